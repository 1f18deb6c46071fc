//! The velocity controller proposed by the thesis (chapter 8): position to velocity to angle, each loop inside the
//! one before.

use super::landing::Landing;
use super::{Batch, ControlLaw, ControllerContext, Entry, Mode, defaults, options};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::estimator::{BELIEF, Estimate, Estimator, SensorNoise};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, tabulate, wrap};

/// A set-point that moves faster than this has jumped.
const JUMP_MPS: f64 = 2.0;

options! {
    position_ps: f64 = 2.0, "velocity asked for per metre of error, in all three directions";
    speed_mps: f64 = 1.0, "the most velocity that is asked for";
    velocity_ps: f64 = 4.0, "acceleration per m/s of error, sideways";
    integral_ps2: f64 = 1.0, "acceleration per metre that the velocity error adds up to, sideways";
    angle: f64 = 2.0, "how much of the angle error is added to the angle that is commanded";
    climb_ps: f64 = 2.0, "acceleration per m/s of error, upwards";
    climb_integral_ps2: f64 = 2.0, "acceleration per metre that the velocity error adds up to, upwards";
    yaw_ps: f64 = 2.0, "yaw rate per radian of error";
    belief: SensorNoise = SensorNoise::default(), BELIEF;
}

pub(super) const ENTRY: Entry = Entry {
    name: "velocity",
    also: None,
    about: "Cascade: position error to velocity (P, limited), velocity error to acceleration (PI), acceleration to angle, closed over the IMU (P)",
    source: "thesis chapter 8, future work 4; the cascade of the Crazyflie's firmware (position_controller_pid.c), by a filtered velocity",
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: defaults::<Options>,
    build: |given, site| Ok(Box::new(Batch::new(site.envs, Velocity::new(given.options()?, site)?))),
};

#[derive(Debug, Clone)]
struct Velocity<R: Scalar> {
    options: Options,
    interface: Interface,
    landing: Landing<R>,
    gravity_mps2: f64,
    /// Command per angle to keep, of roll and pitch.
    per_tilt: [f64; 2],
    tick_s: f64,
    estimator: Estimator<R>,
    /// Integral of the velocity error, in m/s^2.
    integral_mps2: [R; 3],
    target: [R; 3],
    fresh: R::Mask,
}

impl<R: Scalar> Velocity<R> {
    fn new(options: Options, site: &ControllerContext<'_>) -> Result<Self> {
        let ControllerContext { model, interface, tick_s, mode, .. } = *site;
        let zero = R::zero();
        Ok(Velocity {
            options,
            interface,
            landing: Landing::new(mode, tick_s),
            gravity_mps2: model.lateral.gravity.value,
            per_tilt: model.tilt_forms(interface.input).map(|tilt| tilt.input_per_output()),
            tick_s,
            estimator: Estimator::new(model, interface.input, tick_s, &options.belief),
            integral_mps2: [zero; 3],
            target: [zero; 3],
            fresh: !R::nothing(),
        })
    }

    /// Returns the acceleration commanded by the two outer loops, world frame.
    #[inline(always)]
    fn acceleration(&mut self, e: &Estimate<R>, target: &[R; 3]) -> [R; 3] {
        let o = self.options;
        let (h, top) = (R::from_f64(self.tick_s), R::from_f64(o.speed_mps));
        let stiff = [o.velocity_ps, o.velocity_ps, o.climb_ps];
        let slow = [o.integral_ps2, o.integral_ps2, o.climb_integral_ps2];
        // not more than the command can give, sideways; half the weight upwards
        let sideways =
            self.gravity_mps2 * self.interface.tilt_max_rad / self.per_tilt[0].max(self.per_tilt[1]);
        let most = [sideways, sideways, 0.5 * self.gravity_mps2];
        let mut acceleration = [R::zero(); 3];
        for i in 0..3 {
            let moved = (target[i] - self.target[i]) * R::from_f64(1.0 / self.tick_s);
            let along = R::select(moved.abs().lt(R::from_f64(JUMP_MPS)), moved, R::zero());
            let wanted = (R::from_f64(o.position_ps) * (target[i] - e.pos_m[i])).clamp(-top, top) + along;
            let off = wanted - e.vel_mps[i];
            let (asked, most) = (R::from_f64(stiff[i]) * off + self.integral_mps2[i], R::from_f64(most[i]));
            // anti-windup: at its limit the integral does not grow
            let stuck = most.lt(asked.abs()) & R::zero().lt(asked * off);
            let more = R::select(stuck, R::zero(), R::from_f64(slow[i]) * off * h);
            self.integral_mps2[i] = (self.integral_mps2[i] + more).clamp(-most, most);
            acceleration[i] = asked.clamp(-most, most);
        }
        acceleration
    }

    #[inline(always)]
    fn begin(&mut self, target: &[R; 3]) {
        let fresh = self.fresh;
        for i in 0..3 {
            self.integral_mps2[i] = R::select(fresh, R::zero(), self.integral_mps2[i]);
            self.target[i] = R::select(fresh, target[i], self.target[i]);
        }
        self.fresh = R::nothing();
    }
}

impl<R: Scalar> ControlLaw<R> for Velocity<R> {
    fn set_mode(&mut self, mode: Mode) {
        self.landing.set_mode(mode);
    }

    fn reset(&mut self, mask: R::Mask) {
        self.estimator.reset(mask);
        self.fresh = self.fresh | mask;
    }

    #[inline(always)]
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let e = self.estimator.update(o);
        let target = [
            o[index::SETPOINT_X],
            o[index::SETPOINT_Y],
            self.landing.target(self.fresh, o[index::SETPOINT_Z], e.pos_m[2]),
        ];
        self.begin(&target);
        let [ax, ay, az] = self.acceleration(&e, &target);
        self.target = target;
        let (sin, cos) = e.yaw_rad.sin_cos();
        let per_g = R::from_f64(1.0 / self.gravity_mps2);
        let wanted = [(sin * ax - cos * ay) * per_g, (cos * ax + sin * ay) * per_g];
        let [roll_rad, pitch_rad] = tabulate(
            #[inline(always)]
            |i| {
                R::from_f64(self.per_tilt[i]) * wanted[i]
                    + R::from_f64(self.options.angle) * (wanted[i] - o[index::ROLL + i])
            },
        );
        let turn = R::from_f64(self.options.yaw_ps * self.interface.yaw_sign)
            * wrap(o[index::SETPOINT_YAW] - e.yaw_rad);
        let lift = if self.interface.input.is_pwm() {
            R::from_f64(self.interface.hover_lift) * (R::from_f64(1.0) + az * per_g)
        } else {
            target[2]
        };
        let off = R::zero();
        let still = |v: R| R::select(self.landing.idle, off, v);
        let u = Command {
            roll_rad: still(roll_rad),
            pitch_rad: still(pitch_rad),
            yaw_rate_radps: still(turn),
            lift: still(lift),
        };
        self.interface.action(&u)
    }
}
