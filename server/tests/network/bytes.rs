//! Bytes that a connection makes the server keep, whatever it speaks: each kind of them within its budget, and none for
//! ever.

use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use crate::net::{Client, Server, eventually};
use crate::raw::{self, BINARY, PONG, frame};
use crazyflie_server::serve::{Limits, Settings, Shares};
use serde_json::json;
use tungstenite::Message;

/// A message of this size is more than is free, and four of them are more than [`LITTLE`].
const LARGE: usize = 300_000;
const LITTLE: usize = 1 << 20;

fn start(limits: Limits) -> Server {
    Server::start(Settings { limits, ..Settings::default() })
}

fn held(server: &Server, resource: &str) -> f64 {
    server.metric(&format!("crazyflie_held{{resource=\"{resource}\"}}"))
}

/// The first part of a message, and nothing more.
fn begin_message(server: &Server, protocol: &str) -> TcpStream {
    let mut stream = raw::connect(server.address, protocol);
    stream.write_all(&frame(BINARY, &vec![0; LARGE]).fin(false).bytes()).unwrap();
    stream
}

/// The code with which the server closes a connection.
fn close_code(stream: &mut TcpStream) -> u16 {
    loop {
        let (first, payload) = raw::read(stream).unwrap().expect("a close frame");
        if first == 0x88 {
            return u16::from_be_bytes([payload[0], payload[1]]);
        }
    }
}

#[test]
fn unfinished_messages_are_counted() {
    let server = start(Limits { request_bytes: Shares::even(LITTLE), ..Limits::default() });
    let unfinished = begin_message(&server, "crazyflie.v1");
    eventually("the first part is counted", || held(&server, "RequestBytes") > LARGE as f64);
    // the next one is too much, in every dialect
    for protocol in ["crazyflie.v1", "crazyflie.echo.v1"] {
        assert_eq!(close_code(&mut begin_message(&server, protocol)), 1013, "{protocol}");
    }
    // a small message is not
    assert_eq!(server.connect().ask(&json!({"id": 1, "type": "hello", "client": "x"}))["type"], "welcome");
    drop(unfinished);
    eventually("given back", || held(&server, "RequestBytes") == 0.0);
}

#[test]
fn a_message_must_become_complete_whatever_lies_between() {
    let limits = Limits { message_timeout: Duration::from_millis(400), ..Limits::default() };
    let server = start(limits);
    let mut stream = begin_message(&server, "crazyflie.v1");
    let mut writer = stream.try_clone().unwrap();
    let pongs = std::thread::spawn(move || {
        let pong = frame(PONG, b"still here").bytes();
        while writer.write_all(&pong).is_ok() {
            std::thread::sleep(Duration::from_millis(50));
        }
    });
    assert_eq!(close_code(&mut stream), 1008);
    drop(stream);
    pongs.join().unwrap();
    // silence between whole messages is no message
    let mut client = server.connect();
    client.ask(&json!({"id": 1, "type": "hello", "client": "x"}));
    std::thread::sleep(Duration::from_millis(900));
    assert_eq!(client.ask(&json!({"id": 2, "type": "hello", "client": "x"}))["type"], "welcome");
}

#[test]
fn echoes_are_replies() {
    let limits = Limits { reply_bytes: Shares::even(LITTLE), ..Limits::default() };
    let server = start(limits);
    let echo = || Client::connect(server.address, Some("crazyflie.echo.v1"));
    let mut clients: Vec<Client> = (0..3).map(|_| echo()).collect();
    for client in &mut clients {
        client.ws.send(Message::binary(vec![7; LARGE])).unwrap();
        assert_eq!(client.receive_binary().len(), LARGE);
    }
    assert!(held(&server, "ReplyBytes") > 2.0 * LARGE as f64, "the buffers stay");
    let mut refused = echo();
    refused.ws.send(Message::binary(vec![7; LARGE])).unwrap();
    assert_eq!(refused.close_code(), Some(1013));
    drop(clients);
    eventually("given back", || held(&server, "ReplyBytes") == 0.0);
}

#[test]
fn who_takes_no_echo_and_no_pong_is_cut_off() {
    let limits = Limits { write_timeout: Duration::from_millis(300), ..Limits::default() };
    let server = start(limits);
    for payload in [frame(BINARY, &vec![7; LARGE]), frame(raw::PING, &[7; 125])] {
        let before = server.metric("crazyflie_connections_refused_total{reason=\"stalled\"}");
        let mut stream = raw::connect(server.address, "crazyflie.echo.v1");
        let bytes = payload.bytes();
        // until the buffers of the system are full, and the server does not read on
        while stream.write_all(&bytes).is_ok() {}
        eventually("cut off", || {
            server.metric("crazyflie_connections_refused_total{reason=\"stalled\"}") > before
        });
    }
}

/// A world of many drones that has been flown for so many ticks.
fn fly_world(server: &Server, ticks: usize) {
    let mut client = server.connect();
    let options = json!({"drones": 64, "max_episode_steps": 1900});
    let world = json!({"id": 1, "type": "world", "name": "long", "mission": "swap", "options": options,
        "deadline_s": 10, "seed": 7});
    assert_eq!(client.ask(&world)["type"], "world");
    assert_eq!(client.ask(&json!({"id": 2, "type": "join", "name": "long"}))["type"], "joined");
    for _ in 0..ticks {
        let flown = client.ask(&json!({"id": 3, "type": "fly", "action": [0.0, 0.0, 0.0, 0.07]}));
        assert_eq!(flown["type"], "flown", "{flown}");
    }
}

#[test]
fn a_log_is_sent_in_parts_and_who_does_not_read_it_is_cut_off() {
    let limits = Limits {
        world_work: Shares::even(1_000_000),
        write_timeout: Duration::from_millis(300),
        world_unpiloted: Duration::from_millis(1),
        ..Limits::default()
    };
    let server = start(limits);
    fly_world(&server, 1800);
    eventually("the world is over", || server.get("/api/v1/sessions") == "[]");
    let log = server.get("/api/v1/worlds/long/log");
    let (bytes, lines) = (log.len(), log.lines().count());
    println!("a log of {bytes} bytes, {lines} lines");
    assert!(lines >= 1802 && bytes > 8_000_000, "{lines} lines of {bytes} bytes");
    let lazy: Vec<TcpStream> = (0..20)
        .map(|_| {
            let mut stream = TcpStream::connect(server.address).unwrap();
            write!(stream, "GET /api/v1/worlds/long/log HTTP/1.1\r\nhost: {}\r\n\r\n", server.address)
                .unwrap();
            stream
        })
        .collect();
    eventually("they are cut off", || {
        server.metric("crazyflie_connections_refused_total{reason=\"stalled\"}") == 20.0
    });
    eventually("and their work has ended", || held(&server, "ReplyBytes") == 0.0);
    drop(lazy);
    // the limit allows this many bytes
    assert_eq!(server.get("/api/v1/worlds/long/log").len(), bytes);
}

#[test]
fn readers_of_logs_share_the_bytes_of_replies() {
    let server = start(Limits { reply_bytes: Shares::even(100_000), ..Limits::default() });
    fly_world(&server, 1);
    let (head, body) = crate::net::get(server.address, "/api/v1/worlds/long/log");
    assert!(head.starts_with("HTTP/1.1 503"), "{head}");
    let error: serde_json::Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(error["code"], "too_many", "{error}");
}
