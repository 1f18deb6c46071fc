//! The PID of `crazyflie_ros` (W. Hoenig, package `crazyflie_controller`), the controller that the thesis flew and tuned (7.2).
//!
//! Signs: error = reference - measured, gains positive, right-handed frames. The vehicle's own command signs (roll to -y, the yaw rate
//! of 5.2) are applied to the output, which makes table 7.1's negative gains. Written once, for one drone or for lanes.

use crate::error::{Result, unknown};
use crate::lanes::{LANES, LaneMask, Lanes};
use crate::observation::{ACTION, Interface, OBSERVATION, wrap};
use crate::plant::Command;
use crate::real::{Real, tabulate};

/// One loop: output = kp e + ki clamp(sum e dt) + kd de/dt, clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loop {
    pub kp: f64,
    pub ki: f64,
    pub kd: f64,
    /// Limits of the integral of the error.
    pub integral: [f64; 2],
    pub output: [f64; 2],
}

/// The four loops. Pitch (x) and roll (y) give degrees per metre, yaw deg/s per radian, height PWM counts per metre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    pub x: Loop,
    pub y: Loop,
    pub z: Loop,
    pub yaw: Loop,
}

const fn gains(kp: f64, ki: f64, kd: f64, integral: f64, output: [f64; 2]) -> Loop {
    Loop { kp, ki, kd, integral: [-integral, integral], output }
}

impl Gains {
    /// Table 7.1, "new": what the thesis's PID tuner found. The table has no integral clamps; the package's are used.
    pub const THESIS: Gains = Gains {
        x: gains(12.0, 0.06, 10.0, 0.1, [-10.0, 10.0]),
        y: gains(12.0, 0.06, 10.0, 0.1, [-10.0, 10.0]),
        z: gains(10781.90, 5196.65, 638.14, 1000.0, [0.0, 60000.0]),
        yaw: gains(20.0, 0.0, 5.0, 0.0, [-200.0, 200.0]),
    };

    /// `crazyflie_ros` defaults (config/crazyflie2.yaml): the package that the thesis calls "old", which it does not print.
    pub const CRAZYFLIE_ROS: Gains = Gains {
        x: gains(40.0, 2.0, 20.0, 0.1, [-10.0, 10.0]),
        y: gains(40.0, 2.0, 20.0, 0.1, [-10.0, 10.0]),
        z: gains(5000.0, 3500.0, 6000.0, 1000.0, [10000.0, 60000.0]),
        yaw: gains(200.0, 0.0, 20.0, 0.0, [-200.0, 200.0]),
    };

    /// The height loop in parts of the PWM that carries the vehicle: the same acceleration per metre on a vehicle with another hover PWM as on the
    /// thesis's (39 342.5, read off 5.4).
    #[must_use]
    pub fn for_hover(mut self, hover_pwm: f64) -> Gains {
        let by = hover_pwm / THESIS_HOVER_PWM;
        let z = &mut self.z;
        (z.kp, z.ki, z.kd) = (by * z.kp, by * z.ki, by * z.kd);
        z.output = z.output.map(|limit| by * limit);
        self
    }

    /// "thesis" or "crazyflie_ros".
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Gains> {
        match name {
            "thesis" => Ok(Gains::THESIS),
            "crazyflie_ros" => Ok(Gains::CRAZYFLIE_ROS),
            _ => Err(unknown("gains", name, ["thesis", "crazyflie_ros"])),
        }
    }
}

/// What carries the thesis's vehicle by 5.4.
const THESIS_HOVER_PWM: f64 = 39_342.5;

/// What one loop remembers.
#[derive(Debug, Clone, Copy)]
struct Memory<R> {
    integral: R,
    last: R,
}

impl<R: Real> Memory<R> {
    fn new() -> Self {
        Memory { integral: R::zero(), last: R::zero() }
    }

    /// As pid.hpp: integrate and clamp, derivative of the error, clamp the sum. Only lanes of `on` remember.
    #[inline(always)]
    fn update(&mut self, l: &Loop, error: R, dt_s: f64, on: R::Mask) -> R {
        let integral = (self.integral + error * R::of(dt_s)).clamp(R::of(l.integral[0]), R::of(l.integral[1]));
        let slope = (error - self.last) * R::of(1.0 / dt_s);
        self.integral = R::select(on, integral, self.integral);
        self.last = R::select(on, error, self.last);
        (R::of(l.kp) * error + R::of(l.kd) * slope + R::of(l.ki) * integral).clamp(R::of(l.output[0]), R::of(l.output[1]))
    }
}

