//! Routes `/api/v1/...` of the benchmark. Replays and verification simulate flights again, so they run on a
//! thread where nothing else waits, and few at a time.

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use crazyflie_server::serve::{PathOf, QueryOf, as_attachment, error_response, not_allowed};
use serde::Deserialize;
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;
use tracing::error;

use super::front::{self, FrontPage};
use super::kept::{self, KeptLists};
use crate::api::{self, ApiBody};
use crate::{AttemptPage, Bench, Error, Result};

/// State that the routes share.
pub(super) struct Site {
    pub bench: Bench,
    /// Turns of simulating stored flights again.
    pub turns: Arc<Semaphore>,
    pub front: FrontPage,
    pub lists: KeptLists,
}

/// Query parameters of all routes.
#[derive(Deserialize)]
struct AttemptQuery {
    scenario: Option<String>,
    /// "all" for scenarios at every level.
    levels: Option<String>,
    #[serde(default)]
    episode: usize,
    #[serde(default)]
    drone: usize,
    /// Number of the attempt after which a page begins.
    #[serde(default)]
    after: i64,
    /// Attempts on a page.
    #[serde(default = "page_limit")]
    limit: i64,
}

fn page_limit() -> i64 {
    100
}

/// The largest page of attempts.
const MOST_ATTEMPTS: i64 = 1000;

type AtSite = State<Arc<Site>>;
type Id = PathOf<String>;
type Asked = QueryOf<AttemptQuery>;

pub(super) fn router(bench: Bench, turns: Arc<Semaphore>) -> Router {
    Router::new()
        .route("/scenarios", get(scenarios))
        .route("/leaderboard", get(leaderboard))
        .route("/attempts", get(attempts))
        .route(
            "/attempts/{id}",
            get(|State(s): AtSite, PathOf(id): Id| answer(s, move |b| api::attempt(b, &id))),
        )
        .route("/attempts/{id}/replay", get(replay))
        .route("/attempts/{id}/log.csv", get(log_csv))
        .route("/attempts/{id}/actions.bin", get(actions))
        .route(
            "/attempts/{id}/verify",
            get(|State(s): AtSite, PathOf(id): Id| {
                answer_after_simulation(s, move |b| api::verification(b, &id))
            }),
        )
        .route("/key", get(|State(s): AtSite| answer(s, api::key)))
        .route("/showcase", get(|s: AtSite, h: HeaderMap| front::answer(s.0, h, |a| &a.flight)))
        .route("/overview", get(|s: AtSite, h: HeaderMap| front::answer(s.0, h, |a| &a.overview)))
        .method_not_allowed_fallback(not_allowed)
        .with_state(Arc::new(Site { bench, turns, front: FrontPage::default(), lists: KeptLists::default() }))
}

async fn scenarios(State(site): AtSite, QueryOf(query): Asked) -> Response {
    let all_levels = match query.levels.as_deref() {
        None => false,
        Some("all") => true,
        Some(other) => {
            let message = format!("levels is {other:?}, expected all, or none for the scenarios as declared");
            return error_response(StatusCode::BAD_REQUEST, "bad_message", &message);
        }
    };
    answer(site, move |bench| api::scenarios(bench, all_levels)).await
}

async fn leaderboard(State(site): AtSite, QueryOf(query): Asked) -> Response {
    let Some(scenario) = query.scenario else {
        return error_response(StatusCode::BAD_REQUEST, "bad_message", "expected ?scenario=ID");
    };
    let name = format!("leaderboard {scenario}");
    list(site, name, move |bench| api::leaderboard(bench, &scenario)).await
}

async fn attempts(State(site): AtSite, QueryOf(query): Asked) -> Response {
    let AttemptQuery { scenario, after, limit, .. } = query;
    if !(1..=MOST_ATTEMPTS).contains(&limit) {
        let message = format!("limit is {limit}, expected 1 to {MOST_ATTEMPTS}");
        return error_response(StatusCode::BAD_REQUEST, "bad_message", &message);
    }
    let name = format!("attempts {after} {limit} {}", scenario.as_deref().unwrap_or_default());
    list(site, name, move |bench| api::attempts(bench, scenario.as_deref(), AttemptPage { after, limit }))
        .await
}

/// A list that is kept while the database is as it is.
async fn list(
    site: Arc<Site>,
    name: String,
    make: impl FnOnce(&Bench) -> Result<ApiBody> + Send + 'static,
) -> Response {
    match kept::list(site, name, make).await {
        Ok(bytes) => {
            let headers = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
            (headers, bytes).into_response()
        }
        Err(problem) => bench_error_response(problem),
    }
}

async fn replay(State(site): AtSite, PathOf(id): Id, QueryOf(query): Asked) -> Response {
    answer_after_simulation(site, move |bench| api::replay(bench, &id, query.episode)).await
}

async fn log_csv(State(site): AtSite, PathOf(id): Id, QueryOf(query): Asked) -> Response {
    let drone = if query.drone == 0 { String::new() } else { format!("-drone-{}", query.drone) };
    let name = format!("{id}-episode-{}{drone}.csv", query.episode);
    as_attachment(
        &name,
        answer_after_simulation(site, move |bench| api::log_csv(bench, &id, query.episode, query.drone))
            .await,
    )
}

async fn actions(State(site): AtSite, PathOf(id): Id) -> Response {
    let name = format!("{id}-actions.bin");
    as_attachment(&name, answer(site, move |bench| api::actions(bench, &id)).await)
}

/// An answer that needs a simulation: it waits for its turn.
async fn answer_after_simulation(
    site: Arc<Site>,
    ask: impl FnOnce(&Bench) -> Result<ApiBody> + Send + 'static,
) -> Response {
    let Ok(_turn) = site.turns.clone().acquire_owned().await else {
        return error_response(StatusCode::SERVICE_UNAVAILABLE, "unavailable", "the server stops");
    };
    answer(site, ask).await
}

async fn answer(site: Arc<Site>, ask: impl FnOnce(&Bench) -> Result<ApiBody> + Send + 'static) -> Response {
    match spawn_blocking(move || ask(&site.bench)).await {
        Ok(Ok(json_body)) => (
            [(header::CONTENT_TYPE, json_body.content_type), (header::CACHE_CONTROL, "no-store")],
            json_body.bytes,
        )
            .into_response(),
        Ok(Err(problem)) => bench_error_response(problem),
        Err(bug) => {
            error!(%bug, "the benchmark broke");
            error_response(StatusCode::INTERNAL_SERVER_ERROR, "internal", "a bug; the server's log says more")
        }
    }
}

pub(super) fn bench_error_response(problem: Error) -> Response {
    let status = StatusCode::from_u16(problem.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    // those of the database are logged where they occur
    if status.is_server_error() && !problem.is_away() && !problem.is_of_database() {
        error!(%problem, "the benchmark failed");
    }
    let problem = problem.for_clients();
    let mut response = error_response(status, problem.code(), &problem.to_string());
    if let Some(seconds) = problem.retry_after_s() {
        response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
    }
    response
}
