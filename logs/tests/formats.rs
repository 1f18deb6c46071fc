//! The registry: every format has its corpus, and survives damaged copies of it.

#[path = "common/recording.rs"]
mod recording;

use std::path::{Path, PathBuf};

use crazyflie_logs::{FlightLog, readers};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use recording::{check, damage, read};

const CASES: u32 = 300;

fn corpus() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus/flight_log"))
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

#[test]
fn every_format_reads_its_corpus_and_every_corpus_has_a_format() {
    let mut names: Vec<&str> = readers().iter().map(|reader| reader.name).collect();
    for name in &names {
        let files = entries(&corpus().join(name));
        assert!(files.len() >= 3, "only {} files for {name}", files.len());
        let logs = files.iter().filter_map(|file| read(&std::fs::read(file).unwrap()).ok());
        let own: Vec<FlightLog> = logs.filter(|log| log.provenance.format == *name).collect();
        assert!(!own.is_empty(), "{name} reads nothing of its corpus");
        own.iter().for_each(check);
    }
    names.sort_unstable();
    let folders: Vec<String> = entries(&corpus())
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    assert_eq!(folders, names);
}

#[test]
fn damaged_files_of_every_format_give_a_log_or_an_error_that_names_the_file() {
    for reader in readers() {
        let files: Vec<Vec<u8>> =
            entries(&corpus().join(reader.name)).iter().map(|path| std::fs::read(path).unwrap()).collect();
        let cases = (0..files.len(), prop::collection::vec(damage(), 1..4));
        let mut runner = TestRunner::new(ProptestConfig {
            cases: CASES,
            failure_persistence: None,
            ..ProptestConfig::default()
        });
        let run = runner.run(&cases, |(which, damages)| {
            let mut bytes = files[which].clone();
            damages.iter().for_each(|damage| damage.apply(&mut bytes));
            match read(&bytes) {
                Ok(log) => check(&log),
                Err(error) => prop_assert!(error.to_string().contains("log"), "{}", error),
            }
            Ok(())
        });
        run.unwrap_or_else(|error| panic!("{}: {error}", reader.name));
    }
}

#[test]
fn titles_are_words_and_names_are_unique() {
    for (at, reader) in readers().iter().enumerate() {
        assert!(reader.title.starts_with("a"), "{}", reader.title);
        assert!(readers()[..at].iter().all(|other| other.name != reader.name), "{}", reader.name);
    }
}
