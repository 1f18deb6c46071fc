//! The motor-level form of the vehicle: a rigid body with four motors on its diagonals, each with a lag, a
//! thrust curve and limits, behind the firmware's mixer and loops. Small angles are assumed nowhere.

mod linear;
mod loops;
pub(crate) mod mixer;

use crate::action::ActionLevel;
use crate::archive::Ledger;
use crate::model::{FULL_PWM, Model, Motors, Vertical, VerticalInput};
use crate::plant::{Accelerations, Command, State, YawRotation};
use crate::scalar::{Scalar, wrap};

use loops::{Loops, Memory};
use mixer::{MOTORS, SIDE_PER_ARM};

/// The firmware's rate loop runs at 500 Hz; no step is longer.
const LONGEST_STEP_S: f64 = 0.002;
/// Nearer to the vertical than this the angles' rates are those at this cosine: a vehicle that tumbles passes
/// through without a number being lost.
const LEAST_COS: f64 = 0.05;

/// Angular acceleration about the roll or pitch axis per thrust of a motor per mass of the vehicle, 1/m.
fn per_tilt(model: &Model, form: &Motors) -> f64 {
    model.vehicle.mass.value * SIDE_PER_ARM * model.vehicle.arm.value / form.tilt_inertia.value
}

/// As [`per_tilt`], about the yaw axis.
fn per_turn(model: &Model, form: &Motors) -> f64 {
    model.vehicle.mass.value * form.torque_per_thrust.value / form.yaw_inertia.value
}

/// What is remembered of a tile besides its motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MotorState<R> {
    /// What each motor gives, as the PWM that would give it for good.
    pwm: [R; 4],
    memory: Memory<R>,
}

/// What a step brings besides the state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MotorStep<R> {
    pub next: State<R>,
    pub heading: YawRotation<R>,
    /// Specific force along the body's z axis at the end of the step, the push taken as small.
    pub up_mps2: R,
}

/// A vehicle of this form, and what is remembered of all tiles.
#[derive(Debug)]
pub(crate) struct MotorVehicle<R> {
    level: ActionLevel,
    loops: Loops<R>,
    steps: u32,
    step_s: R,
    gravity_mps2: R,
    drag_ps: R,
    heave_ps: R,
    /// Share of the way to the commanded PWM in a step.
    follow: R,
    linear_share: R,
    /// Of one motor at full PWM, per mass of the vehicle.
    most_mps2: R,
    hover_pwm: R,
    /// Angular acceleration per thrust per mass of a motor: roll and pitch, yaw.
    per_tilt: R,
    per_turn: R,
    /// (tilt inertia - yaw inertia) / tilt inertia.
    gyroscopic: R,
    states: Vec<MotorState<R>>,
}

impl<R: Scalar> MotorVehicle<R> {
    /// Of a model whose motor form is commanded, stepped for `h_s` at a time; nothing for another form.
    pub(crate) fn new(model: &Model, input: VerticalInput, h_s: f64, tiles: usize) -> Option<Self> {
        let (VerticalInput::Motors, Some(Vertical::Motors(form))) = (input, &model.vertical.motors) else {
            return None;
        };
        let steps = (h_s / LONGEST_STEP_S - 1e-6).ceil().max(1.0);
        let step_s = h_s / steps;
        let gravity_mps2 = model.lateral.gravity.value;
        let (tilt, yaw) = (form.tilt_inertia.value, form.yaw_inertia.value);
        let state = MotorState { pwm: [R::zero(); 4], memory: Memory::new() };
        Some(MotorVehicle {
            level: ActionLevel::Attitude,
            loops: Loops::new(step_s, model.yaw.sign()),
            steps: steps as u32,
            step_s: R::from_f64(step_s),
            gravity_mps2: R::from_f64(gravity_mps2),
            drag_ps: R::from_f64(model.lateral.drag.value),
            heave_ps: R::from_f64(form.heave.value),
            follow: R::from_f64(1.0 - libm::exp(-step_s / form.lag.value)),
            linear_share: R::from_f64(form.linear_share.value),
            most_mps2: R::from_f64(0.25 * gravity_mps2 / form.curve(form.hover.value)),
            hover_pwm: R::from_f64(form.hover.value),
            per_tilt: R::from_f64(per_tilt(model, form)),
            per_turn: R::from_f64(per_turn(model, form)),
            gyroscopic: R::from_f64((tilt - yaw) / tilt),
            states: vec![state; tiles],
        })
    }

    /// The same vehicle, whose commands are those of another action level.
    pub(crate) fn at_level(self, level: ActionLevel) -> Self {
        MotorVehicle { level, ..self }
    }

    /// Begin flights in the lanes of `mask`: all motors have been giving the same. Returns the command that was
    /// in force, in the numbers of the action level.
    pub(crate) fn start(&mut self, tile: usize, mask: R::Mask, x: &State<R>, u: &Command<R>) -> Command<R> {
        let state = &mut self.states[tile];
        for pwm in &mut state.pwm {
            *pwm = R::select(mask, u.lift, *pwm);
        }
        state.memory.start(mask, x);
        match self.level {
            ActionLevel::Motors => {
                let lift = u.lift;
                Command { roll_rad: lift, pitch_rad: lift, yaw_rate_radps: lift, lift }
            }
            _ => *u,
        }
    }

    /// Thrust over weight of a tile, as the command of a model whose thrust is in proportion to it: what
    /// effects on the thrust go by.
    #[inline(always)]
    pub(crate) fn thrust_command(&self, tile: usize, x: &State<R>) -> Command<R> {
        let lift = self.thrust_mps2(&self.states[tile].pwm) * self.hover_pwm / self.gravity_mps2;
        Command { roll_rad: x.att_rad[0], pitch_rad: x.att_rad[1], yaw_rate_radps: R::zero(), lift }
    }

