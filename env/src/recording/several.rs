//! An environment of several drones.

use std::slice::{from_mut, from_ref};

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::flight::{Drone, DroneTick, Flight, Plan, StartNumbers, everywhere};
use super::{EpisodeStart, start_numbers};
use crate::action::ACTION;
use crate::archive::Ledger;
use crate::coupling::Communication;
use crate::coupling::load::{self, Load, Ropes};
use crate::effects::Neighbour;
use crate::episode::lift_before;
use crate::error::Result;
use crate::expression::Moment;
use crate::noise::{drone_key, episode_key};
use crate::observation::{Field, OBSERVATION, Setpoint, Surroundings, observe};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::swarm::{Harm, look_ahead, mark_hits, neighbour};
use crate::task::{GOAL, Outcome, Scene, Situation, Start, Task};
use crate::world::{Around, GROUP, Tick};

pub(super) struct SwarmFlight<'a, R: SimScalar, T> {
    plan: Plan<'a>,
    task: &'a T,
    fields: Vec<Field>,
    drones: Vec<Drone<R>>,
    /// 1 for each that flies.
    flies: Vec<R>,
    /// Accelerations by the ropes in the last tick.
    pulls_mps2: Vec<[R; 3]>,
    load: Option<(Load, load::State<R>)>,
    known: Communication<R>,
    board: Vec<R>,
}

impl<'a, R: SimScalar, T: Task> SwarmFlight<'a, R, T> {
    pub(super) fn new(plan: Plan<'a>, task: &'a T, drones: usize) -> Result<Self> {
        Ok(SwarmFlight {
            plan,
            task,
            fields: plan.fields::<T>()?,
            drones: (0..drones).map(|place| plan.drone(place)).collect::<Result<_>>()?,
            flies: vec![R::from_f64(1.0); drones],
            pulls_mps2: vec![[R::zero(); 3]; drones],
            load: task.load().map(|load| (load, load::State::rest())),
            known: Communication::new(plan.options.neighbours, drones, plan.tick_s),
            board: vec![R::zero(); task.board()],
        })
    }

    fn flying(&self) -> Vec<R::Mask> {
        self.flies.iter().map(|flies| flies.gt(R::zero())).collect()
    }

    fn scene(&self) -> Vec<Neighbour<R>> {
        let flying = self.flying();
        self.drones.iter().zip(flying).map(|(drone, flies)| neighbour(drone.state(), flies)).collect()
    }

    /// How the ropes pull in the coming tick.
    fn pull(&mut self, scene: &[Neighbour<R>]) {
        let Some((load, state)) = &mut self.load else { return };
        let (mut moving, mut pulls) = (scene.to_vec(), self.pulls_mps2.clone());
        let free: Vec<[R; 3]> = self
            .drones
            .iter()
            .zip(&self.pulls_mps2)
            .map(|(drone, pull)| std::array::from_fn(|i| drone.world.acc_mps2(0)[i] - pull[i]))
            .collect();
        let drone_kg: Vec<R> = self.plan.models.iter().map(|m| R::from_f64(m.vehicle.mass.value)).collect();
        let gravity_mps2 = self.plan.models[0].lateral.gravity.value;
        let ropes = Ropes { moving: &mut moving, pulls_mps2: &mut pulls, drone_kg: &drone_kg };
        load.step(state, scene, &free, ropes, [self.plan.tick_s, gravity_mps2]);
        self.pulls_mps2 = pulls;
    }

    /// All drones obey their actions for a tick.
    fn fly(&mut self, actions: &[[R; ACTION]]) -> Vec<Tick<R>> {
        let mut scene = self.scene();
        self.pull(&scene);
        let half_s = R::from_f64(0.5 * self.plan.tick_s);
        for (seen, drone) in scene.iter_mut().zip(&self.drones) {
            look_ahead(seen, drone.world.acc_mps2(0), half_s);
        }
        let flying = self.flying();
        let mut ticks = Vec::new();
        for (own, drone) in self.drones.iter_mut().enumerate() {
            R::enter("command");
            let before = *drone.state();
            let command = match &mut drone.onboard {
                None => self.plan.interfaces[own].command(&actions[own]),
                Some(onboard) => onboard.command(0, &actions[own], &before),
            };
            let mut tick = Tick::none();
            R::enter("model");
            if self.load.is_none() && drone.world.is_plain() {
                tick = drone.world.step_plain(0, &command);
            } else {
                let push = Accelerations { acc_mps2: self.pulls_mps2[own], ..Accelerations::none() };
                let around = Around { neighbours: &scene, own, push };
                drone.world.step_group(0, from_ref(&command), Some(&[around; GROUP]), from_mut(&mut tick));
            }
            // who no longer flies stays where it is
            drone.world.halt(0, !flying[own], &before);
            ticks.push(tick);
        }
        ticks
    }