/// What the package's state machine is told to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Hold the set-point from the first tick, as from a hover: the height integral is preset to what carries the weight.
    Automatic,
    /// From the floor: ramp the thrust by 10000 PWM/s until 5 cm above the start (or 50000 PWM), then hold the set-point.
    Takeoff,
    /// Hold the set-point, with the height 5 cm above the floor; below that, motors off.
    Landing,
}

impl Mode {
    /// "automatic", "takeoff" or "landing".
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Mode> {
        match name {
            "automatic" => Ok(Mode::Automatic),
            "takeoff" => Ok(Mode::Takeoff),
            "landing" => Ok(Mode::Landing),
            _ => Err(unknown("controller mode", name, ["automatic", "takeoff", "landing"])),
        }
    }
}

const RAMP_PWM_PER_S: f64 = 10_000.0;
const RAMP_END_PWM: f64 = 50_000.0;
const CLEAR_M: f64 = 0.05;

/// The controller of one drone, or of sixteen.
#[derive(Debug, Clone)]
pub struct Pid<R: Real> {
    gains: Gains,
    interface: Interface,
    dt_s: f64,
    mode: Mode,
    x: Memory<R>,
    y: Memory<R>,
    z: Memory<R>,
    yaw: Memory<R>,
    /// Ramping up from the floor; thrust so far; height at the start.
    ramping: R::Mask,
    ramp_pwm: R,
    start_m: R,
    /// Landed: motors off.
    idle: R::Mask,
    fresh: R::Mask,
}

impl<R: Real> Pid<R> {
    /// With the given gains and command interface, called every `dt_s` seconds.
    pub fn new(gains: Gains, interface: Interface, dt_s: f64, mode: Mode) -> Self {
        let (memory, none) = (Memory::new(), R::nothing());
        let mut pid = Pid {
            gains,
            interface,
            dt_s,
            mode,
            x: memory,
            y: memory,
            z: memory,
            yaw: memory,
            ramping: none,
            ramp_pwm: R::zero(),
            start_m: R::zero(),
            idle: none,
            fresh: none,
        };
        pid.reset(!none);
        pid
    }

