//! A submission that was acknowledged is there, whatever happens to the process.

use std::collections::HashSet;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use crate::common::{BINARY, folder, json, text};
use rusqlite::Connection;

const KILLS: u32 = 100;

/// A number in 0..1 that differs from kill to kill and is the same in every run of the test.
fn spread(i: u32) -> f64 {
    (f64::from(i) * 0.618_033_988_75).fract()
}

/// Submits without end; is killed `after` its start or, where `acknowledges`, after its first row is
/// acknowledged: a busy machine may need long for that. Returns the ids that it printed before.
fn submit_and_kill(data: &str, after: Duration, acknowledges: bool) -> Vec<String> {
    let args = [
        "bench",
        "submit",
        "--controller",
        "hover",
        "--scenario",
        "ground-landing",
        "--repeat",
        "1000000",
        "--json",
        "--data",
        data,
    ];
    let mut child = Command::new(BINARY).args(args).stdout(Stdio::piped()).spawn().unwrap();
    let out = BufReader::new(child.stdout.take().unwrap());
    let (ids, printed) = mpsc::channel();
    let reader = std::thread::spawn(move || {
        for line in out.lines().map_while(Result::ok) {
            if let Ok(row) = serde_json::from_str::<serde_json::Value>(&line) {
                ids.send(row["id"].as_str().unwrap().to_owned()).unwrap();
            }
        }
    });
    let first = acknowledges.then(|| printed.recv_timeout(crate::net::PATIENCE).expect("a row"));
    std::thread::sleep(after);
    // SIGKILL
    child.kill().unwrap();
    child.wait().unwrap();
    reader.join().unwrap();
    first.into_iter().chain(printed.try_iter()).collect()
}

#[test]
fn no_acknowledged_row_is_lost_in_a_hundred_kills() {
    let (folder, begun) = (folder("kills"), Instant::now());
    let data = folder.join("bench.sqlite");
    let mut acknowledged = HashSet::new();
    let mut damaged = Vec::new();
    for i in 0..KILLS {
        let after = Duration::from_secs_f64(0.02 + 0.2 * spread(i));
        acknowledged.extend(submit_and_kill(text(&data), after, i % 2 == 1));
        let db = Connection::open(&data).unwrap();
        let check: String = db.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
        if check != "ok" {
            damaged.push(check);
        }
    }
    assert!(damaged.is_empty(), "{damaged:?}");
    let db = Connection::open(&data).unwrap();
    let ids = |status: &str| -> HashSet<String> {
        let mut query = db.prepare("SELECT id FROM attempts WHERE status = ?1").unwrap();
        query.query_map([status], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    let (finished, running) = (ids("finished"), ids("running"));
    let lost: Vec<&String> = acknowledged.difference(&finished).collect();
    assert!(lost.is_empty(), "{} of {} acknowledged rows are lost: {lost:?}", lost.len(), acknowledged.len());
    assert!(acknowledged.len() >= KILLS as usize / 2, "only {} rows", acknowledged.len());
    assert!(!running.is_empty(), "no kill came in the middle of an attempt");
    // a kill may come between the commit and the word about it, at most once each
    assert!(finished.len() - acknowledged.len() <= KILLS as usize);
    // all stored attempts are whole, and none is missing
    let verified = json(&["bench", "verify", "--data", text(&data), "--json"]);
    assert_eq!(verified["missing"].as_array().unwrap().len(), 0);
    let confirmed =
        verified["attempts"].as_array().unwrap().iter().filter(|v| v["verdict"] == "confirmed").count();
    assert_eq!(confirmed, finished.len());
    println!(
        "{KILLS} kills: {} rows acknowledged, {} finished, {} cut short, 0 lost, integrity ok, {:.0} s",
        acknowledged.len(),
        finished.len(),
        running.len(),
        begun.elapsed().as_secs_f64()
    );
}
