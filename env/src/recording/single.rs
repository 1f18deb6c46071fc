//! An environment of one drone.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::flight::{Drone, DroneTick, Flight, Plan, StartNumbers, everywhere};
use super::{EpisodeStart, start_numbers};
use crate::action::ACTION;
use crate::archive::Ledger;
use crate::episode::{TickResult, first_row, judge_tick, lift_before};
use crate::error::Result;
use crate::expression::Moment;
use crate::noise::episode_key;
use crate::observation::Field;
use crate::plant::{Command, State};
use crate::sim_scalar::SimScalar;
use crate::task::{GOAL, Start, Task};

pub(super) struct SingleFlight<'a, R: SimScalar, T> {
    plan: Plan<'a>,
    task: &'a T,
    fields: Vec<Field>,
    drone: Drone<R>,
    board: Vec<R>,
}

impl<'a, R: SimScalar, T: Task> SingleFlight<'a, R, T> {
    pub(super) fn new(plan: Plan<'a>, task: &'a T) -> Result<Self> {
        let (fields, drone) = (plan.fields::<T>()?, plan.drone(0)?);
        Ok(SingleFlight { plan, task, fields, drone, board: vec![R::zero(); task.board()] })
    }
}

impl<R: SimScalar, T: Task> Flight<R> for SingleFlight<'_, R, T> {
    fn drones(&mut self) -> &mut [Drone<R>] {
        std::slice::from_mut(&mut self.drone)
    }

    fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("board", &mut self.board);
    }

    fn begin(&mut self, start: &[R]) -> Vec<Vec<R>> {
        let SingleFlight { plan, task, fields, drone, board } = self;
        let (interface, mut start) = (&plan.interfaces[0], StartNumbers(start));
        let mut x = State::<R>::rest();
        x.pos_m = start.take();
        [x.att_rad[2]] = start.take();
        drone.goal = start.take();
        board.copy_from_slice(start.0);
        let u = Command::level(lift_before(interface, x.pos_m[2]));
        drone.last_action = interface.action_before(&x, &u);
        if let Some(onboard) = &mut drone.onboard {
            onboard.start(0, everywhere::<R>());
        }
        let reading = drone.world.start(0, everywhere::<R>(), &x, &u);
        R::enter("task");
        let row = first_row(*task, &drone.world, 0, &mut drone.goal, board, (&reading, &drone.last_action));
        let surroundings = task.surroundings(&drone.state().pos_m, &drone.goal, board);
        vec![drone.observation(plan.options, fields, &row, (true, surroundings))]
    }

    fn tick(&mut self, actions: &[[R; ACTION]]) -> Result<Vec<DroneTick<R>>> {
        let SingleFlight { plan, task, fields, drone, board } = self;
        let action = &actions[0];
        R::enter("command");
        let command = match &mut drone.onboard {
            None => plan.interfaces[0].command(action),
            Some(onboard) => onboard.command(0, action, drone.world.state(0)),
        };
        R::enter("model");
        let tick = drone.world.step(0, &command);
        R::enter("task");
        let result = TickResult { tile: 0, action, last_action: &drone.last_action, tick: &tick };
        let judged = judge_tick(*task, &drone.world, &mut drone.goal, board, &result);
        let moment = Moment {
            own: &judged.row,
            x: drone.world.state(0),
            setpoint: &judged.setpoint,
            last_action: &drone.last_action,
            impact_mps: tick.contact.impact_mps,
            now_s: judged.now_s,
            broken: judged.broken,
            arrived: judged.arrived,
            task_reward: judged.reward,
        };
        let (reward, ends) = plan.decide(&moment, (judged.reward, judged.ends))?;
        drone.last_action = *action;
        let surroundings = task.surroundings(&drone.state().pos_m, &drone.goal, board);
        Ok(vec![DroneTick {
            observation: drone.observation(plan.options, fields, &judged.row, (false, surroundings)),
            reward,
            terminated: ends | judged.broken,
            truncated: judged.now_s.gt(R::from_f64(plan.last_s())),
        }])
    }
}

/// How the first episode of a seed starts, as in a batch whose effects are not drawn.
pub(super) fn draw_start<T: Task>(task: &T, seed: u64) -> EpisodeStart {
    let key = episode_key(seed, 0);
    let mut start = Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] };
    let mut board = vec![0.0; task.board()];
    task.start(&mut Pcg64Mcg::seed_from_u64(key), std::slice::from_mut(&mut start), &mut board);
    EpisodeStart { keys: vec![key], numbers: start_numbers(&[start], &[], &board) }
}
