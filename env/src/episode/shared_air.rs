//! Drones that share the air: their scene, their wakes, ropes and a load, radio, and collisions.

use super::{Around, At, Coupling, Drone};
use crate::archive::Archive;
use crate::config::Options;
use crate::coupling::load::{self, Load, Ropes};
use crate::coupling::{Communication, Knowledge, NEIGHBOUR};
use crate::effects::{Neighbour, Reading};
use crate::error::Result;
use crate::expression::Pairs;
use crate::model::Model;
use crate::noise::drone_key;
use crate::plant::{Accelerations, State};
use crate::scalar::{Scalar, merge, tabulate};
use crate::sim_scalar::{BatchScalar, SimScalar};
use crate::world::{GROUP, Tick, World};

/// The coupling of tasks for several drones.
pub(crate) struct SharedAir<R: SimScalar> {
    drones: usize,
    tiles: Vec<AirTile<R>>,
    /// By tile, then by drone.
    slots: Vec<AirSlot<R>>,
    radius_m: f64,
    load: Option<Load>,
    drone_kg: Vec<R>,
    gravity_mps2: f64,
    tick_s: f64,
    /// The drones of a group of tiles, one tile after the other, and what pulls them.
    scene: Vec<Neighbour<R>>,
    push: Vec<Accelerations<R>>,
    /// Mask of one tile.
    hit: Vec<R::Mask>,
    free_mps2: Vec<[R; 3]>,
    moving: Vec<Neighbour<R>>,
    pulls_mps2: Vec<[R; 3]>,
}

/// The air of a tile of environments.
struct AirTile<R> {
    known: Communication<R>,
    load: load::State<R>,
    /// Smallest square of a distance between two that flew.
    nearest2_m2: R,
}

/// A drone of a tile in the air.
#[derive(Clone, Copy)]
struct AirSlot<R: Scalar> {
    /// Environments in which it flies.
    flies: R::Mask,
    /// Acceleration that its rope gave it in the last tick.
    pull_mps2: [R; 3],
}

/// Settings of shared air.
pub(crate) struct AirSettings {
    pub(crate) knowledge: Knowledge,
    /// Two drones collide nearer than twice this.
    pub(crate) radius_m: f64,
    pub(crate) load: Option<Load>,
    /// Mass of each drone.
    pub(crate) drone_kg: Vec<f64>,
    pub(crate) gravity_mps2: f64,
    pub(crate) tick_s: f64,
}

impl AirSettings {
    /// Creates the air of the drones of these models, by `options`.
    pub(crate) fn new(models: &[&Model], options: &Options, load: Option<Load>, tick_s: f64) -> Self {
        AirSettings {
            knowledge: options.neighbours,
            radius_m: options.radius_m,
            load,
            drone_kg: models.iter().map(|model| model.vehicle.mass.value).collect(),
            gravity_mps2: models[0].lateral.gravity.value,
            tick_s,
        }
    }
}

/// Nobody is nearer than the room is wide.
const FARTHEST2_M2: f64 = 100.0;

impl<R: SimScalar> SharedAir<R> {
    /// Updates the scene, and marks drones that are nearer to another than two radii.
    #[inline(always)]
    fn collide(&mut self, tile: usize, place: usize, drones: &[Drone<R>]) {
        let n = self.drones;
        let scene = &mut self.scene[place * n..(place + 1) * n];
        for (own, seen) in scene.iter_mut().enumerate() {
            *seen = neighbour(drones[own].world.state(tile), self.slots[tile * n + own].flies);
        }
        mark_hits(scene, self.radius_m, &mut self.hit, &mut self.tiles[tile].nearest2_m2);
    }

