//! Output and pictures of `crazyflie inspect`.

use std::fmt::Display;
use std::io::Write;

use crazyflie_logs::inspect::{Clocks, Finding, Grade, Inspection, Motion, SignVerdict};
use crazyflie_picture::{BLUE, Drawing, PALETTE, Panel, PictureError, Style, VERMILION, chart};

use super::files::stem;
use super::inspect::InspectedLog;
use super::{Outcome, Table, number, quantity};

/// A degree of a radian.
const DEG: f64 = 180.0 / std::f64::consts::PI;

pub(super) fn write(found: &InspectedLog, out: &mut dyn Write) -> Outcome {
    let i = &found.inspection;
    let by_draft = if found.by_draft { ", by a draft of a mapping: check it (--mapping-out)" } else { "" };
    writeln!(out, "{}: {}{by_draft}", found.file, i.format)?;
    let (duration_s, rate_hz) = (number(i.duration_s, 1), number(i.rate_hz, 1));
    findings(i, Grade::Grave, "GRAVE: commands refuse this log", out)?;
    writeln!(out, "  {} rows, {duration_s} s at {rate_hz} Hz; {}", i.rows, gaps(i))?;
    writeln!(out, "  position: {}; attitude: {}", i.provenance.position, i.provenance.attitude)?;
    writeln!(out, "  {}", flight(i))?;
    i.motion.iter().try_for_each(|m| writeln!(out, "  {}", motion(m)))?;
    clocks(&i.clocks).iter().try_for_each(|line| writeln!(out, "  {line}"))?;
    writeln!(out, "\n{}", channels(i))?;
    if !i.commands.is_empty() {
        writeln!(out, "{}", commands(i))?;
    }
    if !i.signs.is_empty() {
        writeln!(out, "{}", signs(i))?;
    }
    for need in &i.needs {
        let lacks = || format!("lacks {}", need.missing.join("; "));
        let state = if need.missing.is_empty() { "suffices".to_owned() } else { lacks() };
        let weak = if need.weak.is_empty() { String::new() } else { format!(" ({})", need.weak.join("; ")) };
        writeln!(out, "{:9} {state}{weak}", need.command)?;
    }
    for (grade, title) in [(Grade::Warning, "warnings"), (Grade::Remark, "notes")] {
        findings(i, grade, title, out)?;
    }
    Ok(writeln!(out)?)
}

/// The findings of one grade, each in a line.
fn findings(i: &Inspection, grade: Grade, title: &str, out: &mut dyn Write) -> Outcome {
    let of_grade: Vec<&Finding> = i.findings.iter().filter(|finding| finding.grade == grade).collect();
    if !of_grade.is_empty() {
        writeln!(out, "\n{title}:")?;
        of_grade.iter().try_for_each(|finding| writeln!(out, "  {finding}"))?;
    }
    Ok(())
}

fn gaps(i: &Inspection) -> String {
    match i.gaps.count {
        0 => "no gaps".into(),
        count => format!("{count} gaps, the longest {} s", number(i.gaps.longest_s, 3)),
    }
}

fn flight(i: &Inspection) -> String {
    let flies = match i.airborne_s {
        Some([from, to]) => format!("flies from {} to {} s", number(from, 1), number(to, 1)),
        None => "never flies".into(),
    };
    match i.resting_height_m {
        Some(rest) => format!("{flies}; stands at {} m", number(rest, 3)),
        None => format!("{flies}; does not stand before or after"),
    }
}

fn motion(m: &Motion) -> String {
    let range =
        |[from, to]: [f64; 2], unit: &str| format!("{} to {}", number(from, 2), quantity(to, 2, unit));
    let voltage = m.voltage_v.map_or(String::new(), |v| format!(", battery {}", range(v, "V")));
    let [speed, climb] = [m.speed_mps, m.climb_mps].map(|mps| quantity(mps, 2, "m/s"));
    let [tilt, yaw] =
        [(m.tilt_deg, 1), (m.yaw_turned_deg, 0)].map(|(deg, digits)| quantity(deg, digits, "deg"));
    let height = range(m.height_m, "m");
    format!("height {height}, speed to {speed}, climb to {climb}, tilt to {tilt}, yaw turned {yaw}{voltage}")
}

