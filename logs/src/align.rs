//! Signals that were recorded on different clocks, brought to one.
//!
//! The thesis starts both signals at their first message and repeats the last command for every sample of the IMU
//! (6.3.3, Annex 3). Here commands are kept in the same way, but time stamps are compared message by message. If they
//! are unusable, the camera's delay is measured by correlating the camera's motion with the gyro's.

use super::attitude::Rotation;
use super::series::{Interpolation, value_at};
use super::signal::unwrap;
use super::{AttitudeSource, FlightLog, G_MPS2};
use crazyflie_statistics::quantile;

/// Transport within one computer and over radio or USB takes no longer; a larger difference is another clock.
const LONGEST_TRANSPORT_S: f64 = 0.25;
/// Stamps in the future by rounding are still the same clock.
const ROUNDING_S: f64 = 0.002;
/// Queues only ever add to the transport time, so the fastest messages show the clocks; of outliers, not the
/// very fastest.
const FASTEST_SHARE: f64 = 0.05;
/// Drift is the slope of the fastest message of so many parts.
const DRIFT_PARTS: usize = 10;
/// A flight shorter than this shows no drift: 100 ppm of it is 1 ms.
const SHORTEST_DRIFT_S: f64 = 10.0;

/// Offset between the clock that stamped a topic's messages and the recorder's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ClockOffset {
    /// Add this to a stamp for the recorder's time of the same moment: 0 where both are one clock, else the
    /// difference that the fastest messages show, transport included.
    pub(super) offset_s: f64,
    /// True if the stamps are of the recorder's clock.
    pub(super) same: bool,
    /// From stamp to record: median, and 5 to 95 % of the messages, less `offset_s`.
    pub(super) transport_s: f64,
    pub(super) spread_s: f64,
    /// Drift between the clocks, parts per million; not corrected.
    pub(super) drift_ppm: Option<f64>,
}

/// Compares the stamps of messages with the times at which they were recorded.
pub(super) fn clock_offset(stamped_s: &[f64], recorded_s: &[f64]) -> ClockOffset {
    let late: Vec<f64> =
        recorded_s.iter().zip(stamped_s).map(|(recorded, stamped)| recorded - stamped).collect();
    let fastest = quantile(&late, FASTEST_SHARE).unwrap_or(0.0);
    let same = (-ROUNDING_S..=LONGEST_TRANSPORT_S).contains(&fastest);
    let offset_s = if same { 0.0 } else { fastest };
    ClockOffset {
        offset_s,
        same,
        transport_s: quantile(&late, 0.5).unwrap_or(0.0) - offset_s,
        spread_s: quantile(&late, 1.0 - FASTEST_SHARE).unwrap_or(0.0) - fastest,
        drift_ppm: drift_ppm(recorded_s, &late),
    }
}

/// Slope through the fastest messages of equal parts of the recording, by the median over pairs of parts.
pub(super) fn drift_ppm(recorded_s: &[f64], late_s: &[f64]) -> Option<f64> {
    let part = recorded_s.len() / DRIFT_PARTS;
    let (first, last) = (recorded_s.first()?, recorded_s.last()?);
    if part < 5 || last - first < SHORTEST_DRIFT_S {
        return None;
    }
    let fastest = |rows: &[f64]| rows.iter().copied().fold(f64::INFINITY, f64::min);
    let times: Vec<f64> =
        recorded_s.chunks_exact(part).map(|part| quantile(part, 0.5).unwrap_or(0.0)).collect();
    let lates: Vec<f64> = late_s.chunks_exact(part).map(fastest).collect();
    let pairs = (0..times.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let slopes: Vec<f64> =
        pairs.map(|(a, b)| (lates[a] - lates[b]) / (times[a] - times[b])).filter(|s| s.is_finite()).collect();
    (!slopes.is_empty()).then(|| quantile(&slopes, 0.5).unwrap_or(0.0) * 1e6)
}

/// Returns, for each of `rows_s`, the index of the last of `t_s` that is not later: a held input. `None` before the
/// first.
pub(super) fn last_index_before(t_s: &[f64], rows_s: &[f64]) -> Vec<Option<usize>> {
    rows_s.iter().map(|row| t_s.partition_point(|t| t <= row).checked_sub(1)).collect()
}

/// Values at increasing times.
#[derive(Debug, Clone, Copy)]
pub(super) struct Track<'a> {
    pub(super) t_s: &'a [f64],
    pub(super) values: &'a [f64],
}

