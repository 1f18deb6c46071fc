//! Seasons: frozen scenarios, a secret that is published at the end, an archive that anybody can verify.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::super::{Error, Submitter, Verdict};
use super::*;

/// A season with an attempt at a scenario as declared, one with a hidden effect, and one that was given up.
fn season(test: &'static str) -> (Bench, [String; 2]) {
    let bench = open(test);
    submit(&bench, "hover-aruco", "hover");
    let ids = ["hover-aruco@1.0.0".to_owned(), "hover-aruco.3@1.0.0".to_owned()];
    let begun = bench.begin_season("spring", &ids, None).unwrap();
    assert!(begun.secret.is_none() && begun.closed_ms.is_none());
    let flown = [submit(&bench, "hover-aruco", "hover"), submit(&bench, "hover-aruco.3", "hover")];
    drop(bench.begin("hover-aruco", Submitter::Local, "gave up").unwrap());
    submit(&bench, "fly-80cm", "hover");
    (bench, flown)
}

fn archive(bench: &Bench) -> String {
    let mut bytes = Vec::new();
    assert_eq!(bench.write_season("spring", &mut bytes).unwrap(), 3);
    String::from_utf8(bytes).unwrap()
}

fn read(test: &'static str, text: &str) -> Result<Bench> {
    let file = path(test).with_file_name("season.jsonl");
    std::fs::write(&file, text).unwrap();
    Bench::open_existing(&file)
}

#[test]
fn a_season_is_verified_from_its_archive_alone() {
    let (bench, flown) = season("season");
    let closed = bench.close_season("spring").unwrap();
    assert!(closed.secret.as_ref().is_some_and(|secret| secret.len() == 64));
    // the season's hidden scenarios are not the server's other ones
    let outside = bench.scenario("hover-aruco.3").unwrap().hash().to_owned();
    assert!(closed.document.scenarios.iter().all(|(_, hash)| *hash != outside));
    let text = archive(&bench);
    let alone = read("season", &text).unwrap();
    let (found, missing) = alone.verify_all(&|_, _| ()).unwrap();
    let verdicts: Vec<_> = found.iter().map(|v| v.verdict).collect();
    assert_eq!(
        (verdicts, missing.len()),
        (vec![Verdict::Confirmed, Verdict::Confirmed, Verdict::Unfinished], 0)
    );
    assert!(flown.iter().all(|id| found.iter().any(|v| v.id == *id)));
    let boards = alone.season_leaderboards("spring").unwrap();
    assert_eq!(boards.iter().map(|(_, rows)| rows.len()).collect::<Vec<_>>(), [2, 1]);
    alone.replay(&flown[1], 3).unwrap();
    assert!(matches!(alone.begin("wind", Submitter::Local, "x").map(drop), Err(Error::Archive)));
    // the server's own file verifies them too
    assert!(bench.verify_all(&|_, _| ()).unwrap().0.iter().all(|v| v.verdict != Verdict::Wrong));
}

#[test]
fn nothing_can_be_taken_away_or_changed() {
    let (bench, _) = season("season_changed");
    bench.close_season("spring").unwrap();
    let text = archive(&bench);
    let lines: Vec<&str> = text.lines().collect();
    let refused = |text: String| {
        let opened = read("season_changed", &text).and_then(|bench| Ok(bench.verify_all(&|_, _| ())?.0));
        match opened {
            Err(Error::Damaged(what)) => what,
            Ok(found) => {
                let wrong = found.iter().find(|v| v.verdict == Verdict::Wrong);
                wrong.map(|v| v.findings.join(";")).unwrap_or_default()
            }
            Err(other) => panic!("{other}"),
        }
    };
    assert!(refused(text.clone()).is_empty());
    for cut in 1..lines.len() {
        let rest: Vec<&str> =
            lines.iter().enumerate().filter(|(at, _)| *at != cut).map(|(_, line)| *line).collect();
        assert!(refused(rest.join("\n")).contains("missing"), "line {cut} was taken away");
    }
    assert!(refused([&lines[..], &lines[1..2]].concat().join("\n")).contains("not listed"));
    for (from, to) in
        [("\"team\\\":\\\"local", "\"team\\\":\\\"other"), ("\\\"secret\\\":\\\"", "\\\"secret\\\":\\\"00")]
    {
        assert!(text.contains(from), "{from}");
        assert!(!refused(text.replacen(from, to, 1)).is_empty(), "{from}");
    }
    // a digit of anything, here and there
    for at in (200..text.len()).step_by(text.len() / 12) {
        let mut bytes = text.clone().into_bytes();
        let Some(at) = (at..text.len()).find(|at| bytes[*at].is_ascii_digit()) else { continue };
        bytes[at] = if bytes[at] == b'7' { b'3' } else { b'7' };
        assert!(!refused(String::from_utf8(bytes).unwrap()).is_empty(), "byte {at}");
    }
}

