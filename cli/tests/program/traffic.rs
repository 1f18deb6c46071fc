//! No secret is in any byte that the server sends: a proxy keeps them all, over whole attempts and every other
//! request.

use std::path::{Path, PathBuf};

use crate::common::{folder, json, text};
use crate::contest::settings;
use crate::net::{Client, Server, floats, get, le, request};
use crate::secrets::Needles;
use crate::tap::Tap;
use hmac::{Hmac, KeyInit, Mac};
use serde_json::{Value, json as object};
use sha2::Sha256;

const EPISODES: usize = 24;
const SCENARIO: &str = "wind";

struct TestSetup {
    server: Server,
    tap: Tap,
    data: PathBuf,
    token: String,
}

fn setup(test: &str) -> TestSetup {
    let data = folder(test).join("bench.sqlite");
    let token = json(&["bench", "token", "create", "team-a", "--data", text(&data), "--json"])["token"]
        .as_str()
        .unwrap()
        .to_owned();
    let server = Server::start(settings(&data));
    let tap = Tap::in_front_of(server.address);
    TestSetup { server, tap, data, token }
}

fn stored_secret(data: &Path, name: &str) -> Vec<u8> {
    let db = rusqlite::Connection::open(data).unwrap();
    db.query_row("SELECT value FROM secrets WHERE name = ?1", [name], |row| row.get(0)).unwrap()
}

/// The seed of an episode, written down once more: HMAC-SHA256 under the secret over the parts, each after
/// its length.
fn seed(secret: &[u8], attempt: &str, scenario_hash: &str, episode: u64) -> u64 {
    let mut mac = Hmac::<Sha256>::new_from_slice(secret).unwrap();
    for part in [&b"seed"[..], attempt.as_bytes(), scenario_hash.as_bytes(), &episode.to_le_bytes()] {
        mac.update(&(part.len() as u64).to_le_bytes());
        mac.update(part);
    }
    u64::from_le_bytes(mac.finalize().into_bytes()[..8].try_into().unwrap())
}

fn seeds(data: &Path, attempt: &Value) -> Vec<u64> {
    let (id, hash) = (attempt["id"].as_str().unwrap(), attempt["scenario_hash"].as_str().unwrap());
    (0..EPISODES as u64).map(|episode| seed(&stored_secret(data, "seed secret"), id, hash, episode)).collect()
}

impl TestSetup {
    fn client(&self) -> Client {
        Client::connect(self.tap.address, Some("crazyflie.v1"))
    }

    fn get(&self, path: &str) -> Vec<u8> {
        let (head, body) = get(self.tap.address, path);
        assert!(head.starts_with("HTTP/1.1 200"), "{path}: {head}");
        body
    }

    fn attempts(&self) -> Vec<Value> {
        serde_json::from_slice(&self.get("/api/v1/attempts")).unwrap()
    }

    fn begin(&self, client: &mut Client, token: &str) -> Value {
        client.ask(&object!({"id": 1, "type": "benchmark", "scenario": SCENARIO, "controller": "still", "token": token}))
    }

    /// A whole attempt, in binary and at first in JSON; the observations that it began with.
    fn compete(&self) -> Vec<f32> {
        let mut client = self.client();
        client.ask(&object!({"id": 0, "type": "hello", "client": "scan", "token": self.token}));
        let begun = self.begin(&mut client, &self.token);
        let first = begun["observation"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|row| row.as_array().unwrap())
            .map(|v| v.as_f64().unwrap() as f32);
        client.ask(&object!({"id": 2, "type": "step", "action": vec![[0.0; 4]; EPISODES]}));
        for id in 3.. {
            let reply = client.ask_binary(request(id, 2, 0, 1, EPISODES as u32, &le(&[0.0; 4 * EPISODES])));
            if reply[9] & 2 != 0 {
                break;
            }
        }
        assert_eq!(client.ask(&object!({"id": 90_000, "type": "finish"}))["type"], "finished");
        first.collect()
    }

    /// Mistakes, an attempt that is left, a session with someone who watches.
    fn talk(&self) {
        let mut client = self.client();
        assert_eq!(self.begin(&mut client, &self.token[1..])["code"], "bad_token");
        client.ask(&object!({"id": 2, "type": "benchmark", "scenario": "wnd", "controller": "x", "token": self.token}));
        assert_eq!(self.begin(&mut client, &self.token)["type"], "begun");
        client.ask(&object!({"id": 3, "type": "step", "action": [[0, 0, 0, 9]]}));
        client.ask(&object!({"id": 4, "type": "state"}));
        assert_eq!(client.ask(&object!({"id": 5, "type": "finish"}))["code"], "attempt_under_way");
        let made = client.ask(&object!({"id": 6, "type": "make", "num_envs": 2}));
        client.ask_binary(request(7, 1, 0, 0, 2, &[]));
        let mut live = Client::connect_at(self.tap.address, "/live", Some("crazyflie.live.v1"));
        live.send(&object!({"watch": made["session"]}));
        live.receive_binary();
        for id in 8..40 {
            client.ask_binary(request(id, 2, 0, 1, 2, &le(&[0.0; 8])));
        }
        live.receive_binary();
        self.get("/api/v1/sessions");
    }

