//! The firmware's attitude and rate loops, and its mixer: commands in, a PWM for each motor out.

use std::slice::from_mut;

use super::mixer::MOTORS;
use crate::action::ActionLevel;
use crate::archive::Ledger;
use crate::model::{AttitudeLoop, FULL_PWM};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, wrap};

// Gains of the Crazyflie's firmware (platform_defaults_cf2.h, 2022, and platform_defaults_cf21bl.h, 2024), in
// degrees: roll, pitch, yaw.
/// Commanded rate per degree, per degree second, and per deg/s; limit of the sum.
pub(super) const ANGLE_P: [f64; 3] = [6.0, 6.0, 6.0];
const ANGLE_I: [f64; 3] = [3.0, 3.0, 1.0];
pub(super) const ANGLE_D: [f64; 3] = [0.0, 0.0, 0.35];
const ANGLE_SUM_DEGS: [f64; 3] = [20.0, 20.0, 360.0];
/// Counts per deg/s^2.
pub(super) const RATE_D: [f64; 3] = [2.5, 2.5, 0.0];
const RATE_SUM_DEG: [f64; 3] = [33.3, 33.3, 166.7];
/// The output of a rate loop is a number of 16 bits.
const OUTPUT_MAX: f64 = 32_767.0;

pub(super) const DEG: f64 = 180.0 / std::f64::consts::PI;

/// The gains in which the boards differ: counts per deg/s, and per degree.
pub(super) fn rate_gains(attitude_loop: &AttitudeLoop) -> [[f64; 3]; 2] {
    match attitude_loop {
        AttitudeLoop::Firmware => [[250.0, 250.0, 120.0], [500.0, 500.0, 16.7]],
        AttitudeLoop::FirmwareBrushless => [[200.0, 200.0, 120.0], [400.0, 400.0, 16.7]],
    }
}

/// State of the loops of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Memory<R> {
    /// Commanded heading.
    yaw_rad: R,
    angle_sum: [R; 3],
    rate_sum: [R; 3],
    last_radps: [R; 3],
}

impl<R: Scalar> Memory<R> {
    pub(super) fn new() -> Self {
        let none = [R::zero(); 3];
        Memory { yaw_rad: R::zero(), angle_sum: none, rate_sum: none, last_radps: none }
    }

    /// Begin flights at rest in the lanes of `mask`.
    pub(super) fn start(&mut self, mask: R::Mask, x: &State<R>) {
        self.yaw_rad = R::select(mask, x.att_rad[2], self.yaw_rad);
        let sums = [&mut self.angle_sum, &mut self.rate_sum, &mut self.last_radps];
        for sum in sums.into_iter().flatten() {
            *sum = R::select(mask, R::zero(), *sum);
        }
    }
}

impl<R: Scalar> Memory<R> {
    pub(super) fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("loops_yaw_rad", from_mut(&mut self.yaw_rad));
        ledger.numbers("loops_angle_sum", &mut self.angle_sum);
        ledger.numbers("loops_rate_sum", &mut self.rate_sum);
        ledger.numbers("loops_last_radps", &mut self.last_radps);
    }
}

/// The loops, called every `step_s`.
#[derive(Debug)]
pub(super) struct Loops<R> {
    step_s: R,
    per_step: R,
    yaw_sign: R,
    rate_p: [R; 3],
    rate_i: [R; 3],
}

impl<R: Scalar> Loops<R> {
    pub(super) fn new(step_s: f64, yaw_sign: f64, attitude_loop: &AttitudeLoop) -> Self {
        let [rate_p, rate_i] =
            rate_gains(attitude_loop).map(|gains| gains.map(|gain| R::from_f64(gain * DEG)));
        Loops {
            rate_p,
            rate_i,
            step_s: R::from_f64(step_s),
            per_step: R::from_f64(1.0 / step_s),
            yaw_sign: R::from_f64(yaw_sign),
        }
    }