    /// Of one motor: thrust per mass of the vehicle.
    #[inline(always)]
    fn motor_mps2(&self, pwm: R) -> R {
        let share = pwm * R::from_f64(1.0 / FULL_PWM);
        let square = R::from_f64(1.0) - self.linear_share;
        self.most_mps2 * share * (self.linear_share + square * share)
    }

    #[inline(always)]
    fn thrust_mps2(&self, pwm: &[R; 4]) -> R {
        let [a, b, c, d] = *pwm;
        (self.motor_mps2(a) + self.motor_mps2(b)) + (self.motor_mps2(c) + self.motor_mps2(d))
    }

    /// The state a physics step later, with the push held.
    #[inline(always)]
    pub(crate) fn advance(
        &mut self,
        tile: usize,
        x: &State<R>,
        u: &Command<R>,
        push: &Accelerations<R>,
    ) -> MotorStep<R> {
        let mut state = self.states[tile];
        let mut next = *x;
        let h = self.step_s;
        let mut tilt = Attitude::new(&next.att_rad);
        let mut rates = tilt.body_rates(x.rate_radps);
        let mut heading = YawRotation { sin: R::zero(), cos: R::from_f64(1.0) };
        for _ in 0..self.steps {
            let asked = self.loops.motors(&mut state.memory, self.level, u, &next.att_rad, &rates);
            for (pwm, asked) in state.pwm.iter_mut().zip(asked) {
                *pwm += self.follow * (asked - *pwm);
            }
            let torques = self.turn(&state.pwm, &rates);
            for i in 0..3 {
                rates[i] += h * (torques[i] + push.ang_radps2[i]);
            }
            let angle_rates = tilt.angle_rates(&rates);
            let thrust = self.thrust_mps2(&state.pwm);
            let (sin, cos) = next.att_rad[2].sin_cos();
            heading = YawRotation { sin, cos };
            let acc = tilt.acceleration(thrust, &heading);
            for i in 0..3 {
                let before = next.vel_mps[i];
                let drag =
                    if i == 2 { self.heave_ps * before + self.gravity_mps2 } else { self.drag_ps * before };
                next.vel_mps[i] += h * (acc[i] + push.acc_mps2[i] - drag);
                next.pos_m[i] += h * R::from_f64(0.5) * (before + next.vel_mps[i]);
                next.att_rad[i] += h * angle_rates[i];
            }
            // a vehicle that rolls over comes round; its heading is wrapped where it is read
            next.att_rad = [wrap(next.att_rad[0]), wrap(next.att_rad[1]), next.att_rad[2]];
            tilt = Attitude::new(&next.att_rad);
            next.rate_radps = tilt.angle_rates(&rates);
        }
        next.aux = [R::zero(); 2];
        self.states[tile] = state;
        MotorStep { next, heading, up_mps2: self.thrust_mps2(&state.pwm) + push.acc_mps2[2] }
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
        [
            self.per_tilt * sums[0] + self.gyroscopic * q * r,
            self.per_tilt * sums[1] - self.gyroscopic * p * r,
            self.per_turn * sums[2],
        ]
    }

    /// What the gyroscope shows: rates about the body axes.
    #[inline(always)]
    pub(crate) fn gyro_radps(x: &State<R>) -> [R; 3] {
        Attitude::new(&x.att_rad).body_rates(x.rate_radps)
    }
}

impl<R: Scalar> MotorVehicle<R> {
    pub(crate) fn show_numbers(&mut self, tile: usize, ledger: &mut dyn Ledger<R>) {
        let state = &mut self.states[tile];
        ledger.numbers("motor_pwm", &mut state.pwm);
        state.memory.show_numbers(ledger);
    }
}

/// Sines and cosines of roll and pitch.
#[derive(Clone, Copy)]
struct Attitude<R> {
    roll: (R, R),
    pitch: (R, R),
}

impl<R: Scalar> Attitude<R> {
    #[inline(always)]
    fn new(att_rad: &[R; 3]) -> Self {
        Attitude { roll: att_rad[0].sin_cos(), pitch: att_rad[1].sin_cos() }
    }

    /// Rates about the body axes of a vehicle whose angles have these rates (thesis 4.3).
    #[inline(always)]
    fn body_rates(&self, [roll_rate, pitch_rate, yaw_rate]: [R; 3]) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = *self;
        [
            roll_rate - yaw_rate * sin_pitch,
            pitch_rate * cos_roll + yaw_rate * cos_pitch * sin_roll,
            yaw_rate * cos_pitch * cos_roll - pitch_rate * sin_roll,
        ]
    }

    /// The inverse of [`Self::body_rates`], bounded near the vertical.
    #[inline(always)]
    fn angle_rates(&self, &[p, q, r]: &[R; 3]) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = *self;
        let per_cos_pitch = cos_pitch / (cos_pitch * cos_pitch).max(R::from_f64(LEAST_COS * LEAST_COS));
        let yaw_rate = (q * sin_roll + r * cos_roll) * per_cos_pitch;
        [p + yaw_rate * sin_pitch, q * cos_roll - r * sin_roll, yaw_rate]
    }

    /// Of the thrust along the tilted axis, in the room.
    #[inline(always)]
    fn acceleration(&self, thrust: R, heading: &YawRotation<R>) -> [R; 3] {
        let Attitude { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = *self;
        let (front, right) = (thrust * sin_pitch * cos_roll, thrust * sin_roll);
        [
            heading.cos * front + heading.sin * right,
            heading.sin * front - heading.cos * right,
            thrust * cos_roll * cos_pitch,
        ]
    }
}
