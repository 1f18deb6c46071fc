//! The bodies of the fuzz targets in `fuzz/`: every parser, and the invariants of its accepted inputs. They are here,
//! where the parsers are, so that nothing has to be public for them; only tests and cargo-fuzz compile them.

#[cfg(test)]
mod corpus;
mod flown;
#[cfg(test)]
mod tests;

use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::VectorEnv;

use flown::fly_env;

/// A name, that of its binary and of the folder of its corpus, and what it does: whether the input was
/// accepted.
pub type Target = (&'static str, fn(&[u8]) -> bool);

/// All of them.
pub const TARGETS: [Target; 7] = [
    ("control_message", crate::serve::fuzzed::control_message),
    ("step_frame", crate::serve::fuzzed::step_frame),
    ("openenv_message", crate::serve::fuzzed::openenv_message),
    ("live_message", crate::serve::fuzzed::live_message),
    ("model", model),
    ("options", options),
    ("flight_log", flight_log),
];

/// Runs a target.
///
/// # Panics
/// For a name that is none, and for what the target finds.
pub fn run(name: &str, bytes: &[u8]) {
    let (_, target) = TARGETS.iter().find(|(known, _)| *known == name).expect("a target of this name");
    target(bytes);
}

#[path = "../../../logs/tests/common/sound.rs"]
mod sound;

/// A log of any format; `logs/tests/hostile.rs` puts each format's corpus to the same test.
fn flight_log(bytes: &[u8]) -> bool {
    let log = sound::read(bytes).map_err(|error| assert!(error.to_string().contains("log"), "{error}"));
    log.map(|log| sound::check(&log)).is_ok()
}

fn model(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(model) = Model::parse(text) else { return false };
    let again =
        Model::parse(&model.to_toml().expect("what was read can be written")).expect("and read again");
    assert_eq!(again.parameters(), model.parameters());
    VectorEnv::new(std::slice::from_ref(&model), &Options::default(), 2).map(fly_env).is_ok()
}

fn options(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let options = Options::parse(text).map_err(|error| assert!(!error.to_string().is_empty()));
    // threads are a machine's to give
    let env =
        options.map(|options| VectorEnv::new(&[Model::thesis()], &Options { threads: 1, ..options }, 2));
    env.is_ok_and(|env| env.map(fly_env).is_ok())
}
