//! Upgrade from HTTP to WebSocket: allowed origins, and the choice of the subprotocol.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{HOST, ORIGIN, SEC_WEBSOCKET_PROTOCOL};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::Response;
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tracing::{debug, info};

use super::answers::HttpError;
use super::server::{Peer, Server};
use super::socket::Socket;
use super::stream::Stream;
use super::{connection, echo, live, openenv};
use crate::protocol::PROTOCOL;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Dialect {
    Crazyflie,
    Echo,
    OpenEnv,
    Live,
}

/// Dialects of a path: by subprotocol, and without one.
pub(crate) struct Dialects {
    named: &'static [(&'static str, Dialect)],
    unnamed: Dialect,
}

pub(crate) const WS: Dialects = Dialects {
    named: &[(PROTOCOL, Dialect::Crazyflie), (echo::PROTOCOL, Dialect::Echo)],
    unnamed: Dialect::OpenEnv,
};
pub(crate) const LIVE: Dialects =
    Dialects { named: &[(live::PROTOCOL, Dialect::Live)], unnamed: Dialect::Live };

/// Answers the request for a WebSocket and leaves the rest to a task.
///
/// # Errors
/// 403 for pages of strange origins, 400 for a request that is no WebSocket handshake or names no protocol of this
/// server.
pub(crate) fn upgrade(
    server: &Arc<Server>,
    mut request: Request,
    dialects: &Dialects,
) -> Result<Response, HttpError> {
    if let Some(origin) = request.headers().get(ORIGIN)
        && !is_origin_allowed(origin, server.address, &server.settings.origins)
    {
        server.metrics.record_refusal("origin");
        let problem = format!("pages of {origin:?} may not connect: see --allow-origin");
        return Err((StatusCode::FORBIDDEN, "origin", problem));
    }
    let (dialect, protocol) = dialects.choose(request.headers())?;
    let peer = request.extensions().get::<Arc<Peer>>().cloned();
    let peer = peer.ok_or((StatusCode::INTERNAL_SERVER_ERROR, "internal", "a request from nobody".into()))?;
    let upgrade = hyper::upgrade::on(&mut request);
    let (parts, _) = request.into_parts();
    let mut response = create_response_with_body(&axum::http::Request::from_parts(parts, ()), Body::empty)
        .map_err(|e| {
            (StatusCode::BAD_REQUEST, "bad_message", format!("expected a WebSocket handshake: {e}"))
        })?;
    if let Some(protocol) = protocol {
        response.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
    }
    let (server, tasks) = (server.clone(), server.tasks.clone());
    tasks.spawn(async move {
        let parts = match upgrade.await.map(|upgraded| upgraded.downcast::<TokioIo<Stream>>()) {
            Ok(Ok(parts)) => parts,
            other => return debug!(peer = %peer.address, error = ?other.err(), "no upgrade"),
        };
        if server.metrics.may_log("connected", peer.payer().address) {
            info!(peer = %peer.address, ?dialect, "connected");
        }
        let leave = server.stop.child_token();
        let (stream, read) = (parts.io.into_inner(), parts.read_buf);
        let mut socket = Socket::new(stream, read, peer.clone(), leave.clone()).await;
        let Err(disconnect) = match dialect {
            Dialect::Crazyflie => connection::serve_socket(peer, &mut socket, leave).await,
            Dialect::OpenEnv => openenv::serve_socket(peer, &mut socket, leave).await,
            Dialect::Echo => echo::serve_socket(&mut socket).await,
            Dialect::Live => live::serve_socket(&server, &mut socket).await,
        };
        // after the session was parked: a client that comes back at once finds it
        socket.goodbye(&disconnect).await;
    });
    Ok(response)
}

