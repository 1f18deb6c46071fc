//! The measured side of a replay: signals with their times, and the full state at any time, derivatives
//! included.

use std::ops::Range;

use crazyflie_env::plant::State;

use crate::{Error, FlightLog, Result};

/// Position fixes arrive at 30 Hz: a cubic over +-0.2 s has 13 of them.
const POSITION_WINDOW_S: f64 = 0.2;
/// Attitude arrives at 50 to 100 Hz and moves as fast as the identified pole of 29 1/s.
const ATTITUDE_WINDOW_S: f64 = 0.06;
/// Shorter than this there is nothing to see of a slow pole of 2.8 1/s.
const SHORTEST_S: f64 = 0.5;

/// Values at increasing times.
#[derive(Debug, Clone, Default)]
pub(crate) struct Track {
    pub(crate) t_s: Vec<f64>,
    pub(crate) values: Vec<f64>,
}

impl Track {
    fn new(t_s: &[f64], values: &[f64]) -> Self {
        Track { t_s: t_s.to_vec(), values: values.to_vec() }
    }

    /// The samples after `after_s` up to and including `to_s`.
    pub(crate) fn between(&self, after_s: f64, to_s: f64) -> Range<usize> {
        let start = self.t_s.partition_point(|t| *t <= after_s);
        start..self.t_s.partition_point(|t| *t <= to_s).max(start)
    }

    /// Interpolates linearly, constant beyond the ends.
    fn value_at(&self, t_s: f64) -> f64 {
        interpolate(&self.t_s, &self.values, t_s)
    }

    /// Value and slope at a time of the cubic that fits the samples within `half_s` best.
    fn local(&self, t_s: f64, half_s: f64) -> (f64, f64) {
        let mut near = self.between(t_s - half_s, t_s + half_s);
        // over a gap, the nearest samples on both sides
        while near.len() < 5 && near.len() < self.t_s.len() {
            near = near.start.saturating_sub(1)..(near.end + 1).min(self.t_s.len());
        }
        let shifted: Vec<f64> = self.t_s[near.clone()].iter().map(|t| t - t_s).collect();
        cubic_at_zero(&shifted, &self.values[near])
    }

    fn derivative(&self, half_s: f64) -> Self {
        let values = self.t_s.iter().map(|t| self.local(*t, half_s).1).collect();
        Track { t_s: self.t_s.clone(), values }
    }
}

/// Interpolates linearly, constant beyond the ends.
pub(crate) fn interpolate(times_s: &[f64], values: &[f64], t_s: f64) -> f64 {
    let after = times_s.partition_point(|t| *t <= t_s).clamp(1, times_s.len().max(2) - 1);
    let (Some(t1), Some(v1)) = (times_s.get(after), values.get(after)) else {
        return values.first().copied().unwrap_or(0.0);
    };
    let (t0, v0) = (times_s[after - 1], values[after - 1]);
    v0 + ((t_s - t0) / (t1 - t0)).clamp(0.0, 1.0) * (v1 - v0)
}

/// Value and slope at x = 0 of the least-squares cubic, in polynomials that are orthogonal on the samples
/// (Forsythe 1957).
fn cubic_at_zero(x: &[f64], y: &[f64]) -> (f64, f64) {
    let sum = |term: &dyn Fn(usize) -> f64| (0..x.len()).map(term).sum::<f64>();
    let (mut old, mut p) = (vec![0.0; x.len()], vec![1.0; x.len()]);
    // the same polynomials and their slopes at zero
    let ([mut old0, mut p0], [mut old1, mut p1]) = ([0.0, 1.0], [0.0, 0.0]);
    let (mut value, mut slope, mut old_norm) = (0.0, 0.0, 1.0);
    for degree in 0..4.min(x.len()) {
        let norm = sum(&|i| p[i] * p[i]);
        let share = sum(&|i| y[i] * p[i]) / norm;
        value += share * p0;
        slope += share * p1;
        let a = sum(&|i| x[i] * p[i] * p[i]) / norm;
        let b = if degree == 0 { 0.0 } else { norm / old_norm };
        let next: Vec<f64> = (0..x.len()).map(|i| (x[i] - a) * p[i] - b * old[i]).collect();
        ((old1, p1), (old0, p0)) = ((p1, p0 - a * p1 - b * old1), (p0, -a * p0 - b * old0));
        (old, p, old_norm) = (p, next, norm);
    }
    (value, slope)
}

/// Measured signals of a flight, on the clock of the log.
pub(crate) struct Measurements {
    attitude: [Track; 3],
    rates: [Track; 3],
    position: [Track; 3],
    velocity: [Track; 3],
    /// Velocity is derived from the position, so single fixes are not trusted for the state either.
    derived: bool,
}

