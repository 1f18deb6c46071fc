//! The excitation of a flight: how large and how fast its commands are, and where and how it moved.

use crazyflie_statistics::quantile;
use serde::Serialize;

use super::airborne_s;
use super::channels::{RowChannel, rows};
use crate::FlightLog;
use crate::series::{Interpolation, value_at};
use crate::signal::usual_step;
use crate::spectrum::power_spectrum;

/// The bandwidth contains this share of a command's variance.
const POWER_SHARE: f64 = 0.9;
/// Long enough for the spectrum of a flight of an hour at 100 Hz, short enough for damaged times.
const MOST_SAMPLES: f64 = 1e6;
const LEAST_SAMPLES: usize = 32;
/// Rounding of a constant in single precision.
const ROUNDING: f64 = 1e-6;
/// Speeds and tilts by this quantile: single outliers of a marker are none.
const HIGH: f64 = 0.99;

/// Size and speed of one command in flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CommandExcitation {
    /// Channel as in a mapping file, such as `cmd_roll` or `motor_1`.
    pub name: &'static str,
    /// Unit of [`CommandExcitation::rms`].
    pub unit: &'static str,
    /// Root mean square about the mean.
    pub rms: f64,
    /// Frequency below which nine tenths of the variance lie; `None` for a constant.
    pub bandwidth_hz: Option<f64>,
}

/// Extent of the motion in flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Motion {
    /// Over the resting place, where that is known; else as logged.
    pub height_m: [f64; 2],
    /// Horizontal speed that 1 % of the samples exceed.
    pub speed_mps: f64,
    /// Vertical speed, up or down, that 1 % of the samples exceed.
    pub climb_mps: f64,
    /// Angle of roll and pitch together that 1 % of the rows exceed.
    pub tilt_deg: f64,
    /// Way that the yaw went, back and forth added up.
    pub yaw_turned_deg: f64,
    /// Voltage at the start and at the end of the flight.
    pub voltage_v: Option<[f64; 2]>,
}

pub(super) fn commands(log: &FlightLog) -> Vec<CommandExcitation> {
    let commands =
        rows(log).into_iter().filter(|(name, ..)| name.starts_with("cmd_") || name.starts_with("motor_"));
    let airborne = log.airborne.clone();
    if airborne.len() < LEAST_SAMPLES {
        return Vec::new();
    }
    let excitation = |(name, unit, values): RowChannel<'_>| {
        let part = &values[airborne.clone()];
        let mean = part.iter().sum::<f64>() / part.len() as f64;
        let rms = (part.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / part.len() as f64).sqrt();
        CommandExcitation { name, unit, rms, bandwidth_hz: bandwidth_hz(&log.t_s[airborne.clone()], part) }
    };
    commands.map(excitation).collect()
}

/// The frequency below which [`POWER_SHARE`] of the variance lies.
fn bandwidth_hz(t_s: &[f64], values: &[f64]) -> Option<f64> {
    let step_s = usual_step(t_s);
    let span_s = t_s.last()? - t_s.first()?;
    if step_s <= 0.0 || span_s / step_s > MOST_SAMPLES {
        return None;
    }
    let count = (span_s / step_s) as usize;
    let grid: Vec<f64> = (0..count).map(|i| t_s[0] + i as f64 * step_s).collect();
    let held = |at_s: &f64| value_at(t_s, values, *at_s, Interpolation::Held, None);
    let mut even: Vec<f64> = grid.iter().map(held).collect();
    let mean = even.iter().sum::<f64>() / even.len().max(1) as f64;
    even.iter_mut().for_each(|v| *v -= mean);
    if even.len() < LEAST_SAMPLES {
        return None;
    }
    let power = power_spectrum(even).split_off(1);
    let total: f64 = power.iter().sum();
    // The rounding of single precision is no motion.
    let rounding = (ROUNDING * mean * grid.len() as f64).powi(2);
    if total.is_nan() || total <= rounding {
        return None;
    }
    let mut sum = 0.0;
    let bin = power.iter().position(|p| {
        sum += p;
        sum >= POWER_SHARE * total
    })?;
    Some((bin + 1) as f64 / (grid.len() as f64 * step_s))
}