    /// The numbers of [`crate::expression::PAIR_FIELDS`].
    #[inline(always)]
    fn pairs_now(&self, at: At) -> Pairs<R> {
        let scene = &self.scene[at.place * self.drones..(at.place + 1) * self.drones];
        let (own, mut nearest2_m2) = (&scene[at.own], R::from_f64(FARTHEST2_M2));
        let (mut sum_m, mut count) = ([R::zero(); 3], R::zero());
        for (_, other) in scene.iter().enumerate().filter(|(i, _)| *i != at.own) {
            let flies = R::zero().lt(other.here);
            nearest2_m2 = R::select(flies, gap2_m2(own, other).min(nearest2_m2), nearest2_m2);
            for (sum, p) in sum_m.iter_mut().zip(other.pos_m) {
                *sum += other.here * p;
            }
            count += other.here;
        }
        let [x, y, z] = tabulate(
            #[inline(always)]
            |i| R::select(R::zero().lt(count), sum_m[i] / count.max(R::from_f64(1.0)), own.pos_m[i]),
        );
        let AirTile { load, nearest2_m2: least2_m2, .. } = &self.tiles[at.tile];
        let [load_x, load_y, load_z] = load.pos_m;
        [nearest2_m2.sqrt(), least2_m2.sqrt(), x, y, z, load_x, load_y, load_z]
    }
}

impl<R: SimScalar> Coupling<R> for SharedAir<R> {
    const ALONE: bool = false;
    type Each<X: Send> = Vec<X>;
    type Seen<'a> = &'a [Neighbour<R>];

    fn new(tiles: usize, settings: AirSettings) -> Self {
        let AirSettings { knowledge, radius_m, load, drone_kg, gravity_mps2, tick_s } = settings;
        let (drones, none) = (drone_kg.len(), [R::zero(); 3]);
        let tile = |_| AirTile {
            known: Communication::new(knowledge, drones, tick_s),
            load: load::State::rest(),
            nearest2_m2: R::from_f64(FARTHEST2_M2),
        };
        SharedAir {
            drones,
            tiles: (0..tiles).map(tile).collect(),
            slots: vec![AirSlot { flies: R::nothing(), pull_mps2: none }; tiles * drones],
            radius_m,
            load,
            drone_kg: drone_kg.into_iter().map(R::from_f64).collect(),
            gravity_mps2,
            tick_s,
            scene: vec![Neighbour::gone(); GROUP * drones],
            push: vec![Accelerations::none(); GROUP * drones],
            hit: vec![R::nothing(); drones],
            free_mps2: vec![none; drones],
            moving: vec![Neighbour::gone(); drones],
            pulls_mps2: vec![none; drones],
        }
    }

    fn each<X: Send>(drones: usize, make: impl FnMut(usize) -> Result<X>) -> Result<Vec<X>> {
        (0..drones).map(make).collect()
    }

    fn drone_key(episode_key: u64, drone: usize) -> u64 {
        drone_key(episode_key, drone)
    }

    #[inline(always)]
    fn begin(&mut self, tile: usize, mask: R::Mask, load_pos_m: &[R; 3]) {
        let AirTile { load, nearest2_m2, .. } = &mut self.tiles[tile];
        load.pos_m = merge(mask, load.pos_m, *load_pos_m);
        load.vel_mps = merge(mask, load.vel_mps, [R::zero(); 3]);
        *nearest2_m2 = R::select(mask, R::from_f64(FARTHEST2_M2), *nearest2_m2);
    }

    #[inline(always)]
    fn start(&mut self, at: At, mask: R::Mask, reading: &Reading<R>, x: &State<R>) {
        let slot = &mut self.slots[at.tile * self.drones + at.own];
        slot.flies = slot.flies | mask;
        slot.pull_mps2 = merge(mask, slot.pull_mps2, [R::zero(); 3]);
        self.tiles[at.tile].known.start(mask, at.own, &reading.marker);
        self.scene[at.place * self.drones + at.own] = neighbour(x, slot.flies);
    }

