//! Requests of the page before anybody flies, and after somebody has flown by hand.

use crate::net::{Server, eventually, floats, get};
use crazyflie_server::serve::Settings;
use serde_json::{Value, json};

fn json_of(server: &Server, path: &str) -> Value {
    serde_json::from_str(&server.get(path)).unwrap()
}

#[test]
fn a_server_shows_a_flight_and_says_that_nothing_extends_it() {
    let server = Server::start(Settings::default());
    let (head, frames) = get(server.address, "/api/v1/showcase");
    assert!(head.starts_with("HTTP/1.1 200") && head.contains("etag: \""), "{head}");
    let length = u32::from_le_bytes(*frames.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&frames[4..4 + length]).unwrap();
    let (drones, width) =
        (header["drones"].as_u64().unwrap() as usize, header["columns"].as_array().unwrap().len());
    let rows = floats(&frames[4 + length..]);
    assert_eq!(rows.len(), drones * width * header["rows"].as_u64().unwrap() as usize);
    assert_eq!((drones, &header["showcase"]), (8, &Value::Null));
    assert_eq!(get(server.address, "/api/v1/showcase").1, frames);
    // nobody's session: it is listed and counted nowhere
    assert_eq!(json_of(&server, "/api/v1/sessions"), json!([]));
    assert_eq!(server.metric("crazyflie_env_steps_total"), 0.0);
    assert_eq!(json_of(&server, "/api/v1/extensions"), json!([]));
    assert!(get(server.address, "/api/v1/overview").0.starts_with("HTTP/1.1 404"));
    assert!(server.get("/protocol.md").starts_with("# The protocol"));
}

#[test]
fn a_flight_by_hand_is_listed_with_the_figures_of_what_was_flown() {
    let server = Server::start(Settings::default());
    let mut pilot = server.connect();
    let options =
        json!({"drones": 2, "max_episode_steps": 200, "vertical": "height", "effects": {"drag_linear": 0.3}});
    pilot.ask(&json!({"id": 1, "type": "world", "name": "hand", "mission": "formation", "options": options}));
    let joined = pilot.ask(&json!({"id": 2, "type": "join", "name": "hand", "drone": 1}));
    assert_eq!(joined["type"], "joined", "{joined}");
    assert_eq!(json_of(&server, "/api/v1/flown"), json!([]), "nothing is flown yet");
    let mut squares_m2 = Vec::new();
    for tick in 0..60 {
        let tilt = f64::from(tick) / 300.0;
        let flown = pilot.ask(&json!({"id": 3 + tick, "type": "fly", "action": [tilt, 0.0, 0.0, 0.1]}));
        let observation: Vec<f64> =
            flown["observation"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
        // sensors are ideal: the first numbers are the true place
        squares_m2.push((0..3).map(|axis| (observation[axis] - observation[16 + axis]).powi(2)).sum::<f64>());
    }
    assert_eq!(json_of(&server, "/api/v1/flown"), json!([]), "it is still flown");
    assert_eq!(pilot.ask(&json!({"id": 99, "type": "leave"}))["type"], "left");
    eventually("the flight in the list", || json_of(&server, "/api/v1/flown") != json!([]));
    let rows = json_of(&server, "/api/v1/flown");
    let row = &rows[0];
    println!("{row}");
    assert_eq!(rows.as_array().unwrap().len(), 1, "the autopilot's flight is none by hand");
    assert_eq!(
        (&row["world"], &row["drone"], &row["mission"], &row["end"], &row["effects"]),
        (&json!("hand"), &json!(1), &json!("formation"), &Value::Null, &json!(["drag_linear"]))
    );
    let rms_m = (squares_m2.iter().sum::<f64>() / squares_m2.len() as f64).sqrt();
    assert!((row["rms_m"].as_f64().unwrap() - rms_m).abs() < 1e-5, "{rms_m}");
    assert!((row["duration_s"].as_f64().unwrap() - 1.2).abs() < 1e-9);
    assert!(row["autopilot_rms_m"].as_f64().unwrap() < rms_m && row["late_share"] == 0.0);
    // the autopilot's ticks from then on are not the pilot's
    eventually("the end of the world", || json_of(&server, "/api/v1/worlds")[0]["over"] == json!(true));
    assert_eq!(json_of(&server, "/api/v1/flown"), rows);
}
