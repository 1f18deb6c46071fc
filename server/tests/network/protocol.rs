//! The worked exchange of `docs/protocol.md` is what the server does.

use crate::net::{Client, Server};
use crazyflie_server::serve::Settings;
use serde_json::{Value, json};
use tungstenite::Message;

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/protocol.md");

/// The lines of the page between the marks of the exchange.
fn exchange(page: &str) -> Vec<&str> {
    let (_, rest) = page.split_once("```exchange\n").expect("the page has an exchange");
    rest.split_once("```").unwrap().0.lines().collect()
}

fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
    digits.chunks(2).map(|d| u8::from_str_radix(&d.iter().collect::<String>(), 16).unwrap()).collect()
}

fn send(client: &mut Client, line: &str) {
    let message = if line.starts_with('{') { Message::text(line) } else { Message::binary(hex(line)) };
    client.ws.send(message).unwrap();
}

/// Secrets and connection limits are not on the page.
fn plain(mut value: Value) -> Value {
    for name in ["session", "token", "server"] {
        if let Some(field) = value.get_mut(name) {
            *field = json!("...");
        }
    }
    value
}

fn check(client: &mut Client, want: &str) {
    match client.ws.read().unwrap() {
        Message::Text(text) => {
            let (got, want): (Value, Value) =
                (serde_json::from_str(&text).unwrap(), serde_json::from_str(want).expect(want));
            assert_eq!(plain(got.clone()), plain(want), "the page is stale; the server says\n< {got}");
        }
        Message::Binary(bytes) => {
            let (want, whole) =
                want.strip_suffix("...").map_or_else(|| (hex(want), true), |start| (hex(start), false));
            let got: String = bytes.iter().take(64).map(|b| format!("{b:02x}")).collect();
            assert!(
                bytes.starts_with(&want) && (!whole || bytes.len() == want.len()),
                "the page is stale; the server says\n< {got}..."
            );
        }
        other => panic!("expected {want}, got {other:?}"),
    }
}

#[test]
fn the_worked_exchange_is_what_happens() {
    let page = std::fs::read_to_string(PAGE).unwrap();
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    let (mut sent, mut received) = (0, 0);
    for line in exchange(&page) {
        match line.split_once(' ') {
            Some((">", message)) => (send(&mut client, message), sent += 1).1,
            Some(("<", message)) => (check(&mut client, message), received += 1).1,
            _ => panic!("expected > or < before {line:?}"),
        }
    }
    assert!(sent == received && sent >= 8, "{sent} requests and {received} replies on the page");
}
