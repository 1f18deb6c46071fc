//! `/api/v1/...` of the benchmark: what `bench::api` hands out, over HTTP. Replays and verification fly again, so they run on a thread where
//! nothing else waits, and few at a time.

use std::sync::Arc;

use axum::extract::{Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::json;
use tokio::task::spawn_blocking;
use tracing::error;

use super::server::Server;
use crate::bench::api::{self, Reply};
use crate::bench::{Bench, Error, Result};

/// Flights that are simulated again for watchers, at a time.
pub(crate) const FLIGHTS_AT_ONCE: usize = 2;

#[derive(Deserialize)]
struct Of {
    scenario: Option<String>,
    #[serde(default)]
    episode: usize,
    #[serde(default)]
    drone: usize,
}

pub(crate) fn routes() -> Router<Arc<Server>> {
    Router::new()
        .route("/scenarios", get(|State(s): State<Arc<Server>>| answer(s, api::scenarios)))
        .route("/leaderboard", get(leaderboard))
        .route(
            "/attempts",
            get(|State(s): State<Arc<Server>>, Query(of): Query<Of>| answer(s, move |b| api::attempts(b, of.scenario.as_deref()))),
        )
        .route("/attempts/{id}", get(|State(s): State<Arc<Server>>, Path(id): Path<String>| answer(s, move |b| api::attempt(b, &id))))
        .route("/attempts/{id}/replay", get(replay))
        .route("/attempts/{id}/log.csv", get(log_csv))
        .route("/attempts/{id}/actions.bin", get(actions))
        .route(
            "/attempts/{id}/verify",
            get(|State(s): State<Arc<Server>>, Path(id): Path<String>| flown(s, move |b| api::verification(b, &id))),
        )
        .route("/key", get(|State(s): State<Arc<Server>>| answer(s, api::key)))
}

async fn leaderboard(State(server): State<Arc<Server>>, Query(of): Query<Of>) -> Response {
    let Some(scenario) = of.scenario else {
        return refused(StatusCode::BAD_REQUEST, "bad_message", "expected ?scenario=ID");
    };
    answer(server, move |bench| api::leaderboard(bench, &scenario)).await
}

async fn replay(State(server): State<Arc<Server>>, Path(id): Path<String>, Query(of): Query<Of>) -> Response {
    flown(server, move |bench| api::replay(bench, &id, of.episode)).await
}

async fn log_csv(State(server): State<Arc<Server>>, Path(id): Path<String>, Query(of): Query<Of>) -> Response {
    let drone = if of.drone == 0 { String::new() } else { format!("-drone-{}", of.drone) };
    let name = format!("{id}-episode-{}{drone}.csv", of.episode);
    saved_as(&name, flown(server, move |bench| api::log_csv(bench, &id, of.episode, of.drone)).await)
}

async fn actions(State(server): State<Arc<Server>>, Path(id): Path<String>) -> Response {
    let name = format!("{id}-actions.bin");
    saved_as(&name, answer(server, move |bench| api::actions(bench, &id)).await)
}

/// What costs a simulation, when it is its turn.
async fn flown(server: Arc<Server>, ask: impl FnOnce(&Bench) -> Result<Reply> + Send + 'static) -> Response {
    let Ok(_turn) = server.flights.clone().acquire_owned().await else {
        return refused(StatusCode::SERVICE_UNAVAILABLE, "unavailable", "the server stops");
    };
    answer(server, ask).await
}

async fn answer(server: Arc<Server>, ask: impl FnOnce(&Bench) -> Result<Reply> + Send + 'static) -> Response {
    let Some(bench) = server.bench.clone() else {
        return refused(StatusCode::NOT_FOUND, "unavailable", "this server has no benchmark");
    };
    match spawn_blocking(move || ask(&bench)).await {
        Ok(Ok(reply)) => ([(header::CONTENT_TYPE, reply.content_type), (header::CACHE_CONTROL, "no-store")], reply.bytes).into_response(),
        Ok(Err(problem)) => failed(&problem),
        Err(bug) => {
            error!(%bug, "the benchmark broke");
            refused(StatusCode::INTERNAL_SERVER_ERROR, "internal", "a bug; the server's log says more")
        }
    }
}

fn failed(problem: &Error) -> Response {
    let status = StatusCode::from_u16(problem.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    if status.is_server_error() {
        error!(%problem, "the benchmark failed");
    }
    let mut response = refused(status, problem.code(), &problem.to_string());
    if let Some(seconds) = problem.retry_after_s() {
        response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
    }
    response
}

pub(crate) fn refused(status: StatusCode, code: &str, message: &str) -> Response {
    (status, Json(json!({"type": "error", "code": code, "message": message}))).into_response()
}

/// A download under a name that only has what file systems take.
pub(crate) fn saved_as(name: &str, mut response: Response) -> Response {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() || "-._".contains(c) { c } else { '_' }).collect();
    if response.status().is_success()
        && let Ok(value) = format!("attachment; filename=\"{plain}\"").parse()
    {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, value);
    }
    response
}
