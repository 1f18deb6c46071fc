//! What makes an episode of a task of one drone: its first moment, and what comes of a tick. The batch runs it on
//! lanes, and a recording on symbols.

use crate::action::{ACTION, Interface};
use crate::effects::{Neighbour, Reading};
use crate::observation::{OBSERVATION, Setpoint, observe};
use crate::plant::State;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::task::{GOAL, Scene, Situation, Task, crashed, outside};
use crate::world::{Tick, World};

/// What a task says of a tick.
#[derive(Clone, Copy)]
pub(crate) struct TickVerdict<R: Scalar> {
    pub(crate) setpoint: Setpoint<R>,
    /// What is measured.
    pub(crate) row: [R; OBSERVATION],
    pub(crate) reward: R,
    pub(crate) arrived: R::Mask,
    /// Ended by the task itself.
    pub(crate) ends: R::Mask,
    /// Crashed, or out of the room.
    pub(crate) broken: R::Mask,
    pub(crate) now_s: R,
}

/// What happened in a tick, of one tile.
pub(crate) struct TickResult<'a, R: Scalar> {
    pub(crate) tile: usize,
    pub(crate) action: &'a [R; ACTION],
    pub(crate) last_action: &'a [R; ACTION],
    pub(crate) tick: &'a Tick<R>,
}

/// The task's opinion on a tick; may move the goal on.
#[inline(always)]
pub(crate) fn judge_tick<R: SimScalar, T: Task>(
    task: &T,
    world: &World<R>,
    goal: &mut [R; GOAL],
    board: &[R],
    result: &TickResult<'_, R>,
) -> TickVerdict<R> {
    let TickResult { tile, action, last_action, tick } = *result;
    let now_s = world.time_s(tile);
    let x = world.state(tile);
    let drones = [neighbour(x)];
    let scene = Scene { drones: &drones, load: None, t_s: now_s, draw: world.draw(tile) };
    let setpoint = task.setpoint(0, goal, board, &scene);
    let situation = Situation { x, setpoint, goal, action, last_action, contact: &tick.contact };
    let outcome = task.judge(0, &situation, board, &scene);
    let broken = outside(x) | crashed(&tick.contact);
    let reward = if T::CRASH_COST == 0.0 {
        outcome.reward
    } else {
        outcome.reward - R::select(broken, R::from_f64(T::CRASH_COST), R::zero())
    };
    let row = observe(&tick.reading, now_s, &setpoint, action);
    TickVerdict { setpoint, row, reward, arrived: outcome.arrived, ends: outcome.ends, broken, now_s }
}

/// What is measured as episodes begin; may move the goal on.
#[inline(always)]
pub(crate) fn first_row<R: SimScalar, T: Task>(
    task: &T,
    world: &World<R>,
    tile: usize,
    goal: &mut [R; GOAL],
    board: &[R],
    (reading, last_action): (&Reading<R>, &[R; ACTION]),
) -> [R; OBSERVATION] {
    let now_s = world.time_s(tile);
    let drones = [neighbour(world.state(tile))];
    let scene = Scene { drones: &drones, load: None, t_s: now_s, draw: world.draw(tile) };
    let setpoint = task.setpoint(0, goal, board, &scene);
    observe(reading, now_s, &setpoint, last_action)
}

/// What was commanded before an episode: in the air it has been hovering, on the floor the motors stand still.
#[inline(always)]
pub(crate) fn lift_before<R: Scalar>(interface: &Interface, height_m: R) -> R {
    if interface.input.is_pwm() {
        R::select(height_m.gt(R::zero()), R::from_f64(interface.hover_lift), R::zero())
    } else {
        height_m
    }
}

/// The drone as a task sees it; computed only for those that look.
#[inline(always)]
fn neighbour<R: Scalar>(x: &State<R>) -> Neighbour<R> {
    Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::from_f64(1.0) }
}
