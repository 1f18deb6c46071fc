//! Bode, Nyquist, root-locus and step plots of the controller's loops.

use crazyflie_control::loop_analysis::{FeedbackLoop, LoopAxis, LoopReport, dead_time_s};
use crazyflie_control::pid::Gains;
use crazyflie_env::Error;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_picture::{BLACK, BLUE, Drawing, Panel, PictureError, SKY, Style, VERMILION, chart};
use crazyflie_server::flight::sensor_rig;

use crate::commands::files;

/// Plots of a loop.
const PLOTS: usize = 5;
/// Half the width and height of the Nyquist plot, in units of the loop gain: the unit circle is nearly round.
const NYQUIST: [f64; 2] = [4.4, 2.5];
/// Left edge of the root locus, in crossover frequencies; what is faster hardly shows in the answer.
const LOCUS: f64 = 6.0;

/// Loops of the PID around a model, as data. `sensors` is ideal or lab, which decides the dead time. A height command
/// needs no height loop, so that loop is left out if all are requested.
///
/// # Errors
/// For a vertical form that the model lacks, unknown sensors, and the height loop of a height command.
pub fn loop_reports(
    model: &Model,
    vertical: VerticalInput,
    axis: Option<LoopAxis>,
    gains: &Gains,
    sensors: &str,
) -> Result<Vec<LoopReport>, Error> {
    if axis == Some(LoopAxis::Z) && !vertical.is_pwm() {
        return Err(Error::Config("the height form needs no height loop; choose pwm or thrust".into()));
    }
    let axes = LoopAxis::ALL.into_iter().filter(|own| match axis {
        Some(axis) => *own == axis,
        None => vertical.is_pwm() || *own != LoopAxis::Z,
    });
    let dead_time_s = dead_time_s(model, sensor_rig(sensors)?.1);
    let tick_s = 1.0 / model.rig.control.value;
    let report = |axis: LoopAxis| {
        let feedback = FeedbackLoop::from_model(model, vertical, axis, gains, dead_time_s)?;
        Ok(feedback.report(axis.name(), tick_s))
    };
    axes.map(report).collect()
}

/// The vertical form of that name; without one, the form that `crazyflie fly` commands.
///
/// # Errors
/// For a name that no form has, and a form that the model lacks.
pub fn vertical_form(model: &Model, name: Option<&str>) -> Result<VerticalInput, Error> {
    let Some(name) = name else { return Ok(files::default_vertical(model)) };
    let form = VerticalInput::named(name)?;
    model.vertical(form).map(|_| form)
}

/// One row of plots for each loop; two columns for a single loop.
///
/// # Errors
/// Those of drawing.
pub fn loop_picture(reports: &[LoopReport], title: &str) -> Result<Drawing, PictureError> {
    let panels: Vec<Panel> = reports.iter().flat_map(panels).collect();
    chart(&panels, if reports.len() == 1 { 2 } else { PLOTS }, title)
}

fn panels(report: &LoopReport) -> [Panel; PLOTS] {
    let LoopReport { name, margins: m, frequency: f, root_locus: locus, step, .. } = report;
    let finite =
        |value: f64, unit: &str| if value.is_finite() { format!("{value:.1} {unit}") } else { "none".into() };
    let seconds = |value: Option<f64>| value.map_or("never".into(), |s| format!("{s:.2} s"));
    let (rise, settled) = (seconds(step.figures.rise_s), seconds(step.figures.settling_s));
    let overshoot_percent = 100.0 * step.figures.overshoot;
    let bode = |y_label: &str, y: &[f64]| {
        Panel::new("frequency (rad/s)", y_label).log_x().curve(Style::Solid, BLUE, "", &f.omega_radps, y)
    };
    let lowest = f.phase_deg.first().copied().unwrap_or(0.0).min(-360.0);
    let angles = (0..=180).map(|i| f64::to_radians(2.0 * f64::from(i)));
    let reach = LOCUS * m.crossover_radps.clamp(0.5, 50.0);
    let poles = [0, 1].map(|part| locus.poles.iter().map(move |pole| pole[part]));
    let [real, imaginary] = poles;
    [
        bode("loop gain (dB)", &f.magnitude_db)
            .title(format!("{name}: gain margin {}", finite(m.gain_db, "dB")))
            .level(VERMILION, "", 0.0),
        bode("phase (deg)", &f.phase_deg)
            .title(format!("{name}: phase margin {}", finite(m.phase_deg, "deg")))
            .level(VERMILION, "", -180.0)
            .y_limits([lowest - 10.0, 0.0]),
        Panel::new("real part (1)", "imaginary part (1)")
            .title(format!("{name}: Nyquist, unit circle and -1"))
            .curve(Style::Dashed, BLACK, "", angles.clone().map(f64::cos), angles.map(f64::sin))
            .curve(Style::Solid, BLUE, "", &f.real, &f.imaginary)
            .curve(Style::Points, VERMILION, "-1", [-1.0], [0.0])
            .x_limits([-NYQUIST[0], NYQUIST[0]])
            .y_limits([-NYQUIST[1], NYQUIST[1]]),
        Panel::new("real part (1/s)", "imaginary part (1/s)")
            .title(format!("{name}: root locus, gains x 0.01 to 100"))
            .curve(Style::Points, SKY, "gains x 0.01 to 100", locus.real.concat(), locus.imaginary.concat())
            .curve(Style::Points, VERMILION, "poles", real, imaginary)
            .x_limits([-reach, 0.4 * reach])
            .y_limits([-reach, reach]),
        Panel::new("time (s)", "answer to a unit step (1)")
            .title(format!("{name}: rise {rise}, overshoot {overshoot_percent:.0} %, settled {settled}"))
            .curve(Style::Solid, BLUE, "", &step.t_s, &step.value)
            .level(VERMILION, "", 1.0)
            // an answer may swing by twice its step
            .cut_beyond([-1.0, 3.0]),
    ]
}
