//! Bodies of the HTTP API, with their types. No seed can be derived from them.

use serde::Serialize;
use serde_json::{Value, json};

use super::error::{Error, Result};
use super::{AttemptEntry, AttemptPage, BUILD, Bench};

/// A body and its type.
#[derive(Debug)]
pub struct ApiBody {
    pub(crate) content_type: &'static str,
    /// Payload of the reply, in the encoding that the type names.
    pub bytes: Vec<u8>,
}

fn json_body(value: &impl Serialize) -> Result<ApiBody> {
    let bytes = serde_json::to_vec(value).map_err(|e| Error::Internal(e.to_string()))?;
    Ok(ApiBody { content_type: "application/json", bytes })
}

/// `GET /api/v1/scenarios`: those as declared; with `?levels=all` at every level.
pub(crate) fn scenarios(bench: &Bench, all_levels: bool) -> Result<ApiBody> {
    let scenarios = if all_levels { bench.all_scenarios() } else { bench.scenarios() };
    json_body(&scenarios.iter().map(|s| s.public()).collect::<Vec<_>>())
}

/// `GET /api/v1/leaderboard?scenario=ID`
pub(crate) fn leaderboard(bench: &Bench, scenario: &str) -> Result<ApiBody> {
    json_body(&bench.leaderboard(bench.scenario(scenario)?)?)
}

/// `GET /api/v1/attempts?scenario=ID&after=N&limit=M`: a page of the attempts, without their episodes; of all scenarios
/// if none is named.
pub fn attempts(bench: &Bench, scenario: Option<&str>, page: AttemptPage) -> Result<ApiBody> {
    let scenario = scenario.map(|name| bench.scenario(name)).transpose()?.map(|s| s.id());
    let short_json = |entry: &AttemptEntry| {
        let mut value = full_json(entry);
        if let Some(result) = value.get_mut("result").and_then(Value::as_object_mut) {
            result.remove("episodes");
        }
        value
    };
    json_body(&bench.attempts_of(scenario.as_deref(), page)?.iter().map(short_json).collect::<Vec<_>>())
}

/// `GET /api/v1/attempts/ID`: all that was signed, and the signature.
pub fn attempt(bench: &Bench, id: &str) -> Result<ApiBody> {
    json_body(&full_json(&bench.attempt(id)?))
}

fn full_json(entry: &AttemptEntry) -> Value {
    match &entry.document {
        Ok(document) => {
            let mut value = json!(document);
            value["at"] = json!(document.begun_ms as f64 / 1000.0);
            value["signature"] = json!(hex::encode(&entry.signature));
            value
        }
        Err(problem) => {
            json!({"id": entry.id, "number": entry.number, "status": "damaged", "problem": problem})
        }
    }
}

/// `GET /api/v1/attempts/ID/replay?episode=N`
pub(crate) fn replay(bench: &Bench, id: &str, episode: usize) -> Result<ApiBody> {
    Ok(ApiBody { content_type: "application/octet-stream", bytes: bench.replay(id, episode)?.frames(None)? })
}

/// `GET /api/v1/attempts/ID/log.csv?episode=N&drone=M`
pub fn log_csv(bench: &Bench, id: &str, episode: usize, drone: usize) -> Result<ApiBody> {
    Ok(ApiBody { content_type: "text/csv; charset=utf-8", bytes: bench.replay(id, episode)?.csv(drone)? })
}

/// `GET /api/v1/attempts/ID/actions.bin`
pub(crate) fn actions(bench: &Bench, id: &str) -> Result<ApiBody> {
    Ok(ApiBody { content_type: "application/octet-stream", bytes: bench.actions(id)? })
}

/// `GET /api/v1/attempts/ID/verify`: the attempt, flown again.
pub(crate) fn verification(bench: &Bench, id: &str) -> Result<ApiBody> {
    json_body(&bench.verify(id)?)
}

/// `GET /api/v1/key`: what signatures are checked with, over which bytes, and the newest row: who has noted it finds
/// out if rows at the end were taken away.
pub(crate) fn key(bench: &Bench) -> Result<ApiBody> {
    let over = "the canonical JSON (RFC 8785) of an attempt without \"signature\" and \"at\"";
    json_body(&json!({
        "algorithm": "Ed25519", "public_key": bench.public_key(), "over": over, "build": BUILD, "newest": bench.newest()?,
    }))
}
