//! Tasks: where an episode starts, where to be, what is rewarded, when it ends, for one drone or several. One
//! small file each plus one registry line.

mod carry;
mod cover;
mod follow;
mod formation;
mod hover;
mod land;
mod land_in_turn;
mod options;
mod own;
mod path;
mod race;
mod swap;
mod takeoff;
mod track;
mod track_table;

pub use options::{OptionKind, TaskOption};
pub use path::{path, setpoints};
pub use track_table::{TRACK_COLUMNS, track_rows};

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

pub(crate) use options::{Chosen, OptionSet, options};

use crate::action::ACTION;
use crate::coupling::{MOST_DRONES, load};
use crate::effects::Neighbour;
use crate::error::{Error, Result, out_of_range, unknown};
use crate::model::ROOM_M;
use crate::noise::TickRng;
use crate::observation::{Setpoint, Surroundings};
use crate::plant::State;
use crate::scalar::{Scalar, tabulate, wrap};
use crate::world::Contact;

/// Numbers that a task remembers of a drone's episode.
pub const GOAL: usize = 12;

/// The thesis's working height.
pub(crate) const HEIGHT_M: f64 = 0.7;

/// Start of a drone's episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Start<R = f64> {
    pub pos_m: [R; 3],
    pub yaw_rad: R,
    /// Sideways velocity, world frame.
    pub vel_mps: [R; 2],
    /// Roll and pitch.
    pub tilt_rad: [R; 2],
    pub goal: [R; GOAL],
}

impl<R: Scalar> Start<R> {
    /// At rest on the floor over the marker.
    pub(crate) fn origin() -> Self {
        let zero = R::zero();
        Start { pos_m: [zero; 3], yaw_rad: zero, vel_mps: [zero; 2], tilt_rad: [zero; 2], goal: [zero; GOAL] }
    }
}

/// A task's view of an environment at a tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a, R: Scalar> {
    /// The drones as they truly are.
    pub drones: &'a [Neighbour<R>],
    /// The load below them, if the task has one.
    pub load: Option<&'a load::State<R>>,
    /// Numbers that all drones of the environment share.
    pub board: &'a [R],
    pub t_s: R,
    /// The noise of this tick.
    pub draw: TickRng<'a, R>,
}

/// The edges of an object in the room: joined points, metres in the world frame.
pub type Outline = Vec<[f64; 3]>;

/// Situation of a drone at the end of a control tick, on which it is judged.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a, R: Scalar> {
    /// True state of the drone.
    pub x: &'a State<R>,
    /// Target of this tick, world frame.
    pub setpoint: Setpoint<R>,
    /// The task's memory of its episode.
    pub goal: &'a [R; GOAL],
    /// Action that the drone obeyed in this tick, each number from -1 to 1.
    pub action: &'a [R; ACTION],
    /// Action of the tick before.
    pub last_action: &'a [R; ACTION],
    /// Touch of the floor during this tick.
    pub contact: &'a Contact<R>,
}

/// Result of a tick for one drone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outcome<R: Scalar> {
    pub reward: R,
    /// Distance from the set-point.
    pub error_m: R,
    /// It is where it should be in the end.
    pub arrived: R::Mask,
    /// Its part is done, and its flight ends.
    pub ends: R::Mask,
}