    /// Go on in another state, as the package's take-off and landing services do: the loops keep what they remember.
    pub fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
    }

    /// Forget the flight in the lanes of `mask`.
    pub fn reset(&mut self, mask: R::Mask) {
        self.fresh = self.fresh | mask;
    }

    /// The action for an observation row.
    #[inline(always)]
    pub fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let height = o[2];
        self.begin(height);
        let climbed = (self.start_m + R::of(CLEAR_M)).lt(height) | R::of(RAMP_END_PWM).lt(self.ramp_pwm);
        self.leave_ramp(self.ramping & climbed);
        let mut target = [o[16], o[17], o[18]];
        if self.mode == Mode::Landing {
            target[2] = R::of(CLEAR_M);
            self.idle = self.idle | height.le(target[2]);
        }
        let flying = !(self.ramping | self.idle);
        let u = self.fly(o, target, flying);
        self.ramp_pwm = R::select(self.ramping, self.ramp_pwm + R::of(RAMP_PWM_PER_S * self.dt_s), self.ramp_pwm);
        let off = self.ramping | self.idle;
        let still = |v: R| R::select(off, R::zero(), v);
        let lift = R::select(self.idle, R::zero(), R::select(self.ramping, self.ramp_pwm, u.lift));
        let u = Command { roll_rad: still(u.roll_rad), pitch_rad: still(u.pitch_rad), yaw_rate_radps: still(u.yaw_rate_radps), lift };
        self.interface.action(&u)
    }

    /// First call of an episode.
    #[inline(always)]
    fn begin(&mut self, height: R) {
        let fresh = self.fresh;
        if !R::any(fresh) {
            return;
        }
        let zero = |v: R| R::select(fresh, R::zero(), v);
        for m in [&mut self.x, &mut self.y, &mut self.z, &mut self.yaw] {
            *m = Memory { integral: zero(m.integral), last: zero(m.last) };
        }
        let hover = R::of(self.interface.hover_lift / self.gains.z.ki);
        self.z.integral = R::select(fresh, hover, self.z.integral);
        self.ramp_pwm = zero(self.ramp_pwm);
        self.start_m = R::select(fresh, height, self.start_m);
        let ramp = self.mode == Mode::Takeoff && self.interface.input.is_pwm();
        self.ramping = if ramp { self.ramping | fresh } else { self.ramping & !fresh };
        self.idle = self.idle & !fresh;
        self.fresh = R::nothing();
    }

    /// Off the ground: as the package does, reset the loops and preset the height integral to the thrust that lifted.
    #[inline(always)]
    fn leave_ramp(&mut self, lifted: R::Mask) {
        let per_ki = R::of(1.0 / self.gains.z.ki);
        let zero = |v: R| R::select(lifted, R::zero(), v);
        for m in [&mut self.x, &mut self.y, &mut self.z, &mut self.yaw] {
            *m = Memory { integral: zero(m.integral), last: zero(m.last) };
        }
        self.z.integral = R::select(lifted, self.ramp_pwm * per_ki, self.z.integral);
        self.ramping = self.ramping & !lifted;
    }

    /// The state Automatic: the target in the vehicle's frame, then four loops.
    #[inline(always)]
    fn fly(&mut self, o: &[R; OBSERVATION], target: [R; 3], on: R::Mask) -> Command<R> {
        let e: [R; 3] = tabulate(
            #[inline(always)]
            |i| target[i] - o[i],
        );
        let [(sr, cr), (sp, cp), (sy, cy)] = [o[6].sin_cos(), o[7].sin_cos(), o[3].sin_cos()];
        let (front, left) = (cy * e[0] + sy * e[1], cy * e[1] - sy * e[0]);
        // world to body: yaw, then pitch, then roll
        let (bx, down) = (cp * front - sp * e[2], sp * front + cp * e[2]);
        let (by, bz) = (cr * left + sr * down, cr * down - sr * left);
        let deg = R::of(std::f64::consts::PI / 180.0);
        let (g, dt) = (self.gains, self.dt_s);
        let pitch = self.x.update(&g.x, bx, dt, on);
        let roll = self.y.update(&g.y, by, dt, on);
        let lift = self.z.update(&g.z, bz, dt, on);
        let turn = self.yaw.update(&g.yaw, wrap(o[19] - o[3]), dt, on);
        Command {
            roll_rad: -roll * deg,
            pitch_rad: pitch * deg,
            yaw_rate_radps: turn * deg * R::of(self.interface.yaw_sign),
            // a height command needs no height loop: the vehicle has one inside (5.3)
            lift: if self.interface.input.is_pwm() { lift } else { target[2] },
        }
    }
}

/// The controller for a batch of environments, row by row as they observe.
#[derive(Debug, Clone)]
pub struct PidBatch {
    tiles: Vec<Pid<Lanes>>,
    envs: usize,
}

impl PidBatch {
    pub fn new(envs: usize, gains: Gains, interface: Interface, dt_s: f64, mode: Mode) -> Self {
        PidBatch { tiles: vec![Pid::new(gains, interface, dt_s, mode); envs.div_ceil(LANES)], envs }
    }

    /// See [`Pid::set_mode`].
    pub fn set_mode(&mut self, mode: Mode) {
        self.tiles.iter_mut().for_each(|pid| pid.set_mode(mode));
    }

    /// Forget the flights of the environments that `of` names.
    pub fn reset(&mut self, of: impl Fn(usize) -> bool) {
        for (tile, pid) in self.tiles.iter_mut().enumerate() {
            pid.reset(LaneMask::from_bools(std::array::from_fn(|lane| of(tile * LANES + lane))));
        }
    }

    /// Actions (`envs` rows of [`ACTION`]) for observations (`envs` rows of [`OBSERVATION`]).
    ///
    /// # Errors
    /// [`crate::Error::Shape`].
    pub fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        crate::rows::shape("observations", self.envs * OBSERVATION, observations.len())?;
        crate::rows::shape("actions", self.envs * ACTION, actions.len())?;
        let rows = observations.chunks(LANES * OBSERVATION).zip(actions.chunks_mut(LANES * ACTION));
        for (pid, (rows, out)) in self.tiles.iter_mut().zip(rows) {
            let mut o = [Lanes::zero(); OBSERVATION];
            for (lane, row) in rows.chunks_exact(OBSERVATION).enumerate() {
                for (slot, value) in o.iter_mut().zip(row) {
                    slot.0[lane] = *value;
                }
            }
            let a = pid.act(&o);
            for (lane, row) in out.chunks_exact_mut(ACTION).enumerate() {
                for (slot, value) in row.iter_mut().zip(&a) {
                    *slot = value.0[lane];
                }
            }
        }
        Ok(())
    }
}
