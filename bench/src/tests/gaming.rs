//! Ways to a better rank than one's controller deserves, and what becomes of them.

use crazyflie_env::action::ACTION;

use super::super::leaderboard::RANKED_FROM;
use super::super::{EntryName, Error, LeaderboardRow, NewestRow, Submitter};
use super::*;

/// Flies one attempt that does nothing until the last flight is over; its score is luck for the most part.
fn hold_still<'a>(bench: &Bench, token: &str, entry: impl Into<EntryName<'a>>) -> Result<f64> {
    let mut attempt = bench.begin("hover-aruco", Submitter::Token(token), entry)?;
    let (n, mut buffers) = (attempt.rows()?, Buffers::new(&attempt));
    while !buffers.step(&mut attempt, &[0.0, 0.0, 0.0, 0.312].repeat(n))? {}
    Ok(attempt.finish()?.result.map_or(0.0, |result| result.score.score))
}

fn another(controller: &str) -> EntryName<'_> {
    EntryName { controller, is_new: true }
}

fn board(bench: &Bench) -> Vec<LeaderboardRow> {
    bench.leaderboard(bench.scenario("hover-aruco").unwrap()).unwrap()
}

fn open_with(test: &'static str, limits: TeamLimits) -> Bench {
    Bench::open_with(&path(test), TeamLimits { attempts_per_minute: 1000, ..limits }).unwrap()
}

#[test]
fn a_team_has_one_rank_whatever_its_names_and_it_takes_attempts() {
    let bench = open_with("renaming", TeamLimits { entries_per_day: 28, ..TeamLimits::default() });
    let (blue, red) = (bench.create_token("blue").unwrap(), bench.create_token("red").unwrap());
    let honest: Vec<f64> = (0..RANKED_FROM).map(|_| hold_still(&bench, &red, "steady").unwrap()).collect();
    for i in 0..6 {
        hold_still(&bench, &blue, another(&format!("lucky {i}"))).unwrap();
    }
    let rows = board(&bench);
    let names: Vec<_> =
        rows.iter().map(|row| (row.team.as_str(), row.controller.as_str(), row.rank)).collect();
    assert_eq!(names, [("red", "steady", Some(1)), ("blue", "lucky 5", None)]);
    let former: Vec<_> = rows[1].former.iter().map(|entry| entry.controller.as_str()).collect();
    assert_eq!(former, ["lucky 4", "lucky 3", "lucky 2", "lucky 1", "lucky 0"]);
    // back to the best of the names: with all its attempts, and not by surprise
    let error = hold_still(&bench, &blue, "lucky 2").unwrap_err();
    assert!(error.code() == "other_entry" && error.status() == 409, "{error}");
    assert!(
        error.to_string().contains("\"lucky 5\"") && error.to_string().contains("--new-entry"),
        "{error}"
    );
    hold_still(&bench, &blue, another("lucky 2")).unwrap();
    for _ in 2..RANKED_FROM {
        hold_still(&bench, &blue, "lucky 2").unwrap();
    }
    let rows = board(&bench);
    assert!(rows.iter().all(|row| row.rank.is_some() && row.attempts == RANKED_FROM), "{rows:?}");
    let blue = rows.iter().find(|row| row.team == "blue").unwrap();
    assert_eq!((blue.controller.as_str(), blue.former.len()), ("lucky 2", 5));
    // the row stands for all attempts: the middle one
    let mut sorted = honest;
    sorted.sort_by(f64::total_cmp);
    let red = rows.iter().find(|row| row.team == "red").unwrap();
    assert_eq!(red.score.score, sorted[(RANKED_FROM - 1) / 2]);
}

#[test]
fn names_and_attempts_of_a_day_are_limited() {
    let limits = TeamLimits { entries_per_day: 2, attempts_per_day: 4, ..TeamLimits::default() };
    let bench = open_with("daily", limits);
    let blue = bench.create_token("blue").unwrap();
    let begin = |name: &str| bench.begin("wind", Submitter::Token(&blue), another(name)).map(drop);
    begin("one").unwrap();
    begin("two").unwrap();
    let error = begin("three").unwrap_err();
    assert_eq!((error.code(), error.status()), ("too_many_entries", 429));
    assert!((86_000..=86_400).contains(&error.retry_after_s().unwrap()), "{error}");
    begin("two").unwrap();
    begin("two").unwrap();
    assert_eq!(begin("two").unwrap_err().code(), "too_many_attempts");
    // dates of a clock that was set back since do not count, nor those that one sees after it was set forward
    let day_ms = 24 * 60 * 60 * 1000;
    for jump_ms in [day_ms, -day_ms] {
        let file = rusqlite::Connection::open(path("daily")).unwrap();
        file.execute("UPDATE attempts SET begun_ms = ?1", [super::super::now_ms() + jump_ms]).unwrap();
        bench.admit("blue", bench.scenario("wind").unwrap(), &another("three")).map(drop).unwrap();
    }
    // another scenario is another day's work
    bench.begin("steps", Submitter::Token(&blue), "one").map(drop).unwrap();
    // the command line beside the database may compare as many as it likes
    for i in 0..6 {
        bench.begin("wind", Submitter::Local, format!("mine {i}").as_str()).map(drop).unwrap();
    }
}

