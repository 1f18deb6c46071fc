//! Controllers are clients of the environment: they read the observation an agent gets and answer with an
//! action. One controller is one small file here plus one line in [`registry`]; command line, benchmark and
//! Python read the registry.

pub mod avoidance;
mod batch;
mod edited;
mod filtered;
mod gains;
mod hover;
mod landing;
pub mod loop_analysis;
mod lqr;
mod mpc;
mod multi;
mod observer;
mod observing;
pub mod pid;
mod policy;
mod python;
mod qp;
mod random;
pub mod riccati;
mod spec;
mod velocity;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crazyflie_env::action::Interface;
use crazyflie_env::error::{Error, Result, find_named, unknown};
use crazyflie_env::model::Model;

pub use batch::{Batch, ControlLaw};
pub use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
pub use multi::MultiController;
pub use observing::{ExtraInputs, InputNeeds, ObservationSpec, with_observation};
pub use policy::{PolicyCode, export_c};
pub use python::{PythonLoader, PythonSource, set_python_loader};
pub use spec::{ControllerFactory, ControllerSpec, build_each, choose};

/// A controller of a batch of environments. Its answer to a row depends on that environment's rows alone: not on the
/// others, nor on their number, to the bit.
pub trait Controller: Send {
    /// Go on in another state, keeping what is remembered.
    fn set_mode(&mut self, _mode: Mode) {}

    /// Forget the flights of the environments that `of` names: called for every one that begins an episode.
    fn reset(&mut self, of: &dyn Fn(usize) -> bool);

    /// Returns what it needs beside measured rows; by default nothing.
    fn needs(&self) -> InputNeeds {
        InputNeeds::default()
    }

    /// Sets inputs of the next [`Controller::act`] beside measured rows.
    fn set_inputs(&mut self, _inputs: ExtraInputs<'_>) {}

    /// Actions (`envs` rows of [`crazyflie_env::action::ACTION`]) for observations (`envs` rows of
    /// [`crazyflie_env::observation::OBSERVATION`]).
    ///
    /// # Errors
    /// [`Error::Shape`]; [`Error::Controller`] of a controller that is not of this crate; [`Error::Config`] for what
    /// it [needs](Controller::needs) and did not get.
    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()>;
}

/// Commands to a controller: the states of `crazyflie_ros`, which the thesis flew.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Keep the set-point from the first tick, as from a hover.
    Automatic,
    /// From the floor to the set-point.
    Takeoff,
    /// Keep the set-point, with the height 5 cm above the floor; below that, motors off.
    Landing,
}

impl Mode {
    /// Returns the name that [`Mode::named`] takes.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Mode::Automatic => "automatic",
            Mode::Takeoff => "takeoff",
            Mode::Landing => "landing",
        }
    }

    /// "automatic", "takeoff" or "landing".
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Mode> {
        let all = [Mode::Automatic, Mode::Takeoff, Mode::Landing];
        find_named("controller mode", name, all, |mode| mode.name())
    }
}

/// Environment that a controller is built for.
#[derive(Debug, Clone, Copy)]
pub struct ControllerContext<'a> {
    /// The vehicle as the controller may assume it: the declared model, which the effects of an environment depart
    /// from.
    pub model: &'a Model,
    /// Meaning of its actions.
    pub interface: Interface,
    /// Seconds from one observation to the next.
    pub tick_s: f64,
    /// Environments that it flies at once: rows of an observation.
    pub envs: usize,
    /// State in which it begins.
    pub mode: Mode,
}

/// Configuration of a controller, besides its site.
#[derive(Debug, Clone, Copy)]
pub struct ControllerConfig<'a> {
    name: &'static str,
    options: &'a Value,
    /// The content of the file named with it, where its entry has one.
    pub file: Option<&'a [u8]>,
    /// That file's path, as the user gave it.
    path: &'a str,
    /// The chosen member of the file, if its entry has members.
    member: &'a str,
    /// Place of its first environment in the whole batch.
    pub first_env: usize,
    /// Observation of the task, for a controller in Python that does not choose its own.
    task_observation: &'a ObservationSpec,
}

