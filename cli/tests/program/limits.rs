//! Limits of one client: others do not pay for it. Prints its figures.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::{Arc, Barrier};
use std::time::{Duration, Instant};

use crate::net::{Client, PATIENCE, Server, eventually, le, request};
use crate::process::Process;
use crazyflie_server::serve::{Limits, SessionEnd, Settings, Shares};
use serde_json::json;
use tungstenite::Message;

fn settings_with(limits: Limits) -> Settings {
    Settings { limits, ..Settings::default() }
}

fn make(client: &mut Client, num_envs: u32) {
    let made = client.ask(&json!({"id": 1, "type": "make", "num_envs": num_envs}));
    assert_eq!(made["type"], "made", "{made}");
    client.ask_binary(request(2, 1, 0, 0, num_envs, &[]));
}

/// Connections need descriptors, here too.
fn more_descriptors() {
    use rustix::process::{Resource, getrlimit, setrlimit};
    let mut limit = getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    setrlimit(Resource::Nofile, limit).unwrap();
}

#[test]
fn messages_beyond_the_cap_are_answered_with_1009() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    make(&mut client, 1);
    client.ws.send(Message::text(" ".repeat((64 << 10) + 1))).unwrap();
    assert_eq!(client.close_code(), Some(1009));
    let mut client = server.connect();
    make(&mut client, 1);
    // the header alone is enough
    client.ws.get_mut().write_all(&[0x82, 0xff, 0, 0, 0, 0, 0, 0x20, 0, 1, 0, 0, 0, 0]).unwrap();
    assert_eq!(client.close_code(), Some(1009));
    assert_eq!(server.metric("crazyflie_connections_refused_total{reason=\"broke a rule\"}"), 2.0);
}

/// Connections that begin a request and go no further.
fn half_open(server: &Server) -> Vec<TcpStream> {
    let heads = ["", "G", "GET /ws HTTP/1.1\r\n", "GET /ws HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\n"];
    let open = |i: usize| {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.write_all(heads[i % heads.len()].as_bytes()).unwrap();
        stream
    };
    (0..200).map(open).collect()
}

#[test]
fn half_open_sockets_are_closed_and_hinder_nobody() {
    more_descriptors();
    let patient = Limits { handshake_timeout: 2 * PATIENCE, ..Limits::default() };
    let server = Server::start(settings_with(patient));
    let half = half_open(&server);
    make(&mut server.connect(), 1);
    for stream in &half {
        stream.set_nonblocking(true).unwrap();
        assert_eq!(stream.peek(&mut [0]).unwrap_err().kind(), std::io::ErrorKind::WouldBlock);
    }
    let hasty = Limits { handshake_timeout: Duration::from_secs(1), ..Limits::default() };
    let server = Server::start(settings_with(hasty));
    for mut stream in half_open(&server) {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // a polite server may say 408 first
        stream.read_to_end(&mut vec![]).unwrap();
    }
    eventually("their places are free", || server.metric("crazyflie_connections") <= 2.0);
}

#[test]
fn silence_is_pinged_and_then_closed() {
    let (ping_after, idle_timeout) = (Duration::from_millis(150), Duration::from_secs(5));
    let server = Server::start(settings_with(Limits { ping_after, idle_timeout, ..Limits::default() }));
    // answers pings, because it reads; has nothing to say for much longer than the limit
    let mut alive = server.connect();
    make(&mut alive, 1);
    let mut dead = server.connect();
    make(&mut dead, 1);
    alive.ws.get_mut().set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let (began, mut pings) = (Instant::now(), 0);
    while pings < 3 || began.elapsed() < Duration::from_secs(6) {
        pings += usize::from(matches!(alive.ws.read(), Ok(Message::Ping(_))));
        let _ = alive.ws.flush();
    }
    alive.ws.get_mut().set_read_timeout(Some(PATIENCE)).unwrap();
    assert_eq!(alive.ask(&json!({"id": 9, "type": "state"}))["type"], "state");
    eventually("the silent one is closed", || {
        server.metric("crazyflie_connections_refused_total{reason=\"silent\"}") == 1.0
    });
    assert_eq!(dead.close_code(), Some(4002));
    println!("{pings} pings in 6 s kept a silent client; one that did not answer was closed");
}

