//! A scenario file, and the condition that one which is read must meet: it can be flown.

use super::scenario::Scenario;
use super::secrets::Secrets;

#[cfg(test)]
#[path = "../../server/src/fuzzed/corpus.rs"]
mod corpus;
#[path = "../../server/src/fuzzed/flown.rs"]
mod flown;

/// Reads a scenario file and flies it; whether it was accepted.
///
/// # Panics
/// For what the target finds.
pub fn scenario(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let scenario = Scenario::read("fuzzed.toml", text, &Secrets::new(&[1; 32], [2; 32]));
    let scenario = scenario.map_err(|error| assert!(error.to_string().contains("fuzzed.toml"), "{error}"));
    // the fuzzer looks for scenarios that are read and cannot be flown; all their episodes may be more
    // than fit into memory
    scenario.map(|scenario| flown::fly_env(scenario.env(2).expect("one could be made"))).is_ok()
}

#[test]
fn it_bears_its_corpus_and_damaged_copies_of_it() {
    corpus::check("scenario", scenario);
}
