//! A log that somebody drops on the page. It is counted while it is here, and nothing of it stays.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use futures_util::StreamExt as _;
use serde_json::json;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::answers::{QueryOf, bad_request, error_response};
use super::budget::{Buffer, Resource, Share};
use super::http::simulate;
use super::server::{FLIGHTS_AT_ONCE, Peer, Server, UPLOADS};
use super::service::unavailable;
use super::upgrade;
use crate::log_replay::{LogQuery, Problem};

/// Largest log, packed or not.
const MOST_BYTES: usize = 16 << 20;

/// The flight of a log beside its model's.
pub(super) async fn replay_log(
    State(server): State<Arc<Server>>,
    Extension(peer): Extension<Arc<Peer>>,
    QueryOf(query): QueryOf<LogQuery>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Response> {
    let is_foreign = |origin| !upgrade::is_origin_allowed(origin, server.address, &server.settings.origins);
    if headers.get(ORIGIN).is_some_and(is_foreign) {
        let problem = "pages of other origins: see --allow-origin";
        return Err(error_response(StatusCode::FORBIDDEN, "origin", problem));
    }
    let address = peer.payer().address;
    if server.uploads.take(address) == 0 {
        server.metrics.record_limit("too many logs", address);
        let problem = format!("your address sends more than {UPLOADS} logs a minute: try again later");
        return Err(error_response(StatusCode::TOO_MANY_REQUESTS, "too_many", &problem));
    }
    let mut buffer = server.budgets.buffer(Resource::RequestBytes, peer.payer(), peer.limits().free_bytes);
    let bytes = received(&headers, body, &mut buffer, peer.limits().message_timeout).await?;
    // ends with the client: hyper drops this future then
    let gone = CancellationToken::new();
    let _guard = gone.clone().drop_guard();
    // all turns: one log at a time, since it takes many times its size while it is read
    let answer = simulate(&server, FLIGHTS_AT_ONCE, move || {
        let answer = query.answer(&bytes, || gone.is_cancelled());
        drop((bytes, buffer));
        answer.and_then(|answer| serde_json::to_vec(&answer).map_err(|e| Problem::Log(e.to_string())))
    });
    let text = answer.await?.map_err(refused)?;
    let share = server.budgets.charge(Resource::ReplyBytes, peer.payer(), text.len()).map_err(unavailable)?;
    let body = Body::from(Bytes::from_owner(CountedReply(text, share)));
    Ok(([(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], body).into_response())
}

/// A reply that is counted until it is sent.
struct CountedReply(Vec<u8>, #[allow(dead_code, reason = "given back when dropped")] Share);

impl AsRef<[u8]> for CountedReply {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// The bytes of a request, counted twice while they grow: the vector moves.
async fn received(
    headers: &HeaderMap,
    body: Body,
    buffer: &mut Buffer,
    patience: Duration,
) -> Result<Vec<u8>, Response> {
    let too_large = || {
        let problem = format!("expected a log of at most {} MiB; gzip makes it smaller", MOST_BYTES >> 20);
        error_response(StatusCode::PAYLOAD_TOO_LARGE, "too_large", &problem)
    };
    let told = headers.get(CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<usize>().ok());
    if told.is_some_and(|told| told > MOST_BYTES) {
        return Err(too_large());
    }
    let (mut bytes, mut parts) = (Vec::new(), body.into_data_stream());
    loop {
        let part = match timeout(patience, parts.next()).await {
            Ok(None) => break,
            Ok(Some(Ok(part))) => part,
            Ok(Some(Err(_))) => return Err(bad_request("the body ends early")),
            Err(_) => {
                let problem = format!("nothing came for {} s", patience.as_secs());
                return Err(error_response(StatusCode::REQUEST_TIMEOUT, "bad_message", &problem));
            }
        };
        if bytes.len() + part.len() > MOST_BYTES {
            return Err(too_large());
        }
        buffer.fit(2 * (bytes.len() + part.len())).map_err(unavailable)?;
        bytes.extend_from_slice(&part);
    }
    if bytes.is_empty() {
        return Err(bad_request("expected a flight log in the body, found nothing"));
    }
    Ok(bytes)
}

fn refused(problem: Problem) -> Response {
    match problem {
        Problem::Query(problem) => bad_request(&problem),
        Problem::Log(problem) => error_response(StatusCode::UNPROCESSABLE_ENTITY, "bad_log", &problem),
        Problem::Grave(findings) => {
            let message = findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
            let body =
                json!({"type": "error", "code": "grave_findings", "message": message, "findings": findings});
            (StatusCode::UNPROCESSABLE_ENTITY, Json(body)).into_response()
        }
        Problem::Gone => {
            error_response(StatusCode::SERVICE_UNAVAILABLE, "unavailable", "nobody waits for it")
        }
    }
}

/// The answer to a method that this path does not have.
pub(super) async fn only_post() -> Response {
    error_response(StatusCode::METHOD_NOT_ALLOWED, "bad_method", "this path takes a log: expected POST")
}
