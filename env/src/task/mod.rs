//! Tasks: where an episode starts, where to be, what is rewarded, when it ends. One small file each plus one registry line.

mod hover;
mod land;
mod path;
mod takeoff;
mod track;

pub use path::path;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result, unknown};
use crate::noise::Draw;
use crate::observation::{ACTION, Setpoint, wrap};
use crate::plant::State;
use crate::real::{Real, tabulate};
use crate::world::Contact;

/// Numbers that a task remembers per episode.
pub const GOAL: usize = 8;

/// The thesis's working height.
pub(crate) const HEIGHT_M: f64 = 0.7;

/// Half the side, and the height, of the thesis's room (2.1): beyond it a flight is over.
pub(crate) const ROOM_M: [f64; 2] = [2.5, 2.8];

/// How an episode begins: at rest, here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    pub pos_m: [f64; 3],
    pub yaw_rad: f64,
    pub goal: [f64; GOAL],
}

/// What a task is judged on, at the end of a control tick.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a, R: Real> {
    pub x: &'a State<R>,
    pub setpoint: Setpoint<R>,
    pub action: &'a [R; ACTION],
    pub last_action: &'a [R; ACTION],
    pub contact: &'a Contact<R>,
    pub t_s: R,
}

/// Reward and end.
#[derive(Debug, Clone, Copy)]
pub struct Verdict<R: Real> {
    pub reward: R,
    pub terminated: R::Mask,
}

/// A task, generic over the number type.
pub trait Task: Send + Sync + Sized + 'static {
    const NAME: &'static str;
    const ID: &'static str;
    const ABOUT: &'static str;
    const REWARD: &'static str;
    const MAX_EPISODE_STEPS: u32;
    /// The task's options, as in the `task_options` of a configuration.
    type Options: DeserializeOwned + Default;

    /// # Errors
    /// [`Error::Range`] for options out of range.
    fn new(options: Self::Options) -> Result<Self>;
    /// Draw the start of an episode.
    fn start(&self, rng: &mut Pcg64Mcg) -> Start;
    /// Where to be at a time; may move the goal on.
    fn setpoint<R: Real>(&self, goal: &mut [R; GOAL], t_s: R, draw: &Draw<'_, R>) -> Setpoint<R>;
    /// Reward and end; `s` has the set-point of now.
    fn judge<R: Real>(&self, s: &Situation<R>) -> Verdict<R>;
}

/// What is done with a task whose type is known only at run time.
pub(crate) trait Visitor {
    type Out;
    fn visit<T: Task>(self, task: T) -> Result<Self::Out>;
}

/// A task as the rest of the program sees it.
pub struct Entry {
    pub name: &'static str,
    /// The Gymnasium id.
    pub id: &'static str,
    pub about: &'static str,
    /// The reward of one step, in words and formula.
    pub reward: &'static str,
    pub max_episode_steps: u32,
}

const fn entry<T: Task>() -> Entry {
    Entry { name: T::NAME, id: T::ID, about: T::ABOUT, reward: T::REWARD, max_episode_steps: T::MAX_EPISODE_STEPS }
}

fn build<T: Task>(options: &serde_json::Value) -> Result<T> {
    T::new(match options {
        serde_json::Value::Null => T::Options::default(),
        given => serde_json::from_value(given.clone()).map_err(|e| Error::Config(format!("options of the task {}: {e}", T::NAME)))?,
    })
}

macro_rules! registry {
    ($($module:ident :: $task:ident),* $(,)?) => {
        /// Every task.
        pub fn registry() -> &'static [Entry] {
            static REGISTRY: &[Entry] = &[$(entry::<$module::$task>()),*];
            REGISTRY
        }

        /// The task `name`, made with `options`, given to `visitor`.
        ///
        /// # Errors
        /// [`Error::Unknown`] with a proposal, [`Error::Config`] and [`Error::Range`] for the options, and what the visitor returns.
        pub(crate) fn visit<V: Visitor>(name: &str, options: &serde_json::Value, visitor: V) -> Result<V::Out> {
            match find(name)?.name {
                $($module::$task::NAME => visitor.visit(build::<$module::$task>(options)?),)*
                _ => Err(Error::Config(format!("the task {name} cannot be built"))),
            }
        }
    };
}
registry![hover::Hover, takeoff::Takeoff, land::Land, track::Track];

/// The entry of a task.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find(name: &str) -> Result<&'static Entry> {
    registry().iter().find(|e| e.name == name).ok_or_else(|| unknown("task", name, registry().iter().map(|e| e.name)))
}

/// Uniform in a disc.
pub(crate) fn in_disc(radius: f64, rng: &mut Pcg64Mcg) -> [f64; 2] {
    let (r, angle) = (radius * rng.random::<f64>().sqrt(), std::f64::consts::TAU * rng.random::<f64>());
    [r * libm::cos(angle), r * libm::sin(angle)]
}

/// # Errors
/// [`Error::Range`] outside `low..=high`.
pub(crate) fn within(name: &str, value: f64, low: f64, high: f64) -> Result<f64> {
    if (low..=high).contains(&value) { Ok(value) } else { Err(Error::Range { name: name.into(), value, want: format!("{low} to {high}") }) }
}

/// 1 at the set-point, 1/2 at 30 cm: near enough to feel, far enough to be found from across the room.
#[inline(always)]
pub(crate) fn closeness<R: Real>(s: &Situation<R>) -> R {
    let [dx, dy, dz] = tabulate(
        #[inline(always)]
        |i| s.x.pos_m[i] - s.setpoint.pos_m[i],
    );
    let turned = wrap(s.x.att_rad[2] - s.setpoint.yaw_rad);
    let near = R::of(1.0) / (R::of(1.0) + (dx * dx + dy * dy + dz * dz) * R::of(1.0 / 0.09));
    let facing = R::of(1.0) / (R::of(1.0) + turned * turned);
    near * (R::of(0.8) + R::of(0.2) * facing)
}

/// Cost of jerking the sticks: mean square change of the action.
#[inline(always)]
pub(crate) fn jerk<R: Real>(s: &Situation<R>) -> R {
    let mut sum = R::zero();
    for i in 0..ACTION {
        let d = s.action[i] - s.last_action[i];
        sum += d * d;
    }
    R::of(0.25) * sum
}

/// Out of the room.
#[inline(always)]
pub(crate) fn outside<R: Real>(x: &State<R>) -> R::Mask {
    let (half, top) = (R::of(ROOM_M[0]), R::of(ROOM_M[1]));
    x.pos_m[0].abs().gt(half) | x.pos_m[1].abs().gt(half) | x.pos_m[2].gt(top)
}

/// Hit the floor faster than this and it is a crash. The package that the thesis flew cuts the motors 5 cm up, which lands at 1 m/s.
#[inline(always)]
pub(crate) fn crashed<R: Real>(contact: &Contact<R>) -> R::Mask {
    contact.impact_mps.gt(R::of(1.5))
}
