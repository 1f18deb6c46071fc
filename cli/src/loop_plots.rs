//! Bode, Nyquist, root-locus and step plots of the controller's loops.

use crazyflie_control::loop_analysis::{FeedbackLoop, LoopAxis, LoopReport, dead_time_s};
use crazyflie_control::pid::Gains;
use crazyflie_env::Error;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_picture::{HLine, PALETTE, Panel, PictureError, Scale, Series, Style, chart};
use crazyflie_server::flight::sensor_rig;

use crate::commands::files;

/// Plots of a loop.
const PLOTS: usize = 5;
/// Half the side of the Nyquist plot, in units of the loop gain.
const NYQUIST: f64 = 2.5;
/// Left edge of the root locus, in crossover frequencies; what is faster hardly shows in the answer.
const LOCUS: f64 = 6.0;

/// Loops of the PID around a model, as data. `sensors` is ideal or lab, which decides the dead time. A height
/// command needs no height loop, so that loop is left out where all are asked for.
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
pub fn loop_picture(reports: &[LoopReport], title: &str) -> Result<String, PictureError> {
    let curves: Vec<LoopCurves> = reports.iter().map(LoopCurves::new).collect();
    let panels: Vec<Panel> =
        reports.iter().zip(&curves).flat_map(|(report, curves)| curves.panels(report)).collect();
    chart(&panels, if reports.len() == 1 { 2 } else { PLOTS }, title)
}

/// Texts and numbers of a loop's plots.
struct LoopCurves {
    titles: [String; PLOTS],
    circle: [Vec<f64>; 2],
    locus: [Vec<f64>; 2],
    poles: [Vec<f64>; 2],
    critical: [Vec<f64>; 2],
    reach: f64,
}

impl LoopCurves {
    fn new(report: &LoopReport) -> Self {
        let (m, f) = (&report.margins, &report.step.figures);
        let finite = |value: f64, unit: &str| {
            if value.is_finite() { format!("{value:.1} {unit}") } else { "none".into() }
        };
        let seconds = |value: Option<f64>| value.map_or("never".into(), |s| format!("{s:.2} s"));
        let name = report.name;
        let titles = [
            format!("{name}: gain margin {}", finite(m.gain_db, "dB")),
            format!("{name}: phase margin {}", finite(m.phase_deg, "deg")),
            format!("{name}: Nyquist, unit circle and -1"),
            format!("{name}: root locus, gains x 0.01 to 100"),
            format!(
                "{name}: rise {}, overshoot {:.0} %, settled {}",
                seconds(f.rise_s),
                100.0 * f.overshoot,
                seconds(f.settling_s)
            ),
        ];
        let angles = (0..=180).map(|i| f64::to_radians(2.0 * f64::from(i)));
        let locus = &report.root_locus;
        LoopCurves {
            titles,
            circle: [angles.clone().map(f64::cos).collect(), angles.map(f64::sin).collect()],
            locus: [locus.real.concat(), locus.imaginary.concat()],
            poles: [0, 1].map(|part| locus.poles.iter().map(|pole| pole[part]).collect()),
            critical: [vec![-1.0], vec![0.0]],
            reach: LOCUS * m.crossover_radps.clamp(0.5, 50.0),
        }
    }

    fn panels<'a>(&'a self, report: &'a LoopReport) -> [Panel<'a>; PLOTS] {
        let f = &report.frequency;
        let line = |label, x, y| Series { label, x, y, style: Style::Solid, color: PALETTE[0] };
        let level = |y| vec![HLine { label: "", y, color: PALETTE[1] }];
        let points = |label, of: &'a [Vec<f64>; 2], color: usize| Series {
            label,
            x: &of[0],
            y: &of[1],
            style: Style::Points,
            color: PALETTE[color],
        };
        let [magnitude, phase, nyquist, locus, step] = &self.titles;
        let bode = |title, y_label, y| Panel {
            title,
            x_label: "frequency (rad/s)",
            y_label,
            series: vec![line("", &f.omega_radps, y)],
            x_scale: Scale::Log,
            ..Panel::default()
        };
        let lowest = f.phase_deg.first().copied().unwrap_or(0.0).min(-360.0);
        let unit =
            Series { style: Style::Dashed, color: PALETTE[4], ..line("", &self.circle[0], &self.circle[1]) };
        [
            Panel { hlines: level(0.0), ..bode(magnitude, "loop gain (dB)", &f.magnitude_db) },
            Panel {
                hlines: level(-180.0),
                y_limits: Some([lowest - 10.0, 0.0]),
                ..bode(phase, "phase (deg)", &f.phase_deg)
            },
            Panel {
                title: nyquist,
                x_label: "real part",
                y_label: "imaginary part",
                series: vec![unit, line("", &f.real, &f.imaginary), points("-1", &self.critical, 1)],
                x_limits: Some([-NYQUIST, NYQUIST]),
                y_limits: Some([-NYQUIST, NYQUIST]),
                ..Panel::default()
            },
            Panel {
                title: locus,
                x_label: "real part (1/s)",
                y_label: "imaginary part (1/s)",
                series: vec![points("gains x 0.01 to 100", &self.locus, 5), points("poles", &self.poles, 1)],
                x_limits: Some([-self.reach, 0.4 * self.reach]),
                y_limits: Some([-self.reach, self.reach]),
                ..Panel::default()
            },
            Panel {
                title: step,
                x_label: "time (s)",
                y_label: "answer to a unit step",
                series: vec![line("", &report.step.t_s, &report.step.value)],
                hlines: level(1.0),
                y_limits: Some([-1.0, 3.0].map(|edge| edge_of(&report.step.value, edge))),
                ..Panel::default()
            },
        ]
    }
}

/// The range of an answer, within that of one that swings by twice its step.
fn edge_of(value: &[f64], edge: f64) -> f64 {
    if edge < 0.0 {
        value.iter().copied().fold(-0.1, f64::min).max(edge)
    } else {
        value.iter().copied().fold(1.2, f64::max).min(edge)
    }
}