fn clocks(clocks: &Clocks) -> Vec<String> {
    let ms = |s: f64| number(s * 1e3, 0);
    let gyro = clocks.gyro_late_s.map(|late| {
        let [median, lowest, highest] = late.map(ms);
        format!("the gyro appears {median} ms later than the attitude ({lowest} to {highest} ms)")
    });
    let position = clocks.position_late_s.map(|[lag, sigma]| {
        format!("the position appears {} +- {} ms later than the attitude", ms(lag), ms(sigma))
    });
    gyro.into_iter().chain(position).collect()
}

/// Angles and rates are read in degrees; all others as they are.
fn shown(unit: &'static str) -> (f64, &'static str, usize) {
    match unit {
        "rad" => (DEG, "deg", 2),
        "rad/s" => (DEG, "deg/s", 1),
        "pwm" => (1.0, "pwm", 0),
        _ => (1.0, unit, 3),
    }
}

/// A value as it is read.
fn in_unit(value: f64, unit: &'static str) -> String {
    let (scale, _, decimals) = shown(unit);
    number(value * scale, decimals)
}

fn channels(i: &Inspection) -> impl Display {
    Table::from_rows(&i.channels)
        .words("channel", |c| c.name)
        .words("unit", |c| shown(c.unit).1)
        .values(
            "new values (Hz)",
            |c| if c.rate_hz == 0.0 { "constant".into() } else { number(c.rate_hz, 1) },
        )
        .values("longest hold (s)", |c| number(c.longest_hold_s, 2))
        .values("lowest", |c| in_unit(c.lowest, c.unit))
        .values("median", |c| in_unit(c.median, c.unit))
        .values("highest", |c| in_unit(c.highest, c.unit))
}

fn commands(i: &Inspection) -> impl Display {
    Table::from_rows(&i.commands)
        .words("command", |c| c.name)
        .words("unit", |c| shown(c.unit).1)
        .values("RMS", |c| in_unit(c.rms, c.unit))
        .values("bandwidth (Hz)", |c| c.bandwidth_hz.map_or("constant".into(), |hz| number(hz, 2)))
}

fn signs(i: &Inspection) -> impl Display {
    Table::from_rows(&i.signs)
        .words("sign check", |check| check.expectation)
        .words("channel", |check| check.channel)
        .values("correlation", |check| number(check.correlation, 2))
        .words("verdict", |check| match check.verdict {
            SignVerdict::Agrees => "agrees",
            SignVerdict::Contradicts => "CONTRADICTS: the sign is wrong, or the axes are",
            SignVerdict::NotSeen => "not seen",
        })
}

/// Position, attitude with its commands, what lifts, and the battery.
pub(super) fn picture(found: &InspectedLog) -> Result<Drawing, PictureError> {
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
    for (name, label, angle, command) in [
        ("roll", "roll (deg)", &log.roll_rad, &log.cmd_roll_rad),
        ("pitch", "pitch (deg)", &log.pitch_rad, &log.cmd_pitch_rad),
        ("yaw", "yaw (deg)", &log.yaw_rad, &log.setpoint_yaw_rad),
    ] {
        let measured = add(panel(name, label), Style::Solid, BLUE, "measured", Some(angle), DEG);
        panels.push(add(measured, Style::Dashed, VERMILION, "command", command.as_ref(), DEG));
    }
    let thrust = log.cmd_thrust_pwm.as_ref();
    let mut lift = add(panel("lift", "PWM (thousands)"), Style::Solid, BLUE, "thrust command", thrust, 1e-3);
    let motors = log.onboard.as_ref().and_then(|onboard| onboard.motor_pwm.as_ref()).into_iter().flatten();
    for ((motor, pwm), color) in (1..).zip(motors).zip(&PALETTE[usize::from(thrust.is_some())..]) {
        lift = add(lift, Style::Solid, *color, &format!("motor {motor}"), Some(pwm), 1e-3);
    }
    let rate = log.cmd_yaw_rate_radps.as_ref();
    let rate = add(panel("yaw rate", "command (deg/s)"), Style::Solid, BLUE, "yaw-rate command", rate, DEG);
    let battery = panel("battery", "voltage (V)");
    let battery = add(battery, Style::Solid, BLUE, "battery", log.vbat_v.as_ref(), 1.0);
    panels.extend([lift, rate, battery]);
    panels.retain(|panel| !panel.is_empty());
    chart(&panels, 3, &stem(&found.file))
}
