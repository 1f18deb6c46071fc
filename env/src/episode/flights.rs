//! The motion of drones in some tiles, and the end of their ticks, whatever the task: compiled once for all tasks.

use super::{
    AirSettings, At, Commander, Coupling, DroneResult, FlightPlan, Inbox, MakeWorld, Sight, Sink, Starts,
};
use crate::action::{ACTION, ActionScale, Interface, Onboard};
use crate::archive::Archive;
use crate::config::Options;
use crate::coupling::load::Load;
use crate::effects::Neighbour;
use crate::error::Result;
use crate::expression::{Moment, Program, holds, parse_reward, parse_termination};
use crate::model::Model;
use crate::observation::{Setpoint, Surroundings, observe};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, merge};
use crate::sim_scalar::{BatchScalar, SimScalar};
use crate::task::{GOAL, Outcome, Scene, Task, crashed, outside};
use crate::world::{GROUP, Settings, Tick, World};

/// A drone in all tiles.
pub(crate) struct Drone<R: SimScalar> {
    pub(crate) world: World<R>,
    /// Turns actions that are no attitudes into commands.
    pub(crate) onboard: Option<Onboard<R>>,
    pub(crate) interface: Interface,
    pub(super) action_scale: ActionScale<R>,
}

/// A drone's memory of its episode, besides its world.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Slot<R> {
    pub(crate) last_action: [R; ACTION],
    pub(crate) goal: [R; GOAL],
}

/// Ends and rewards that are not the task's own.
pub(crate) struct Rules<R> {
    /// Past this an episode is over: half a step of margin, because the clock is in `f32`.
    last_s: R,
    reward: Option<Program>,
    termination: Option<Program>,
}

/// The drones of some tiles, with their memory and the rules that end their flights.
pub(crate) struct Flights<R: SimScalar, C: Coupling<R>> {
    pub(crate) drones: C::Each<Drone<R>>,
    pub(crate) coupling: C,
    /// By tile, then by drone.
    slots: Vec<Slot<R>>,
    /// Numbers of a tile's board, and those of all tiles.
    pub(super) board_size: usize,
    boards: Vec<R>,
    /// A board that moves on.
    pub(super) turned: Vec<R>,
    rules: Rules<R>,
    reads_pairs: bool,
}

/// The board of a tile. It never panics, so that a task without a board pays nothing for it.
#[inline(always)]
fn board<R>(boards: &[R], tile: usize, size: usize) -> &[R] {
    boards.get(tile * size..(tile + 1) * size).unwrap_or_default()
}

/// All that a task sees of a tile, whose first drone's world has the clock.
#[inline(always)]
fn scene<'a, R: SimScalar, C: Coupling<R>>(
    clock: &'a World<R>,
    coupling: &'a C,
    board: &'a [R],
    tile: usize,
    drones: &'a [Neighbour<R>],
) -> Scene<'a, R> {
    Scene { drones, load: coupling.load(tile), board, t_s: clock.time_s(tile), draw: clock.draw(tile) }
}

/// Masks of the drones that `flew`: part done, flight terminated, flight truncated.
#[inline(always)]
fn ends_of<R: Scalar>(flew: R::Mask, broken: R::Mask, ends: R::Mask, over: R::Mask) -> [R::Mask; 3] {
    let done = flew & ends & !broken;
    let terminated = broken | done;
    [done, terminated, flew & !terminated & over]
}

/// The reward of a task for drones that `flew`, or all, less the cost of being broken.
#[inline(always)]
fn reward_after<R: Scalar>(reward: R, flew: Option<R::Mask>, broken: R::Mask, crash_cost: f64) -> R {
    let reward = flew.map_or(reward, |flew| R::select(flew, reward, R::zero()));
    if crash_cost == 0.0 { reward } else { reward - R::select(broken, R::from_f64(crash_cost), R::zero()) }
}