pub(super) fn motion(log: &FlightLog) -> Option<Motion> {
    let rows = log.airborne.clone();
    let [from_s, to_s] = airborne_s(log)?;
    let flown = |t: f64| (from_s..=to_s).contains(&t);
    let seen: Vec<usize> = (0..log.fixes.row.len()).filter(|i| flown(log.t_s[log.fixes.row[*i]])).collect();
    let axis = |axis: usize| seen.iter().map(|i| log.fixes.pos_m[axis][*i]).collect::<Vec<f64>>();
    let (t_s, pos_m) =
        (seen.iter().map(|i| log.fixes.capture_t_s[*i]).collect::<Vec<f64>>(), [axis(0), axis(1), axis(2)]);
    let rest_m = log.resting_height_m().unwrap_or(0.0);
    let velocity = match &log.vel_mps {
        Some(velocity) => velocity.each_ref().map(|v| v[rows.clone()].to_vec()),
        None => pos_m.each_ref().map(|x| slopes(&t_s, x)),
    };
    let speed: Vec<f64> = velocity[0].iter().zip(&velocity[1]).map(|(x, y)| x.hypot(*y)).collect();
    let climb: Vec<f64> = velocity[2].iter().map(|v| v.abs()).collect();
    let tilt: Vec<f64> =
        rows.clone().map(|row| log.roll_rad[row].hypot(log.pitch_rad[row]).to_degrees()).collect();
    let yaw_turned_deg = smooth_way(&log.t_s[rows.clone()], &log.yaw_rad[rows.clone()]).to_degrees();
    let voltage_v = log.vbat_v.as_ref().map(|v| [v[rows.start], v[rows.end - 1]]);
    Some(Motion {
        height_m: [0.01, HIGH].map(|share| quantile(&pos_m[2], share).unwrap_or(0.0) - rest_m),
        speed_mps: quantile(&speed, HIGH).unwrap_or(0.0),
        climb_mps: quantile(&climb, HIGH).unwrap_or(0.0),
        tilt_deg: quantile(&tilt, HIGH).unwrap_or(0.0),
        yaw_turned_deg,
        voltage_v,
    })
}

/// Slopes over about 0.2 s.
fn slopes(t_s: &[f64], x: &[f64]) -> Vec<f64> {
    let reach = (0.1 / usual_step(t_s).max(1e-3)).ceil().clamp(1.0, 200.0) as usize;
    let between = |i: usize| {
        let (a, b) = (i.saturating_sub(reach), (i + reach).min(x.len() - 1));
        let step_s = t_s[b] - t_s[a];
        if step_s > 0.0 { (x[b] - x[a]) / step_s } else { 0.0 }
    };
    (0..x.len()).map(between).collect()
}

/// The way of an angle back and forth, in steps of half a second, so that noise does not add up.
fn smooth_way(t_s: &[f64], angle_rad: &[f64]) -> f64 {
    let mut way = 0.0;
    let Some((mut last_s, mut last)) = t_s.first().copied().zip(angle_rad.first().copied()) else {
        return 0.0;
    };
    for (t, angle) in t_s.iter().zip(angle_rad) {
        if t - last_s >= 0.5 {
            way += (angle - last).abs();
            (last_s, last) = (*t, *angle);
        }
    }
    way
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bandwidth_of_a_sine_is_its_frequency() {
        let t: Vec<f64> = (0..2000).map(|i| f64::from(i) * 0.01).collect();
        let sine: Vec<f64> = t.iter().map(|t| 3.0 + (std::f64::consts::TAU * 1.5 * t).sin()).collect();
        assert!((bandwidth_hz(&t, &sine).unwrap() - 1.5).abs() < 0.1);
        assert_eq!(bandwidth_hz(&t, &vec![3.0; 2000]), None);
    }
}
