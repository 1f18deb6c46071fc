//! The connection of a native client to a server: TCP, TLS if the URL requires it, WebSocket.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::Duration;

use tokio_rustls::rustls::pki_types::{InvalidDnsNameError, ServerName};
use tokio_rustls::rustls::{self, ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tokio_tungstenite::tungstenite::client::{IntoClientRequest, client_with_config};
use tokio_tungstenite::tungstenite::handshake::HandshakeError;
use tokio_tungstenite::tungstenite::http::{HeaderValue, Uri};
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, WebSocket};

use crate::protocol::PROTOCOL;

/// Limit for the TCP connection, and again for each handshake.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Largest message. This server sends at most 2 MiB; others may send more.
const MAX_MESSAGE_BYTES: usize = 256 << 20;

/// A byte stream: plain TCP or TLS.
pub trait ByteStream: Read + Write + Send + Sync {}
impl<T: Read + Write + Send + Sync> ByteStream for T {}

/// An open WebSocket to a server.
pub struct ServerConnection {
    /// WebSocket after the handshake, in blocking mode.
    pub ws: WebSocket<Box<dyn ByteStream>>,
    /// The TCP stream beneath, for the caller's timeouts. Reads first time out after 10 s.
    pub tcp: TcpStream,
}

/// Reason that a connection could not be made.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum ConnectError {
    #[error("the URL: {0}")]
    Url(tungstenite::Error),
    #[error("the URL names no host")]
    NoHost,
    #[error("{host}: {problem}")]
    Host { host: String, problem: io::Error },
    #[error("{address}: {problem}")]
    Unreachable { address: SocketAddr, problem: io::Error },
    #[error("TLS: {0}")]
    Name(#[from] InvalidDnsNameError),
    #[error("TLS: {0}")]
    Tls(#[from] rustls::Error),
    #[error("{0}{hint}", hint = certificate_hint(.0))]
    Handshake(tungstenite::Error),
    #[error("no answer to the handshake within {} s", CONNECT_TIMEOUT.as_secs())]
    Silent,
    #[error(transparent)]
    Socket(#[from] io::Error),
}

/// Returns a hint for a certificate that TLS rejects.
fn certificate_hint(error: &tungstenite::Error) -> &'static str {
    let words = format!("{error:?}");
    let hints = [
        (
            "CaUsedAsEndEntity",
            ": the certificate is one of an authority, as `openssl req -x509` makes it: add -addext basicConstraints=critical,CA:FALSE (see crazyflie serve --help)",
        ),
        (
            "UnknownIssuer",
            ": this machine does not trust it: set SSL_CERT_FILE to the server's certificate, a PEM file",
        ),
        (
            "NotValidForName",
            ": it is for another name: make it with -addext subjectAltName=DNS:NAME (see crazyflie serve --help)",
        ),
        ("Expired", ": it is no longer valid"),
    ];
    hints.iter().find(|(sign, _)| words.contains(sign)).map_or("", |(_, hint)| hint)
}

/// Connects to `url`, ws:// or wss:// with a path. `reply_bytes` is the size of the usual reply and sizes the
/// read buffer.
///
/// # Errors
/// [`ConnectError`].
pub fn connect(url: &str, reply_bytes: usize) -> Result<ServerConnection, ConnectError> {
    let mut request = url.into_client_request().map_err(ConnectError::Url)?;
    request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(PROTOCOL));
    let tcp = connect_tcp(request.uri())?;
    let tcp_handle = tcp.try_clone()?;
    let stream: Box<dyn ByteStream> =
        if is_secure(request.uri()) { tls_stream(tcp, request.uri())? } else { Box::new(tcp) };
    let config = WebSocketConfig::default()
        .read_buffer_size(reply_bytes.clamp(4 << 10, 1 << 20))
        .max_message_size(Some(MAX_MESSAGE_BYTES))
        .max_frame_size(Some(MAX_MESSAGE_BYTES));
    let (ws, _) = client_with_config(request, stream, Some(config)).map_err(|error| match error {
        HandshakeError::Interrupted(_) => ConnectError::Silent,
        HandshakeError::Failure(error) => ConnectError::Handshake(error),
    })?;
    Ok(ServerConnection { ws, tcp: tcp_handle })
}

fn is_secure(uri: &Uri) -> bool {
    uri.scheme_str() == Some("wss")
}

/// The host of a URL; an IPv6 address without its brackets.
fn host(uri: &Uri) -> Result<&str, ConnectError> {
    Ok(uri.host().ok_or(ConnectError::NoHost)?.trim_start_matches('[').trim_end_matches(']'))
}

fn connect_tcp(uri: &Uri) -> Result<TcpStream, ConnectError> {
    let (host, port) = (host(uri)?, uri.port_u16().unwrap_or(if is_secure(uri) { 443 } else { 80 }));
    let about = |problem| ConnectError::Host { host: host.into(), problem };
    let mut error = about(io::Error::other("no address is known"));
    for address in (host, port).to_socket_addrs().map_err(about)? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(CONNECT_TIMEOUT))?;
                return Ok(stream);
            }
            Err(problem) => error = ConnectError::Unreachable { address, problem },
        }
    }
    Err(error)
}

/// A TLS session over `tcp`. It trusts the roots of this machine, `SSL_CERT_FILE` among them.
fn tls_stream(tcp: TcpStream, uri: &Uri) -> Result<Box<dyn ByteStream>, ConnectError> {
    let name = ServerName::try_from(host(uri)?.to_owned())?;
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    let config = config.with_root_certificates(roots).with_no_client_auth();
    Ok(Box::new(StreamOwned::new(ClientConnection::new(Arc::new(config), name)?, tcp)))
}
