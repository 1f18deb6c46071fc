//! Fuzzes the parsers on the wire: anything may be sent, and a session survives all of it. Inputs that once mattered
//! are kept in `fuzz/corpus` and sent first.

use std::path::Path;

use crate::net::{Client, Server, request};
use crazyflie_server::serve::{SessionEnd, Settings};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use serde_json::json;
use tungstenite::Message;

const CORPUS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus");

/// The files of a folder of the corpus, in the order of their names.
fn corpus(folder: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<_> = std::fs::read_dir(Path::new(CORPUS).join(folder))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    assert!(paths.len() >= 8, "only {} files in {folder}", paths.len());
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// JSON that is nearly a message: types and fields that exist, values that may not fit.
fn nearly() -> impl Strategy<Value = String> {
    let value = prop_oneof![
        any::<f64>().prop_map(|v| json!(v)),
        any::<u64>().prop_map(|v| json!(v)),
        any::<bool>().prop_map(|v| json!(v)),
        ".{0,12}".prop_map(|v| json!(v)),
        prop::collection::vec(-1.5..1.5f64, 0..9).prop_map(|v| json!(v)),
        prop::collection::vec(prop::collection::vec(-1.0..1.0f64, 3..5), 0..4).prop_map(|v| json!(v)),
        Just(json!(null)),
        Just(json!({"task": "track", "effects": {"wind": 0.1}})),
        Just(json!({"threads": 99, "autoreset": "disabled"})),
        Just(json!("Crazyflie-v0")),
        Just(json!(1)),
    ];
    let kinds: Vec<&str> = crazyflie_server::protocol::request_kinds().chain(["x"]).collect();
    let names = [
        "id", "env", "options", "num_envs", "model", "seed", "seeds", "mask", "states", "action", "session",
        "token", "client", "watch", "data",
    ];
    let fields = prop::collection::vec((prop::sample::select(names.to_vec()), value), 0..6);
    (prop::sample::select(kinds), 0..64u64, fields).prop_map(|(kind, id, fields)| {
        let mut message = json!({"type": kind, "id": id});
        for (name, value) in fields {
            // no batches that take the test's time
            let value =
                if name == "num_envs" && value.as_u64().is_some_and(|n| n > 64) { json!(3) } else { value };
            message[name] = value;
        }
        message.to_string()
    })
}

fn frames() -> impl Strategy<Value = Vec<u8>> {
    let header = (0..40u64, 0..5u8, 0..9u8, 0..4u16, 0..4u32);
    let near = (header, prop::collection::vec(any::<u8>(), 0..120), any::<bool>()).prop_map(
        |((id, kind, flags, steps, envs), payload, fit)| {
            // half of them with a payload of the length that the header promises
            let want = if fit { usize::from(steps) * envs as usize * 16 } else { payload.len() };
            let payload: Vec<u8> = payload.iter().copied().chain(std::iter::repeat(0)).take(want).collect();
            request(id, kind, flags, steps, envs, &payload)
        },
    );
    prop_oneof![near, prop::collection::vec(any::<u8>(), 0..64)]
}

/// Sends it and hears one reply.
fn heard(client: &mut Client, message: Message) -> Result<(), TestCaseError> {
    client.ws.send(message).map_err(|e| TestCaseError::fail(e.to_string()))?;
    match client.ws.read() {
        Ok(Message::Binary(reply)) => prop_assert!(reply.len() >= 32),
        Ok(Message::Text(text)) => {
            let reply: serde_json::Value =
                serde_json::from_str(&text).map_err(|e| TestCaseError::fail(e.to_string()))?;
            prop_assert!(reply["type"].is_string(), "{}", reply);
        }
        other => prop_assert!(false, "{other:?}"),
    }
    Ok(())
}

fn fire<S: Strategy>(cases: u32, strategy: S, mut shoot: impl FnMut(S::Value) -> Result<(), TestCaseError>) {
    let mut runner = TestRunner::new(Config { cases, failure_persistence: None, ..Config::default() });
    let shoot = std::cell::RefCell::new(&mut shoot);
    runner.run(&strategy, |value| shoot.borrow_mut()(value)).unwrap();
}

#[test]
fn anything_may_be_sent() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    let mut plain = Client::connect(server.address, None);
    let mut live = Client::connect_at(server.address, "/live", Some("crazyflie.live.v1"));
    client.ask(&json!({"id": 1, "type": "make", "num_envs": 2, "options": {"autoreset": "same_step", "max_episode_steps": 3}}));
    client.ask_binary(request(1, 1, 0, 0, 2, &[]));
    let (texts, binaries) = (corpus("control_message"), corpus("step_frame"));
    for text in &texts {
        let text = String::from_utf8_lossy(text);
        for client in [&mut client, &mut plain] {
            // the dialect of OpenEnv has a word for goodbye
            if !text.contains("\"close\"") {
                heard(client, Message::text(&*text)).unwrap();
            }
        }
    }
    for bytes in &binaries {
        heard(&mut client, Message::binary(bytes.clone())).unwrap();
    }
    fire(1500, nearly(), |text| heard(&mut client, Message::text(text)));
    fire(1500, ".{0,80}", |text| heard(&mut client, Message::text(text)));
    fire(2000, frames(), |bytes| {
        heard(&mut client, Message::binary(bytes))?;
        Ok(())
    });
    let goodbye = |text: &String| text.contains("\"close\"");
    fire(700, nearly().prop_filter("no goodbye", move |text| !goodbye(text)), |text| {
        heard(&mut plain, Message::text(text))
    });
    fire(300, ".{0,40}", |text| heard(&mut live, Message::text(text)));
    println!("{} kept inputs and 6000 drawn ones: one reply to each", texts.len() + binaries.len());
    client.ask(&json!({"id": 100, "type": "make"}));
    assert_eq!(client.ask(&json!({"id": 101, "type": "reset"}))["type"], "observation");
    let report = server.stop();
    assert_eq!((report.ended[&SessionEnd::Broken], report.cut), (0, 0));
}