impl Measurements {
    pub(crate) fn from_log(log: &FlightLog, remarks: &mut Vec<String>) -> Result<Self> {
        let attitude = [&log.roll_rad, &log.pitch_rad, &log.yaw_rad].map(|v| Track::new(&log.t_s, v));
        // a gyro on another clock than the attitude does not line up with it: then rates are derivatives of
        // the measured angles
        let rates = match &log.gyro_radps {
            Some(gyro) if !log.provenance.onboard_interpolated => {
                gyro.each_ref().map(|v| Track::new(&log.t_s, v))
            }
            _ => attitude.each_ref().map(|angle| angle.derivative(ATTITUDE_WINDOW_S)),
        };
        let position = position(log)?;
        let truth = log.truth.as_ref().map(|truth| &truth.vel_mps);
        let given = log.vel_mps.as_ref().or(truth);
        let velocity = match given {
            Some(v) => v.each_ref().map(|v| Track::new(&log.t_s, v)),
            None => position.each_ref().map(|p| p.derivative(POSITION_WINDOW_S)),
        };
        if given.is_none() {
            let how = format!("derived from the position by local cubics over +-{POSITION_WINDOW_S} s");
            remarks.push(format!("velocity is not measured: {how}"));
        } else if log.vel_mps.is_none() {
            remarks.push("velocity is not measured: taken from the simulator's truth in the log".to_owned());
        }
        Ok(Measurements { attitude, rates, position, velocity, derived: given.is_none() })
    }

    /// A signal by its place in [`super::SIGNALS`].
    pub(crate) fn track(&self, signal: usize) -> &Track {
        match signal {
            0..3 => &self.attitude[signal],
            3 => &self.position[2],
            4 | 5 => &self.velocity[signal - 4],
            _ => &self.position[signal - 6],
        }
    }

    pub(crate) fn yaw_rate(&self, t_s: f64) -> f64 {
        self.rates[2].value_at(t_s)
    }

    /// The state at a time; the second states of the model's forms are left at zero.
    pub(crate) fn state(&self, t_s: f64) -> State<f64> {
        let position = |track: &Track| {
            if self.derived { track.local(t_s, POSITION_WINDOW_S).0 } else { track.value_at(t_s) }
        };
        State {
            pos_m: self.position.each_ref().map(position),
            vel_mps: self.velocity.each_ref().map(|v| v.value_at(t_s)),
            att_rad: self.attitude.each_ref().map(|v| v.value_at(t_s)),
            rate_radps: self.rates.each_ref().map(|v| v.value_at(t_s)),
            aux: [0.0; 2],
        }
    }

    /// Returns the start of the replay and its number of ticks: the flight, without the part before it that the
    /// windows of derivatives need.
    pub(crate) fn interval(&self, log: &FlightLog, tick_s: f64) -> Result<(f64, usize)> {
        if log.airborne.is_empty() {
            return Error::logs("the vehicle never flies in this log");
        }
        let (first_s, last_s) = (log.t_s[log.airborne.start], log.t_s[log.airborne.end - 1]);
        let fixed_s = self.position[0].t_s.first().copied().unwrap_or(first_s);
        let need_s = fixed_s + if self.derived { POSITION_WINDOW_S } else { 0.0 };
        let start_s = first_s.max(need_s);
        let end_s = last_s.min(self.position[0].t_s.last().copied().unwrap_or(last_s));
        if end_s - start_s < SHORTEST_S {
            let seconds = (end_s - start_s).max(0.0);
            return Error::logs(format!(
                "the flight lasts only {seconds:.2} s, expected at least {SHORTEST_S} s"
            ));
        }
        Ok((start_s, ((end_s - start_s) / tick_s + 1e-6) as usize))
    }
}

/// Returns the position fixes in order of capture. If several were captured at one time, the first that arrived
/// counts.
fn position(log: &FlightLog) -> Result<[Track; 3]> {
    let capture = &log.fixes.capture_t_s;
    let mut order: Vec<usize> = (0..capture.len()).collect();
    order.sort_by(|a, b| capture[*a].total_cmp(&capture[*b]));
    order.dedup_by(|later, earlier| capture[*later] == capture[*earlier]);
    if order.len() < 5 {
        return Error::logs("the log holds no position measurement to compare with");
    }
    let pick = |values: &Vec<f64>| order.iter().map(|i| values[*i]).collect::<Vec<_>>();
    let t_s = pick(capture);
    Ok(log.fixes.pos_m.each_ref().map(|v| Track { t_s: t_s.clone(), values: pick(v) }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_fitted_exactly() {
        let x = [-0.2, -0.13, -0.02, 0.05, 0.11, 0.2];
        let y = x.map(|x: f64| 3.0 - 2.0 * x + 5.0 * x * x - 7.0 * x * x * x);
        let (value, slope) = cubic_at_zero(&x, &y);
        assert!((value - 3.0).abs() < 1e-12 && (slope + 2.0).abs() < 1e-11, "{value} {slope}");
        assert_eq!(cubic_at_zero(&[0.3], &[4.0]), (4.0, 0.0));
    }

    #[test]
    fn tracks_interpolate_and_hold() {
        let track = Track::new(&[0.0, 1.0, 3.0], &[0.0, 2.0, -2.0]);
        assert_eq!([-1.0, 0.5, 2.0, 9.0].map(|t| track.value_at(t)), [0.0, 1.0, 0.0, -2.0]);
        assert_eq!(track.between(0.0, 1.0), 1..2);
        assert_eq!(Track::new(&[1.0], &[5.0]).value_at(3.0), 5.0);
    }
}
