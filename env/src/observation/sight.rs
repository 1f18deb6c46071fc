//! Every field available to an observation.

use super::choice::{ERROR, GATE_POS, OBSERVABLE, YAW_ERROR, is_of_surroundings, is_true_state};
use super::{EST_POS, Field, OBSERVATION, index};
use crate::estimator::Estimate;
use crate::plant::State;
use crate::rows::{STATE, state_index, state_row};
use crate::scalar::{Scalar, wrap};

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

/// Returns whether some of these fields are of the true state.
pub(crate) fn need_truth(fields: &[Field]) -> bool {
    fields.iter().any(is_true_state)
}

/// The numbers available to an observation, group by group; zeros for a true state or an estimate that is
/// not asked for.
pub(crate) struct Observable<'a, R> {
    own: &'a [R; OBSERVATION],
    truth: [R; EST_POS.first - OBSERVATION],
    estimate: [R; GATE_POS.first - EST_POS.first],
    surroundings: [R; OBSERVABLE - GATE_POS.first],
}

impl<'a, R: Scalar> Observable<'a, R> {
    #[inline(always)]
    pub(crate) fn new(
        needs_truth: bool,
        own: &'a [R; OBSERVATION],
        x: &State<R>,
        estimate: Option<Estimate<R>>,
        about: &Surroundings<R>,
    ) -> Self {
        let setpoint = |i: usize| own[index::SETPOINT_X + i];
        let mut truth = [R::zero(); EST_POS.first - OBSERVATION];
        if needs_truth {
            let mut state = state_row(x);
            state[state_index::YAW] = wrap(x.att_rad[2]);
            truth[..STATE].copy_from_slice(&state);
            for i in 0..3 {
                truth[ERROR.first - OBSERVATION + i] = setpoint(i) - x.pos_m[i];
            }
            truth[YAW_ERROR.first - OBSERVATION] = wrap(setpoint(3) - x.att_rad[2]);
        }
        let mut estimated = [R::zero(); GATE_POS.first - EST_POS.first];
        if let Some(Estimate { pos_m, vel_mps, yaw_rad, push_mps2 }) = estimate {
            let ([a, b, c], [d, e, f], [g, h, i]) = (pos_m, vel_mps, push_mps2);
            let turn = wrap(setpoint(3) - yaw_rad);
            estimated =
                [a, b, c, d, e, f, yaw_rad, g, h, i, setpoint(0) - a, setpoint(1) - b, setpoint(2) - c, turn];
        }
        let ([a, b, c], [d, e, f], [g, h, i]) = (about.gate_pos_m, about.next_gate_pos_m, about.obstacle_m);
        let surroundings =
            [a, b, c, wrap(about.gate_yaw_rad), d, e, f, wrap(about.next_gate_yaw_rad), g, h, i];
        Observable { own, truth, estimate: estimated, surroundings }
    }

    /// Returns the numbers of a field.
    #[inline(always)]
    pub(crate) fn field(&self, field: &Field) -> &[R] {
        let (numbers, first): (&[R], usize) = match field.first {
            0..OBSERVATION => (self.own, 0),
            first if first < EST_POS.first => (&self.truth, OBSERVATION),
            first if first < GATE_POS.first => (&self.estimate, EST_POS.first),
            _ => (&self.surroundings, GATE_POS.first),
        };
        &numbers[field.first - first..field.end() - first]
    }
}
