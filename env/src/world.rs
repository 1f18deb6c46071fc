//! The data path: command -> effects on it -> pushes -> exact step -> camera frame -> reading. Reads like one drone; a tile is sixteen.

use crate::config::{EffectTable, Number, Ranged, numbers};
use crate::effects::{self, Body, Cx, Fix, Frame, Reading, Simulated, Stage};
use crate::error::{Error, Result};
use crate::isa::Level;
use crate::model::{Model, VerticalInput};
use crate::noise::{Draw, Keys};
use crate::plant::{Command, Plant, Push, State};
use crate::real::{Real, Word};
use crate::schedule::Schedule;

/// Nominal cell voltage (thesis 3.1.1): what is read without a battery effect.
const NOMINAL_V: f64 = 3.7;

/// The drones of one tile.
#[derive(Debug, Clone)]
struct Tile<R: Real> {
    x: State<R>,
    keys: Keys<R>,
    /// Control ticks since the episode began, as a word for the noise and as a number for the time.
    tick: R::Word,
    ticks: R,
    /// Base-clock counts until the next camera frame.
    until_frame: R,
    marker: Fix<R>,
}

/// Speed at which the floor was hit, and whether the vehicle stands on it.
#[derive(Debug, Clone, Copy)]
pub struct Contact<R: Real> {
    pub impact_mps: R,
    pub standing: R::Mask,
}

/// Lists of stages by hook, so that a tick calls only what has something to do.
#[derive(Debug, Default)]
struct Order {
    command: Vec<usize>,
    push: Vec<usize>,
    frame: Vec<usize>,
    sense: Vec<usize>,
}

/// Drones with their effects; each lane is a drone of its own that never feels its neighbours.
pub struct World<R: Simulated> {
    schedule: Schedule,
    body: Body<R>,
    /// Over one physics step, and over each whole number of base counts within it for frames that fall between.
    plant: Plant<R>,
    partial: Vec<Plant<R>>,
    steps_per_tick: u32,
    counts_per_step: u32,
    tick_s: f64,
    gravity_mps2: R,
    /// Active effects, in registry order, with what their parameters are drawn from.
    stages: Vec<Box<dyn Stage<R>>>,
    order: Order,
    drawn: Vec<(usize, Vec<Ranged>)>,
    tiles: Vec<Tile<R>>,
}

/// Physics settings of a world.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    pub input: VerticalInput,
    /// See [`crate::config::Options::physics_hz`].
    pub physics_hz: Option<u32>,
    pub level: Level,
}

impl<R: Simulated> World<R> {
    /// A world of `tiles` tiles at rest on the floor.
    ///
    /// # Errors
    /// [`Error::Unknown`] or [`Error::Range`] for effects; [`Error::Range`] if `physics_hz` does not divide the tick into whole base counts.
    pub fn new(model: &Model, effects: &EffectTable, settings: Settings, tiles: usize) -> Result<Self> {
        crate::config::check_effects(effects)?;
        let schedule = Schedule::of(model)?;
        let active = active(&model.effects, effects)?;
        let pushes = active.iter().any(|(_, entry, _)| entry.hooks.push || entry.hooks.command);
        let counts_per_step = counts_per_step(&schedule, settings.physics_hz, pushes)?;
        let plant_over = |counts: u32| Plant::new(model, settings.input, schedule.seconds(counts));
        let mut order = Order::default();
        let (mut stages, mut drawn) = (Vec::new(), Vec::new());
        for (i, (_, entry, values)) in active.into_iter().enumerate() {
            let per_drone = values.iter().any(|v| v.fixed().is_none());
            let mut stage = R::stage(entry, effects::Build { tiles, per_drone, level: settings.level });
            if per_drone {
                drawn.push((i, values));
            } else {
                let fixed: Vec<f64> = values.iter().filter_map(Number::fixed).collect();
                stage.set(0, 0, &fixed);
            }
            let hooks = entry.hooks;
            let lists = [
                (hooks.command, &mut order.command),
                (hooks.push, &mut order.push),
                (hooks.frame, &mut order.frame),
                (hooks.sense, &mut order.sense),
            ];
            for (_, list) in lists.into_iter().filter(|(has, _)| *has) {
                list.push(i);
            }
            stages.push((entry, stage));
        }
        let entries: Vec<_> = stages.iter().map(|(entry, _)| *entry).collect();
        Ok(World {
            schedule,
            body: body(model, settings.input)?,
            plant: plant_over(counts_per_step)?,
            partial: (1..counts_per_step).map(plant_over).collect::<Result<_>>()?,
            steps_per_tick: schedule.control / counts_per_step,
            counts_per_step,
            tick_s: schedule.seconds(schedule.control),
            gravity_mps2: R::of(model.lateral.gravity.value),
            drawn: drawn.into_iter().map(|(i, values)| (i, with_ranges(entries[i], values))).collect(),
            stages: stages.into_iter().map(|(_, stage)| stage).collect(),
            order,
            tiles: vec![Tile::new(); tiles],
        })
    }

