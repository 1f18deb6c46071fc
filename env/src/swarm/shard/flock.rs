//! All drones of a part of the batch, with their load, and how they move for a tick.

use super::Whole;
use crate::config::Autoreset;
use crate::effects::Neighbour;
use crate::error::Result;
use crate::lanes::LANES;
use crate::observation::{ACTION, OBSERVATION, Setpoint};
use crate::plant::{Command, Push, State};
use crate::rows::{STATE, state_row, write_lane};
use crate::simulated::Batched;
use crate::swarm::known::Known;
use crate::swarm::load::{self, Load, Ropes};
use crate::swarm::mission::{Scene, Verdict};
use crate::swarm::{METRICS, NEIGHBOUR, Rules};
use crate::task::{GOAL, Start};
use crate::world::{Around, Contact, GROUP, Settings, Tick, World};

/// What is measured of an episode, see [`METRICS`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums<R> {
    pub(super) collisions: R,
    pub(super) crashes: R,
    pub(super) done: R,
    pub(super) nearest2_m2: R,
    pub(super) settled_s: R,
    pub(super) error2_m2: R,
    pub(super) flown: R,
}

/// A tile of worlds besides its drones.
pub(super) struct Tile<R: Batched> {
    pub(super) known: Known<R>,
    pub(super) load: load::State<R>,
    pub(super) sums: Sums<R>,
    pub(super) seed: [u64; LANES],
    pub(super) number: [u64; LANES],
    /// Worlds of the batch (the last tile may have fewer than sixteen), and those whose episode has ended.
    pub(super) used: u16,
    pub(super) ended: u16,
}

/// A drone of a tile of worlds.
#[derive(Clone, Copy)]
pub(super) struct Pilot<R> {
    pub(super) last_action: [R; ACTION],
    pub(super) goal: [R; GOAL],
    /// Acceleration that its rope gave it in the last tick.
    pub(super) pull_mps2: [R; 3],
    /// Worlds in which it flies.
    pub(super) flying: u16,
}

/// What the parts of a step hand to each other, drone by drone.
pub(super) struct Desk<R: Batched> {
    /// Of a group of tiles, one after the other.
    pub(super) scene: Vec<Neighbour<R>>,
    push: Vec<Push<R>>,
    pub(super) ticks: Vec<[Tick<R>; GROUP]>,
    pub(super) actions: Vec<[[R; ACTION]; GROUP]>,
    /// Of one tile.
    pub(super) contacts: Vec<Contact<R>>,
    pub(super) setpoints: Vec<Setpoint<R>>,
    pub(super) verdicts: Vec<Verdict<R>>,
    pub(super) hit: Vec<R::Mask>,
    free_mps2: Vec<[R; 3]>,
    moving: Vec<Neighbour<R>>,
    pulls_mps2: Vec<[R; 3]>,
    pub(super) turned: Vec<R>,
    /// Of episodes that begin.
    pub(super) starts: Vec<Start>,
    pub(super) begun: Vec<f64>,
    pub(super) x: Vec<State<R>>,
    pub(super) u: Vec<Command<R>>,
    pub(super) hanging: load::State<R>,
    /// Observations of one drone in a tile of worlds.
    pub(super) rows: Vec<f32>,
}

pub(super) struct Flock<R: Batched> {
    /// Of each drone, in all tiles.
    pub(super) drones: Vec<World<R>>,
    pub(super) load: Option<Load>,
    drone_kg: Vec<R>,
    gravity_mps2: f64,
    pub(super) worlds: usize,
    pub(super) tiles: Vec<Tile<R>>,
    /// By tile, then by drone.
    pub(super) pilots: Vec<Pilot<R>>,
    /// By tile.
    boards: Vec<R>,
    pub(super) desk: Desk<R>,
    pub(super) final_observations: Vec<f32>,
}

impl<R: Batched> Flock<R> {
    pub(super) fn new(whole: &Whole<'_>, load: Option<Load>, board: usize, drones: usize) -> Result<Self> {
        let Whole { models, inputs, options, worlds, tick_s } = *whole;
        let tiles = worlds.div_ceil(LANES);
        let one = |j: usize| {
            let settings = Settings { input: inputs[j], physics_hz: options.env.physics_hz };
            World::new(models[j], &options.effects(j), settings, tiles)
        };
        let zero = R::zero();
        let pilot = Pilot { last_action: [zero; ACTION], goal: [zero; GOAL], pull_mps2: [zero; 3], flying: 0 };
        let tile = |i: usize| {
            let left = worlds - i * LANES;
            let used = if left >= LANES { u16::MAX } else { (1 << left) - 1 };
            let known = Known::new(options.shared.neighbours, drones, tick_s);
            Tile { known, load: load::State::rest(), sums: Sums::none(), seed: [0; LANES], number: [0; LANES], used, ended: 0 }
        };
        let kept = if options.env.autoreset == Autoreset::SameStep { worlds } else { 0 };
        Ok(Flock {
            drones: (0..drones).map(one).collect::<Result<_>>()?,
            load,
            drone_kg: models.iter().map(|m| R::of(m.vehicle.mass.value)).collect(),
            gravity_mps2: models[0].lateral.gravity.value,
            worlds,
            tiles: (0..tiles).map(tile).collect(),
            pilots: vec![pilot; tiles * drones],
            boards: vec![zero; tiles * board],
            desk: Desk::new(drones, board),
            final_observations: vec![0.0; kept * drones * (OBSERVATION + NEIGHBOUR * (drones - 1))],
        })
    }

