//! Drives the real binary.
#![allow(dead_code, reason = "each test file uses its part")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

pub const BINARY: &str = env!("CARGO_BIN_EXE_crazyflie");

pub struct ProgramRun {
    pub code: i32,
    pub out: String,
    pub err: String,
}

/// Runs the binary to its end.
pub fn run(args: &[&str]) -> ProgramRun {
    let Output { status, stdout, stderr } =
        Command::new(BINARY).args(args).stdin(Stdio::null()).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    ProgramRun { code: status.code().expect("no signal"), out: text(stdout), err: text(stderr) }
}

/// Runs the binary, which must succeed, and returns its output.
pub fn stdout_of(args: &[&str]) -> String {
    let program = run(args);
    assert_eq!(program.code, 0, "{args:?}: {}", program.err);
    program.out
}

/// Runs the binary, which must end with this code and print all of these words on stderr, without a panic.
pub fn assert_fails(code: i32, args: &[&str], words: &[&str]) {
    let program = run(args);
    assert_eq!(program.code, code, "{args:?}: {}{}", program.out, program.err);
    assert!(!program.err.contains("panicked"), "{args:?}: {}", program.err);
    for word in words {
        assert!(program.err.contains(word), "{args:?} does not say {word:?}:\n{}", program.err);
    }
}

pub fn json(args: &[&str]) -> serde_json::Value {
    serde_json::from_str(&stdout_of(args)).unwrap()
}

/// A folder of this test's own, empty.
pub fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns recordings beside the project, if there are some. Reports loudly when a test is left out.
pub fn recordings(test: &str, part: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(part);
    if cfg!(feature = "labs") && folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED {test}: no recordings in {}, or none that this build reads", folder.display());
    None
}
