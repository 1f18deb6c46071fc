//! Estimates the vehicle's position from camera and IMU: a Kalman filter that accounts for the age of a fix.
//!
//! The filter's state is that at the capture of the last frame that it took in. A new fix moves it on to its own
//! capture, along the accelerations that the IMU has shown since, and corrects it there; where the vehicle is now
//! follows along the rest. So a fix that arrives 50 ms late is compared with the position at that time, with no error
//! from the delay (out-of-sequence measurements by re-running the history: Bar-Shalom, Li, Kirubarajan, Estimation
//! with Applications to Tracking and Navigation, 2001, ch. 11). Per axis: position, velocity, and an acceleration
//! that nothing explains, a random walk, which takes the error of a tilted IMU.

mod prediction;
mod sensor_noise;

use std::slice::from_mut;

use crate::archive::Ledger;
use crate::model::{Model, Vertical, VerticalInput};
use crate::observation::{OBSERVATION, index};
use crate::scalar::{Scalar, tabulate, wrap};
use prediction::{Axis, Covariance, START, overlap, predict_covariance, predict_mean};
use sensor_noise::NoiseVariance;

pub use sensor_noise::{BELIEF, SensorNoise};

/// Ticks of history: a fix older than this is of no use. At 50 Hz 0.24 s, twice the longest latency that the
/// simulator has.
const HISTORY: usize = 12;
/// So many outliers in a row are the truth.
const RELOCK: f64 = 6.0;
/// A fix is new if it is so much younger than the last one would be by now.
const NEWER_S: f64 = 1e-3;

/// Estimated position and motion of the vehicle, world frame.
#[derive(Debug, Clone, Copy)]
pub struct Estimate<R> {
    /// Position over the marker.
    pub pos_m: [R; 3],
    /// Velocity along the axes of the world.
    pub vel_mps: [R; 3],
    /// Heading over the marker, from -pi to pi.
    pub yaw_rad: R,
    /// Acceleration that the attitude does not explain: what the accelerometer shows of pushes, and the
    /// filter's own.
    pub push_mps2: [R; 3],
}

/// The filter of one drone, or of lanes.
#[derive(Debug, Clone)]
pub struct Estimator<R: Scalar> {
    noise: NoiseVariance,
    tick_s: f64,
    gravity_mps2: f64,
    /// Displacement by a constant acceleration over a step dt, divided by dt^2, per axis.
    carry: [f64; 3],
    /// At the capture of the last frame taken in, `age_s` ago.
    axes: [Axis<R>; 3],
    spread: [Covariance<R>; 2],
    age_s: R,
    outliers: R,
    /// Accelerations of the last ticks in the world frame, the newest first, and the IMU's heading at their
    /// ends, unwrapped.
    acc_mps2: [[R; 3]; HISTORY],
    imu_yaw_rad: [R; HISTORY + 1],
    /// By the attitude at the last tick.
    last_mps2: [R; 2],
    /// Heading over the marker minus the IMU's, and its variance.
    turned_rad: R,
    turned_spread: R,
    /// Age of the last fix that was looked at.
    seen_s: R,
    fresh: R::Mask,
}

impl<R: Scalar> Estimator<R> {
    /// Creates the filter for the declared model, updated every `tick_s` seconds.
    pub fn new(model: &Model, input: VerticalInput, tick_s: f64, belief: &SensorNoise) -> Self {
        let (zero, none) = (R::zero(), R::nothing());
        // a first-order form's velocity jumps at the start of a tick and holds
        let jumps = matches!(model.vertical(input), Ok(Vertical::FirstOrder { .. }));
        Estimator {
            noise: NoiseVariance::from_belief(belief),
            tick_s,
            gravity_mps2: model.lateral.gravity.value,
            carry: [0.5, 0.5, if jumps { 1.0 } else { 0.5 }],
            axes: [[zero; 3]; 3],
            spread: [[zero; 6]; 2],
            age_s: zero,
            outliers: zero,
            acc_mps2: [[zero; 3]; HISTORY],
            imu_yaw_rad: [zero; HISTORY + 1],
            last_mps2: [zero; 2],
            turned_rad: zero,
            turned_spread: zero,
            seen_s: zero,
            fresh: !none,
        }
    }

    /// Forget the flight in the lanes of `mask`.
    pub fn reset(&mut self, mask: R::Mask) {
        self.fresh = self.fresh | mask;
    }

