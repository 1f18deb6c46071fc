//! The fingerprint of everything that decides an attempt's result: simulator, scenarios, scoring and the
//! versions of all libraries.
//!
//! Sources rather than the binary: the same sources give the same bits on every machine and in every profile,
//! so an attempt can be re-run elsewhere. Also the list of the scenarios: a file in their folder is all that
//! one needs.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use sha2::{Digest, Sha256};

/// Relative to the workspace.
const PARTS: [&str; 9] = [
    "Cargo.lock",
    "bench/scenarios",
    "bench/src",
    "control/Cargo.toml",
    "control/src",
    "env/Cargo.toml",
    "env/models",
    "env/src",
    "server/src/flight",
];

fn main() -> io::Result<()> {
    let bench = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let workspace = bench.join("..");
    list_scenarios(&bench.join("scenarios"))?;
    // a crate of a registry is alone: there the version fixes the sources
    if !workspace.join("Cargo.lock").exists() {
        println!("cargo::rustc-env=CRAZYFLIE_BUILD=release {}", env!("CARGO_PKG_VERSION"));
        return Ok(());
    }
    let mut files = Vec::new();
    for part in PARTS {
        let path = workspace.join(part);
        println!("cargo::rerun-if-changed={}", path.display());
        collect(&path, part, &mut files)?;
    }
    files.sort();
    let mut hash = Sha256::new();
    for (name, path) in files {
        // a checkout may have turned the line ends
        let text: Vec<u8> = fs::read(&path)?.into_iter().filter(|byte| *byte != b'\r').collect();
        hash.update(format!("{name} {}\n", text.len()));
        hash.update(text);
    }
    println!("cargo::rustc-env=CRAZYFLIE_BUILD={}", hex::encode(hash.finalize()));
    Ok(())
}

/// Writes the names and texts of the scenarios as a slice, in the order of their names.
fn list_scenarios(folder: &Path) -> io::Result<()> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|entry| entry.map(|e| e.path())).collect::<io::Result<_>>()?;
    files.sort();
    let entry = |path: &PathBuf| {
        format!("    ({:?}, include_str!({path:?})),\n", path.file_name().unwrap_or_default())
    };
    let list = format!("&[\n{}]\n", files.iter().map(entry).collect::<String>());
    fs::write(PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join("scenarios.rs"), list)
}

/// Files under `path`, but for tests and what talks to a server, with their names relative to the workspace,
/// which are the same on every system.
fn collect(path: &Path, name: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    if !path.is_dir() {
        files.push((name.to_owned(), path.to_owned()));
        return Ok(());
    }
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        if ["tests", "serve"].iter().any(|other| entry.file_name() == *other) {
            continue;
        }
        let name = format!("{name}/{}", entry.file_name().to_string_lossy());
        collect(&entry.path(), &name, files)?;
    }
    Ok(())
}
