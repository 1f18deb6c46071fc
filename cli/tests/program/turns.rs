//! Turns at the processor: whatever four connections do without end, an honest client beside them keeps its share. And
//! what the log and secrets are protected from. Prints its figures.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::net::{Client, Server, eventually, le, once, request};
use crate::process::Process;
use crazyflie_server::serve::Settings;
use serde_json::json;
use tungstenite::Message;

const ATTACKERS: usize = 4;

/// Octets that are sent again and again, over a connection that speaks this.
struct Flood {
    name: &'static str,
    path: &'static str,
    protocol: Option<&'static str>,
    octets: Vec<u8>,
}

/// A frame of a client, with a mask of zeros.
fn frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x80 | opcode, 0x80 | payload.len() as u8, 0, 0, 0, 0];
    bytes.extend(payload);
    bytes
}

fn floods() -> Vec<Flood> {
    let flood =
        |name, path, protocol, octets: &[u8]| Flood { name, path, protocol, octets: octets.repeat(500) };
    let (v1, live) = (Some("crazyflie.v1"), Some("crazyflie.live.v1"));
    vec![
        flood("pongs", "/ws", v1, &frame(10, b"")),
        flood("pings", "/ws", v1, &frame(9, b"x")),
        flood("echo", "/ws", Some("crazyflie.echo.v1"), &frame(2, b"x")),
        flood("live", "/live", live, &frame(1, br#"{"watch": null}"#)),
        flood("live errors", "/live", live, &frame(1, b"{}")),
        flood("hello", "/ws", v1, &frame(1, br#"{"id": 1, "type": "hello", "client": "x"}"#)),
        flood("healthz", "", None, b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n"),
    ]
}

impl Flood {
    fn run(&self, address: SocketAddr, stop: &AtomicBool) {
        let mut stream = match self.protocol {
            None => TcpStream::connect(address).unwrap(),
            protocol => Client::connect_at(address, self.path, protocol).ws.get_ref().try_clone().unwrap(),
        };
        let mut answers = stream.try_clone().unwrap();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let mut bytes = vec![0; 1 << 16];
                while answers.read(&mut bytes).is_ok_and(|read| read > 0) {}
            });
            while !stop.load(Ordering::Relaxed) && stream.write_all(&self.octets).is_ok() {}
            let _ = stream.shutdown(std::net::Shutdown::Both);
        });
    }
}

/// Steps a second of an honest client, one request at a time, and the 99th percentile of its times in ms.
fn fly_honestly(address: SocketAddr) -> (f64, f64) {
    let mut honest = Client::connect(address, Some("crazyflie.v1"));
    assert_eq!(honest.ask(&json!({"id": 1, "type": "make", "num_envs": 1}))["type"], "made");
    honest.ask_binary(request(2, 1, 0, 0, 1, &[]));
    let (began, mut times_ms) = (Instant::now(), Vec::new());
    while began.elapsed() < Duration::from_secs(1) {
        let asked = Instant::now();
        honest.ask_binary(request(3 + times_ms.len() as u64, 2, 0, 1, 1, &le(&[0.0; 4])));
        times_ms.push(asked.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    (times_ms.len() as f64 / began.elapsed().as_secs_f64(), times_ms[times_ms.len() * 99 / 100])
}

/// Returns the part of its fair share that an honest client keeps beside a flood.
fn share_beside(flood: &Flood, process: &Process) -> f64 {
    let (alone, _) = fly_honestly(process.address);
    let stop = Arc::new(AtomicBool::new(false));
    let (beside, p99_ms) = std::thread::scope(|scope| {
        for _ in 0..ATTACKERS {
            scope.spawn(|| flood.run(process.address, &stop));
        }
        std::thread::sleep(Duration::from_millis(200));
        let measured = fly_honestly(process.address);
        stop.store(true, Ordering::Relaxed);
        measured
    });
    let share = beside / (alone / (ATTACKERS + 1) as f64);
    println!(
        "{}: {alone:.0} steps/s alone, {beside:.0} beside (p99 {p99_ms:.2} ms), {share:.2} of a fair share",
        flood.name
    );
    share
}

#[test]
fn whoever_floods_gets_turns_like_everybody() {
    let process = Process::start(&["--log", "error"]);
    for flood in floods() {
        assert!(once(|| share_beside(&flood, &process) >= 0.4), "{}", flood.name);
    }
}

#[test]
fn the_log_is_quiet_about_what_a_client_repeats() {
    let file = crate::common::folder("quiet").join("log");
    let process =
        Process::start_logging(&["--log", "info"], Stdio::from(std::fs::File::create(&file).unwrap()));
    let mut client = process.client();
    for _ in 0..50 {
        for id in 0..100 {
            let hello = json!({"id": id, "type": "hello", "client": "x"});
            client.ws.write(Message::text(hello.to_string())).unwrap();
        }
        client.ws.flush().unwrap();
        (0..100).for_each(|_| assert_eq!(client.receive()["type"], "welcome"));
    }
    (0..200).for_each(|_| drop(process.client()));
    let bytes = std::fs::metadata(&file).unwrap().len();
    println!("5000 hellos and 200 connections: {bytes} bytes of log");
    assert!(bytes > 0 && bytes < 60_000, "{bytes} bytes");
}

#[test]
fn an_invitation_is_not_guessed() {
    let server = Server::start(Settings::default());
    let mut host = server.connect();
    let world = |word: &str| json!({"id": 1, "type": "world", "name": "private", "mission": "swap", "invitation": word});
    assert_eq!(host.ask(&world("sesame!"))["code"], "bad_options", "seven characters are too few");
    assert_eq!(host.ask(&world("open sesame"))["type"], "world");
    let join = |client: &mut Client, word: &str| {
        client.ask(&json!({"id": 2, "type": "join", "name": "private", "invitation": word}))["code"].clone()
    };
    // a join with the right word is no guess
    for _ in 0..40 {
        assert_ne!(join(&mut server.connect(), "open sesame"), "not_invited");
    }
    let mut guesser = server.connect();
    for guess in 0..30 {
        assert_eq!(join(&mut guesser, &format!("guess {guess}")), "not_invited");
    }
    assert_eq!(join(&mut server.connect(), "open sesame"), "too_many", "not even the right one");
    eventually("counted", || {
        server.metric("crazyflie_limits_reached_total{reason=\"too many wrong invitations\"}") == 1.0
    });
}

#[cfg(feature = "bench")]
#[test]
fn a_token_that_the_benchmark_knows_has_a_share_beside_its_address() {
    let data = crate::common::folder("own-share").join("bench.sqlite");
    let data = crate::common::text(&data);
    let token =
        crate::common::json(&["bench", "token", "create", "pupils", "--json", "--data", data])["token"]
            .clone();
    let process = Process::start(&["--log", "error", "--data", data, "--envs-per-address", "200"]);
    let mut hog = process.client();
    assert_eq!(hog.ask(&json!({"id": 1, "type": "make", "num_envs": 200}))["type"], "made");
    let make = |token: &serde_json::Value| {
        let mut client = process.client();
        let hello = json!({"id": 1, "type": "hello", "client": "x", "token": token});
        assert_eq!(client.ask(&hello)["type"], "welcome");
        client.ask(&json!({"id": 2, "type": "make", "num_envs": 150}))
    };
    assert_eq!(make(&json!("invented"))["code"], "too_many");
    assert_eq!(make(&token)["type"], "made");
}
