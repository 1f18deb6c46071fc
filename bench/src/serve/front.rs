//! Answers for every visitor of the page: the flight that loops, and the overview of the benchmark. Both are
//! made once for all, and again only when the database has changed.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::http::HeaderMap;
use axum::response::Response;
use crazyflie_server::serve::TaggedBody;
use tokio::task::{JoinError, spawn_blocking};
use tracing::error;

use super::overview::overview;
use super::routes::{Site, bench_error_response};
use super::showcase::{self, Showcase};
use crate::{Bench, Error, Result, Revision};

/// Shortest time between two reads of the database, however many requests arrive.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// The answers, once they have been requested.
#[derive(Default)]
pub(super) struct FrontPage {
    answers: tokio::sync::Mutex<Option<Arc<Answers>>>,
}

#[derive(Clone)]
pub(super) struct Answers {
    looked: Instant,
    /// Revision of the database that they were made from.
    revision: Revision,
    showcase: Showcase,
    pub flight: TaggedBody,
    pub overview: TaggedBody,
}

pub(super) async fn answer(
    site: Arc<Site>,
    headers: HeaderMap,
    choose: fn(&Answers) -> &TaggedBody,
) -> Response {
    match newest(site).await {
        Ok(answers) => choose(&answers).response(&headers),
        Err(problem) => bench_error_response(problem),
    }
}

/// Returns the present answers. Requests that arrive while they are computed wait for them, and compute none.
async fn newest(site: Arc<Site>) -> Result<Arc<Answers>> {
    let broken = |bug: JoinError| {
        error!(%bug, "the front page broke");
        Error::Internal("a bug; the server's log says more".into())
    };
    // a task of its own: a visitor who goes away must not take an answer along that the next one waits for
    let look = tokio::spawn(async move {
        let mut kept = site.front.answers.lock().await;
        if let Some(answers) = kept.as_ref().filter(|answers| answers.looked.elapsed() < LOOK_AGAIN) {
            return Ok(Ok(Arc::clone(answers)));
        }
        let _turn = site.turns.acquire().await;
        let (before, shared) = (kept.clone(), Arc::clone(&site));
        let made = spawn_blocking(move || make(&shared.bench, before.as_deref())).await?;
        Ok(made.map(|made| Arc::clone(kept.insert(Arc::new(made)))))
    });
    look.await.and_then(|looked| looked).map_err(broken)?
}

/// The answers before if no attempt was begun or has ended since, otherwise new ones.
fn make(bench: &Bench, before: Option<&Answers>) -> Result<Answers> {
    let looked = Instant::now();
    // asked before anything is read: what is committed in between is seen the next time
    let revision = bench.revision()?;
    if let Some(before) = before.filter(|before| before.revision == revision) {
        return Ok(Answers { looked, ..before.clone() });
    }
    let showcase = showcase::choose(bench, before.map(|before| &before.showcase))?;
    let table = serde_json::to_vec(&overview(bench)?).map_err(|e| Error::Internal(e.to_string()))?;
    let flight = TaggedBody::new("application/octet-stream", showcase.frames.clone());
    let overview = TaggedBody::new("application/json", table.into());
    Ok(Answers { looked, revision, showcase, flight, overview })
}