    /// Begins flights in the lanes of `mask` with their first rows; where the vehicle is, in these lanes.
    #[inline(always)]
    pub fn start(&mut self, mask: R::Mask, o: &[R; OBSERVATION]) -> Estimate<R> {
        self.begin(mask, o);
        self.fresh = self.fresh & !mask;
        self.now(o, self.push(o, o[index::YAW] + self.turned_rad))
    }

    /// [`Self::start`] in the lanes of `begun`, or else [`Self::update`].
    #[inline(always)]
    pub(crate) fn estimate(&mut self, begun: Option<R::Mask>, o: &[R; OBSERVATION]) -> Estimate<R> {
        match begun {
            Some(mask) => self.start(mask, o),
            None => self.update(o),
        }
    }

    /// Estimates the vehicle's state at the time of this observation row, the next one since the last call.
    #[inline(always)]
    pub fn update(&mut self, o: &[R; OBSERVATION]) -> Estimate<R> {
        let fresh = self.fresh;
        if R::any(fresh) {
            self.begin(fresh, o);
            self.fresh = R::nothing();
        }
        let yaw = o[index::YAW] + self.turned_rad;
        let push = self.push(o, yaw);
        self.remember(!fresh, o, yaw, push);
        self.look(!fresh, o);
        self.now(o, push)
    }

    /// Begins an episode with its first row: at rest at the fix.
    #[inline(always)]
    fn begin(&mut self, fresh: R::Mask, o: &[R; OBSERVATION]) {
        let set = |slot: &mut R, value: R| *slot = R::select(fresh, value, *slot);
        let zero = R::zero();
        for (i, axis) in self.axes.iter_mut().enumerate() {
            axis.iter_mut().zip([o[i], zero, zero]).for_each(|(slot, value)| set(slot, value));
        }
        for (i, spread) in self.spread.iter_mut().enumerate() {
            let start = START.map(R::from_f64);
            spread.iter_mut().zip(start).for_each(|(slot, value)| set(slot, value));
            set(&mut spread[0], R::from_f64(self.noise.fix[i]));
        }
        self.acc_mps2.iter_mut().flatten().for_each(|slot| set(slot, zero));
        self.imu_yaw_rad.iter_mut().for_each(|slot| set(slot, o[index::YAW]));
        let tilts = self.tilts(o, o[index::MARKER_YAW]);
        self.last_mps2.iter_mut().zip(tilts).for_each(|(slot, value)| set(slot, value));
        set(&mut self.turned_rad, wrap(o[index::MARKER_YAW] - o[index::YAW]));
        set(&mut self.turned_spread, R::from_f64(self.noise.yaw));
        set(&mut self.outliers, zero);
        set(&mut self.age_s, o[index::MARKER_AGE]);
        set(&mut self.seen_s, o[index::MARKER_AGE]);
    }

    /// Acceleration by the tilt, world frame: +pitch to +x, +roll to -y (4.10).
    #[inline(always)]
    fn tilts(&self, o: &[R; OBSERVATION], yaw: R) -> [R; 2] {
        turn(
            [
                o[index::PITCH] * R::from_f64(self.gravity_mps2),
                -o[index::ROLL] * R::from_f64(self.gravity_mps2),
            ],
            yaw,
        )
    }

    /// Returns the acceleration besides that of the tilt: the accelerometer measures neither gravity nor, therefore,
    /// the tilt.
    #[inline(always)]
    fn push(&self, o: &[R; OBSERVATION], yaw: R) -> [R; 3] {
        let [x, y] = turn([o[index::ACC_X], o[index::ACC_Y]], yaw);
        [x, y, o[index::ACC_Z] - R::from_f64(self.gravity_mps2)]
    }

