//! What every visitor of the page asks for: the flight that loops, and the overview of the benchmark. Both are
//! made once for all, and again only when the database has changed.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use sha2::{Digest, Sha256};
use tokio::task::{JoinError, spawn_blocking};
use tracing::error;

use super::bench_routes::bench_error_response;
use super::overview::{Overview, overview};
use super::server::Server;
use super::showcase::{self, Showcase};
use crate::bench::{Bench, Error, Result, Revision};

/// The database is looked at this often at most, however many ask.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// The answers, once somebody has asked.
#[derive(Default)]
pub(crate) struct FrontPage {
    answers: tokio::sync::Mutex<Option<Arc<Answers>>>,
}

struct Answers {
    looked: Instant,
    /// Of the database that they were made from; none without a benchmark.
    revision: Option<Revision>,
    showcase: Showcase,
    flight: Body,
    overview: Body,
}

/// Bytes, and a tag by which a browser asks whether they are still the same.
#[derive(Clone)]
struct Body {
    content_type: &'static str,
    bytes: Bytes,
    tag: String,
}

impl Body {
    fn new(content_type: &'static str, bytes: Bytes) -> Body {
        let tag = format!("\"{}\"", hex::encode(&Sha256::digest(&bytes)[..16]));
        Body { content_type, bytes, tag }
    }

    fn response(self, request_headers: &HeaderMap) -> Response {
        let known = request_headers.get(IF_NONE_MATCH).and_then(|known| known.to_str().ok());
        let same = known.is_some_and(|known| known.contains(&self.tag));
        let headers =
            [(CONTENT_TYPE, self.content_type), (CACHE_CONTROL, "no-cache"), (ETAG, self.tag.as_str())];
        if same {
            (StatusCode::NOT_MODIFIED, headers).into_response()
        } else {
            (headers, self.bytes).into_response()
        }
    }
}

pub(crate) fn routes() -> Router<Arc<Server>> {
    Router::new()
        .route(
            "/showcase",
            get(|State(server): State<Arc<Server>>, headers: HeaderMap| async move {
                answer(server, &headers, |answers| answers.flight.clone()).await
            }),
        )
        .route(
            "/overview",
            get(|State(server): State<Arc<Server>>, headers: HeaderMap| async move {
                answer(server, &headers, |answers| answers.overview.clone()).await
            }),
        )
}

async fn answer(server: Arc<Server>, headers: &HeaderMap, choose: fn(&Answers) -> Body) -> Response {
    match newest(server).await {
        Ok(answers) => choose(&answers).response(headers),
        Err(problem) => bench_error_response(&problem),
    }
}

/// The answers of now. Who comes while they are made waits for them, and makes none.
async fn newest(server: Arc<Server>) -> Result<Arc<Answers>> {
    let broken = |bug: JoinError| {
        error!(%bug, "the front page broke");
        Error::Internal("a bug; the server's log says more".into())
    };
    // a task of its own: a visitor who goes away must not take an answer along that the next one waits for
    let look = tokio::spawn(async move {
        let mut kept = server.front.answers.lock().await;
        if let Some(answers) = kept.as_ref().filter(|answers| answers.looked.elapsed() < LOOK_AGAIN) {
            return Ok(Ok(Arc::clone(answers)));
        }
        let _turn = server.flights.acquire().await;
        let (before, shared) = (kept.clone(), Arc::clone(&server));
        let made = spawn_blocking(move || make(shared.bench.as_ref(), before.as_deref())).await?;
        Ok(made.map(|made| Arc::clone(kept.insert(Arc::new(made)))))
    });
    look.await.and_then(|looked| looked).map_err(broken)?
}

/// The answers before if no attempt was begun or has ended since, otherwise new ones.
fn make(bench: Option<&Bench>, before: Option<&Answers>) -> Result<Answers> {
    let looked = Instant::now();
    // asked before anything is read: what is committed in between is seen the next time
    let revision = bench.map(Bench::revision).transpose()?;
    if let Some(before) = before.filter(|before| before.revision == revision) {
        let Answers { showcase, flight, overview, .. } = before;
        let (showcase, flight, overview) = (showcase.clone(), flight.clone(), overview.clone());
        return Ok(Answers { looked, revision, showcase, flight, overview });
    }
    let showcase = showcase::choose(bench, before.map(|before| &before.showcase))?;
    let table = bench.map(overview).transpose()?.unwrap_or_else(Overview::default);
    let table = serde_json::to_vec(&table).map_err(|e| Error::Internal(e.to_string()))?;
    let flight = Body::new("application/octet-stream", showcase.frames.clone());
    let overview = Body::new("application/json", table.into());
    Ok(Answers { looked, revision, showcase, flight, overview })
}

/// The text that the page links to: how to fly from any language.
pub(crate) async fn protocol() -> Response {
    const TEXT: &str = include_str!("../../../docs/protocol.md");
    ([(CONTENT_TYPE, "text/plain; charset=utf-8"), (CACHE_CONTROL, "no-cache")], TEXT).into_response()
}
