//! One flipped bit in a stored attempt, anywhere: `verify` finds it.

use rusqlite::{Connection, params};

use super::super::Verdict;
use super::*;

/// Number of bits that are tried of a long column, evenly spread; of a short one all are.
const BITS: usize = 6000;

fn bits(bytes: usize) -> impl Iterator<Item = usize> {
    (0..bytes * 8).step_by((bytes * 8 / BITS).max(1) | 1)
}

fn flip_bit(bytes: &[u8], bit: usize) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[bit / 8] ^= 1 << (bit % 8);
    bytes
}

/// Returns whether every row is verified and none is missing.
fn sound(bench: &Bench) -> bool {
    let (all, missing) = bench.verify_all(&|_, _| ()).unwrap();
    missing.is_empty() && all.iter().all(|v| v.verdict != Verdict::Wrong)
}

#[test]
fn a_flipped_bit_anywhere_is_found() {
    let bench = open("flipped");
    submit(&bench, "ground-landing", "thesis-pid");
    let db = Connection::open(path("flipped")).unwrap();
    // only this test's own writes, which need not survive a power cut
    db.pragma_update(None, "synchronous", "OFF").unwrap();
    assert!(sound(&bench));
    let mut tried = Vec::new();
    for column in ["id", "scenario", "team", "controller", "status", "document", "signature", "actions"] {
        let value: Vec<u8> = db
            .query_row(&format!("SELECT CAST({column} AS BLOB) FROM attempts"), [], |row| row.get(0))
            .unwrap();
        let cast = if matches!(column, "signature" | "actions") { "?1" } else { "CAST(?1 AS TEXT)" };
        let set = |bytes: &[u8]| {
            db.execute(&format!("UPDATE attempts SET {column} = {cast}"), params![bytes]).unwrap()
        };
        for bit in bits(value.len()) {
            set(&flip_bit(&value, bit));
            assert!(!sound(&bench), "bit {bit} of {column}");
        }
        set(&value);
        tried.push(format!("{} of {} bits of {column}", bits(value.len()).count(), value.len() * 8));
    }
    for column in ["number", "begun_ms"] {
        let value: i64 =
            db.query_row(&format!("SELECT {column} FROM attempts"), [], |row| row.get(0)).unwrap();
        let set = |value: i64| db.execute(&format!("UPDATE attempts SET {column} = ?1"), [value]).unwrap();
        for bit in 0..64 {
            set(value ^ (1 << bit));
            assert!(!sound(&bench), "bit {bit} of {column}");
        }
        set(value);
        tried.push(format!("64 of 64 bits of {column}"));
    }
    assert!(sound(&bench));
    println!("found every one: {}", tried.join(", "));
}

#[test]
fn flipped_keys_rows_that_are_gone_and_swapped_flights_are_found() {
    let bench = open("gone");
    let ids: Vec<String> = (0..3).map(|_| submit(&bench, "ground-landing", "thesis-pid")).collect();
    drop(bench);
    let db = Connection::open(path("gone")).unwrap();
    for name in ["signing key", "seed secret"] {
        let value: Vec<u8> =
            db.query_row("SELECT value FROM secrets WHERE name = ?1", [name], |row| row.get(0)).unwrap();
        let set = |bytes: &[u8]| {
            db.execute("UPDATE secrets SET value = ?2 WHERE name = ?1", params![name, bytes]).unwrap()
        };
        for bit in [0, 77, 128, 255] {
            set(&flip_bit(&value, bit));
            assert!(!sound(&open("gone")), "bit {bit} of the {name}");
        }
        set(&value);
    }
    let bench = open("gone");
    assert!(sound(&bench));
    // two flights change places, each with its own signed document
    let actions = |id: &str| bench.store().actions(id).unwrap().unwrap();
    for (id, others) in [(&ids[0], actions(&ids[1])), (&ids[1], actions(&ids[0]))] {
        db.execute("UPDATE attempts SET actions = ?2 WHERE id = ?1", params![id, others]).unwrap();
    }
    assert!(ids[..2].iter().all(|id| bench.verify(id).unwrap().verdict == Verdict::Wrong));
    assert_eq!(bench.verify(&ids[2]).unwrap().verdict, Verdict::Confirmed);
    db.execute("DELETE FROM attempts WHERE number > 1", []).unwrap();
    assert_eq!(bench.verify_all(&|_, _| ()).unwrap().1, [2, 3]);
}