impl Dialects {
    /// The first protocol of the client's list that is spoken here.
    fn choose(&self, headers: &HeaderMap) -> Result<(Dialect, Option<&'static str>), HttpError> {
        let offered = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter().filter_map(|value| value.to_str().ok());
        let mut offered = offered.flat_map(|value| value.split(',')).map(str::trim).peekable();
        if offered.peek().is_none() {
            return Ok((self.unnamed, None));
        }
        let dialect_entry = offered.find_map(|name| self.named.iter().find(|(known, _)| *known == name));
        let no_dialect = || {
            let known = self.named.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
            let problem = format!("none of the subprotocols is spoken here; known: {known}");
            (StatusCode::BAD_REQUEST, "bad_message", problem)
        };
        dialect_entry.map(|(name, dialect)| (*dialect, Some(*name))).ok_or_else(no_dialect)
    }
}

/// Returns whether a page of this origin may connect: the server's own at its port, and those of the list. The
/// request's `Host` proves nothing: a name of the attacker's may lead here.
pub(super) fn is_origin_allowed(origin: &HeaderValue, address: SocketAddr, allowed: &[String]) -> bool {
    let Ok(origin) = origin.to_str() else { return false };
    if allowed.iter().any(|known| known.eq_ignore_ascii_case(origin)) {
        return true;
    }
    let host = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    let own = [address.to_string(), format!("localhost:{}", address.port())];
    host.is_some_and(|host| own.iter().any(|own| own.eq_ignore_ascii_case(host)))
}

/// Returns whether a request is meant for this server. On this machine alone its `Host` must be `localhost`, an
/// address or a name of the list: a page whose name was made to lead here (DNS rebinding) could read everything
/// otherwise. The port may be another, of a tunnel. Elsewhere TLS proves the name to the client.
pub(crate) fn is_host_allowed(headers: &HeaderMap, address: SocketAddr, allowed: &[String]) -> bool {
    if !address.ip().is_loopback() {
        return true;
    }
    let Some(host) = headers.get(HOST).and_then(|host| host.to_str().ok()) else { return false };
    let Some(authority) = host.parse::<Authority>().ok().filter(|_| !host.contains('@')) else {
        return false;
    };
    let name = authority.host().trim_start_matches('[').trim_end_matches(']');
    let is_here = name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok();
    let mut listed = allowed.iter().filter_map(|origin| origin.split("://").nth(1));
    is_here || listed.any(|known| known.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_leads_here_is_not_enough() {
        let (loopback, public): (SocketAddr, SocketAddr) =
            ("127.0.0.1:8765".parse().unwrap(), "0.0.0.0:8765".parse().unwrap());
        let allowed = ["https://lab.example".to_owned()];
        let is_allowed = |host: Option<&str>, address| {
            let headers = host.map(|host| (HOST, HeaderValue::from_str(host).unwrap()));
            is_host_allowed(&headers.into_iter().collect(), address, &allowed)
        };
        for good in ["127.0.0.1:8765", "localhost:9000", "LOCALHOST", "[::1]:8765", "lab.example"] {
            assert!(is_allowed(Some(good), loopback), "{good}");
        }
        for bad in [
            "evil.example",
            "evil.example:8765",
            "localhost.evil.example:8765",
            "",
            "127.0.0.1.evil",
            "x@localhost",
        ] {
            assert!(!is_allowed(Some(bad), loopback), "{bad}");
        }
        assert!(!is_allowed(None, loopback) && is_allowed(Some("anything"), public));
    }

    #[test]
    fn only_own_and_listed_origins_are_welcome() {
        let address: SocketAddr = "127.0.0.1:8765".parse().unwrap();
        let allowed = ["https://lab.example".to_owned()];
        let is_allowed =
            |origin: &str| is_origin_allowed(&HeaderValue::from_str(origin).unwrap(), address, &allowed);
        for good in [
            "http://127.0.0.1:8765",
            "http://localhost:8765",
            "https://localhost:8765",
            "https://lab.example",
            "https://LAB.example",
        ] {
            assert!(is_allowed(good), "{good}");
        }
        for bad in [
            "null",
            "",
            "http://localhost",
            "http://localhost:80",
            "https://lab.example.evil.com",
            "https://evil.com",
            "http://127.0.0.1:8765.evil.com",
        ] {
            assert!(!is_allowed(bad), "{bad}");
        }
    }
}
