//! The PID of `crazyflie_ros` (W. Hoenig, package `crazyflie_controller`), the controller that the thesis
//! flew and tuned (7.2).
//!
//! Signs: error = reference - measured, gains positive, right-handed frames. The vehicle's own command signs
//! (roll to -y, the yaw rate of 5.2) are applied to the output, which makes table 7.1's negative gains.
//! Written once, for one drone or for lanes.

use serde_json::json;

pub use super::gains::{Gains, Loop};
use super::{Batch, ControlLaw, Controller, ControllerConfig, ControllerContext, Entry, Mode, options_json};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, tabulate, wrap};

/// A controller that flies these gains.
fn batch(gains: Gains, site: &ControllerContext<'_>) -> Box<dyn Controller> {
    Box::new(Batch::new(site.envs, Pid::new(gains, site.interface, site.tick_s, site.mode)))
}

const SOURCE: &str = "crazyflie_ros, package crazyflie_controller (W. Hoenig): P on the error, D on its change, I clamped, at 50 Hz";
const OPTIONS: &[(&str, &str)] = &[
    ("x", "the pitch loop, degrees per metre: kp, ki, kd, and the limits of integral and output"),
    ("y", "the roll loop, likewise"),
    ("yaw", "the yaw loop, deg/s per radian"),
    ("z", "the height loop, PWM counts per metre"),
];

/// These gains, but for what the options give.
fn with_options(
    gains: Gains,
    given: &ControllerConfig<'_>,
    site: &ControllerContext<'_>,
) -> Result<Box<dyn Controller>> {
    let gains: Gains = given.options_over(&gains)?;
    gains.check().map_err(|problem| given.problem(problem))?;
    Ok(batch(gains, site))
}

pub(super) const THESIS: Entry = Entry {
    name: "thesis-pid",
    also: Some("thesis"),
    about: "The thesis's PID with the gains that its tuner found (table 7.1, new)",
    source: SOURCE,
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: || options_json(Gains::THESIS),
    build: |given, site| with_options(Gains::THESIS, given, site),
};

pub(super) const STOCK: Entry = Entry {
    name: "stock-pid",
    also: Some("crazyflie_ros"),
    about: "The same PID with the package's defaults, which the thesis calls old",
    source: SOURCE,
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: || options_json(Gains::CRAZYFLIE_ROS),
    build: |given, site| with_options(Gains::CRAZYFLIE_ROS, given, site),
};

pub(super) const GIVEN: Entry = Entry {
    name: "pid",
    also: None,
    about: "The same PID with the gains of a file, as `crazyflie tune` writes it",
    source: SOURCE,
    any_level: false,
    file: Some("the gains of the loops x, y, z and yaw, as JSON"),
    member: None,
    options: OPTIONS,
    // the loops of the file stay as they are unless given
    defaults: || json!({"x": null, "y": null, "z": null, "yaw": null}),
    build: |given, site| {
        let gains = serde_json::from_slice(given.file.unwrap_or_default())
            .map_err(|e| given.problem(format!("the file of gains: {e}")))?;
        with_options(gains, given, site)
    },
};

/// The integral at which a loop gives so much; none does where it does not integrate.
fn preset(output: f64, ki: f64) -> f64 {
    if ki == 0.0 { 0.0 } else { output / ki }
}

/// State of one loop.
#[derive(Debug, Clone, Copy)]
struct Memory<R> {
    integral: R,
    last: R,
}

impl<R: Scalar> Memory<R> {
    fn new() -> Self {
        Memory { integral: R::zero(), last: R::zero() }
    }

    /// Steps the loop like pid.hpp: integrate and clamp, derivative of the error, clamp the sum. Only lanes of `on`
    /// change their state.
    #[inline(always)]
    fn update(&mut self, l: &Loop, error: R, dt_s: f64, on: R::Mask) -> R {
        let integral = (self.integral + error * R::from_f64(dt_s))
            .clamp(R::from_f64(l.integral[0]), R::from_f64(l.integral[1]));
        let slope = (error - self.last) * R::from_f64(1.0 / dt_s);
        self.integral = R::select(on, integral, self.integral);
        self.last = R::select(on, error, self.last);
        (R::from_f64(l.kp) * error + R::from_f64(l.kd) * slope + R::from_f64(l.ki) * integral)
            .clamp(R::from_f64(l.output[0]), R::from_f64(l.output[1]))
    }
}

const RAMP_PWM_PER_S: f64 = 10_000.0;
const RAMP_END_PWM: f64 = 50_000.0;
const CLEAR_M: f64 = 0.05;

/// The controller of one drone, or of sixteen.
#[derive(Debug, Clone)]
pub struct Pid<R: Scalar> {
    gains: Gains,
    interface: Interface,
    dt_s: f64,
    mode: Mode,
    /// The loops x, y, z and yaw.
    loops: [Memory<R>; 4],
    /// Ramping up from the floor; thrust so far; height at the start.
    ramping: R::Mask,
    ramp_pwm: R,
    start_m: R,
    /// Landed: motors off.
    idle: R::Mask,
    fresh: R::Mask,
}

