//! The channels of a log: rate, range, longest standstill.

use crazyflie_statistics::quantile;
use serde::Serialize;

use super::airborne_s;
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
        all.extend(summary(log, &fixes, (name, "m", values)));
    }
    all.extend(rows(log).into_iter().filter_map(|channel| summary(log, &log.t_s, channel)));
    all
}

/// A channel with one value per row: name, unit, values.
pub(super) type RowChannel<'a> = (&'static str, &'static str, &'a [f64]);

/// Channels of these names, with spaces between.
fn named<'a>(
    names: &'static str,
    unit: &'static str,
    values: impl IntoIterator<Item = &'a Vec<f64>>,
) -> Vec<RowChannel<'a>> {
    names.split(' ').zip(values).map(|(name, values)| (name, unit, &values[..])).collect()
}

/// Channels with one value per row.
pub(super) fn rows(log: &FlightLog) -> Vec<RowChannel<'_>> {
    let onboard = || log.onboard.iter();
    let rates = onboard().flat_map(|o| &o.cmd_rates_radps);
    let torques = onboard().flat_map(|o| &o.cmd_torque_nm);
    let motors = onboard().flat_map(|o| o.motor_pwm.as_ref().or(o.motor_request_pwm.as_ref()));
    [
        named("roll pitch yaw", "rad", [&log.roll_rad, &log.pitch_rad, &log.yaw_rad]),
        named("vx vy vz", "m/s", log.vel_mps.iter().flatten()),
        named("gyro_x gyro_y gyro_z", "rad/s", log.gyro_radps.iter().flatten()),
        named("acc_x acc_y acc_z", "m/s2", log.acc_mps2.iter().flatten()),
        named("setpoint_x setpoint_y setpoint_z", "m", log.setpoint_m.iter().flatten()),
        named("setpoint_yaw", "rad", &log.setpoint_yaw_rad),
        named("cmd_roll", "rad", &log.cmd_roll_rad),
        named("cmd_pitch", "rad", &log.cmd_pitch_rad),
        named("cmd_yaw_rate", "rad/s", &log.cmd_yaw_rate_radps),
        named("cmd_thrust", "pwm", &log.cmd_thrust_pwm),
        named("cmd_height", "m", &log.cmd_height_m),
        named("vbat", "V", &log.vbat_v),
        named("cmd_rate_x cmd_rate_y cmd_rate_z", "rad/s", rates.flatten()),
        named("cmd_torque_x cmd_torque_y cmd_torque_z", "N m", torques.flatten()),
        named("motor_1 motor_2 motor_3 motor_4", "pwm", motors.flatten()),
        named("rotor_1 rotor_2 rotor_3 rotor_4", "rad/s", onboard().flat_map(|o| &o.rotor_radps).flatten()),
    ]
    .concat()
}

fn summary(log: &FlightLog, t_s: &[f64], (name, unit, values): RowChannel<'_>) -> Option<ChannelSummary> {
    let (first_s, last_s) = (*t_s.first()?, *t_s.last()?);
    let flies = airborne_s(log).unwrap_or([first_s, last_s]);
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
