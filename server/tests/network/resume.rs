//! Lost connections: a session waits for its client and goes on exactly; nothing is stepped twice; whatever
//! the network does, every session ends.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::net::{Client, PATIENCE, Server, eventually, le, request};
use crazyflie_server::serve::{Limits, SessionEnd, Settings};
use serde_json::{Value, json};
use tungstenite::Message;

fn settings(resume_ms: u64) -> Settings {
    Settings {
        limits: Limits { resume_for: Duration::from_millis(resume_ms), ..Limits::default() },
        ..Settings::default()
    }
}

fn make(client: &mut Client) -> Value {
    let effects = json!({"gust": {"sigma_mps2": 0.5}, "camera_noise": 0.01});
    client.ask(&json!({"id": 1, "type": "make", "num_envs": 3, "options": {"effects": effects, "max_episode_steps": 20}}))
}

fn resume(client: &mut Client, made: &Value) -> Value {
    client.ask(&json!({"id": 1, "type": "resume", "session": made["session"], "token": made["token"]}))
}

/// Request 2 resets, the others step.
fn nth(id: u64) -> Vec<u8> {
    if id == 2 {
        return request(
            2,
            1,
            2,
            0,
            3,
            &[5u64, 6, 7].iter().flat_map(|s| s.to_le_bytes()).collect::<Vec<_>>(),
        );
    }
    let actions: Vec<f32> = (0..12).map(|i| ((id as usize * 13 + i * 5) % 37) as f32 / 18.5 - 1.0).collect();
    request(id, 2, 1, 1, 3, &le(&actions))
}

/// The replies to the requests 2 to `last` over a network that works.
fn replies_without_faults(server: &Server, last: u64) -> Vec<Vec<u8>> {
    let mut client = server.connect();
    make(&mut client);
    let replies = (2..=last).map(|id| client.ask_binary(nth(id))).collect();
    client.ask(&json!({"id": last + 1, "type": "close"}));
    replies
}

#[test]
fn a_session_goes_on_where_it_was() {
    let server = Server::start(Settings::default());
    let want = replies_without_faults(&server, 60);
    let mut client = server.connect();
    let made = make(&mut client);
    for id in 2..=30 {
        assert_eq!(client.ask_binary(nth(id)), want[id as usize - 2]);
    }
    // sent, carried out, and the reply never read
    client.ws.send(Message::binary(nth(31))).unwrap();
    eventually("request 31 is carried out", || {
        server.metric("crazyflie_env_steps_total") >= 3.0 * (58.0 + 29.0)
    });
    client.ws.get_ref().shutdown(Shutdown::Both).unwrap();
    drop(client);

    let mut client = server.connect();
    let resumed = resume(&mut client, &made);
    assert_eq!(
        (&resumed["type"], &resumed["last_id"], &resumed["ticks"]),
        (&json!("resumed"), &json!(31), &json!(29)),
        "{resumed}"
    );
    for id in [31, 30, 31, 20, 31] {
        assert_eq!(
            client.ask_binary(nth(id)),
            want[id as usize - 2],
            "a repeated request gets the reply it had"
        );
    }
    for id in 32..=60 {
        assert_eq!(client.ask_binary(nth(id)), want[id as usize - 2], "request {id}");
    }
    client.ws.send(Message::binary(nth(3))).unwrap();
    assert_eq!(client.receive()["code"], "stale_id");
    assert_eq!(client.ask(&json!({"id": 99, "type": "state"}))["ticks"], 58);
}

#[test]
fn a_connection_that_does_not_know_it_is_dead_is_taken_over() {
    let server = Server::start(Settings::default());
    let want = replies_without_faults(&server, 5);
    let mut old = server.connect();
    let made = make(&mut old);
    old.ask_binary(nth(2));
    let mut new = server.connect();
    assert_eq!(resume(&mut new, &made)["last_id"], 2);
    assert_eq!(old.close_code(), Some(4001));
    assert_eq!(new.ask_binary(nth(3)), want[1]);
    let mut wrong = made.clone();
    wrong["token"] = json!("0".repeat(32));
    assert_eq!(resume(&mut server.connect(), &wrong)["code"], "unknown_session");
    assert_eq!(new.ask_binary(nth(4)), want[2], "a wrong token takes nothing");
}

#[test]
fn who_comes_too_late_finds_nothing() {
    let server = Server::start(settings(200));
    let mut client = server.connect();
    let made = make(&mut client);
    drop(client);
    eventually("the session expires", || server.metric("crazyflie_sessions") == 0.0);
    assert_eq!(resume(&mut server.connect(), &made)["code"], "unknown_session");
    let mut polite = server.connect();
    let made = make(&mut polite);
    polite
        .ws
        .close(Some(tungstenite::protocol::CloseFrame { code: 1000.into(), reason: "".into() }))
        .unwrap();
    eventually("a goodbye ends it", || server.metric("crazyflie_sessions") == 0.0);
    assert_eq!(resume(&mut server.connect(), &made)["code"], "unknown_session");
    let report = server.stop();
    assert_eq!((report.ended[&SessionEnd::Expired], report.ended[&SessionEnd::Closed]), (1, 1));
}

