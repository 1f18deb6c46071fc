//! The targets without a fuzzer.

use super::{TARGETS, corpus};

#[test]
fn every_target_bears_its_corpus_and_damaged_copies_of_it() {
    for (name, target) in TARGETS {
        corpus::check(name, target);
    }
}

#[test]
fn each_target_is_a_program_of_cargo_fuzz() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz");
    let manifest = std::fs::read_to_string(format!("{folder}/Cargo.toml")).unwrap();
    for (name, _) in TARGETS {
        let program = std::fs::read_to_string(format!("{folder}/fuzz_targets/{name}.rs")).unwrap();
        assert!(
            program.contains(&format!("run(\"{name}\"")) && manifest.contains(&format!("name = \"{name}\"")),
            "{name}"
        );
    }
    // and those of `crazyflie_crtp::fuzzed` and `crazyflie_bench::fuzzed`, which have tests there
    assert_eq!(manifest.matches("[[bin]]").count(), TARGETS.len() + 2);
}
