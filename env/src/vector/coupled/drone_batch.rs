//! All drones of a part of the batch, with their load, and how they move for a tick.

use crate::action::{ACTION, Onboard};
use crate::archive::Archive;
use crate::config::Autoreset;
use crate::coupling::load::{self, Load, Ropes};
use crate::coupling::{Communication, NEIGHBOUR};
use crate::effects::Neighbour;
use crate::error::Result;
use crate::lanes::LANES;
use crate::observation::{OBSERVATION, Setpoint};
use crate::plant::{Accelerations, Command, State};
use crate::rows::{STATE, state_row, write_lane};
use crate::sim_scalar::BatchScalar;
use crate::swarm::{self, look_ahead};
use crate::task::{GOAL, Outcome, Scene, Start};
use crate::vector::judgement::{Fault, Judgement};
use crate::vector::observer::{Observer, row_width};
use crate::vector::{BatchConfig, METRICS, ShardSpec};
use crate::world::{Around, Contact, GROUP, Settings, Tick, World};

/// What is measured of an episode, see [`METRICS`].
#[derive(Debug, Clone, Copy)]
pub(in crate::vector) struct EpisodeStats<R> {
    pub(in crate::vector) collisions: R,
    pub(in crate::vector) crashes: R,
    pub(in crate::vector) done: R,
    pub(in crate::vector) nearest2_m2: R,
    pub(in crate::vector) settled_s: R,
    pub(in crate::vector) error2_m2: R,
    pub(in crate::vector) flown: R,
}

/// A tile of environments besides its drones.
pub(in crate::vector) struct Tile<R: BatchScalar> {
    pub(in crate::vector) known: Communication<R>,
    pub(in crate::vector) load: load::State<R>,
    pub(in crate::vector) stats: EpisodeStats<R>,
    pub(in crate::vector) seed: [u64; LANES],
    pub(in crate::vector) number: [u64; LANES],
    /// Environments of the batch (the last tile may have fewer than sixteen), and those whose episode has
    /// ended.
    pub(in crate::vector) used: u16,
    pub(in crate::vector) ended: u16,
}

/// A drone of a tile of environments.
#[derive(Clone, Copy)]
pub(in crate::vector) struct DroneSlot<R> {
    pub(in crate::vector) last_action: [R; ACTION],
    pub(in crate::vector) goal: [R; GOAL],
    /// Acceleration that its rope gave it in the last tick.
    pub(in crate::vector) pull_mps2: [R; 3],
    /// Environments in which it flies.
    pub(in crate::vector) flying: u16,
}

/// What the parts of a step hand to each other, drone by drone.
pub(in crate::vector) struct Scratch<R: BatchScalar> {
    /// Of a group of tiles, one after the other.
    pub(in crate::vector) scene: Vec<Neighbour<R>>,
    push: Vec<Accelerations<R>>,
    pub(in crate::vector) ticks: Vec<[Tick<R>; GROUP]>,
    pub(in crate::vector) actions: Vec<[[R; ACTION]; GROUP]>,
    /// Of one tile.
    pub(in crate::vector) contacts: Vec<Contact<R>>,
    pub(in crate::vector) setpoints: Vec<Setpoint<R>>,
    pub(in crate::vector) outcomes: Vec<Outcome<R>>,
    pub(in crate::vector) hit: Vec<R::Mask>,
    free_mps2: Vec<[R; 3]>,
    moving: Vec<Neighbour<R>>,
    pulls_mps2: Vec<[R; 3]>,
    pub(in crate::vector) turned: Vec<R>,
    /// Of episodes that begin.
    pub(in crate::vector) starts: Vec<Start>,
    pub(in crate::vector) begun: Vec<f64>,
    pub(in crate::vector) x: Vec<State<R>>,
    pub(in crate::vector) u: Vec<Command<R>>,
    pub(in crate::vector) hanging: load::State<R>,
    /// Observations of one drone in a tile of environments.
    pub(in crate::vector) rows: Vec<f32>,
}