    pub(super) fn len(&self) -> usize {
        self.drones.len()
    }
    pub(super) fn tiles(&self) -> usize {
        self.tiles.len()
    }
    pub(super) fn used(&self, tile: usize) -> u32 {
        self.tiles[tile].used.into()
    }
    pub(super) fn ended(&self, tile: usize) -> u16 {
        self.tiles[tile].ended
    }
    #[inline(always)]
    pub(super) fn pilot(&self, tile: usize, drone: usize) -> &Pilot<R> {
        &self.pilots[tile * self.drones.len() + drone]
    }
    #[inline(always)]
    pub(super) fn pilot_mut(&mut self, tile: usize, drone: usize) -> &mut Pilot<R> {
        &mut self.pilots[tile * self.drones.len() + drone]
    }
    #[inline(always)]
    pub(super) fn board(&self, tile: usize) -> &[R] {
        let size = self.desk.begun.len();
        &self.boards[tile * size..(tile + 1) * size]
    }
    #[inline(always)]
    pub(super) fn board_mut(&mut self, tile: usize) -> &mut [R] {
        let size = self.desk.begun.len();
        &mut self.boards[tile * size..(tile + 1) * size]
    }
    #[inline(always)]
    pub(super) fn state(&self, tile: usize, drone: usize) -> &State<R> {
        self.drones[drone].state(tile)
    }

    /// What a mission knows of a tile, at `place` of its group.
    #[inline(always)]
    pub(super) fn scene(&self, tile: usize, place: usize) -> Scene<'_, R> {
        let n = self.drones.len();
        Scene {
            drones: &self.desk.scene[place * n..(place + 1) * n],
            load: self.load.is_some().then_some(&self.tiles[tile].load),
            t_s: self.drones[0].time_s(tile),
        }
    }

    /// One tick of motion for `n` tiles from `first` on.
    // one copy for all missions, as of everything here
    #[inline(never)]
    pub(super) fn advance(&mut self, rules: &Rules, first: usize, n: usize, actions: &[f32]) {
        R::run(
            #[inline(always)]
            || {
                for place in 0..n {
                    self.prepare(first + place, place);
                }
                for drone in 0..self.drones.len() {
                    self.obey(rules, drone, first, n, actions);
                }
            },
        );
    }

    /// Who is where at the middle of the coming tick, and how the ropes will pull.
    #[inline(always)]
    fn prepare(&mut self, tile: usize, place: usize) {
        let n = self.drones.len();
        let Flock { drones, desk, pilots, tiles, load, drone_kg, gravity_mps2, .. } = self;
        let tick_s = drones[0].tick_s();
        let pilots = &mut pilots[tile * n..(tile + 1) * n];
        let scene = &mut desk.scene[place * n..(place + 1) * n];
        for ((drone, pilot), seen) in drones.iter().zip(pilots.iter()).zip(scene.iter_mut()) {
            *seen = neighbour(drone.state(tile), pilot.flying);
        }
        if let Some(load) = load {
            for ((drone, pilot), free) in drones.iter().zip(pilots.iter()).zip(&mut desk.free_mps2) {
                let acc_mps2 = drone.acc_mps2(tile);
                for i in 0..3 {
                    free[i] = acc_mps2[i] - pilot.pull_mps2[i];
                }
            }
            let ropes = Ropes { moving: &mut desk.moving, pulls_mps2: &mut desk.pulls_mps2, drone_kg };
            load.step(&mut tiles[tile].load, scene, &desk.free_mps2, ropes, [tick_s, *gravity_mps2]);
            for ((pilot, pull), push) in pilots.iter_mut().zip(&desk.pulls_mps2).zip(&mut desk.push[place * n..]) {
                pilot.pull_mps2 = *pull;
                push.acc_mps2 = *pull;
            }
        }
        let half = R::of(0.5 * tick_s);
        for (drone, seen) in drones.iter().zip(scene) {
            let acc_mps2 = drone.acc_mps2(tile);
            for i in 0..3 {
                seen.pos_m[i] += half * seen.vel_mps[i];
                seen.vel_mps[i] += half * acc_mps2[i];
            }
        }
    }

    /// One drone of a group of tiles obeys its actions.
    #[inline(always)]
    fn obey(&mut self, rules: &Rules, drone: usize, first: usize, n: usize, actions: &[f32]) {
        let all = self.drones.len();
        let Flock { drones, desk, pilots, worlds, load, .. } = self;
        let world = &mut drones[drone];
        let reach = rules.interfaces[drone].reach();
        let mut commands = [Command::level(R::zero()); GROUP];
        let flying = |i: usize| pilots[(first + i) * all + drone].flying;
        // who no longer flies stays where it is
        let halted = (0..n).any(|i| flying(i) != u16::MAX);
        let before = halted.then(|| [*world.state(first), *world.state(first + n - 1)]);
        let row = &mut desk.actions[drone];
        for i in 0..n {
            row[i] = gather(actions, (first + i) * LANES, *worlds, drone, all);
            commands[i] = reach.command(&row[i]);
        }
        if load.is_none() && world.is_plain() {
            for i in 0..n {
                desk.ticks[drone][i] = world.step_plain(first + i, &commands[i]);
            }
        } else {
            let around =
                |i: usize| Around { neighbours: &desk.scene[i * all..(i + 1) * all], own: drone, push: desk.push[i * all + drone] };
            let around = [around(0), around(n - 1)];
            world.step_group(first, &commands[..n], Some(&around), &mut desk.ticks[drone][..n]);
        }
        for (i, before) in before.iter().flat_map(|both| &both[..n]).enumerate() {
            world.halt(first + i, R::mask(u32::from(!flying(i))), before);
        }
    }

    pub(super) fn states(&self, rows: &mut [f32]) {
        let n = self.drones.len();
        for (i, row) in rows.chunks_exact_mut(STATE).enumerate() {
            let (world, drone) = (i / n, i % n);
            write_lane(&state_row(self.state(world / LANES, drone)), world % LANES, row);
        }
    }

    pub(super) fn loads(&self, rows: &mut [f32]) -> bool {
        for (world, row) in rows.chunks_exact_mut(3).enumerate() {
            write_lane(&self.tiles[world / LANES].load.pos_m, world % LANES, row);
        }
        self.load.is_some()
    }

    pub(super) fn last_of_episode(&self, world: usize) -> Option<&[f32]> {
        let size = self.final_observations.len() / self.worlds;
        self.final_observations.get(world * size..(world + 1) * size).filter(|rows| !rows.is_empty())
    }
}

