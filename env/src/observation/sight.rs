//! Every field available to an observation.

use super::{EST_POS, Field, OBSERVABLE, OBSERVATION, index, is_of_surroundings};
use crate::estimator::Estimate;
use crate::plant::State;
use crate::rows::{state_index, state_row};
use crate::scalar::{Scalar, tabulate, wrap};

/// Along each axis, where no obstacle is near: beyond any wall.
pub(crate) const NOTHING_NEAR_M: f64 = 10.0;

/// Surroundings of a drone: the gates that it has to fly through, and obstacles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surroundings<R> {
    /// Middle of the gate that is next, and the direction to fly through it.
    pub gate_pos_m: [R; 3],
    pub gate_yaw_rad: R,
    /// Position of the gate after that.
    pub next_gate_pos_m: [R; 3],
    pub next_gate_yaw_rad: R,
    /// From the drone to the nearest point of an obstacle; [`NOTHING_NEAR_M`] along each axis for none.
    pub obstacle_m: [R; 3],
}

impl<R: Scalar> Surroundings<R> {
    /// An empty room.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        let zero = R::zero();
        Surroundings {
            gate_pos_m: [zero; 3],
            gate_yaw_rad: zero,
            next_gate_pos_m: [zero; 3],
            next_gate_yaw_rad: zero,
            obstacle_m: [R::from_f64(NOTHING_NEAR_M); 3],
        }
    }
}

/// Returns whether a filter has to run for these fields.
pub(crate) fn need_estimate(fields: &[Field]) -> bool {
    fields.iter().any(|field| field.first >= EST_POS.first && !is_of_surroundings(field))
}

/// Returns every number available to an observation, in the order of [`super::ALL_FIELDS`]; those of the filter are
/// zero if there is none.
#[inline(always)]
pub(crate) fn observable<R: Scalar>(
    own: &[R; OBSERVATION],
    x: &State<R>,
    estimate: Option<Estimate<R>>,
    about: &Surroundings<R>,
) -> [R; OBSERVABLE] {
    let zero = R::zero();
    let setpoint_m = [own[index::SETPOINT_X], own[index::SETPOINT_Y], own[index::SETPOINT_Z]];
    let error = |pos_m: &[R; 3]| {
        tabulate::<R, 3>(
            #[inline(always)]
            |i| setpoint_m[i] - pos_m[i],
        )
    };
    let turn = |yaw_rad: R| wrap(own[index::SETPOINT_YAW] - yaw_rad);
    let mut all = [zero; OBSERVABLE];
    let mut end = 0;
    let mut add = |numbers: &[R]| {
        all[end..end + numbers.len()].copy_from_slice(numbers);
        end += numbers.len();
    };
    add(own);
    let mut state = state_row(x);
    state[state_index::YAW] = wrap(x.att_rad[2]);
    add(&state);
    add(&error(&x.pos_m));
    add(&[turn(x.att_rad[2])]);
    let Estimate { pos_m, vel_mps, yaw_rad, push_mps2 } = estimate.unwrap_or(Estimate {
        pos_m: [zero; 3],
        vel_mps: [zero; 3],
        yaw_rad: zero,
        push_mps2: [zero; 3],
    });
    add(&pos_m);
    add(&vel_mps);
    add(&[yaw_rad]);
    add(&push_mps2);
    add(&error(&pos_m));
    add(&[turn(yaw_rad)]);
    add(&about.gate_pos_m);
    add(&[wrap(about.gate_yaw_rad)]);
    add(&about.next_gate_pos_m);
    add(&[wrap(about.next_gate_yaw_rad)]);
    add(&about.obstacle_m);
    all
}