pub(in crate::vector) struct DroneBatch<R: BatchScalar> {
    /// Of each drone, in all tiles.
    pub(in crate::vector) drones: Vec<World<R>>,
    /// Of each drone: turns actions that are no attitudes into commands.
    pub(in crate::vector) onboard: Vec<Option<Onboard<R>>>,
    pub(in crate::vector) load: Option<Load>,
    drone_kg: Vec<R>,
    gravity_mps2: f64,
    pub(in crate::vector) envs: usize,
    pub(in crate::vector) tiles: Vec<Tile<R>>,
    /// By tile, then by drone.
    pub(in crate::vector) slots: Vec<DroneSlot<R>>,
    /// By tile.
    boards: Vec<R>,
    pub(in crate::vector) scratch: Scratch<R>,
    pub(in crate::vector) observer: Option<Observer<R>>,
    pub(in crate::vector) judgement: Option<Judgement>,
    pub(in crate::vector) final_observations: Vec<f32>,
    pub(in crate::vector) final_states: Vec<f32>,
}

impl<R: BatchScalar> DroneBatch<R> {
    pub(in crate::vector) fn new(
        spec: &ShardSpec<'_>,
        load: Option<Load>,
        board: usize,
        drones: usize,
    ) -> Result<Self> {
        let ShardSpec { models, inputs, options, envs, tick_s, .. } = *spec;
        let tiles = envs.div_ceil(LANES);
        let one = |j: usize| -> Result<World<R>> {
            let settings = Settings { input: inputs[j], physics_hz: options.physics_hz };
            let mut world = World::new(models[j], &options.drone_effects(j), settings, tiles)?;
            options.wind_field.as_ref().map_or(Ok(()), |field| world.set_wind(field))?;
            Ok(world.at_level(options.action))
        };
        let zero = R::zero();
        let slot =
            DroneSlot { last_action: [zero; ACTION], goal: [zero; GOAL], pull_mps2: [zero; 3], flying: 0 };
        let tile = |i: usize| {
            let left = envs - i * LANES;
            let used = if left >= LANES { u16::MAX } else { (1 << left) - 1 };
            let known = Communication::new(options.neighbours, drones, tick_s);
            Tile {
                known,
                load: load::State::rest(),
                stats: EpisodeStats::none(),
                seed: [0; LANES],
                number: [0; LANES],
                used,
                ended: 0,
            }
        };
        let kept = if options.autoreset == Autoreset::SameStep { envs } else { 0 };
        Ok(DroneBatch {
            drones: (0..drones).map(one).collect::<Result<_>>()?,
            onboard: (0..drones)
                .map(|j| Onboard::new(models[j], &spec.interfaces[j], tick_s, tiles))
                .collect::<Result<_>>()?,
            load,
            drone_kg: models.iter().map(|m| R::from_f64(m.vehicle.mass.value)).collect(),
            gravity_mps2: models[0].lateral.gravity.value,
            envs,
            tiles: (0..tiles).map(tile).collect(),
            slots: vec![slot; tiles * drones],
            boards: vec![zero; tiles * board],
            scratch: Scratch::new(drones, board),
            observer: Observer::new(spec, drones, false)?,
            judgement: Judgement::new(spec, drones)?,
            final_observations: vec![0.0; kept * drones * row_width(options, drones)?],
            final_states: vec![0.0; kept * drones * STATE],
        })
    }