    /// The PWM of each motor. At the levels of body rates and of motors the command's four numbers are rates
    /// about the body axes with a PWM, and four PWMs.
    #[inline(always)]
    pub(super) fn motors(
        &self,
        memory: &mut Memory<R>,
        level: ActionLevel,
        u: &Command<R>,
        att_rad: &[R; 3],
        rates: &[R; 3],
    ) -> [R; 4] {
        let commanded = [u.roll_rad, u.pitch_rad, u.yaw_rate_radps];
        let asked = match level {
            ActionLevel::Motors => {
                let [a, b, c] = commanded;
                return [a, b, c, u.lift].map(
                    #[inline(always)]
                    |pwm| pwm.clamp(R::zero(), R::from_f64(FULL_PWM)),
                );
            }
            ActionLevel::BodyRates => commanded,
            _ => self.rates(memory, commanded, att_rad, rates),
        };
        let outputs = self.torques(memory, &asked, rates);
        memory.last_radps = *rates;
        mix(&outputs, u.lift)
    }

    /// Runs the attitude loop: commanded rates.
    #[inline(always)]
    fn rates(
        &self,
        memory: &mut Memory<R>,
        [roll, pitch, turn]: [R; 3],
        att: &[R; 3],
        rates: &[R; 3],
    ) -> [R; 3] {
        memory.yaw_rad = wrap(memory.yaw_rad + self.yaw_sign * turn * self.step_s);
        let error = [roll - att[0], pitch - att[1], wrap(memory.yaw_rad - att[2])];
        std::array::from_fn(
            #[inline(always)]
            |i| {
                let most = R::from_f64(ANGLE_SUM_DEGS[i] / DEG);
                memory.angle_sum[i] = (memory.angle_sum[i] + error[i] * self.step_s).clamp(-most, most);
                R::from_f64(ANGLE_P[i]) * error[i] + R::from_f64(ANGLE_I[i]) * memory.angle_sum[i]
                    - R::from_f64(ANGLE_D[i]) * rates[i]
            },
        )
    }

    /// Runs the rate loop: inputs of the mixer, in counts. The derivative is that of the measured rate.
    #[inline(always)]
    fn torques(&self, memory: &mut Memory<R>, asked: &[R; 3], rates: &[R; 3]) -> [R; 3] {
        std::array::from_fn(
            #[inline(always)]
            |i| {
                let error = asked[i] - rates[i];
                let most = R::from_f64(RATE_SUM_DEG[i] / DEG);
                memory.rate_sum[i] = (memory.rate_sum[i] + error * self.step_s).clamp(-most, most);
                let slope = (rates[i] - memory.last_radps[i]) * self.per_step;
                let output = self.rate_p[i] * error + self.rate_i[i] * memory.rate_sum[i]
                    - R::from_f64(RATE_D[i] * DEG) * slope;
                output.clamp(R::from_f64(-OUTPUT_MAX), R::from_f64(OUTPUT_MAX))
            },
        )
    }
}

/// Mixes the torques like the firmware (power_distribution_quadrotor.c). If a motor would exceed its limit, all four
/// are reduced by the same amount: attitude has priority over height.
#[inline(always)]
fn mix<R: Scalar>(&[roll, pitch, yaw]: &[R; 3], lift: R) -> [R; 4] {
    let half = R::from_f64(0.5);
    let asked = MOTORS.map(
        #[inline(always)]
        |[front, left]| {
            lift + R::from_f64(left) * half * roll - R::from_f64(front) * half * pitch
                + R::from_f64(front * left) * yaw
        },
    );
    let [a, b, c, d] = asked;
    let full = R::from_f64(FULL_PWM);
    let excess = (a.max(b).max(c.max(d)) - full).max(R::zero());
    asked.map(
        #[inline(always)]
        |pwm| (pwm - excess).clamp(R::zero(), full),
    )
}
