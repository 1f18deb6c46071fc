//! A task of a user's own: a file that names a task and its settings, under the names of [`Options`].

use serde_json::{Map, Value};

use crate::config::Options;
use crate::error::{Error, Result, unknown};
use crate::task;
use crate::tree::parse_tree;

/// Keys of a file besides its name: everything that defines a task. Threads, instruction sets and resets are up to
/// whoever flies it.
const KEYS: [&str; 17] = [
    "task",
    "task_options",
    "reward",
    "termination",
    "cost",
    "max_episode_steps",
    "action",
    "observation",
    "history",
    "effects",
    "vertical",
    "physics_hz",
    "drones",
    "neighbours",
    "each",
    "radius_m",
    "wind_field",
];

/// A task of a user's own.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskFile {
    /// Letters, digits, `-` and `_`.
    pub name: String,
    /// Description for people.
    pub about: String,
    /// Options as they are written in the file, by the names of [`Options`]; at least `task` and
    /// `max_episode_steps`.
    pub options: Map<String, Value>,
}

impl TaskFile {
    /// From TOML or JSON. The task is "hover" unless the file names another, and lasts as long as that one does.
    ///
    /// # Errors
    /// [`Error::Config`] naming the line of what cannot be read, and the key of what is missing or wrong;
    /// [`Error::Unknown`] with a proposal for other keys; as [`Options::parse`].
    pub fn parse(text: &str) -> Result<TaskFile> {
        let bad = |problem: String| Error::Config(format!("task file: {problem}"));
        let value = parse_tree(text).map_err(bad)?;
        let Value::Object(mut options) = value else { return Err(bad("expected a table".into())) };
        let mut take_text = |key: &str| match options.remove(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(bad(format!("{key} is {other}, expected a text"))),
        };
        let (name, about) = (take_text("name")?, take_text("about")?.unwrap_or_default());
        let name = name.ok_or_else(|| bad("there is no name, expected name = \"my-task\"".into()))?;
        let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > 64 || !name.chars().all(fits) {
            return Err(bad(format!("name is {name:?}, expected up to 64 letters, digits, - and _")));
        }
        if let Some(key) = options.keys().find(|key| !KEYS.contains(&key.as_str())) {
            return Err(unknown("key of a task file", key, KEYS.into_iter().chain(["name", "about"])));
        }
        options.entry("task").or_insert_with(|| Options::default().task.into());
        let read = Options::parse(&Value::Object(options.clone()).to_string())
            .map_err(|error| name_key(&options, error))?;
        let entry = task::find(&read.task)?;
        if options.contains_key("max_episode_steps") && read.max_episode_steps == 0 {
            return Err(bad("max_episode_steps is 0, expected at least 1".into()));
        }
        options.entry("max_episode_steps").or_insert_with(|| entry.max_episode_steps.into());
        Ok(TaskFile { name, about, options })
    }

    /// The Gymnasium id.
    pub fn id(&self) -> String {
        format!("crazyflie/{}-v0", self.name)
    }
}

/// Names the key that is wrong by itself in an error about options; an error about a value's type lacks the key.
fn name_key(options: &Map<String, Value>, error: Error) -> Error {
    let Error::Config(problem) = &error else { return error };
    let alone = |key: &str, value: &Value| {
        Options::parse(&Value::Object(Map::from_iter([(key.into(), value.clone())])).to_string())
    };
    let wrong = options.iter().find(|(key, value)| alone(key, value).is_err());
    match wrong {
        Some((key, value)) => Error::Config(format!("task file: {key} is {value}: {problem}")),
        None => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
name = "climb"
reward = "exp(-4*dist**2)"
termination = "dist > 2"
max_episode_steps = 100
[task_options]
setpoint_m = [0, 0, 1.5]
[effects]
gust = { sigma_mps2 = 0.2 }
"#;

    #[test]
    fn toml_and_json_say_the_same() {
        let toml = TaskFile::parse(TEXT).unwrap();
        assert_eq!((toml.name.as_str(), toml.id().as_str()), ("climb", "crazyflie/climb-v0"));
        assert_eq!(toml.options["task"], "hover");
        let mut json = toml.options.clone();
        json.insert("name".into(), "climb".into());
        assert_eq!(TaskFile::parse(&Value::Object(json).to_string()).unwrap(), toml);
        assert_eq!(TaskFile::parse("name = \"x\"").unwrap().options["max_episode_steps"], 500);
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, words) in [
            ("", "there is no name"),
            ("name = 3", "name is 3"),
            ("name = \"x\"\nphysics_hz = nan", "physics_hz is NaN, expected a finite number"),
            ("name = \"a b\"", "letters, digits"),
            ("name = \"x\"\nrewrd = \"dist\"", "did you mean \"reward\""),
            ("name = \"x\"\nthreads = 2", "unknown key of a task file"),
            ("name = \"x\"\ntask = \"hovr\"", "did you mean \"hover\""),
            ("name = \"x\"\nreward = \"-dst\"", "did you mean \"dist\""),
            ("name = \"x\"\nreward = ", "line 2"),
            ("[1, 2]", "task file"),
            ("name = \"x\"\nmax_episode_steps = 0", "expected at least 1"),
            ("{\"name\": \"x\", \"history\": \"long\"}", "history is \"long\""),
        ] {
            let error = TaskFile::parse(text).unwrap_err().to_string();
            assert!(error.contains(words), "{text:?} gave: {error}");
        }
    }

    #[test]
    fn every_key_is_an_option() {
        let refused = Options::parse("{\"nonsense\": 0}").unwrap_err().to_string();
        for key in KEYS {
            assert!(refused.contains(&format!("`{key}`")), "{key}: {refused}");
        }
    }
}
