//! Lists that are the same for everybody: one is made at a time, kept for all who request it, and made again when the
//! database has changed.

use std::collections::HashMap;
use std::sync::Arc;

use axum::body::Bytes;
use tokio::sync::Mutex;
use tokio::task::{JoinError, spawn_blocking};
use tracing::error;

use super::routes::Site;
use crate::api::ApiBody;
use crate::{Bench, Error, Result, Revision};

/// Lists that are kept.
const KEPT: usize = 16;

#[derive(Default)]
pub(super) struct KeptLists(Mutex<(Option<Revision>, HashMap<String, Bytes>)>);

/// The list `name`, which `make` makes of the database.
pub(super) async fn list(
    site: Arc<Site>,
    name: String,
    make: impl FnOnce(&Bench) -> Result<ApiBody> + Send + 'static,
) -> Result<Bytes> {
    let broken = |bug: JoinError| {
        error!(%bug, "a list of the benchmark broke");
        Error::Internal("a bug; the server's log says more".into())
    };
    // a task of its own: a client that goes away must not let the next one begin beside it
    let look = tokio::spawn(async move {
        let mut kept = site.lists.0.lock().await;
        let bench = site.bench.clone();
        let known = kept.clone();
        let key = name.clone();
        let made = spawn_blocking(move || {
            // asked before anything is read: what is committed in between is seen the next time
            let revision = bench.revision()?;
            let known = known.1.get(&key).filter(|_| known.0 == Some(revision));
            let body =
                known.map_or_else(|| make(&bench).map(|body| body.bytes.into()), |body| Ok(body.clone()));
            Ok((revision, body?))
        });
        let (revision, body) = match made.await? {
            Ok(made) => made,
            Err(problem) => return Ok(Err(problem)),
        };
        if kept.0 != Some(revision) || kept.1.len() >= KEPT {
            *kept = (Some(revision), HashMap::new());
        }
        kept.1.insert(name, Bytes::clone(&body));
        Ok(Ok(body))
    });
    look.await.and_then(|looked| looked).map_err(broken)?
}
