//! The benchmark in this process, without a server.

use std::path::PathBuf;

use crazyflie_bench::robustness::compare;
use crazyflie_bench::{Bench, Entrant, Error, baselines, default_path};
use pyo3::prelude::*;
use serde_json::Value;

use crate::custom::spec;
use crate::errors::{Failure, guarded, parse_json};

fn json(value: &impl serde::Serialize) -> Result<String, Error> {
    serde_json::to_string(value).map_err(|e| crazyflie_env::Error::Config(e.to_string()).into())
}

/// Attempts at a scenario (or "all") from beginning to end, stored in the database `data` (that of `crazyflie
/// bench` unless given); `controllers`: one for all drones, or one for each. Returns the signed documents, a
/// JSON list.
#[pyfunction]
#[pyo3(signature = (controllers, scenario, *, options = "null", collision_avoidance = false, data = None))]
pub fn submit(
    py: Python<'_>,
    controllers: Vec<Bound<'_, PyAny>>,
    scenario: &str,
    options: &str,
    collision_avoidance: bool,
    data: Option<PathBuf>,
) -> PyResult<String> {
    let options: Value = guarded(|| parse_json("options", options))?;
    let controllers =
        controllers.iter().map(|asked| spec(asked, options.clone(), None)).collect::<PyResult<_>>()?;
    let entrant = Entrant { controllers, avoid: collision_avoidance };
    let data = data.unwrap_or_else(default_path);
    py.detach(|| {
        guarded(|| {
            let bench = Bench::open(&data)?;
            let ids = match scenario {
                "all" => bench.scenarios().iter().map(|scenario| scenario.id()).collect(),
                name => vec![bench.scenario(name)?.id()],
            };
            let documents: Result<Vec<_>, Error> =
                ids.iter().map(|id| baselines::submit(&bench, id, &entrant)).collect();
            json(&documents?)
        })
    })
}

/// Flies controllers in scenarios under every condition of `crazyflie bench robustness`, for the seeds
/// `first_seed` and so on. Returns a row for each, as a JSON list.
#[pyfunction]
#[pyo3(signature = (controllers, scenarios, seeds, first_seed, *, options = "null"))]
pub fn robustness(
    py: Python<'_>,
    controllers: Vec<Bound<'_, PyAny>>,
    scenarios: Vec<String>,
    seeds: u32,
    first_seed: u64,
    options: &str,
) -> PyResult<String> {
    let options: Value = guarded(|| parse_json("options", options))?;
    let chosen =
        controllers.iter().map(|asked| spec(asked, options.clone(), None)).collect::<PyResult<Vec<_>>>()?;
    let seeds: Vec<u64> = (0..u64::from(seeds)).map(|i| first_seed.wrapping_add(i)).collect();
    py.detach(|| guarded(|| json(&compare(&chosen, &scenarios, &seeds, &|| {})?)))
}

/// Verifies the attempts in a part of a season's archive: its first line and the lines of some attempts. Returns a
/// verdict for each, as a JSON list.
#[pyfunction]
pub fn verify_attempts(py: Python<'_>, archive: &str) -> PyResult<String> {
    py.detach(|| guarded(|| json(&Bench::open_part(archive)?.verify_all(&|_, _| ())?.0)))
}

/// Opens a season's archive, which must be whole. Returns the season and the public key, as JSON.
#[pyfunction]
pub fn read_season(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    py.detach(|| {
        guarded(|| {
            let bench = Bench::open_existing(&path)?;
            json(&serde_json::json!({"seasons": bench.seasons()?, "public_key": bench.public_key()}))
        })
    })
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Env(error) => error.into(),
            Error::Scenario { .. }
            | Error::Name { .. }
            | Error::Missing { .. }
            | Error::Foreign { .. }
            | Error::Damaged(_) => Failure::Argument(error.to_string()),
            _ => Failure::Moment(error.to_string()),
        }
    }
}
