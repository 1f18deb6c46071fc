//! HTTP of the server: errors in its own words, headers of every answer, and clients that share an address.

use std::io::{Read, Write};
use std::net::{IpAddr, Ipv6Addr, TcpStream};
use std::time::Duration;

use crate::net::{PATIENCE, Server, exchange, get};
use crazyflie_server::serve::{Limits, Settings, Shares};
use serde_json::{Value, json};

#[test]
fn wrong_requests_are_answered_in_json() {
    let server = Server::start(Settings::default());
    let address = server.address;
    let host = format!("host: {address}\r\n");
    let upgrade =
        "upgrade: websocket\r\nsec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    for (line, headers, status, code) in [
        ("GET /nothing", host.clone(), 404, "not_found"),
        ("GET /api/v1/nothing", host.clone(), 404, "not_found"),
        ("GET /api/v1/worlds/none/log", host.clone(), 404, "unknown_world"),
        ("GET /api/v1/worlds/%ff/log", host.clone(), 400, "bad_message"),
        ("GET /api/v1/tuner?kp=x", host.clone(), 400, "bad_message"),
        ("POST /api/v1/worlds", host.clone(), 405, "bad_method"),
        ("POST /healthz", host.clone(), 405, "bad_method"),
        ("POST /index.html", host.clone(), 405, "bad_method"),
        ("GET /ws", host.clone(), 400, "bad_message"),
        ("GET /ws", format!("{host}origin: http://evil.example\r\n{upgrade}"), 403, "origin"),
        ("GET /ws", format!("{host}sec-websocket-protocol: other\r\n{upgrade}"), 400, "bad_message"),
        ("GET /healthz", format!("{host}{host}"), 400, "bad_message"),
        ("GET /healthz", "host: evil.example\r\n".into(), 421, "host"),
    ] {
        let (head, body) =
            exchange(address, &format!("{line} HTTP/1.1\r\n{headers}connection: close\r\n\r\n"));
        assert!(head.starts_with(&format!("HTTP/1.1 {status}")), "{line}: {head}");
        assert!(head.contains("x-content-type-options: nosniff"), "{line}: {head}");
        let error: Value = serde_json::from_slice(&body).unwrap_or_else(|_| panic!("{line}: {head}"));
        assert_eq!((&error["type"], &error["code"]), (&"error".into(), &code.into()), "{line}");
        let message = error["message"].as_str().unwrap();
        assert!(!message.contains("Failed to") && !message.contains("deserialize"), "{line}: {message}");
    }
}

#[test]
fn texts_are_compressed_for_who_reads_gzip_and_no_answer_is_sniffed() {
    let server = Server::start(Settings::default());
    for path in ["/", "/js/main.js", "/protocol.md", "/healthz", "/metrics", "/api/v1/worlds"] {
        let (head, plain) = get(server.address, path);
        assert!(head.contains("x-content-type-options: nosniff"), "{path}: {head}");
        let accepts = format!(
            "GET {path} HTTP/1.1\r\nhost: {}\r\naccept-encoding: gzip\r\nconnection: close\r\n\r\n",
            server.address
        );
        let (head, packed) = exchange(server.address, &accepts);
        if path != "/metrics" && plain.len() > 1000 {
            assert!(
                head.contains("content-encoding: gzip") && 2 * packed.len() < plain.len(),
                "{path}: {head}"
            );
        }
    }
}

/// A connection that a proxy has opened for a client, up to the status of its upgrade.
fn upgrade_for(server: &Server, client: &str) -> (TcpStream, String) {
    upgrade_after(server, &[], client)
}

/// The same after a header in front of the connection, in several pieces.
fn upgrade_after(server: &Server, header: &[&[u8]], client: &str) -> (TcpStream, String) {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.set_nodelay(true).unwrap();
    for piece in header {
        let _ = stream.write_all(piece);
        std::thread::sleep(Duration::from_millis(20));
    }
    // the server may close the connection before it reads a refused client
    let _ = write!(
        stream,
        "GET /ws HTTP/1.1\r\nhost: {}\r\nx-forwarded-for: {client}\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        server.address
    );
    let mut status = [0; 12];
    let _ = stream.read_exact(&mut status);
    (stream, String::from_utf8_lossy(&status[9..]).into_owned())
}

