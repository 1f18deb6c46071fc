//! Helpers of the tests on recorded data.

use std::io::Write;
use std::path::PathBuf;

/// The folder of recorded flights beside the project, or `None` and a loud line where it is absent.
pub fn data(test: &str, folder: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(folder);
    if path.is_dir() {
        return Some(path);
    }
    // Straight to the terminal: the test harness hides what `eprintln!` prints in a test that passes.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {} not found", path.display());
    None
}
