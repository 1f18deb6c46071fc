//! Picture of `crazyflie inspect`: position, attitude with its commands, what lifts, and the battery.

use crazyflie_picture::{PALETTE, Panel, PictureError, Series, Style, chart};

use super::inspect::InspectedLog;

/// Label, times and values.
type Curve = (&'static str, Vec<f64>, Vec<f64>, Style);

/// The curves of one panel.
struct PanelData {
    title: &'static str,
    y_label: &'static str,
    curves: Vec<Curve>,
}

pub(super) fn draw(found: &InspectedLog) -> Result<String, PictureError> {
    let log = &found.log;
    let rows = |label, values: &[f64], scale: f64, style| {
        (label, log.t_s.clone(), values.iter().map(|v| v * scale).collect(), style)
    };
    let deg = 180.0 / std::f64::consts::PI;
    let mut panel_data = Vec::new();
    let axes = [("x", "x (m)", 0), ("y", "y (m)", 1), ("z", "z (m)", 2)];
    for (title, y_label, axis) in axes {
        let mut curves = Vec::new();
        if !log.fixes.row.is_empty() {
            curves.push((
                "measured",
                log.fixes.capture_t_s.clone(),
                log.fixes.pos_m[axis].clone(),
                Style::Solid,
            ));
        }
        curves.extend(
            log.setpoint_m.as_ref().map(|setpoint| rows("set-point", &setpoint[axis], 1.0, Style::Dashed)),
        );
        panel_data.push(PanelData { title, y_label, curves });
    }
    let tilts = [
        ("roll", "roll (deg)", &log.roll_rad, log.cmd_roll_rad.as_ref()),
        ("pitch", "pitch (deg)", &log.pitch_rad, log.cmd_pitch_rad.as_ref()),
        ("yaw", "yaw (deg)", &log.yaw_rad, log.setpoint_yaw_rad.as_ref()),
    ];
    for (title, y_label, angle, command) in tilts {
        let mut curves = vec![rows("measured", angle, deg, Style::Solid)];
        curves.extend(command.map(|command| rows("command", command, deg, Style::Dashed)));
        panel_data.push(PanelData { title, y_label, curves });
    }
    let mut lift: Vec<Curve> =
        log.cmd_thrust_pwm.iter().map(|thrust| rows("thrust command", thrust, 1e-3, Style::Solid)).collect();
    let motors = log.onboard.as_ref().and_then(|onboard| onboard.motor_pwm.as_ref());
    for (label, motor) in
        ["motor 1", "motor 2", "motor 3", "motor 4"].into_iter().zip(motors.into_iter().flatten())
    {
        lift.push(rows(label, motor, 1e-3, Style::Solid));
    }
    panel_data.push(PanelData { title: "lift", y_label: "PWM (thousands)", curves: lift });
    let rate =
        log.cmd_yaw_rate_radps.iter().map(|rate| rows("yaw-rate command", rate, deg, Style::Solid)).collect();
    panel_data.push(PanelData { title: "yaw rate", y_label: "command (deg/s)", curves: rate });
    let battery = log.vbat_v.iter().map(|v| rows("battery", v, 1.0, Style::Solid)).collect();
    panel_data.push(PanelData { title: "battery", y_label: "voltage (V)", curves: battery });
    panel_data.retain(|panel| !panel.curves.is_empty());
    let panels: Vec<Panel> = panel_data.iter().map(panel).collect();
    chart(&panels, 3, &super::replay::stem(&found.file))
}

fn panel(panel_data: &PanelData) -> Panel<'_> {
    let series = panel_data.curves.iter().enumerate().map(|(i, (label, x, y, style))| {
        let color = PALETTE[i % PALETTE.len()];
        Series { label, x, y, style: *style, color }
    });
    Panel {
        title: panel_data.title,
        x_label: "time (s)",
        y_label: panel_data.y_label,
        series: series.collect(),
        ..Panel::default()
    }
}
