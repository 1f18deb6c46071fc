//! The flight that the page shows while nobody flies: the best stored attempt or, without one, eight drones
//! that change places. Rows and header are those of a replay, with an entry more: `showcase`.

use axum::body::Bytes;
use crazyflie_server::serve::eight_drones;
use serde_json::json;

use crate::{Bench, Document, Error, Result};

/// Number of attempts that are tried: another build's may have another result now, and is not shown.
const TRIES: usize = 3;

/// A flight to be shown.
#[derive(Clone)]
pub(super) struct Showcase {
    /// Id of the attempt; none for the drones that change places.
    pub attempt: Option<String>,
    pub frames: Bytes,
}

/// The flight to show now. `before` is kept if its attempt is still the best.
///
/// # Errors
/// The errors of the database, and bugs.
pub(super) fn choose(bench: &Bench, before: Option<&Showcase>) -> Result<Showcase> {
    for document in &best_attempts(bench)? {
        match before.filter(|before| before.attempt.as_deref() == Some(&document.id)) {
            Some(same) => return Ok(same.clone()),
            None => match replay(bench, document) {
                Ok(showcase) => return Ok(showcase),
                Err(problem) => tracing::debug!(attempt = document.id, %problem, "not shown"),
            },
        }
    }
    match before.filter(|before| before.attempt.is_none()) {
        Some(same) => Ok(same.clone()),
        None => Ok(Showcase { attempt: None, frames: eight_drones()?.into() }),
    }
}

/// The attempts of the highest scores, the best first; of equal ones the older.
fn best_attempts(bench: &Bench) -> Result<Vec<Document>> {
    let mut finished: Vec<(f64, Document)> = Vec::new();
    for entry in bench.attempts(None)? {
        let Ok(document) = entry.document else { continue };
        if let Some(score) = document.result.as_ref().map(|result| result.score.score) {
            finished.push((score, document));
        }
    }
    finished.sort_by(|(a, one), (b, other)| b.total_cmp(a).then(one.number.cmp(&other.number)));
    Ok(finished.into_iter().take(TRIES).map(|(_, document)| document).collect())
}

/// The best episode of an attempt, flown again.
fn replay(bench: &Bench, document: &Document) -> Result<Showcase> {
    let result = document.result.as_ref();
    let result = result.ok_or_else(|| Error::Internal("an attempt without a result".into()))?;
    let better = |a: &usize, b: &usize| {
        let score = |episode: usize| result.episodes[episode].score;
        // the first of equal ones
        score(*a).total_cmp(&score(*b)).then(b.cmp(a))
    };
    let episode = (0..result.episodes.len()).max_by(better).unwrap_or(0);
    let about = json!({
        "attempt": document.id, "episode": episode, "scenario": document.scenario,
        "title": bench.scenario(&document.scenario)?.title(), "controller": document.controller,
        "team": document.team, "score": result.score.score,
    });
    let frames = bench.replay(&document.id, episode)?.frames(Some(about))?;
    Ok(Showcase { attempt: Some(document.id.clone()), frames: frames.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baselines::submit;
    use crazyflie_control::ControllerSpec;
    use serde_json::Value;

    fn header(showcase: &Showcase) -> Value {
        let length = u32::from_le_bytes(*showcase.frames.first_chunk().unwrap()) as usize;
        serde_json::from_slice(&showcase.frames[4..4 + length]).unwrap()
    }

    #[test]
    fn the_best_attempt_is_flown_once_until_a_better_one_comes() {
        let bench = Bench::in_memory().unwrap();
        let store = |controller: &str| {
            submit(&bench, "takeoff", &ControllerSpec::named(controller).unwrap().into()).unwrap().id
        };
        let swap = choose(&bench, None).unwrap();
        assert_eq!(swap.attempt, None);
        let worse = store("stock-pid");
        let first = choose(&bench, Some(&swap)).unwrap();
        assert_eq!(first.attempt.as_ref(), Some(&worse));
        let about = &header(&first)["showcase"];
        assert_eq!((&about["attempt"], &about["controller"]), (&json!(worse), &json!("stock-pid")));
        let episode = about["episode"].as_u64().unwrap() as usize;
        let whole = bench.replay(&worse, episode).unwrap().frames(None).unwrap();
        assert!(whole.ends_with(&first.frames[first.frames.len() - 4000..]), "the rows of the replay");
        let better = store("lqr");
        let second = choose(&bench, Some(&first)).unwrap();
        assert_eq!(second.attempt, Some(better));
        // kept, not flown again: bytes that were changed stay
        let marked = Showcase { frames: vec![1, 2, 3].into(), ..second };
        assert_eq!(choose(&bench, Some(&marked)).unwrap().frames[..], [1, 2, 3]);
    }
}
