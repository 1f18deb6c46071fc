//! Estimates the vehicle's state: a Kalman filter of place and velocity, driven by the IMU, corrected by positions.
//! Like the firmware's it treats a position as one of now, whatever its latency was.

use crazyflie_env::effects::Reading;
use crazyflie_env::scalar::wrap;

/// Variance of the filter after a reset: the firmware's own numbers.
const START_VAR_POS_M2: [f64; 3] = [100.0 * 100.0, 100.0 * 100.0, 1.0];
const START_VAR_VEL_M2PS2: f64 = 0.01 * 0.01;
const START_VAR_YAW_RAD2: f64 = 0.01 * 0.01;
/// The IMU's heading drifts by this within a second.
const YAW_DRIFT_RADPS: f64 = 0.002;

/// Place and velocity along one axis, with their covariance.
#[derive(Debug, Clone, Copy)]
struct Axis {
    pos_m: f64,
    vel_mps: f64,
    /// Covariance: of place, of both, of velocity.
    spread: [f64; 3],
}

impl Axis {
    fn new(pos_m: f64, var_m2: f64) -> Axis {
        Axis { pos_m, vel_mps: 0.0, spread: [var_m2, 0.0, START_VAR_VEL_M2PS2] }
    }

    fn predict(&mut self, acc_mps2: f64, noise_mps2: f64, dt_s: f64) {
        self.pos_m += dt_s * (self.vel_mps + 0.5 * dt_s * acc_mps2);
        self.vel_mps += dt_s * acc_mps2;
        let [pp, pv, vv] = self.spread;
        // an acceleration that holds for a tick
        let q = noise_mps2 * noise_mps2 * dt_s * dt_s;
        self.spread = [
            pp + dt_s * (2.0 * pv + dt_s * vv) + 0.25 * q * dt_s * dt_s,
            pv + dt_s * vv + 0.5 * q * dt_s,
            vv + q,
        ];
    }

    fn correct(&mut self, pos_m: f64, noise_m: f64) {
        let [pp, pv, vv] = self.spread;
        let total = pp + noise_m * noise_m;
        let (gain, gain_ps, off_m) = (pp / total, pv / total, pos_m - self.pos_m);
        self.pos_m += gain * off_m;
        self.vel_mps += gain_ps * off_m;
        self.spread = [pp - gain * pp, pv - gain * pv, vv - gain_ps * pv];
    }
}

/// Standard deviations that the filter believes in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FilterNoise {
    /// Noise of the acceleration, horizontal and vertical.
    pub acc_mps2: [f64; 2],
}

/// The filter of one drone.
#[derive(Debug, Clone)]
pub(crate) struct Estimator {
    axes: [Axis; 3],
    /// Heading less the IMU's, and its variance.
    turned_rad: f64,
    turned_var_rad2: f64,
    imu_yaw_rad: f64,
}

impl Estimator {
    /// A filter that knows next to nothing, at a place and with a heading to begin from.
    pub(crate) fn new(start_m: [f64; 3], yaw_rad: f64, imu_yaw_rad: f64) -> Self {
        let axis = |i: usize| Axis::new(start_m[i], START_VAR_POS_M2[i]);
        Estimator {
            axes: [axis(0), axis(1), axis(2)],
            turned_rad: wrap(yaw_rad - imu_yaw_rad),
            turned_var_rad2: START_VAR_YAW_RAD2,
            imu_yaw_rad,
        }
    }

    /// A tick under what the IMU shows. The simulator's accelerometer feels no tilt, so the part of gravity that
    /// a tilt turns sideways is added by the attitude.
    pub(crate) fn predict(&mut self, y: &Reading<f64>, gravity_mps2: f64, noise: FilterNoise, dt_s: f64) {
        self.imu_yaw_rad = y.att_rad[2];
        let front = y.att_rad[1] * gravity_mps2 + y.acc_mps2[0];
        let left = -y.att_rad[0] * gravity_mps2 + y.acc_mps2[1];
        let (sin, cos) = self.yaw_rad().sin_cos();
        let acc = [cos * front - sin * left, sin * front + cos * left, y.acc_mps2[2] - gravity_mps2];
        for (i, axis) in self.axes.iter_mut().enumerate() {
            axis.predict(acc[i], noise.acc_mps2[i / 2], dt_s);
        }
        self.turned_var_rad2 += YAW_DRIFT_RADPS * YAW_DRIFT_RADPS * dt_s;
    }

    /// A position from outside, of which the filter believes a standard deviation of `noise_m`.
    pub(crate) fn correct(&mut self, pos_m: [f64; 3], noise_m: f64) {
        for (axis, pos_m) in self.axes.iter_mut().zip(pos_m) {
            axis.correct(pos_m, noise_m);
        }
    }

    /// A heading from outside.
    pub(crate) fn correct_yaw(&mut self, yaw_rad: f64, noise_rad: f64) {
        let gain = self.turned_var_rad2 / (self.turned_var_rad2 + noise_rad * noise_rad);
        self.turned_rad += gain * wrap(yaw_rad - self.yaw_rad());
        self.turned_var_rad2 -= gain * self.turned_var_rad2;
    }

    pub(crate) fn pos_m(&self) -> [f64; 3] {
        self.axes.map(|axis| axis.pos_m)
    }

    pub(crate) fn vel_mps(&self) -> [f64; 3] {
        self.axes.map(|axis| axis.vel_mps)
    }

    pub(crate) fn yaw_rad(&self) -> f64 {
        wrap(self.imu_yaw_rad + self.turned_rad)
    }

    /// Variances of place and velocity.
    pub(crate) fn variances(&self) -> [[f64; 3]; 2] {
        [self.axes.map(|axis| axis.spread[0]), self.axes.map(|axis| axis.spread[2])]
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::effects::PoseFix;

    use super::*;

    fn reading(pitch_rad: f64) -> Reading<f64> {
        let marker = PoseFix { pos_m: [0.0; 3], yaw_rad: 0.0, t_s: 0.0, valid: 0.0 };
        Reading {
            marker,
            att_rad: [0.0, pitch_rad, 0.0],
            gyro_radps: [0.0; 3],
            acc_mps2: [0.0, 0.0, 9.81],
            vbat_v: 3.7,
        }
    }

    #[test]
    fn variances_begin_high_and_fall_with_positions() {
        let mut filter = Estimator::new([0.0; 3], 0.0, 0.0);
        let noise = FilterNoise { acc_mps2: [0.5, 1.0] };
        assert!(filter.variances()[0][0] > 1000.0);
        for _ in 0..300 {
            filter.predict(&reading(0.0), 9.81, noise, 0.01);
            filter.correct([1.0, 2.0, 0.5], 0.002);
        }
        let [pos, vel] = filter.variances();
        assert!(pos.iter().all(|var| *var < 1e-4) && vel.iter().all(|var| *var < 1e-2), "{pos:?} {vel:?}");
        assert!((filter.pos_m()[1] - 2.0).abs() < 1e-3);
    }

    #[test]
    fn a_tilt_is_believed_until_positions_deny_it() {
        let mut filter = Estimator::new([0.0; 3], 0.0, 0.0);
        let noise = FilterNoise { acc_mps2: [0.5, 1.0] };
        for _ in 0..100 {
            filter.predict(&reading(0.1), 9.81, noise, 0.01);
        }
        assert!((filter.vel_mps()[0] - 0.981).abs() < 1e-3);
        filter.correct_yaw(0.5, 0.0001);
        assert!(filter.yaw_rad() > 0.4);
    }
}
