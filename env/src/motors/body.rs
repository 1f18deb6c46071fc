//! A rigid body with four motors on its diagonals, each with a lag and a thrust curve.

use super::{FULL_PWM, MOTORS};
use crate::plant::{Accelerations, YawRotation};
use crate::scalar::Scalar;
use crate::scalar::wrap;

/// Nearer to the vertical than this the angles' rates are those at this cosine: a vehicle that tumbles passes
/// through without a number being lost.
const LEAST_COS: f64 = 0.05;

/// Motion of a rigid body. World frame and signs as in [`crate::plant::State`].
#[derive(Debug, Clone, Copy)]
pub struct Motion<R> {
    /// Position of the centre of mass.
    pub pos_m: [R; 3],
    /// Velocity of the centre of mass.
    pub vel_mps: [R; 3],
    /// Roll, pitch and yaw.
    pub attitude: Attitude<R>,
    /// Rates about the body axes, as a gyroscope measures them.
    pub rate_radps: [R; 3],
}

/// Constants of a rigid body with four motors, for steps of one length.
#[derive(Debug)]
pub struct RigidBody<R> {
    /// Length of a step.
    pub step_s: R,
    /// Acceleration by gravity, downwards.
    pub gravity_mps2: R,
    /// Linear drag along the world's x and y axes.
    pub drag_ps: R,
    /// Linear drag along the world's z axis.
    pub heave_ps: R,
    /// Share of the way to the commanded PWM that a motor goes in a step: up to a larger one, down to a smaller one.
    pub follow: [R; 2],
    /// Share of the thrust at full PWM that grows with the PWM; the rest grows with its square.
    pub linear_share: R,
    /// Thrust of one motor at full PWM, per mass of the vehicle.
    pub most_mps2: R,
    /// Angular acceleration about the body axes per thrust per mass of a motor, 1/m.
    pub turn_per_thrust: [R; 3],
    /// Angular acceleration about each body axis per product of the rates about the two others: the difference of
    /// their inertias over its own.
    pub gyroscopic: [R; 3],
}

impl<R: Scalar> RigidBody<R> {
    /// Thrust of one motor per mass of the vehicle.
    #[inline(always)]
    fn motor_mps2(&self, pwm: R) -> R {
        let share = pwm * R::from_f64(1.0 / FULL_PWM);
        let square = R::from_f64(1.0) - self.linear_share;
        self.most_mps2 * share * (self.linear_share + square * share)
    }

    /// Thrust of all motors per mass of the vehicle.
    #[inline(always)]
    pub fn thrust_mps2(&self, pwm: &[R; 4]) -> R {
        let [a, b, c, d] = *pwm;
        (self.motor_mps2(a) + self.motor_mps2(b)) + (self.motor_mps2(c) + self.motor_mps2(d))
    }

    /// Angular acceleration about the body axes, by the motors and by the turning itself.
    #[inline(always)]
    fn turn(&self, pwm: &[R; 4], &[p, q, r]: &[R; 3]) -> [R; 3] {
        let mut sums = [R::zero(); 3];
        for (pwm, [front, left]) in pwm.iter().zip(MOTORS) {
            let thrust = self.motor_mps2(*pwm);
            for (sum, sign) in sums.iter_mut().zip([left, -front, front * left]) {
                *sum += R::from_f64(sign) * thrust;
            }
        }
        let ([roll, pitch, yaw], [about_x, about_y, about_z]) = (self.turn_per_thrust, self.gyroscopic);
        [roll * sums[0] + about_x * q * r, pitch * sums[1] + about_y * p * r, yaw * sums[2] + about_z * p * q]
    }

