//! Errors, worded so that the reader can correct the cause.

/// Every error of the simulator names the value, the place and what was expected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum Error {
    #[error("{what}: expected {want}, got {got}")]
    Shape { what: &'static str, want: String, got: String },
    #[error("actions[{env}][{axis}] is {value}, expected a number from -1 to 1")]
    Action { env: usize, axis: usize, value: f32 },
    #[error("actions[{world}][{drone}][{axis}] is {value}, expected a number from -1 to 1")]
    DroneAction { world: usize, drone: usize, axis: usize, value: f32 },
    #[error("unknown {what} {name:?}{hint}; known: {known}")]
    Unknown { what: &'static str, name: String, hint: String, known: String },
    #[error("{name} is {value}, expected {want}")]
    Range { name: String, value: f64, want: String },
    #[error("model {name}: {problem}")]
    Model { name: String, problem: String },
    #[error("controller {name}: {problem}")]
    Controller { name: String, problem: String },
    #[error("configuration: {0}")]
    Config(String),
    #[error("{name} {text:?}, column {column}: {problem}")]
    Expression { name: &'static str, text: String, column: usize, problem: String },
    #[error(
        "{name} {text:?} is {value} in environment {env}, drone {drone}, at step {step} of its episode: expected a finite number"
    )]
    NotFinite { name: &'static str, text: String, value: f32, env: usize, drone: usize, step: u64 },
    #[error("environment {env} has ended: reset it before the next step (options={{\"reset_mask\": ...}})")]
    Ended { env: usize },
    #[error("call reset() before step()")]
    NotReset,
}

/// Results of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Creates an [`Error::Unknown`] that proposes the nearest known name, or those that begin or end with the given one.
pub fn unknown<'a>(what: &'static str, name: &str, known: impl IntoIterator<Item = &'a str>) -> Error {
    let known: Vec<&str> = known.into_iter().collect();
    let nearest = known.iter().map(|k| (strsim::damerau_levenshtein(k, name), *k)).min();
    let hint = match nearest {
        Some((distance, k)) if distance <= 1 + name.len() / 3 => format!(" (did you mean {k:?}?)"),
        _ => {
            let parts = |k: &&&str| name.len() > 2 && (k.starts_with(name) || k.ends_with(name));
            let longer: Vec<String> = known.iter().filter(parts).map(|k| format!("{k:?}")).collect();
            if longer.is_empty() {
                String::new()
            } else {
                format!(" (did you mean {}?)", longer.join(" or "))
            }
        }
    };
    Error::Unknown { what, name: name.to_owned(), hint, known: known.join(", ") }
}

/// Finds what has that name.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find_named<'a, T: Copy>(
    what: &'static str,
    name: &str,
    all: impl IntoIterator<Item = T, IntoIter: Clone>,
    name_of: impl Fn(T) -> &'a str,
) -> Result<T> {
    let mut all = all.into_iter();
    let known = all.clone();
    all.find(|each| name_of(*each) == name).ok_or_else(|| unknown(what, name, known.map(name_of)))
}

/// Creates an [`Error::Range`].
pub fn out_of_range(name: impl Into<String>, value: f64, want: impl Into<String>) -> Error {
    Error::Range { name: name.into(), value, want: want.into() }
}

/// # Errors
/// [`Error::Shape`] unless `got == want`.
pub fn check_length(what: &'static str, want: usize, got: usize) -> Result<()> {
    if want == got {
        Ok(())
    } else {
        Err(Error::Shape { what, want: format!("{want} numbers"), got: got.to_string() })
    }
}

/// The value, where it is within `low..=high`.
///
/// # Errors
/// [`Error::Range`] elsewhere.
pub fn check_range(name: &str, value: f64, low: f64, high: f64) -> Result<f64> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(out_of_range(name, value, format!("{low} to {high}")))
    }
}

/// The problem with JSON. A wrong value is named without its place in the text, because mostly a program wrote the text.
pub fn json_problem(error: &serde_json::Error) -> String {
    let text = error.to_string();
    match text.rsplit_once(" at line ") {
        Some((problem, _)) if error.is_data() => problem.into(),
        _ => text,
    }
}