impl Track<'_> {
    /// Interpolates linearly, constant beyond the ends; 0 without samples.
    pub(super) fn value_at(&self, t_s: f64) -> f64 {
        value_at(self.t_s, self.values, t_s, Interpolation::Line, None)
    }
}

/// The same motion as seen from outside and felt on board.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionPair<'a> {
    pub(super) seen: Track<'a>,
    pub(super) felt: Track<'a>,
    /// Order of the differences that are compared: slope (1) or curvature (2). Offsets or straight drifts
    /// fall out.
    pub(super) differences: usize,
    pub(super) name: &'static str,
}

/// Delay of the seen signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lag {
    pub(super) lag_s: f64,
    /// Standard error, from the scatter between parts of the flight.
    pub(super) sigma_s: f64,
    pub(super) correlation: f64,
    /// The compared motion.
    pub(super) by: &'static str,
}

const GRID_S: f64 = 0.01;
/// Camera pipelines take 30 to 150 ms.
const REACH: usize = 40;
/// Differences over +-0.3 s: the marker's noise of some millimetres against accelerations of 1 m/s2.
const HALF_WIDTH: usize = 30;
/// Long enough for a manoeuvre, short enough to have several.
const PART_S: f64 = 6.0;
const LEAST_CORRELATION: f64 = 0.5;
const LEAST_PARTS: usize = 3;

/// Estimates the lag between the sides of the pair with the clearest answer, `None` if none moves enough.
pub(super) fn lag(pairs: &[MotionPair<'_>]) -> Option<Lag> {
    let lags = pairs.iter().filter_map(pair_lag);
    lags.max_by(|a, b| b.sigma_s.total_cmp(&a.sigma_s))
}

fn pair_lag(pair: &MotionPair<'_>) -> Option<Lag> {
    let (seen, felt) = (differences(pair.seen, pair)?, differences(pair.felt, pair)?);
    let part = (PART_S / GRID_S) as usize;
    let mut lags = Vec::new();
    let mut best = Vec::new();
    let mut start = REACH;
    while start + part + REACH <= seen.len() {
        let rows = start..start + part;
        // lag L: what is felt at t is seen at t + L
        let correlation_at = |shift: usize| {
            correlation(&seen[rows.start + shift - REACH..rows.end + shift - REACH], &felt[rows.clone()])
        };
        let by_lag: Vec<f64> = (0..=2 * REACH).map(correlation_at).collect();
        if let Some((at, top)) = peak(&by_lag, LEAST_CORRELATION) {
            lags.push((at - REACH as f64) * GRID_S);
            best.push(top);
        }
        start += part;
    }
    if lags.len() < LEAST_PARTS {
        return None;
    }
    let lag_s = quantile(&lags, 0.5).unwrap_or(0.0);
    let off: Vec<f64> = lags.iter().map(|lag| (lag - lag_s).abs()).collect();
    // Median deviation to standard deviation, then to the error of a median; no better than a tenth of the
    // grid.
    let sigma_s =
        (1.4826 * 1.2533 * quantile(&off, 0.5).unwrap_or(0.0) / (lags.len() as f64).sqrt()).max(0.1 * GRID_S);
    Some(Lag { lag_s, sigma_s, correlation: quantile(&best, 0.5).unwrap_or(0.0), by: pair.name })
}

/// Slope or curvature over a wide step on a common grid. The same operation on both sides shifts neither.
fn differences(track: Track<'_>, pair: &MotionPair<'_>) -> Option<Vec<f64>> {
    let from_s = pair.seen.t_s.first()?.max(*pair.felt.t_s.first()?);
    let to_s = pair.seen.t_s.last()?.min(*pair.felt.t_s.last()?);
    // A flight of more than three hours is no flight.
    let count = ((to_s - from_s) / GRID_S).min(1e6) as usize;
    let on_grid: Vec<f64> = (0..count).map(|i| track.value_at(from_s + i as f64 * GRID_S)).collect();
    let wide = on_grid.windows(2 * HALF_WIDTH + 1);
    let last = 2 * HALF_WIDTH;
    Some(match pair.differences {
        1 => wide.map(|w| w[last] - w[0]).collect(),
        _ => wide.map(|w| w[last] - 2.0 * w[HALF_WIDTH] + w[0]).collect(),
    })
}

/// Place and height of the highest value, refined by a parabola; `None` if it lies at an end or below
/// `least`.
pub(super) fn peak(by_lag: &[f64], least: f64) -> Option<(f64, f64)> {
    let peak = (1..by_lag.len().checked_sub(1)?).max_by(|a, b| by_lag[*a].total_cmp(&by_lag[*b]))?;
    let [before, top, after] = [by_lag[peak - 1], by_lag[peak], by_lag[peak + 1]];
    if top < least || before > top || after > top {
        return None;
    }
    let curvature = before - 2.0 * top + after;
    let refine = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    Some((peak as f64 + refine, top))
}

/// Pearson correlation, 0 when either side is constant.
pub(super) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / count, b.iter().sum::<f64>() / count);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        ab += (x - mean_a) * (y - mean_b);
        aa += (x - mean_a).powi(2);
        bb += (y - mean_b).powi(2);
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// The double integral of samples, by the trapezoidal rule.
pub(super) fn integrate_twice(t_s: &[f64], values: &[f64]) -> Vec<f64> {
    let (mut once, mut twice) = (0.0, 0.0);
    let mut out = vec![0.0; values.len().min(1)];
    for (t, v) in t_s.windows(2).zip(values.windows(2)) {
        let step_s = t[1] - t[0];
        twice += once * step_s + step_s * step_s * (2.0 * v[0] + v[1]) / 6.0;
        once += 0.5 * (v[0] + v[1]) * step_s;
        out.push(twice);
    }
    out
}

