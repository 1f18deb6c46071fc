//! Torques and drag from one row to the next, before any prediction: noise on the rotor speeds must not pass for
//! a weak torque, nor a weak torque for drag.
//!
//! The turn follows dw/dt = authority u - damping w, with the lagged rotors u. Noise is in all three, so its size
//! is taken from third differences and the equation is solved by total least squares. The drag is the specific
//! force across the measured attitude, over the velocity there: rotors have no part in it.

use crazyflie_env::motors::MOTORS;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::flight::{MotorFlight, STEP_S};
use super::model::{G_MPS2, PARAMETERS, attitude, into_body};
use crate::estimate::robust_sd;
use crate::fit::solve::Prior;

/// Rows to either side of a derivative, and of the means beside it.
const HALF: usize = 2;
/// Rows to either side for the specific force: velocities differ by more noise.
const FORCE_HALF: usize = 4;
/// Rotors are looked for so many rows early or late. Real logs need -2 to +3.
const MOST_SHIFT: isize = 6;
/// A shift counts if it lowers the logarithm of what is left by this much, a twentieth.
const LEAST_GAIN: f64 = 0.05;
/// Motor lags that are tried: every 5 ms.
const LAG_STEP_S: f64 = 0.005;
const LAGS: usize = 25;
/// Largest residual of an equation, in variances of the noise. Synthetic flights leave 1.0 to 3.3; NanoBench's
/// interpolated motors leave 40 to 700, which noise does not explain.
const MOST_LEFT: f64 = 4.0;
/// A flight is cut into so many blocks, each with a trim of its own; one after the other is left out for the
/// standard errors.
const BLOCKS: usize = 4;
/// Sign of the torque of motors 1 to 4 about each axis.
pub(super) fn mix() -> [[f64; 4]; 3] {
    let of = |sign: fn([f64; 2]) -> f64| MOTORS.map(sign);
    [of(|[_, left]| left), of(|[front, _]| -front), of(|[front, left]| front * left)]
}

/// Sums of products of derivative, torque and rate, and of their noise.
#[derive(Clone, Copy)]
struct Moments {
    signals: Matrix3<f64>,
    noise: Vector3<f64>,
}

/// A turn's equation, solved.
struct Torque {
    authority_radps2: f64,
    damping_ps: f64,
    /// Variance that is left, in variances of the noise.
    left: f64,
}

impl Moments {
    fn plus(&self, other: &Self, sign: f64) -> Self {
        Moments { signals: self.signals + sign * other.signals, noise: self.noise + sign * other.noise }
    }

    /// Solves total least squares: the direction in which the signals have the least beyond their noise.
    fn solve(&self) -> Torque {
        let by = self.noise.map(|n| 1.0 / n.max(f64::MIN_POSITIVE).sqrt());
        let eigen = SymmetricEigen::new(Matrix3::from_fn(|i, j| self.signals[(i, j)] * by[i] * by[j]));
        let least = eigen.eigenvalues.imin();
        let v = eigen.eigenvectors.column(least).component_mul(&by);
        let left = eigen.eigenvalues[least];
        Torque { authority_radps2: -v[1] / v[0], damping_ps: v[2] / v[0], left }
    }
}

/// The rotors of a flight about one axis, as parts of the median speed squared, behind a lag.
fn lagged_torque(flight: &MotorFlight, axis: usize, median_speed: f64, lag_s: f64) -> (Vec<f64>, f64) {
    let signs = mix()[axis];
    let torque = |w: &[f64; 4]| (0..4).map(|m| 0.25 * signs[m] * (w[m] / median_speed).powi(2)).sum();
    let commanded: Vec<f64> = flight.speeds.iter().map(torque).collect();
    (lagged(&commanded, STEP_S / lag_s), white_variance(&commanded))
}

/// A signal behind a lag of first order, of which a step is this share.
pub(super) fn lagged(commanded: &[f64], step: f64) -> Vec<f64> {
    let mut state = commanded.first().copied().unwrap_or(0.0);
    let follow = 1.0 - (-step).exp();
    let step = |u: &f64| {
        let next = state + follow * (u - state);
        std::mem::replace(&mut state, next)
    };
    commanded.iter().map(step).collect()
}

/// Variance of the white noise of a signal that is smooth otherwise, by the median of its third differences: the
/// squares of 1, 3, 3 and 1 are 20 together, the median of |normal| is 0.6745 standard deviations.
fn white_variance(signal: &[f64]) -> f64 {
    robust_sd(signal.windows(4).map(|s| s[3] - 3.0 * (s[2] - s[1]) - s[0])).powi(2) / 20.0
}