    /// Where a drone is to be now; may move its goal on.
    fn place(&mut self, own: usize, scene: &[Neighbour<R>]) -> Setpoint<R> {
        let mut goal = self.drones[own].goal;
        let setpoint = self.task.setpoint(own, &mut goal, &self.board, &self.tasks_scene(scene));
        self.drones[own].goal = goal;
        setpoint
    }

    fn tasks_scene<'b>(&'b self, scene: &'b [Neighbour<R>]) -> Scene<'b, R> {
        let world = &self.drones[0].world;
        let load = self.load.as_ref().map(|(_, state)| state);
        Scene { drones: scene, load, t_s: world.time_s(0), draw: world.draw(0) }
    }

    /// An observation: a drone's own, then what it knows of the others; nothing where it does not fly.
    fn observation(
        &mut self,
        own: usize,
        row: &[R; OBSERVATION],
        scene: &[Neighbour<R>],
        begun: bool,
    ) -> Vec<R> {
        let now_s = self.drones[own].world.time_s(0);
        let options = self.plan.options;
        let mut numbers =
            self.drones[own].observation(options, &self.fields, row, (begun, Surroundings::none()));
        for other in (0..scene.len()).filter(|other| *other != own) {
            numbers.extend(self.known.neighbour_row(own, other, scene, now_s));
        }
        let flies = self.flies[own].gt(R::zero());
        numbers.into_iter().map(|number| R::select(flies, number, R::zero())).collect()
    }

    fn judge(
        &mut self,
        own: usize,
        scene: &[Neighbour<R>],
        action: &[R; ACTION],
        tick: &Tick<R>,
    ) -> (Setpoint<R>, Outcome<R>) {
        let setpoint = self.place(own, scene);
        let drone = &self.drones[own];
        let situation = Situation {
            x: drone.state(),
            setpoint,
            goal: &drone.goal,
            action,
            last_action: &drone.last_action,
            contact: &tick.contact,
        };
        (setpoint, self.task.judge(own, &situation, &self.board, &self.tasks_scene(scene)))
    }

    /// What the tick came to for a drone, and who flies on.
    fn end(
        &mut self,
        own: usize,
        seen: &DroneTickView<'_, R>,
        (setpoint, outcome): &(Setpoint<R>, Outcome<R>),
    ) -> Result<(DroneTick<R>, R)> {
        let DroneTickView { scene, hits, action, tick } = *seen;
        let flies = self.flies[own].gt(R::zero());
        let (world, last_action) = (&self.drones[own].world, self.drones[own].last_action);
        let (x, now_s) = (world.state(0), world.time_s(0));
        let worth = (outcome.reward, T::CRASH_COST);
        let harm = Harm::new([flies, hits[own]], x, &tick.contact, worth);
        let broken = harm.hit | harm.crash;
        let row = observe(&tick.reading, now_s, setpoint, action);
        let moment = Moment {
            own: &row,
            x,
            setpoint,
            last_action: &last_action,
            impact_mps: tick.contact.impact_mps,
            now_s,
            broken,
            arrived: outcome.arrived,
            task_reward: harm.reward,
        };
        let (reward, ends) = self.plan.decide(&moment, (harm.reward, outcome.ends))?;
        let terminated = broken | (flies & ends);
        let over = self.drones[0].world.time_s(0).gt(R::from_f64(self.plan.last_s()));
        self.drones[own].last_action = *action;
        let tick = DroneTick {
            observation: self.observation(own, &row, scene, false),
            reward: R::select(flies, reward, R::zero()),
            terminated,
            truncated: flies & !terminated & over,
        };
        Ok((tick, R::select(terminated | over, R::zero(), self.flies[own])))
    }
}

