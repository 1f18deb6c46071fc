//! An attempt at the benchmark from afar: lock-step, scored by the server, signed, verified by flying it
//! again.

use std::path::{Path, PathBuf};

use crate::common::{folder, json, stdout_of, text};
use crate::net::{Client, Server, eventually, floats, le, request};
use crazyflie_server::serve::Settings;
use serde_json::{Value, json as object};

const ENVS: usize = 24;

/// A server with the benchmark of a database.
pub fn settings(data: &Path) -> Settings {
    let bench = crazyflie_bench::Bench::open(data).unwrap();
    Settings { extension: Some(crazyflie_bench::serve::Benchmark::extension(bench)), ..Settings::default() }
}

struct TestSetup {
    server: Server,
    data: PathBuf,
    token: String,
}

fn setup(test: &str) -> TestSetup {
    let data = folder(test).join("bench.sqlite");
    let made = json(&["bench", "token", "create", "team-a", "--data", text(&data), "--json"]);
    let token = made["token"].as_str().unwrap().to_owned();
    let server = Server::start(settings(&data));
    TestSetup { server, data, token }
}

impl TestSetup {
    fn begin(&self, client: &mut Client, scenario: &str) -> Value {
        client.ask(&object!({"id": 1, "type": "benchmark", "scenario": scenario, "controller": "still", "token": self.token}))
    }
}

/// Steps by binary messages until the server reports that the last episode is over; returns their number.
fn fly(client: &mut Client) -> u64 {
    for tick in 1.. {
        let reply = client.ask_binary(request(1 + tick, 2, 0, 1, ENVS as u32, &le(&[0.0; 4 * ENVS])));
        assert_eq!(reply[8], 0x82);
        assert!(floats(&reply[32..32 + 4 * 24 * ENVS]).iter().all(|number| number.is_finite()));
        if reply[9] & 2 != 0 {
            return tick;
        }
    }
    unreachable!()
}

#[test]
fn an_attempt_from_afar_is_listed_and_confirmed() {
    let setup = setup("contest-listed");
    let mut client = setup.server.connect();
    let begun = setup.begin(&mut client, "wind");
    assert_eq!((&begun["type"], &begun["num_envs"]), (&object!("begun"), &object!(ENVS)), "{begun}");
    assert_eq!(begun["observation"].as_array().unwrap().len(), ENVS);
    // too early, in the wrong length and of the wrong kind: the attempt goes on
    let wrong = client.ask(&object!({"id": 2, "type": "step", "action": [[0, 0, 0, 0]]}));
    assert_eq!((&wrong["type"], &wrong["code"]), (&object!("error"), &object!("bad_shape")), "{wrong}");
    let wrong = client.ask(&object!({"id": 3, "type": "step", "action": vec![[0.0, 0.0, 0.0, 7.0]; ENVS]}));
    assert_eq!(wrong["code"], "bad_action", "{wrong}");
    let wrong = client.ask(&object!({"id": 4, "type": "state"}));
    assert_eq!(wrong["code"], "no_session", "no true states in an attempt: {wrong}");
    let first = client.ask(&object!({"id": 5, "type": "step", "action": vec![[0.0; 4]; ENVS]}));
    assert_eq!(
        (&first["type"], &first["over"], first.get("state")),
        (&object!("result"), &object!(false), None)
    );
    let ticks = 1 + fly(&mut client);
    let done = client.ask(&object!({"id": 90_000, "type": "finish"}));
    assert_eq!(done["type"], "finished", "{done}");
    let (id, score) = (
        done["attempt"]["id"].as_str().unwrap(),
        done["attempt"]["result"]["score"]["score"].as_f64().unwrap(),
    );
    println!("{ticks} ticks, score {score}");
    assert_eq!(begun["attempt"], done["attempt"]["id"]);
    let board: Value = serde_json::from_str(&setup.server.get("/api/v1/leaderboard?scenario=wind")).unwrap();
    assert_eq!(
        (&board[0]["team"], &board[0]["controller"]),
        (&object!("team-a"), &object!("still")),
        "{board}"
    );
    assert!(stdout_of(&["bench", "verify", id, "--data", text(&setup.data)]).contains("confirmed"));
    setup.server.stop();
}

