//! The identified linear model, stepped exactly: zero-order hold of commands and pushes, by the matrix
//! exponential.

mod vehicle_constants;

use nalgebra::SMatrix;

use crate::error::Result;
use crate::model::{AxisForm, Model, Tilt, VerticalInput};
use crate::scalar::{Scalar, dot};

pub use vehicle_constants::VehicleConstants;

/// State of motion. World frame: x right, y forward, z up; right-handed angles; +pitch accelerates to +x, +roll to -y
/// at zero yaw.
#[derive(Debug, Clone, Copy)]
pub struct State<R> {
    /// Position of the centre of mass.
    pub pos_m: [R; 3],
    /// Velocity of the centre of mass.
    pub vel_mps: [R; 3],
    /// Roll, pitch, yaw.
    pub att_rad: [R; 3],
    /// Their rates.
    pub rate_radps: [R; 3],
    /// Second state of the vertical and of the yaw form: the rate itself for a second-order form, the lagged
    /// push for a first-order one.
    pub aux: [R; 2],
}

/// Commands, constant over a control tick.
#[derive(Debug, Clone, Copy)]
pub struct Command<R> {
    /// Roll angle; positive accelerates to -y at zero yaw.
    pub roll_rad: R,
    /// Pitch angle; positive accelerates to +x at zero yaw.
    pub pitch_rad: R,
    /// In the vehicle's own sign: positive turns clockwise on the thesis's Crazyflie (5.2).
    pub yaw_rate_radps: R,
    /// Height in metres or thrust in PWM counts, according to the model's vertical input.
    pub lift: R,
}

/// Contributions of effects to the motion: accelerations in the world frame, angular accelerations about the body
/// axes.
#[derive(Debug, Clone, Copy)]
pub struct Accelerations<R> {
    /// Linear accelerations along x, y, z.
    pub acc_mps2: [R; 3],
    /// Angular accelerations: roll, pitch, yaw.
    pub ang_radps2: [R; 3],
}

/// Sine and cosine of a yaw.
#[derive(Debug, Clone, Copy)]
pub(crate) struct YawRotation<R> {
    pub sin: R,
    pub cos: R,
}

impl<R: Scalar> State<R> {
    /// At rest at the origin.
    #[inline(always)]
    pub fn rest() -> Self {
        let o = [R::zero(); 3];
        State { pos_m: o, vel_mps: o, att_rad: o, rate_radps: o, aux: [R::zero(); 2] }
    }
}

impl<R: Scalar> Accelerations<R> {
    /// Returns zero on all axes.
    #[inline(always)]
    pub fn none() -> Self {
        Accelerations { acc_mps2: [R::zero(); 3], ang_radps2: [R::zero(); 3] }
    }

    #[inline(always)]
    pub(crate) fn add(&mut self, other: &Self) {
        for i in 0..3 {
            self.acc_mps2[i] += other.acc_mps2[i];
            self.ang_radps2[i] += other.ang_radps2[i];
        }
    }
}

impl<R: Scalar> Command<R> {
    /// Level, no turn, and the given height or PWM.
    #[inline(always)]
    pub fn level(lift: R) -> Self {
        Command { roll_rad: R::zero(), pitch_rad: R::zero(), yaw_rate_radps: R::zero(), lift }
    }
}

/// One axis over one step: new (x, w) and the rate x' at the end, each linear in (x, w, input, push).
#[derive(Debug, Clone, Copy)]
struct AxisStep<R> {
    x: [R; 4],
    w: [R; 4],
    rate: [R; 3],
    offset: R,
}

impl<R: Scalar> AxisStep<R> {
    fn numbers(&mut self) -> impl Iterator<Item = &mut R> {
        self.x.iter_mut().chain(&mut self.w).chain(&mut self.rate).chain([&mut self.offset])
    }

    fn new(form: &AxisForm, h_s: f64) -> Self {
        let mut m = SMatrix::<f64, 4, 4>::zeros();
        for i in 0..2 {
            for j in 0..2 {
                m[(i, j)] = form.a[i][j];
            }
            m[(i, 2)] = form.u[i];
            m[(i, 3)] = form.push[i];
        }
        let e = (m * h_s).exp();
        let row = |i: usize| std::array::from_fn(|j| R::from_f64(e[(i, j)]));
        AxisStep {
            x: row(0),
            w: row(1),
            rate: [form.a[0][0], form.a[0][1], form.u[0]].map(R::from_f64),
            offset: R::from_f64(form.offset),
        }
    }

    #[inline(always)]
    fn step(&self, x: R, w: R, u: R, push: R) -> (R, R, R) {
        let u = u - self.offset;
        let held = [x, w, u, push];
        let (x1, w1) = (dot(&self.x, held), dot(&self.w, held));
        (x1, w1, self.rate[0] * x1 + self.rate[1] * w1 + self.rate[2] * u)
    }
}

/// One tilt axis with the sideways motion that it causes: rows for angle, rate, velocity and distance gained
/// along the body axis.
#[derive(Debug, Clone, Copy)]
struct TiltStep<R> {
    angle: [R; 3],
    rate: [R; 3],
    gained_mps: [R; 3],
    gained_m: [R; 3],
    /// A push on the angle is a command of push / gain.
    per_push: R,
}

impl<R: Scalar> TiltStep<R> {
    fn numbers(&mut self) -> impl Iterator<Item = &mut R> {
        let rows = [&mut self.angle, &mut self.rate, &mut self.gained_mps, &mut self.gained_m];
        rows.into_iter().flatten().chain([&mut self.per_push])
    }

