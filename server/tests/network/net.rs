//! A real server on a real socket, and a plain client of it.
#![allow(dead_code, reason = "each test file uses its part")]

use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use crazyflie_server::serve::{Report, Service, Settings};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// Longest time that a test waits: longer than a machine needs that is busy with many other things.
pub const PATIENCE: Duration = Duration::from_secs(300);

pub struct Server {
    pub address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<Report>>,
}

impl Server {
    pub fn start(settings: Settings) -> Server {
        let (stop, stopped) = oneshot::channel::<()>();
        let (tell, told) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime =
                tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                tell.send(listener.local_addr().unwrap()).unwrap();
                let stop = async { drop(stopped.await) };
                Service::open(listener, settings).unwrap().run(stop).await
            })
        });
        Server { address: told.recv().unwrap(), stop: Some(stop), thread: Some(thread) }
    }

    /// Stops the server and returns what it did.
    pub fn stop(mut self) -> Report {
        drop(self.stop.take());
        self.thread.take().unwrap().join().unwrap()
    }

    pub fn connect(&self) -> Client {
        Client::connect(self.address, Some("crazyflie.v1"))
    }

    /// The body of a page.
    pub fn get(&self, path: &str) -> String {
        let (head, body) = get(self.address, path);
        assert!(head.starts_with("HTTP/1.1 200"), "{path}: {head}");
        String::from_utf8(body).unwrap()
    }

    /// A number of `/metrics`.
    pub fn metric(&self, name: &str) -> f64 {
        let text = self.get("/metrics");
        let line =
            text.lines().find(|line| line.strip_prefix(name).is_some_and(|rest| rest.starts_with(' ')));
        line.map_or(0.0, |line| line.rsplit(' ').next().unwrap().parse().unwrap())
    }
}

pub struct Client {
    pub ws: WebSocket<TcpStream>,
}

impl Client {
    pub fn connect(address: SocketAddr, protocol: Option<&'static str>) -> Client {
        Client::connect_at(address, "/ws", protocol)
    }

    pub fn connect_at(address: SocketAddr, path: &str, protocol: Option<&'static str>) -> Client {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        Client::over(stream, address, path, protocol)
    }

    pub fn over(
        stream: TcpStream,
        address: SocketAddr,
        path: &str,
        protocol: Option<&'static str>,
    ) -> Client {
        stream.set_nodelay(true).unwrap();
        let mut request = format!("ws://{address}{path}").into_client_request().unwrap();
        if let Some(protocol) = protocol {
            request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(protocol));
        }
        let (ws, response) = tungstenite::client(request, stream).unwrap();
        assert_eq!(response.headers().get("sec-websocket-protocol").map(|v| v.to_str().unwrap()), protocol);
        Client { ws }
    }

    pub fn send(&mut self, message: &Value) {
        self.ws.send(Message::text(message.to_string())).unwrap();
    }

    /// The next text message.
    pub fn receive(&mut self) -> Value {
        match self.ws.read().unwrap() {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            other => panic!("expected JSON, got {other:?}"),
        }
    }

    pub fn ask(&mut self, message: &Value) -> Value {
        self.send(message);
        self.receive()
    }

    /// The reply to a binary request.
    pub fn ask_binary(&mut self, request: Vec<u8>) -> Vec<u8> {
        self.ws.send(Message::binary(request)).unwrap();
        self.receive_binary()
    }

    pub fn receive_binary(&mut self) -> Vec<u8> {
        match self.ws.read().unwrap() {
            Message::Binary(bytes) => bytes.to_vec(),
            other => panic!("expected a binary reply, got {other:?}"),
        }
    }

    /// Returns the close code that ends the connection; messages before it are dropped.
    pub fn close_code(&mut self) -> Option<u16> {
        loop {
            match self.ws.read() {
                Ok(Message::Close(frame)) => return frame.map(|frame| frame.code.into()),
                Ok(_) => {}
                Err(error) => panic!("expected Close, got {error}"),
            }
        }
    }
}

/// Head and body of an answer over HTTP.
pub fn get(address: SocketAddr, path: &str) -> (String, Vec<u8>) {
    exchange(address, &format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n"))
}

/// Head and body of the answer to a request, which closes the connection.
pub fn exchange(address: SocketAddr, request: &str) -> (String, Vec<u8>) {
    use std::io::{Read, Write};
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
    let (head, body) = (String::from_utf8_lossy(&bytes[..end]).into_owned(), bytes.split_off(end + 4));
    let chunked = head.contains("transfer-encoding: chunked");
    (head, if chunked { without_chunks(&body) } else { body })
}

/// A body that was sent in chunks, each after its length in hex.
pub fn without_chunks(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    loop {
        let line = rest.windows(2).position(|two| two == b"\r\n").expect("the length of a chunk");
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
        if length == 0 {
            return body;
        }
        body.extend(&rest[line + 2..line + 2 + length]);
        rest = &rest[line + 4 + length..];
    }
}

/// A binary request: kind 1 reset, 2 step, 3 state.
pub fn request(id: u64, kind: u8, flags: u8, steps: u16, envs: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = id.to_le_bytes().to_vec();
    bytes.extend([kind, flags]);
    bytes.extend(steps.to_le_bytes());
    bytes.extend(envs.to_le_bytes());
    bytes.extend(payload);
    bytes
}

pub fn le(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

pub fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

/// Waits until `done`, or fails with the condition it waited for.
pub fn eventually(what: &str, mut done: impl FnMut() -> bool) {
    let began = Instant::now();
    while !done() {
        assert!(began.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Returns whether a comparison of speeds is true once in some tries: the machine has other work.
pub fn once(mut holds: impl FnMut() -> bool) -> bool {
    (0..10).any(|_| holds())
}
