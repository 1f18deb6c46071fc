//! Estimates all states of the declared model, and the vehicle's deviation from the model, from observation rows
//! alone.

use nalgebra::{SMatrix, SVector};

use super::landing::Landing;
use super::{ControllerContext, Mode};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
use crazyflie_env::model::AxisForm;
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, dot, tabulate, wrap};

/// Time constant of the trim that learns the unexplained part.
const TRIM_S: f64 = 0.4;
/// A set-point that moves or turns away faster than this has jumped.
const JUMP_MPS: f64 = 2.0;
const JUMP_MPS2: f64 = 3.0;

/// The model over one tick, exact for held commands: x+ = A x + B u.
#[derive(Debug, Clone)]
pub(super) struct DiscreteModel {
    pub a: SMatrix<f64, 12, 12>,
    pub b: SMatrix<f64, 12, 4>,
}

/// One row: where the vehicle is against where it should be.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrackingError<R: Scalar> {
    /// The model's twelve states (4.14) less those of a vehicle that flies along with the set-point;
    /// positions and velocities along the vehicle's heading.
    pub off: [R; 12],
    /// The command with which it would stay there.
    pub still: Command<R>,
    /// Motors off: it has landed.
    pub idle: R::Mask,
}

/// Filter, trims and modes of one drone, or of lanes.
#[derive(Debug, Clone)]
pub(super) struct Observer<R: Scalar> {
    estimator: Estimator<R>,
    interface: Interface,
    landing: Landing<R>,
    gravity_mps2: f64,
    /// Angle, rate and command to the rate one tick later, and static gain, of roll and pitch.
    tilt: [[R; 3]; 2],
    per_tilt: [f64; 2],
    vertical: AxisForm,
    yaw: AxisForm,
    tick_s: f64,
    /// Missing part of the commands: roll and pitch in radians, lift in its unit.
    trim: [R; 3],
    /// Roll, pitch, their rates at the last tick; set-point of the last tick and its velocity.
    last: [R; 4],
    target: [R; 3],
    along_mps: [R; 3],
    push_mps2: [R; 2],
    fresh: R::Mask,
}

impl<R: Scalar> Observer<R> {
    pub(super) fn new(
        site: &ControllerContext<'_>,
        model: &DiscreteModel,
        belief: &SensorNoise,
    ) -> Result<Self> {
        let ControllerContext { interface, tick_s, mode, .. } = *site;
        let (zero, none) = (R::zero(), R::nothing());
        let gravity_mps2 = site.model.lateral.gravity.value;
        Ok(Observer {
            estimator: Estimator::new(site.model, interface.input, tick_s, belief),
            interface,
            landing: Landing::new(mode, tick_s),
            gravity_mps2,
            tilt: [0, 1].map(|i| {
                [model.a[(9 + i, 3 + i)], model.a[(9 + i, 9 + i)], model.b[(9 + i, i)]].map(R::from_f64)
            }),
            per_tilt: site.model.tilt_forms(interface.input).map(|tilt| tilt.input_per_output()),
            vertical: site.model.vertical(interface.input)?.form(gravity_mps2),
            yaw: site.model.yaw_form(interface.input),
            tick_s,
            trim: [zero; 3],
            last: [zero; 4],
            target: [zero; 3],
            along_mps: [zero; 3],
            push_mps2: [zero; 2],
            fresh: !none,
        })
    }

    pub(super) fn set_mode(&mut self, mode: Mode) {
        self.landing.set_mode(mode);
    }

    pub(super) fn reset(&mut self, mask: R::Mask) {
        self.estimator.reset(mask);
        self.fresh = self.fresh | mask;
    }

    #[inline(always)]
    pub(super) fn update(&mut self, o: &[R; OBSERVATION]) -> TrackingError<R> {
        let estimate = self.estimator.update(o);
        let height = self.landing.target(self.fresh, o[index::SETPOINT_Z], estimate.pos_m[2]);
        let target = [o[index::SETPOINT_X], o[index::SETPOINT_Y], height];
        self.learn(o, &estimate, &target);
        let per_tick = R::from_f64(1.0 / self.tick_s);
        let small = |v: R, limit: f64| R::select(v.abs().lt(R::from_f64(limit)), v, R::zero());
        let rates: [R; 3] = tabulate(
            #[inline(always)]
            |i| small((target[i] - self.target[i]) * per_tick, JUMP_MPS),
        );
        let turns: [R; 2] = tabulate(
            #[inline(always)]
            |i| small((rates[i] - self.along_mps[i]) * per_tick, JUMP_MPS2),
        );
        (self.target, self.along_mps) = (target, rates);
        self.last = [o[index::ROLL], o[index::PITCH], o[index::ROLL_RATE], o[index::PITCH_RATE]];
        self.fresh = R::nothing();
        self.against(o, &estimate, &target, &rates, &turns)
    }

