//! Tokens and limits.

use super::super::{Error, Submitter};
use super::*;

fn strict(test: &'static str, attempts_per_minute: u32, at_once: u32) -> Bench {
    Bench::open_with(&path(test), TeamLimits { attempts_per_minute, at_once, ..TeamLimits::default() })
        .unwrap()
}

#[test]
fn a_token_opens_its_team_until_it_is_revoked_and_nothing_else_does() {
    let bench = open("tokens");
    let (token, other) = (bench.create_token("blue").unwrap(), bench.create_token("red").unwrap());
    assert_eq!(bench.team(Submitter::Token(&token)).unwrap(), "blue");
    assert_eq!(bench.team(Submitter::Token(&other)).unwrap(), "red");
    assert_eq!(token.len(), "cft_".len() + 64);
    for at in 0..token.len() {
        let mut bytes = token.clone().into_bytes();
        bytes[at] = if bytes[at] == b'0' { b'1' } else { b'0' };
        assert!(
            matches!(bench.team(Submitter::Token(std::str::from_utf8(&bytes).unwrap())), Err(Error::Token)),
            "byte {at}"
        );
    }
    for wrong in ["", "blue", "local", &token[..token.len() - 1], &format!("{token}0"), &token.to_uppercase()]
    {
        assert!(matches!(bench.team(Submitter::Token(wrong)), Err(Error::Token)), "{wrong:?}");
    }
    let second = bench.create_token("blue").unwrap();
    assert_eq!(bench.revoke_tokens("blue").unwrap(), 2);
    for revoked in [&token, &second] {
        let error = bench.begin("wind", Submitter::Token(revoked), "x").map(|_| ()).unwrap_err();
        assert!(error.code() == "bad_token" && !error.to_string().contains(revoked.as_str()));
    }
    assert_eq!(bench.team(Submitter::Token(&other)).unwrap(), "red");
}

#[test]
fn the_database_holds_no_token() {
    let bench = open("no_token");
    let token = bench.create_token("blue").unwrap();
    drop(bench.begin("wind", Submitter::Token(&token), "x").unwrap());
    let listed = serde_json::to_string(&bench.tokens().unwrap()).unwrap();
    assert!(listed.contains("blue") && !listed.contains(&token[4..]));
    drop(bench);
    for file in std::fs::read_dir(path("no_token").parent().unwrap()).unwrap() {
        let bytes = std::fs::read(file.unwrap().path()).unwrap();
        let raw = hex::decode(&token[4..]).unwrap();
        assert!(
            !bytes.windows(64).any(|w| w == &token.as_bytes()[4..]) && !bytes.windows(32).any(|w| w == raw)
        );
    }
}

#[test]
fn names_are_checked() {
    let bench = open("names");
    for team in ["", "local", "a b", "ä", "x\n", &"x".repeat(33)] {
        assert!(matches!(bench.create_token(team), Err(Error::Name { .. })), "{team:?}");
    }
    for controller in ["", "x\n", "\u{1b}[2J", &"x".repeat(65)] {
        assert!(
            matches!(bench.begin("wind", Submitter::Local, controller), Err(Error::Name { .. })),
            "{controller:?}"
        );
    }
    assert!(matches!(bench.begin("wnd", Submitter::Local, "x"), Err(Error::Scenario { .. })));
}

#[test]
fn a_team_is_held_to_so_many_attempts_a_minute() {
    let bench = strict("rate", 3, 10);
    let (blue, red) = (bench.create_token("blue").unwrap(), bench.create_token("red").unwrap());
    (0..3).for_each(|_| drop(bench.begin("wind", Submitter::Token(&blue), "x").unwrap()));
    let error = bench.begin("wind", Submitter::Token(&blue), "x").map(|_| ()).unwrap_err();
    let again_s = error.retry_after_s().unwrap();
    assert!(error.code() == "too_many_attempts" && (50..=60).contains(&again_s), "{error}");
    drop(bench.begin("wind", Submitter::Token(&red), "x").unwrap());
    drop(bench.begin("wind", Submitter::Local, "x").unwrap());
    // the limit outlives the process
    let error = strict("rate", 3, 10).begin("wind", Submitter::Token(&blue), "x").map(|_| ()).unwrap_err();
    assert_eq!(error.code(), "too_many_attempts");
}

#[test]
fn a_team_is_held_to_so_many_attempts_at_once() {
    let bench = strict("at_once", 100, 2);
    let blue = bench.create_token("blue").unwrap();
    let begin = || bench.begin("wind", Submitter::Token(&blue), "x");
    let (first, _second) = (begin().unwrap(), begin().unwrap());
    let error = begin().map(|_| ()).unwrap_err();
    assert!(
        error.code() == "too_many_at_once" && error.status() == 429 && error.retry_after_s().is_some(),
        "{error}"
    );
    drop(first);
    drop(begin().unwrap());
}