/// What happened in a tick.
struct DroneTickView<'a, R: Scalar> {
    scene: &'a [Neighbour<R>],
    hits: &'a [R::Mask],
    action: &'a [R; ACTION],
    tick: &'a Tick<R>,
}

impl<R: SimScalar, T: Task> Flight<R> for SwarmFlight<'_, R, T> {
    fn drones(&mut self) -> &mut [Drone<R>] {
        &mut self.drones
    }

    fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("board", &mut self.board);
        ledger.numbers("flies", &mut self.flies);
        if let Some((_, load)) = &mut self.load {
            ledger.numbers("load_pos_m", &mut load.pos_m);
            ledger.numbers("load_vel_mps", &mut load.vel_mps);
            for (i, pull) in self.pulls_mps2.iter_mut().enumerate() {
                ledger.numbers(&format!("pull{i}_mps2"), pull);
            }
        }
    }

    fn begin(&mut self, start: &[R]) -> Vec<Vec<R>> {
        let mut start = StartNumbers(start);
        let mut rows = Vec::new();
        for (own, drone) in self.drones.iter_mut().enumerate() {
            let interface = &self.plan.interfaces[own];
            let mut x = State::<R>::rest();
            x.pos_m = start.take();
            [x.att_rad[2]] = start.take();
            drone.goal = start.take();
            let u = Command::level(lift_before(interface, x.pos_m[2]));
            drone.last_action = interface.action_before(&x, &u);
            if let Some(onboard) = &mut drone.onboard {
                onboard.start(0, everywhere::<R>());
            }
            rows.push(drone.world.start(0, everywhere::<R>(), &x, &u));
        }
        if let Some((_, load)) = &mut self.load {
            *load = load::State { pos_m: start.take(), vel_mps: [R::zero(); 3] };
        }
        self.board.copy_from_slice(start.0);
        R::enter("task");
        let scene = self.scene();
        let mut observations = Vec::new();
        for (own, reading) in rows.iter().enumerate() {
            let setpoint = self.place(own, &scene);
            let now_s = self.drones[own].world.time_s(0);
            let row = observe(reading, now_s, &setpoint, &self.drones[own].last_action);
            observations.push(self.observation(own, &row, &scene, true));
        }
        observations
    }

    fn tick(&mut self, actions: &[[R; ACTION]]) -> Result<Vec<DroneTick<R>>> {
        let ticks = self.fly(actions);
        R::enter("task");
        let mut scene = self.scene();
        let mut hits = vec![R::nothing(); scene.len()];
        mark_hits(&scene, self.plan.options.radius_m, &mut hits, &mut R::from_f64(1e9));
        let outcomes: Vec<_> =
            (0..scene.len()).map(|own| self.judge(own, &scene, &actions[own], &ticks[own])).collect();
        let (mut results, mut flies) = (Vec::new(), Vec::new());
        for (own, outcome) in outcomes.iter().enumerate() {
            let seen = DroneTickView { scene: &scene, hits: &hits, action: &actions[own], tick: &ticks[own] };
            let (result, on) = self.end(own, &seen, outcome)?;
            results.push(result);
            flies.push(on);
        }
        self.flies = flies;
        for (seen, flies) in scene.iter_mut().zip(&self.flies) {
            seen.here = *flies;
        }
        let mut board = std::mem::take(&mut self.board);
        self.task.turn(&mut board, &self.tasks_scene(&scene));
        self.board = board;
        Ok(results)
    }
}

/// How the first episode of a seed starts, as in a batch whose effects are not drawn.
pub(super) fn draw_start<T: Task>(task: &T, drones: usize, seed: u64) -> EpisodeStart {
    let key = episode_key(seed, 0);
    let mut starts = vec![Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] }; drones];
    let mut board = vec![0.0; task.board()];
    task.start(&mut Pcg64Mcg::seed_from_u64(key), &mut starts, &mut board);
    let hanging = task.load().map(|load| load.hangs(starts.iter().map(|start| start.pos_m)));
    EpisodeStart {
        keys: (0..drones).map(|drone| drone_key(key, drone)).collect(),
        numbers: start_numbers(&starts, hanging.as_ref().map_or(&[], |at| &at[..]), &board),
    }
}