    /// A flag for each drone, environment by environment.
    pub(in crate::vector) fn end_flights(&mut self, drones: &[bool]) {
        let n = self.drones.len();
        for (row, _) in drones.iter().enumerate().filter(|(_, ends)| **ends) {
            let (env, drone) = (row / n, row % n);
            self.slots[env / LANES * n + drone].flying &= !(1 << (env % LANES));
        }
        for (tile, slots) in self.tiles.iter_mut().zip(self.slots.chunks(n)) {
            let flying = slots.iter().fold(0, |flying, slot| flying | slot.flying);
            tile.ended = !flying & tile.used;
        }
    }
    pub(in crate::vector) fn watched(&self) -> &[f32] {
        self.judgement.as_ref().map_or(&[], Judgement::rows)
    }
    pub(in crate::vector) fn take_fault(&mut self) -> Option<Fault> {
        self.judgement.as_mut()?.take_fault()
    }
    pub(in crate::vector) fn len(&self) -> usize {
        self.drones.len()
    }
    pub(in crate::vector) fn tiles(&self) -> usize {
        self.tiles.len()
    }
    pub(in crate::vector) fn used(&self, tile: usize) -> u32 {
        self.tiles[tile].used.into()
    }
    pub(in crate::vector) fn ended(&self, tile: usize) -> u16 {
        self.tiles[tile].ended
    }
    #[inline(always)]
    pub(in crate::vector) fn slot(&self, tile: usize, drone: usize) -> &DroneSlot<R> {
        &self.slots[tile * self.drones.len() + drone]
    }
    #[inline(always)]
    pub(in crate::vector) fn slot_mut(&mut self, tile: usize, drone: usize) -> &mut DroneSlot<R> {
        &mut self.slots[tile * self.drones.len() + drone]
    }
    #[inline(always)]
    pub(in crate::vector) fn board(&self, tile: usize) -> &[R] {
        let size = self.scratch.begun.len();
        &self.boards[tile * size..(tile + 1) * size]
    }
    #[inline(always)]
    pub(in crate::vector) fn board_mut(&mut self, tile: usize) -> &mut [R] {
        let size = self.scratch.begun.len();
        &mut self.boards[tile * size..(tile + 1) * size]
    }
    #[inline(always)]
    pub(in crate::vector) fn state(&self, tile: usize, drone: usize) -> &State<R> {
        self.drones[drone].state(tile)
    }

