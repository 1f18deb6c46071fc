//! The only place where an episode begins, ticks and is judged: for lanes in a batch, for symbols in a recording,
//! and for `f64` where drones are flown one tick at a time. A rule of flight is changed here, or in the coupling.

mod alone;
mod flights;
mod shared_air;
mod start;

use std::ops::Range;

pub(crate) use alone::Alone;
pub(crate) use flights::{Drone, Flights};
use shared_air::AirSettings;
pub(crate) use shared_air::SharedAir;
pub(crate) use start::Starts;

use crate::action::{ACTION, Interface};
use crate::archive::Archive;
use crate::config::Options;
use crate::coupling::{NEIGHBOUR, load};
use crate::effects::{Neighbour, Reading};
use crate::error::Result;
use crate::expression::{Moment, Pairs};
use crate::model::Model;
use crate::observation::{OBSERVATION, Surroundings, observe};
use crate::plant::{Command, State};
use crate::scalar::Scalar;
use crate::sim_scalar::{BatchScalar, SimScalar};
use crate::task::{Situation, Start, Task};
pub(crate) use crate::world::Around;
use crate::world::{Contact, GROUP, Settings, Tick, World};

/// Episodes of some tiles: `R` the number type, `T` the task, `C` how the drones of an environment meet.
pub(crate) struct Episode<R: SimScalar, T, C: Coupling<R>> {
    pub(crate) task: T,
    pub(crate) flights: Flights<R, C>,
    inbox: Inbox<R, C>,
    /// The numbers of the start that was drawn last.
    drawn: Vec<Start>,
    board: Vec<f64>,
}

/// The drones of an environment, one model and interface each, and the options that they fly with.
#[derive(Clone, Copy)]
pub(crate) struct FlightPlan<'a> {
    pub(crate) models: &'a [&'a Model],
    pub(crate) interfaces: &'a [Interface],
    pub(crate) options: &'a Options,
    pub(crate) tick_s: f64,
    pub(crate) tiles: usize,
}

/// Makes the world of a drone.
pub(crate) type MakeWorld<'a, R> = dyn FnMut(usize, Settings) -> Result<World<R>> + 'a;

/// Actions and readings of a group of tiles, drone by drone; kept because filling it anew costs more than a tick.
pub(crate) struct Inbox<R: SimScalar, C: Coupling<R>> {
    actions: C::Each<[[R; ACTION]; GROUP]>,
    ticks: C::Each<[Tick<R>; GROUP]>,
}

/// A drone of a tile, and the tile's place in its group.
#[derive(Clone, Copy)]
pub(crate) struct At {
    pub(crate) tile: usize,
    pub(crate) place: usize,
    pub(crate) own: usize,
}

/// Encounters of the drones of an environment; without functions of its own those of a drone that meets nobody.
/// [`Alone`] is zero-sized, so that such a drone stays in registers; [`SharedAir`] has the scene, ropes, radio and
/// collisions.
pub(crate) trait Coupling<R: SimScalar>: Sized + Send {
    /// Nobody else is there, whatever happens.
    const ALONE: bool;
    /// One value for each drone.
    type Each<X: Send>: AsRef<[X]> + AsMut<[X]> + Send;
    /// The drones of a tile as tasks see them.
    type Seen<'a>: AsRef<[Neighbour<R>]>
    where
        Self: 'a;

