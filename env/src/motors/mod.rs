//! The motor-level form of the vehicle: a rigid body with four motors on its diagonals, each with a lag, a
//! thrust curve and limits, behind the firmware's mixer and loops. Small angles are assumed nowhere.

mod body;
mod linear;
mod loops;
pub(crate) mod mixer;

use crate::action::ActionLevel;
use crate::archive::Ledger;
use crate::model::{FULL_PWM, Model, Motors, Vertical, VerticalInput};
use crate::plant::{Accelerations, Command, State, YawRotation};
use crate::scalar::Scalar;

pub use body::{Attitude, Motion, RigidBody};
use loops::{Loops, Memory};
pub use mixer::{MOTORS, SIDE_PER_ARM};

/// The firmware's rate loop runs at 500 Hz; no step is longer.
const LONGEST_STEP_S: f64 = 0.002;
/// Angular acceleration about the roll, pitch and yaw axis per thrust of a motor per mass of the vehicle, 1/m.
fn turn_per_thrust(model: &Model, form: &Motors) -> [f64; 3] {
    let mass_kg = model.vehicle.mass.value;
    let side_m = SIDE_PER_ARM * model.vehicle.arm.value;
    let [roll, pitch, yaw] = form.inertias_kgm2();
    [mass_kg * side_m / roll, mass_kg * side_m / pitch, mass_kg * form.torque_per_thrust.value / yaw]
}

/// State of a tile besides its motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MotorState<R> {
    /// Present thrust of each motor, as the PWM that would give it in the steady state.
    pwm: [R; 4],
    memory: Memory<R>,
}

/// A vehicle of this form, and what is remembered of all tiles.
#[derive(Debug)]
pub(crate) struct MotorVehicle<R> {
    level: ActionLevel,
    loops: Loops<R>,
    steps: u32,
    body: RigidBody<R>,
    hover_pwm: R,
    states: Vec<MotorState<R>>,
}

impl<R: Scalar> MotorVehicle<R> {
    /// Creates the vehicle of a model whose motor form is commanded, with steps of `h_s`; nothing for another form.
    pub(crate) fn new(model: &Model, input: VerticalInput, h_s: f64, tiles: usize) -> Option<Self> {
        let (VerticalInput::Motors, Some(Vertical::Motors(form))) = (input, &model.vertical.motors) else {
            return None;
        };
        let steps = (h_s / LONGEST_STEP_S - 1e-6).ceil().max(1.0);
        let step_s = h_s / steps;
        let gravity_mps2 = model.lateral.gravity.value;
        let [roll, pitch, yaw] = form.inertias_kgm2();
        let follow = form.lags_s().map(|lag_s| R::from_f64(1.0 - libm::exp(-step_s / lag_s)));
        let state = MotorState { pwm: [R::zero(); 4], memory: Memory::new() };
        Some(MotorVehicle {
            level: ActionLevel::Attitude,
            loops: Loops::new(step_s, model.yaw.sign(), &form.attitude_loop),
            steps: steps as u32,
            body: RigidBody {
                step_s: R::from_f64(step_s),
                gravity_mps2: R::from_f64(gravity_mps2),
                drag_ps: R::from_f64(model.lateral.drag.value),
                heave_ps: R::from_f64(form.heave.value),
                follow,
                linear_share: R::from_f64(form.linear_share.value),
                most_mps2: R::from_f64(0.25 * gravity_mps2 / form.curve(form.hover.value)),
                turn_per_thrust: turn_per_thrust(model, form).map(R::from_f64),
                gyroscopic: [(pitch - yaw) / roll, (yaw - roll) / pitch, (roll - pitch) / yaw]
                    .map(R::from_f64),
            },
            hover_pwm: R::from_f64(form.hover.value),
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
        let lift = self.body.thrust_mps2(&self.states[tile].pwm) * self.hover_pwm / self.body.gravity_mps2;
        Command { roll_rad: x.att_rad[0], pitch_rad: x.att_rad[1], yaw_rate_radps: R::zero(), lift }
    }

    /// The state a physics step later, with the push held; the heading before; and the specific force along the body's
    /// z axis at the end, the push taken as small.
    #[inline(always)]
    pub(crate) fn advance(
        &mut self,
        tile: usize,
        x: &State<R>,
        u: &Command<R>,
        push: &Accelerations<R>,
    ) -> (State<R>, YawRotation<R>, R) {
        let mut state = self.states[tile];
        let attitude = Attitude::new(x.att_rad);
        let rate_radps = attitude.body_rates(x.rate_radps);
        let mut motion = Motion { pos_m: x.pos_m, vel_mps: x.vel_mps, attitude, rate_radps };
        let mut heading = attitude.heading;
        for _ in 0..self.steps {
            heading = motion.attitude.heading;
            let (att_rad, rates) = (motion.attitude.angles_rad(), motion.rate_radps);
            let asked = self.loops.motors(&mut state.memory, self.level, u, &att_rad, &rates);
            self.body.step(&mut motion, &mut state.pwm, asked, push);
        }
        self.states[tile] = state;
        let next = State {
            pos_m: motion.pos_m,
            vel_mps: motion.vel_mps,
            att_rad: motion.attitude.angles_rad(),
            rate_radps: motion.attitude.angle_rates(&motion.rate_radps),
            aux: [R::zero(); 2],
        };
        (next, heading, self.body.thrust_mps2(&state.pwm) + push.acc_mps2[2])
    }

    /// Returns the gyroscope's reading: rates about the body axes.
    #[inline(always)]
    pub(crate) fn gyro_radps(x: &State<R>) -> [R; 3] {
        Attitude::new(x.att_rad).body_rates(x.rate_radps)
    }
}

impl<R: Scalar> MotorVehicle<R> {
    pub(crate) fn show_numbers(&mut self, tile: usize, ledger: &mut dyn Ledger<R>) {
        let state = &mut self.states[tile];
        ledger.numbers("motor_pwm", &mut state.pwm);
        state.memory.show_numbers(ledger);
    }
}
