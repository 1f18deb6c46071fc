//! Pictures of a flight.

use crazyflie_env::action::ACTION;
use crazyflie_logs::FlightLog;
use crazyflie_picture::{Band, PALETTE, Panel, Path3, PictureError, Series, Style, chart, scene3d};

use super::{Trace, log};

/// Half the side of the marker (thesis 2.2): over it is "over the marker".
const MARKER_M: f64 = 0.0985;

/// Positions, poses by the camera, and commands over time.
pub fn picture(trace: &Trace, title: &str) -> Result<String, PictureError> {
    let flight = log(trace);
    let t = &flight.t_s;
    let fixes = &flight.fixes;
    let pos = [0, 1, 2].map(|i| trace.state(i));
    let setpoint = [16, 17, 18].map(|i| trace.observation_column(i));
    let degrees = |values: &[f64]| values.iter().map(|v| v.to_degrees()).collect::<Vec<_>>();
    let (yaw, yaw_set) = (degrees(&trace.state(8)), degrees(&trace.observation_column(19)));
    let tilts = [degrees(&trace.state(7)), degrees(&trace.state(6))];
    let commanded =
        [&flight.cmd_pitch_rad, &flight.cmd_roll_rad].map(|c| degrees(c.as_deref().unwrap_or_default()));
    let is_command = flight.cmd_pitch_rad.is_some();
    let lift = flight.cmd_thrust_pwm.as_ref().or(flight.cmd_height_m.as_ref()).cloned().unwrap_or_default();
    let mut panels = Vec::new();
    for (i, label) in ["x (m)", "y (m)", "z (m)"].into_iter().enumerate() {
        let mut series = vec![line("set-point", t, &setpoint[i], Style::Dashed, 4)];
        if sparse(&flight) && !fixes.row.is_empty() {
            series.push(line("marker fixes", &fixes.capture_t_s, &fixes.pos_m[i], Style::Points, 6));
        }
        series.push(line("vehicle", t, &pos[i], Style::Solid, 0));
        let marker = Band { label: "over the marker", low: -MARKER_M, high: MARKER_M, color: PALETTE[2] };
        panels.push(Panel {
            x_label: "time (s)",
            y_label: label,
            series,
            bands: if i < 2 { vec![marker] } else { Vec::new() },
            ..Panel::default()
        });
    }
    panels.push(panel(
        "yaw (deg)",
        vec![line("set-point", t, &yaw_set, Style::Dashed, 4), line("vehicle", t, &yaw, Style::Solid, 0)],
    ));
    for (label, (angle, command)) in
        ["pitch (deg)", "roll (deg)"].into_iter().zip(tilts.iter().zip(&commanded))
    {
        let mut series = vec![line("vehicle", t, angle, Style::Solid, 0)];
        if is_command {
            series.insert(0, line("command", t, command, Style::Step, 1));
        }
        panels.push(panel(label, series));
    }
    let set_points = set_points(trace);
    if is_command {
        let is_pwm = trace.interface.input.is_pwm();
        let label = if is_pwm { "thrust (PWM counts)" } else { "commanded height (m)" };
        panels.push(panel(label, vec![line("command", t, &lift, Style::Step, 1)]));
    } else {
        let channels = trace.interface.level().entry().channels;
        let lines = channels.iter().zip(&set_points).zip([0, 1, 2, 3]);
        let lines = lines.map(|((channel, values), color)| line(channel.name, t, values, Style::Step, color));
        panels.push(panel("set-points of actions", lines.collect()));
    }
    let speeds = [3, 4, 5].map(|i| trace.state(i));
    let named = ["vx", "vy", "vz"].iter().zip(&speeds).zip([0, 1, 2]);
    panels.push(panel(
        "velocity (m/s)",
        named.map(|((name, v), color)| line(name, t, v, Style::Solid, color)).collect(),
    ));
    chart(&panels, 2, title)
}

/// What the actions set, channel by channel, in its units.
fn set_points(trace: &Trace) -> [Vec<f64>; ACTION] {
    let rows = trace.rows.iter().map(|row| trace.interface.set_point(&row.action.map(f64::from)));
    let rows: Vec<[f64; ACTION]> = rows.collect();
    std::array::from_fn(|i| rows.iter().map(|row| row[i]).collect())
}

/// The way through space.
pub fn path(trace: &Trace, title: &str) -> Result<String, PictureError> {
    let points = |of: &dyn Fn(usize) -> [f64; 3]| (0..trace.rows.len()).map(of).collect::<Vec<_>>();
    let flown = points(&|i| [0, 1, 2].map(|k| f64::from(trace.rows[i].state[k])));
    let wanted = points(&|i| [16, 17, 18].map(|k| f64::from(trace.rows[i].observation[k])));
    let paths = [
        Path3 { label: "set-point", points_m: &wanted, style: Style::Dashed, color: PALETTE[4] },
        Path3 { label: "vehicle", points_m: &flown, style: Style::Solid, color: PALETTE[0] },
    ];
    scene3d(&paths, &trace.outlines, title)
}

/// Whether fixes come more rarely than control ticks, so that showing them says something.
fn sparse(flight: &FlightLog) -> bool {
    flight.fixes.row.len() < flight.len()
}

fn panel<'a>(y_label: &'a str, series: Vec<Series<'a>>) -> Panel<'a> {
    Panel { x_label: "time (s)", y_label, series, ..Panel::default() }
}

fn line<'a>(label: &'a str, x: &'a [f64], y: &'a [f64], style: Style, color: usize) -> Series<'a> {
    Series { label, x, y, style, color: PALETTE[color] }
}