    /// The coupling of drones in `tiles` tiles.
    fn new(tiles: usize, settings: AirSettings) -> Self;
    /// Makes one value for each of `drones`.
    ///
    /// # Errors
    /// The first of `make`.
    fn each<X: Send>(drones: usize, make: impl FnMut(usize) -> Result<X>) -> Result<Self::Each<X>>;
    /// Derives the noise key of a drone from that of its episode.
    fn drone_key(episode_key: u64, drone: usize) -> u64;
    /// Begins episodes of a tile in the lanes of `mask`; called before any of its drones starts.
    #[inline(always)]
    fn begin(&mut self, _tile: usize, _mask: R::Mask, _load_pos_m: &[R; 3]) {}
    /// A drone has started in the lanes of `mask`.
    #[inline(always)]
    fn start(&mut self, _at: At, _mask: R::Mask, _reading: &Reading<R>, _x: &State<R>) {}
    /// Before a tick: where everybody will be in its middle, and how the ropes will pull. Called per tile.
    #[inline(always)]
    fn before(&mut self, _tile: usize, _place: usize, _drones: &[Drone<R>]) {}
    /// Surroundings of a drone in a group of `n` tiles, or none where the air is still and nothing pulls.
    #[inline(always)]
    fn around(&self, _own: usize, _n: usize) -> Option<[Around<'_, R>; GROUP]> {
        None
    }
    /// Something besides the air pulls the drones.
    #[inline(always)]
    fn pulls(&self) -> bool {
        false
    }
    /// States to go back to, of a drone that no longer flies somewhere in a group.
    #[inline(always)]
    fn held(&self, _own: usize, _first: usize, _n: usize, _world: &World<R>) -> Option<[State<R>; GROUP]> {
        None
    }
    /// Lanes in which a drone flies.
    #[inline(always)]
    fn flies(&self, _tile: usize, _own: usize) -> R::Mask {
        !R::nothing()
    }
    /// After a tick: where everybody is, who hit whom, and what the radio brings. Called per tile.
    #[inline(always)]
    fn after(&mut self, _tile: usize, _place: usize, _drones: &[Drone<R>], _: &Self::Each<[Tick<R>; GROUP]>) {
    }
    /// The drones of a tile, of which the first is at `x`.
    fn seen(&self, place: usize, x: &State<R>) -> Self::Seen<'_>;
    /// The load of a tile.
    #[inline(always)]
    fn load(&self, _tile: usize) -> Option<&load::State<R>> {
        None
    }
    /// Lanes in which a drone was hit in the tick.
    #[inline(always)]
    fn hit(&self, _own: usize) -> R::Mask {
        R::nothing()
    }
    /// A drone's flight goes on in the lanes of `flies` alone.
    #[inline(always)]
    fn set_flies(&mut self, _tile: usize, _own: usize, _flies: R::Mask) {}
    /// At the end of a tick, when every drone of the tile has been judged.
    #[inline(always)]
    fn finish(&mut self, _tile: usize, _place: usize) {}
    /// A drone's knowledge of another one.
    fn neighbour_row(&self, _at: At, _other: usize, _now_s: R) -> [R; NEIGHBOUR] {
        [R::zero(); NEIGHBOUR]
    }
    /// Smallest square of a distance between two drones that flew, since the episode began.
    fn nearest2_m2(&self, _tile: usize) -> R {
        R::zero()
    }
    /// A drone among the others of its world.
    #[inline(always)]
    fn pairs(&self, _: At) -> Pairs<R> {
        [R::zero(); 8]
    }
    /// Shows the numbers that a tile goes on from by name; not those of the radio.
    #[cfg(feature = "recording")]
    fn show_numbers(&mut self, _tile: usize, _ledger: &mut dyn crate::archive::Ledger<R>) {}
    /// Writes or reads everything that a tile goes on from, whose environments are those of `used`.
    fn archive(&mut self, _tile: usize, _used: u16, _archive: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
    }
}

/// Source of the drones' commands.
pub(crate) trait Commander<R: SimScalar> {
    /// The action of a drone.
    fn action(&self, tile: usize, own: usize, drone: &Drone<R>) -> [R; ACTION];
    /// The command that its action turns into.
    #[inline(always)]
    fn command(&self, at: At, drone: &mut Drone<R>, action: &[R; ACTION]) -> Command<R> {
        drone.obey(at.tile, action)
    }
}

/// Actions of the only tile, one for each drone.
impl<R: SimScalar> Commander<R> for [[R; ACTION]] {
    #[inline(always)]
    fn action(&self, _: usize, own: usize, _: &Drone<R>) -> [R; ACTION] {
        self[own]
    }
}