/// The mean over the rows around one, ends by half.
pub(super) fn local_mean(signal: &[f64], row: usize, half: usize) -> f64 {
    let ends = 0.5 * (signal[row - half] + signal[row + half]);
    (signal[row - half + 1..row + half].iter().sum::<f64>() + ends) / (2 * half) as f64
}

/// Rows of the blocks of a flight whose rotors are shifted.
fn blocks(rows: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    let (first, last) = (HALF + MOST_SHIFT as usize, rows.saturating_sub(HALF + MOST_SHIFT as usize));
    let edge = move |block: usize| first + block * last.saturating_sub(first) / BLOCKS;
    (0..BLOCKS).map(move |block| edge(block)..edge(block + 1))
}

/// The moments of each block, with the rotors so many rows later.
fn moments(
    flight: &MotorFlight,
    axis: usize,
    (torque, torque_variance): &(Vec<f64>, f64),
    lag_s: f64,
    later: isize,
) -> Vec<Moments> {
    let rate: Vec<f64> = flight.motion.iter().map(|row| row[9 + axis]).collect();
    let span_s = 2.0 * HALF as f64 * STEP_S;
    let noise = noise_share(lag_s);
    let rate_variance = white_variance(&rate);
    let each = Vector3::new(2.0 / (span_s * span_s), 0.0, noise[1]) * rate_variance
        + Vector3::new(0.0, noise[0], 0.0) * *torque_variance;
    let of_block = |rows: std::ops::Range<usize>| {
        let signals = |row: usize| {
            let turn = (rate[row + HALF] - rate[row - HALF]) / span_s;
            let torque = local_mean(torque, row.saturating_add_signed(-later), HALF);
            Vector3::new(turn, torque, local_mean(&rate, row, HALF))
        };
        let count = rows.len() as f64;
        let mean = rows.clone().map(signals).sum::<Vector3<f64>>() / count.max(1.0);
        let product = |row| (signals(row) - mean) * (signals(row) - mean).transpose();
        Moments { signals: rows.map(product).sum(), noise: each * count }
    };
    blocks(flight.motion.len()).map(of_block).collect()
}

/// Shares of a white variance that lag and mean leave, and that the mean alone leaves.
fn noise_share(lag_s: f64) -> [f64; 2] {
    let follow = 1.0 - (-STEP_S / lag_s).exp();
    let answer = |lag: bool| -> f64 {
        let impulse = |k: usize| match lag {
            true if k > 0 => follow * (1.0 - follow).powi(k as i32 - 1),
            false if k == 0 => 1.0,
            _ => 0.0,
        };
        // the length covers the slowest lag
        let response: Vec<_> = (0..80).map(|k: usize| k.checked_sub(2 * HALF).map_or(0.0, impulse)).collect();
        (HALF..response.len() - HALF).map(|row| local_mean(&response, row, HALF).powi(2)).sum()
    };
    [answer(true), answer(false)]
}

/// Logarithm of what roll and pitch of a flight leave.
fn log_left(flight: &MotorFlight, median_speed: f64, lag_s: f64) -> Vec<(isize, f64)> {
    let torques = [0, 1].map(|axis| lagged_torque(flight, axis, median_speed, lag_s));
    let left = |axis: usize, later: isize| {
        let all = moments(flight, axis, &torques[axis], lag_s, later);
        all.into_iter().reduce(|a, b| a.plus(&b, 1.0)).map_or(f64::NAN, |sum| sum.solve().left.ln())
    };
    (-MOST_SHIFT..=MOST_SHIFT).map(|later| (later, left(0, later) + left(1, later))).collect()
}

/// Computes by how many rows the rotors of each flight must be shifted to fit its gyro best. The clocks of rotors and
/// gyro differ from log to log.
fn shifts(flights: &[MotorFlight], median_speed: f64, lag_s: f64) -> (Vec<isize>, f64) {
    let best = |flight: &MotorFlight| {
        let all = log_left(flight, median_speed, lag_s);
        let here = all[MOST_SHIFT as usize];
        let best = all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or(here);
        if best.1 < here.1 - LEAST_GAIN { best } else { here }
    };
    let all: Vec<(isize, f64)> = flights.iter().map(best).collect();
    (all.iter().map(|(later, _)| *later).collect(), all.iter().map(|(_, left)| left).sum())
}

