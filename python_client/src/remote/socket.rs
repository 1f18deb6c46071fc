//! A WebSocket that waits for one reply at a time.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use pyo3::Python;
use rustls::pki_types::ServerName;
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::{HeaderValue, Uri};
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::protocol::{CloseFrame, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use super::trouble::Trouble;

const PROTOCOL: &str = "crazyflie.v1";
/// For the connection, and again for the handshakes.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// How long an interrupt of the user's may go unnoticed.
const NOTICE: Duration = Duration::from_millis(250);
/// A server that takes nothing for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);
/// Messages of a server are at most 2 MiB; another one's may be larger.
const MOST_BYTES: usize = 256 << 20;
/// No answer to pings; a server closes with this.
const SILENT: u16 = 4002;

trait Stream: Read + Write + Send + Sync {}
impl<T: Read + Write + Send + Sync> Stream for T {}

pub struct Socket {
    ws: WebSocket<Box<dyn Stream>>,
    url: String,
}

impl Socket {
    /// `reply_bytes` is the size of the usual reply: a buffer for it is filled anew by each read.
    ///
    /// # Errors
    /// [`Trouble::Lost`] if nobody answers, or not in this protocol.
    pub fn connect(url: &str, reply_bytes: usize) -> Result<Socket, Trouble> {
        let lost = |why: String| Trouble::Lost { url: url.into(), why };
        let mut request = url.into_client_request().map_err(|e| lost(e.to_string()))?;
        request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(PROTOCOL));
        let tcp = dial(request.uri()).map_err(lost)?;
        let watched = tcp.try_clone().map_err(|e| lost(e.to_string()))?;
        let stream: Box<dyn Stream> =
            if request.uri().scheme_str() == Some("wss") { secured(tcp, request.uri()).map_err(lost)? } else { Box::new(tcp) };
        let config = WebSocketConfig::default()
            .read_buffer_size(reply_bytes.clamp(4 << 10, 1 << 20))
            .max_message_size(Some(MOST_BYTES))
            .max_frame_size(Some(MOST_BYTES));
        let (ws, _) = tungstenite::client::client_with_config(request, stream, Some(config)).map_err(|e| lost(e.to_string()))?;
        watched.set_read_timeout(Some(NOTICE)).map_err(|e| lost(e.to_string()))?;
        watched.set_write_timeout(Some(WRITE_TIMEOUT)).map_err(|e| lost(e.to_string()))?;
        Ok(Socket { ws, url: url.into() })
    }

    /// Sends a request.
    ///
    /// # Errors
    /// [`Trouble::Lost`].
    pub fn send(&mut self, message: Message) -> Result<(), Trouble> {
        let Err(error) = self.ws.send(message) else { return Ok(()) };
        // what the server said last explains it better than a broken pipe
        match self.ws.read() {
            Ok(Message::Close(frame)) => Err(self.parted(frame)),
            _ => Err(self.lost(error.to_string())),
        }
    }

    /// The next text or binary message.
    ///
    /// # Errors
    /// [`Trouble::Lost`] also if none comes within `timeout`, [`Trouble::Ended`], and what Python's signal handlers raise.
    pub fn receive(&mut self, timeout: Duration) -> Result<Message, Trouble> {
        let began = Instant::now();
        loop {
            match self.ws.read() {
                Ok(message @ (Message::Text(_) | Message::Binary(_))) => return Ok(message),
                Ok(Message::Close(frame)) => return Err(self.parted(frame)),
                Ok(_) => {}
                Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                    Python::attach(|py| py.check_signals())?;
                    if began.elapsed() > timeout {
                        return Err(self.lost(format!("no reply within {} s", timeout.as_secs())));
                    }
                }
                Err(error) => return Err(self.lost(error.to_string())),
            }
        }
    }

    /// Lets the server know that we are there; it answers nothing.
    pub fn beat(&mut self) {
        // who is not there any more is found out by the next request
        let _ = self.ws.send(Message::Pong(Bytes::new()));
    }

    /// Says goodbye; the server ends the session.
    pub fn close(&mut self) {
        let frame = CloseFrame { code: CloseCode::Normal, reason: "".into() };
        // there is nobody to tell of a goodbye that fails
        let _ = self.ws.close(Some(frame)).and_then(|()| self.ws.flush());
    }

    fn lost(&self, why: String) -> Trouble {
        Trouble::Lost { url: self.url.clone(), why }
    }

    fn parted(&self, frame: Option<CloseFrame>) -> Trouble {
        let Some(frame) = frame else { return self.lost("the server closed it".into()) };
        let (url, code) = (self.url.clone(), u16::from(frame.code));
        let why = format!("{} (close code {code})", frame.reason);
        // the session waits, though the server lost patience with the connection
        if code == SILENT { Trouble::Lost { url, why } } else { Trouble::Ended { url, why } }
    }
}

fn dial(uri: &Uri) -> Result<TcpStream, String> {
    let host = uri.host().ok_or("the URL names no host")?;
    let port = uri.port_u16().unwrap_or(if uri.scheme_str() == Some("wss") { 443 } else { 80 });
    let plain = host.trim_start_matches('[').trim_end_matches(']');
    let mut why = format!("no address is known for {host:?}");
    for address in (plain, port).to_socket_addrs().map_err(|e| format!("{host}: {e}"))? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                let set = stream.set_nodelay(true).and_then(|()| stream.set_read_timeout(Some(CONNECT_TIMEOUT)));
                return set.map(|()| stream).map_err(|e| e.to_string());
            }
            Err(error) => why = format!("{address}: {error}"),
        }
    }
    Err(why)
}

/// TLS with the roots that this machine trusts, `SSL_CERT_FILE` among them.
fn secured(tcp: TcpStream, uri: &Uri) -> Result<Box<dyn Stream>, String> {
    let host = uri.host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    let name = ServerName::try_from(host.to_owned()).map_err(|e| e.to_string())?;
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().map_err(|e| e.to_string())?;
    let config = config.with_root_certificates(roots).with_no_client_auth();
    let connection = ClientConnection::new(Arc::new(config), name).map_err(|e| e.to_string())?;
    Ok(Box::new(StreamOwned::new(connection, tcp)))
}