    /// One tick more of history.
    #[inline(always)]
    fn remember(&mut self, on: R::Mask, o: &[R; OBSERVATION], yaw: R, push: [R; 3]) {
        let (h, keep) = (R::from_f64(self.tick_s), |new: R, old: R| R::select(on, new, old));
        // the filter advances over the oldest ticks before it forgets them
        let over = (self.age_s - R::from_f64(self.tick_s * (HISTORY - 1) as f64)).max(R::zero());
        let over = R::select(on, over, R::zero());
        self.advance(HISTORY - 1, over);
        self.widen(over);
        self.age_s = keep(self.age_s - over + h, self.age_s);
        self.seen_s = keep(self.seen_s + h, self.seen_s);
        let tilts = self.tilts(o, yaw);
        let mean: [R; 2] = tabulate(
            #[inline(always)]
            |i| R::from_f64(0.5) * (tilts[i] + self.last_mps2[i]) + push[i],
        );
        for i in 0..2 {
            self.last_mps2[i] = keep(tilts[i], self.last_mps2[i]);
        }
        for j in (1..HISTORY).rev() {
            for i in 0..3 {
                self.acc_mps2[j][i] = keep(self.acc_mps2[j - 1][i], self.acc_mps2[j][i]);
            }
        }
        for (slot, value) in self.acc_mps2[0].iter_mut().zip([mean[0], mean[1], push[2]]) {
            *slot = keep(value, *slot);
        }
        let newest = self.imu_yaw_rad[0] + wrap(o[index::YAW] - self.imu_yaw_rad[0]);
        for j in (1..=HISTORY).rev() {
            self.imu_yaw_rad[j] = keep(self.imu_yaw_rad[j - 1], self.imu_yaw_rad[j]);
        }
        self.imu_yaw_rad[0] = keep(newest, self.imu_yaw_rad[0]);
        self.turned_spread += R::select(on, R::from_f64(self.noise.drift * self.tick_s), R::zero());
    }

    /// Moves the state on by `dt_s` under the accelerations of tick `j`.
    #[inline(always)]
    fn advance(&mut self, j: usize, dt_s: R) {
        // a step of no time changes at most the sign of a zero
        if R::any(R::zero().lt(dt_s)) {
            for i in 0..3 {
                self.axes[i] = predict_mean(&self.axes[i], self.acc_mps2[j][i], dt_s, self.carry[i]);
            }
        }
    }

    /// Adds the uncertainty of `dt_s`.
    #[inline(always)]
    fn widen(&mut self, dt_s: R) {
        for spread in &mut self.spread {
            *spread = predict_covariance(spread, dt_s, self.noise.white, self.noise.bias);
        }
    }

    /// Takes a new fix in.
    #[inline(always)]
    fn look(&mut self, on: R::Mask, o: &[R; OBSERVATION]) {
        let age = o[index::MARKER_AGE];
        let newer =
            on & age.lt(self.seen_s - R::from_f64(NEWER_S)) & age.le(self.age_s + R::from_f64(NEWER_S));
        if !R::any(newer) {
            return;
        }
        let h = self.tick_s;
        self.seen_s = R::select(newer, age, self.seen_s);
        let to = R::select(newer, age, self.age_s);
        for j in (0..HISTORY).rev() {
            self.advance(j, overlap(self.age_s, to, j, h));
        }
        for number in self.axes.as_flattened_mut() {
            *number = unsigned_zero(*number);
        }
        self.widen((self.age_s - to).max(R::zero()));
        self.age_s = to;
        self.correct(newer, o);
    }

    /// The Kalman update at the fix's capture, but for outliers.
    #[inline(always)]
    fn correct(&mut self, newer: R::Mask, o: &[R; OBSERVATION]) {
        // pixel noise through a pinhole: sideways as the distance, along the line of sight as its square
        let far = (self.axes[2][0] * R::from_f64(1.0 / 0.7)).max(R::from_f64(0.3));
        let noise = [
            R::from_f64(self.noise.fix[0]) * far * far,
            R::from_f64(self.noise.fix[1]) * far * far * far * far,
        ];
        let total = [self.spread[0][0] + noise[0], self.spread[1][0] + noise[1]];
        let off: [R; 3] = tabulate(
            #[inline(always)]
            |i| o[i] - self.axes[i][0],
        );
        let distance = (off[0] * off[0] + off[1] * off[1]) / total[0] + off[2] * off[2] / total[1];
        let outlier = newer & R::from_f64(self.noise.gate).lt(distance);
        let lost = outlier & R::from_f64(RELOCK - 1.5).lt(self.outliers);
        self.outliers = R::select(
            newer,
            R::select(outlier & !lost, self.outliers + R::from_f64(1.0), R::zero()),
            self.outliers,
        );
        let good = newer & !outlier;
        for (k, total) in total.into_iter().enumerate() {
            let [pp, pv, pb, vv, vb, bb] = self.spread[k];
            let gain = [pp / total, pv / total, pb / total];
            for i in if k == 0 { 0..2 } else { 2..3 } {
                for (slot, gain) in self.axes[i].iter_mut().zip(gain) {
                    *slot += R::select(good, gain * off[i], R::zero());
                }
                // several in a row that agree against the filter: it begins again
                let restart = [o[i], R::zero(), R::zero()];
                self.axes[i]
                    .iter_mut()
                    .zip(restart)
                    .for_each(|(slot, value)| *slot = R::select(lost, value, *slot));
            }
            let [g, u, w] = gain;
            let less = [pp - g * pp, pv - g * pv, pb - g * pb, vv - u * pv, vb - u * pb, bb - w * pb];
            let start = START.map(R::from_f64);
            for i in 0..6 {
                self.spread[k][i] = R::select(lost, start[i], R::select(good, less[i], self.spread[k][i]));
            }
        }
        self.correct_yaw(good | lost, o);
    }

