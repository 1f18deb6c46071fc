//! Counters for Prometheus, and a line in the log for each limit that is reached.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use prometheus_client::encoding::EncodeLabelValue;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry, Unit};
use serde::Serialize;
use tracing::{info, warn};

use super::allowance::Allowance;
use super::budget::Resource;
use super::extension::Extension;

/// Lines of a kind that are logged for an address within [`QUIET`]; a limit that it reaches is logged once.
const LINES: u32 = 32;
const QUIET: Duration = Duration::from_secs(10);

/// Reason that a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, EncodeLabelValue, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionEnd {
    /// By its client.
    Closed,
    /// Its client went away and did not return.
    Expired,
    /// The server stopped.
    Stopped,
    /// It waited for its client, and its place was needed.
    Evicted,
    /// By a bug: no other end was recorded.
    Broken,
}

impl SessionEnd {
    /// Every way in which a session ends.
    pub(crate) const ALL: [SessionEnd; 5] = [
        SessionEnd::Closed,
        SessionEnd::Expired,
        SessionEnd::Stopped,
        SessionEnd::Evicted,
        SessionEnd::Broken,
    ];
}

/// A metric for each value of one label.
type Labelled<T, M> = Family<[(&'static str, T); 1], M>;

pub struct Metrics {
    registry: Registry,
    held: Labelled<Resource, Gauge>,
    limits: Labelled<&'static str, Counter>,
    /// Limits that are logged, and other lines, by what they are about.
    logged: Allowance<(&'static str, IpAddr)>,
    lines: Allowance<(&'static str, IpAddr)>,
    /// Connections that wait for their turn at the processor.
    pub queue: Gauge,
    resident_bytes: Gauge,
    pub connections: Gauge,
    pub connections_total: Counter,
    refused: Labelled<&'static str, Counter>,
    sessions: Gauge,
    pub sessions_total: Counter,
    ended: Labelled<SessionEnd, Counter>,
    pub requests: Counter,
    pub faults: Counter,
    pub env_steps: Counter,
    pub request_s: Histogram,
}

impl Metrics {
    /// The server's own, and those of its extension.
    pub(crate) fn new(extension: Option<&Arc<dyn Extension>>) -> Self {
        let mut registry = Registry::with_prefix("crazyflie");
        let r = &mut registry;
        if let Some(extension) = extension {
            extension.register(r);
        }
        let metrics = Metrics {
            connections: register(r, "connections", "Open connections"),
            connections_total: register(r, "connections_accepted", "Connections accepted"),
            refused: register(r, "connections_refused", "Connections refused or closed by a limit"),
            sessions: register(r, "sessions", "Sessions, those that wait for their clients included"),
            sessions_total: register(r, "sessions_begun", "Sessions begun"),
            ended: register(r, "sessions_ended", "Sessions ended"),
            requests: register(r, "requests", "Requests answered"),
            faults: register(r, "requests_refused", "Requests answered with an error"),
            env_steps: register(r, "env_steps", "Environment steps"),
            request_s: histogram(r),
            held: register(r, "held", "What clients hold of each resource that has a limit"),
            limits: register(r, "limits_reached", "Requests for more than a limit allows"),
            logged: Allowance::new(1, QUIET),
            lines: Allowance::new(LINES, QUIET),
            queue: register(r, "queue", "Connections that wait for their turn at the processor"),
            resident_bytes: register(
                r,
                "resident_bytes",
                "Memory that the program has, where the system tells",
            ),
            registry: Registry::default(),
        };
        Metrics { registry, ..metrics }
    }

    pub(crate) fn record_refusal(&self, reason: &'static str) {
        self.refused.get_or_create(&[("reason", reason)]).inc();
    }

    /// Counts that a limit was reached, and logs it unless it was logged a moment ago.
    pub(crate) fn record_limit(&self, reason: &'static str, address: IpAddr) {
        self.limits.get_or_create(&[("reason", reason)]).inc();
        if self.logged.take((reason, address)) > 0 {
            warn!(limit = reason, %address, "a limit is reached");
        }
    }

    /// Returns whether one more line about this is logged for a client, whose requests must not fill the disk.
    pub(crate) fn may_log(&self, about: &'static str, address: IpAddr) -> bool {
        let left = self.lines.take((about, address));
        if left == 1 {
            info!(about, %address, "the next line is the last one of its kind for a while");
        }
        left > 0
    }

    pub(crate) fn set_held(&self, resource: Resource, amount: usize) {
        self.held.get_or_create(&[("resource", resource)]).set(amount as i64);
    }

    pub(crate) fn record_session_start(&self) {
        self.sessions.inc();
        self.sessions_total.inc();
    }

    pub(crate) fn record_session_end(&self, end: SessionEnd) {
        self.sessions.dec();
        self.ended.get_or_create(&[("end", end)]).inc();
    }

    pub(crate) fn session_ends(&self, end: SessionEnd) -> u64 {
        self.ended.get_or_create(&[("end", end)]).get()
    }

    /// In the text format that Prometheus reads.
    pub(crate) fn text(&self) -> String {
        if let Some(memory) = memory_stats::memory_stats() {
            self.resident_bytes.set(memory.physical_mem as i64);
        }
        let mut text = String::new();
        // writing to a string does not fail
        let _ = encode(&mut text, &self.registry);
        text
    }
}

fn register<M: Metric + Clone + Default>(registry: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

fn histogram(registry: &mut Registry) -> Histogram {
    let buckets = [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 0.1, 1.0];
    let histogram = Histogram::new(buckets);
    registry.register_with_unit(
        "request",
        "Time to carry out a request, without the network",
        Unit::Seconds,
        histogram.clone(),
    );
    histogram
}