/// A task, generic over the number type. Crashes, collisions and the walls are the environment's business.
pub(crate) trait Task: Send + Sync + Sized + 'static {
    const NAME: &'static str;
    /// The Gymnasium id.
    const ID: &'static str;
    const ABOUT: &'static str;
    const REWARD: &'static str;
    const MAX_EPISODE_STEPS: u32;
    /// Default number of drones of an environment. A task of one drone is for one drone only: nothing couples it.
    const DRONES: usize = 1;
    /// Reward that a collision, a crash or leaving the room takes; all three end a drone's flight.
    const CRASH_COST: f64 = if Self::DRONES > 1 { 10.0 } else { 0.0 };
    /// The end of a drone's part, or its crash, ends its flight: it stays in place, and no longer affects the others.
    const ENDS_FLIGHTS: bool = true;
    /// Gates or obstacles are in the room, so that fields of them can be observed.
    const SURROUNDED: bool = false;
    /// The task's options, as in the `task_options` of a configuration.
    type Options: OptionSet;

    /// For so many drones.
    ///
    /// # Errors
    /// [`Error::Range`] and [`Error::Config`] for options that do not go together.
    fn new(chosen: Chosen<Self::Options>, drones: usize) -> Result<Self>;
    /// Numbers that all drones of an environment share, for an episode.
    fn board(&self) -> usize {
        0
    }
    /// Returns the load that the drones carry together.
    fn load(&self) -> Option<load::Load> {
        None
    }
    /// Draws the start of an episode: a place for each drone, and the contents of the board. A load begins at rest
    /// below them.
    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]);
    /// Returns the objects in the room, as lines to draw.
    fn outlines(&self, _board: &[f64]) -> Vec<Outline> {
        Vec::new()
    }
    /// Move the board on, once per tick.
    #[inline(always)]
    fn turn<R: Scalar>(&self, _board: &mut [R], _scene: &Scene<R>) {}
    /// Returns the set-point of drone `own` now, by itself the first numbers of its goal; may move its goal on.
    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _own: usize, goal: &mut [R; GOAL], _scene: &Scene<R>) -> Setpoint<R> {
        Setpoint { pos_m: [goal[0], goal[1], goal[2]], yaw_rad: goal[3] }
    }
    /// Returns the surroundings of drone `own` at `pos_m`.
    #[inline(always)]
    fn surroundings<R: Scalar>(
        &self,
        _own: usize,
        _pos_m: &[R; 3],
        _goal: &[R; GOAL],
        _board: &[R],
    ) -> Surroundings<R> {
        Surroundings::none()
    }
    /// Judges its tick; `s` has the set-point of now.
    #[inline(always)]
    fn judge<R: Scalar>(&self, _own: usize, s: &Situation<R>, _scene: &Scene<R>) -> Outcome<R> {
        keeping(s)
    }
}

/// An operation on a task whose type is known only at run time.
pub(crate) trait Visitor {
    type Output;
    fn visit<T: Task>(self, task: T, drones: usize) -> Result<Self::Output>;
}

/// A task as the rest of the program sees it.
pub struct Entry {
    /// Key in configurations and on the command line.
    pub name: &'static str,
    /// The Gymnasium id.
    pub id: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
    /// The reward of one drone's step, in words and formula.
    pub reward: &'static str,
    /// Default number of control ticks after which Gymnasium truncates an episode.
    pub max_episode_steps: u32,
    /// Default number of drones of an environment.
    pub drones: usize,
    options: fn() -> Vec<TaskOption>,
}

const fn entry<T: Task>() -> Entry {
    Entry {
        name: T::NAME,
        id: T::ID,
        about: T::ABOUT,
        reward: T::REWARD,
        max_episode_steps: T::MAX_EPISODE_STEPS,
        drones: T::DRONES,
        options: T::Options::list,
    }
}

impl Entry {
    /// Returns the options that `task_options` may contain.
    pub fn options(&self) -> Vec<TaskOption> {
        (self.options)()
    }

    /// Returns the number of drones for the requested one; 0 requests the task's own number.
    ///
    /// # Errors
    /// [`Error::Range`] for more than one drone in a task of one, and for more than [`MOST_DRONES`].
    pub fn drones(&self, asked: usize) -> Result<usize> {
        let most = if self.drones == 1 { 1 } else { MOST_DRONES };
        match asked {
            0 => Ok(self.drones),
            _ if asked <= most => Ok(asked),
            _ if most == 1 => Err(out_of_range(
                "drones",
                asked as f64,
                format!("1: the task {} is for one drone", self.name),
            )),
            _ => Err(out_of_range("drones", asked as f64, format!("1 to {most}"))),
        }
    }
}

