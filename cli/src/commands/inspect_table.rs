//! Output of `crazyflie inspect`.

use std::fmt::Display;
use std::io::Write;

use crazyflie_logs::inspect::{Clocks, Inspection, Motion, SignVerdict};

use super::inspect::InspectedLog;
use super::{Outcome, Table, number, quantity};

/// A degree of a radian.
const DEG: f64 = 180.0 / std::f64::consts::PI;

pub(super) fn write(found: &InspectedLog, out: &mut dyn Write) -> Outcome {
    let i = &found.inspection;
    let by_draft = if found.by_draft { ", by a draft of a mapping: check it (--mapping-out)" } else { "" };
    writeln!(out, "{}: {}{by_draft}", found.file, i.format)?;
    let (duration_s, rate_hz) = (number(i.duration_s, 1), number(i.rate_hz, 1));
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
    if !i.notes.is_empty() {
        writeln!(out, "\nnotes:")?;
        i.notes.iter().try_for_each(|note| writeln!(out, "  {note}"))?;
    }
    Ok(writeln!(out)?)
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
    Table::of(&i.channels)
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
    Table::of(&i.commands)
        .words("command", |c| c.name)
        .words("unit", |c| shown(c.unit).1)
        .values("RMS", |c| in_unit(c.rms, c.unit))
        .values("bandwidth (Hz)", |c| c.bandwidth_hz.map_or("constant".into(), |hz| number(hz, 2)))
}

fn signs(i: &Inspection) -> impl Display {
    Table::of(&i.signs)
        .words("sign check", |check| check.expectation)
        .words("channel", |check| check.channel)
        .values("correlation", |check| number(check.correlation, 2))
        .words("verdict", |check| match check.verdict {
            SignVerdict::Agrees => "agrees",
            SignVerdict::Contradicts => "CONTRADICTS: the sign is wrong, or the axes are",
            SignVerdict::NotSeen => "not seen",
        })
}