#[test]
fn behind_a_trusted_proxy_every_client_has_its_own_share() {
    let start = |proxies: &[IpAddr]| {
        let limits =
            Limits { connections: Shares { server: 100, address: 2, token: 2 }, ..Limits::default() };
        Server::start(Settings { limits, trusted_proxies: proxies.into(), ..Settings::default() })
    };
    let clients = ["10.0.0.1", "10.0.0.1", "10.0.0.1", "10.0.0.2", "10.0.0.9, 10.0.0.1", "2001:db8::1"];
    let server = start(&["127.0.0.1".parse().unwrap()]);
    let opened: Vec<_> = clients.iter().map(|client| upgrade_for(&server, client)).collect();
    let statuses: Vec<&str> = opened.iter().map(|(_, status)| status.as_str()).collect();
    assert_eq!(statuses, ["101", "101", "503", "101", "503", "101"], "the last address counts");
    drop(opened);
    // anybody else may write into the header
    let server = start(&[]);
    let opened: Vec<_> = clients.iter().map(|client| upgrade_for(&server, client)).collect();
    assert_eq!(opened.iter().filter(|(_, status)| status == "101").count(), 2);
}

#[test]
fn a_trusted_proxy_may_name_the_client_in_front_of_the_connection() {
    let start = |proxies: &[IpAddr]| {
        let limits =
            Limits { connections: Shares { server: 100, address: 1, token: 1 }, ..Limits::default() };
        Server::start(Settings { limits, trusted_proxies: proxies.into(), ..Settings::default() })
    };
    let text = |client: &str| format!("PROXY TCP4 {client} 127.0.0.1 50000 8765\r\n").into_bytes();
    let binary = |client: &str| {
        let v6 = ppp::v2::IPv6::new(client.parse::<Ipv6Addr>().unwrap(), Ipv6Addr::LOCALHOST, 50000, 8765);
        ppp::v2::Builder::with_addresses(0x21, ppp::v2::Protocol::Stream, v6).build().unwrap()
    };
    let server = start(&["127.0.0.1".parse().unwrap()]);
    let mut opened = Vec::new();
    let mut status = |header: &[u8], pieces: usize| {
        let pieces: Vec<&[u8]> = header.chunks(header.len().div_ceil(pieces)).collect();
        // a header of HTTP that contradicts it is the client's own
        opened.push(upgrade_after(&server, &pieces, "10.9.9.9"));
        opened.last().unwrap().1.clone()
    };
    assert_eq!((status(&text("10.0.0.1"), 1), status(&text("10.0.0.1"), 3)), ("101".into(), "503".into()));
    assert_eq!(
        (status(&text("10.0.0.2"), 5), status(&binary("2001:db8::1"), 4)),
        ("101".into(), "101".into())
    );
    assert_eq!(status(&binary("2001:db8::1"), 1), "503", "of one network");
    assert_eq!(status(b"PROXY UNKNOWN\r\n", 1), "101", "by the header of HTTP");
    assert_eq!(status(b"PROXY TCP4 10.0.0.3\r\n", 1), "\0\0\0", "closed without a word");
    // anybody else may write in front
    assert_eq!(upgrade_after(&start(&[]), &[&text("10.0.0.1")], "10.0.0.1").1, "400");
}

#[test]
fn a_class_behind_one_address_takes_off() {
    let server = Server::start(Settings::default());
    let mut hog = server.connect();
    for number in 0..8 {
        let options = json!({"drones": 2, "max_episode_steps": 100_000});
        let world = json!({"id": 1, "type": "world", "name": format!("hog-{number}"), "mission": "swap", "options": options});
        assert_eq!(hog.ask(&world)["type"], "world");
    }
    let make =
        |envs: u32| server.connect().ask(&json!({"id": 1, "type": "make", "num_envs": envs}))["type"].clone();
    // with the drones of its worlds, all that one address may have
    let hogs = [16384, 16384, 16384, 16368].map(|envs| {
        let mut client = server.connect();
        assert_eq!(client.ask(&json!({"id": 1, "type": "make", "num_envs": envs}))["type"], "made");
        client
    });
    assert_eq!((make(65), make(64)), (json!("error"), json!("made")));
    // the same messages as the page's
    let pupils: Vec<_> = (0..24)
        .map(|number| {
            let mut pupil = server.connect();
            let options = json!({"drones": 2, "max_episode_steps": 6000, "vertical": "height"});
            let name = format!("pupil-{number}");
            let world =
                json!({"id": 1, "type": "world", "name": name, "mission": "formation", "options": options});
            let founded = pupil.ask(&world);
            assert_eq!(founded["type"], "world", "{name}: {founded}");
            assert_eq!(pupil.ask(&json!({"id": 2, "type": "join", "name": name}))["type"], "joined");
            pupil
        })
        .collect();
    drop((hogs, pupils));
}