/// Receives the results of a tick, or of a first moment, drone by drone.
pub(crate) trait Sink<R: SimScalar, C: Coupling<R>> {
    /// Returns whether it needs the surroundings of each drone.
    fn looks_around(&self) -> bool;
    /// The first moment of an episode in the lanes of `mask`.
    fn begin(&mut self, at: At, mask: R::Mask, flights: &Flights<R, C>, sight: &Sight<'_, R>);
    /// The end of a tick. Its drones arrive in order.
    fn tick(&mut self, at: At, flights: &Flights<R, C>, sight: &Sight<'_, R>, result: &DroneResult<'_, R>);
}

/// A drone's measurements, and its surroundings where the sink looks around.
pub(crate) struct Sight<'a, R> {
    pub(crate) reading: &'a Reading<R>,
    pub(crate) row: &'a [R; OBSERVATION],
    /// None in an empty room, and where the sink does not look.
    pub(crate) surroundings: Option<&'a Surroundings<R>>,
}

/// Result of a drone's tick, in the lanes of a tile.
#[derive(Clone, Copy)]
pub(crate) struct DroneResult<'a, R: Scalar> {
    pub(crate) contact: Contact<R>,
    /// With the reward of the task.
    pub(crate) moment: Moment<'a, R>,
    pub(crate) reward: R,
    /// The value of a user's own termination, where there is one.
    pub(crate) condition: Option<R>,
    /// Distance to its set-point, or what the task counts as its error.
    pub(crate) error_m: R,
    /// It flew until now.
    pub(crate) flew: R::Mask,
    pub(crate) hit: R::Mask,
    pub(crate) crash: R::Mask,
    /// Its part is done.
    pub(crate) done: R::Mask,
    pub(crate) terminated: R::Mask,
    pub(crate) truncated: R::Mask,
}

impl<R: SimScalar, T: Task, C: Coupling<R>> Episode<R, T, C> {
    /// Episodes of a task; `world` makes the world of each drone, at the level of attitudes.
    ///
    /// # Errors
    /// Those of `world`, of the onboard cascade, and of a user's own expressions.
    pub(crate) fn new(task: T, plan: FlightPlan<'_>, world: &mut MakeWorld<'_, R>) -> Result<Self> {
        let (flights, inbox) = Flights::new(plan, task.load(), task.board(), world)?;
        let drawn = vec![Start::origin(); plan.models.len()];
        let board = vec![0.0; task.board()];
        Ok(Episode { task, flights, inbox, drawn, board })
    }

    /// Draws how an episode of one lane starts, with the effects of its drones; see [`Self::begin`].
    pub(crate) fn draw(&mut self, tile: usize, lane: usize, key: u64, starts: &mut Starts<R>) {
        let Episode { task, flights, drawn, board, .. } = self;
        start::draw::<R, T, C>(task, key, flights.drones.as_mut(), (tile, lane), drawn, board);
        starts.set_lane(lane, drawn, board, task.load());
    }

    /// Begins episodes of a tile in the lanes of `mask`.
    #[inline(always)]
    pub(crate) fn begin<S: Sink<R, C>>(
        &mut self,
        tile: usize,
        mask: R::Mask,
        starts: &Starts<R>,
        sink: &mut S,
    ) {
        let Episode { task, flights, inbox, .. } = self;
        flights.begin(tile, mask, starts, inbox);
        R::enter("task");
        for own in 0..flights.drones.as_ref().len() {
            let at = At { tile, place: 0, own };
            // the goals of lanes under way must not move on here
            let before = flights.slot(tile, own).goal;
            let setpoint = flights.find_setpoint(task, at);
            for (new, old) in flights.slot_mut(tile, own).goal.iter_mut().zip(before) {
                *new = R::select(mask, *new, old);
            }
            let looked = sink.looks_around().then_some(surroundings(task, flights, at));
            let reading = &inbox.ticks.as_ref()[own][0].reading;
            let now_s = flights.drones.as_ref()[own].world.time_s(tile);
            let row = observe(reading, now_s, &setpoint, &flights.slot(tile, own).last_action);
            sink.begin(at, mask, flights, &Sight { reading, row: &row, surroundings: looked.as_ref() });
        }
    }