    #[inline(always)]
    fn before(&mut self, tile: usize, place: usize, drones: &[Drone<R>]) {
        let n = self.drones;
        let slots = &mut self.slots[tile * n..(tile + 1) * n];
        let scene = &mut self.scene[place * n..(place + 1) * n];
        for own in 0..n {
            scene[own] = neighbour(drones[own].world.state(tile), slots[own].flies);
        }
        if let Some(load) = &self.load {
            for own in 0..n {
                let acc_mps2 = drones[own].world.acc_mps2(tile);
                for i in 0..3 {
                    self.free_mps2[own][i] = acc_mps2[i] - slots[own].pull_mps2[i];
                }
            }
            let ropes = Ropes {
                moving: &mut self.moving,
                pulls_mps2: &mut self.pulls_mps2,
                drone_kg: &self.drone_kg,
            };
            let times = [self.tick_s, self.gravity_mps2];
            load.step(&mut self.tiles[tile].load, scene, &self.free_mps2, ropes, times);
            for own in 0..n {
                slots[own].pull_mps2 = self.pulls_mps2[own];
                self.push[place * n + own].acc_mps2 = self.pulls_mps2[own];
            }
        }
        let half_s = R::from_f64(0.5 * self.tick_s);
        for own in 0..n {
            look_ahead(&mut scene[own], drones[own].world.acc_mps2(tile), half_s);
        }
    }

    #[inline(always)]
    fn around(&self, own: usize, n: usize) -> Option<[Around<'_, R>; GROUP]> {
        let all = self.drones;
        let around = |place: usize| Around {
            neighbours: &self.scene[place * all..(place + 1) * all],
            own,
            push: self.push[place * all + own],
        };
        Some([around(0), around(n - 1)])
    }

    #[inline(always)]
    fn pulls(&self) -> bool {
        self.load.is_some()
    }

    #[inline(always)]
    fn held(&self, own: usize, first: usize, n: usize, world: &World<R>) -> Option<[State<R>; GROUP]> {
        for tile in first..first + n {
            if !R::all(self.flies(tile, own)) {
                return Some([*world.state(first), *world.state(first + n - 1)]);
            }
        }
        None
    }

    #[inline(always)]
    fn flies(&self, tile: usize, own: usize) -> R::Mask {
        self.slots[tile * self.drones + own].flies
    }

    // one copy for all tasks, as of all that drones do together
    #[inline(never)]
    fn after(&mut self, tile: usize, place: usize, drones: &[Drone<R>], ticks: &Vec<[Tick<R>; GROUP]>) {
        R::run(
            #[inline(always)]
            || {
                self.collide(tile, place, drones);
                let known = &mut self.tiles[tile].known;
                known.tick();
                for (own, ticks) in ticks.iter().enumerate() {
                    known.say(own, &ticks[place].reading.marker);
                }
                let n = self.drones;
                known.listen(&self.scene[place * n..(place + 1) * n], &drones[0].world.draw(tile));
            },
        );
    }

    #[inline(always)]
    fn seen(&self, place: usize, _: &State<R>) -> &[Neighbour<R>] {
        &self.scene[place * self.drones..(place + 1) * self.drones]
    }

    #[inline(always)]
    fn load(&self, tile: usize) -> Option<&load::State<R>> {
        self.load.is_some().then_some(&self.tiles[tile].load)
    }

    #[inline(always)]
    fn hit(&self, own: usize) -> R::Mask {
        self.hit[own]
    }

    #[inline(always)]
    fn set_flies(&mut self, tile: usize, own: usize, flies: R::Mask) {
        self.slots[tile * self.drones + own].flies = flies;
    }

    #[inline(always)]
    fn finish(&mut self, tile: usize, place: usize) {
        let n = self.drones;
        for own in 0..n {
            self.scene[place * n + own].here =
                R::select(self.slots[tile * n + own].flies, R::from_f64(1.0), R::zero());
        }
    }

    #[inline(always)]
    fn neighbour_row(&self, at: At, other: usize, now_s: R) -> [R; NEIGHBOUR] {
        let truth = &self.scene[at.place * self.drones..(at.place + 1) * self.drones];
        self.tiles[at.tile].known.neighbour_row(at.own, other, truth, now_s)
    }

