//! The paths of the server.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, HOST, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Json, Router};
use crazyflie_env::model::VehicleSummary;
use serde::Serialize;
use serde_json::Value;
use tokio::task::spawn_blocking;
use tower_http::compression::CompressionLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use tracing::error;

use super::answers::{PathOf, QueryOf, as_attachment, bad_request, error_response, not_allowed};
use super::budget::Resource;
use super::openenv;
use super::page;
use super::server::{Peer, Server};
use super::service::unavailable;
use super::showcase;
use super::upgrade;
use super::upload;
use super::worlds::LOG_PART_BYTES;
use crate::protocol::ProtocolError;
use crate::tune::TunerQuery;

/// All paths. The extension's and the page join here.
pub(crate) fn router(server: &Arc<Server>) -> Router {
    Router::new()
        .route("/ws", get(ws))
        .route("/live", get(live))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/health", get(openenv::health))
        .route("/metadata", get(openenv::metadata))
        .route("/schema", get(openenv::schema))
        .route("/metrics", get(metrics))
        .route("/protocol.md", get(protocol).layer(CompressionLayer::new()))
        .method_not_allowed_fallback(not_allowed)
        .with_state(server.clone())
        .nest("/api/v1", api(server))
        .fallback_service(get(page::page).fallback(page::page).layer(CompressionLayer::new()))
        .layer(from_fn_with_state(server.clone(), check_host))
        .layer(SetResponseHeaderLayer::overriding(
            X_CONTENT_TYPE_OPTIONS,
            HeaderValue::from_static("nosniff"),
        ))
}

async fn check_host(State(server): State<Arc<Server>>, request: Request, next: Next) -> Response {
    if request.headers().get_all(HOST).iter().count() > 1 {
        server.metrics.record_refusal("host");
        return bad_request("the request has several headers Host, expected one");
    }
    if upgrade::is_host_allowed(request.headers(), server.address, &server.settings.origins) {
        return next.run(request).await;
    }
    server.metrics.record_refusal("host");
    let want = "expected the header Host to be localhost or an address: see --allow-origin for other names";
    error_response(StatusCode::MISDIRECTED_REQUEST, "host", want)
}

/// JSON about what the server does and has. The extension's paths have priority.
fn api(server: &Arc<Server>) -> Router {
    let own = Router::new()
        .route("/extensions", get(extensions))
        .route("/flown", get(flown))
        .route("/log-replay", post(upload::replay_log).fallback(upload::only_post))
        .route("/sessions", get(sessions))
        .route("/showcase", get(showcase::showcase))
        .route("/tuner", get(tuner))
        .route("/vehicles", get(vehicles))
        .route("/worlds", get(worlds))
        .route("/worlds/{name}/log", get(world_log))
        .method_not_allowed_fallback(not_allowed)
        .fallback(|| async { error_response(StatusCode::NOT_FOUND, "not_found", "there is nothing here") })
        .with_state(server.clone());
    match &server.settings.extension {
        Some(extension) => extension.clone().routes(server.flights.clone()).fallback_service(own),
        None => own,
    }
}

async fn extensions(State(server): State<Arc<Server>>) -> Response {
    Json(server.settings.extension.iter().map(|extension| extension.name()).collect::<Vec<_>>())
        .into_response()
}

/// The text that the page links to: how to fly from any language.
async fn protocol() -> Response {
    const TEXT: &str = include_str!("../../protocol.md");
    ([(CONTENT_TYPE, "text/plain; charset=utf-8"), (CACHE_CONTROL, "no-cache")], TEXT).into_response()
}

async fn metrics(State(server): State<Arc<Server>>) -> Response {
    let kind = [(CONTENT_TYPE, "application/openmetrics-text; version=1.0.0; charset=utf-8")];
    server.metrics.queue.set(server.turns.waiting.load(Ordering::Relaxed) as i64);
    (kind, server.metrics.text()).into_response()
}

/// A row of `GET /api/v1/sessions`.
#[derive(Serialize)]
struct SessionRow {
    session: String,
    env: String,
    num_envs: usize,
    /// In each environment.
    drones: usize,
    /// The name of the shared world that it is.
    #[serde(skip_serializing_if = "Value::is_null")]
    world: Value,
    steps: u64,
    since_s: f64,
    watching: usize,
}

