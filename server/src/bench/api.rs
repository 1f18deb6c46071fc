//! What is handed out over HTTP, as bytes with their type. Nothing that a seed could be derived from is among it.

use serde::Serialize;
use serde_json::{Value, json};

use super::error::{Error, Result};
use super::{BUILD, Bench, Listed};

/// A body and its type.
#[derive(Debug)]
pub struct Reply {
    pub content_type: &'static str,
    pub bytes: Vec<u8>,
}

fn reply(value: &impl Serialize) -> Result<Reply> {
    let bytes = serde_json::to_vec(value).map_err(|e| Error::Internal(e.to_string()))?;
    Ok(Reply { content_type: "application/json", bytes })
}

/// `GET /api/v1/scenarios`
pub(crate) fn scenarios(bench: &Bench) -> Result<Reply> {
    reply(&bench.scenarios().iter().map(|s| s.public()).collect::<Vec<_>>())
}

/// `GET /api/v1/leaderboard?scenario=ID`
pub(crate) fn leaderboard(bench: &Bench, scenario: &str) -> Result<Reply> {
    reply(&bench.leaderboard(bench.scenario(scenario)?)?)
}

/// `GET /api/v1/attempts?scenario=ID`: every attempt, without its episodes; of all scenarios if none is named.
pub fn attempts(bench: &Bench, scenario: Option<&str>) -> Result<Reply> {
    let scenario = scenario.map(|name| bench.scenario(name)).transpose()?.map(|s| s.id());
    let short = |listed: &Listed| {
        let mut value = whole(listed);
        if let Some(result) = value.get_mut("result").and_then(Value::as_object_mut) {
            result.remove("episodes");
        }
        value
    };
    reply(&bench.attempts(scenario.as_deref())?.iter().map(short).collect::<Vec<_>>())
}

/// `GET /api/v1/attempts/ID`: all that was signed, and the signature.
pub fn attempt(bench: &Bench, id: &str) -> Result<Reply> {
    reply(&whole(&bench.attempt(id)?))
}

fn whole(listed: &Listed) -> Value {
    match &listed.document {
        Ok(document) => {
            let mut value = json!(document);
            value["at"] = json!(document.begun_ms as f64 / 1000.0);
            value["signature"] = json!(hex::encode(&listed.signature));
            value
        }
        Err(problem) => json!({"id": listed.id, "status": "damaged", "problem": problem}),
    }
}

/// `GET /api/v1/attempts/ID/replay?episode=N`
pub(crate) fn replay(bench: &Bench, id: &str, episode: usize) -> Result<Reply> {
    Ok(Reply { content_type: "application/octet-stream", bytes: bench.replay(id, episode)?.frames()? })
}

/// `GET /api/v1/attempts/ID/log.csv?episode=N&drone=M`
pub fn log_csv(bench: &Bench, id: &str, episode: usize, drone: usize) -> Result<Reply> {
    Ok(Reply { content_type: "text/csv; charset=utf-8", bytes: bench.replay(id, episode)?.csv(drone)? })
}

/// `GET /api/v1/attempts/ID/actions.bin`
pub(crate) fn actions(bench: &Bench, id: &str) -> Result<Reply> {
    Ok(Reply { content_type: "application/octet-stream", bytes: bench.actions(id)? })
}

/// `GET /api/v1/attempts/ID/verify`: the attempt, flown again.
pub(crate) fn verification(bench: &Bench, id: &str) -> Result<Reply> {
    reply(&bench.verify(id)?)
}

/// `GET /api/v1/key`: what signatures are checked with, and over which bytes.
pub(crate) fn key(bench: &Bench) -> Result<Reply> {
    let over = "the canonical JSON (RFC 8785) of an attempt without \"signature\" and \"at\"";
    reply(&json!({"algorithm": "Ed25519", "public_key": bench.public_key(), "over": over, "build": BUILD}))
}
