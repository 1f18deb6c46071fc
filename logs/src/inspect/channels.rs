//! The channels of a log: rate, range, longest standstill.

use crazyflie_statistics::quantile;
use serde::Serialize;

use crate::FlightLog;

/// One channel of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// Name as in a mapping file.
    pub name: &'static str,
    /// Unit of the three values below.
    pub unit: &'static str,
    /// New values per second: a channel that is repeated between its packets changes less often than rows arrive. 0
    /// is a constant.
    pub rate_hz: f64,
    /// Longest time without a new value, within the flight.
    pub longest_hold_s: f64,
    /// Lowest value of the whole log.
    pub lowest: f64,
    /// Median over the whole log.
    pub median: f64,
    /// Highest value of the whole log.
    pub highest: f64,
}

/// Summaries of all channels that are there.
pub(super) fn summaries(log: &FlightLog) -> Vec<ChannelSummary> {
    let fixes = log.fixes.row.iter().map(|row| log.t_s[*row]).collect::<Vec<f64>>();
    let mut all = Vec::new();
    for (name, values) in ["x", "y", "z"].into_iter().zip(&log.fixes.pos_m) {
        all.extend(summary(log, name, "m", &fixes, values));
    }
    for (name, unit, values) in rows(log) {
        all.extend(summary(log, name, unit, &log.t_s, values));
    }
    all
}

/// Channels with one value per row: name, unit, values.
pub(super) fn rows(log: &FlightLog) -> Vec<(&'static str, &'static str, &[f64])> {
    let mut all: Vec<(&str, &str, &[f64])> = Vec::new();
    let triples = [
        (["vx", "vy", "vz"], "m/s", log.vel_mps.as_ref()),
        (["gyro_x", "gyro_y", "gyro_z"], "rad/s", log.gyro_radps.as_ref()),
        (["acc_x", "acc_y", "acc_z"], "m/s2", log.acc_mps2.as_ref()),
        (["setpoint_x", "setpoint_y", "setpoint_z"], "m", log.setpoint_m.as_ref()),
    ];
    all.extend([
        ("roll", "rad", &log.roll_rad[..]),
        ("pitch", "rad", &log.pitch_rad),
        ("yaw", "rad", &log.yaw_rad),
    ]);
    for (names, unit, values) in triples {
        all.extend(
            values
                .into_iter()
                .flat_map(|values| names.into_iter().zip(values).map(move |(name, v)| (name, unit, &v[..]))),
        );
    }
    let single = [
        ("setpoint_yaw", "rad", &log.setpoint_yaw_rad),
        ("cmd_roll", "rad", &log.cmd_roll_rad),
        ("cmd_pitch", "rad", &log.cmd_pitch_rad),
        ("cmd_yaw_rate", "rad/s", &log.cmd_yaw_rate_radps),
        ("cmd_thrust", "pwm", &log.cmd_thrust_pwm),
        ("cmd_height", "m", &log.cmd_height_m),
        ("vbat", "V", &log.vbat_v),
    ];
    all.extend(single.into_iter().filter_map(|(name, unit, values)| Some((name, unit, values.as_deref()?))));
    if let Some(onboard) = &log.onboard {
        for (names, unit, values) in [
            (["cmd_rate_x", "cmd_rate_y", "cmd_rate_z"], "rad/s", onboard.cmd_rates_radps.as_ref()),
            (["cmd_torque_x", "cmd_torque_y", "cmd_torque_z"], "N m", onboard.cmd_torque_nm.as_ref()),
        ] {
            all.extend(
                values.into_iter().flat_map(|values| {
                    names.into_iter().zip(values).map(move |(name, v)| (name, unit, &v[..]))
                }),
            );
        }
        let motors = onboard.motor_pwm.as_ref().or(onboard.motor_request_pwm.as_ref());
        for (names, unit, values) in [
            (["motor_1", "motor_2", "motor_3", "motor_4"], "pwm", motors),
            (["rotor_1", "rotor_2", "rotor_3", "rotor_4"], "rad/s", onboard.rotor_radps.as_ref()),
        ] {
            all.extend(
                values.into_iter().flat_map(|values| {
                    names.into_iter().zip(values).map(move |(name, v)| (name, unit, &v[..]))
                }),
            );
        }
    }
    all
}

fn summary(
    log: &FlightLog,
    name: &'static str,
    unit: &'static str,
    t_s: &[f64],
    values: &[f64],
) -> Option<ChannelSummary> {
    let (first_s, last_s) = (*t_s.first()?, *t_s.last()?);
    let flies = match (
        log.t_s.get(log.airborne.start),
        log.airborne.end.checked_sub(1).and_then(|row| log.t_s.get(row)),
    ) {
        (Some(from), Some(to)) if !log.airborne.is_empty() => [*from, *to],
        _ => [first_s, last_s],
    };
    let changed: Vec<f64> =
        (1..values.len()).filter(|i| values[*i] != values[i - 1]).map(|i| t_s[i]).collect();
    let inside: Vec<f64> = changed.iter().copied().filter(|t| (flies[0]..=flies[1]).contains(t)).collect();
    let edges: Vec<f64> = [&[flies[0]][..], &inside, &[flies[1]]].concat();
    let longest_hold_s = edges.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    let span_s = flies[1] - flies[0];
    let rate_hz = if span_s > 0.0 { inside.len() as f64 / span_s } else { 0.0 };
    let [lowest, median, highest] = [0.0, 0.5, 1.0].map(|share| quantile(values, share).unwrap_or(0.0));
    Some(ChannelSummary { name, unit, rate_hz, longest_hold_s, lowest, median, highest })
}
