//! Attempts from beginning to end, and what is kept of those that have none.

use crazyflie_env::action::ACTION;
use crazyflie_env::observation::OBSERVATION;

use super::super::record::{AttemptRow, Status};
use super::super::store::AttemptFilter;
use super::super::{AttemptPage, Document, Error, Submitter, Verdict, api, now_ms};
use super::*;

/// Actions under which some flights end early: full thrust and a tilt for some, calm for the others.
fn uneven(n: usize, tick: usize) -> Vec<f32> {
    (0..n)
        .flat_map(
            |i| if i % 3 == 0 { [0.4, (tick % 7) as f32 * 0.1, 0.0, 1.0] } else { [0.0, 0.0, 0.0, 0.312] },
        )
        .collect()
}

#[test]
fn an_attempt_that_begins_or_ends_is_a_new_revision_and_reading_is_none() {
    let bench = open("revision");
    let empty = bench.revision().unwrap();
    let attempt = bench.begin("hover-aruco", Submitter::Local, "x").unwrap();
    let begun = bench.revision().unwrap();
    bench.attempts(None).unwrap();
    assert_eq!(bench.revision().unwrap(), begun);
    drop(attempt);
    let over = bench.revision().unwrap();
    assert!(empty != begun && begun != over && over != empty, "{empty:?} {begun:?} {over:?}");
}

#[test]
fn flights_that_are_over_hold_still_and_come_out_the_same_again() {
    let bench = open("uneven");
    let mut attempt = bench.begin("hover-aruco", Submitter::Local, "uneven").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    let (mut tick, mut ended) = (0, vec![None; n]);
    loop {
        let mut actions = uneven(n, tick);
        // actions of ended flights are not read, not even if they are NaN
        ended
            .iter()
            .enumerate()
            .filter(|(_, e): &(usize, &Option<Vec<f32>>)| e.is_some())
            .for_each(|(i, _)| actions[i * ACTION] = f32::NAN);
        let over = buffers.step(&mut attempt, &actions).unwrap();
        tick += 1;
        for (i, ended) in ended.iter_mut().enumerate() {
            let row = &buffers.observations[i * OBSERVATION..(i + 1) * OBSERVATION];
            match ended {
                Some(last) => {
                    assert_eq!(row, last);
                    assert!(buffers.rewards[i] == 0.0 && (buffers.terminated[i] || buffers.truncated[i]));
                }
                None if buffers.terminated[i] || buffers.truncated[i] => *ended = Some(row.to_vec()),
                None => {}
            }
        }
        if over {
            break;
        }
    }
    assert!(matches!(buffers.step(&mut attempt, &vec![0.0; n * ACTION]), Err(Error::Over)));
    let document = attempt.finish().unwrap();
    let result = document.result.unwrap();
    let early = result.episodes.iter().filter(|e| e.metrics.duration_s < 14.9).count();
    assert!(early >= n / 3 && early < n && result.score.failed >= early, "{early} of {n} ended early");
    assert_eq!(result.ticks, tick);
    assert_eq!(bench.verify(&document.id).unwrap().verdict, Verdict::Confirmed);
    // alone, each flight is bit by bit what it was among the others
    (0..n).for_each(|episode| drop(bench.replay(&document.id, episode).unwrap()));
}

/// A server hands attempts from thread to thread.
#[test]
fn a_benchmark_is_shared_and_an_attempt_moves_between_threads() {
    let bench = open("threads");
    let fly = |baseline: &'static str| {
        let bench = bench.clone();
        move || submit(&bench, "ground-landing", baseline)
    };
    let threads = ["thesis-pid", "hover", "random"].map(|baseline| std::thread::spawn(fly(baseline)));
    let attempt = bench.begin("wind", Submitter::Local, "moved").unwrap();
    std::thread::spawn(move || drop(attempt)).join().unwrap();
    let ids = threads.map(|thread| thread.join().unwrap());
    assert!(ids.iter().all(|id| bench.verify(id).unwrap().verdict == Verdict::Confirmed));
    assert_eq!(bench.attempts(None).unwrap().len(), 4);
}

#[test]
fn bad_steps_are_refused_before_anything_moves() {
    let bench = open("bad_steps");
    let mut attempt = bench.begin("wind", Submitter::Local, "clumsy").unwrap();
    let (n, mut buffers) = (attempt.rows().unwrap(), Buffers::new(&attempt));
    let first = attempt.observations().unwrap().to_vec();
    for value in [f32::NAN, f32::INFINITY, 1.5] {
        let mut actions = vec![0.0; n * ACTION];
        actions[5] = value;
        let error = buffers.step(&mut attempt, &actions).unwrap_err();
        assert!(error.code() == "bad_action" && error.to_string().contains("actions[1][1]"), "{error}");
    }
    assert_eq!(buffers.step(&mut attempt, &[0.0; 3]).unwrap_err().code(), "bad_shape");
    buffers.rewards.pop();
    assert_eq!(buffers.step(&mut attempt, &vec![0.0; n * ACTION]).unwrap_err().code(), "bad_shape");
    assert_eq!(attempt.observations().unwrap(), first);
    let error = attempt.finish().unwrap_err();
    assert_eq!(error.code(), "attempt_under_way");
}

