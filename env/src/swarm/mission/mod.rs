//! What several drones do together. One small file each plus one registry line.

mod carry;
mod cover;
mod follow;
mod formation;
mod land;
mod swap;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::de::DeserializeOwned;

use crate::effects::Neighbour;
use crate::error::{Error, Result, unknown};
use crate::observation::Setpoint;
use crate::real::Real;
use crate::swarm::{MOST_DRONES, load};
pub(crate) use crate::task::{GOAL, Situation, Start, closeness, jerk, within};

/// What a mission knows of a world at a tick.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a, R: Real> {
    /// The drones as they truly are.
    pub drones: &'a [Neighbour<R>],
    /// What hangs below them, where something does.
    pub load: Option<&'a load::State<R>>,
    pub t_s: R,
}

/// What comes of a tick for one drone.
#[derive(Debug, Clone, Copy)]
pub struct Verdict<R: Real> {
    pub reward: R,
    /// How far it is from where it should be.
    pub error_m: R,
    /// It is where it should be in the end.
    pub arrived: R::Mask,
    /// Its part is done, and it leaves the world.
    pub done: R::Mask,
}

/// Several drones' task, generic over the number type. Crashes, collisions and the walls are the world's business.
pub trait Mission: Send + Sync + Sized + 'static {
    const NAME: &'static str;
    const ID: &'static str;
    const ABOUT: &'static str;
    const REWARD: &'static str;
    const MAX_EPISODE_STEPS: u32;
    /// Drones, unless the user says otherwise.
    const DRONES: usize;
    /// The mission's options, as in the `task_options` of a configuration.
    type Options: DeserializeOwned + Default;

    /// For so many drones.
    ///
    /// # Errors
    /// [`Error::Range`] for options out of range.
    fn new(options: Self::Options, drones: usize) -> Result<Self>;
    /// Numbers that all drones of a world share.
    fn board(&self) -> usize {
        0
    }
    /// What they carry together.
    fn load(&self) -> Option<load::Load> {
        None
    }
    /// Draw the start of an episode: a place for each drone, and what stands on the board. A load begins at rest below them.
    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]);
    /// Move the board on, once per tick.
    #[inline(always)]
    fn turn<R: Real>(&self, _board: &mut [R], _scene: &Scene<R>) {}
    /// Where drone `own` is to be now.
    fn setpoint<R: Real>(&self, own: usize, goal: &[R; GOAL], board: &[R], scene: &Scene<R>) -> Setpoint<R>;
    /// What its tick was worth.
    #[inline(always)]
    fn judge<R: Real>(&self, _own: usize, s: &Situation<R>, _board: &[R], _scene: &Scene<R>) -> Verdict<R> {
        keeping(s)
    }
}

/// Being where one should be: the reward of the single drone's tasks, and arrived within 10 cm.
#[inline(always)]
pub(crate) fn keeping<R: Real>(s: &Situation<R>) -> Verdict<R> {
    let error_m = distance(&s.x.pos_m, &s.setpoint.pos_m);
    Verdict { reward: closeness(s) - R::of(0.05) * jerk(s), error_m, arrived: error_m.lt(R::of(0.1)), done: R::nothing() }
}

#[inline(always)]
pub(crate) fn distance<R: Real>(a: &[R; 3], b: &[R; 3]) -> R {
    let [dx, dy, dz] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (dx * dx + dy * dy + dz * dz).sqrt()
}

/// A start at rest, whose goal begins with these numbers.
pub(crate) fn start_at(pos_m: [f64; 3], first: &[f64]) -> Start {
    let mut goal = [0.0; GOAL];
    goal[..first.len()].copy_from_slice(first);
    Start { pos_m, yaw_rad: 0.0, goal }
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
    Err(Error::Range { name: name.into(), value: radius_m, want: format!("{:.0} cm between {n} drones", 100.0 * least_m) })
}

/// Uniform from `-size` to `size`.
pub(crate) fn jitter<const N: usize>(rng: &mut Pcg64Mcg, size: f64) -> [f64; N] {
    std::array::from_fn(|_| size * (2.0 * rng.random::<f64>() - 1.0))
}

/// Where a whole number that is kept as a number of the lanes is `i`.
#[inline(always)]
pub(crate) fn is<R: Real>(number: R, i: usize) -> R::Mask {
    (number - R::of(i as f64)).abs().lt(R::of(0.5))
}

/// What is done with a mission whose type is known only at run time.
pub(crate) trait Visitor {
    type Out;
    fn visit<M: Mission>(self, mission: M, drones: usize) -> Result<Self::Out>;
}

/// A mission as the rest of the program sees it.
pub struct Entry {
    pub name: &'static str,
    /// The Gymnasium id of the centralised environment.
    pub id: &'static str,
    pub about: &'static str,
    /// The reward of one drone's step, in words and formula.
    pub reward: &'static str,
    pub max_episode_steps: u32,
    /// Drones unless the user says otherwise.
    pub drones: usize,
}

const fn entry<M: Mission>() -> Entry {
    Entry { name: M::NAME, id: M::ID, about: M::ABOUT, reward: M::REWARD, max_episode_steps: M::MAX_EPISODE_STEPS, drones: M::DRONES }
}

fn build<M: Mission>(options: &serde_json::Value, drones: usize) -> Result<M> {
    let options = match options {
        serde_json::Value::Null => M::Options::default(),
        given => serde_json::from_value(given.clone()).map_err(|e| Error::Config(format!("options of the mission {}: {e}", M::NAME)))?,
    };
    M::new(options, drones)
}

macro_rules! registry {
    ($($module:ident :: $mission:ident),* $(,)?) => {
        /// Every mission.
        pub fn registry() -> &'static [Entry] {
            static REGISTRY: &[Entry] = &[$(entry::<$module::$mission>()),*];
            REGISTRY
        }

        /// The mission `name` for `drones` (0 for its own number), made with `options`, given to `visitor`.
        ///
        /// # Errors
        /// [`Error::Unknown`] with a proposal, [`Error::Config`] and [`Error::Range`] for the options, and what the visitor returns.
        pub(crate) fn visit<V: Visitor>(name: &str, drones: usize, options: &serde_json::Value, visitor: V) -> Result<V::Out> {
            let entry = find(name)?;
            let drones = if drones == 0 { entry.drones } else { drones };
            if drones > MOST_DRONES {
                return Err(Error::Range { name: "drones".into(), value: drones as f64, want: format!("1 to {MOST_DRONES}") });
            }
            match entry.name {
                $($module::$mission::NAME => visitor.visit(build::<$module::$mission>(options, drones)?, drones),)*
                _ => Err(Error::Config(format!("the mission {name} cannot be built"))),
            }
        }
    };
}
registry![formation::Formation, swap::Swap, follow::Follow, cover::Cover, land::LandInTurn, carry::Carry];

/// The entry of a mission.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find(name: &str) -> Result<&'static Entry> {
    registry().iter().find(|e| e.name == name).ok_or_else(|| unknown("mission", name, registry().iter().map(|e| e.name)))
}
