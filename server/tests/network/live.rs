//! Watching: what is shown is what flies, only the newest, and a watcher who does not look costs the session
//! nothing.

use std::io::Read;
use std::time::{Duration, Instant};

use crate::net::{Client, Server, floats, le, request};
use crazyflie_server::serve::Settings;
use serde_json::{Value, json};
use tungstenite::Message;

/// A session of `n` environments, reset.
fn session(server: &Server, n: u32) -> (Client, String) {
    let mut client = server.connect();
    let effects = json!({"markers": {"columns": 2, "rows": 1, "pitch_m": 1}, "camera_fov": 120});
    let made = client.ask(&json!({"id": 1, "type": "make", "num_envs": n, "options": {"effects": effects, "autoreset": "same_step"}}));
    client.ask_binary(request(2, 1, 0, 0, n, &[]));
    (client, made["session"].as_str().unwrap().to_owned())
}

fn watcher(server: &Server) -> Client {
    Client::connect_at(server.address, "/live", Some("crazyflie.live.v1"))
}

fn watch(client: &mut Client, session: &str, env: usize) -> Value {
    client.send(&json!({"watch": session, "env": env}));
    let bytes = client.receive_binary();
    let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
    assert!(bytes.len().is_multiple_of(4) && bytes.len() - 4 - length < 4);
    serde_json::from_slice(&bytes[4..4 + length]).unwrap()
}

fn watching(server: &Server) -> u64 {
    let rows: Value = serde_json::from_str(&server.get("/api/v1/sessions")).unwrap();
    rows.as_array().unwrap().iter().map(|row| row["watching"].as_u64().unwrap()).sum()
}

#[test]
fn a_watcher_sees_the_newest_row() {
    let server = Server::start(Settings::default());
    let (mut client, name) = session(&server, 20);
    let mut live = watcher(&server);
    let header = watch(&mut live, &name, 3);
    assert_eq!(
        (&header["session"], &header["tick_s"], &header["env_id"]),
        (&json!(name), &json!(0.02), &json!("Crazyflie-v0"))
    );
    assert_eq!(
        (&header["camera"]["fov_deg"], &header["marker"]),
        (&json!(120.0), &json!([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]))
    );
    let columns: Vec<&str> =
        header["columns"].as_array().unwrap().iter().map(|c| c.as_str().unwrap()).collect();
    assert_eq!(columns.len(), 25);
    let rows: Value = serde_json::from_str(&server.get("/api/v1/sessions")).unwrap();
    let row = &rows[0];
    assert_eq!(
        (&row["session"], &row["env"], &row["num_envs"], &row["watching"]),
        (&json!(name), &json!("Crazyflie-v0"), &json!(20), &json!(1))
    );
    let mut reply = vec![];
    for step in 0..5 {
        reply = client.ask_binary(request(3 + step, 2, 1, 1, 20, &le(&[0.2; 80])));
    }
    let numbers = floats(&reply[32..32 + 4 * 20 * (24 + 1 + 12)]);
    let (observation, reward, state) =
        (&numbers[3 * 24..4 * 24], numbers[20 * 24 + 3], &numbers[20 * 25 + 36..20 * 25 + 48]);
    let shown = loop {
        let row = floats(&live.receive_binary());
        assert_eq!(row.len(), 25);
        if row[0] > 0.099 {
            break row;
        }
    };
    let value = |name: &str| shown[columns.iter().position(|c| *c == name).unwrap()];
    let names = ["x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw"];
    assert_eq!(names.map(value), state[..9]);
    assert_eq!(["fix_x", "fix_y", "fix_z", "fix_yaw", "fix_age_s", "fix_valid"].map(value), observation[..6]);
    assert_eq!(["setpoint_x", "setpoint_y", "setpoint_z", "setpoint_yaw"].map(value), observation[16..20]);
    assert_eq!((value("t_s"), value("reward")), (0.1, reward));
    assert!((value("u_roll") - 0.2 * 10.0_f32.to_radians()).abs() < 1e-6);
    client.ask(&json!({"id": 99, "type": "close"}));
    assert_eq!(live.receive(), json!({"type": "ended", "session": name}));
    live.send(&json!({"watch": name}));
    assert_eq!(live.receive()["code"], "unknown_session");
    live.send(&json!({"watch": 7}));
    assert_eq!(live.receive()["code"], "bad_message");
}

#[test]
fn rows_come_at_most_thirty_times_a_second() {
    let server = Server::start(Settings::default());
    let (mut client, name) = session(&server, 1);
    let mut live = watcher(&server);
    watch(&mut live, &name, 0);
    let began = Instant::now();
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    let stepping = std::thread::spawn(move || {
        let mut id = 2;
        while stopped.try_recv() == Err(std::sync::mpsc::TryRecvError::Empty) {
            id += 1;
            client.ask_binary(request(id, 2, 0, 1, 1, &le(&[0.0; 4])));
        }
        id - 2
    });
    (0..30).for_each(|_| drop(live.receive_binary()));
    let took_s = began.elapsed().as_secs_f64();
    drop(stop);
    let steps = stepping.join().unwrap();
    println!("30 rows of {steps} steps in {took_s:.2} s");
    assert!(took_s > 28.0 / 30.0 && steps >= 28, "{steps} steps in {took_s} s");
}

#[test]
fn a_watcher_who_does_not_look_slows_nothing() {
    let server = Server::start(Settings::default());
    let (mut client, name) = session(&server, 64);
    let mut id = 2;
    let mut steps_in_a_moment = |client: &mut Client| {
        let (began, mut steps) = (Instant::now(), 0);
        while began.elapsed() < Duration::from_millis(60) {
            id += 1;
            client.ask_binary(request(id, 2, 0, 1, 64, &le(&[0.0; 256])));
            steps += 1;
        }
        steps
    };
    // the best of many short times
    let mut fastest = |client: &mut Client| (0..15).map(|_| steps_in_a_moment(client)).max().unwrap();
    let alone = fastest(&mut client);
    let mut sleepers: Vec<Client> = (0..20).map(|_| watcher(&server)).collect();
    for live in &mut sleepers {
        live.send(&json!({"watch": name}));
    }
    crate::net::eventually("twenty watchers", || watching(&server) == 20);
    let fast = crate::net::once(|| {
        let watched = fastest(&mut client);
        println!("{alone} steps in 60 ms alone, {watched} with twenty watchers who do not read");
        watched * 2 > alone
    });
    assert!(fast, "watchers slow it");
    // one cuts the line in the middle
    let mut cut = sleepers.remove(0);
    let _ = cut.ws.get_mut().read(&mut [0; 10]);
    drop(cut);
    crate::net::eventually("a closed tab is noticed", || watching(&server) == 19);
    for live in &mut sleepers {
        assert!(matches!(live.ws.read().unwrap(), Message::Binary(_)));
    }
    drop(sleepers);
    crate::net::eventually("all are gone", || watching(&server) == 0);
}