async fn sessions(State(server): State<Arc<Server>>) -> Response {
    let rows = server.sessions.all().into_iter().map(|entry| SessionRow {
        session: entry.name(),
        env: entry.env.clone(),
        num_envs: entry.batch(),
        drones: entry.feed.drones,
        world: entry.feed.header["world"].clone(),
        steps: entry.steps.load(Ordering::Relaxed),
        since_s: entry.since.elapsed().as_secs_f64(),
        watching: entry.feed.watchers(),
    });
    ([(CACHE_CONTROL, "no-store")], Json(rows.collect::<Vec<_>>())).into_response()
}

/// Gains on paper and in flight. A thousand flights keep a core busy, so a question waits for its turn, as
/// replays do.
async fn tuner(
    State(server): State<Arc<Server>>,
    QueryOf(query): QueryOf<TunerQuery>,
) -> Result<Response, Response> {
    let answer = simulate(&server, 1, move || query.answer()).await?;
    let answer = answer.map_err(|problem| bad_request(&problem.to_string()))?;
    Ok(([(CACHE_CONTROL, "no-store")], Json(answer)).into_response())
}

/// Flights for an answer, with so many of the turns.
pub(super) async fn simulate<T: Send + 'static>(
    server: &Server,
    turns: u32,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Response> {
    let Ok(turn) = server.flights.clone().acquire_many_owned(turns).await else {
        return Err(error_response(StatusCode::SERVICE_UNAVAILABLE, "unavailable", "the server stops"));
    };
    // the turn ends with the flights, even if nobody waits for them any more
    let flown = spawn_blocking(move || {
        let _turn = turn;
        work()
    });
    flown.await.map_err(|bug| {
        error!(%bug, "flights for an answer broke");
        error_response(StatusCode::INTERNAL_SERVER_ERROR, "internal", "a bug; the server's log says more")
    })
}

async fn vehicles() -> Result<Json<Vec<VehicleSummary>>, Response> {
    VehicleSummary::of_all().map(Json).map_err(|problem| bad_request(&problem.to_string()))
}

async fn flown(State(server): State<Arc<Server>>) -> Response {
    let rows = server.flown.update(&server.worlds.all());
    ([(CACHE_CONTROL, "no-store")], Json(rows)).into_response()
}

async fn worlds(State(server): State<Arc<Server>>) -> Response {
    let rows: Vec<_> = server.worlds.all().iter().map(|entry| entry.row()).collect();
    ([(CACHE_CONTROL, "no-store")], Json(rows)).into_response()
}

async fn world_log(
    State(server): State<Arc<Server>>,
    Extension(peer): Extension<Arc<Peer>>,
    PathOf(name): PathOf<String>,
) -> Result<Response, Response> {
    let unknown =
        |error: ProtocolError| error_response(StatusCode::NOT_FOUND, "unknown_world", &error.message);
    let entry = server.worlds.find(&name).map_err(unknown)?;
    // a part waits in the connection while the next one is written
    let room = server.budgets.charge(Resource::ReplyBytes, peer.payer(), 2 * LOG_PART_BYTES);
    let body = Body::from_stream(entry.log(peer, room.map_err(unavailable)?));
    let kind = [(CONTENT_TYPE, "application/x-ndjson"), (CACHE_CONTROL, "no-store")];
    Ok(as_attachment(&format!("{name}.jsonl"), (kind, body).into_response()))
}

async fn ws(State(server): State<Arc<Server>>, request: Request) -> Response {
    upgrade_response(&server, request, &upgrade::WS)
}

async fn live(State(server): State<Arc<Server>>, request: Request) -> Response {
    upgrade_response(&server, request, &upgrade::LIVE)
}

fn upgrade_response(server: &Arc<Server>, request: Request, dialects: &upgrade::Dialects) -> Response {
    upgrade::upgrade(server, request, dialects)
        .unwrap_or_else(|(status, code, why)| error_response(status, code, &why))
}