    /// Seconds per control tick.
    pub fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The true state of a tile.
    #[inline(always)]
    pub fn state(&self, tile: usize) -> &State<R> {
        &self.tiles[tile].x
    }

    /// Time since each lane's episode began.
    #[inline(always)]
    pub fn time_s(&self, tile: usize) -> R {
        self.tiles[tile].ticks * R::of(self.tick_s)
    }

    /// The noise of the current tick.
    #[inline(always)]
    pub fn draw(&self, tile: usize) -> Draw<R> {
        let t = &self.tiles[tile];
        t.keys.at(t.tick)
    }

    /// Prepare one lane for a new episode: its noise key and its drawn parameters. Call [`World::start`] for all such lanes after.
    pub fn draw_lane(&mut self, tile: usize, lane: usize, key: u64, rng: &mut rand_pcg::Pcg64Mcg) {
        self.tiles[tile].keys.set_lane(lane, key);
        self.tiles[tile].tick.set_lane(lane, 0);
        let mut values = [0.0; 8];
        for (stage, numbers) in &self.drawn {
            let drawn = &mut values[..numbers.len()];
            for (slot, number) in drawn.iter_mut().zip(numbers) {
                *slot = number.draw(rng);
            }
            self.stages[*stage].set(tile, lane, drawn);
        }
    }