    /// Learns the trim: the difference between the measured effect of the last command and the model's, as a command.
    #[inline(always)]
    fn learn(&mut self, o: &[R; OBSERVATION], estimate: &Estimate<R>, target: &[R; 3]) {
        let fresh = self.fresh;
        let u = self.interface.command(&std::array::from_fn(|i| o[index::LAST_ACTION + i]));
        let slow = R::from_f64(self.tick_s / TRIM_S);
        let lift = u.lift - R::from_f64(self.vertical.offset);
        let [z, vz] = [estimate.pos_m[2], estimate.vel_mps[2]];
        let f = &self.vertical;
        let unexplained = if f.u[0] == 0.0 {
            // the newest acceleration against that of the form
            o[index::ACC_Z]
                - R::from_f64(self.gravity_mps2)
                - (R::from_f64(f.a[1][0]) * z + R::from_f64(f.a[1][1]) * vz + R::from_f64(f.u[1]) * lift)
        } else {
            vz - (R::from_f64(f.a[0][0]) * z + R::from_f64(f.u[0]) * lift)
        };
        let asked = [u.roll_rad, u.pitch_rad];
        let mut missing = [R::zero(), R::zero(), unexplained * R::from_f64(1.0 / (f.u[0] + f.u[1]))];
        for i in 0..2 {
            let expected = dot(&self.tilt[i], [self.last[i], self.last[2 + i], asked[i] + self.trim[i]]);
            missing[i] = self.trim[i] + (o[index::ROLL_RATE + i] - expected) / self.tilt[i][2];
        }
        let limits =
            [self.interface.tilt_max_rad, self.interface.tilt_max_rad, 0.4 * self.interface.lift_max];
        for i in 0..3 {
            let learned = self.trim[i] + slow * (missing[i] - self.trim[i]);
            let limit = R::from_f64(limits[i]);
            self.trim[i] = R::select(fresh, R::zero(), learned.clamp(-limit, limit));
        }
        for i in 0..2 {
            let learned = self.push_mps2[i] + slow * (estimate.push_mps2[i] - self.push_mps2[i]);
            self.push_mps2[i] = R::select(fresh, R::zero(), learned);
        }
        for i in 0..3 {
            self.target[i] = R::select(fresh, target[i], self.target[i]);
            self.along_mps[i] = R::select(fresh, R::zero(), self.along_mps[i]);
        }
    }

    #[inline(always)]
    fn against(
        &self,
        o: &[R; OBSERVATION],
        e: &Estimate<R>,
        target: &[R; 3],
        rates: &[R; 3],
        turns: &[R; 2],
    ) -> TrackingError<R> {
        let (sin, cos) = e.yaw_rad.sin_cos();
        let along = |x: R, y: R| [cos * x + sin * y, cos * y - sin * x];
        let [front, left] = along(e.pos_m[0] - target[0], e.pos_m[1] - target[1]);
        let [front_mps, left_mps] = along(e.vel_mps[0] - rates[0], e.vel_mps[1] - rates[1]);
        // against a push the vehicle leans, and into a turn of the set-point
        let [lean_x, lean_y] = along(self.push_mps2[0] - turns[0], self.push_mps2[1] - turns[1]);
        let per_g = R::from_f64(1.0 / self.gravity_mps2);
        let (lean_roll, lean_pitch) = (lean_y * per_g, -lean_x * per_g);
        let zero = R::zero();
        let f = &self.vertical;
        let (climb, lift) = if f.u[0] == 0.0 {
            (
                e.vel_mps[2] - rates[2],
                (-R::from_f64(f.a[1][0]) * target[2] - R::from_f64(f.a[1][1]) * rates[2])
                    * R::from_f64(1.0 / f.u[1]),
            )
        } else {
            (zero, (rates[2] - R::from_f64(f.a[0][0]) * target[2]) * R::from_f64(1.0 / f.u[0]))
        };
        let turned = wrap(e.yaw_rad - o[index::SETPOINT_YAW]);
        let turning = if self.yaw.u[0] == 0.0 { o[index::YAW_RATE] } else { zero };
        let height = e.pos_m[2] - target[2];
        let (roll, pitch) = (o[index::ROLL] - lean_roll, o[index::PITCH] - lean_pitch);
        let (roll_rate, pitch_rate) = (o[index::ROLL_RATE], o[index::PITCH_RATE]);
        TrackingError {
            off: [
                front, left, height, roll, pitch, turned, front_mps, left_mps, climb, roll_rate, pitch_rate,
                turning,
            ],
            still: Command {
                roll_rad: lean_roll * R::from_f64(self.per_tilt[0]) - self.trim[0],
                pitch_rad: lean_pitch * R::from_f64(self.per_tilt[1]) - self.trim[1],
                yaw_rate_radps: zero,
                lift: lift + R::from_f64(f.offset) - self.trim[2],
            },
            idle: self.landing.idle,
        }
    }

    /// The action of a command: none where the vehicle has landed.
    #[inline(always)]
    pub(super) fn action(&self, u: &Command<R>, idle: R::Mask) -> [R; ACTION] {
        let off = self.interface.action(&Command::level(R::zero()));
        let on = self.interface.action(u);
        tabulate(
            #[inline(always)]
            |i| R::select(idle, off[i], on[i]),
        )
    }
}

impl DiscreteModel {
    /// Discretises the declared model.
    ///
    /// # Errors
    /// [`crazyflie_env::Error::Unknown`] if it lacks the vertical form.
    pub(super) fn from_context(site: &ControllerContext<'_>) -> Result<Self> {
        let whole = site.model.state_space(site.interface.input)?;
        let (a, b) = whole.discrete(site.tick_s);
        Ok(DiscreteModel { a, b })
    }
}

/// 1 over the square of each size: what costs 1 (Bryson's rule).
pub(super) fn costs<const N: usize>(sizes: [f64; N]) -> SVector<f64, N> {
    SVector::from(sizes.map(|size| if size.is_finite() { 1.0 / (size * size) } else { 0.0 }))
}
