//! A controller as a user specifies it: a name, perhaps with a file, and options.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use serde_json::Value;

use super::edited::EditedController;
use super::{Controller, ControllerConfig, ControllerContext, Entry, ObservationSpec, find};
use crazyflie_env::action::{ActionLevel, check_attitude};
use crazyflie_env::error::{Error, Result};
use crazyflie_env::estimator::{Estimator, SensorNoise};
use crazyflie_env::model::{Model, TiltInput, VerticalInput};

/// Makes controllers that are not of the registry.
pub trait ControllerFactory: Send + Sync {
    /// A controller for this site.
    ///
    /// # Errors
    /// [`Error::Controller`] for what goes wrong in it.
    fn build(&self, site: &ControllerContext<'_>) -> Result<Box<dyn Controller>>;
}

/// A specified controller; it is built for a site.
#[derive(Debug, Clone)]
pub struct ControllerSpec {
    origin: Origin,
    /// The sensor noise of the Kalman filter in front of it, if there is one.
    filter: Option<SensorNoise>,
    /// Observation of the task, for a controller in Python that does not choose its own.
    pub task_observation: ObservationSpec,
    /// Its label: as the user wrote it, a file by its name without folder and ending.
    pub label: String,
}

/// Origin of a controller.
#[derive(Clone)]
enum Origin {
    Registry { entry: &'static Entry, options: Value, file: Option<ControllerFile> },
    Factory(Arc<dyn ControllerFactory>),
}

/// The file that was named with a controller.
#[derive(Clone)]
struct ControllerFile {
    path: String,
    content: Vec<u8>,
    /// The chosen member; empty for the whole file.
    member: String,
}

impl fmt::Debug for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Registry { entry, options, file } => {
                let path = file.as_ref().map_or("", |file| &file.path);
                write!(f, "{entry:?} with {options} {path}")
            }
            Origin::Factory(_) => f.write_str("Factory"),
        }
    }
}

/// The name of a controller behind a Kalman filter begins so.
const FILTERED: &str = "kalman+";

