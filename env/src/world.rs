//! The data path: command -> effects on it -> pushes -> exact step -> camera frame -> reading. Reads like one drone; a tile is sixteen.

use crate::config::{EffectTable, Number, Ranged, numbers};
use crate::effects::{self, Body, Cx, Fix, Frame, Reading, Stage};
use crate::error::{Error, Result};
use crate::model::{Model, VerticalInput};
use crate::noise::{Draw, Keys};
use crate::plant::{Command, Heading, Plant, Push, State};
use crate::real::{Real, Word, each, tabulate};
use crate::schedule::Schedule;
use crate::simulated::Simulated;

/// Nominal cell voltage (thesis 3.1.1): what is read without a battery effect.
const NOMINAL_V: f64 = 3.7;

/// The drones of one tile: first what every world touches in a step, then what only effects need.
#[derive(Debug, Clone)]
#[repr(C)]
struct Tile<R: Real> {
    x: State<R>,
    /// Control ticks since the episode began, as a word for the noise and as a number for the time.
    tick: R::Word,
    ticks: R,
    keys: Keys<R>,
    /// Acceleration over the last physics step.
    acc_mps2: [R; 3],
    /// Base-clock counts until the next camera frame.
    until_frame: R,
    /// The last marker pose, where effects film it.
    fix: Fix<R>,
    /// Control ticks since the world was made.
    clock: usize,
}

/// Speed at which the floor was hit, and whether the vehicle stands on it.
#[derive(Debug, Clone, Copy)]
pub struct Contact<R: Real> {
    pub impact_mps: R,
    pub standing: R::Mask,
}

/// What a tick brought: returned, not kept, because a large batch waits for memory.
#[derive(Debug, Clone, Copy)]
pub struct Tick<R: Real> {
    pub contact: Contact<R>,
    pub reading: Reading<R>,
}

/// Times as numbers of the lanes, ready for use.
#[derive(Debug, Clone, Copy)]
struct Times<R> {
    tick_s: R,
    per_tick: R,
    /// A physics step.
    h_s: R,
    per_h: R,
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
    /// Over one physics step.
    plant: Plant<R>,
    steps_per_tick: u32,
    counts_per_step: u32,
    tick_s: f64,
    times: Times<R>,
    gravity_mps2: R,
    floor: bool,
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
        let needed_hz = active.iter().map(|(_, entry, _)| entry.physics_hz).max().unwrap_or(0);
        let counts_per_step = counts_per_step(&schedule, settings.physics_hz, needed_hz)?;
        let mut order = Order::default();
        let (mut stages, mut drawn) = (Vec::new(), Vec::new());
        for (i, (_, entry, values)) in active.into_iter().enumerate() {
            let per_drone = values.iter().any(|v| v.fixed().is_none());
            let mut stage = R::stage(entry, effects::Build { tiles, per_drone });
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
        let tick_s = schedule.seconds(schedule.control);
        let steps_per_tick = schedule.control / counts_per_step;
        let h_s = tick_s / f64::from(steps_per_tick);
        let times = Times { tick_s: R::of(tick_s), per_tick: R::of(1.0 / tick_s), h_s: R::of(h_s), per_h: R::of(1.0 / h_s) };
        let entries: Vec<_> = stages.iter().map(|(entry, _)| *entry).collect();
        Ok(World {
            schedule,
            body: body(model, settings.input)?,
            plant: Plant::new(model, settings.input, schedule.seconds(counts_per_step))?,
            steps_per_tick,
            counts_per_step,
            tick_s,
            times,
            gravity_mps2: R::of(model.lateral.gravity.value),
            floor: true,
            drawn: drawn.into_iter().map(|(i, values)| (i, with_ranges(entries[i], values))).collect(),
            stages: stages.into_iter().map(|(_, stage)| stage).collect(),
            order,
            tiles: vec![Tile::new(); tiles],
        })
    }

    /// The same world without a floor, for a recorded flight's commands: where they would sink the model, the linear model says how far.
    #[must_use]
    pub fn without_floor(self) -> Self {
        World { floor: false, ..self }
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
        self.tiles[tile].ticks * self.times.tick_s
    }

    /// The noise of the current tick.
    #[inline(always)]
    pub fn draw(&self, tile: usize) -> Draw<'_, R> {
        let t = &self.tiles[tile];
        t.keys.at(&t.tick)
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