impl<R: Scalar> Pid<R> {
    /// With the given gains and command interface, called every `dt_s` seconds.
    pub fn new(gains: Gains, interface: Interface, dt_s: f64, mode: Mode) -> Self {
        let none = R::nothing();
        let mut pid = Pid {
            gains,
            interface,
            dt_s,
            mode,
            loops: [Memory::new(); 4],
            ramping: none,
            ramp_pwm: R::zero(),
            start_m: R::zero(),
            idle: none,
            fresh: none,
        };
        pid.reset(!none);
        pid
    }

    /// Resets the loops of these lanes, but for the height's integral.
    #[inline(always)]
    fn restart(&mut self, lanes: R::Mask, height_integral: R) {
        let zero = |v: R| R::select(lanes, R::zero(), v);
        for m in &mut self.loops {
            *m = Memory { integral: zero(m.integral), last: zero(m.last) };
        }
        self.loops[2].integral = R::select(lanes, height_integral, self.loops[2].integral);
    }

    /// First call of an episode.
    #[inline(always)]
    fn begin(&mut self, height: R) {
        let fresh = self.fresh;
        if !R::any(fresh) {
            return;
        }
        let zero = |v: R| R::select(fresh, R::zero(), v);
        self.restart(fresh, R::from_f64(preset(self.interface.hover_lift, self.gains.z.ki)));
        self.ramp_pwm = zero(self.ramp_pwm);
        self.start_m = R::select(fresh, height, self.start_m);
        let ramp = self.mode == Mode::Takeoff && self.interface.input.is_pwm();
        self.ramping = if ramp { self.ramping | fresh } else { self.ramping & !fresh };
        self.idle = self.idle & !fresh;
        self.fresh = R::nothing();
    }

    /// Off the ground: as the package does, reset the loops and preset the height integral to the thrust that
    /// lifted.
    #[inline(always)]
    fn leave_ramp(&mut self, lifted: R::Mask) {
        let per_ki = R::from_f64(preset(1.0, self.gains.z.ki));
        self.restart(lifted, self.ramp_pwm * per_ki);
        self.ramping = self.ramping & !lifted;
    }

    /// The state Automatic: the target in the vehicle's frame, then four loops.
    #[inline(always)]
    fn fly(&mut self, o: &[R; OBSERVATION], target: [R; 3], on: R::Mask) -> Command<R> {
        let e: [R; 3] = tabulate(
            #[inline(always)]
            |i| target[i] - o[i],
        );
        let [(sr, cr), (sp, cp), (sy, cy)] =
            [o[index::ROLL].sin_cos(), o[index::PITCH].sin_cos(), o[index::MARKER_YAW].sin_cos()];
        let (front, left) = (cy * e[0] + sy * e[1], cy * e[1] - sy * e[0]);
        // world to body: yaw, then pitch, then roll
        let (bx, down) = (cp * front - sp * e[2], sp * front + cp * e[2]);
        let (by, bz) = (cr * left + sr * down, cr * down - sr * left);
        let deg = R::from_f64(std::f64::consts::PI / 180.0);
        let (g, dt) = (self.gains, self.dt_s);
        let [x, y, z, yaw] = &mut self.loops;
        let pitch = x.update(&g.x, bx, dt, on);
        let roll = y.update(&g.y, by, dt, on);
        let lift = z.update(&g.z, bz, dt, on);
        let turn = yaw.update(&g.yaw, wrap(o[index::SETPOINT_YAW] - o[index::MARKER_YAW]), dt, on);
        Command {
            roll_rad: -roll * deg,
            pitch_rad: pitch * deg,
            yaw_rate_radps: turn * deg * R::from_f64(self.interface.yaw_sign),
            // a height command needs no height loop: the vehicle has one inside (5.3)
            lift: if self.interface.input.is_pwm() { lift } else { target[2] },
        }
    }
}

impl<R: Scalar> ControlLaw<R> for Pid<R> {
    /// Go on in another state, as the package's take-off and landing services do: the loops keep what they
    /// remember.
    fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
    }

    fn reset(&mut self, mask: R::Mask) {
        self.fresh = self.fresh | mask;
    }

    #[inline(always)]
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let height = o[index::MARKER_Z];
        self.begin(height);
        let climbed =
            (self.start_m + R::from_f64(CLEAR_M)).lt(height) | R::from_f64(RAMP_END_PWM).lt(self.ramp_pwm);
        self.leave_ramp(self.ramping & climbed);
        let mut target = [o[index::SETPOINT_X], o[index::SETPOINT_Y], o[index::SETPOINT_Z]];
        if self.mode == Mode::Landing {
            target[2] = R::from_f64(CLEAR_M);
            self.idle = self.idle | height.le(target[2]);
        }
        let flying = !(self.ramping | self.idle);
        let u = self.fly(o, target, flying);
        self.ramp_pwm =
            R::select(self.ramping, self.ramp_pwm + R::from_f64(RAMP_PWM_PER_S * self.dt_s), self.ramp_pwm);
        let off = self.ramping | self.idle;
        let still = |v: R| R::select(off, R::zero(), v);
        let lift = R::select(self.idle, R::zero(), R::select(self.ramping, self.ramp_pwm, u.lift));
        let u = Command {
            roll_rad: still(u.roll_rad),
            pitch_rad: still(u.pitch_rad),
            yaw_rate_radps: still(u.yaw_rate_radps),
            lift,
        };
        self.interface.action(&u)
    }
}