fn build<T: Task>(options: &serde_json::Value, drones: usize) -> Result<T> {
    T::new(Chosen::read(T::NAME, options)?, drones)
}

macro_rules! registry {
    ($($module:ident :: $task:ident),* $(,)?) => {
        /// Every task.
        pub fn registry() -> &'static [Entry] {
            static REGISTRY: &[Entry] = &[$(entry::<$module::$task>()),*];
            REGISTRY
        }

        /// The task `name` for `drones` (0 for its own number), made with `options`, given to `visitor`.
        ///
        /// # Errors
        /// [`Error::Unknown`] with a proposal, [`Error::Config`] and [`Error::Range`] for the options, and
        /// what the visitor returns.
        pub(crate) fn visit<V: Visitor>(name: &str, drones: usize, options: &serde_json::Value, visitor: V) -> Result<V::Output> {
            let entry = find(name)?;
            let drones = entry.drones(drones)?;
            match entry.name {
                $($module::$task::NAME => visitor.visit(build::<$module::$task>(options, drones)?, drones),)*
                _ => Err(Error::Config(format!("the task {name} cannot be built"))),
            }
        }
    };
}
registry![
    hover::Hover,
    takeoff::Takeoff,
    land::Land,
    track::Track,
    race::Race,
    formation::Formation,
    swap::Swap,
    follow::Follow,
    cover::Cover,
    land_in_turn::LandInTurn,
    carry::Carry,
    own::Own,
];

/// The entry of a task.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find(name: &str) -> Result<&'static Entry> {
    registry()
        .iter()
        .find(|e| e.name == name || e.id == name)
        .ok_or_else(|| unknown("task", name, registry().iter().map(|e| e.name)))
}

/// Being where one should be, and arrived within 10 cm.
#[inline(always)]
pub(crate) fn keeping<R: Scalar>(s: &Situation<R>) -> Outcome<R> {
    let error_m = distance(&s.x.pos_m, &s.setpoint.pos_m);
    Outcome {
        reward: closeness(s) - R::from_f64(0.05) * jerk(s),
        error_m,
        arrived: error_m.lt(R::from_f64(0.1)),
        ends: R::nothing(),
    }
}

#[inline(always)]
pub(crate) fn distance<R: Scalar>(a: &[R; 3], b: &[R; 3]) -> R {
    let [dx, dy, dz] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (dx * dx + dy * dy + dz * dz).sqrt()
}

/// The reward of landing: of the approach, and of the touch-down in the lanes of `down`.
#[inline(always)]
pub(crate) fn landing_reward<R: Scalar>(s: &Situation<R>, impact_mps: R, down: R::Mask) -> R {
    let one = R::from_f64(1.0);
    let approach = R::from_f64(0.1) * (closeness(s) - one) - R::from_f64(0.005) * jerk(s);
    let off2 = s.x.pos_m[0] * s.x.pos_m[0] + s.x.pos_m[1] * s.x.pos_m[1];
    let impact2 = impact_mps * impact_mps;
    let touch = R::from_f64(10.0)
        / ((one + R::from_f64(1.0 / 0.01) * off2) * (one + R::from_f64(1.0 / 0.09) * impact2));
    approach + R::select(down, touch, R::zero())
}

/// A start at rest, whose goal begins with these numbers.
pub(crate) fn start_at(pos_m: [f64; 3], first: &[f64]) -> Start {
    let mut goal = [0.0; GOAL];
    goal[..first.len()].copy_from_slice(first);
    Start { pos_m, goal, ..Start::origin() }
}

/// Place `i` of `n` on a circle.
pub(crate) fn on_circle(i: usize, n: usize, radius_m: f64, turned_rad: f64) -> [f64; 2] {
    let angle = turned_rad + std::f64::consts::TAU * i as f64 / n as f64;
    [radius_m * libm::cos(angle), radius_m * libm::sin(angle)]
}