/// The task's opinion on a drone's tick.
#[derive(Clone, Copy)]
pub(super) struct Verdict<'a, R: Scalar> {
    pub(super) setpoint: Setpoint<R>,
    pub(super) outcome: Outcome<R>,
    pub(super) surroundings: Option<&'a Surroundings<R>>,
    pub(super) crash_cost: f64,
    pub(super) ends_flights: bool,
}

impl<R: SimScalar> Drone<R> {
    /// A drone of a model, whose world is at the level of its actions.
    ///
    /// # Errors
    /// Those of [`Onboard::new`].
    pub(crate) fn new(world: World<R>, model: &Model, interface: &Interface, tiles: usize) -> Result<Self> {
        let onboard = Onboard::new(model, interface, world.tick_s(), tiles)?;
        Ok(Drone { world, onboard, interface: *interface, action_scale: interface.action_scale() })
    }

    /// Turns an action into a command.
    #[inline(always)]
    pub(crate) fn obey(&mut self, tile: usize, action: &[R; ACTION]) -> Command<R> {
        R::enter("command");
        match &mut self.onboard {
            None => self.action_scale.command(action),
            Some(onboard) => onboard.command(tile, action, self.world.state(tile)),
        }
    }
}

impl<R: SimScalar> Rules<R> {
    /// Creates the flights of `options`, for ticks of `tick_s`.
    ///
    /// # Errors
    /// [`crate::Error::Expression`] for a text that is none.
    fn new(options: &Options, tick_s: f64) -> Result<Self> {
        let last_s = match options.max_episode_steps {
            0 => f64::INFINITY,
            steps => (f64::from(steps) - 0.5) * tick_s,
        };
        Ok(Rules {
            last_s: R::from_f64(last_s),
            reward: options.reward.as_deref().map(parse_reward).transpose()?,
            termination: options.termination.as_deref().map(parse_termination).transpose()?,
        })
    }

    /// Reward and end of a tick, by the user's own expressions where there are some, with the value of the
    /// termination.
    #[inline(always)]
    fn decide(&self, moment: &Moment<'_, R>, ends: R::Mask) -> (R, R::Mask, Option<R>) {
        if self.reward.is_none() && self.termination.is_none() {
            return (moment.task_reward, ends, None);
        }
        // a moment of its own, so that the other one stays in registers
        let [reward, condition] = self.evaluate(&Moment { ..*moment });
        (reward.unwrap_or(moment.task_reward), condition.map_or(ends, holds), condition)
    }

    /// The user's own reward, and the value of the user's own termination.
    // a function of its own, so that it does not weigh on steps without it
    #[inline(never)]
    fn evaluate(&self, moment: &Moment<'_, R>) -> [Option<R>; 2] {
        R::run(
            #[inline(always)]
            || {
                let mut values = [None; 2];
                for (value, program) in values.iter_mut().zip([&self.reward, &self.termination]) {
                    if let Some(program) = program {
                        *value = Some(program.evaluate(moment));
                    }
                }
                values
            },
        )
    }
}

impl<R: SimScalar, C: Coupling<R>> Flights<R, C> {
    /// Drones of a plan, with a board of `board_size` numbers in each tile, and what they are sent.
    ///
    /// # Errors
    /// Those of `world`, of the onboard cascade, and of a user's own expressions.
    pub(super) fn new(
        plan: FlightPlan<'_>,
        load: Option<Load>,
        board_size: usize,
        world: &mut MakeWorld<'_, R>,
    ) -> Result<(Self, Inbox<R, C>)> {
        let FlightPlan { models, interfaces, options, tick_s, tiles } = plan;
        let (drones, zero) = (models.len(), R::zero());
        let flown = C::each(drones, |own| {
            let settings = Settings { input: interfaces[own].input, physics_hz: options.physics_hz };
            let world = world(own, settings)?.at_level(options.action);
            Drone::new(world, models[own], &interfaces[own], tiles)
        })?;
        let inbox = Inbox {
            actions: C::each(drones, |_| Ok([[zero; ACTION]; GROUP]))?,
            ticks: C::each(drones, |_| Ok([Tick::none(); GROUP]))?,
        };
        let slot = Slot { last_action: [zero; ACTION], goal: [zero; GOAL] };
        let flights = Flights {
            drones: flown,
            coupling: C::new(tiles, AirSettings::new(models, options, load, tick_s)),
            slots: vec![slot; tiles * drones],
            board_size,
            boards: vec![zero; tiles * board_size],
            turned: vec![zero; board_size],
            rules: Rules::new(options, tick_s)?,
            reads_pairs: options.reads_pairs(drones, load.is_some())?,
        };
        Ok((flights, inbox))
    }