#[test]
fn no_reward_tells_where_the_vehicle_is() {
    let bench = open("rewards");
    let mut attempt = bench.begin("hover-aruco", Submitter::Local, "x").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    buffers.rewards.fill(f32::NAN);
    for _ in 0..20 {
        buffers.step(&mut attempt, &vec![0.0; n * ACTION]).unwrap();
        assert!(buffers.rewards.iter().all(|reward| *reward == 0.0));
    }
}

#[test]
fn a_revoked_token_ends_its_attempt() {
    let bench = open("revoked");
    let token = bench.create_token("blue").unwrap();
    let mut attempt = bench.begin("hover-aruco", Submitter::Token(&token), "x").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    let still = [0.0, 0.0, 0.0, 0.312].repeat(n);
    buffers.step(&mut attempt, &still).unwrap();
    // by another process, as the command line does it
    open("revoked").revoke_tokens("blue").unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1100));
    assert!(matches!(buffers.step(&mut attempt, &still), Err(Error::Token)));
    assert!(matches!(buffers.step(&mut attempt, &still), Err(Error::Over)));
    assert!(matches!(attempt.finish(), Err(Error::Over)));
    let statuses: Vec<_> = bench
        .attempts(None)
        .unwrap()
        .into_iter()
        .map(|entry| entry.document.unwrap().status.name())
        .collect();
    assert_eq!(statuses, ["abandoned"]);
}

#[test]
fn what_cannot_be_stored_can_be_stored_later() {
    let bench = open("full");
    let mut attempt = bench.begin("hover-aruco", Submitter::Local, "x").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    while !buffers.step(&mut attempt, &[0.0, 0.0, 0.0, 0.312].repeat(n)).unwrap() {}
    let disk = rusqlite::Connection::open(path("full")).unwrap();
    disk.execute_batch(
        "CREATE TRIGGER full BEFORE UPDATE ON attempts BEGIN SELECT RAISE(ABORT, 'database or disk is full'); END",
    )
    .unwrap();
    let error = attempt.finish().unwrap_err();
    assert!(error.status() == 500 && error.to_string().contains("disk is full"), "{error}");
    assert!(!error.for_clients().to_string().contains("disk"), "strangers hear no words of the database");
    assert!(!attempt.is_closed());
    disk.execute_batch("DROP TRIGGER full").unwrap();
    let document = attempt.finish().unwrap();
    assert!(attempt.is_closed() && document.result.is_some());
    drop(attempt);
    assert_eq!(bench.verify(&document.id).unwrap().verdict, super::super::Verdict::Confirmed);
}

#[test]
fn rows_that_are_cut_off_at_the_end_are_missed_by_who_noted_the_newest() {
    let bench = open("newest");
    assert_eq!(bench.newest().unwrap(), None);
    submit(&bench, "hover-aruco", "hover");
    let noted = bench.newest().unwrap().unwrap();
    let _running = bench.begin("wind", Submitter::Local, "x").unwrap();
    assert_eq!(bench.newest().unwrap().unwrap(), noted, "an attempt under way may still change");
    let text = format!("{}:{}", noted.number, noted.sha256);
    assert_eq!(text.parse::<NewestRow>().unwrap(), noted);
    assert!(bench.has_row(&noted).unwrap());
    let file = rusqlite::Connection::open(path("newest")).unwrap();
    file.execute("DELETE FROM attempts WHERE number = ?1", [noted.number]).unwrap();
    // even with the counter set back, which hides the gap
    file.execute("UPDATE sqlite_sequence SET seq = 0", []).unwrap();
    assert!(!bench.has_row(&noted).unwrap());
}

#[cfg(unix)]
#[test]
fn an_archive_that_cannot_be_written_can_be_verified() {
    use std::os::unix::fs::PermissionsExt;
    let bench = open("archive");
    let id = submit(&bench, "hover-aruco", "hover");
    drop(bench);
    let (file, archive) = (path("archive"), path("archive").with_file_name("archive.sqlite"));
    std::fs::copy(&file, &archive).unwrap();
    std::fs::set_permissions(&archive, std::fs::Permissions::from_mode(0o400)).unwrap();
    let before = std::fs::read(&archive).unwrap();
    let bench = Bench::open_existing(&archive).unwrap();
    assert_eq!(bench.verify(&id).unwrap().verdict, super::super::Verdict::Confirmed);
    assert!(bench.begin("wind", Submitter::Local, "x").is_err());
    drop(bench);
    assert_eq!(std::fs::read(&archive).unwrap(), before);
    assert!(!archive.with_extension("sqlite-wal").exists() && !archive.with_extension("sqlite-shm").exists());
}
