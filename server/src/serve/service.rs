//! Accepting connections, within the limits, until stopped; then letting them end in order.

use std::collections::BTreeMap;
use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::StatusCode;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Serialize;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;
use tokio_util::either::Either;
use tower_service::Service as _;
use tracing::{debug, info, warn};

use super::answers::error_response;
use super::budget::Refusal;
use super::http;
use super::metrics::SessionEnd;
use super::moment;
use super::proxied;
use super::server::{Peer, Server};
use super::settings::{ServeError, Settings};
use super::shown::{self, FleetView};
use super::stream::{Stream, is_stalled};
use crate::protocol::ProtocolError;

/// A plain HTTP connection is closed after this time, whatever it does: an idle reader does not keep its place.
const HTTP_FOR: Duration = Duration::from_secs(600);

/// Totals of a server that has stopped.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Connections that were accepted.
    pub connections: u64,
    /// Sessions that were begun.
    pub sessions: u64,
    /// Sessions by the way they ended.
    pub ended: BTreeMap<SessionEnd, u64>,
    /// Connections that had not ended when the time to stop was over.
    pub cut: usize,
}

/// A server that has its port, and answers when it runs.
pub struct Service {
    listener: TcpListener,
    server: Arc<Server>,
    fleet: Option<FleetView>,
}

impl Service {
    /// Prepares to serve on `listener`.
    ///
    /// # Errors
    /// [`ServeError`]: settings that do not fit where the listener listens.
    pub fn open(listener: TcpListener, settings: Settings) -> Result<Service, ServeError> {
        let address = listener.local_addr()?;
        settings.check(address)?;
        Ok(Service { listener, server: Server::new(settings, address), fleet: None })
    }

    /// Returns the address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address
    }

    /// Shows drones, which somebody else in this program flies, among the sessions of the page.
    #[must_use]
    pub fn with_fleet(self, fleet: FleetView) -> Service {
        Service { fleet: Some(fleet), ..self }
    }

    /// Serves until `stop`. Wants a runtime of several threads: long steps take one of them.
    pub async fn run(self, stop: impl Future<Output = ()>) -> Report {
        let Service { listener, server, fleet } = self;
        let router = http::router(&server);
        info!(address = %server.address, tls = server.settings.tls.is_some(), "listening");
        if let Some(fleet) = fleet {
            server.tasks.spawn(shown::show(Arc::clone(&server), fleet));
        }
        server.tasks.spawn(moment::watch(server.stop.clone()));
        tokio::pin!(stop);
        loop {
            tokio::select! {
                () = &mut stop => break,
                accepted = listener.accept() => match accepted {
                    Ok((stream, peer)) => server.admit(stream, peer, &router),
                    Err(error) => {
                        // out of descriptors, mostly: others will be closed
                        warn!(%error, "cannot accept");
                        tokio::time::sleep(Duration::from_millis(20)).await;
                    }
                }
            }
        }
        drop(listener);
        server.drain().await
    }
}

impl Server {
    fn admit(self: &Arc<Self>, stream: TcpStream, address: SocketAddr, router: &Router) {
        let Ok(peer) = Peer::new(self, address, usize::from(!self.is_proxy(address))) else {
            self.turn_away(&stream);
            return;
        };
        self.tasks.spawn(Box::pin(serve(self.clone(), stream, peer, router.clone())));
    }

    /// Sends the reason for which a connection is closed, if that is possible before a handshake.
    fn turn_away(&self, stream: &TcpStream) {
        if self.settings.tls.is_none() {
            let _ = stream.try_write(
                b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: application/json\r\n\
                  x-content-type-options: nosniff\r\n\r\n\
                  {\"type\":\"error\",\"code\":\"too_many\",\"message\":\"too many connections: try again later\"}\n",
            );
        }
    }

    async fn drain(&self) -> Report {
        info!(connections = self.metrics.connections.get(), "stopping");
        self.stop.cancel();
        self.tasks.close();
        let cut = match timeout(self.settings.limits.drain_for, self.tasks.wait()).await {
            Ok(()) => 0,
            Err(_) => self.tasks.len(),
        };
        let ended = SessionEnd::ALL.map(|end| (end, self.metrics.session_ends(end)));
        let (connections, sessions) =
            (self.metrics.connections_total.get(), self.metrics.sessions_total.get());
        info!(connections, sessions, cut, "stopped");
        Report { connections, sessions, ended: ended.into(), cut }
    }
}

/// The answer to a client that is refused.
pub(super) fn unavailable(refusal: Refusal) -> Response {
    let problem = ProtocolError::from(refusal).message;
    error_response(StatusCode::SERVICE_UNAVAILABLE, "too_many", &problem)
}

/// The client of a connection: the peer, or the one that a trusted proxy names in front of it. None for a header that is
/// wrong or late, and for a client with too many connections.
async fn client(server: &Arc<Server>, stream: &mut TcpStream, peer: Arc<Peer>) -> Option<Arc<Peer>> {
    if !server.is_proxy(peer.address) {
        return Some(peer);
    }
    let named =
        timeout(server.settings.limits.handshake_timeout, proxied::client(stream)).await.ok()?.ok()?;
    let Some(address) = named else { return Some(peer) };
    Peer::new(server, address, 1).inspect_err(|_| server.turn_away(stream)).ok()
}

/// Handshakes and HTTP; a WebSocket goes on in a task of its own.
async fn serve(server: Arc<Server>, mut stream: TcpStream, peer: Arc<Peer>, router: Router) {
    let patience = server.settings.limits.handshake_timeout;
    // a reply must not wait for the acknowledgement of the one before
    let _ = stream.set_nodelay(true);
    let Some(peer) = client(&server, &mut stream, peer).await else {
        server.metrics.record_refusal("handshake");
        return;
    };
    let transport = match &server.settings.tls {
        None => Either::Left(stream),
        Some(tls) => match timeout(patience, TlsAcceptor::from(tls.clone()).accept(stream)).await {
            Ok(Ok(stream)) => Either::Right(Box::new(stream)),
            failed => {
                server.metrics.record_refusal("handshake");
                debug!(peer = %peer.address, error = ?failed.map(|r| r.err()), "no TLS");
                return;
            }
        },
    };
    let stream = Stream::new(transport, server.settings.limits.write_timeout);
    let service = hyper::service::service_fn(|mut request: hyper::Request<Incoming>| {
        let (client, mut router) = (peer.behind(request.headers()), router.clone());
        async move {
            let client = match client {
                Ok(client) => client,
                Err(refusal) => return Ok(unavailable(refusal)),
            };
            request.extensions_mut().insert(client.clone());
            drop(client.queue.turn(false).await);
            // a client that has sent many requests at once lets others go on after each
            tokio::task::yield_now().await;
            router.call(request.map(Body::new)).await
        }
    });
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(patience).max_buf_size(16 << 10);
    let connection = builder.serve_connection(TokioIo::new(stream), service).with_upgrades();
    tokio::pin!(connection);
    let ended = tokio::select! {
        ended = timeout(HTTP_FOR, &mut connection) => ended,
        () = server.stop.cancelled() => {
            connection.as_mut().graceful_shutdown();
            timeout(HTTP_FOR, &mut connection).await
        }
    };
    match ended {
        Ok(Ok(())) => {}
        Ok(Err(error)) => {
            if error.is_timeout() {
                server.metrics.record_refusal("handshake");
            } else if is_stalled(&error) {
                server.metrics.record_refusal("stalled");
            }
            debug!(peer = %peer.address, %error, "HTTP ended");
        }
        Err(_) => server.metrics.record_refusal("stalled"),
    }
}