impl ControllerConfig<'_> {
    /// The options, defaults filled in.
    ///
    /// # Errors
    /// The errors of [`ControllerConfig::options_over`].
    pub fn options<T: Serialize + DeserializeOwned + Default>(&self) -> Result<T> {
        self.options_over(&T::default())
    }

    /// The options merged into `base`: what is not given stays, inside groups as well.
    ///
    /// # Errors
    /// [`Error::Config`] naming the controller and the option.
    pub fn options_over<T: Serialize + DeserializeOwned>(&self, base: &T) -> Result<T> {
        let bad = |e: serde_json::Error| self.problem(format!("options: {e}"));
        let mut merged = serde_json::to_value(base).map_err(bad)?;
        merge(&mut merged, self.options);
        serde_json::from_value(merged).map_err(bad)
    }

    /// The controller's name with that of its file.
    fn label(&self) -> String {
        if self.path.is_empty() { self.name.into() } else { format!("{}:{}", self.name, self.path) }
    }

    /// An error about this controller.
    pub fn problem(&self, problem: impl std::fmt::Display) -> Error {
        Error::Config(format!("controller {}: {problem}", self.name))
    }
}

/// Puts `given` into `base`, group by group; null changes nothing.
fn merge(base: &mut Value, given: &Value) {
    match (base, given) {
        (_, Value::Null) => {}
        (Value::Object(base), Value::Object(given)) => {
            for (name, value) in given {
                merge(base.entry(name.as_str()).or_insert(Value::Null), value);
            }
        }
        (base, given) => *base = given.clone(),
    }
}

/// A controller as the rest of the program sees it.
pub struct Entry {
    /// Key on the command line and in configurations.
    pub name: &'static str,
    /// Another name of it.
    pub also: Option<&'static str>,
    /// Description for users.
    pub about: &'static str,
    /// Equation, paper or derivation.
    pub source: &'static str,
    /// The controller flies at any action level; the others command attitudes.
    pub any_level: bool,
    /// Description of the file that is named after the name and a colon (`NAME:FILE`); `None` if it takes no file.
    pub file: Option<&'static str>,
    /// Description of the member named after a second colon (`NAME:FILE:MEMBER`); `None` if the whole file is meant.
    pub member: Option<&'static str>,
    /// Its options, and what each means.
    pub options: &'static [(&'static str, &'static str)],
    /// The options as they are unless given.
    pub defaults: fn() -> Value,
    /// # Errors
    /// [`Error::Config`] and [`Error::Range`] for the options and the file; what the model lacks.
    pub build: fn(&ControllerConfig<'_>, &ControllerContext<'_>) -> Result<Box<dyn Controller>>,
}

impl std::fmt::Debug for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Entry({})", self.name)
    }
}

/// Declares a controller's options, each with its type, its default and its meaning.
macro_rules! options {
    ($($name:ident: $type:ty = $default:expr, $about:expr;)*) => {
        #[derive(Debug, Clone, Copy, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub(super) struct Options {
            $(pub(super) $name: $type,)*
        }

        impl Default for Options {
            fn default() -> Self {
                Options { $($name: $default,)* }
            }
        }

        pub(super) const OPTIONS: &[(&str, &str)] = &[$((stringify!($name), $about),)*];
    };
}
use options;

/// Returns options in the registry's form.
fn options_json(options: impl Serialize) -> Value {
    // options are plain structures of numbers
    serde_json::to_value(options).unwrap_or(Value::Null)
}

/// The default options of a controller.
fn defaults<T: Serialize + Default>() -> Value {
    options_json(T::default())
}

/// Every controller.
pub fn registry() -> &'static [&'static Entry] {
    static REGISTRY: &[&Entry] = &[
        &pid::THESIS,
        &pid::STOCK,
        &pid::GIVEN,
        &lqr::ENTRY,
        &velocity::ENTRY,
        &mpc::ENTRY,
        &policy::ENTRY,
        &python::ENTRY,
        &hover::ENTRY,
        &random::ENTRY,
    ];
    REGISTRY
}

/// The entry of a controller.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find(name: &str) -> Result<&'static Entry> {
    let entry = registry().iter().copied().find(|e| e.name == name || e.also == Some(name));
    entry.ok_or_else(|| {
        unknown("controller", name, registry().iter().flat_map(|e| std::iter::once(e.name).chain(e.also)))
    })
}
