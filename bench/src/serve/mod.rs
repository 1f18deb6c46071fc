//! The benchmark on a server: what plugs into [`crazyflie_server::serve`].

mod front;
mod kept;
mod overview;
pub mod protocol;
mod routes;
mod session;
mod showcase;

use std::sync::Arc;

use axum::Router;
use crazyflie_server::protocol::{Code, Fields, ProtocolError};
use crazyflie_server::serve::{Begun, Extension};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::registry::Registry;
use serde_json::{Map, Value};
use tokio::sync::Semaphore;
use tokio::task::block_in_place;

use crate::{Bench, Error, Scenario, Submitter};
use protocol::REQUESTS;

/// A benchmark that a server offers.
pub struct Benchmark {
    bench: Bench,
    counters: Counters,
}

/// Counts of attempts over the network.
#[derive(Debug, Clone, Default)]
struct Counters {
    begun: Counter,
    finished: Counter,
    abandoned: Counter,
}

impl Benchmark {
    /// For [`crazyflie_server::serve::Settings::extension`].
    pub fn extension(bench: Bench) -> Arc<dyn Extension> {
        Arc::new(Benchmark { bench, counters: Counters::default() })
    }
}

impl Extension for Benchmark {
    fn name(&self) -> &'static str {
        "benchmark"
    }

    fn requests(&self) -> &'static [&'static str] {
        &REQUESTS
    }

    fn knows_token(&self, token: &str) -> bool {
        block_in_place(|| self.bench.team(Submitter::Token(token)).is_ok())
    }

    fn welcome(&self) -> Map<String, Value> {
        let scenarios: Vec<_> = self.bench.scenarios().iter().map(Scenario::id).collect();
        Map::from_iter([("scenarios".to_owned(), scenarios.into())])
    }

    fn routes(self: Arc<Self>, turns: Arc<Semaphore>) -> Router {
        routes::router(self.bench.clone(), turns)
    }

    fn register(&self, registry: &mut Registry) {
        let Counters { begun, finished, abandoned } = &self.counters;
        registry.register("attempts_begun", "Attempts at the benchmark begun", begun.clone());
        registry.register("attempts_finished", "Attempts finished and stored", finished.clone());
        let help = "Attempts that ended before they were finished";
        registry.register("attempts_abandoned", help, abandoned.clone());
    }

    fn begin(&self, id: u64, fields: &Fields<'_>) -> Result<Begun, ProtocolError> {
        session::begin(&self.bench, &self.counters, id, &fields.read()?)
    }
}

impl From<Error> for ProtocolError {
    fn from(error: Error) -> Self {
        let error = error.for_clients();
        let code = Code::Other(error.code().into());
        ProtocolError { code, message: error.to_string(), retry_after_s: error.retry_after_s() }
    }
}