/// Returns the controller that `text` names: `NAME`, or `NAME:FILE` for a controller in a file, which `read` reads,
/// or `NAME:FILE:MEMBER` for a part of that file; each after `kalman+` with a Kalman filter in front. `options` is an
/// object of options, or null; its `filter` is what the filter believes (see [`SensorNoise`]).
///
/// # Errors
/// [`Error::Unknown`] with a proposal; [`Error::Config`] for a file that cannot be read, is missing, or that
/// the controller has no use for.
pub fn choose(
    text: &str,
    mut options: Value,
    read: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<ControllerSpec> {
    let (filtered, text) = text.strip_prefix(FILTERED).map_or((false, text), |inner| (true, inner));
    let (name, path) = text.split_once(':').map_or((text, None), |(name, path)| (name, Some(path)));
    let entry = find(name)?;
    let problem = |problem: String| Error::Config(format!("controller {name}: {problem}"));
    let belief = options.as_object_mut().and_then(|options| options.remove("filter"));
    if belief.is_some() && !filtered {
        return Err(problem(format!("the option filter is for {FILTERED}{name}")));
    }
    let belief = belief
        .map(serde_json::from_value)
        .transpose()
        .map_err(|e| problem(format!("options: filter: {e}")))?;
    let filter = filtered.then(|| belief.unwrap_or_default());
    let file = read_file(entry, path, read).map_err(problem)?;
    let label = match &file {
        None => entry.name.to_owned(),
        Some(ControllerFile { path, member, .. }) => {
            let stem = Path::new(path).file_stem().map_or(path.into(), |stem| stem.to_string_lossy());
            let member = if member.is_empty() { String::new() } else { format!(":{member}") };
            format!("{}:{stem}{member}", entry.name)
        }
    };
    let label = if filtered { format!("{FILTERED}{label}") } else { label };
    let task_observation = ObservationSpec::default();
    Ok(ControllerSpec { origin: Origin::Registry { entry, options, file }, filter, task_observation, label })
}

/// The file that an entry is named with, or what is wrong with it.
fn read_file(
    entry: &Entry,
    path: Option<&str>,
    read: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> std::result::Result<Option<ControllerFile>, String> {
    let (what, path) = match (entry.file, path) {
        (None, None) => return Ok(None),
        (None, Some(path)) => return Err(format!("it takes no file, got {path:?}")),
        (Some(what), path) => (what, path.filter(|path| !path.is_empty())),
    };
    let form = match entry.member {
        None => format!("{}:FILE with {what}", entry.name),
        Some(member) => format!("{}:FILE:NAME with {what}, and {member}", entry.name),
    };
    let path = path.ok_or_else(|| format!("needs a file: {form}"))?;
    let (path, member) = match entry.member {
        None => (path, ""),
        // a path may hold a colon itself, as on Windows
        Some(_) => path
            .rsplit_once(':')
            .filter(|(file, name)| !file.is_empty() && !name.is_empty() && !name.contains(['/', '\\', '.']))
            .ok_or_else(|| format!("{path:?} names no part of the file: expected {form}"))?,
    };
    let content = read(path).map_err(|e| format!("{path}: {e}"))?;
    Ok(Some(ControllerFile { path: path.into(), content, member: member.into() }))
}

impl ControllerSpec {
    /// Returns a controller that needs no file, with its default options.
    ///
    /// # Errors
    /// The errors of [`choose`].
    pub fn named(name: &str) -> Result<ControllerSpec> {
        choose(name, Value::Null, &|path| {
            Err(std::io::Error::other(format!("{path} is not to be read here")))
        })
    }

    /// One that `factory` makes.
    pub fn from_factory(label: String, factory: Arc<dyn ControllerFactory>) -> ControllerSpec {
        let task_observation = ObservationSpec::default();
        ControllerSpec { origin: Origin::Factory(factory), filter: None, task_observation, label }
    }

    /// Returns the action level and the vertical form that a policy was trained for, if its file names them.
    pub fn trained_for(&self) -> Option<(ActionLevel, VerticalInput)> {
        let Origin::Registry { file: Some(file), .. } = &self.origin else { return None };
        super::policy::trained_for(&file.content)
    }

    /// Ready to fly.
    ///
    /// # Errors
    /// The errors of [`Entry::build`] and [`ControllerFactory::build`].
    pub fn build(&self, site: &ControllerContext<'_>) -> Result<Box<dyn Controller>> {
        self.build_part(site, 0)
    }

    /// Returns whether each part of a batch can have a controller of its own: one in Python answers for all rows.
    pub fn is_divisible(&self) -> bool {
        match &self.origin {
            Origin::Factory(_) => false,
            Origin::Registry { entry, .. } => entry.member.is_none(),
        }
    }

    /// Ready to fly the environments of a batch from `first_env` on, as many as the site has.
    ///
    /// # Errors
    /// The errors of [`ControllerSpec::build`].
    pub fn build_part(&self, site: &ControllerContext<'_>, first_env: usize) -> Result<Box<dyn Controller>> {
        let inner = match &self.origin {
            Origin::Factory(factory) => factory.build(site)?,
            Origin::Registry { entry, options, file } => {
                if !entry.any_level {
                    check_attitude(&format!("controller {}", entry.name), &site.interface)?;
                    check_angles(entry.name, site.model)?;
                }
                let file = file.as_ref();
                let config = ControllerConfig {
                    name: entry.name,
                    options,
                    file: file.map(|file| &file.content[..]),
                    path: file.map_or("", |file| &file.path),
                    member: file.map_or("", |file| &file.member),
                    first_env,
                    task_observation: &self.task_observation,
                };
                (entry.build)(&config, site)?
            }
        };
        Ok(match &self.filter {
            Some(belief) => {
                let filter = Estimator::new(site.model, site.interface.input, site.tick_s, belief);
                Box::new(EditedController::new(inner, site.envs, filter))
            }
            None => inner,
        })
    }
}

/// Refuses a model whose roll and pitch commands are no angles, for a controller that commands angles.
fn check_angles(controller: &str, model: &Model) -> Result<()> {
    if model.command.tilt == TiltInput::Angle {
        return Ok(());
    }
    Err(Error::Config(format!(
        "controller {controller} commands angles, and the model {} takes body rates or moments (command.tilt)",
        model.name
    )))
}

/// A controller for each drone of a world: `specs` has one for all of them, or one for each; `sites` are the
/// drones', of worlds from `first_env` on.
///
/// # Errors
/// [`Error::Config`] for another number of them; as [`ControllerSpec::build`].
pub fn build_each<'a>(
    specs: &[ControllerSpec],
    sites: impl ExactSizeIterator<Item = ControllerContext<'a>>,
    first_env: usize,
) -> Result<Vec<Box<dyn Controller>>> {
    if specs.len() != 1 && specs.len() != sites.len() {
        let (drones, got) = (sites.len(), specs.len());
        return Err(Error::Config(format!(
            "controller: expected one, or one for each of the {drones} drones, got {got}"
        )));
    }
    sites.enumerate().map(|(drone, site)| specs[drone % specs.len()].build_part(&site, first_env)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mode, registry};
    use crazyflie_env::action::{ACTION, Interface};
    use crazyflie_env::observation::{OBSERVATION, index};

    fn site(model: &Model, envs: usize) -> ControllerContext<'_> {
        ControllerContext {
            model,
            interface: Interface::from_model(model, VerticalInput::Pwm).unwrap(),
            tick_s: 0.02,
            envs,
            mode: Mode::Automatic,
        }
    }

    #[test]
    fn mistakes_are_named() {
        let none = |_: &str| Err(std::io::Error::other("no such file"));
        for (text, words) in [
            ("thesis-pit", vec!["thesis-pit", "did you mean \"thesis-pid\""]),
            ("hover:x", vec!["hover", "takes no file", "x"]),
            ("pid", vec!["pid:FILE", "gains"]),
            ("pid:gone.json", vec!["gone.json", "no such file"]),
            ("kalman+lqt", vec!["lqt", "did you mean \"lqr\""]),
            ("python:mine.py", vec!["names no part of the file", "python:FILE:NAME"]),
            ("python:mine.py:Mine", vec!["mine.py", "no such file"]),
        ] {
            let error = choose(text, Value::Null, &none).unwrap_err().to_string();
            assert!(words.iter().all(|w| error.contains(w)), "{text} gave: {error}");
        }
        let model = Model::thesis();
        // a client on the network can neither read a file nor run code here
        let named = ControllerSpec::named("python:mine.py:Mine").unwrap_err().to_string();
        assert!(named.contains("not to be read here"), "{named}");
        let mine = choose("python:mine.py:Mine", Value::Null, &|_| Ok(Vec::new())).unwrap();
        let error = mine.build(&site(&model, 1)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("has no Python in it"), "{error}");
        let odd = choose("hover", serde_json::json!({"hight": 1}), &none).unwrap();
        let error = odd.build(&site(&model, 1)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("controller hover") && error.contains("hight"), "{error}");
        // a controller of angles would be taken for one of body rates
        let by_rates = Model::thesis().with_tilt_input(TiltInput::Rate);
        let pid = choose("thesis-pid", Value::Null, &none).unwrap();
        let error = pid.build(&site(&by_rates, 1)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("thesis-pid commands angles") && error.contains("command.tilt"), "{error}");
    }

    #[test]
    fn the_registry_says_which_options_there_are() {
        let model = Model::thesis();
        for entry in registry() {
            let defaults = (entry.defaults)();
            let names: Vec<&str> = defaults.as_object().unwrap().keys().map(String::as_str).collect();
            let mut said: Vec<&str> = entry.options.iter().map(|(name, _)| *name).collect();
            said.sort_unstable();
            assert_eq!(names, said, "{}", entry.name);
            if entry.file.is_none() {
                let all = choose(entry.name, defaults, &|_| Ok(Vec::new())).unwrap();
                all.build(&site(&model, 1)).unwrap();
            }
        }
    }

    /// Every controller without a file gives an environment the same bits in a batch of 1 and of 37, whatever
    /// its neighbours do.
    #[test]
    fn a_row_is_answered_by_itself() {
        let model = Model::thesis();
        let wave = |env: usize, tick: usize, k: usize| {
            (0.37 * (1.0 + env as f32) * (tick as f32 + 3.0 * k as f32)).sin() * 0.3
        };
        for entry in registry().iter().filter(|e| e.file.is_none()) {
            let fly = |envs: &[usize]| {
                let mut controller =
                    ControllerSpec::named(entry.name).unwrap().build(&site(&model, envs.len())).unwrap();
                controller.reset(&|_| true);
                let mut log = vec![Vec::new(); envs.len()];
                let (mut o, mut a) =
                    (vec![0.0_f32; envs.len() * OBSERVATION], vec![0.0_f32; envs.len() * ACTION]);
                for tick in 0..40 {
                    for (row, env) in o.chunks_exact_mut(OBSERVATION).zip(envs) {
                        row.iter_mut().enumerate().for_each(|(k, v)| *v = wave(*env, tick, k));
                        for (at, value) in [
                            (index::MARKER_Z, 0.7),
                            (index::MARKER_AGE, 0.05),
                            (index::MARKER_VALID, 1.0),
                            (index::ACC_Z, 9.81),
                            (index::SETPOINT_Z, 0.7),
                        ] {
                            row[at] = value;
                        }
                    }
                    controller.act(&o, &mut a).unwrap();
                    log.iter_mut()
                        .zip(a.chunks_exact(ACTION))
                        .for_each(|(log, a)| log.extend(a.iter().map(|a| a.to_bits())));
                }
                log
            };
            let all: Vec<usize> = (0..37).collect();
            let batch = fly(&all);
            // a controller that throws dice throws them by the place in the batch
            assert_eq!(fly(&[0])[0], batch[0], "{}", entry.name);
            if entry.name != "random" {
                assert_eq!(fly(&[23])[0], batch[23], "{}", entry.name);
            }
            assert!(
                batch.iter().flatten().all(|bits| (-1.0..=1.0).contains(&f32::from_bits(*bits))),
                "{}",
                entry.name
            );
        }
    }
}
