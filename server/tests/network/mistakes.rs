//! Bad input of every kind is answered with a typed error, and the session flies on as if nothing had
//! happened.

use crate::net::{Server, floats, le, request};
use crazyflie_server::serve::{SessionEnd, Settings};
use serde_json::json;
use tungstenite::Message;

const TEXTS: [(&str, &str); 30] = [
    ("", "bad_json"),
    ("{", "bad_json"),
    ("nonsense", "bad_json"),
    (r#"{"id": 9, "type": "step", "action": [NaN, 0, 0, 0]}"#, "bad_json"),
    ("\u{0}", "bad_json"),
    ("7", "bad_message"),
    ("[]", "bad_message"),
    ("{}", "bad_message"),
    (r#"{"id": -1, "type": "state"}"#, "bad_message"),
    (r#"{"id": 1.5, "type": "state"}"#, "bad_message"),
    (r#"{"id": 9007199254740992, "type": "state"}"#, "bad_message"),
    (r#"{"id": "7", "type": "state"}"#, "bad_message"),
    (r#"{"id": 9}"#, "bad_message"),
    (r#"{"id": 9, "type": 4}"#, "bad_message"),
    (r#"{"id": 9, "type": "jump"}"#, "unknown_type"),
    (r#"{"id": 9, "type": "step"}"#, "bad_message"),
    (r#"{"id": 9, "type": "step", "action": "left"}"#, "bad_message"),
    (r#"{"id": 9, "type": "step", "action": [0, 0, 0]}"#, "bad_message"),
    (r#"{"id": 9, "type": "reset", "seed": -4}"#, "bad_message"),
    (r#"{"id": 9, "type": "make", "num_envs": 0}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "num_envs": 16385}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "num_envs": 1e9}"#, "bad_message"),
    (r#"{"id": 9, "type": "make", "env": "Crazyfly-v0"}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "env": "Crazyflie-v0", "options": {"task": "land"}}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "options": {"effects": {"wind": {"x_mps2": 99}}}}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "options": {"physics_hz": 4000000000}}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "options": {"colour": "red"}}"#, "bad_options"),
    (r#"{"id": 9, "type": "make", "model": "not a model"}"#, "bad_model"),
    (r#"{"id": 9, "type": "resume", "session": "1", "token": "guess"}"#, "bad_message"),
    (r#"{"id": 9, "type": "resume", "session": "99", "token": ""}"#, "unknown_session"),
];

/// Each with an id of its own from 100 on: a fault is the answer to its id for good.
fn frames() -> Vec<(Vec<u8>, &'static str)> {
    let mut seeds = 7u64.to_le_bytes().to_vec();
    seeds.extend(8u64.to_le_bytes());
    seeds.extend([1, 2]);
    vec![
        (vec![], "bad_frame"),
        (vec![1; 15], "bad_frame"),
        (request(100, 0, 0, 0, 2, &[]), "bad_frame"),
        (request(101, 4, 0, 0, 2, &[]), "bad_frame"),
        (request(102, 2, 8, 1, 2, &le(&[0.0; 8])), "bad_frame"),
        (request(103, 2, 0, 0, 2, &[]), "bad_frame"),
        (request(104, 3, 0, 1, 2, &[]), "bad_frame"),
        (request(u64::MAX, 2, 0, 1, 2, &le(&[0.0; 8])), "bad_frame"),
        (request(105, 1, 6, 0, 2, &seeds), "bad_frame"),
        (request(106, 2, 0, 1, 2, &le(&[0.0; 7])), "wrong_length"),
        (request(107, 2, 0, 1, u32::MAX, &le(&[0.0; 8])), "wrong_length"),
        (request(108, 2, 0, u16::MAX, u32::MAX, &[]), "wrong_length"),
        (request(109, 2, 0, 1, 3, &le(&[0.0; 12])), "wrong_length"),
        (request(110, 2, 0, 1, 2, &le(&[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0])), "bad_action"),
        (request(111, 2, 0, 2, 2, &le(&[[0.0; 15].as_slice(), &[1.0001]].concat())), "bad_action"),
        (request(112, 2, 0, 2, 2, &le(&[[0.0; 15].as_slice(), &[f32::NEG_INFINITY]].concat())), "bad_action"),
        (request(113, 2, 1, 60_000, 2, &le(&vec![0.0; 480_000 - 48_000])[..0]), "wrong_length"),
    ]
}

#[test]
fn every_mistake_is_named_and_the_session_lives() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    let mut good = server.connect();
    let make = json!({"id": 1, "type": "make", "num_envs": 2});
    for c in [&mut client, &mut good] {
        assert_eq!(c.ask(&make)["type"], "made");
        assert_eq!(
            c.ask(&json!({"id": 2, "type": "step", "action": [[0, 0, 0, 0], [0, 0, 0, 0]]}))["code"],
            "not_reset"
        );
        assert_eq!(c.ask(&json!({"id": 3, "type": "state"}))["code"], "not_reset");
        c.ask_binary(request(4, 1, 0, 0, 2, &[]));
    }
    let mut count = 0;
    for (text, code) in TEXTS {
        client.ws.send(Message::text(text)).unwrap();
        let reply = client.receive();
        assert_eq!((&reply["type"], &reply["code"]), (&json!("error"), &json!(code)), "{text}: {reply}");
        assert!(reply["message"].as_str().unwrap().len() > 5, "{text}: {reply}");
        count += 1;
    }
    for (bytes, code) in frames() {
        client.ws.send(Message::binary(bytes.clone())).unwrap();
        let reply = client.receive();
        assert_eq!(reply["code"], code, "{bytes:?}: {reply}");
        count += 1;
    }
    // with others' ids in between, the flights are the same
    for id in [200, 201] {
        let step = request(id, 2, 1, 1, 2, &le(&[0.3; 8]));
        assert_eq!(client.ask_binary(step.clone()), good.ask_binary(step));
    }
    println!("{count} mistakes, each answered with its code; the session went on");
    drop((client, good));
    let report = server.stop();
    assert_eq!((report.ended[&SessionEnd::Broken], report.cut), (0, 0));
}

#[test]
fn an_ended_episode_is_said_to_be_so_and_large_requests_are_refused() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    client.ask(&json!({"id": 1, "type": "make", "num_envs": 2, "options": {"autoreset": "disabled", "max_episode_steps": 1}}));
    client.ask_binary(request(2, 1, 0, 0, 2, &[]));
    let reply = client.ask_binary(request(3, 2, 0, 1, 2, &le(&[0.0; 8])));
    assert_eq!(reply[reply.len() - 4..], [0, 0, 1, 1]);
    client.ws.send(Message::binary(request(4, 2, 0, 1, 2, &le(&[0.0; 8])))).unwrap();
    assert_eq!(client.receive()["code"], "ended");
    client.ws.send(Message::binary(request(5, 2, 0, 2, 2, &le(&[0.0; 16])))).unwrap();
    assert_eq!(client.receive()["code"], "bad_frame");
    // the mask says who begins; the other row is zeros
    let reply = client.ask_binary(request(6, 1, 4, 0, 2, &[0, 1]));
    let rows = floats(&reply[32..]);
    assert!(rows[..24].iter().all(|v| *v == 0.0) && rows[24..].iter().any(|v| *v != 0.0));
    client.ws.send(Message::binary(request(7, 2, 0, 1, 2, &le(&[0.0; 8])))).unwrap();
    assert_eq!(client.receive()["code"], "ended");

    let made = client.ask(&json!({"id": 8, "type": "make", "num_envs": 1000}));
    let max = made["max_steps"].as_u64().unwrap() as u16;
    client.ask_binary(request(9, 1, 0, 0, 1000, &[]));
    client.ask_binary(request(10, 2, 0, max, 1000, &le(&vec![0.0; 4000 * usize::from(max)])));
    client
        .ws
        .send(Message::binary(request(
            11,
            2,
            0,
            max + 1,
            1000,
            &le(&vec![0.0; 4000 * (usize::from(max) + 1)]),
        )))
        .unwrap();
    assert_eq!(client.receive()["code"], "too_large");
}

/// Words of Rust that mean nothing to the reader of an error.
const RUST: [&str; 13] = [
    "usize", "u64", "u32", "i64", "f32", "f64", "struct ", "enum ", "Option", "Vec<", "sequence", "unit",
    "String",
];

#[test]
fn unknown_fields_are_refused_with_a_proposal_and_no_error_speaks_rust() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    let mut ask = |text: &str| {
        client.ws.send(Message::text(text.to_owned())).unwrap();
        let reply = client.receive();
        let words = reply["message"].as_str().unwrap_or_else(|| panic!("{text}: {reply}")).to_owned();
        RUST.iter().for_each(|rust| assert!(!words.contains(rust), "{text}: {words}"));
        (reply["code"].as_str().unwrap().to_owned(), words)
    };
    for (text, word) in [
        (r#"{"id": 1, "type": "make", "num_env": 64}"#, "did you mean \"num_envs\""),
        (r#"{"id": 1, "type": "hello", "tokens": "x"}"#, "did you mean \"token\""),
        (r#"{"id": 1, "type": "reset", "seed": 1, "state": true}"#, "did you mean \"states\""),
        (r#"{"id": 1, "type": "close", "now": 1}"#, "it has none besides id and type"),
        (
            r#"{"id": 1, "type": "world", "name": "a", "mission": "swap", "seeds": 4}"#,
            "did you mean \"seed\"",
        ),
        (
            r#"{"id": 1, "type": "world", "name": "a", "mission": "swap", "pilot": 4}"#,
            "did you mean \"pilots\"",
        ),
        (r#"{"id": 1, "type": "join", "world": "a"}"#, "known: name, drone, token, invitation"),
    ] {
        let (code, words) = ask(text);
        assert!(code == "bad_message" && words.contains(word), "{text}: {code}: {words}");
    }
    for text in TEXTS.iter().map(|(text, _)| *text).chain([
        r#"{"id": 1, "type": "make", "num_envs": "two"}"#,
        r#"{"id": 1, "type": "make", "options": 3}"#,
        r#"{"id": 1, "type": "make", "options": {"effects": 3}}"#,
        r#"{"id": 1, "type": "make", "options": {"physics_hz": "x"}}"#,
        r#"{"id": 1, "type": "reset", "seeds": [1.5]}"#,
        r#"{"id": 1, "type": "reset", "mask": [1]}"#,
        r#"{"id": 1, "type": "hello", "client": 4}"#,
        r#"{"id": 1, "type": "world", "name": 4}"#,
        r#"{"id": 1, "type": "fly", "action": "up"}"#,
        r#"{"id": 1, "type": "fly", "action": [{}]}"#,
    ]) {
        ask(text);
    }
}