    /// Begin episodes in the lanes of `mask` from the state `x`, with the command `u` in force until now.
    pub fn start(&mut self, tile: usize, mask: R::Mask, x: &State<R>, u: &Command<R>) -> Reading<R> {
        let t = &mut self.tiles[tile];
        let pick = |new: R, old: R| R::select(mask, new, old);
        for i in 0..3 {
            t.x.pos_m[i] = pick(x.pos_m[i], t.x.pos_m[i]);
            t.x.vel_mps[i] = pick(x.vel_mps[i], t.x.vel_mps[i]);
            t.x.att_rad[i] = pick(x.att_rad[i], t.x.att_rad[i]);
            t.x.rate_radps[i] = pick(x.rate_radps[i], t.x.rate_radps[i]);
        }
        for i in 0..2 {
            t.x.aux[i] = pick(x.aux[i], t.x.aux[i]);
        }
        t.ticks = pick(R::zero(), t.ticks);
        // one frame is taken as the episode begins
        t.until_frame = pick(R::of(f64::from(self.schedule.camera)), t.until_frame);
        let draw = t.keys.at(t.tick);
        let (x, tick_s) = (t.x, R::of(self.tick_s));
        let cx =
            Cx { body: &self.body, h_s: tick_s, tick_s, since_tick_s: R::zero(), t_s: t.ticks * tick_s, first: true, draw, channel: 0 };
        for stage in &mut self.stages {
            stage.start(tile, mask, &cx, &x, u);
        }
        let mut frame = Frame::of(&x, mask, cx.t_s);
        for &i in &self.order.frame {
            self.stages[i].frame(tile, &cx, &x, &mut frame);
        }
        // whatever its latency, the pose from before the episode is known when it begins
        t.marker.deliver(mask, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
        t.marker.valid = R::select(mask & frame.markers.lt(R::of(0.5)), R::zero(), t.marker.valid);
        let mut y = reading(&x, &t.marker, [R::zero(), R::zero(), self.gravity_mps2]);
        for &i in &self.order.sense {
            self.stages[i].peek(tile, &cx, &x, u, &mut y);
        }
        y
    }

    /// One control tick of one tile.
    #[inline(always)]
    pub fn step(&mut self, tile: usize, command: &Command<R>) -> (Reading<R>, Contact<R>) {
        let t = &mut self.tiles[tile];
        t.tick = t.tick.add(R::Word::of(1));
        let tick_s = R::of(self.tick_s);
        let began_s = t.ticks * tick_s;
        let h_s = R::of(self.tick_s / f64::from(self.steps_per_tick));
        let mut cx =
            Cx { body: &self.body, h_s, tick_s, since_tick_s: R::zero(), t_s: began_s, first: true, draw: t.keys.at(t.tick), channel: 0 };
        let flying = !self.order.frame.is_empty();
        let captured = t.until_frame.le(R::of(f64::from(self.schedule.control)));
        let mut at_frame = t.x;
        let mut contact = Contact { impact_mps: R::zero(), standing: R::nothing() };
        let (mut u, mut push, mut climb_mps) = (*command, Push::none(), R::zero());
        for step in 0..self.steps_per_tick {
            u = *command;
            for &i in &self.order.command {
                self.stages[i].command(tile, &cx, &t.x, &mut u);
            }
            push = Push::none();
            for &i in &self.order.push {
                self.stages[i].push(tile, &cx, &t.x, &u, &mut push);
            }
            climb_mps = t.x.vel_mps[2];
            let mut next = self.plant.advance(&t.x, &u, &push);
            land(&mut next, &mut contact);
            if flying {
                let since = self.counts_per_step * step;
                for counts in 1..=self.counts_per_step {
                    let now = t.until_frame.le(R::of(f64::from(since + counts))) & t.until_frame.gt(R::of(f64::from(since + counts - 1)));
                    if R::any(now) {
                        let then =
                            if counts == self.counts_per_step { next } else { self.partial[counts as usize - 1].advance(&t.x, &u, &push) };
                        at_frame = at_frame.merge(now, &then);
                    }
                }
            }
            t.x = next;
            cx.first = false;
            cx.since_tick_s += h_s;
            cx.t_s += h_s;
        }
        t.ticks += R::of(1.0);
        cx.t_s = t.ticks * tick_s;
        cx.h_s = tick_s;
        if flying {
            if R::any(captured) {
                let count_s = R::of(self.schedule.seconds(1));
                let mut frame = Frame::of(&at_frame, captured, began_s + t.until_frame * count_s);
                let since_frame = Cx { h_s: R::of(self.schedule.seconds(self.schedule.camera)), ..cx };
                for &i in &self.order.frame {
                    self.stages[i].frame(tile, &since_frame, &at_frame, &mut frame);
                }
                t.marker.deliver(frame.captured, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
            }
            let more = R::select(captured, R::of(f64::from(self.schedule.camera)), R::zero());
            t.until_frame = t.until_frame + more - R::of(f64::from(self.schedule.control));
        } else {
            t.marker = Fix { pos_m: t.x.pos_m, yaw_rad: t.x.att_rad[2], t_s: cx.t_s, valid: R::of(1.0) };
        }
        let (sin, cos) = t.x.att_rad[2].sin_cos();
        let [ax, ay, _] = push.acc_mps2;
        let climb = (t.x.vel_mps[2] - climb_mps) / h_s;
        let mut y = reading(&t.x, &t.marker, [cos * ax + sin * ay, cos * ay - sin * ax, climb + self.gravity_mps2]);
        for &i in &self.order.sense {
            self.stages[i].sense(tile, &cx, &t.x, &u, &mut y);
        }
        t.marker = y.marker;
        (y, contact)
    }
}

fn with_ranges(entry: &effects::Entry, values: Vec<Number>) -> Vec<Ranged> {
    values.into_iter().zip(entry.params).map(|(number, param)| Ranged { number, param }).collect()
}

type Active = (usize, &'static effects::Entry, Vec<Number>);

/// The effects of the model and of the configuration that are not off, the configuration's winning, in registry order.
fn active(of_model: &EffectTable, of_config: &EffectTable) -> Result<Vec<Active>> {
    let mut table = of_model.clone();
    table.extend(of_config.iter().map(|(name, given)| (name.clone(), given.clone())));
    let mut active = Vec::new();
    for (name, given) in &table {
        let (place, entry) = effects::find(name)?;
        let values = numbers(entry, given);
        let off = values.iter().zip(entry.params).all(|(v, p)| v.fixed() == Some(p.off));
        if !off {
            active.push((place, entry, values));
        }
    }
    active.sort_by_key(|(place, ..)| *place);
    Ok(active)
}

/// Without pushes one exact step per tick; with them the IMU's rate, unless the user says otherwise.
fn counts_per_step(schedule: &Schedule, physics_hz: Option<u32>, pushes: bool) -> Result<u32> {
    let Some(hz) = physics_hz else {
        return Ok(if pushes { schedule.imu } else { schedule.control });
    };
    let counts = if hz == 0 { 0 } else { schedule.base_hz / hz };
    if counts == 0 || !schedule.base_hz.is_multiple_of(hz) || !schedule.control.is_multiple_of(counts) {
        let good: Vec<String> =
            (1..=schedule.control).filter(|c| schedule.control.is_multiple_of(*c)).map(|c| (schedule.base_hz / c).to_string()).collect();
        return Err(Error::Range { name: "physics_hz".into(), value: f64::from(hz), want: format!("one of {}", good.join(", ")) });
    }
    Ok(counts)
}

fn body<R: Real>(model: &Model, input: VerticalInput) -> Result<Body<R>> {
    let hover = model.vertical(input)?.hover_pwm().filter(|_| input.is_pwm());
    let tilts = [&model.roll, &model.pitch];
    Ok(Body {
        gravity_mps2: R::of(model.lateral.gravity.value),
        mass_kg: R::of(model.vehicle.mass.value),
        rotor_radius_m: R::of(model.vehicle.rotor_radius.value),
        battery_capacity_c: R::of(model.vehicle.battery_capacity.value),
        hover_current_a: R::of(model.vehicle.hover_current.value),
        per_hover_pwm: R::of(hover.map_or(0.0, |h| 1.0 / h)),
        height_command: R::of(if hover.is_some() { 0.0 } else { 1.0 }),
        arm_m: R::of(model.vehicle.arm.value),
        yaw_sign: R::of(model.yaw.sign()),
        tilt_gain_ps2: tilts.map(|t| R::of(t.gain.value)),
        tilt_damping_ps: tilts.map(|t| R::of(t.damping.value)),
        tilt_stiffness_ps2: tilts.map(|t| R::of(t.stiffness.value)),
    })
}

/// The floor carries: no sinking, and on its legs the vehicle neither slides nor tilts.
#[inline(always)]
fn land<R: Real>(x: &mut State<R>, contact: &mut Contact<R>) {
    let below = x.pos_m[2].lt(R::zero());
    contact.standing = below;
    if !R::any(below) {
        return;
    }
    contact.impact_mps = contact.impact_mps.max(R::select(below, -x.vel_mps[2], R::zero()));
    let still = |v: R| R::select(below, R::zero(), v);
    x.pos_m[2] = still(x.pos_m[2]);
    x.vel_mps = x.vel_mps.map(still);
    x.att_rad = [still(x.att_rad[0]), still(x.att_rad[1]), x.att_rad[2]];
    x.rate_radps = x.rate_radps.map(still);
    x.aux = [R::select(below, x.aux[0].max(R::zero()), x.aux[0]), still(x.aux[1])];
}

#[inline(always)]
fn reading<R: Real>(x: &State<R>, marker: &Fix<R>, acc_mps2: [R; 3]) -> Reading<R> {
    Reading { marker: *marker, att_rad: x.att_rad, gyro_radps: x.rate_radps, acc_mps2, vbat_v: R::of(NOMINAL_V) }
}

impl<R: Real> Frame<R> {
    #[inline(always)]
    fn of(x: &State<R>, captured: R::Mask, t_s: R) -> Self {
        let (one, zero) = (R::of(1.0), R::zero());
        Frame { captured, markers: one, pos_m: x.pos_m, yaw_rad: x.att_rad[2], t_s, field: [one, one, one], nearest_m: [zero, zero] }
    }
}

impl<R: Real> State<R> {
    /// `other` in the lanes of `mask`.
    #[inline(always)]
    fn merge(&self, mask: R::Mask, other: &Self) -> Self {
        let pick = |a: [R; 3], b: [R; 3]| std::array::from_fn(|i| R::select(mask, b[i], a[i]));
        State {
            pos_m: pick(self.pos_m, other.pos_m),
            vel_mps: pick(self.vel_mps, other.vel_mps),
            att_rad: pick(self.att_rad, other.att_rad),
            rate_radps: pick(self.rate_radps, other.rate_radps),
            aux: std::array::from_fn(|i| R::select(mask, other.aux[i], self.aux[i])),
        }
    }
}

impl<R: Real> Tile<R> {
    fn new() -> Self {
        let marker = Fix { pos_m: [R::zero(); 3], yaw_rad: R::zero(), t_s: R::zero(), valid: R::of(1.0) };
        Tile { x: State::rest(), keys: Keys::new(), tick: R::Word::of(0), ticks: R::zero(), until_frame: R::of(1e9), marker }
    }
}