#[test]
fn what_is_not_finished_is_listed_as_abandoned() {
    let setup = setup("contest-abandoned");
    let mut client = setup.server.connect();
    let begun = setup.begin(&mut client, "hover-aruco@1.0.0");
    drop(client);
    let path = format!("/api/v1/attempts/{}", begun["attempt"].as_str().unwrap());
    let status = || serde_json::from_str::<Value>(&setup.server.get(&path)).unwrap()["status"].clone();
    eventually("it is abandoned", || status() == "abandoned");
    // finished before it is over: abandoned as well, and the connection lives on
    let mut client = setup.server.connect();
    setup.begin(&mut client, "wind");
    assert_eq!(client.ask(&object!({"id": 2, "type": "finish"}))["code"], "attempt_under_way");
    assert_eq!(client.ask(&object!({"id": 3, "type": "hello"}))["type"], "welcome");
    setup.server.stop();
}

#[test]
fn who_has_no_token_is_told_so_and_who_asks_too_much_when_to_come_back() {
    let setup = setup("contest-refused");
    let mut client = setup.server.connect();
    let ask = |token: &str| object!({"id": 1, "type": "benchmark", "scenario": "wind", "controller": "x", "token": token});
    assert_eq!(client.ask(&ask("cft_00"))["code"], "bad_token");
    let unknown = client.ask(
        &object!({"id": 2, "type": "benchmark", "scenario": "wnd", "controller": "x", "token": setup.token}),
    );
    assert_eq!(unknown["code"], "unknown_scenario");
    let mut held: Vec<Client> = Vec::new();
    let refused = loop {
        let mut another = setup.server.connect();
        let answer = another.ask(&ask(&setup.token));
        held.push(another);
        if answer["type"] == "error" {
            break answer;
        }
        assert!(held.len() < 50, "no limit");
    };
    println!("refused after {} attempts at once: {refused}", held.len() - 1);
    assert_eq!(refused["code"], "too_many_at_once");
    assert!(refused["retry_after_s"].as_u64().is_some());
    drop(held);
    setup.server.stop();
}

#[test]
fn the_benchmark_is_an_extension_that_the_server_names() {
    let setup = setup("contest-extension");
    let mut client = setup.server.connect();
    assert_eq!(setup.server.get("/api/v1/extensions"), r#"["benchmark"]"#);
    let welcome = client.ask(&object!({"id": 1, "type": "hello"}));
    assert_eq!(welcome["scenarios"].as_array().unwrap().len(), 15, "{welcome}");
    for (message, code) in [
        (object!({"id": 2, "type": "finish"}), "no_session"),
        (object!({"id": 3, "type": "benchmark", "scenario": "wind"}), "bad_message"),
        (
            object!({"id": 4, "type": "benchmark", "scenarios": "wind", "controller": "x", "token": "t"}),
            "bad_message",
        ),
        (object!({"id": 5, "type": "benchmarks"}), "unknown_type"),
    ] {
        let refused = client.ask(&message);
        assert_eq!(refused["code"], code, "{refused}");
    }
    // an ordinary session follows the attempt
    setup.begin(&mut client, "wind");
    assert_eq!(client.ask(&object!({"id": 6, "type": "close"}))["type"], "closed");
    assert_eq!(client.ask(&object!({"id": 7, "type": "make"}))["type"], "made");
    assert_eq!(client.ask(&object!({"id": 8, "type": "finish"}))["code"], "no_session");
    assert_eq!(client.ask(&object!({"id": 9, "type": "reset"}))["type"], "observation");
    assert_eq!(setup.server.metric("crazyflie_attempts_abandoned_total"), 1.0);
    setup.server.stop();
    // without it
    let plain = Server::start(Settings::default());
    let mut client = plain.connect();
    let unknown = client.ask(&object!({"id": 1, "type": "benchmark"}));
    assert_eq!(unknown["code"], "unknown_type", "{unknown}");
    plain.stop();
}