    /// Begin episodes in the lanes of `mask` from the state `x`, with the command `u` in force until now. The reading holds for those lanes
    /// only.
    #[inline(always)]
    pub fn start(&mut self, tile: usize, mask: R::Mask, x: &State<R>, u: &Command<R>) -> Reading<R> {
        let t = &mut self.tiles[tile];
        t.x = t.x.merge(mask, x);
        t.ticks = R::select(mask, R::zero(), t.ticks);
        // one frame is taken as the episode begins
        t.until_frame = R::select(mask, R::of(f64::from(self.schedule.camera)), t.until_frame);
        let (draw, tick_s) = (t.keys.at(&t.tick), self.tick_s);
        let x = t.x;
        let t_s = t.ticks * R::of(tick_s);
        let cx = Cx { body: &self.body, h_s: tick_s, tick_s, since_tick_s: 0.0, t_s, first: true, draw: &draw, clock: t.clock };
        for stage in &mut self.stages {
            stage.start(tile, mask, &cx, &x, u);
        }
        let mut frame = Frame::of(&x, mask, cx.t_s);
        for &i in &self.order.frame {
            self.stages[i].frame(tile, &cx, &x, &mut frame);
        }
        // whatever its latency, the pose from before the episode is known when it begins
        let none = [R::zero(); 3];
        let mut marker = Fix { pos_m: none, yaw_rad: R::zero(), t_s: cx.t_s, valid: R::zero() };
        marker.deliver(mask, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
        t.acc_mps2 = merge(mask, t.acc_mps2, none);
        let mut y = Reading::of(&x, [R::zero(), R::zero(), self.gravity_mps2], marker);
        for &i in &self.order.sense {
            self.stages[i].peek(tile, &cx, &x, u, &mut y);
        }
        t.fix = t.fix.merge(mask, &y.marker);
        y
    }

    /// One control tick of one tile; the state is in [`World::state`].
    #[inline(always)]
    pub fn step(&mut self, tile: usize, command: &Command<R>) -> Tick<R> {
        if !self.stages.is_empty() || self.steps_per_tick != 1 {
            return self.step_with_effects(tile, command);
        }
        // The same with nothing to call: everything stays in registers.
        let t = &mut self.tiles[tile];
        t.tick = t.tick.add(R::Word::of(1));
        t.ticks += R::of(1.0);
        let mut contact = Contact::none();
        let (mut next, _) = self.plant.advance(&t.x, command, &Push::none());
        if self.floor {
            land(&mut next, t.x.pos_m[2], &mut contact);
        }
        let climb_mps2 = (next.vel_mps[2] - t.x.vel_mps[2]) * self.times.per_tick;
        let specific_mps2 = [R::zero(), R::zero(), climb_mps2 + self.gravity_mps2];
        t.x = next;
        Tick { contact, reading: Reading::of(&next, specific_mps2, Fix::ideal(&next, t.ticks * self.times.tick_s)) }
    }

    #[inline(always)]
    fn step_with_effects(&mut self, tile: usize, command: &Command<R>) -> Tick<R> {
        let t = &mut self.tiles[tile];
        t.tick = t.tick.add(R::Word::of(1));
        t.clock += 1;
        let filming = !self.order.frame.is_empty();
        let (tick_s, h_s) = (self.tick_s, self.tick_s / f64::from(self.steps_per_tick));
        let draw = t.keys.at(&t.tick);
        let began_s = t.ticks * self.times.tick_s;
        let mut cx = Cx { body: &self.body, h_s, tick_s, since_tick_s: 0.0, t_s: began_s, first: true, draw: &draw, clock: t.clock };
        let mut contact = Contact::none();
        let (mut at_frame, mut captured) = (t.x, R::nothing());
        let (mut u, mut push) = (*command, Push::none());
        let mut specific_mps2 = [R::zero(); 3];
        for step in 1..=self.steps_per_tick {
            if !self.order.command.is_empty() {
                u = *command;
                for &i in &self.order.command {
                    self.stages[i].command(tile, &cx, &t.x, &mut u);
                }
            }
            if !self.order.push.is_empty() {
                push = Push::none();
                let middle = t.x.ahead(&t.acc_mps2, 0.5 * h_s);
                for &i in &self.order.push {
                    self.stages[i].push(tile, &cx, &middle, &u, &mut push);
                }
            }
            let (mut next, heading) = self.plant.advance(&t.x, &u, &push);
            if self.floor {
                land(&mut next, t.x.pos_m[2], &mut contact);
            }
            if filming {
                let counts = R::of(f64::from(self.counts_per_step));
                // counts from the frame to the end of this step: within it if 0 <= counts < counts_per_step
                let left = R::of(f64::from(self.counts_per_step * step)) - t.until_frame;
                let now = R::zero().le(left) & left.lt(counts);
                if R::any(now) {
                    let seen = t.x.look_back(&next, left * R::of(1.0 / f64::from(self.counts_per_step)), h_s);
                    at_frame = if R::any(captured) { at_frame.merge(now, &seen) } else { seen };
                    captured = captured | now;
                }
            }
            t.acc_mps2 = tabulate(
                #[inline(always)]
                |i| (next.vel_mps[i] - t.x.vel_mps[i]) * self.times.per_h,
            );
            specific_mps2 = heading.specific(&push, t.acc_mps2[2] + self.gravity_mps2);
            t.x = next;
            cx.first = false;
            cx.since_tick_s += h_s;
            cx.t_s += self.times.h_s;
        }
        t.ticks += R::of(1.0);
        cx.t_s = t.ticks * self.times.tick_s;
        if filming {
            if R::any(captured) {
                let mut frame = Frame::of(&at_frame, captured, began_s + t.until_frame * R::of(self.schedule.seconds(1)));
                cx.h_s = self.schedule.seconds(self.schedule.camera);
                for &i in &self.order.frame {
                    self.stages[i].frame(tile, &cx, &at_frame, &mut frame);
                }
                t.fix.deliver(frame.captured, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
            }
            let more = R::select(captured, R::of(f64::from(self.schedule.camera)), R::zero());
            t.until_frame = t.until_frame + more - R::of(f64::from(self.schedule.control));
        }
        let marker = if filming { t.fix } else { Fix::ideal(&t.x, cx.t_s) };
        let mut reading = Reading::of(&t.x, specific_mps2, marker);
        cx.h_s = tick_s;
        for &i in &self.order.sense {
            self.stages[i].sense(tile, &cx, &t.x, &u, &mut reading);
        }
        if filming {
            t.fix = reading.marker;
        }
        Tick { contact, reading }
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

/// As often as the neediest active effect asks, unless the user says otherwise; the linear model itself is exact at any rate.
fn counts_per_step(schedule: &Schedule, physics_hz: Option<u32>, needed_hz: u32) -> Result<u32> {
    let good = |counts: &u32| schedule.control.is_multiple_of(*counts);
    let Some(hz) = physics_hz else {
        let longest = (schedule.base_hz / needed_hz.max(1)).clamp(1, schedule.control);
        return Ok((1..=longest).rev().find(good).unwrap_or(1));
    };
    let counts = schedule.base_hz.checked_div(hz).unwrap_or(0);
    if counts == 0 || !schedule.base_hz.is_multiple_of(hz) || !good(&counts) {
        let rates: Vec<String> = (1..=schedule.control).filter(good).map(|c| (schedule.base_hz / c).to_string()).collect();
        return Err(Error::Range { name: "physics_hz".into(), value: f64::from(hz), want: format!("one of {}", rates.join(", ")) });
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
        per_battery_capacity_pc: R::of(1.0 / model.vehicle.battery_capacity.value),
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

#[inline(always)]
fn merge<R: Real, const N: usize>(mask: R::Mask, old: [R; N], new: [R; N]) -> [R; N] {
    tabulate(
        #[inline(always)]
        |i| R::select(mask, new[i], old[i]),
    )
}

#[inline(always)]
fn at_rest<R: Real>(mask: R::Mask, v: R) -> R {
    R::select(mask, R::zero(), v)
}

/// The floor carries: no sinking, and on its legs the vehicle neither slides nor tilts.
#[inline(always)]
fn land<R: Real>(x: &mut State<R>, from_m: R, contact: &mut Contact<R>) {
    let below = x.pos_m[2].lt(R::zero());
    contact.standing = below;
    if !R::any(below) {
        return;
    }
    // what stood on the floor before hits nothing, though a first-order form (5.4) gives a standing vehicle a sinking speed
    let fell = below & from_m.gt(R::zero());
    contact.impact_mps = contact.impact_mps.max(R::select(fell, -x.vel_mps[2], R::zero()));
    x.pos_m[2] = at_rest(below, x.pos_m[2]);
    x.vel_mps = each(
        x.vel_mps,
        #[inline(always)]
        |v| at_rest(below, v),
    );
    x.att_rad = [at_rest(below, x.att_rad[0]), at_rest(below, x.att_rad[1]), x.att_rad[2]];
    x.rate_radps = each(
        x.rate_radps,
        #[inline(always)]
        |v| at_rest(below, v),
    );
    x.aux = [R::select(below, x.aux[0].max(R::zero()), x.aux[0]), at_rest(below, x.aux[1])];
}

impl<R: Real> Contact<R> {
    #[inline(always)]
    fn none() -> Self {
        Contact { impact_mps: R::zero(), standing: R::nothing() }
    }
}

impl<R: Real> Reading<R> {
    /// What the sensors show of a state, before any effect.
    #[inline(always)]
    fn of(x: &State<R>, acc_mps2: [R; 3], marker: Fix<R>) -> Self {
        Reading { marker, att_rad: x.att_rad, gyro_radps: x.rate_radps, acc_mps2, vbat_v: R::of(NOMINAL_V) }
    }
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
        State {
            pos_m: merge(mask, self.pos_m, other.pos_m),
            vel_mps: merge(mask, self.vel_mps, other.vel_mps),
            att_rad: merge(mask, self.att_rad, other.att_rad),
            rate_radps: merge(mask, self.rate_radps, other.rate_radps),
            aux: merge(mask, self.aux, other.aux),
        }
    }

    /// Where things will be after so short a time, to second order in the position: what a push held over twice that time should see.
    #[inline(always)]
    fn ahead(&self, acc_mps2: &[R; 3], time_s: f64) -> Self {
        let t = R::of(time_s);
        let mut x = *self;
        for i in 0..3 {
            x.pos_m[i] += t * self.vel_mps[i];
            x.vel_mps[i] += t * acc_mps2[i];
            x.att_rad[i] += t * self.rate_radps[i];
        }
        x
    }

    /// Position and attitude `share` of a step of `h_s` before its end, on the parabola through both ends with the velocity of the end. (A
    /// first-order form's velocity jumps at the start of a step.) The third derivative makes an error of less than 3e-6 m at 50 Hz.
    #[inline(always)]
    fn look_back(&self, end: &Self, share: R, h_s: f64) -> Self {
        let (h, square) = (R::of(h_s), share * share);
        let mut x = *end;
        for i in 0..3 {
            let (dp, da) = (h * end.vel_mps[i], h * end.rate_radps[i]);
            x.pos_m[i] = end.pos_m[i] - share * dp + square * (self.pos_m[i] - end.pos_m[i] + dp);
            x.att_rad[i] = end.att_rad[i] - share * da + square * (self.att_rad[i] - end.att_rad[i] + da);
        }
        x
    }
}

impl<R: Real> Fix<R> {
    /// `other` in the lanes of `mask`.
    #[inline(always)]
    fn merge(&self, mask: R::Mask, other: &Self) -> Self {
        let [yaw_rad, t_s, valid] = merge(mask, [self.yaw_rad, self.t_s, self.valid], [other.yaw_rad, other.t_s, other.valid]);
        Fix { pos_m: merge(mask, self.pos_m, other.pos_m), yaw_rad, t_s, valid }
    }

    /// Ideal localisation: the true pose, now.
    #[inline(always)]
    fn ideal(x: &State<R>, now_s: R) -> Self {
        Fix { pos_m: x.pos_m, yaw_rad: x.att_rad[2], t_s: now_s, valid: R::of(1.0) }
    }
}

impl<R: Real> Heading<R> {
    /// The specific force along the body axes: what pushes sideways, and what carries.
    #[inline(always)]
    fn specific(&self, push: &Push<R>, up_mps2: R) -> [R; 3] {
        let [ax, ay, _] = push.acc_mps2;
        [self.cos * ax + self.sin * ay, self.cos * ay - self.sin * ax, up_mps2]
    }
}

impl<R: Real> Tile<R> {
    fn new() -> Self {
        let (zero, none) = (R::zero(), [R::zero(); 3]);
        let fix = Fix { pos_m: none, yaw_rad: zero, t_s: zero, valid: zero };
        Tile {
            x: State::rest(),
            tick: R::Word::of(0),
            ticks: zero,
            keys: Keys::new(),
            acc_mps2: none,
            until_frame: R::of(1e9),
            fix,
            clock: 0,
        }
    }
}