impl FlightLog {
    /// Estimates the delay of the fixes against the attitude, by the motion that both show. `None` if the attitude is
    /// no measurement.
    pub(super) fn position_lag(&self) -> Option<Lag> {
        let fixes = &self.fixes;
        let is_ordered = fixes.capture_t_s.windows(2).all(|pair| pair[0] < pair[1]);
        if self.provenance.attitude == AttitudeSource::Motion || fixes.row.is_empty() || !is_ordered {
            return None;
        }
        self.lag_of_positions(&fixes.capture_t_s, &fixes.pos_m, fixes.yaw_rad.as_deref())
    }

    /// Estimates the delay of roll and pitch against their commands.
    pub(super) fn command_lag(&self) -> Option<Lag> {
        let rows = self.airborne.clone();
        let measured = self.provenance.attitude != AttitudeSource::Motion;
        let pairs = [
            (self.cmd_roll_rad.as_ref(), &self.roll_rad, "roll and its command"),
            (self.cmd_pitch_rad.as_ref(), &self.pitch_rad, "pitch and its command"),
        ];
        let pairs = pairs.into_iter().filter(|_| measured).filter_map(|(command, angle, name)| {
            let [seen, felt] = [angle, command?]
                .map(|values| Track { t_s: &self.t_s[rows.clone()], values: &values[rows.clone()] });
            Some(MotionPair { seen, felt, differences: 1, name })
        });
        lag(&pairs.collect::<Vec<_>>())
    }

