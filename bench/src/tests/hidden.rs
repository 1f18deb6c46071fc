//! Tests of the hidden effect of the mystery scenario.

use serde_json::json;
use sha2::{Digest, Sha256};

use super::super::baselines::evaluate;
use super::super::mystery::HiddenDraw;
use super::super::scenario::{self, Scenario};
use super::super::secrets::{Secrets, canonical};
use super::*;

fn secrets(seed: u8) -> Secrets {
    Secrets::new(&[9; 32], [seed; 32])
}

fn mystery(secrets: &Secrets) -> Scenario {
    scenario::read_all(secrets).unwrap().into_iter().find(|s| s.plan.hidden.is_some()).unwrap()
}

#[test]
fn each_server_hides_its_own_and_commits_to_it() {
    let drawn = |seed| mystery(&secrets(seed));
    let (first, again) = (drawn(1), drawn(1));
    let hidden = |s: &Scenario| s.hidden.clone().unwrap();
    assert_eq!(hidden(&first).effects, hidden(&again).effects);
    assert_eq!(first.hash(), again.hash());
    let others: Vec<Scenario> = (2..60).map(drawn).collect();
    assert!(others.iter().all(|s| s.hash() != first.hash() && hidden(s).effects != hidden(&first).effects));
    let mut names: Vec<String> = others.iter().flat_map(|s| hidden(s).effects.into_keys()).collect();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 7, "every effect of the pool is drawn by some server: {names:?}");
    // opened one day, the commitment is checked like this
    let public = scenario::content_hash(&first.plan, None).unwrap();
    let salt = hex::encode(secrets(1).derive(&[b"salt", public.as_bytes()]).unwrap());
    let opened = canonical(&json!({"effects": hidden(&first).effects, "salt": salt})).unwrap();
    assert_eq!(hex::encode(Sha256::digest(opened)), hidden(&first).commitment);
}

/// The score of a controller on a scenario of any effects.
fn score(scenario: &Scenario, controller: &str) -> f64 {
    let seeds: Vec<u64> = (0..scenario.episodes() as u64).collect();
    evaluate(scenario, &ControllerSpec::named(controller).unwrap().into(), &seeds).unwrap().0.score.score
}

#[test]
fn whatever_is_hidden_can_be_flown_and_leaves_room() {
    let scenario = mystery(&secrets(1));
    let pool = scenario.plan.hidden.clone().unwrap();
    for effects in pool.corners() {
        let words = serde_json::to_string(&effects).unwrap();
        let scenario =
            Scenario { hidden: Some(HiddenDraw { effects, commitment: String::new() }), ..scenario.clone() };
        let (thesis, hover) = (score(&scenario, "thesis-pid"), score(&scenario, "hover"));
        println!("thesis-pid {thesis:.1}, hover {hover:.1} with {words}");
        assert!(
            (8.0..70.0).contains(&thesis) && hover < thesis,
            "{words}: thesis-pid {thesis}, hover {hover}"
        );
    }
}