/// Aligns the rotors of each flight to its gyro and returns the motor lag by which they fit best; `lag_s` is
/// that of other flights.
pub fn align(flights: &mut [MotorFlight], median_speed: f64, lag_s: Option<f64>) -> f64 {
    let candidates: Vec<f64> =
        lag_s.map_or_else(|| (1..=LAGS).map(|i| i as f64 * LAG_STEP_S).collect(), |lag_s| vec![lag_s]);
    let judged = candidates.iter().map(|lag_s| (*lag_s, shifts(flights, median_speed, *lag_s)));
    let best = judged.min_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
    let Some((lag_s, (later, _))) = best else { return LAG_STEP_S };
    flights.iter_mut().zip(later).for_each(|(flight, later)| flight.delay_rotors(later));
    lag_s
}

/// Returns the parameters that rows determine without a prediction, by their places in the form, of aligned flights.
pub(super) fn known(flights: &[MotorFlight], median_speed: f64, lag_s: f64) -> [Option<Prior>; PARAMETERS] {
    let mut known = [None; PARAMETERS];
    for axis in 0..3 {
        let of_flight = |flight: &MotorFlight| {
            moments(flight, axis, &lagged_torque(flight, axis, median_speed, lag_s), lag_s, 0)
        };
        let all: Vec<Moments> = flights.iter().flat_map(of_flight).collect();
        let Some(sum) = all.iter().copied().reduce(|a, b| a.plus(&b, 1.0)) else { continue };
        let torque = sum.solve();
        if torque.left < MOST_LEFT && torque.authority_radps2 > 0.0 && torque.damping_ps >= 0.0 {
            let without: Vec<Torque> = all.iter().map(|block| sum.plus(block, -1.0).solve()).collect();
            let error = |of: fn(&Torque) -> f64| jackknife(&without.iter().map(of).collect::<Vec<_>>());
            let sd = error(|t| t.authority_radps2);
            known[2 + axis] = Some(Prior { mean: torque.authority_radps2, sd });
            known[8 + axis] = Some(Prior { mean: torque.damping_ps, sd: error(|t| t.damping_ps) });
            known[1] = Some(Prior { mean: lag_s, sd: 0.5 * LAG_STEP_S });
        }
    }
    for axis in 0..2 {
        let all: Vec<[f64; 2]> = flights.iter().flat_map(|flight| drag_moments(flight, axis)).collect();
        let sum = all.iter().fold([0.0; 2], |sum, block| [sum[0] + block[0], sum[1] + block[1]]);
        let without: Vec<f64> = all.iter().map(|b| (sum[0] - b[0]) / (sum[1] - b[1])).collect();
        let (mean, sd) = (sum[0] / sum[1], jackknife(&without));
        if mean > 0.0 && sd > 0.0 {
            known[5 + axis] = Some(Prior { mean, sd });
        }
    }
    known
}

/// Force against velocity and velocity squared along a body axis, summed over each block.
fn drag_moments(flight: &MotorFlight, axis: usize) -> Vec<[f64; 2]> {
    let span_s = 2.0 * FORCE_HALF as f64 * STEP_S;
    let column = |i: usize| flight.motion.iter().map(move |row| row[i]).collect::<Vec<f64>>();
    let turns: Vec<[[f64; 3]; 3]> = flight.motion.iter().map(|row| attitude(row).rotation()).collect();
    // gravity as the body sees it, a mean over the same time as the acceleration
    let gravity: Vec<f64> = turns.iter().map(|turn| into_body(turn, [0.0, 0.0, G_MPS2])[axis]).collect();
    let velocity: Vec<f64> =
        flight.motion.iter().zip(&turns).map(|(x, turn)| into_body(turn, [x[3], x[4], x[5]])[axis]).collect();
    let world = [3, 4, 5].map(column);
    let signals = |row: usize| {
        let acc = world.each_ref().map(|v| (v[row + FORCE_HALF] - v[row - FORCE_HALF]) / span_s);
        let force = into_body(&turns[row], acc)[axis] + local_mean(&gravity, row, FORCE_HALF);
        [force, local_mean(&velocity, row, FORCE_HALF)]
    };
    let of_block = |rows: std::ops::Range<usize>| {
        let all: Vec<[f64; 2]> = rows.map(signals).collect();
        let mean = |i: usize| all.iter().map(|s| s[i]).sum::<f64>() / all.len().max(1) as f64;
        let [force, along] = [mean(0), mean(1)];
        all.iter().fold([0.0; 2], |sum, s| {
            let v = s[1] - along;
            [sum[0] - (s[0] - force) * v, sum[1] + v * v]
        })
    };
    blocks(flight.motion.len()).map(of_block).collect()
}

/// Standard error of an estimate by the estimates without each block.
pub(super) fn jackknife(without: &[f64]) -> f64 {
    let n = without.len() as f64;
    let mean = without.iter().sum::<f64>() / n;
    (without.iter().map(|v| (v - mean).powi(2)).sum::<f64>() * (n - 1.0) / n).sqrt()
}
