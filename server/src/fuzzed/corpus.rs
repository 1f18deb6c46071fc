//! A target on what is kept for it and on damaged copies of that, without a fuzzer.

use std::path::PathBuf;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

#[path = "../../../logs/tests/common/damage.rs"]
mod damages;

use damages::Damage;

const CASES: u32 = 2000;

/// The files of a target, in the order of their names, those of folders in it included.
fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let mut folders =
        vec![PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus")).join(target)];
    let mut paths = Vec::new();
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let (inner, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
        folders.extend(inner);
        paths.extend(files);
    }
    paths.sort();
    paths.into_iter().map(|path| (path.clone(), std::fs::read(path).unwrap())).collect()
}

/// Damage to bytes, and pieces of text that mean something somewhere.
fn damage() -> impl Strategy<Value = Damage> {
    let tokens = [
        "NaN", "-inf", "1e999", "-1", "0", "1e-320", "\"", "[", "{", "]", "}", ",", ":", "=", "\n", "null",
        "\u{feff}", "true",
    ];
    let piece = (any::<u32>(), prop::sample::select(tokens.to_vec()));
    prop_oneof![damages::damage(), piece.prop_map(|(at, piece)| Damage::Insert(at as usize, piece.into()))]
}

/// The target accepts a part of its corpus, and survives the rest and damaged copies.
pub fn check(name: &str, target: fn(&[u8]) -> bool) {
    let files = corpus(name);
    assert!(files.len() >= 3, "only {} files for {name}", files.len());
    let accepted = files.iter().filter(|(path, bytes)| {
        println!("{}", path.display());
        target(bytes)
    });
    assert!(accepted.count() >= 1, "{name} accepts nothing of its corpus");
    let cases = (0..files.len(), prop::collection::vec(damage(), 1..4));
    let mut runner = TestRunner::new(ProptestConfig {
        cases: CASES,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    let run = runner.run(&cases, |(which, damages)| {
        let mut bytes = files[which].1.clone();
        damages.iter().for_each(|damage| damage.apply(&mut bytes));
        target(&bytes);
        Ok(())
    });
    run.unwrap_or_else(|e| panic!("{name}: {e}"));
    println!("{name}: {} kept inputs, {CASES} damaged ones", files.len());
}
