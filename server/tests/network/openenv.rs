//! The dialect of `openenv-core`, as its server answers; the real package is tested from Python.

use crate::net::{Client, Server};
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::FIELDS;
use crazyflie_env::vector::{StepBuffers, VectorEnv};
use crazyflie_server::serve::{SessionEnd, Settings};
use serde_json::{Value, json};
use tungstenite::Message;

fn row(data: &Value) -> Vec<f32> {
    let observation = &data["observation"];
    let fields = FIELDS.iter().flat_map(|field| observation[field.name].as_array().unwrap());
    fields.map(|v| v.as_f64().unwrap() as f32).collect()
}

#[test]
fn a_conversation_flies_as_in_process() {
    let server = Server::start(Settings::default());
    let mut client = Client::connect(server.address, None);
    let options = r#"{"task": "track", "autoreset": "disabled", "max_episode_steps": 5}"#;
    let mut local = VectorEnv::new(&[Model::thesis()], &Options::parse(options).unwrap(), 1).unwrap();
    let (mut observation, mut reward, mut terminated, mut truncated) = ([0.0; 24], [0.0], [false], [false]);
    let data = json!({"seed": 3, "episode_id": "mine", "env": "CrazyflieTrack-v0", "options": {"max_episode_steps": 5}});
    let first = client.ask(&json!({"type": "reset", "data": data}));
    assert_eq!(
        (&first["type"], &first["data"]["reward"], &first["data"]["done"]),
        (&json!("observation"), &Value::Null, &json!(false))
    );
    local.reset(Some(&[3]), None, &mut observation).unwrap();
    assert_eq!(row(&first["data"]), observation);
    for step in 1..=5 {
        let action = [0.1 * step as f32, -0.2, 0.0, 0.3];
        let reply = client.ask(&json!({"type": "step", "data": {"action": action}}));
        let out = StepBuffers::new(&mut observation, &mut reward, &mut terminated, &mut truncated);
        local.step(&action, out).unwrap();
        assert_eq!(
            (row(&reply["data"]), reply["data"]["reward"].as_f64().unwrap() as f32),
            (observation.to_vec(), reward[0])
        );
        assert_eq!(reply["data"]["done"], json!(step == 5));
    }
    let state = client.ask(&json!({"type": "state"}));
    assert_eq!((&state["data"]["episode_id"], &state["data"]["step_count"]), (&json!("mine"), &json!(5)));
    let over = client.ask(&json!({"type": "step", "data": {"action": [0, 0, 0, 0]}}));
    assert_eq!((&over["type"], &over["data"]["code"]), (&json!("error"), &json!("EXECUTION_ERROR")));
    assert_eq!(client.ask(&json!({"type": "reset", "data": {}}))["type"], "observation");
    client.send(&json!({"type": "close"}));
    assert!(matches!(client.ws.read(), Ok(Message::Close(_)) | Err(_)));
    let report = server.stop();
    assert_eq!((report.ended[&SessionEnd::Closed], report.sessions), (1, 1));
}

#[test]
fn an_observation_holds_the_fields_that_were_asked_for() {
    let server = Server::start(Settings::default());
    let mut client = Client::connect(server.address, None);
    let reset = |options: Value| json!({"type": "reset", "data": {"seed": 1, "options": options}});
    let first = client.ask(&reset(json!({"observation": ["vel_mps", "error_m"], "history": 2})));
    let seen = &first["data"]["observation"];
    assert_eq!(seen["vel_mps"], json!([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]));
    assert_eq!(seen["error_m"].as_array().unwrap().len(), 2);
    assert_eq!(seen.as_object().unwrap().len(), 4, "two fields and two flags");
    let step = json!({"type": "step", "data": {"action": [0.5, 0, 0, 0]}});
    let next = client.ask(&step);
    let velocity = &next["data"]["observation"]["vel_mps"];
    assert_eq!(velocity[0], json!([0.0, 0.0, 0.0]), "the older tick comes first");
    assert_ne!(velocity[1], velocity[0]);
    assert_eq!(client.ask(&step)["data"]["observation"]["vel_mps"][0], velocity[1]);
    let state = client.ask(&reset(json!({"observation": "state"})));
    assert_eq!(state["data"]["observation"]["pos_m"].as_array().unwrap().len(), 3);
    let bad = client.ask(&reset(json!({"observation": ["vel_mp"]})));
    assert!(bad["data"]["message"].as_str().unwrap().contains("did you mean \"vel_mps\""), "{bad}");
}

#[test]
fn mistakes_have_the_codes_of_openenv() {
    let server = Server::start(Settings::default());
    let mut client = Client::connect(server.address, None);
    for (text, code) in [
        ("{", "INVALID_JSON"),
        (r#"{"type": "reset", "data": {"seed": NaN}}"#, "INVALID_JSON"),
        ("[1]", "UNKNOWN_TYPE"),
        ("3", "VALIDATION_ERROR"),
        (r#"{"type": "jump"}"#, "UNKNOWN_TYPE"),
        (r#"{}"#, "UNKNOWN_TYPE"),
        (r#"{"type": "step", "data": {"action": [0, 0, 0, 0]}}"#, "EXECUTION_ERROR"),
        (r#"{"type": "state"}"#, "EXECUTION_ERROR"),
        (r#"{"type": "step", "data": {"action": [0, 0, 0]}}"#, "VALIDATION_ERROR"),
        (r#"{"type": "step"}"#, "VALIDATION_ERROR"),
        (r#"{"type": "reset", "data": {"env": "Crazyfly-v0"}}"#, "VALIDATION_ERROR"),
        (r#"{"type": "reset", "data": {"seed": -1}}"#, "VALIDATION_ERROR"),
    ] {
        client.ws.send(Message::text(text)).unwrap();
        let reply = client.receive();
        assert_eq!(
            (&reply["type"], &reply["data"]["code"]),
            (&json!("error"), &json!(code)),
            "{text}: {reply}"
        );
    }
    client.ws.send(Message::binary(vec![1, 2])).unwrap();
    assert_eq!(client.receive()["data"]["code"], "VALIDATION_ERROR");
    assert_eq!(client.ask(&json!({"type": "reset", "data": {"seed": 1}}))["type"], "observation");
    assert_eq!(
        client.ask(&json!({"type": "step", "data": {"action": [5, 0, 0, 0]}}))["data"]["code"],
        "VALIDATION_ERROR"
    );
    assert_eq!(client.ask(&json!({"type": "step", "data": {"action": [1, 0, 0, 0]}}))["type"], "observation");
}
