//! Databases that are locked, removed or damaged while somebody needs them.

use std::time::{Duration, Instant};

use super::super::{Error, Submitter};
use super::*;

#[test]
fn a_locked_database_lets_nobody_queue_and_tokens_hold() {
    let bench = open("locked");
    let token = bench.create_token("blue").unwrap();
    let mut attempt = bench.begin("wind", Submitter::Token(&token), "x").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    // a backup locks the database against writers
    let backup = rusqlite::Connection::open(path("locked")).unwrap();
    backup.execute_batch("BEGIN IMMEDIATE").unwrap();
    let began = Instant::now();
    let refused = std::thread::scope(|scope| {
        let waiting: Vec<_> = (0..8)
            .map(|_| {
                scope.spawn(|| bench.begin("wind", Submitter::Token(&token), "x").map(drop).unwrap_err())
            })
            .collect();
        waiting.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
    });
    // one waits two seconds for the lock, the others are refused at once: eight waits would be 16
    assert!(began.elapsed() < Duration::from_secs(12), "{:?}", began.elapsed());
    for error in refused {
        let error = error.for_clients();
        assert_eq!((error.code(), error.status(), error.retry_after_s()), ("unavailable", 503, Some(1)));
    }
    // a look at the token is due, while the database rests
    buffers.step(&mut attempt, &[0.0, 0.0, 0.0, 0.3].repeat(n)).unwrap();
    assert!(bench.team(Submitter::Token("cft_0")).is_err());
    backup.execute_batch("ROLLBACK").unwrap();
    drop(backup);
    std::thread::sleep(Duration::from_millis(1100));
    bench.begin("wind", Submitter::Token(&token), "x").map(drop).unwrap();
}

#[cfg(unix)]
#[test]
fn a_file_that_was_removed_takes_no_attempt() {
    for which in ["bench.sqlite", "bench.sqlite-wal"] {
        let bench = open("removed");
        drop(bench.begin("wind", Submitter::Local, "x").unwrap());
        let (file, aside) = (path("removed").with_file_name(which), path("removed").with_file_name("aside"));
        std::fs::rename(&file, &aside).unwrap();
        let error = bench.begin("wind", Submitter::Local, "x").map(drop).unwrap_err();
        assert!(matches!(&error, Error::Gone { path } if *path == file), "{error}");
        // another file in its place is not it
        std::fs::copy(&aside, &file).unwrap();
        assert!(matches!(bench.begin("wind", Submitter::Local, "x"), Err(Error::Gone { .. })));
        std::fs::rename(&aside, &file).unwrap();
        drop(bench.begin("wind", Submitter::Local, "x").unwrap());
    }
}

#[test]
fn a_damaged_log_is_told_before_it_is_cut_off() {
    let bench = open("damaged_log");
    (0..4).for_each(|_| drop(bench.begin("wind", Submitter::Local, "x").unwrap()));
    // a crash leaves the log beside the file
    let log = path("damaged_log").with_file_name("bench.sqlite-wal");
    let folder = path("damaged_log").with_file_name("crashed");
    std::fs::create_dir_all(&folder).unwrap();
    let (file, copy) = (folder.join("bench.sqlite"), folder.join("bench.sqlite-wal"));
    let bytes = std::fs::read(&log).unwrap();
    let open_with = |log: &[u8]| {
        std::fs::copy(path("damaged_log"), &file).unwrap();
        let _ = std::fs::remove_file(folder.join("bench.sqlite-shm"));
        std::fs::write(&copy, log).unwrap();
        Bench::open_existing(&file)
    };
    assert_eq!(open_with(&bytes).unwrap().attempts(None).unwrap().len(), 4);
    let frame = 24 + 4096;
    let mut damaged = bytes.clone();
    damaged[32 + frame + 24 + 100] ^= 1;
    let error = open_with(&damaged).map(drop).unwrap_err();
    assert!(matches!(&error, Error::DamagedLog { frame: 2, path } if *path == copy), "{error}");
    assert_eq!(std::fs::read(&copy).unwrap(), damaged, "nothing is touched");
    // the end of a transaction that was never acknowledged is cut off as ever
    let offset = bytes.len() - 50;
    let mut torn = bytes.clone();
    torn[offset] ^= 1;
    assert_eq!(open_with(&torn).unwrap().attempts(None).unwrap().len(), 4);
    open_with(&bytes[..offset]).unwrap();
}
