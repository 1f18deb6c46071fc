//! Messages of the benchmark, besides those of every server.

#![allow(missing_docs, reason = "docs/protocol.md says what every field means")]

use std::borrow::Cow;

use crazyflie_env::action::Interface;
use crazyflie_server::protocol::Rows;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::PlannedPhase;

/// The types of the requests; the first begins an attempt.
pub(crate) const REQUESTS: [&str; 2] = ["benchmark", "finish"];

/// A request, apart from its id.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Request {
    Benchmark(Benchmark),
    Finish(Finish),
}

/// An attempt at a scenario of the benchmark.
#[derive(Serialize, Deserialize)]
pub struct Benchmark {
    /// `name@version`, or a name alone.
    pub scenario: String,
    pub controller: String,
    /// A team's.
    pub token: String,
    /// It may take the place of the team's entry, if that has another name.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub new_entry: bool,
}

impl std::fmt::Debug for Benchmark {
    // the token is not for logs
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Benchmark({:?}, {:?})", self.scenario, self.controller)
    }
}

/// The end of an attempt: it is scored and stored.
#[derive(Debug, Serialize, Deserialize)]
pub struct Finish {}

/// A response, apart from those of every server.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Response<'a> {
    Begun(Box<AttemptInfo<'a>>),
    /// The stored row of an attempt.
    Finished {
        id: u64,
        attempt: Map<String, Value>,
    },
}

/// Fields that the benchmark adds to the reply to `hello`.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Offer {
    /// By `name@version`; none on a server without the benchmark.
    #[serde(default)]
    pub scenarios: Vec<String>,
}

/// Reply to `benchmark`: the attempt and its first observations.
#[derive(Debug, Serialize, Deserialize)]
pub struct AttemptInfo<'a> {
    pub id: u64,
    pub attempt: Cow<'a, str>,
    pub scenario: String,
    pub scenario_hash: Cow<'a, str>,
    /// Rows in and out: the drones of all episodes, in lock-step.
    pub num_envs: usize,
    /// In each episode.
    pub drones: usize,
    /// Numbers in a row of observations.
    pub width: usize,
    pub tick_s: f64,
    pub interface: Interface,
    /// The parts of the flight, for controllers that need to know when to take off and when to land.
    pub phases: Cow<'a, [PlannedPhase]>,
    pub observation: Rows<'a>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_of_the_protocol_has_every_request_and_no_other() {
        let page = include_str!("../../../docs/protocol.md");
        let section = page.split_once("## Attempts at the benchmark").expect("a section").1;
        let table = section.split_once("| request | fields").expect("a table of requests").1;
        let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
        let documented: Vec<&str> = rows.filter_map(|row| row.split('`').nth(1)).collect();
        assert_eq!(documented, REQUESTS);
        let benchmark =
            Benchmark { scenario: "x".into(), controller: "c".into(), token: "t".into(), new_entry: false };
        let kinds = [Request::Benchmark(benchmark), Request::Finish(Finish {})]
            .map(|request| serde_json::to_value(request).unwrap()["type"].clone());
        assert_eq!(kinds, REQUESTS);
    }
}