    /// Nothing is called in a tick: a drone that is alone may stay in registers.
    pub(super) fn is_plain(&self) -> bool {
        self.drones.as_ref().iter().all(|drone| drone.onboard.is_none() && drone.world.is_plain())
    }

    #[inline(always)]
    pub(crate) fn state(&self, tile: usize, own: usize) -> &State<R> {
        self.drones.as_ref()[own].world.state(tile)
    }
    #[inline(always)]
    pub(crate) fn slot(&self, tile: usize, own: usize) -> &Slot<R> {
        &self.slots[tile * self.drones.as_ref().len() + own]
    }
    #[inline(always)]
    pub(crate) fn slot_mut(&mut self, tile: usize, own: usize) -> &mut Slot<R> {
        &mut self.slots[tile * self.drones.as_ref().len() + own]
    }
    #[inline(always)]
    pub(crate) fn board(&self, tile: usize) -> &[R] {
        board(&self.boards, tile, self.board_size)
    }
    #[inline(always)]
    pub(crate) fn board_mut(&mut self, tile: usize) -> &mut [R] {
        &mut self.boards[tile * self.board_size..][..self.board_size]
    }

    /// The drones of a tile as a task sees them.
    #[inline(always)]
    pub(super) fn seen(&self, at: At) -> C::Seen<'_> {
        self.coupling.seen(at.place, self.state(at.tile, 0))
    }

    /// Set-point of a drone now; may move its goal on.
    #[inline(always)]
    pub(super) fn find_setpoint<T: Task>(&mut self, task: &T, at: At) -> Setpoint<R> {
        let At { tile, place, own } = at;
        let Flights { drones, coupling, slots, board_size, boards, .. } = self;
        let (n, clock) = (drones.as_ref().len(), &drones.as_ref()[0].world);
        let seen = coupling.seen(place, clock.state(tile));
        let scene = scene(clock, coupling, board(boards, tile, *board_size), tile, seen.as_ref());
        task.setpoint(own, &mut slots[tile * n + own].goal, &scene)
    }

    /// All that a task sees of a tile.
    #[inline(always)]
    pub(super) fn scene<'a>(&'a self, tile: usize, drones: &'a [Neighbour<R>]) -> Scene<'a, R> {
        scene(&self.drones.as_ref()[0].world, &self.coupling, self.board(tile), tile, drones)
    }

    /// Begins episodes of a tile in the lanes of `mask`; the readings are in the inbox.
    #[inline(never)]
    pub(super) fn begin(&mut self, tile: usize, mask: R::Mask, starts: &Starts<R>, inbox: &mut Inbox<R, C>) {
        R::run(
            #[inline(always)]
            || self.begin_now(tile, mask, starts, inbox),
        );
    }

    #[inline(always)]
    fn begin_now(&mut self, tile: usize, mask: R::Mask, starts: &Starts<R>, inbox: &mut Inbox<R, C>) {
        for (number, start) in self.board_mut(tile).iter_mut().zip(&starts.board) {
            *number = R::select(mask, *start, *number);
        }
        self.coupling.begin(tile, mask, &starts.load_pos_m);
        for own in 0..self.drones.as_ref().len() {
            let Flights { drones, coupling, slots, .. } = self;
            let n = drones.as_ref().len();
            let (drone, slot) = (&mut drones.as_mut()[own], &mut slots[tile * n + own]);
            let start = &starts.drones[own];
            let mut x = State::rest();
            x.pos_m = start.pos_m;
            x.vel_mps[..2].copy_from_slice(&start.vel_mps);
            x.att_rad[..2].copy_from_slice(&start.tilt_rad);
            x.att_rad[2] = start.yaw_rad;
            let command = Command::level(drone.lift_before(x.pos_m[2]));
            let action = drone.interface.action_before(&x, &command);
            slot.last_action = merge(mask, slot.last_action, action);
            slot.goal = merge(mask, slot.goal, start.goal);
            if let Some(onboard) = &mut drone.onboard {
                onboard.start(tile, mask);
            }
            let reading = drone.world.start(tile, mask, &x, &command);
            inbox.ticks.as_mut()[own][0] = Tick { reading, ..Tick::none() };
            coupling.start(At { tile, place: 0, own }, mask, &reading, drone.world.state(tile));
        }
    }

    /// All drones of `n` tiles from `first` on obey for a tick.
    #[inline(never)]
    pub(super) fn fly<A: Commander<R> + ?Sized>(
        &mut self,
        first: usize,
        n: usize,
        inbox: &mut Inbox<R, C>,
        commander: &A,
    ) {
        R::run(
            #[inline(always)]
            || self.fly_now(first, n, inbox, commander),
        );
    }

    #[inline(always)]
    fn fly_now<A: Commander<R> + ?Sized>(
        &mut self,
        first: usize,
        n: usize,
        inbox: &mut Inbox<R, C>,
        commander: &A,
    ) {
        let Flights { drones, coupling, .. } = self;
        for place in 0..n {
            coupling.before(first + place, place, drones.as_ref());
        }
        for (own, drone) in drones.as_mut().iter_mut().enumerate() {
            let held = coupling.held(own, first, n, &drone.world);
            let mut commands = [Command::level(R::zero()); GROUP];
            let (actions, ticks) = (&mut inbox.actions.as_mut()[own], &mut inbox.ticks.as_mut()[own]);
            for i in 0..n {
                actions[i] = commander.action(first + i, own, drone);
                commands[i] = commander.command(At { tile: first + i, place: i, own }, drone, &actions[i]);
            }
            R::enter("model");
            if drone.world.is_plain() && !coupling.pulls() {
                for i in 0..n {
                    ticks[i] = drone.world.step_plain(first + i, &commands[i]);
                }
            } else {
                let around = coupling.around(own, n);
                drone.world.step_group(first, &commands[..n], around.as_ref(), &mut ticks[..n]);
            }
            if let Some(held) = &held {
                for i in 0..n {
                    drone.world.halt(first + i, !coupling.flies(first + i, own), &held[i]);
                }
            }
        }
    }

    /// Judges a drone's tick: harm, reward, ends; and hands the result to the sink.
    #[inline(always)]
    pub(super) fn conclude<S: Sink<R, C>>(
        &mut self,
        at: At,
        action: &[R; ACTION],
        tick: &Tick<R>,
        verdict: Verdict<'_, R>,
        sink: &mut S,
    ) {
        if C::ALONE && R::INLINED {
            self.conclude_now(at, action, tick, verdict, sink);
        } else {
            self.conclude_apart(at, action, tick, &verdict, sink);
        }
    }

    // one copy for all tasks: a call is nothing beside what effects and drones that meet do
    #[inline(never)]
    fn conclude_apart<S: Sink<R, C>>(
        &mut self,
        at: At,
        action: &[R; ACTION],
        tick: &Tick<R>,
        verdict: &Verdict<'_, R>,
        sink: &mut S,
    ) {
        R::run(
            #[inline(always)]
            || self.conclude_now(at, action, tick, *verdict, sink),
        );
    }

    #[inline(always)]
    fn conclude_now<S: Sink<R, C>>(
        &mut self,
        at: At,
        action: &[R; ACTION],
        tick: &Tick<R>,
        verdict: Verdict<'_, R>,
        sink: &mut S,
    ) {
        let Verdict { setpoint, outcome, surroundings, crash_cost, ends_flights } = verdict;
        let world = &self.drones.as_ref()[at.own].world;
        let (x, now_s) = (world.state(at.tile), world.time_s(at.tile));
        let (flew, hit) = (self.coupling.flies(at.tile, at.own), self.coupling.hit(at.own));
        let mut crash = outside(x) | crashed(&tick.contact);
        if !C::ALONE {
            crash = flew & crash & !hit;
        }
        let broken = if C::ALONE { crash } else { hit | crash };
        let task_reward = reward_after(outcome.reward, (!C::ALONE).then_some(flew), broken, crash_cost);
        let row = observe(&tick.reading, now_s, &setpoint, action);
        let pairs = if !C::ALONE && self.reads_pairs { Some(self.coupling.pairs(at)) } else { None };
        let moment = Moment {
            own: &row,
            x,
            setpoint: &setpoint,
            last_action: &self.slots[at.tile * self.drones.as_ref().len() + at.own].last_action,
            impact_mps: tick.contact.impact_mps,
            now_s,
            broken,
            arrived: outcome.arrived,
            task_reward,
            pairs: pairs.as_ref(),
        };
        let (mut reward, ends, condition) = self.rules.decide(&moment, outcome.ends);
        let over = now_s.gt(self.rules.last_s);
        let [done, terminated, truncated] =
            if C::ALONE { [ends, ends | broken, over] } else { ends_of::<R>(flew, broken, ends, over) };
        if !C::ALONE {
            reward = R::select(flew, reward, R::zero());
        }
        let result = DroneResult {
            contact: tick.contact,
            moment,
            reward,
            condition,
            error_m: outcome.error_m,
            flew,
            hit,
            crash,
            done,
            terminated,
            truncated,
        };
        sink.tick(at, self, &Sight { reading: &tick.reading, row: &row, surroundings }, &result);
        self.slot_mut(at.tile, at.own).last_action = *action;
        if ends_flights {
            self.coupling.set_flies(at.tile, at.own, flew & !(terminated | over));
        }
    }

    /// Shows every number that a drone goes on from, besides the words of the noise.
    #[cfg(feature = "recording")]
    pub(crate) fn show_numbers(
        &mut self,
        tile: usize,
        own: usize,
        ledger: &mut dyn crate::archive::Ledger<R>,
    ) {
        let drone = &mut self.drones.as_mut()[own];
        drone.world.show_numbers(tile, ledger);
        if let Some(onboard) = &mut drone.onboard {
            onboard.show_numbers(tile, ledger);
        }
    }
}

impl<R: SimScalar> Drone<R> {
    /// Lift in force before an episode: in the air that of hovering, on the floor none.
    #[inline(always)]
    fn lift_before(&self, height_m: R) -> R {
        if self.interface.input.is_pwm() {
            R::select(height_m.gt(R::zero()), R::from_f64(self.interface.hover_lift), R::zero())
        } else {
            height_m
        }
    }
}

impl<R: BatchScalar, C: Coupling<R>> Flights<R, C> {
    /// Everything that a tile's flights go on from; `key` is that of a lane's episode.
    pub(crate) fn archive(&mut self, tile: usize, key: impl Fn(usize) -> u64, archive: &mut Archive<'_>) {
        archive.numbers(self.board_mut(tile));
        for own in 0..self.drones.as_ref().len() {
            let slot = self.slot_mut(tile, own);
            archive.numbers(&mut slot.last_action);
            archive.numbers(&mut slot.goal);
            let drone = &mut self.drones.as_mut()[own];
            drone.world.archive(tile, |lane| C::drone_key(key(lane), own), archive);
            if let Some(onboard) = &mut drone.onboard {
                onboard.show_numbers(tile, archive);
            }
        }
    }
}