#[test]
fn connections_are_capped_by_address_and_by_token() {
    let server = Server::start(settings_with(Limits {
        connections: Shares { server: 100, address: 6, token: 2 },
        ..Limits::default()
    }));
    let hello = json!({"id": 1, "type": "hello", "token": "team secret"});
    let mut clients: Vec<Client> = (0..6).map(|_| server.connect()).collect();
    assert_eq!(clients[0].ask(&hello)["type"], "welcome");
    assert_eq!(clients[1].ask(&hello)["type"], "welcome");
    assert_eq!(clients[1].ask(&hello)["type"], "welcome", "a second hello is no second connection");
    assert_eq!(clients[2].ask(&hello)["code"], "too_many");
    assert_eq!(clients[2].ask(&json!({"id": 2, "type": "hello", "token": "other"}))["type"], "welcome");
    let mut seventh = TcpStream::connect(server.address).unwrap();
    let mut text = String::new();
    seventh.read_to_string(&mut text).unwrap();
    assert!(text.starts_with("HTTP/1.1 503"), "{text}");
    drop(clients.remove(0));
    eventually("a place is free again", || {
        let mut stream = TcpStream::connect(server.address).unwrap();
        let mut text = String::new();
        write!(stream, "GET /healthz HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\r\n", server.address)
            .unwrap();
        stream.read_to_string(&mut text).is_ok() && text.starts_with("HTTP/1.1 200")
    });
    assert_eq!(clients[1].ask(&hello)["type"], "welcome", "and the token's");
}

#[test]
fn environments_are_capped() {
    let limits = Limits { envs: Shares::even(100), reserved_envs: Shares::even(0), ..Limits::default() };
    let server = Server::start(settings_with(limits));
    let (mut a, mut b) = (server.connect(), server.connect());
    make(&mut a, 60);
    assert_eq!(b.ask(&json!({"id": 1, "type": "make", "num_envs": 50}))["code"], "too_many");
    make(&mut b, 40);
    assert_eq!(a.ask(&json!({"id": 9, "type": "close"}))["type"], "closed");
    make(&mut b, 60);
}

#[test]
fn who_never_reads_is_cheap() {
    let process = Process::start(&[]);
    make(&mut process.client(), 8192);
    std::thread::sleep(Duration::from_millis(100));
    let before = process.rss_kib();
    let mut lazy = process.client();
    make(&mut lazy, 8192);
    let envs = process.rss_kib().saturating_sub(before);
    lazy.ws.get_mut().set_write_timeout(Some(Duration::from_millis(300))).unwrap();
    let mut sent = 0;
    for id in 3..2000 {
        if lazy.ws.send(Message::binary(request(id, 2, 0, 1, 8192, &le(&[0.0; 8192 * 4])))).is_err() {
            break;
        }
        sent += 1;
    }
    std::thread::sleep(Duration::from_millis(500));
    let cost = process.rss_kib().saturating_sub(before);
    println!(
        "a client of 8192 environments that sent {sent} steps and read nothing: {:.1} MiB ({:.1} of it environments)",
        cost as f64 / 1024.0,
        envs as f64 / 1024.0
    );
    assert!(sent < 1000, "the server took {sent} requests without being read");
    assert!(cost < 10 << 10, "{cost} KiB");
}

#[test]
fn who_never_reads_is_closed() {
    let server = Server::start(settings_with(Limits {
        write_timeout: Duration::from_millis(400),
        ..Limits::default()
    }));
    let mut lazy = server.connect();
    make(&mut lazy, 4096);
    lazy.ws.get_mut().set_write_timeout(Some(PATIENCE)).unwrap();
    let step = |id| Message::binary(request(id, 2, 0, 1, 4096, &le(&[0.0; 4096 * 4])));
    let refused = (3..5000).find(|id| lazy.ws.send(step(*id)).is_err());
    assert!(refused.is_some(), "5000 requests and no end");
    eventually("it is closed", || {
        server.metric("crazyflie_connections_refused_total{reason=\"stalled\"}") == 1.0
    });
    assert_eq!(server.stop().ended[&SessionEnd::Stopped], 1, "the session waited to be resumed");
}

