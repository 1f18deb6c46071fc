//! A controller as a user asks for it: a name, perhaps with a file, and options.

use serde_json::Value;

use super::filtered::FilteredController;
use super::{Controller, ControllerConfig, ControllerContext, Entry, find};
use crazyflie_env::action::check_attitude;
use crazyflie_env::error::{Error, Result};
use crazyflie_env::estimator::SensorNoise;

/// A controller that was asked for; it is built for a site.
#[derive(Debug, Clone)]
pub struct ControllerSpec {
    entry: &'static Entry,
    options: Value,
    file: Option<Vec<u8>>,
    /// What the Kalman filter in front of it believes, where there is one.
    filter: Option<SensorNoise>,
    /// What it is called: as it was asked for, a file by its name without folder and ending.
    pub label: String,
}

/// The name of a controller behind a Kalman filter begins so.
const FILTERED: &str = "kalman+";

/// The controller that `text` asks for: `NAME`, or `NAME:FILE` where the controller comes from a file, which
/// `read` reads; either after `kalman+` with a Kalman filter in front. `options` is an object of options, or
/// null; its `filter` is what the filter believes (see [`SensorNoise`]).
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
    let (file, label) = match (entry.file, path) {
        (None, None) => (None, entry.name.to_owned()),
        (None, Some(path)) => return Err(problem(format!("it takes no file, got {path:?}"))),
        (Some(what), None) => return Err(problem(format!("needs a file: {name}:FILE with {what}"))),
        (Some(_), Some(path)) => {
            let bytes = read(path).map_err(|e| problem(format!("{path}: {e}")))?;
            let stem =
                std::path::Path::new(path).file_stem().map_or(path.into(), |stem| stem.to_string_lossy());
            (Some(bytes), format!("{}:{stem}", entry.name))
        }
    };
    let label = if filtered { format!("{FILTERED}{label}") } else { label };
    Ok(ControllerSpec { entry, options, file, filter, label })
}

impl ControllerSpec {
    /// One that comes from no file, with its default options.
    ///
    /// # Errors
    /// As [`choose`].
    pub fn named(name: &str) -> Result<ControllerSpec> {
        choose(name, Value::Null, &|path| {
            Err(std::io::Error::other(format!("{path} is not to be read here")))
        })
    }

    /// Ready to fly.
    ///
    /// # Errors
    /// As [`Entry::build`].
    pub fn build(&self, site: &ControllerContext<'_>) -> Result<Box<dyn Controller>> {
        let given =
            ControllerConfig { name: self.entry.name, options: &self.options, file: self.file.as_deref() };
        if !self.entry.any_level {
            check_attitude(&format!("controller {}", self.entry.name), &site.interface)?;
        }
        let inner = (self.entry.build)(&given, site)?;
        Ok(match &self.filter {
            Some(belief) => Box::new(FilteredController::new(inner, site, belief)),
            None => inner,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mode, registry};
    use crazyflie_env::model::{Model, VerticalInput};
    use crazyflie_env::observation::{ACTION, Interface, OBSERVATION, index};

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
        ] {
            let error = choose(text, Value::Null, &none).unwrap_err().to_string();
            assert!(words.iter().all(|w| error.contains(w)), "{text} gave: {error}");
        }
        let model = Model::thesis();
        let odd = choose("hover", serde_json::json!({"hight": 1}), &none).unwrap();
        let error = odd.build(&site(&model, 1)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("controller hover") && error.contains("hight"), "{error}");
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
