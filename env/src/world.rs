//! The data path: command -> effects on it -> pushes -> exact step -> camera frame -> reading. Reads like one
//! drone; a tile is sixteen.

mod archive;
mod camera_clock;
mod fitting;
mod force;
mod group_step;
mod parts;
#[cfg(feature = "recording")]
mod recording;
mod setup;
mod wind;

#[cfg(feature = "recording")]
pub use recording::RecordedEffect;
pub(crate) use setup::check_scope;
pub use setup::has_battery;

use std::slice::{from_mut, from_ref};

use crate::effect_table::EffectTable;
use crate::effects::{self, BoundedNumber, Frame, HookContext, Neighbour, PoseFix, Reading, Stage, Tiles};
use crate::error::Result;
use crate::model::{Model, Schedule, VerticalInput};
use crate::motors::MotorVehicle;
use crate::noise::{EpisodeKeys, TickRng};
use crate::number::Number;
use crate::plant::{Accelerations, Command, Plant, State, VehicleConstants};
use crate::scalar::{Scalar, Word, merge};
use crate::sim_scalar::SimScalar;

use camera_clock::CameraClock;
use force::Outside;
use group_step::GroupStep;
use parts::land;
use setup::{Active, active, body, counts_per_step, needed_hz, with_ranges};
use wind::Wind;

/// Tiles that are stepped side by side: while one waits for a result, another computes.
pub const GROUP: usize = 2;

/// Progress of the episodes of a tile.
#[derive(Debug, Clone, Copy)]
struct Age<R: Scalar> {
    keys: EpisodeKeys<R>,
    /// Control ticks since the episode began, as a word for the noise and as a number for the time.
    tick: R::Word,
    ticks: R,
}

/// Data of the effects of a tile besides the state.
#[derive(Debug, Clone, Copy)]
struct Tile<R: Scalar> {
    /// Acceleration over the last physics step.
    acc_mps2: [R; 3],
    /// Base-clock counts until the next camera frame.
    until_frame: R,
    /// The last marker pose, where effects film it.
    fix: PoseFix<R>,
}

/// Data passed between the steps of a group of tiles; kept because filling it anew costs more than a step of it.
#[derive(Debug, Clone)]
struct Group<R: Scalar> {
    u: [Command<R>; GROUP],
    push: [Accelerations<R>; GROUP],
    /// The states expected at the middle of a step.
    middle: [State<R>; GROUP],
    /// The states at which a camera frame of this tick was taken, in the lanes in which one was.
    seen: [State<R>; GROUP],
    captured: [R::Mask; GROUP],
    frames: [Frame<R>; GROUP],
}

/// Speed at the impact on the floor, and whether the vehicle is on the floor.
#[derive(Debug, Clone, Copy)]
pub struct Contact<R: Scalar> {
    /// Greatest sinking speed at which the floor was hit during the tick; 0 where it was not.
    pub impact_mps: R,
    /// Lanes whose vehicle is on the floor at the end of the tick.
    pub standing: R::Mask,
}

/// Result of a tick: returned, not kept, because a large batch is limited by memory.
#[derive(Debug, Clone, Copy)]
pub struct Tick<R: Scalar> {
    /// Touch of the floor during the tick.
    pub contact: Contact<R>,
    /// Sensors at the end of the tick.
    pub reading: Reading<R>,
}

/// Surroundings of a drone among others: its neighbours, and the pull on it besides its effects.
#[derive(Debug, Clone, Copy)]
pub struct Around<'a, R> {
    /// See [`HookContext::neighbours`] and [`HookContext::own`].
    pub neighbours: &'a [Neighbour<R>],
    /// Index of the drone itself among `neighbours`.
    pub own: usize,
    /// Accelerations from outside, such as the pull of a rope.
    pub push: Accelerations<R>,
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
#[derive(Debug)]
struct Order {
    command: Vec<usize>,
    rates: Vec<usize>,
    push: Vec<usize>,
    frame: Vec<usize>,
    sense: Vec<usize>,
}

impl Order {
    /// The places of these effects under each hook that they have.
    fn new(entries: &[&effects::Entry]) -> Self {
        let places = |has: fn(&effects::Hooks) -> bool| {
            let with_it = entries.iter().enumerate().filter(|(_, entry)| has(&entry.hooks));
            with_it.map(|(place, _)| place).collect()
        };
        Order {
            command: places(|hooks| hooks.command),
            rates: places(|hooks| hooks.rates),
            push: places(|hooks| hooks.push),
            frame: places(|hooks| hooks.frame),
            sense: places(|hooks| hooks.sense),
        }
    }
}

