//! Settings of the server, and its default limits.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::extension::Extension;

/// Everything that can be chosen about a server, besides where it listens.
#[derive(Clone, Default)]
pub struct Settings {
    /// Bounds on time, memory and number of clients.
    pub limits: Limits,
    /// Certificate and key; needed wherever others than this machine can connect.
    pub tls: Option<Arc<ServerConfig>>,
    /// Proxies in front of the server: the header `X-Forwarded-For` of their requests, or the PROXY header in front
    /// of their connections, is believed.
    pub trusted_proxies: Vec<IpAddr>,
    /// Web origins whose pages may connect, besides the server's own.
    pub origins: Vec<String>,
    /// The server's additions to environments and worlds.
    pub extension: Option<Arc<dyn Extension>>,
}

/// Limits for one client, and for all of them together.
#[derive(Clone, Debug)]
pub struct Limits {
    /// From the connection to the end of the request's head, TLS included.
    pub handshake_timeout: Duration,
    /// Silence after which the peer is pinged.
    pub ping_after: Duration,
    /// Silence, pings unanswered, after which the connection is closed.
    pub idle_timeout: Duration,
    /// Time for one message to become complete.
    pub message_timeout: Duration,
    /// A reply that the peer does not take within this time closes the connection.
    pub write_timeout: Duration,
    /// Time that a session waits for its client to return.
    pub resume_for: Duration,
    /// Time for running requests and closing handshakes when the server stops.
    pub drain_for: Duration,
    /// Largest text message.
    pub control_bytes: usize,
    /// Largest binary message, in both directions.
    pub batch_bytes: usize,
    /// Replies kept per session, to be had again after a lost connection.
    pub window: usize,
    /// The same in bytes.
    pub window_bytes: usize,
    /// Connections.
    pub connections: Shares,
    /// Environments of one session.
    pub envs_per_session: usize,
    /// Environments of sessions: what bounds their memory.
    pub envs: Shares,
    /// Environments for requests of at most [`Limits::small_envs`] when the others are used up.
    pub reserved_envs: Shares,
    /// The most environments of a small request.
    pub small_envs: usize,
    /// Sessions that wait for their clients. The oldest end where there is no room for more.
    pub parked: Shares,
    /// Bytes of replies that are kept or on their way. The first [`Limits::free_bytes`] of a session and of a connection
    /// are not counted.
    pub reply_bytes: Shares,
    /// Bytes of incoming messages, those of unfinished ones twice. The first [`Limits::free_bytes`] of a connection are
    /// not counted.
    pub request_bytes: Shares,
    /// Bytes that everybody may have, however little is left.
    pub free_bytes: usize,
    /// Shared worlds that are flown; as many that are over are remembered.
    pub worlds: Shares,
    /// Worlds of small logs, an eighth of [`Limits::world_bytes`] at most, when the others are used up.
    pub reserved_worlds: Shares,
    /// Work of these worlds when nobody pilots a drone, in thousandths of a core.
    pub world_work: Shares,
    /// The log of a shared world.
    pub world_bytes: usize,
    /// Time that a shared world waits for its first tick.
    pub world_waits: Duration,
    /// Time that a shared world flies on without a pilot.
    pub world_unpiloted: Duration,
    /// Time after which a pilot that gives no action loses its drone.
    pub pilot_silence: Duration,
}

/// Limits of a resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shares {
    /// By all clients together.
    pub server: usize,
    /// By the clients of one address (with IPv6: of one network).
    pub address: usize,
    /// By the clients that show one token.
    pub token: usize,
}

impl Shares {
    /// The same for the server, an address and a token.
    pub fn even(amount: usize) -> Shares {
        Shares { server: amount, address: amount, token: amount }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            handshake_timeout: Duration::from_secs(5),
            ping_after: Duration::from_secs(20),
            idle_timeout: Duration::from_secs(60),
            message_timeout: Duration::from_secs(20),
            write_timeout: Duration::from_secs(20),
            resume_for: Duration::from_secs(30),
            drain_for: Duration::from_secs(8),
            control_bytes: 64 << 10,
            batch_bytes: 2 << 20,
            window: 32,
            window_bytes: 2 << 20,
            connections: Shares { server: 4096, address: 512, token: 16 },
            envs_per_session: 16384,
            envs: Shares { server: 262_144, address: 65_536, token: 65_536 },
            reserved_envs: Shares { server: 16_384, address: 4096, token: 4096 },
            small_envs: 64,
            parked: Shares { server: 512, address: 128, token: 32 },
            reply_bytes: Shares { server: 256 << 20, address: 96 << 20, token: 96 << 20 },
            request_bytes: Shares { server: 160 << 20, address: 96 << 20, token: 96 << 20 },
            free_bytes: 16 << 10,
            worlds: Shares { server: 32, address: 8, token: 8 },
            reserved_worlds: Shares { server: 96, address: 48, token: 8 },
            world_work: Shares { server: 500, address: 250, token: 250 },
            world_bytes: 8 << 20,
            world_waits: Duration::from_secs(50),
            world_unpiloted: Duration::from_secs(10),
            pilot_silence: Duration::from_secs(20),
        }
    }
}

/// Reason that a server did not start, or stopped by itself.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum ServeError {
    #[error("{0} can be reached from other machines: give --tls-cert and --tls-key, or listen on 127.0.0.1")]
    TlsRequired(SocketAddr),
    #[error("{path}: {problem}")]
    Tls { path: PathBuf, problem: String },
    #[error("origin {0:?}: expected scheme and host, such as https://example.org or http://localhost:3000")]
    Origin(String),
    #[error("listening: {0}")]
    Listen(#[from] std::io::Error),
}

impl Settings {
    /// # Errors
    /// [`ServeError::TlsRequired`] off loopback without TLS, [`ServeError::Origin`] for an origin that no
    /// browser would send.
    pub fn check(&self, address: SocketAddr) -> Result<(), ServeError> {
        if self.tls.is_none() && !address.ip().is_loopback() {
            return Err(ServeError::TlsRequired(address));
        }
        let odd = self.origins.iter().find(|origin| {
            let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
            host.is_none_or(|host| host.is_empty() || host.contains(['/', '*', ' ']))
        });
        odd.map_or(Ok(()), |origin| Err(ServeError::Origin(origin.clone())))
    }
}

/// Reads a certificate chain and its key, PEM files.
///
/// # Errors
/// [`ServeError::Tls`] with the file and what is wrong with it.
pub fn tls(cert: &Path, key: &Path) -> Result<Arc<ServerConfig>, ServeError> {
    let about = |path: &Path, problem: String| ServeError::Tls { path: path.to_owned(), problem };
    let certs = CertificateDer::pem_file_iter(cert).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let certs = certs.map_err(|e| about(cert, format!("expected PEM certificates: {e}")))?;
    let private = PrivateKeyDer::from_pem_file(key)
        .map_err(|e| about(key, format!("expected a PEM private key: {e}")))?;
    let provider = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(certs, private));
    let mut config = config.map_err(|e| about(cert, e.to_string()))?;
    // Tickets arrive while a client of several threads sends its request. OpenSSL can lose the request
    // then (tests/tls_connections.py: 11 of 4000). Connections are long, so resuming saves nothing.
    config.send_tls13_tickets = 0;
    Ok(Arc::new(config))
}