#[inline(always)]
pub(super) fn neighbour<R: Batched>(x: &State<R>, flying: u16) -> Neighbour<R> {
    Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::select(R::mask(flying.into()), R::of(1.0), R::zero()) }
}

/// A drone's actions in sixteen worlds from `first` on; none where there are no more worlds.
#[inline(always)]
fn gather<R: Batched>(actions: &[f32], first: usize, worlds: usize, drone: usize, drones: usize) -> [R; ACTION] {
    let mut rows = [0.0; LANES * ACTION];
    let count = LANES.min(worlds - first);
    for (lane, row) in rows.chunks_exact_mut(ACTION).take(count).enumerate() {
        let at = ((first + lane) * drones + drone) * ACTION;
        row.copy_from_slice(&actions[at..at + ACTION]);
    }
    R::read4(&rows)
}

impl<R: Batched> Desk<R> {
    fn new(drones: usize, board: usize) -> Self {
        let (zero, group, nothing) = (R::zero(), GROUP * drones, R::nothing());
        let none = [zero; 3];
        Desk {
            scene: vec![Neighbour::gone(); group],
            push: vec![Push::none(); group],
            ticks: vec![[Tick::none(); GROUP]; drones],
            actions: vec![[[zero; ACTION]; GROUP]; drones],
            contacts: vec![Tick::none().contact; drones],
            setpoints: vec![Setpoint::origin(); drones],
            verdicts: vec![Verdict { reward: zero, error_m: zero, arrived: nothing, done: nothing }; drones],
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

impl<R: Batched> Sums<R> {
    pub(super) fn none() -> Self {
        let zero = R::zero();
        // nobody is nearer than the room is wide
        let nearest2_m2 = R::of(100.0);
        Sums { collisions: zero, crashes: zero, done: zero, nearest2_m2, settled_s: zero, error2_m2: zero, flown: zero }
    }

    /// In the order of [`METRICS`].
    #[inline(always)]
    pub(super) fn row(&self, arrived: R) -> [R; METRICS.len()] {
        let rms_m = (self.error2_m2 / self.flown.max(R::of(1.0))).sqrt();
        [self.collisions, self.crashes, self.nearest2_m2.sqrt(), self.settled_s, rms_m, self.done + arrived]
    }
}