    /// One tick of all drones of some tiles: they move, meet, and are judged.
    #[inline(always)]
    pub(crate) fn tick<S: Sink<R, C>, A: Commander<R> + ?Sized>(
        &mut self,
        tiles: Range<usize>,
        commander: &A,
        sink: &mut S,
    ) {
        let Episode { task, flights, inbox, .. } = self;
        if C::ALONE && flights.is_plain() {
            for tile in tiles {
                let drone = &mut flights.drones.as_mut()[0];
                let action = commander.action(tile, 0, drone);
                R::enter("command");
                let command = drone.action_scale.command(&action);
                R::enter("model");
                let tick = drone.world.step_plain(tile, &command);
                judge(task, flights, At { tile, place: 0, own: 0 }, &action, &tick, sink);
            }
            return;
        }
        for first in tiles.clone().step_by(GROUP) {
            let n = GROUP.min(tiles.end - first);
            flights.fly(first, n, inbox, commander);
            for place in 0..n {
                let tile = first + place;
                flights.coupling.after(tile, place, flights.drones.as_ref(), &inbox.ticks);
                for own in 0..flights.drones.as_ref().len() {
                    let (action, tick) =
                        (&inbox.actions.as_ref()[own][place], &inbox.ticks.as_ref()[own][place]);
                    judge(task, flights, At { tile, place, own }, action, tick, sink);
                }
                flights.coupling.finish(tile, place);
                turn(task, flights, tile, place);
            }
        }
    }
}

/// Judges a drone's tick by the task, and passes on the result.
#[inline(always)]
fn judge<R: SimScalar, T: Task, C: Coupling<R>, S: Sink<R, C>>(
    task: &T,
    flights: &mut Flights<R, C>,
    at: At,
    action: &[R; ACTION],
    tick: &Tick<R>,
    sink: &mut S,
) {
    R::enter("task");
    let setpoint = flights.find_setpoint(task, at);
    let outcome = {
        let slot = flights.slot(at.tile, at.own);
        let situation = Situation {
            x: flights.state(at.tile, at.own),
            setpoint,
            goal: &slot.goal,
            action,
            last_action: &slot.last_action,
            contact: &tick.contact,
        };
        let seen = flights.seen(at);
        task.judge(at.own, &situation, &flights.scene(at.tile, seen.as_ref()))
    };
    let about;
    let mut looked = None;
    if T::SURROUNDED && sink.looks_around() {
        about = surroundings(task, flights, at);
        looked = Some(&about);
    }
    let verdict = flights::Verdict {
        setpoint,
        outcome,
        surroundings: looked,
        crash_cost: T::CRASH_COST,
        ends_flights: T::ENDS_FLIGHTS,
    };
    flights.conclude(at, action, tick, verdict, sink);
}

/// Gates and obstacles about a drone.
#[inline(always)]
fn surroundings<R: SimScalar, T: Task, C: Coupling<R>>(
    task: &T,
    flights: &Flights<R, C>,
    at: At,
) -> Surroundings<R> {
    let slot = flights.slot(at.tile, at.own);
    task.surroundings(at.own, &flights.state(at.tile, at.own).pos_m, &slot.goal, flights.board(at.tile))
}

/// The board moves on.
#[inline(always)]
fn turn<R: SimScalar, T: Task, C: Coupling<R>>(
    task: &T,
    flights: &mut Flights<R, C>,
    tile: usize,
    place: usize,
) {
    if C::ALONE || flights.board_size == 0 {
        return;
    }
    let mut board = std::mem::take(&mut flights.turned);
    board.copy_from_slice(flights.board(tile));
    let seen = flights.seen(At { tile, place, own: 0 });
    task.turn(&mut board, &flights.scene(tile, seen.as_ref()));
    drop(seen);
    flights.board_mut(tile).copy_from_slice(&board);
    flights.turned = board;
}