/// A network that delays, cuts and closes halves, each connection in its own way.
struct Proxy {
    address: SocketAddr,
    cuts: Arc<AtomicUsize>,
}

impl Proxy {
    fn start(to: SocketAddr, seed: u64) -> Proxy {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (cuts, state) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicU64::new(seed)));
        let counted = cuts.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let Ok(server) = TcpStream::connect(to) else { return };
                for (from, to) in [(&client, &server), (&server, &client)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    let (random, cuts) = (next(&state), counted.clone());
                    std::thread::spawn(move || carry(from, to, random, &cuts));
                }
            }
        });
        Proxy { address, cuts }
    }
}

/// A step of SplitMix64.
fn next(state: &AtomicU64) -> u64 {
    let mut z = state.fetch_add(0x9e37_79b9_7f4a_7c15, Ordering::Relaxed).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Carries one direction, until its time is over.
fn carry(mut from: TcpStream, mut to: TcpStream, random: u64, cuts: &AtomicUsize) {
    let (mut left, fate, delay) = (200 + (random >> 8) as usize % 12_000, random % 4, random >> 40 & 3);
    let mut buffer = [0; 700];
    while let Ok(n @ 1..) = from.read(&mut buffer) {
        if delay == 3 {
            std::thread::sleep(Duration::from_micros(500));
        }
        // the end may come within a frame
        if to.write_all(&buffer[..n.min(left)]).is_err() {
            break;
        }
        left = left.saturating_sub(n);
        if left == 0 {
            cuts.fetch_add(1, Ordering::Relaxed);
            let _ = match fate {
                0 => to.shutdown(Shutdown::Write),
                1 => from.shutdown(Shutdown::Read),
                _ => from.shutdown(Shutdown::Both).and_then(|()| to.shutdown(Shutdown::Both)),
            };
            return;
        }
    }
    let _ = to.shutdown(Shutdown::Write);
}

/// A client that does not give up: flies the requests 2 to `last`, four at a time in flight, and returns the
/// replies.
fn stubborn(address: SocketAddr, last: u64) -> Vec<Vec<u8>> {
    let (mut made, mut replies) = (None, Vec::new());
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        let _ = attempt(address, last, &mut made, &mut replies);
        if replies.len() as u64 == last - 1 {
            return replies;
        }
    }
    panic!("only {} of {} replies within {PATIENCE:?}", replies.len(), last - 1);
}

type Net<T> = Result<T, Box<dyn std::error::Error>>;

fn attempt(address: SocketAddr, last: u64, made: &mut Option<Value>, replies: &mut Vec<Vec<u8>>) -> Net<()> {
    let stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_millis(400)))?;
    let mut request =
        tungstenite::client::IntoClientRequest::into_client_request(format!("ws://{address}/ws"))?;
    request.headers_mut().insert("sec-websocket-protocol", "crazyflie.v1".parse()?);
    let mut client = Client { ws: tungstenite::client(request, stream).map_err(|e| e.to_string())?.0 };
    let first = match &*made {
        Some(made) => json!({"id": 1, "type": "resume", "session": made["session"], "token": made["token"]}),
        None => {
            json!({"id": 1, "type": "make", "num_envs": 3, "options": {"effects": {"gust": {"sigma_mps2": 0.5}, "camera_noise": 0.01},
            "max_episode_steps": 20}})
        }
    };
    client.ws.send(Message::text(first.to_string()))?;
    let answer: Value = serde_json::from_str(client.ws.read()?.to_text()?)?;
    match answer["type"].as_str() {
        Some("made") => *made = Some(answer),
        Some("resumed") => {}
        _ => panic!("{answer}"),
    }
    let mut sent = replies.len() as u64 + 1;
    while (replies.len() as u64) < last - 1 {
        while sent < last && sent - (replies.len() as u64 + 1) < 4 {
            sent += 1;
            client.ws.send(Message::binary(nth(sent)))?;
        }
        match client.ws.read()? {
            Message::Binary(bytes) => replies.push(bytes.to_vec()),
            Message::Close(_) => return Err("closed".into()),
            other => panic!("{other:?}"),
        }
    }
    Ok(())
}

#[test]
fn chaos_changes_no_flight() {
    let server = Server::start(Settings::default());
    let want = replies_without_faults(&server, 120);
    let flights = 6;
    let (mut cuts, mut threads) = (0, Vec::new());
    let proxies: Vec<_> = (0..flights).map(|seed| Proxy::start(server.address, seed * 77 + 1)).collect();
    for proxy in &proxies {
        let address = proxy.address;
        threads.push(std::thread::spawn(move || stubborn(address, 120)));
    }
    for thread in threads {
        assert!(thread.join().unwrap() == want, "chaos changed a flight");
    }
    for proxy in &proxies {
        cuts += proxy.cuts.load(Ordering::Relaxed);
    }
    let report = server.stop();
    let ended: u64 = report.ended.values().sum();
    println!(
        "{flights} flights of 119 requests through {cuts} cuts, {} connections: the same bits; sessions {ended} of {} ended, {:?}",
        report.connections, report.sessions, report.ended
    );
    assert!(cuts > 20, "only {cuts} cuts: this was no chaos");
    assert_eq!((ended, report.ended[&SessionEnd::Broken], report.cut), (report.sessions, 0, 0));
}