    /// The heading: the IMU's, turned by what the marker shows of it.
    #[inline(always)]
    fn correct_yaw(&mut self, good: R::Mask, o: &[R; OBSERVATION]) {
        let ticks = o[index::MARKER_AGE] * R::from_f64(1.0 / self.tick_s);
        let mut then = R::zero();
        for (j, yaw) in self.imu_yaw_rad.iter().enumerate() {
            let share = (R::from_f64(1.0) - (ticks - R::from_f64(j as f64)).abs()).max(R::zero());
            then += share * *yaw;
        }
        let gain = self.turned_spread / (self.turned_spread + R::from_f64(self.noise.yaw));
        let off = wrap(o[index::MARKER_YAW] - then - self.turned_rad);
        self.turned_rad += R::select(good, gain * off, R::zero());
        self.turned_spread =
            R::select(good, self.turned_spread - gain * self.turned_spread, self.turned_spread);
    }

    /// From the last capture to now.
    #[inline(always)]
    fn now(&self, o: &[R; OBSERVATION], push: [R; 3]) -> Estimate<R> {
        let mut axes = self.axes;
        for j in (0..HISTORY).rev() {
            let dt_s = overlap(self.age_s, R::zero(), j, self.tick_s);
            if R::any(R::zero().lt(dt_s)) {
                for i in 0..3 {
                    axes[i] = predict_mean(&axes[i], self.acc_mps2[j][i], dt_s, self.carry[i]);
                }
            }
        }
        for number in axes.as_flattened_mut() {
            *number = unsigned_zero(*number);
        }
        let [x, y, z] = axes;
        Estimate {
            pos_m: [x[0], y[0], z[0].max(R::zero())],
            vel_mps: [x[1], y[1], z[1]],
            yaw_rad: wrap(o[index::YAW] + self.turned_rad),
            push_mps2: [push[0] + x[2], push[1] + y[2], push[2] + z[2]],
        }
    }

    /// Shows what it goes on from.
    pub(crate) fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("filter_axes", self.axes.as_flattened_mut());
        ledger.numbers("filter_spread", self.spread.as_flattened_mut());
        ledger.numbers("filter_acc_mps2", self.acc_mps2.as_flattened_mut());
        ledger.numbers("filter_imu_yaw_rad", &mut self.imu_yaw_rad);
        ledger.numbers("filter_last_mps2", &mut self.last_mps2);
        ledger.numbers("filter_age_s", from_mut(&mut self.age_s));
        ledger.numbers("filter_outliers", from_mut(&mut self.outliers));
        ledger.numbers("filter_turned_rad", from_mut(&mut self.turned_rad));
        ledger.numbers("filter_turned_spread", from_mut(&mut self.turned_spread));
        ledger.numbers("filter_seen_s", from_mut(&mut self.seen_s));
    }

    /// Every lane is under way, with the numbers that it was given.
    pub(crate) fn resume(&mut self) {
        self.fresh = R::nothing();
    }
}

/// A pair along the vehicle's heading, in the world frame.
#[inline(always)]
fn turn<R: Scalar>([front, left]: [R; 2], yaw: R) -> [R; 2] {
    let (sin, cos) = yaw.sin_cos();
    [cos * front - sin * left, sin * front + cos * left]
}

/// Zero without a sign: what lanes next to each other skip together must not differ by it.
#[inline(always)]
fn unsigned_zero<R: Scalar>(number: R) -> R {
    number + R::zero()
}