#[test]
fn two_thousand_idle_connections_are_cheap() {
    more_descriptors();
    let process = Process::start(&["--connections-per-address", "3000"]);
    drop(process.client());
    let before = process.rss_kib();
    let mut clients: Vec<Client> = (0..2000).map(|_| process.client()).collect();
    let rss = process.rss_kib();
    let hello = json!({"id": 1, "type": "hello"});
    assert!([0, 777, 1999].iter().all(|i| clients[*i].ask(&hello)["type"] == "welcome"));
    println!(
        "2000 idle connections: {:.1} MiB, the whole process {:.1} MiB",
        (rss - before) as f64 / 1024.0,
        rss as f64 / 1024.0
    );
    // 20 KiB each; the rest of the process is mapped code, as large as the build makes it
    assert!(rss - before < 40 << 10, "{} KiB", rss - before);
}

#[test]
fn ten_thousand_connections_leave_nothing() {
    let process = Process::start(&[]);
    let cycles =
        |n: usize| {
            for i in 0..n {
                let mut client = process.client();
                if i % 10 == 0 {
                    make(&mut client, 16);
                }
                match i % 3 {
                    2 if i % 10 == 0 => drop(client.ask(&json!({"id": 7, "type": "close"}))),
                    0 => drop(client.ws.close(Some(tungstenite::protocol::CloseFrame {
                        code: 1000.into(),
                        reason: "".into(),
                    }))),
                    1 => drop(client.ask(&json!({"id": 7, "type": "close"}))),
                    _ => {}
                }
            }
        };
    let settled = || {
        eventually("connections end", || process.descriptors() < 30);
        (process.rss_kib(), process.descriptors())
    };
    cycles(1000);
    let (rss, descriptors) = settled();
    cycles(10_000);
    let (rss_after, descriptors_after) = settled();
    println!("10000 connections: {rss} to {rss_after} KiB, {descriptors} to {descriptors_after} descriptors");
    assert!(descriptors_after <= descriptors + 2);
    assert!(rss_after < rss + (4 << 10), "{rss} KiB grew to {rss_after} KiB");
}

#[test]
fn a_server_that_is_told_to_stop_loses_no_result() {
    let process = Process::start(&[]);
    let (address, flying) = (process.address, Arc::new(Barrier::new(9)));
    let threads: Vec<_> = (0..8)
        .map(|_| {
            let flying = flying.clone();
            std::thread::spawn(move || {
                let mut client = Client::connect(address, Some("crazyflie.v1"));
                make(&mut client, 64);
                flying.wait();
                for id in 3.. {
                    if client.ws.send(Message::binary(request(id, 2, 0, 1, 64, &le(&[0.1; 256])))).is_err() {
                        return (id, None);
                    }
                    match client.ws.read() {
                        Ok(Message::Binary(reply)) => {
                            assert_eq!(reply[24..32], (id - 2).to_le_bytes(), "a reply is missing")
                        }
                        Ok(Message::Close(frame)) => return (id, frame.map(|frame| u16::from(frame.code))),
                        other => panic!("{other:?}"),
                    }
                }
                unreachable!()
            })
        })
        .collect();
    flying.wait();
    let (report, code, took) = process.terminate();
    let ends: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
    let steps: u64 = ends.iter().map(|(id, _)| id - 3).sum();
    println!(
        "SIGTERM under load: {steps} steps answered, all goodbyes 1001, exit after {:.2} s; {report}",
        took.as_secs_f64()
    );
    assert!(ends.iter().all(|(_, code)| *code == Some(1001)), "{ends:?}");
    assert_eq!((code, &report["cut"], &report["ended"]["stopped"]), (Some(0), &json!(0), &json!(8)));
}

#[test]
fn two_hundred_clients_are_served_at_once() {
    more_descriptors();
    let server = Server::start(Settings::default());
    let address = server.address;
    let began = Instant::now();
    let threads: Vec<_> = (0..200)
        .map(|_| {
            std::thread::spawn(move || {
                let mut client = Client::connect(address, Some("crazyflie.v1"));
                make(&mut client, 1);
                for id in 3..53 {
                    let reply = client.ask_binary(request(id, 2, 0, 1, 1, &le(&[0.0; 4])));
                    assert_eq!((reply.len(), &reply[24..32]), (32 + 100 + 2, &(id - 2).to_le_bytes()[..]));
                }
            })
        })
        .collect();
    let failed = threads.into_iter().filter_map(|thread| thread.join().err()).count();
    println!(
        "200 clients of one environment, 50 steps each: {failed} failed, {:.2} s",
        began.elapsed().as_secs_f64()
    );
    assert_eq!(failed, 0);
}