/// Drones on a circle have room.
///
/// # Errors
/// [`Error::Range`] naming `name`, the circle's radius, if neighbours are less than `least_m` apart.
pub(crate) fn room_on_circle(name: &str, radius_m: f64, n: usize, least_m: f64) -> Result<()> {
    let gap_m = 2.0 * radius_m * libm::sin(std::f64::consts::PI / n.max(2) as f64);
    if n < 2 || gap_m >= least_m {
        return Ok(());
    }
    let needed_m = 0.5 * least_m / libm::sin(std::f64::consts::PI / n as f64);
    Err(out_of_range(
        name,
        radius_m,
        format!("{:.0} cm between {n} drones: at least {needed_m:.3}", 100.0 * least_m),
    ))
}

/// A vector of this length in any direction.
pub(crate) fn random_direction(length: f64, rng: &mut Pcg64Mcg) -> [f64; 2] {
    let angle = std::f64::consts::TAU * rng.random::<f64>();
    // adding zero removes the sign of a negative zero
    [length * libm::cos(angle) + 0.0, length * libm::sin(angle) + 0.0]
}

/// Uniform from `-size` to `size`.
pub(crate) fn jitter<const N: usize>(rng: &mut Pcg64Mcg, size: f64) -> [f64; N] {
    std::array::from_fn(|_| size * (2.0 * rng.random::<f64>() - 1.0))
}

/// Returns the mask of lanes whose whole number, kept as a number of the lanes, is `i`.
#[inline(always)]
pub(crate) fn is<R: Scalar>(number: R, i: usize) -> R::Mask {
    (number - R::from_f64(i as f64)).abs().lt(R::from_f64(0.5))
}

/// Uniform in a disc.
pub(crate) fn in_disc(radius: f64, rng: &mut Pcg64Mcg) -> [f64; 2] {
    let (r, angle) = (radius * rng.random::<f64>().sqrt(), std::f64::consts::TAU * rng.random::<f64>());
    [r * libm::cos(angle), r * libm::sin(angle)]
}

/// 1 at the set-point, 1/2 at 30 cm: near enough to feel, far enough to be found from across the room.
#[inline(always)]
pub(crate) fn closeness<R: Scalar>(s: &Situation<R>) -> R {
    let [dx, dy, dz] = tabulate(
        #[inline(always)]
        |i| s.x.pos_m[i] - s.setpoint.pos_m[i],
    );
    let turned = wrap(s.x.att_rad[2] - s.setpoint.yaw_rad);
    let near =
        R::from_f64(1.0) / (R::from_f64(1.0) + (dx * dx + dy * dy + dz * dz) * R::from_f64(1.0 / 0.09));
    let facing = R::from_f64(1.0) / (R::from_f64(1.0) + turned * turned);
    near * (R::from_f64(0.8) + R::from_f64(0.2) * facing)
}

/// Cost of jerking the sticks: mean square change of the action.
#[inline(always)]
pub(crate) fn jerk<R: Scalar>(s: &Situation<R>) -> R {
    let mut sum = R::zero();
    for i in 0..ACTION {
        let d = s.action[i] - s.last_action[i];
        sum += d * d;
    }
    R::from_f64(0.25) * sum
}

/// Out of the room.
#[inline(always)]
pub(crate) fn outside<R: Scalar>(x: &State<R>) -> R::Mask {
    let (half, top) = (R::from_f64(ROOM_M[0]), R::from_f64(ROOM_M[1]));
    x.pos_m[0].abs().gt(half) | x.pos_m[1].abs().gt(half) | x.pos_m[2].gt(top)
}

/// Hit the floor faster than this and it is a crash. The package that the thesis flew cuts the motors 5 cm
/// up, which lands at 1 m/s.
#[inline(always)]
pub(crate) fn crashed<R: Scalar>(contact: &Contact<R>) -> R::Mask {
    contact.impact_mps.gt(R::from_f64(1.5))
}
