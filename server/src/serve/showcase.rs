//! The flight that the page shows while nobody flies: the best stored attempt or, without one, eight drones that
//! change places. Rows and header are those of a replay, with an entry more: `showcase`.

use axum::body::Bytes;
use serde_json::{Value, json};

use super::feed::Feed;
use crate::bench::{Bench, Document, Error, Result};
use crate::frames;
use crate::worlds::{WorldFlight, WorldPlan};

/// Attempts that are tried: another build's may come out differently now, and is not shown.
const TRIES: usize = 3;
/// Of eight drones: after this they stand in their new places.
const SWAP_TICKS: u64 = 600;
/// A start from which all pass each other well.
const SWAP_SEED: u64 = 2;

/// A flight to be shown.
#[derive(Clone)]
pub(crate) struct Showcase {
    /// Id of the attempt; none for the drones that change places.
    pub attempt: Option<String>,
    pub frames: Bytes,
}

/// The flight to show now. `before` is kept if its attempt is still the best.
///
/// # Errors
/// Of the database, and bugs.
pub(crate) fn choose(bench: Option<&Bench>, before: Option<&Showcase>) -> Result<Showcase> {
    let best = bench.map(best_attempts).transpose()?.unwrap_or_default();
    for (bench, document) in bench.into_iter().flat_map(|bench| best.iter().map(move |best| (bench, best))) {
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
        None => swap(),
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
    let flight = bench.replay(&document.id, episode)?.frames()?;
    let frames = frames::with_entry(&flight, "showcase", about)
        .ok_or_else(|| Error::Internal("frames without a header".into()))?;
    Ok(Showcase { attempt: Some(document.id.clone()), frames: frames.into() })
}

/// Eight drones change places, flown by the thesis's controller.
fn swap() -> Result<Showcase> {
    let plan = WorldPlan { seed: SWAP_SEED, ..WorldPlan::new("swap") };
    let (mut flight, options) = (WorldFlight::new(&plan)?, plan.options()?);
    let feed = Feed::for_multi_drone(&options, flight.tick_s(), flight.drones());
    // a feed takes rows only while somebody watches
    let _watcher = feed.watch();
    let (mut rows, mut seen, nobody) = (Vec::new(), 0, vec![None; flight.drones()]);
    loop {
        feed.show_shared(&flight);
        rows.extend(feed.newer(0, &mut seen).unwrap_or_default());
        if flight.ticks >= SWAP_TICKS || flight.is_over() {
            break;
        }
        flight.step(&nobody)?;
    }
    let mut header = feed.header.clone();
    header["rows"] = (flight.ticks + 1).into();
    header["end"] = "time".into();
    header["showcase"] = Value::Null;
    let mut frames = frames::header_bytes(&header).map_err(|e| Error::Internal(e.to_string()))?;
    frames.extend_from_slice(bytemuck::cast_slice(&rows));
    Ok(Showcase { attempt: None, frames: frames.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::TeamLimits;
    use crate::bench::baselines::submit;
    use crazyflie_control::ControllerSpec;

    fn header(showcase: &Showcase) -> Value {
        let length = u32::from_le_bytes(*showcase.frames.first_chunk().unwrap()) as usize;
        serde_json::from_slice(&showcase.frames[4..4 + length]).unwrap()
    }

    /// All rows, one after the other.
    fn rows(showcase: &Showcase) -> Vec<f32> {
        let length = u32::from_le_bytes(*showcase.frames.first_chunk().unwrap()) as usize;
        let (numbers, rest) = showcase.frames[4 + length..].as_chunks::<4>();
        assert!(rest.is_empty());
        numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
    }

    #[test]
    fn eight_drones_change_places_and_none_comes_near_another() {
        let showcase = choose(None, None).unwrap();
        let (header, rows) = (header(&showcase), rows(&showcase));
        let columns: Vec<&str> =
            header["columns"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        let column = |name: &str| columns.iter().position(|known| *known == name).unwrap();
        let (drones, width) = (8, columns.len());
        assert_eq!((&header["drones"], &header["showcase"]), (&json!(8), &Value::Null));
        let moments = header["rows"].as_u64().unwrap() as usize;
        assert_eq!((moments as u64, rows.len()), (SWAP_TICKS + 1, moments * drones * width));
        let at =
            |moment: usize, drone: usize, name: &str| rows[(moment * drones + drone) * width + column(name)];
        let least_m = at(moments - 1, 0, "least_separation_m");
        println!("nearest {least_m} m");
        assert!(least_m > 0.25);
        for drone in 0..drones {
            let [from, to] = [0, moments - 1].map(|moment| ["x", "y"].map(|axis| at(moment, drone, axis)));
            let off_m = (from[0] + to[0]).hypot(from[1] + to[1]);
            assert!(
                off_m < 0.2 && at(moments - 1, drone, "flying") == 1.0,
                "drone {drone}: {from:?} to {to:?}"
            );
        }
    }

    #[test]
    fn the_best_attempt_is_flown_once_until_a_better_one_comes() {
        let folder = std::env::current_exe().unwrap().with_file_name("bench-tests").join("showcase");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let bench = Bench::open(&folder.join("bench.sqlite"), TeamLimits::default()).unwrap();
        let store = |controller: &str| {
            submit(&bench, "takeoff", &ControllerSpec::named(controller).unwrap().into()).unwrap().id
        };
        let swap = choose(Some(&bench), None).unwrap();
        assert_eq!(swap.attempt, None);
        let worse = store("stock-pid");
        let first = choose(Some(&bench), Some(&swap)).unwrap();
        assert_eq!(first.attempt.as_ref(), Some(&worse));
        let about = &header(&first)["showcase"];
        assert_eq!((&about["attempt"], &about["controller"]), (&json!(worse), &json!("stock-pid")));
        let episode = about["episode"].as_u64().unwrap() as usize;
        let whole = bench.replay(&worse, episode).unwrap().frames().unwrap();
        assert!(whole.ends_with(&first.frames[first.frames.len() - 4000..]), "the rows of the replay");
        let better = store("lqr");
        let second = choose(Some(&bench), Some(&first)).unwrap();
        assert_eq!(second.attempt, Some(better));
        // kept, not flown again: bytes that were changed stay
        let marked = Showcase { frames: vec![1, 2, 3].into(), ..second };
        assert_eq!(choose(Some(&bench), Some(&marked)).unwrap().frames[..], [1, 2, 3]);
    }
}
