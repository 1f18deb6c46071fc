//! Linear-quadratic regulator on the identified model, with an observer over camera and IMU.

use nalgebra::SVector;

use super::observer::{DiscreteModel, Observer, costs};
use super::riccati::regulator;
use super::{Batch, ControlLaw, ControllerContext, Entry, Mode, defaults, options};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::Result;
use crazyflie_env::estimator::{BELIEF, SensorNoise};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, dot};

// deviations that cost 1 in a tick (Bryson's rule), and the limit of position errors
options! {
    position_m: f64 = 0.1, "the position error that costs 1 in a tick; smaller is quicker";
    velocity_mps: f64 = 0.4, "the velocity error that does";
    height_m: f64 = 0.1, "the height error that does";
    yaw_deg: f64 = 10.0, "the heading error that does";
    tilt_deg: f64 = 8.0, "the tilt command that costs 1; larger is quicker";
    yaw_rate_degps: f64 = 40.0, "the yaw-rate command that does";
    lift_share: f64 = 0.1, "the lift command that does, as a share of the greatest";
    reach_m: f64 = 1.0, "farther position errors are taken as this far";
    belief: SensorNoise = SensorNoise::default(), BELIEF;
}

pub(super) const ENTRY: Entry = Entry {
    name: "lqr",
    also: None,
    about: "Linear-quadratic regulator on the identified model, all states by a Kalman filter over camera and IMU, with trims for what the model lacks",
    source: "Discrete algebraic Riccati equation of the twelve-state form (4.14, 4.15) over one tick, exact for held commands; Anderson and Moore, \
             Optimal Control: Linear Quadratic Methods, 1990",
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: defaults::<Options>,
    build: |given, site| Ok(Box::new(Batch::new(site.envs, Lqr::new(given.options()?, site)?))),
};

#[derive(Debug, Clone)]
struct Lqr<R: Scalar> {
    observer: Observer<R>,
    gain: [[R; 12]; 4],
    reach_m: R,
}

impl<R: Scalar> Lqr<R> {
    fn new(options: Options, site: &ControllerContext<'_>) -> Result<Self> {
        let model = DiscreteModel::from_context(site)?;
        let (q, r) = options.costs(site);
        let k = regulator(&model.a, &model.b, &q, &r)?;
        Ok(Lqr {
            observer: Observer::new(site, &model, &options.belief)?,
            gain: std::array::from_fn(|i| std::array::from_fn(|j| R::from_f64(k[(i, j)]))),
            reach_m: R::from_f64(options.reach_m),
        })
    }
}

impl Options {
    /// Diagonals of Q and R.
    pub(super) fn costs(&self, site: &ControllerContext<'_>) -> (SVector<f64, 12>, SVector<f64, 4>) {
        let (p, v, free) = (self.position_m, self.velocity_mps, f64::INFINITY);
        let q =
            costs([p, p, self.height_m, free, free, self.yaw_deg.to_radians(), v, v, free, free, free, free]);
        let tilt = self.tilt_deg.to_radians();
        (q, costs([tilt, tilt, self.yaw_rate_degps.to_radians(), self.lift_share * site.interface.lift_max]))
    }
}

impl<R: Scalar> ControlLaw<R> for Lqr<R> {
    fn set_mode(&mut self, mode: Mode) {
        self.observer.set_mode(mode);
    }

    fn reset(&mut self, mask: R::Mask) {
        self.observer.reset(mask);
    }

    #[inline(always)]
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let seen = self.observer.update(o);
        let mut off = seen.off;
        for slot in &mut off[..3] {
            *slot = slot.clamp(-self.reach_m, self.reach_m);
        }
        let still = seen.still;
        let less = |i: usize| dot(&self.gain[i], off);
        let u = Command {
            roll_rad: still.roll_rad - less(0),
            pitch_rad: still.pitch_rad - less(1),
            yaw_rate_radps: still.yaw_rate_radps - less(2),
            lift: still.lift - less(3),
        };
        self.observer.action(&u, seen.idle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::action::Interface;
    use crazyflie_env::model::{Model, VerticalInput};

    /// The closed loop of every vertical form is stable on the model that it was made for.
    #[test]
    fn the_gain_stabilises_every_form() {
        let model = Model::thesis();
        for input in VerticalInput::ALL {
            let site = ControllerContext {
                model: &model,
                interface: Interface::from_model(&model, input).unwrap(),
                tick_s: 0.02,
                envs: 1,
                mode: Mode::Automatic,
            };
            let discrete = DiscreteModel::from_context(&site).unwrap();
            let (q, r) = Options::default().costs(&site);
            let k = regulator(&discrete.a, &discrete.b, &q, &r).unwrap();
            let closed = discrete.a - discrete.b * k;
            let radius = closed.complex_eigenvalues().iter().map(|e| e.norm()).fold(0.0, f64::max);
            assert!(radius < 0.995, "{input:?}: {radius}");
        }
    }
}
