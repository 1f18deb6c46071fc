//! Picture of `crazyflie inspect`: position, attitude with its commands, what lifts, and the battery.

use crazyflie_picture::{BLUE, Drawing, PALETTE, Panel, PictureError, Style, VERMILION, chart};

use super::inspect::InspectedLog;

pub(super) fn draw(found: &InspectedLog) -> Result<Drawing, PictureError> {
    let log = &found.log;
    let add = |panel: Panel, style, color, label: &str, values: Option<&Vec<f64>>, scale: f64| match values {
        Some(values) => panel.curve(style, color, label, &log.t_s, values.iter().map(|v| v * scale)),
        None => panel,
    };
    let panel = |title, y_label: &str| Panel::new("time (s)", y_label).title(title);
    let mut panels = Vec::new();
    for (axis, (name, label)) in [("x", "x (m)"), ("y", "y (m)"), ("z", "z (m)")].into_iter().enumerate() {
        let mut position = panel(name, label);
        if !log.fixes.row.is_empty() {
            let (t_s, pos_m) = (&log.fixes.capture_t_s, &log.fixes.pos_m[axis]);
            position = position.curve(Style::Solid, BLUE, "measured", t_s, pos_m);
        }
        let setpoint = log.setpoint_m.as_ref().map(|setpoint| &setpoint[axis]);
        panels.push(add(position, Style::Dashed, VERMILION, "set-point", setpoint, 1.0));
    }
    let deg = 1.0_f64.to_degrees();
    for (name, label, angle, command) in [
        ("roll", "roll (deg)", &log.roll_rad, &log.cmd_roll_rad),
        ("pitch", "pitch (deg)", &log.pitch_rad, &log.cmd_pitch_rad),
        ("yaw", "yaw (deg)", &log.yaw_rad, &log.setpoint_yaw_rad),
    ] {
        let measured = add(panel(name, label), Style::Solid, BLUE, "measured", Some(angle), deg);
        panels.push(add(measured, Style::Dashed, VERMILION, "command", command.as_ref(), deg));
    }
    let thrust = log.cmd_thrust_pwm.as_ref();
    let mut lift = add(panel("lift", "PWM (thousands)"), Style::Solid, BLUE, "thrust command", thrust, 1e-3);
    let motors = log.onboard.as_ref().and_then(|onboard| onboard.motor_pwm.as_ref()).into_iter().flatten();
    for ((motor, pwm), color) in (1..).zip(motors).zip(&PALETTE[usize::from(thrust.is_some())..]) {
        lift = add(lift, Style::Solid, *color, &format!("motor {motor}"), Some(pwm), 1e-3);
    }
    let rate = log.cmd_yaw_rate_radps.as_ref();
    let rate = add(panel("yaw rate", "command (deg/s)"), Style::Solid, BLUE, "yaw-rate command", rate, deg);
    let battery = panel("battery", "voltage (V)");
    let battery = add(battery, Style::Solid, BLUE, "battery", log.vbat_v.as_ref(), 1.0);
    panels.extend([lift, rate, battery]);
    panels.retain(|panel| !panel.is_empty());
    chart(&panels, 3, &super::files::stem(&found.file))
}