    /// What a task knows of a tile, at `place` of its group.
    #[inline(always)]
    pub(in crate::vector) fn scene(&self, tile: usize, place: usize) -> Scene<'_, R> {
        let load = self.load.is_some().then_some(&self.tiles[tile].load);
        scene(&self.drones, &self.scratch.scene, load, tile, place)
    }

    /// A drone's goal, with the board and the scene that it is moved on by.
    #[inline(always)]
    pub(in crate::vector) fn goal(
        &mut self,
        tile: usize,
        place: usize,
        drone: usize,
    ) -> (&mut [R; GOAL], &[R], Scene<'_, R>) {
        let n = self.drones.len();
        let DroneBatch { drones, load, tiles, slots, boards, scratch, .. } = self;
        let size = scratch.begun.len();
        let scene = scene(drones, &scratch.scene, load.is_some().then_some(&tiles[tile].load), tile, place);
        (&mut slots[tile * n + drone].goal, &boards[tile * size..(tile + 1) * size], scene)
    }

    /// One tick of motion for `n` tiles from `first` on.
    // one copy for all tasks, as of everything here
    #[inline(never)]
    pub(in crate::vector) fn advance(
        &mut self,
        config: &BatchConfig,
        first: usize,
        n: usize,
        actions: &[f32],
    ) {
        R::run(
            #[inline(always)]
            || {
                for place in 0..n {
                    self.prepare(first + place, place);
                }
                for drone in 0..self.drones.len() {
                    self.obey(config, drone, first, n, actions);
                }
            },
        );
    }

    /// Who is where at the middle of the coming tick, and how the ropes will pull.
    #[inline(always)]
    fn prepare(&mut self, tile: usize, place: usize) {
        let n = self.drones.len();
        let DroneBatch { drones, scratch, slots, tiles, load, drone_kg, gravity_mps2, .. } = self;
        let tick_s = drones[0].tick_s();
        let slots = &mut slots[tile * n..(tile + 1) * n];
        let scene = &mut scratch.scene[place * n..(place + 1) * n];
        for ((drone, slot), seen) in drones.iter().zip(slots.iter()).zip(scene.iter_mut()) {
            *seen = neighbour(drone.state(tile), slot.flying);
        }
        if let Some(load) = load {
            for ((drone, slot), free) in drones.iter().zip(slots.iter()).zip(&mut scratch.free_mps2) {
                let acc_mps2 = drone.acc_mps2(tile);
                for i in 0..3 {
                    free[i] = acc_mps2[i] - slot.pull_mps2[i];
                }
            }
            let ropes = Ropes { moving: &mut scratch.moving, pulls_mps2: &mut scratch.pulls_mps2, drone_kg };
            load.step(&mut tiles[tile].load, scene, &scratch.free_mps2, ropes, [tick_s, *gravity_mps2]);
            for ((slot, pull), push) in
                slots.iter_mut().zip(&scratch.pulls_mps2).zip(&mut scratch.push[place * n..])
            {
                slot.pull_mps2 = *pull;
                push.acc_mps2 = *pull;
            }
        }
        let half = R::from_f64(0.5 * tick_s);
        for (drone, seen) in drones.iter().zip(scene) {
            look_ahead(seen, drone.acc_mps2(tile), half);
        }
    }

    /// One drone of a group of tiles obeys its actions.
    #[inline(always)]
    fn obey(&mut self, config: &BatchConfig, drone: usize, first: usize, n: usize, actions: &[f32]) {
        let all = self.drones.len();
        let DroneBatch { drones, onboard, scratch, slots, envs, load, .. } = self;
        let (world, onboard) = (&mut drones[drone], &mut onboard[drone]);
        let reach = config.interfaces[drone].reach();
        let mut commands = [Command::level(R::zero()); GROUP];
        let flying = |i: usize| slots[(first + i) * all + drone].flying;
        // who no longer flies stays where it is
        let halted = (0..n).any(|i| flying(i) != u16::MAX);
        let before = halted.then(|| [*world.state(first), *world.state(first + n - 1)]);
        let row = &mut scratch.actions[drone];
        for i in 0..n {
            row[i] = gather(actions, (first + i) * LANES, *envs, drone, all);
            commands[i] = match onboard {
                None => reach.command(&row[i]),
                Some(onboard) => onboard.command(first + i, &row[i], world.state(first + i)),
            };
        }
        if load.is_none() && world.is_plain() {
            for i in 0..n {
                scratch.ticks[drone][i] = world.step_plain(first + i, &commands[i]);
            }
        } else {
            let around = |i: usize| Around {
                neighbours: &scratch.scene[i * all..(i + 1) * all],
                own: drone,
                push: scratch.push[i * all + drone],
            };
            let around = [around(0), around(n - 1)];
            world.step_group(first, &commands[..n], Some(&around), &mut scratch.ticks[drone][..n]);
        }
        for (i, before) in before.iter().flat_map(|both| &both[..n]).enumerate() {
            world.halt(first + i, R::mask(u32::from(!flying(i))), before);
        }
    }

    pub(in crate::vector) fn states(&self, rows: &mut [f32]) {
        let n = self.drones.len();
        for (i, row) in rows.chunks_exact_mut(STATE).enumerate() {
            let (world, drone) = (i / n, i % n);
            write_lane(&state_row(self.state(world / LANES, drone)), world % LANES, row);
        }
    }

    pub(in crate::vector) fn loads(&self, rows: &mut [f32]) -> bool {
        for (world, row) in rows.chunks_exact_mut(3).enumerate() {
            write_lane(&self.tiles[world / LANES].load.pos_m, world % LANES, row);
        }
        self.load.is_some()
    }

    pub(in crate::vector) fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        let observations = self.final_observations.len() / self.envs;
        let states = self.len() * STATE;
        let observations = self
            .final_observations
            .get(env * observations..(env + 1) * observations)
            .filter(|rows| !rows.is_empty())?;
        Some((observations, self.final_states.get(env * states..(env + 1) * states)?))
    }
}

/// Of the scenes of a group of tiles the one at `place`.
#[inline(always)]
fn scene<'a, R: BatchScalar>(
    drones: &'a [World<R>],
    group: &'a [Neighbour<R>],
    load: Option<&'a load::State<R>>,
    tile: usize,
    place: usize,
) -> Scene<'a, R> {
    let n = drones.len();
    Scene {
        drones: &group[place * n..(place + 1) * n],
        load,
        t_s: drones[0].time_s(tile),
        draw: drones[0].draw(tile),
    }
}