    /// Moves the body and the `pwm` of its motors one step on, with commanded PWM and push held. A motor's PWM is
    /// the one that would give its present thrust for good.
    #[inline(always)]
    pub fn step(&self, motion: &mut Motion<R>, pwm: &mut [R; 4], commanded: [R; 4], push: &Accelerations<R>) {
        let h = self.step_s;
        for (pwm, commanded) in pwm.iter_mut().zip(commanded) {
            let [up, down] = self.follow;
            *pwm += R::select(commanded.lt(*pwm), down, up) * (commanded - *pwm);
        }
        let torques = self.turn(pwm, &motion.rate_radps);
        for i in 0..3 {
            motion.rate_radps[i] += h * (torques[i] + push.ang_radps2[i]);
        }
        let angle_rates = motion.attitude.angle_rates(&motion.rate_radps);
        let acc = motion.attitude.acceleration(self.thrust_mps2(pwm));
        let mut angles_rad = motion.attitude.angles_rad;
        for i in 0..3 {
            let before = motion.vel_mps[i];
            let drag =
                if i == 2 { self.heave_ps * before + self.gravity_mps2 } else { self.drag_ps * before };
            motion.vel_mps[i] += h * (acc[i] + push.acc_mps2[i] - drag);
            motion.pos_m[i] += h * R::from_f64(0.5) * (before + motion.vel_mps[i]);
            angles_rad[i] += h * angle_rates[i];
        }
        // a vehicle that rolls over comes round; its heading is wrapped where it is read
        motion.attitude = Attitude::new([wrap(angles_rad[0]), wrap(angles_rad[1]), angles_rad[2]]);
    }
}

/// Roll after pitch after yaw, with their sines and cosines.
#[derive(Debug, Clone, Copy)]
pub struct Attitude<R> {
    angles_rad: [R; 3],
    roll: (R, R),
    pitch: (R, R),
    pub(super) heading: YawRotation<R>,
}

impl<R: Scalar> Attitude<R> {
    /// Takes roll, pitch and yaw.
    #[inline(always)]
    pub fn new(angles_rad: [R; 3]) -> Self {
        let (sin, cos) = angles_rad[2].sin_cos();
        Attitude {
            angles_rad,
            roll: angles_rad[0].sin_cos(),
            pitch: angles_rad[1].sin_cos(),
            heading: YawRotation { sin, cos },
        }
    }

    /// Returns roll, pitch and yaw.
    #[inline(always)]
    pub fn angles_rad(&self) -> [R; 3] {
        self.angles_rad
    }

    /// Rates about the body axes of a vehicle whose angles have these rates (thesis 4.3).
    #[inline(always)]
    pub(super) fn body_rates(&self, [roll_rate, pitch_rate, yaw_rate]: [R; 3]) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch), .. } = *self;
        [
            roll_rate - yaw_rate * sin_pitch,
            pitch_rate * cos_roll + yaw_rate * cos_pitch * sin_roll,
            yaw_rate * cos_pitch * cos_roll - pitch_rate * sin_roll,
        ]
    }

    /// Rates of roll, pitch and yaw from those about the body axes, bounded near the vertical.
    #[inline(always)]
    pub fn angle_rates(&self, &[p, q, r]: &[R; 3]) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch), .. } = *self;
        let per_cos_pitch = cos_pitch / (cos_pitch * cos_pitch).max(R::from_f64(LEAST_COS * LEAST_COS));
        let yaw_rate = (q * sin_roll + r * cos_roll) * per_cos_pitch;
        [p + yaw_rate * sin_pitch, q * cos_roll - r * sin_roll, yaw_rate]
    }

    /// Acceleration in the world frame by thrust along the tilted axis.
    #[inline(always)]
    fn acceleration(&self, thrust: R) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch), heading, .. } = *self;
        let (front, right) = (thrust * sin_pitch * cos_roll, thrust * sin_roll);
        [
            heading.cos * front + heading.sin * right,
            heading.sin * front - heading.cos * right,
            thrust * cos_roll * cos_pitch,
        ]
    }

    /// Rows of the rotation from the body frame to the world frame.
    #[inline(always)]
    pub fn rotation(&self) -> [[R; 3]; 3] {
        let Attitude { roll: (sr, cr), pitch: (sp, cp), heading: YawRotation { sin: sy, cos: cy }, .. } =
            *self;
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    }
}
