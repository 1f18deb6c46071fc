//! Drives the real binary.
#![allow(dead_code, reason = "each test file uses its part")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

pub const BINARY: &str = env!("CARGO_BIN_EXE_crazyflie");

pub struct Ran {
    pub code: i32,
    pub out: String,
    pub err: String,
}

/// Runs the binary to its end.
pub fn run(args: &[&str]) -> Ran {
    let Output { status, stdout, stderr } = Command::new(BINARY).args(args).stdin(Stdio::null()).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ran { code: status.code().expect("no signal"), out: text(stdout), err: text(stderr) }
}

/// Runs the binary, which must succeed, and returns its output.
pub fn good(args: &[&str]) -> String {
    let ran = run(args);
    assert_eq!(ran.code, 0, "{args:?}: {}", ran.err);
    ran.out
}

/// Runs the binary, which must end with this code and say all of these words on stderr, without a panic.
pub fn bad(code: i32, args: &[&str], words: &[&str]) {
    let ran = run(args);
    assert_eq!(ran.code, code, "{args:?}: {}{}", ran.out, ran.err);
    assert!(!ran.err.contains("panicked"), "{args:?}: {}", ran.err);
    for word in words {
        assert!(ran.err.contains(word), "{args:?} does not say {word:?}:\n{}", ran.err);
    }
}

pub fn json(args: &[&str]) -> serde_json::Value {
    serde_json::from_str(&good(args)).unwrap()
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

/// Recordings that stand beside the project, where there are some. Says loudly when a test is left out.
pub fn shared(test: &str, part: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(part);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED {test}: no recordings in {}", folder.display());
    None
}