impl<R: BatchScalar> Tile<R> {
    pub(in crate::vector) fn archive(&mut self, archive: &mut Archive<'_>) {
        self.known.archive(archive);
        archive.numbers(&mut self.load.pos_m);
        archive.numbers(&mut self.load.vel_mps);
        let EpisodeStats { collisions, crashes, done, nearest2_m2, settled_s, error2_m2, flown } =
            &mut self.stats;
        for number in [collisions, crashes, done, nearest2_m2, settled_s, error2_m2, flown] {
            archive.number(number);
        }
        archive.seeds(&mut self.seed);
        archive.words(&mut self.number);
        archive.bits(&mut self.ended, self.used);
    }
}

impl<R: BatchScalar> DroneSlot<R> {
    pub(in crate::vector) fn archive(&mut self, used: u16, archive: &mut Archive<'_>) {
        archive.numbers(&mut self.last_action);
        archive.numbers(&mut self.goal);
        archive.numbers(&mut self.pull_mps2);
        archive.bits(&mut self.flying, used);
    }
}

#[inline(always)]
pub(in crate::vector) fn neighbour<R: BatchScalar>(x: &State<R>, flying: u16) -> Neighbour<R> {
    swarm::neighbour(x, R::mask(flying.into()))
}

/// A drone's actions in sixteen envs from `first` on; none where there are no more envs.
#[inline(always)]
fn gather<R: BatchScalar>(
    actions: &[f32],
    first: usize,
    envs: usize,
    drone: usize,
    drones: usize,
) -> [R; ACTION] {
    let mut rows = [0.0; LANES * ACTION];
    let count = LANES.min(envs - first);
    for (lane, row) in rows.chunks_exact_mut(ACTION).take(count).enumerate() {
        let at = ((first + lane) * drones + drone) * ACTION;
        row.copy_from_slice(&actions[at..at + ACTION]);
    }
    R::read4(&rows)
}

impl<R: BatchScalar> Scratch<R> {
    fn new(drones: usize, board: usize) -> Self {
        let (zero, group, nothing) = (R::zero(), GROUP * drones, R::nothing());
        let none = [zero; 3];
        Scratch {
            scene: vec![Neighbour::gone(); group],
            push: vec![Accelerations::none(); group],
            ticks: vec![[Tick::none(); GROUP]; drones],
            actions: vec![[[zero; ACTION]; GROUP]; drones],
            contacts: vec![Tick::none().contact; drones],
            setpoints: vec![Setpoint::origin(); drones],
            outcomes: vec![Outcome { reward: zero, error_m: zero, arrived: nothing, ends: nothing }; drones],
            hit: vec![nothing; drones],
            free_mps2: vec![none; drones],
            moving: vec![Neighbour::gone(); drones],
            pulls_mps2: vec![none; drones],
            turned: vec![zero; board],
            starts: vec![Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] }; drones],
            begun: vec![0.0; board],
            x: vec![State::rest(); drones],
            u: vec![Command::level(zero); drones],
            hanging: load::State::rest(),
            rows: vec![0.0; LANES * (OBSERVATION + NEIGHBOUR * (drones - 1))],
        }
    }
}

impl<R: BatchScalar> EpisodeStats<R> {
    pub(in crate::vector) fn none() -> Self {
        let zero = R::zero();
        // nobody is nearer than the room is wide
        let nearest2_m2 = R::from_f64(100.0);
        EpisodeStats {
            collisions: zero,
            crashes: zero,
            done: zero,
            nearest2_m2,
            settled_s: zero,
            error2_m2: zero,
            flown: zero,
        }
    }

    /// In the order of [`METRICS`].
    #[inline(always)]
    pub(in crate::vector) fn row(&self, arrived: R) -> [R; METRICS.len()] {
        let rms_m = (self.error2_m2 / self.flown.max(R::from_f64(1.0))).sqrt();
        [self.collisions, self.crashes, self.nearest2_m2.sqrt(), self.settled_s, rms_m, self.done + arrived]
    }
}