    #[inline(always)]
    fn step(&self, angle: R, rate: R, command: R, push: R) -> [R; 4] {
        let u = command + push * self.per_push;
        let held = [angle, rate, u];
        [
            dot(&self.angle, held),
            dot(&self.rate, held),
            dot(&self.gained_mps, held),
            dot(&self.gained_m, held),
        ]
    }
}

/// The model over one step of fixed length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plant<R> {
    roll: TiltStep<R>,
    pitch: TiltStep<R>,
    yaw: AxisStep<R>,
    vertical: AxisStep<R>,
    /// Remaining share of a velocity, the distance that it carries, and both for a constant acceleration (drag of
    /// 4.15; none in the thesis).
    keep: R,
    carry_s: R,
    acc_s: R,
    acc_s2: R,
}

impl<R: Scalar> Plant<R> {
    /// All of its numbers, for derivatives of each.
    pub(crate) fn numbers(&mut self) -> impl Iterator<Item = &mut R> {
        let tilts = self.roll.numbers().chain(self.pitch.numbers());
        let axes = self.yaw.numbers().chain(self.vertical.numbers());
        tilts.chain(axes).chain([&mut self.keep, &mut self.carry_s, &mut self.acc_s, &mut self.acc_s2])
    }

    /// Discretise for steps of `h_s` seconds.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] if the model lacks the vertical input.
    pub fn new(model: &Model, input: VerticalInput, h_s: f64) -> Result<Self> {
        let (g, drag) = (model.lateral.gravity.value, model.lateral.drag.value);
        // Matrices of static size: nalgebra multiplies dynamic ones with a kernel that picks fused
        // multiply-add at run time, and the last bits would depend on the machine.
        let tilt_step = |tilt: &Tilt| {
            // states: distance, velocity, angle, rate; input: commanded angle
            let mut m = SMatrix::<f64, 5, 5>::zeros();
            m[(0, 1)] = 1.0;
            m[(1, 1)] = -drag;
            m[(1, 2)] = g;
            m[(2, 3)] = 1.0;
            m[(3, 2)] = -tilt.stiffness.value;
            m[(3, 3)] = -tilt.damping.value;
            m[(3, 4)] = tilt.gain.value;
            let e = (m * h_s).exp();
            let row = |i: usize| [2, 3, 4].map(|j| R::from_f64(e[(i, j)]));
            TiltStep {
                angle: row(2),
                rate: row(3),
                gained_mps: row(1),
                gained_m: row(0),
                per_push: R::from_f64(1.0 / tilt.gain.value),
            }
        };
        // states: distance, velocity; input: acceleration
        let e = (SMatrix::<f64, 3, 3>::new(0.0, 1.0, 0.0, 0.0, -drag, 1.0, 0.0, 0.0, 0.0) * h_s).exp();
        let form = model.vertical(input)?.form(g);
        Ok(Plant {
            roll: tilt_step(&model.roll),
            pitch: tilt_step(&model.pitch),
            yaw: AxisStep::new(&model.yaw.form(), h_s),
            vertical: AxisStep::new(&form, h_s),
            keep: R::from_f64(e[(1, 1)]),
            carry_s: R::from_f64(e[(0, 1)]),
            acc_s: R::from_f64(e[(1, 2)]),
            acc_s2: R::from_f64(e[(0, 2)]),
        })
    }

    /// Returns the state one step later, and the heading at mid-step, with constant command and push. Exact for the
    /// linear model; a turning vehicle's sideways acceleration is taken along its heading at mid-step.
    #[inline(always)]
    pub fn advance(
        &self,
        x: &State<R>,
        u: &Command<R>,
        push: &Accelerations<R>,
    ) -> (State<R>, YawRotation<R>) {
        let [roll, roll_rate, right_mps, right_m] =
            self.roll.step(x.att_rad[0], x.rate_radps[0], u.roll_rad, push.ang_radps2[0]);
        let [pitch, pitch_rate, front_mps, front_m] =
            self.pitch.step(x.att_rad[1], x.rate_radps[1], u.pitch_rad, push.ang_radps2[1]);
        let (yaw, yaw_aux, yaw_rate) =
            self.yaw.step(x.att_rad[2], x.aux[1], u.yaw_rate_radps, push.ang_radps2[2]);
        let (z, z_aux, z_rate) = self.vertical.step(x.pos_m[2], x.aux[0], u.lift, push.acc_mps2[2]);
        let (sin, cos) = (R::from_f64(0.5) * (x.att_rad[2] + yaw)).sin_cos();
        // body x gains from pitch, body y loses from roll
        let dv = [cos * front_mps + sin * right_mps, sin * front_mps - cos * right_mps];
        let dp = [cos * front_m + sin * right_m, sin * front_m - cos * right_m];
        let mut next = State {
            pos_m: [R::zero(), R::zero(), z],
            vel_mps: [R::zero(), R::zero(), z_rate],
            att_rad: [roll, pitch, yaw],
            rate_radps: [roll_rate, pitch_rate, yaw_rate],
            aux: [z_aux, yaw_aux],
        };
        for i in 0..2 {
            next.pos_m[i] = x.pos_m[i] + self.carry_s * x.vel_mps[i] + dp[i] + self.acc_s2 * push.acc_mps2[i];
            next.vel_mps[i] = self.keep * x.vel_mps[i] + dv[i] + self.acc_s * push.acc_mps2[i];
        }
        (next, YawRotation { sin, cos })
    }
}
