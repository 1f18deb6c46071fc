//! One pass of the simulator over some directions of the unknowns.

use crazyflie_env::dual::DualNumber;
use crazyflie_env::model::Model;
use crazyflie_env::plant::{Command, State};
use crazyflie_env::scalar::Scalar;
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::world::World;

use super::flight::{Flight, with_lags};

/// Directions of one pass: all unknowns do not fit one dual.
pub(super) struct DerivativePass<const D: usize>
where
    DualNumber<D>: SimScalar<Mask = bool>,
{
    pub(super) first: usize,
    pub(super) world: World<DualNumber<D>>,
}

/// The start state of twelve numbers: position, velocity, attitude, rates.
pub(super) fn start_state<const D: usize>(
    model: &Model,
    flight: &Flight,
    number: impl Fn(usize) -> DualNumber<D>,
) -> State<DualNumber<D>> {
    let triple = |from: usize| std::array::from_fn(|i| number(from + i));
    let (pos_m, vel_mps, att_rad, rate_radps) = (triple(0), triple(3), triple(6), triple(9));
    let aux = [DualNumber::from_f64(0.0); 2];
    with_lags(model, flight.input, State { pos_m, vel_mps, att_rad, rate_radps, aux })
}

/// A number of the pass whose directions begin with the unknown `first`.
pub(super) fn variable<const D: usize>(first: usize, value: f64, unknown: usize) -> DualNumber<D> {
    match unknown.checked_sub(first) {
        Some(direction) if direction < D => DualNumber::variable(value, direction),
        _ => DualNumber::from_f64(value),
    }
}

/// A command without slopes.
pub(super) fn dual_command<const D: usize>(u: &Command<f64>) -> Command<DualNumber<D>> {
    let [roll_rad, pitch_rad, yaw_rate_radps, lift] =
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift].map(DualNumber::from_f64);
    Command { roll_rad, pitch_rad, yaw_rate_radps, lift }
}
