//! Output of the benchmark: it is correct, and no secret is in it.

use ed25519_dalek::{Signature, VerifyingKey};
use serde_json::Value;

use super::super::record::Status;
use super::super::secrets::canonical;
use super::super::{AttemptPage, Submitter, api};
use super::spelled::Needles;
use super::*;

/// Returns every answer of a database, with the request.
fn everything(bench: &Bench) -> Vec<(String, Vec<u8>)> {
    let mut all = vec![
        ("scenarios".into(), api::scenarios(bench, true).unwrap().bytes),
        ("attempts".into(), api::attempts(bench, None, AttemptPage::default()).unwrap().bytes),
        ("key".into(), api::key(bench).unwrap().bytes),
        ("tokens".into(), serde_json::to_vec(&bench.tokens().unwrap()).unwrap()),
        ("verify".into(), serde_json::to_vec(&bench.verify_all(&|_, _| ()).unwrap().0).unwrap()),
        ("debug".into(), format!("{:?}", bench.all_scenarios()).into_bytes()),
    ];
    for scenario in bench.scenarios() {
        all.push((
            format!("leaderboard {}", scenario.id()),
            api::leaderboard(bench, &scenario.id()).unwrap().bytes,
        ));
    }
    for listed in bench.attempts(None).unwrap() {
        let (id, finished) = (listed.id, listed.document.unwrap().status == Status::Finished);
        all.push((format!("attempt {id}"), api::attempt(bench, &id).unwrap().bytes));
        if finished {
            all.push((format!("actions {id}"), api::actions(bench, &id).unwrap().bytes));
            for episode in 0..24 {
                all.push((format!("replay {id} {episode}"), api::replay(bench, &id, episode).unwrap().bytes));
                all.push((
                    format!("log {id} {episode}"),
                    api::log_csv(bench, &id, episode, 0).unwrap().bytes,
                ));
            }
        }
    }
    all
}

/// The database's secrets, and the seeds of every attempt.
fn secrets(bench: &Bench, test: &'static str) -> Vec<(String, Vec<u8>)> {
    let db = rusqlite::Connection::open(path(test)).unwrap();
    let mut query = db.prepare("SELECT name, value FROM secrets").unwrap();
    let stored =
        query.query_map([], |row| Ok((row.get::<_, String>(0)?, row.get::<_, Vec<u8>>(1)?))).unwrap();
    let mut all: Vec<(String, Vec<u8>)> = stored.map(|row| row.unwrap()).collect();
    assert_eq!(all.len(), 2);
    for listed in bench.attempts(None).unwrap() {
        let document = listed.document.unwrap();
        let seeds = bench.0.secrets.seeds(&document.id, &document.scenario_hash, 24).unwrap();
        all.extend(
            seeds
                .iter()
                .enumerate()
                .map(|(i, seed)| (format!("seed {i} of {}", document.id), seed.to_le_bytes().to_vec())),
        );
    }
    all
}

#[test]
fn no_secret_is_in_anything_that_is_handed_out() {
    let bench = open("handed_out");
    let token = bench.create_token("blue").unwrap();
    submit(&bench, "mystery", "thesis-pid");
    submit(&bench, "ground-landing", "random");
    drop(bench.begin("wind", Submitter::Token(&token), "quitter").unwrap());
    let mut forbidden = secrets(&bench, "handed_out");
    forbidden.push(("token".into(), hex::decode(&token[4..]).unwrap()));
    let needles = Needles::new(&forbidden);
    let all = everything(&bench);
    let bytes: usize = all.iter().map(|(_, bytes)| bytes.len()).sum();
    for (what, bytes) in &all {
        assert_eq!(needles.find(bytes), None, "{what} gives it away");
    }
    println!(
        "{} spellings of secrets looked for in {bytes} bytes of {} answers: none",
        needles.all.len(),
        all.len()
    );
    // a planted secret is found, so the search works
    for (name, needle) in &needles.all {
        let planted = [b"{\"x\":\"", &needle[..], b"\"}"].concat();
        assert!(needles.find(&planted).is_some(), "{name}");
    }
}

