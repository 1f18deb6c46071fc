//! Names available to an expression: the fields of observations that are measured or true, and a few numbers derived
//! from them.

use crate::action::ACTION;
use crate::error::{Result, find_named};
use crate::observation::{ALL_FIELDS, Field, OBSERVATION, Setpoint, YAW_ERROR, field};
use crate::plant::State;
use crate::scalar::{Scalar, wrap};

/// Distance to the set-point.
const DIST: Field =
    field("dist", YAW_ERROR.end(), 1, "m", [0.0, 20.0]).about("true distance to the set-point");
const SPEED: Field =
    field("speed", DIST.end(), 1, "m/s", [0.0, 35.0]).about("magnitude of the true velocity");
const TILT: Field = field("tilt", SPEED.end(), 1, "rad", [0.0, 4.5])
    .about("root of the sum of squares of true roll and pitch");
const RATE2: Field =
    field("rate2", TILT.end(), 1, "rad^2/s^2", [0.0, 3700.0]).about("sum of squares of the true rates");
const ACTION_CHANGE: Field = field("action_change", RATE2.end(), ACTION, "1", [-2.0, 2.0])
    .about("this step's action minus that of the step before");
const IMPACT: Field = field("impact_mps", ACTION_CHANGE.end(), 1, "m/s", [0.0, 20.0])
    .about("speed of touching the floor in this step");
const TIME: Field = field("time_s", IMPACT.end(), 1, "s", [0.0, 1e6]).about("time since the episode began");
const BROKEN: Field =
    field("broken", TIME.end(), 1, "1", [0.0, 1.0]).about("1 where it crashed, collided or left the room");
const ARRIVED: Field = field("arrived", BROKEN.end(), 1, "1", [0.0, 1.0])
    .about("1 where the task says that it is where it should be");
const TASK_REWARD: Field = field("task_reward", ARRIVED.end(), 1, "1", [-1e3, 1e3])
    .about("the reward that the task gives by itself");

const NEAREST: Field = field("nearest_m", TASK_REWARD.end(), 1, "m", [0.0, 10.0])
    .about("distance to the nearest other drone; 10 without any");
const MIN_SEPARATION: Field = field("min_separation_m", NEAREST.end(), 1, "m", [0.0, 10.0])
    .about("smallest distance between two drones since the episode began");
const OTHERS_MEAN: Field = field("others_mean_m", MIN_SEPARATION.end(), 3, "m", [-10.0, 10.0])
    .about("mean place of the other drones; the own one without any");
/// Place of the load.
pub(crate) const LOAD_POS: Field =
    field("load_pos_m", OTHERS_MEAN.end(), 3, "m", [-10.0, 10.0]).about("place of the load");

/// Numbers that are made for expressions, behind those of observations.
const TERMS: [Field; 10] =
    [DIST, SPEED, TILT, RATE2, ACTION_CHANGE, IMPACT, TIME, BROKEN, ARRIVED, TASK_REWARD];

/// Those of a drone among others, behind them.
pub(crate) const PAIR_FIELDS: [Field; 4] = [NEAREST, MIN_SEPARATION, OTHERS_MEAN, LOAD_POS];

/// Their numbers, in order.
pub(crate) type Pairs<R> = [R; LOAD_POS.end() - NEAREST.first];

/// Returns every field available to an expression. A filter's estimates are excluded: the filter would have to run
/// for them.
pub fn expression_fields() -> impl Iterator<Item = &'static Field> + Clone {
    ALL_FIELDS.iter().filter(|field| field.first <= YAW_ERROR.first).chain(&TERMS).chain(&PAIR_FIELDS)
}

/// The field of a name.
///
/// # Errors
/// [`crate::Error::Unknown`] with a proposal.
pub(crate) fn find_expression_field(name: &str) -> Result<Field> {
    find_named("field", name, expression_fields(), |field| field.name).copied()
}

/// A drone at the end of a control tick.
#[derive(Clone, Copy)]
pub(crate) struct Moment<'a, R: Scalar> {
    /// Its observation; the last action is that of this tick.
    pub own: &'a [R; OBSERVATION],
    /// Its true state.
    pub x: &'a State<R>,
    pub setpoint: &'a Setpoint<R>,
    /// Action of the tick before.
    pub last_action: &'a [R; ACTION],
    pub impact_mps: R,
    pub now_s: R,
    pub broken: R::Mask,
    pub arrived: R::Mask,
    pub task_reward: R,
    /// None where nothing reads them.
    pub pairs: Option<&'a Pairs<R>>,
}

impl<R: Scalar> Moment<'_, R> {
    /// The number at a place among those of [`expression_fields`].
    #[inline(always)]
    pub(crate) fn number(&self, place: usize) -> R {
        const STATE_END: usize = OBSERVATION + 12;
        let one = R::from_f64(1.0);
        let x = self.x;
        match place {
            0..OBSERVATION => self.own[place],
            OBSERVATION..STATE_END => {
                let (group, i) = ((place - OBSERVATION) / 3, (place - OBSERVATION) % 3);
                match group {
                    0 => x.pos_m[i],
                    1 => x.vel_mps[i],
                    2 if i == 2 => wrap(x.att_rad[2]),
                    2 => x.att_rad[i],
                    _ => x.rate_radps[i],
                }
            }
            p if p < YAW_ERROR.first => self.error_m(p - STATE_END),
            p if p == YAW_ERROR.first => wrap(self.setpoint.yaw_rad - x.att_rad[2]),
            p if p == DIST.first => {
                sum_of_squares([self.error_m(0), self.error_m(1), self.error_m(2)]).sqrt()
            }
            p if p == SPEED.first => sum_of_squares(x.vel_mps).sqrt(),
            p if p == TILT.first => sum_of_squares([x.att_rad[0], x.att_rad[1], R::zero()]).sqrt(),
            p if p == RATE2.first => sum_of_squares(x.rate_radps),
            p if p < ACTION_CHANGE.end() => {
                let i = p - ACTION_CHANGE.first;
                self.own[crate::observation::index::LAST_ACTION + i] - self.last_action[i]
            }
            p if p == IMPACT.first => self.impact_mps,
            p if p == TIME.first => self.now_s,
            p if p == BROKEN.first => R::select(self.broken, one, R::zero()),
            p if p == ARRIVED.first => R::select(self.arrived, one, R::zero()),
            p if p == TASK_REWARD.first => self.task_reward,
            p => self.pairs.and_then(|pairs| pairs.get(p - NEAREST.first)).copied().unwrap_or(R::zero()),
        }
    }

    #[inline(always)]
    fn error_m(&self, i: usize) -> R {
        self.setpoint.pos_m[i] - self.x.pos_m[i]
    }
}

#[inline(always)]
fn sum_of_squares<R: Scalar>(v: [R; 3]) -> R {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_belongs_to_one_field_and_every_name_to_one() {
        let mut end = 0;
        for field in expression_fields() {
            assert_eq!(field.first, end, "{}", field.name);
            assert!(!field.about.is_empty(), "{}", field.name);
            assert_eq!(expression_fields().filter(|other| other.name == field.name).count(), 1);
            end = field.end();
        }
        assert_eq!(end, LOAD_POS.end());
    }
}