/// Drones with their effects; each lane is a drone of its own that never feels its neighbours.
pub struct World<R: SimScalar> {
    schedule: Schedule,
    body: VehicleConstants<R>,
    /// Over one physics step.
    plant: Plant<R>,
    /// In place of the plant, where the motor-level form is commanded.
    motors: Option<MotorVehicle<R>>,
    steps_per_tick: u32,
    counts_per_step: u32,
    tick_s: f64,
    times: Times<R>,
    gravity_mps2: R,
    floor: bool,
    /// See [`HookContext::voltage_v`].
    voltage_v: Option<R>,
    /// Disturbance of a filter, besides the effects.
    disturbance: Option<Accelerations<R>>,
    /// Accelerations by external forces on each tile; empty if there are none.
    forced_mps2: Vec<[R; 3]>,
    mass_kg: f64,
    /// Wind from place to place, the drag of the model itself by axis, and which stages see velocities in the air.
    wind: Option<Wind<R>>,
    drag_ps: [f64; 3],
    feels_air: Vec<bool>,
    /// Active effects, in registry order, with what their parameters are drawn from.
    stages: Vec<Box<dyn Stage<R>>>,
    /// Their names.
    names: Vec<&'static str>,
    order: Order,
    drawn: Vec<(usize, Vec<BoundedNumber>)>,
    /// Room for the numbers of the effect that draws most.
    drawn_now: Vec<f64>,
    /// States of each tile: separate, because a step without effects needs no more than the first two.
    states: Vec<State<R>>,
    ages: Vec<Age<R>>,
    tiles: Vec<Tile<R>>,
    /// Control ticks of each tile since the world was made.
    clocks: Vec<usize>,
    group: Group<R>,
}

/// Physics settings of a world.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Height input of the model that commands drive.
    pub input: VerticalInput,
    /// See [`crate::config::Options::physics_hz`].
    pub physics_hz: Option<u32>,
}

impl<R: SimScalar> World<R> {
    /// A world of `tiles` tiles at rest on the floor.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] or [`crate::Error::Range`] for effects; [`crate::Error::Range`] if
    /// `physics_hz` does not divide the tick into whole base counts.
    pub fn new(model: &Model, effects: &EffectTable, settings: Settings, tiles: usize) -> Result<Self> {
        crate::effects::check_effects(effects)?;
        Self::assemble(model, active(model, effects, settings.input)?, settings, tiles)
    }

    fn assemble(model: &Model, active: Vec<Active>, settings: Settings, tiles: usize) -> Result<Self> {
        let schedule = Schedule::from_model(model)?;
        let counts_per_step =
            counts_per_step(&schedule, settings.physics_hz, needed_hz(&active, settings.input))?;
        let tick_s = schedule.seconds(schedule.control);
        let (mut entries, mut stages, mut drawn) = (Vec::new(), Vec::new(), Vec::new());
        for (i, (_, entry, values)) in active.into_iter().enumerate() {
            let per_drone = values.iter().any(|v| v.fixed().is_none());
            let mut stage = R::stage(entry, effects::Build { tiles, per_drone, tick_s });
            if per_drone {
                drawn.push((i, with_ranges(entry, values)));
            } else {
                let fixed: Vec<f64> = values.iter().filter_map(Number::fixed).collect();
                stage.numbers().set(0, 0, &fixed);
            }
            entries.push(entry);
            stages.push(stage);
        }
        let steps_per_tick = schedule.control / counts_per_step;
        let h_s = tick_s / f64::from(steps_per_tick);
        let times = Times {
            tick_s: R::from_f64(tick_s),
            per_tick: R::from_f64(1.0 / tick_s),
            h_s: R::from_f64(h_s),
            per_h: R::from_f64(1.0 / h_s),
        };
        let body = body::<R>(model, settings.input)?;
        let drag_ps = model.lateral.drag.value;
        Ok(World {
            schedule,
            wind: None,
            drag_ps: [drag_ps, drag_ps, body.heave_ps.lane(0)],
            feels_air: entries.iter().map(|entry| entry.feels_air).collect(),
            body,
            plant: Plant::new(model, settings.input, schedule.seconds(counts_per_step))?,
            motors: MotorVehicle::new(model, settings.input, h_s, tiles),
            steps_per_tick,
            counts_per_step,
            tick_s,
            times,
            gravity_mps2: R::from_f64(model.lateral.gravity.value),
            floor: true,
            voltage_v: None,
            disturbance: None,
            forced_mps2: Vec::new(),
            mass_kg: model.vehicle.mass.value,
            drawn_now: vec![0.0; drawn.iter().map(|(_, values)| values.len()).max().unwrap_or(0)],
            drawn,
            names: entries.iter().map(|entry| entry.name).collect(),
            stages,
            order: Order::new(&entries),
            states: vec![State::rest(); tiles],
            ages: vec![Age { keys: EpisodeKeys::new(), tick: R::Word::from_u32(0), ticks: R::zero() }; tiles],
            tiles: vec![Tile::new(); tiles],
            clocks: vec![0; tiles],
            group: Group::new(),
        })
    }