    /// Estimates the delay of positions against the attitude: acceleration by tilt in x and y, and yaw.
    pub(super) fn lag_of_positions(
        &self,
        seen_s: &[f64],
        pos_m: &[Vec<f64>; 3],
        yaw_rad: Option<&[f64]>,
    ) -> Option<Lag> {
        let up = |row: usize| {
            Rotation::from_angles([self.roll_rad[row], self.pitch_rad[row], self.yaw_rad[row]])
                .turn([0.0, 0.0, 1.0])
        };
        // A thrust that carries the weight; beyond 80 degrees of tilt nothing is known.
        let push = |axis: usize| {
            (0..self.len()).map(up).map(|up| G_MPS2 * up[axis] / up[2].max(0.2)).collect::<Vec<f64>>()
        };
        let felt = [0, 1].map(|axis| integrate_twice(&self.t_s, &push(axis)));
        let track = |values| Track { t_s: &self.t_s, values };
        let seen = |values| Track { t_s: seen_s, values };
        let yaw = yaw_rad.map(|yaw| {
            let mut yaw = yaw.to_vec();
            unwrap(&mut yaw, "marker yaw", &mut Vec::new());
            yaw
        });
        let mut pairs = vec![
            MotionPair { seen: seen(&pos_m[0]), felt: track(&felt[0]), differences: 2, name: "x and tilt" },
            MotionPair { seen: seen(&pos_m[1]), felt: track(&felt[1]), differences: 2, name: "y and tilt" },
        ];
        let felt_yaw = track(&self.yaw_rad);
        let of_yaw = |yaw| MotionPair { seen: seen(yaw), felt: felt_yaw, differences: 1, name: "yaw" };
        pairs.extend(yaw.as_deref().map(of_yaw));
        lag(&pairs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise without a generator, -0.5 to 0.5.
    fn noise(i: usize) -> f64 {
        (i as f64 * 0.754_877_666).fract() - 0.5
    }

    fn position(t: f64) -> f64 {
        0.5 * (1.1 * t).sin() + 0.2 * (2.7 * t + 1.0).sin()
    }

    fn acceleration(t: f64) -> f64 {
        -0.5 * 1.21 * (1.1 * t).sin() - 0.2 * 7.29 * (2.7 * t + 1.0).sin()
    }

    #[test]
    fn the_delay_of_a_noisy_camera_is_found() {
        let frames: Vec<f64> = (0..1200).map(|i| i as f64 / 30.0).collect();
        let seen: Vec<f64> =
            frames.iter().enumerate().map(|(i, t)| position(t - 0.083) + 0.01 * noise(i)).collect();
        let imu: Vec<f64> = (0..4000).map(|i| i as f64 * 0.01).collect();
        let felt: Vec<f64> = imu.iter().map(|t| acceleration(*t) + 0.05).collect();
        let felt = integrate_twice(&imu, &felt);
        let [seen, felt] = [Track { t_s: &frames, values: &seen }, Track { t_s: &imu, values: &felt }];
        let estimate = lag(&[MotionPair { seen, felt, differences: 2, name: "x" }]).unwrap();
        assert!((estimate.lag_s - 0.083).abs() < 4e-3 && estimate.sigma_s < 5e-3, "{estimate:?}");
    }

    #[test]
    fn stillness_has_no_lag() {
        let t: Vec<f64> = (0..4000).map(|i| i as f64 * 0.01).collect();
        let zero = vec![0.0; 4000];
        let still = Track { t_s: &t, values: &zero };
        assert_eq!(lag(&[MotionPair { seen: still, felt: still, differences: 1, name: "yaw" }]), None);
        assert_eq!(lag(&[]), None);
    }

    #[test]
    fn a_clock_since_boot_is_told_from_a_slow_transport() {
        let recorded: Vec<f64> = (0..6000).map(|i| i as f64 * 0.01).collect();
        let queue = |i: usize| 0.004 * (noise(i) + 0.5).powi(2);
        let stamped: Vec<f64> =
            recorded.iter().enumerate().map(|(i, t)| t * (1.0 - 50e-6) - 1234.5 - queue(i)).collect();
        let clock = clock_offset(&stamped, &recorded);
        assert!(!clock.same && (clock.offset_s - 1234.5).abs() < 2e-3, "{clock:?}");
        assert!((clock.drift_ppm.unwrap() - 50.0).abs() < 10.0, "{clock:?}");
        let stamped: Vec<f64> = recorded.iter().enumerate().map(|(i, t)| t - 0.05 - queue(i)).collect();
        let clock = clock_offset(&stamped, &recorded);
        assert!(clock.same && clock.offset_s == 0.0 && (clock.transport_s - 0.051).abs() < 2e-3, "{clock:?}");
    }

    #[test]
    fn inputs_hold_until_the_next() {
        assert_eq!(
            last_index_before(&[1.0, 2.0], &[0.5, 1.0, 1.9, 2.0, 9.0]),
            [None, Some(0), Some(0), Some(1), Some(1)]
        );
    }
}