#[test]
fn what_the_mystery_hides_is_not_told() {
    let bench = open("not_told");
    submit(&bench, "mystery", "thesis-pid");
    let (name, params) = {
        let mystery = bench.scenarios().iter().find(|s| s.id().starts_with("mystery")).unwrap();
        let hidden = mystery.hidden.clone().unwrap();
        let (name, params) = hidden.effects.into_iter().next().unwrap();
        (name, serde_json::to_value(params).unwrap())
    };
    let mystery: Vec<Value> = serde_json::from_slice(&api::scenarios(&bench, false).unwrap().bytes).unwrap();
    let public = mystery.iter().find(|s| s["name"] == "mystery").unwrap();
    assert!(
        !public.to_string().contains(&name) && public["commitment"].as_str().unwrap().len() == 64,
        "{public}"
    );
    for (what, bytes) in everything(&bench) {
        for value in params.as_object().unwrap().values() {
            let text = value.to_string();
            assert!(
                text.len() > 6 && !bytes.windows(text.len()).any(|w| w == text.as_bytes()),
                "{what} tells {name}"
            );
        }
    }
}

/// Checks a signature as any language could, from the server's publications.
#[test]
fn anyone_can_check_a_signature() {
    let bench = open("signature");
    let id = submit(&bench, "wind", "hover");
    let key: Value = serde_json::from_slice(&api::key(&bench).unwrap().bytes).unwrap();
    let public: [u8; 32] = hex::decode(key["public_key"].as_str().unwrap()).unwrap().try_into().unwrap();
    let mut attempt: Value = serde_json::from_slice(&api::attempt(&bench, &id).unwrap().bytes).unwrap();
    let fields = attempt.as_object_mut().unwrap();
    fields.remove("at").unwrap();
    let signature = hex::decode(fields.remove("signature").unwrap().as_str().unwrap()).unwrap();
    let check = |value: &Value| {
        let signature = Signature::from_slice(&signature).unwrap();
        VerifyingKey::from_bytes(&public)
            .unwrap()
            .verify_strict(&canonical(value).unwrap(), &signature)
            .is_ok()
    };
    assert!(check(&attempt));
    attempt["controller"] = "thesis-pid".into();
    assert!(!check(&attempt));
}

#[test]
fn a_replay_is_a_header_and_rows() {
    let bench = open("frames");
    let id = submit(&bench, "ground-landing", "thesis-pid");
    let bytes = api::replay(&bench, &id, 5).unwrap().bytes;
    let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
    let columns: Vec<&str> =
        header["columns"].as_array().unwrap().iter().map(|c| c.as_str().unwrap()).collect();
    let (rows, width) = (header["rows"].as_u64().unwrap() as usize, columns.len());
    assert_eq!((length % 4, bytes.len()), (0, 4 + length + rows * width * 4));
    assert_eq!(
        (header["end"].as_str(), header["camera"]["fov_deg"].as_f64(), width),
        (Some("landed"), Some(120.0), 25)
    );
    assert_eq!(header["marker"], serde_json::json!([[0.0, 0.0, 0.0]]));
    let number = |row: usize, column: &str| {
        let offset = 4 + length + 4 * (row * width + columns.iter().position(|c| *c == column).unwrap());
        f32::from_le_bytes(bytes[offset..offset + 4].try_into().unwrap())
    };
    assert_eq!((number(0, "t_s"), number(0, "z"), number(0, "setpoint_z")), (0.0, 0.7, 0.0));
    assert!(
        (number(rows - 1, "t_s") - (rows - 1) as f32 * 0.02).abs() < 1e-4 && number(rows - 1, "z") <= 0.0
    );
    assert!((number(0, "fix_z") - 0.7).abs() < 0.05 && number(0, "fix_valid") == 1.0);
    assert!(number(rows - 1, "reward") > 0.1 && number(1, "reward") < 0.0 && number(0, "reward") == 0.0);
    // the log tells the same flight
    let log = String::from_utf8(api::log_csv(&bench, &id, 5, 0).unwrap().bytes).unwrap();
    assert_eq!(log.lines().count(), rows + 1);
    assert!(api::replay(&bench, &id, 24).unwrap_err().to_string().contains("episodes 0 to 23"));
    assert_eq!(api::actions(&bench, &id).unwrap().bytes.len() % (24 * 4 * 4), 0);
}
