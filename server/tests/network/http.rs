//! HTTP of the server: errors in its own words, and what every answer has.

use crate::net::{Server, exchange, get};
use crazyflie_server::serve::Settings;
use serde_json::Value;

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