#[test]
fn seasons_come_one_after_another() {
    let bench = open("season_order");
    let ids = ["wind@1.0.0".to_owned()];
    let begin_season = |name: &str, until| bench.begin_season(name, &ids, until).map(drop);
    assert!(matches!(begin_season("a b", None), Err(Error::Name { .. })));
    assert!(matches!(begin_season("past", Some(1)), Err(Error::Season { .. })));
    assert!(matches!(bench.close_season("one"), Err(Error::Season { .. })));
    begin_season("one", None).unwrap();
    assert!(begin_season("two", None).unwrap_err().to_string().contains("is open"));
    assert!(bench.write_season("one", &mut Vec::new()).unwrap_err().to_string().contains("open"));
    bench.close_season("one").unwrap();
    assert!(begin_season("one", None).unwrap_err().to_string().contains("of this name"));
    begin_season("two", Some(super::super::now_ms() + 3_600_000)).unwrap();
    assert_eq!(
        bench.seasons().unwrap().iter().map(|s| s.closed_ms.is_some()).collect::<Vec<_>>(),
        [true, false]
    );
    assert!(matches!(bench.begin_season("three", &["wnd".into()], None), Err(Error::Season { .. })));
}

#[test]
fn nobody_keeps_a_season_open_by_beginning_attempts() {
    let bench = open("season_held");
    bench.begin_season("one", &["wind@1.0.0".to_owned()], None).unwrap();
    let season = |attempt: &str| bench.attempt(attempt).unwrap().document.unwrap().season;
    let (enough, over) = (AtomicUsize::new(0), AtomicBool::new(false));
    let (running, closed) = std::thread::scope(|scope| {
        let pupils: Vec<_> = (0..3)
            .map(|_| {
                scope.spawn(|| {
                    let mut attempts = Vec::new();
                    while !over.load(Ordering::Relaxed) {
                        attempts.push(bench.begin("wind", Submitter::Local, "x").unwrap());
                        enough.fetch_add(1, Ordering::Relaxed);
                    }
                    attempts
                })
            })
            .collect();
        let wait_for_more = |count| {
            let until = enough.load(Ordering::Relaxed) + count;
            while enough.load(Ordering::Relaxed) < until {
                std::thread::yield_now();
            }
        };
        wait_for_more(3);
        let closed = bench.close_season("one").unwrap();
        wait_for_more(3);
        over.store(true, Ordering::Relaxed);
        (pupils.into_iter().flat_map(|pupil| pupil.join().unwrap()).collect::<Vec<_>>(), closed)
    });
    assert!(closed.closed_ms.is_some());
    let (inside, outside): (Vec<_>, Vec<_>) =
        running.into_iter().partition(|attempt| season(attempt.id()).is_some());
    assert!(inside.len() >= 3 && outside.len() >= 3);
    // numbers are given in the order of the transactions: the season ends at one of them
    let number = |attempt: &Attempt| bench.attempt(attempt.id()).unwrap().number;
    assert!(inside.iter().map(number).max() < outside.iter().map(number).min());
    let now = bench.close_season("one").unwrap();
    assert_eq!((now.under_way, now.closed_ms), (inside.len(), closed.closed_ms));
    // the hidden effects of those that still fly are no secret once it is known
    assert!(now.secret.is_none());
    assert!(bench.write_season("one", &mut Vec::new()).unwrap_err().to_string().contains("under way"));
    drop(inside);
    let now = bench.close_season("one").unwrap();
    assert!(now.under_way == 0 && now.secret.is_some());
    bench.write_season("one", &mut Vec::new()).unwrap();
}