    /// Returns the same world without a floor, for a recorded flight's commands: if they would sink the model, the
    /// linear model determines how far.
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
        &self.states[tile]
    }

    /// Acceleration of a tile over the last physics step.
    #[inline(always)]
    pub fn acc_mps2(&self, tile: usize) -> &[R; 3] {
        &self.tiles[tile].acc_mps2
    }

    /// Put the lanes of `mask` at rest where they were in `x`: what is broken stays where it broke.
    #[inline(always)]
    pub fn halt(&mut self, tile: usize, mask: R::Mask, x: &State<R>) {
        let none = [R::zero(); 3];
        let still = State { vel_mps: none, rate_radps: none, aux: [x.aux[0], R::zero()], ..*x };
        self.states[tile] = self.states[tile].merge(mask, &still);
        self.tiles[tile].acc_mps2 = merge(mask, self.tiles[tile].acc_mps2, none);
    }

    /// Time since each lane's episode began.
    #[inline(always)]
    pub fn time_s(&self, tile: usize) -> R {
        self.ages[tile].ticks * self.times.tick_s
    }

    /// The noise of the current tick.
    #[inline(always)]
    pub fn draw(&self, tile: usize) -> TickRng<'_, R> {
        self.ages[tile].draw()
    }

    /// Prepare one lane for a new episode: its noise key and its drawn parameters. Call [`World::start`] for
    /// all such lanes after.
    pub fn draw_lane(&mut self, tile: usize, lane: usize, key: u64, rng: &mut rand_pcg::Pcg64Mcg) {
        self.ages[tile].keys.set_lane(lane, key);
        self.ages[tile].tick.set_lane(lane, 0);
        for (stage, numbers) in &self.drawn {
            let drawn = &mut self.drawn_now[..numbers.len()];
            for (slot, number) in drawn.iter_mut().zip(numbers) {
                *slot = number.draw(rng);
            }
            self.stages[*stage].numbers().set(tile, lane, drawn);
        }
    }

    /// Begin episodes in the lanes of `mask` from the state `x`, with the command `u` in force until now. The reading
    /// is valid for those lanes only.
    #[inline(never)]
    pub fn start(&mut self, tile: usize, mask: R::Mask, x: &State<R>, u: &Command<R>) -> Reading<R> {
        R::run(
            #[inline(always)]
            || self.start_now(tile, mask, x, u),
        )
    }

    #[inline(always)]
    fn start_now(&mut self, tile: usize, mask: R::Mask, x: &State<R>, u: &Command<R>) -> Reading<R> {
        let (t, age) = (&mut self.tiles[tile], &mut self.ages[tile]);
        let x = self.states[tile].merge(mask, x);
        self.states[tile] = x;
        age.ticks = R::select(mask, R::zero(), age.ticks);
        // one frame is taken as the episode begins
        t.until_frame = R::select(mask, R::from_f64(f64::from(self.schedule.camera)), t.until_frame);
        let draw = age.draw();
        let cx = HookContext {
            t_s: age.ticks * self.times.tick_s,
            clock: self.clocks[tile],
            ..HookContext::new(&self.body, self.tick_s, &draw, self.voltage_v.as_ref())
        };
        let u = &self.motors.as_mut().map_or(*u, |motors| motors.start(tile, mask, &x, u));
        for stage in &mut self.stages {
            stage.start(tile, mask, &cx, &x, u);
        }
        let mut frame = Frame::from_state(&x, mask, cx.t_s);
        for &i in &self.order.frame {
            self.stages[i].frame(
                &Tiles { first: tile, cx: from_ref(&cx), x: from_ref(&x), u: &[] },
                from_mut(&mut frame),
            );
        }
        // the pose from before the episode is known at its start, for every latency
        let none = [R::zero(); 3];
        let mut marker = PoseFix { pos_m: none, yaw_rad: R::zero(), t_s: cx.t_s, valid: R::zero() };
        marker.deliver(mask, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
        t.acc_mps2 = merge(mask, t.acc_mps2, none);
        let mut y = Reading::from_state(&x, [R::zero(), R::zero(), self.gravity_mps2], marker);
        for &i in &self.order.sense {
            self.stages[i].peek(tile, &cx, &x, &mut y);
        }
        t.fix = t.fix.merge(mask, &y.marker);
        y
    }

    /// One control tick of one tile; the state is in [`World::state`].
    #[inline(always)]
    pub fn step(&mut self, tile: usize, command: &Command<R>) -> Tick<R> {
        if self.is_plain() {
            return self.step_plain(tile, command);
        }
        let mut tick = Tick::none();
        self.step_group(tile, from_ref(command), None, from_mut(&mut tick));
        tick
    }

    /// Nothing is called in a step, and a tick is one step: [`World::step_plain`] will do.
    #[inline(always)]
    pub fn is_plain(&self) -> bool {
        self.stages.is_empty()
            && self.steps_per_tick == 1
            && self.disturbance.is_none()
            && self.forced_mps2.is_empty()
            && self.wind.is_none()
            && self.motors.is_none()
    }

    /// A step of a plain world: everything stays in registers.
    #[inline(always)]
    pub fn step_plain(&mut self, tile: usize, command: &Command<R>) -> Tick<R> {
        let (x, age) = (&mut self.states[tile], &mut self.ages[tile]);
        age.count();
        let mut contact = Contact::none();
        let (mut next, _) = self.plant.advance(x, command, &Accelerations::none());
        if self.floor {
            land(&mut next, x.pos_m[2], &mut contact);
        }
        let climb_mps2 = (next.vel_mps[2] - x.vel_mps[2]) * self.times.per_tick;
        let specific_mps2 = [R::zero(), R::zero(), climb_mps2 + self.gravity_mps2];
        *x = next;
        Tick {
            contact,
            reading: Reading::from_state(
                &next,
                specific_mps2,
                PoseFix::ideal(&next, age.ticks * self.times.tick_s),
            ),
        }
    }

    /// Steps one control tick of the tiles from `first` on, as many as there are commands, at most [`GROUP`];
    /// `around` has the neighbours.
    ///
    /// # Panics
    /// Unless there are as many `ticks` as commands.
    // one copy for all tasks: a call is nothing beside what it does
    #[inline(never)]
    pub fn step_group(
        &mut self,
        first: usize,
        commands: &[Command<R>],
        around: Option<&[Around<'_, R>; GROUP]>,
        ticks: &mut [Tick<R>],
    ) {
        R::run(
            #[inline(always)]
            || self.step_group_now(first, commands, around, ticks),
        );
    }

    #[inline(always)]
    fn step_group_now(
        &mut self,
        first: usize,
        commands: &[Command<R>],
        around: Option<&[Around<'_, R>; GROUP]>,
        ticks: &mut [Tick<R>],
    ) {
        let n = commands.len().min(GROUP);
        assert!(n > 0 && ticks.len() == n);
        self.open(first, n, ticks);
        let h_s = self.tick_s / f64::from(self.steps_per_tick);
        let ages = &self.ages[first..first + n];
        // with one tile, both are the same
        let b = n - 1;
        let draws = [ages[0].draw(), ages[b].draw()];
        let mut cx = [0, b].map(
            #[inline(always)]
            |i| HookContext {
                h_s,
                t_s: ages[i].began_s(&self.times),
                clock: self.clocks[first + i],
                ..HookContext::new(&self.body, self.tick_s, &draws[i], self.voltage_v.as_ref())
            },
        );
        if let Some(around) = around {
            for (cx, around) in cx.iter_mut().zip(around) {
                (cx.neighbours, cx.own) = (around.neighbours, around.own);
            }
        }
        let mut step = GroupStep {
            first,
            n,
            h_s,
            tick_s: self.tick_s,
            times: &self.times,
            gravity_mps2: self.gravity_mps2,
            floor: self.floor,
            plant: &self.plant,
            motors: &mut self.motors,
            states: &mut self.states[first..first + n],
            tiles: &mut self.tiles[first..first + n],
            ages,
            stages: &mut self.stages,
            order: &self.order,
            group: &mut self.group,
            wind: &mut self.wind,
            feels_air: &self.feels_air,
            filming: CameraClock { counts_per_step: self.counts_per_step, schedule: self.schedule, h_s },
            outside: Outside { around, disturbance: self.disturbance, forced_mps2: &self.forced_mps2, first },
        };
        step.begin(commands);
        for count in 1..=self.steps_per_tick {
            step.command(&cx, commands);
            step.push(&cx);
            step.advance(&mut cx, count, ticks);
        }
        step.film(&mut cx);
        step.read(&mut cx, ticks);
        step.sense(&cx, ticks);
    }

    /// Counts the tick of a group of tiles, and forgets the touch of the floor.
    #[inline(always)]
    fn open(&mut self, first: usize, n: usize, ticks: &mut [Tick<R>]) {
        for i in 0..n {
            self.ages[first + i].count();
            self.clocks[first + i] += 1;
            ticks[i].contact = Contact::none();
        }
    }
}