    #[inline(always)]
    fn nearest2_m2(&self, tile: usize) -> R {
        self.tiles[tile].nearest2_m2
    }

    #[inline(never)]
    fn pairs(&self, at: At) -> Pairs<R> {
        R::run(
            #[inline(always)]
            || self.pairs_now(at),
        )
    }

    #[cfg(feature = "recording")]
    fn show_numbers(&mut self, tile: usize, ledger: &mut dyn crate::archive::Ledger<R>) {
        let slots = &mut self.slots[tile * self.drones..(tile + 1) * self.drones];
        let mut flies: Vec<R> =
            slots.iter().map(|slot| R::select(slot.flies, R::from_f64(1.0), R::zero())).collect();
        ledger.numbers("flies", &mut flies);
        for (slot, flies) in slots.iter_mut().zip(flies) {
            slot.flies = flies.gt(R::zero());
        }
        let AirTile { load, nearest2_m2, .. } = &mut self.tiles[tile];
        ledger.numbers("nearest2_m2", std::slice::from_mut(nearest2_m2));
        if self.load.is_some() {
            ledger.numbers("load_pos_m", &mut load.pos_m);
            ledger.numbers("load_vel_mps", &mut load.vel_mps);
            for (own, slot) in slots.iter_mut().enumerate() {
                ledger.numbers(&format!("pull{own}_mps2"), &mut slot.pull_mps2);
            }
        }
    }

    fn archive(&mut self, tile: usize, used: u16, archive: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
        let AirTile { known, load, nearest2_m2 } = &mut self.tiles[tile];
        known.archive(archive);
        archive.numbers(&mut load.pos_m);
        archive.numbers(&mut load.vel_mps);
        archive.number(nearest2_m2);
        for slot in &mut self.slots[tile * self.drones..(tile + 1) * self.drones] {
            let mut flies = R::bits(slot.flies) as u16;
            archive.bits(&mut flies, used);
            slot.flies = R::mask(flies.into());
            archive.numbers(&mut slot.pull_mps2);
        }
    }
}

/// A drone as the others feel it, in the lanes of `flies`.
#[inline(always)]
fn neighbour<R: Scalar>(x: &State<R>, flies: R::Mask) -> Neighbour<R> {
    Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::select(flies, R::from_f64(1.0), R::zero()) }
}

/// Moves a drone on by half a tick.
#[inline(always)]
fn look_ahead<R: Scalar>(seen: &mut Neighbour<R>, acc_mps2: &[R; 3], half_tick_s: R) {
    for i in 0..3 {
        seen.pos_m[i] += half_tick_s * seen.vel_mps[i];
        seen.vel_mps[i] += half_tick_s * acc_mps2[i];
    }
}

/// Square of the distance between two drones.
#[inline(always)]
fn gap2_m2<R: Scalar>(p: &Neighbour<R>, q: &Neighbour<R>) -> R {
    let [dx, dy, dz] = [p.pos_m[0] - q.pos_m[0], p.pos_m[1] - q.pos_m[1], p.pos_m[2] - q.pos_m[2]];
    dx * dx + dy * dy + dz * dz
}

/// Marks drones that are nearer to another than two radii, and keeps the smallest square of a distance.
#[inline(always)]
fn mark_hits<R: Scalar>(scene: &[Neighbour<R>], radius_m: f64, hit: &mut [R::Mask], nearest2_m2: &mut R) {
    let (n, near2) = (scene.len(), R::from_f64(4.0 * radius_m * radius_m));
    hit.fill(R::nothing());
    for a in 0..n {
        for b in a + 1..n {
            let (p, q) = (&scene[a], &scene[b]);
            let both = R::zero().lt(p.here * q.here);
            let far2 = R::select(both, gap2_m2(p, q), *nearest2_m2);
            *nearest2_m2 = nearest2_m2.min(far2);
            let touches = both & far2.lt(near2);
            hit[a] = hit[a] | touches;
            hit[b] = hit[b] | touches;
        }
    }
}
