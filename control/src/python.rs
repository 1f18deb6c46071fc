//! Controllers that are written in Python. This crate contains no Python: the Python package registers a loader if
//! the program runs inside it.

use std::sync::OnceLock;

use serde_json::{Value, json};

use super::spec::ControllerFactory;
use super::{Entry, ObservationSpec};
use crazyflie_env::error::Result;

/// A controller as its file gives it.
#[derive(Debug, Clone, Copy)]
pub struct PythonSource<'a> {
    /// Path of the file as the user gave it; for tracebacks and for imports from its folder.
    pub path: &'a str,
    /// Contents of the file.
    pub code: &'a [u8],
    /// The class or function in it that makes the controller.
    pub name: &'a str,
    /// Keyword arguments of that class or function.
    pub options: &'a Value,
    /// The observation that it reads unless it chooses its own.
    pub observation: &'a ObservationSpec,
}

/// Reads a file into what makes its controllers.
pub type PythonLoader = fn(&PythonSource<'_>) -> Result<Box<dyn ControllerFactory>>;

static LOADER: OnceLock<PythonLoader> = OnceLock::new();

/// Sets the loader of Python files in this process; the first call counts.
pub fn set_python_loader(loader: PythonLoader) {
    LOADER.get_or_init(|| loader);
}

pub(super) const ENTRY: Entry = Entry {
    name: "python",
    also: None,
    about: "A controller of one's own in Python: a class or function of a file, called as NAME(num_envs, interface, **options) for an object with \
            act(rows) -> actions, called once a tick for all environments; reset(mask) and set_mode(mode) if it has them. Its attributes \
            observation, history and others choose what the rows hold",
    source: "the file",
    any_level: true,
    file: Some("Python code"),
    member: Some("the class or function in it that makes the controller"),
    options: &[],
    // any options, which the class or function of the file takes
    defaults: || json!({}),
    build: |given, site| {
        let load = LOADER.get().ok_or_else(|| {
            given.problem("this program has no Python in it: expected the one of the Python package (pip install crazyflie-gym)")
        })?;
        let source = PythonSource {
            path: given.path,
            code: given.file.unwrap_or_default(),
            name: given.member,
            options: given.options,
            observation: given.task_observation,
        };
        load(&source)?.build(site)
    },
};