#[test]
fn who_goes_away_stays_listed_and_counts() {
    let bench = open("abandoned");
    let attempt = bench.begin("wind", Submitter::Local, "thesis-pid").unwrap();
    let id = attempt.id().to_owned();
    assert_eq!(bench.attempt(&id).unwrap().document.unwrap().status, Status::Running);
    drop(attempt);
    assert_eq!(bench.attempt(&id).unwrap().document.unwrap().status, Status::Abandoned);
    assert_eq!(bench.verify(&id).unwrap().verdict, Verdict::Unfinished);
    assert!(matches!(bench.replay(&id, 0), Err(Error::Unfinished { .. })));
    let scenario = bench.scenario("wind").unwrap();
    submit(&bench, "wind", "thesis-pid");
    let row = bench.leaderboard(scenario).unwrap().remove(0);
    assert_eq!((row.attempts, row.abandoned, row.score.score), (2, 1, 0.0));
    submit(&bench, "wind", "thesis-pid");
    let row = bench.leaderboard(scenario).unwrap().remove(0);
    assert!(row.attempts == 3 && row.score.score > 20.0, "{row:?}");
}

#[test]
fn the_leaderboard_takes_the_middle_attempt_not_the_luckiest() {
    let bench = open("middle");
    (0..5).for_each(|_| drop(submit(&bench, "packet-loss", "thesis-pid")));
    submit(&bench, "packet-loss", "hover");
    let scenario = bench.scenario("packet-loss").unwrap();
    let board = bench.leaderboard(scenario).unwrap();
    let thesis =
        bench.attempts(Some(&scenario.id())).unwrap().into_iter().map(|listed| listed.document.unwrap());
    let mut scores: Vec<f64> = thesis
        .filter(|d| d.controller == "thesis-pid")
        .map(|document| document.result.unwrap().score.score)
        .collect();
    scores.sort_by(f64::total_cmp);
    assert!(scores[2] < scores[4], "{scores:?}");
    assert_eq!(
        (board[0].controller.as_str(), board[0].score.score, board[0].rank),
        ("thesis-pid", scores[2], Some(1))
    );
    assert_eq!((board[1].controller.as_str(), board[1].rank), ("hover", Some(2)));
}

/// Puts a document in place of the stored one, signed by the server's own key.
fn resign(bench: &Bench, change: impl Fn(&mut Document)) -> AttemptRow {
    let row = bench.store().attempts(AttemptFilter::default()).unwrap().remove(0);
    let mut document = row.document(&bench.0.secrets).unwrap();
    change(&mut document);
    document.to_row(&bench.0.secrets).unwrap()
}

#[test]
fn an_attempt_of_another_build_is_told_from_a_wrong_one() {
    let bench = open("other_build");
    submit(&bench, "wind", "thesis-pid");
    let worse = |document: &mut Document| {
        document.result.as_mut().unwrap().episodes[3].states_sha256 = "0".repeat(64)
    };
    let other = |document: &mut Document| document.build = "another".into();
    let verdict = |row: &AttemptRow| bench.verify_row(row).unwrap();
    assert_eq!(verdict(&resign(&bench, |_| {})).verdict, Verdict::Confirmed);
    assert_eq!(verdict(&resign(&bench, other)).verdict, Verdict::Confirmed);
    let both = verdict(&resign(&bench, |d| (worse(d), other(d)).0));
    assert!(both.verdict == Verdict::OtherBuild && both.findings[0].contains("another"), "{both:?}");
    let wrong = verdict(&resign(&bench, worse));
    assert!(
        wrong.verdict == Verdict::Wrong && wrong.findings == ["episode 3: the states differ"],
        "{wrong:?}"
    );
    let better = verdict(&resign(&bench, |d| d.result.as_mut().unwrap().score.score += 1e-6));
    assert!(better.verdict == Verdict::Wrong && better.findings[0].contains("the score is"), "{better:?}");
    let gone = verdict(&resign(&bench, |d| d.scenario_hash = "0".repeat(64)));
    assert_eq!(gone.verdict, Verdict::OtherBuild);
}

#[test]
fn what_a_crash_left_behind_is_abandoned_when_its_time_is_over() {
    let bench = open("stale");
    let attempt = bench.begin("wind", Submitter::Local, "slow").unwrap();
    let id = attempt.id().to_owned();
    std::mem::forget(attempt);
    bench.sweep().unwrap();
    assert_eq!(bench.attempt(&id).unwrap().document.unwrap().status, Status::Running);
    // the same row, begun an hour ago
    let old = resign(&bench, |document| document.begun_ms = now_ms() - 3_600_000);
    let db = rusqlite::Connection::open(path("stale")).unwrap();
    let document = std::str::from_utf8(&old.document).unwrap();
    db.execute(
        "UPDATE attempts SET begun_ms = ?1, document = ?2, signature = ?3",
        rusqlite::params![old.begun_ms, document, old.signature],
    )
    .unwrap();
    let again = open("stale");
    assert_eq!(again.attempt(&id).unwrap().document.unwrap().status, Status::Abandoned);
    assert_eq!(again.verify(&id).unwrap().verdict, Verdict::Unfinished);
}

#[test]
fn attempts_are_listed_in_pages() {
    let bench = open("pages");
    for number in 0..7 {
        let scenario = if number % 3 == 2 { "takeoff" } else { "wind" };
        drop(bench.begin(scenario, Submitter::Local, "left").unwrap());
    }
    let page = |scenario, after, limit| {
        let body = api::attempts(&bench, scenario, AttemptPage { after, limit }).unwrap().bytes;
        let rows: Vec<serde_json::Value> = serde_json::from_slice(&body).unwrap();
        rows.iter().map(|row| row["number"].as_i64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(page(None, 0, 3), [1, 2, 3]);
    assert_eq!(page(None, 3, 3), [4, 5, 6]);
    assert_eq!(page(None, 6, 3), [7]);
    assert_eq!(page(Some("takeoff"), 3, 3), [6]);
    assert_eq!(page(None, 0, i64::MAX).len(), 7);
}
