//! The connection that a native client makes to a server: TCP, TLS where the URL asks for it, WebSocket.

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

use crate::serve::PROTOCOL;

/// For the connection, and again for the handshakes.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Messages of a server are at most 2 MiB; another one's may be larger.
const MOST_BYTES: usize = 256 << 20;

/// Plain or over TLS.
pub trait Stream: Read + Write + Send + Sync {}
impl<T: Read + Write + Send + Sync> Stream for T {}

/// A connection that speaks the protocol.
pub struct Dialled {
    pub ws: WebSocket<Box<dyn Stream>>,
    /// Beneath it, for the caller's own timeouts; reads time out after 10 s at first.
    pub tcp: TcpStream,
}

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
pub enum DialError {
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
    #[error("{0}")]
    Handshake(tungstenite::Error),
    #[error("no answer to the handshake within {} s", CONNECT_TIMEOUT.as_secs())]
    Silent,
    #[error(transparent)]
    Socket(#[from] io::Error),
}

/// Connects to `url`, ws:// or wss:// with a path. `reply_bytes` is the size of the usual reply: a buffer for it is filled anew by each read.
///
/// # Errors
/// [`DialError`].
pub fn dial(url: &str, reply_bytes: usize) -> Result<Dialled, DialError> {
    let mut request = url.into_client_request().map_err(DialError::Url)?;
    request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(PROTOCOL));
    let tcp = connect(request.uri())?;
    let below = tcp.try_clone()?;
    let stream: Box<dyn Stream> = if is_secure(request.uri()) { secured(tcp, request.uri())? } else { Box::new(tcp) };
    let config = WebSocketConfig::default()
        .read_buffer_size(reply_bytes.clamp(4 << 10, 1 << 20))
        .max_message_size(Some(MOST_BYTES))
        .max_frame_size(Some(MOST_BYTES));
    let (ws, _) = client_with_config(request, stream, Some(config)).map_err(|error| match error {
        HandshakeError::Interrupted(_) => DialError::Silent,
        HandshakeError::Failure(error) => DialError::Handshake(error),
    })?;
    Ok(Dialled { ws, tcp: below })
}

fn is_secure(uri: &Uri) -> bool {
    uri.scheme_str() == Some("wss")
}

/// The host of a URL; an IPv6 address without its brackets.
fn host(uri: &Uri) -> Result<&str, DialError> {
    Ok(uri.host().ok_or(DialError::NoHost)?.trim_start_matches('[').trim_end_matches(']'))
}

fn connect(uri: &Uri) -> Result<TcpStream, DialError> {
    let (host, port) = (host(uri)?, uri.port_u16().unwrap_or(if is_secure(uri) { 443 } else { 80 }));
    let about = |problem| DialError::Host { host: host.into(), problem };
    let mut why = about(io::Error::other("no address is known"));
    for address in (host, port).to_socket_addrs().map_err(about)? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(CONNECT_TIMEOUT))?;
                return Ok(stream);
            }
            Err(problem) => why = DialError::Unreachable { address, problem },
        }
    }
    Err(why)
}

/// TLS with the roots that this machine trusts, `SSL_CERT_FILE` among them.
fn secured(tcp: TcpStream, uri: &Uri) -> Result<Box<dyn Stream>, DialError> {
    let name = ServerName::try_from(host(uri)?.to_owned())?;
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    let config = config.with_root_certificates(roots).with_no_client_auth();
    Ok(Box::new(StreamOwned::new(ClientConnection::new(Arc::new(config), name)?, tcp)))
}
