//! Environments over a real socket are those of the library, bit for bit; mistakes are answered and the
//! session lives.

use crate::net::{Client, Server, floats, le, request};
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};
use crazyflie_server::serve::{SessionEnd, Settings};
use serde_json::{Value, json};

const OPTIONS: &str = r#"{"task": "hover", "autoreset": "same_step", "max_episode_steps": 7,
    "effects": {"gust": {"sigma_mps2": 0.5}, "camera_noise": 0.01, "mass_change": {"uniform": [-0.002, 0.002]}}}"#;

/// Actions that differ between steps and environments.
fn actions(step: usize, envs: usize) -> Vec<f32> {
    (0..envs * 4).map(|i| ((step * 31 + i * 7) % 41) as f32 / 20.5 - 1.0).collect()
}

/// The same rollout in this process: per step observations, rewards, states, finals, terminated, truncated.
struct Local {
    env: VectorEnv,
    n: usize,
}

struct Row {
    observations: Vec<f32>,
    rewards: Vec<f32>,
    states: Vec<f32>,
    finals: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Local {
    fn new(options: &str, n: usize) -> Local {
        Local { env: VectorEnv::new(&[Model::thesis()], &Options::parse(options).unwrap(), n).unwrap(), n }
    }

    fn reset(&mut self, seeds: &[u64]) -> Vec<f32> {
        let mut observations = vec![0.0; self.n * 24];
        self.env.reset(Some(seeds), None, &mut observations).unwrap();
        observations
    }

    fn step(&mut self, actions: &[f32]) -> Row {
        let n = self.n;
        let (observations, rewards, states) = (vec![0.0; n * 24], vec![0.0; n], vec![0.0; n * STATE]);
        let mut row = Row {
            observations,
            rewards,
            states,
            finals: vec![],
            terminated: vec![false; n],
            truncated: vec![false; n],
        };
        let out = StepBuffers::new(
            &mut row.observations,
            &mut row.rewards,
            &mut row.terminated,
            &mut row.truncated,
        );
        self.env.step(actions, out).unwrap();
        self.env.states(&mut row.states).unwrap();
        for env in (0..n).filter(|i| row.terminated[*i] | row.truncated[*i]) {
            if let Some((observation, state)) = self.env.last_of_episode(env) {
                row.finals.extend(observation.iter().chain(state));
            }
        }
        row
    }
}

fn make(client: &mut Client, options: &str, num_envs: usize) -> Value {
    let made =
        client.ask(&json!({"id": 1, "type": "make", "options": serde_json::from_str::<Value>(options).unwrap(), "num_envs": num_envs}));
    assert_eq!(made["type"], "made", "{made}");
    made
}

fn seeds(n: usize) -> Vec<u64> {
    (0..n as u64).map(|i| i * 1_000_000_007 + 3).collect()
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|n| n.to_bits()).collect()
}

/// Checks a reply with true states: header, observations, rewards, states, finals, terminated, truncated.
fn check_reply(reply: &[u8], id: u64, ticks: u64, n: usize, rows: &[Row]) {
    let k = rows.len();
    let join = |f: fn(&Row) -> &Vec<f32>| bits(&rows.iter().flat_map(f).copied().collect::<Vec<_>>());
    let finals = join(|r| &r.finals).len() / 36;
    assert_eq!(reply[..8], id.to_le_bytes());
    assert_eq!(reply[8..12], [0x82, 1, k as u8, 0]);
    assert_eq!(reply[12..16], (n as u32).to_le_bytes());
    assert_eq!(reply[16..24], (finals as u64).to_le_bytes());
    assert_eq!(reply[24..32], ticks.to_le_bytes());
    let numbers = bits(&floats(&reply[32..32 + 4 * (k * n * (24 + 1 + 12) + finals * 36)]));
    let want =
        [join(|r| &r.observations), join(|r| &r.rewards), join(|r| &r.states), join(|r| &r.finals)].concat();
    assert!(numbers == want, "the numbers differ");
    let flags: Vec<u8> = rows
        .iter()
        .flat_map(|r| &r.terminated)
        .chain(rows.iter().flat_map(|r| &r.truncated))
        .map(|b| u8::from(*b))
        .collect();
    assert_eq!(&reply[32 + 4 * numbers.len()..], flags);
}

