//! A season on the command line, from its beginning to its verified archive.

use std::fs;

use crate::common::{assert_fails, folder, json, stdout_of, text};

#[test]
fn a_season_from_its_beginning_to_its_archive() {
    let folder = folder("season");
    let (data, archive) = (folder.join("bench.sqlite"), folder.join("spring.jsonl"));
    let (data, archive) = (text(&data), text(&archive));
    let scenarios = ["--scenarios", "hover-aruco", "--levels", "0,1,3"];
    let new = [&["bench", "season", "new", "spring", "--data", data, "--json"][..], &scenarios].concat();
    let begun = json(&new);
    assert_eq!(begun["scenarios"].as_array().unwrap().len(), 3, "{begun}");
    assert_eq!(begun["secret_sha256"].as_str().unwrap().len(), 64);
    assert!(begun.get("secret").is_none(), "{begun}");
    for id in ["hover-aruco.0", "hover-aruco"] {
        json(&["bench", "submit", "--controller", "hover", "--scenario", id, "--data", data, "--json"]);
    }
    assert!(stdout_of(&["bench", "season", "list", "--data", data]).contains("spring"));
    assert_fails(1, &["bench", "season", "close", "autumn", "--out", archive, "--data", data], &["autumn"]);
    let closed = json(&["bench", "season", "close", "spring", "--out", archive, "--data", data, "--json"]);
    assert_eq!(closed["attempts"], 2, "{closed}");
    let verified = json(&["bench", "season", "verify", archive, "--json"]);
    let verdicts: Vec<_> =
        verified["attempts"].as_array().unwrap().iter().map(|row| row["verdict"].clone()).collect();
    assert_eq!(verdicts, ["confirmed", "confirmed"], "{verified}");
    let boards = json(&["bench", "season", "list", "spring", "--data", archive, "--json"]);
    assert_eq!(boards["hover-aruco.0@1.0.0"].as_array().unwrap().len(), 1, "{boards}");
    let key = verified["public_key"].as_str().unwrap();
    stdout_of(&["bench", "season", "verify", archive, "--key", key]);
    assert_fails(1, &["bench", "season", "verify", archive, "--key", &"0".repeat(64)], &["another key"]);
    let lines = fs::read_to_string(archive).unwrap();
    let shorter: Vec<&str> = lines.lines().take(2).collect();
    fs::write(archive, shorter.join("\n")).unwrap();
    assert_fails(1, &["bench", "season", "verify", archive], &["missing"]);
}