    /// Reads everything that the server sends over HTTP; returns the number of answers.
    fn read(&self) -> usize {
        let mut paths: Vec<String> =
            ["", "metrics", "healthz", "js/main.js", "api/v1/scenarios", "api/v1/key"]
                .map(|path| format!("/{path}"))
                .into();
        paths.extend([
            format!("/api/v1/leaderboard?scenario={SCENARIO}"),
            format!("/api/v1/attempts?scenario={SCENARIO}"),
            "/api/v1/showcase".into(),
            "/api/v1/overview".into(),
        ]);
        for attempt in self.attempts() {
            let path = format!("/api/v1/attempts/{}", attempt["id"].as_str().unwrap());
            if attempt["status"] == "finished" {
                paths.extend(["actions.bin", "verify"].map(|what| format!("{path}/{what}")));
                let each =
                    |episode| ["replay", "log.csv"].map(|what| format!("{path}/{what}?episode={episode}"));
                paths.extend((0..EPISODES).flat_map(each));
            }
            paths.push(path);
        }
        paths.iter().for_each(|path| drop(self.get(path)));
        // refusals are answers as well
        for path in ["/api/v1/attempts/0/replay", "/api/v1/leaderboard?scenario=wnd", "/nothing"] {
            assert!(get(self.tap.address, path).0.starts_with("HTTP/1.1 404"), "{path}");
        }
        paths.len() + 3
    }
}

#[test]
fn no_secret_is_in_the_traffic() {
    let setup = setup("traffic");
    let first = setup.compete();
    setup.talk();
    let answers = setup.read();
    let attempts = setup.attempts();
    assert_eq!(attempts.len(), 2);
    let mut forbidden = vec![
        ("the evaluation secret".to_owned(), stored_secret(&setup.data, "seed secret")),
        ("the signing key".into(), stored_secret(&setup.data, "signing key")),
        ("the token".into(), setup.token.clone().into_bytes()),
        ("the token's number".into(), hex::decode(&setup.token[4..]).unwrap()),
    ];
    for attempt in &attempts {
        let named = |(i, seed): (usize, &u64)| {
            (format!("seed {i} of {}", attempt["id"]), seed.to_le_bytes().to_vec())
        };
        forbidden.extend(seeds(&setup.data, attempt).iter().enumerate().map(named));
    }
    these_are_the_seeds(&setup.server, &seeds(&setup.data, &attempts[0]), &first);
    let TestSetup { server, tap, .. } = setup;
    server.stop();
    let heard = tap.received();
    let needles = Needles::new(&forbidden);
    for output in &heard {
        assert_eq!(
            needles.find(output),
            None,
            "in {}",
            String::from_utf8_lossy(&output[..output.len().min(200)])
        );
    }
    let bytes: usize = heard.iter().map(Vec::len).sum();
    println!(
        "{} secrets in {} spellings looked for in {bytes} bytes that the server sent over {} connections",
        forbidden.len(),
        needles.all.len(),
        heard.len()
    );
    println!(
        "({answers} answers over HTTP, one attempt of {EPISODES} episodes flown, one left, a session and its watcher): none"
    );
    assert!(bytes > 3_000_000 && heard.len() > answers);
    // a planted secret is found at any place, so the search works
    let mut longest = heard.into_iter().max_by_key(Vec::len).unwrap();
    for (i, (name, needle)) in needles.all.iter().enumerate() {
        let offset = i * 7919 % (longest.len() - needle.len());
        let before: Vec<u8> = longest.splice(offset..offset + needle.len(), needle.iter().copied()).collect();
        assert!(needles.find(&longest).is_some(), "{name} at byte {offset}");
        longest.splice(offset..offset + needle.len(), before);
    }
}

/// Environments begin with these seeds as the attempt did: they are the ones that must stay secret.
fn these_are_the_seeds(server: &Server, seeds: &[u64], first: &[f32]) {
    let scenarios: Vec<Value> = serde_json::from_str(&server.get("/api/v1/scenarios")).unwrap();
    let plan = scenarios.iter().find(|plan| plan["name"] == SCENARIO).unwrap();
    let options = object!({"task": plan["task"], "task_options": plan["task_options"], "vertical": plan["vertical"], "effects": plan["effects"]});
    let mut client = server.connect();
    let made = client.ask(&object!({"id": 1, "type": "make", "num_envs": EPISODES, "options": options}));
    assert_eq!(made["type"], "made", "{made}");
    let bytes: Vec<u8> = seeds.iter().flat_map(|seed| seed.to_le_bytes()).collect();
    let reply = client.ask_binary(request(2, 1, 2, 0, EPISODES as u32, &bytes));
    assert_eq!(floats(&reply[32..]), first, "the seeds are not those of the attempt");
}

/// A server that is made to reveal a seed: OpenEnv's episodes have the names that their clients gave them.
#[test]
fn a_seed_in_the_traffic_is_found() {
    for (name, spell) in [
        ("decimal", (|seed: u64| seed.to_string()) as fn(u64) -> String),
        ("hex", |seed| hex::encode(seed.to_be_bytes())),
    ] {
        let setup = setup(&format!("traffic-{name}"));
        setup.begin(&mut setup.client(), &setup.token);
        let seed_in_reply = seeds(&setup.data, &setup.attempts()[0])[7];
        let mut client = Client::connect(setup.tap.address, None);
        client
            .ask(&object!({"type": "reset", "data": {"episode_id": format!("x{}x", spell(seed_in_reply))}}));
        client.ask(&object!({"type": "state"}));
        drop(client);
        let TestSetup { server, tap, .. } = setup;
        server.stop();
        let needles = Needles::new(&[("seed 7".into(), seed_in_reply.to_le_bytes().into())]);
        let leaks: Vec<&str> =
            tap.received().iter().filter_map(|output| needles.find(output).map(|_| "seed 7")).collect();
        assert_eq!(leaks, ["seed 7"], "{name}");
    }
}