#[test]
fn binary_batches_fly_as_in_process() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    for n in [1, 5, 16, 37] {
        let made = make(&mut client, OPTIONS, n);
        assert_eq!(made["num_envs"], n);
        let (mut local, seeds) = (Local::new(OPTIONS, n), seeds(n));
        let payload: Vec<u8> = seeds.iter().flat_map(|s| s.to_le_bytes()).collect();
        let reply = client.ask_binary(request(1, 1, 2, 0, n as u32, &payload));
        assert_eq!(reply[8], 0x81);
        assert_eq!(bits(&floats(&reply[32..])), bits(&local.reset(&seeds)));
        let (mut step, mut ended) = (0, 0);
        for (id, k) in [1, 1, 3, 4, 1, 9].into_iter().enumerate() {
            let batches: Vec<_> = (step..step + k).map(|s| actions(s, n)).collect();
            let rows: Vec<_> = batches.iter().map(|a| local.step(a)).collect();
            step += k;
            ended += rows.iter().map(|r| r.finals.len() / 36).sum::<usize>();
            let id = id as u64 + 2;
            let reply = client.ask_binary(request(id, 2, 1, k as u16, n as u32, &le(&batches.concat())));
            check_reply(&reply, id, step as u64, n, &rows);
        }
        assert!(ended >= 2 * n, "no episode ended: nothing was tested of ends");
    }
    assert_eq!(server.stop().ended[&SessionEnd::Broken], 0);
}

#[test]
fn json_flies_as_in_process() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    make(&mut client, OPTIONS, 3);
    let mut local = Local::new(OPTIONS, 3);
    let numbers = |v: &Value| -> Vec<u32> {
        let rows = v.as_array().unwrap().iter();
        rows.flat_map(|row| row.as_array().cloned().unwrap_or(vec![row.clone()]))
            .map(|v| (v.as_f64().unwrap() as f32).to_bits())
            .collect()
    };
    let first = client.ask(&json!({"id": 2, "type": "reset", "seed": 9}));
    assert_eq!(numbers(&first["observation"]), bits(&local.reset(&[9, 10, 11])));
    for step in 0..9 {
        let (given, id) = (actions(step, 3), step + 3);
        let action: Vec<_> = given.chunks(4).collect();
        let row = local.step(&given);
        let reply = client.ask(&json!({"id": id, "type": "step", "action": action, "states": true}));
        assert_eq!((&reply["id"], &reply["type"]), (&json!(id), &json!("result")));
        assert_eq!(numbers(&reply["observation"]), bits(&row.observations));
        assert_eq!(numbers(&reply["reward"]), bits(&row.rewards));
        assert_eq!(numbers(&reply["state"]), bits(&row.states));
        assert_eq!(
            (&reply["terminated"], &reply["truncated"]),
            (&json!(row.terminated), &json!(row.truncated))
        );
        let finals = reply["final"].as_array().cloned().unwrap_or_default();
        let sent: Vec<u32> =
            finals.iter().flat_map(|f| [numbers(&f["observation"]), numbers(&f["state"])].concat()).collect();
        assert_eq!(sent, bits(&row.finals));
    }
    assert_eq!(client.ask(&json!({"id": 99, "type": "close"})), json!({"type": "closed", "id": 99}));
    assert_eq!(client.ask(&json!({"id": 100, "type": "state"}))["code"], "no_session");
}

#[test]
fn requests_in_flight_are_answered_in_order() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    make(&mut client, OPTIONS, 2);
    client.ask_binary(request(1, 1, 0, 0, 2, &[]));
    let mut local = Local::new(OPTIONS, 2);
    local.reset(&[0, 0]);
    for id in 2..66 {
        client
            .ws
            .write(tungstenite::Message::binary(request(id, 2, 1, 1, 2, &le(&actions(id as usize, 2)))))
            .unwrap();
    }
    client.ws.flush().unwrap();
    for id in 2..66 {
        check_reply(&client.receive_binary(), id, id - 1, 2, &[local.step(&actions(id as usize, 2))]);
    }
}
