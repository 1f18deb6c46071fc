//! The flight that the page shows while nobody flies: eight drones that change places. An extension may
//! answer the same path with another one.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use crazyflie_env::{Error, Result};
use serde_json::Value;
use tokio::task::spawn_blocking;
use tracing::error;

use super::answers::{TaggedBody, error_response};
use super::feed::Feed;
use super::server::Server;
use crate::frames;
use crate::worlds::{WorldFlight, WorldPlan};

/// Ticks after which they are in their new places.
const SWAP_TICKS: u64 = 600;
/// A start from which all pass each other well.
const SWAP_SEED: u64 = 116;

pub(crate) async fn showcase(State(server): State<Arc<Server>>, headers: HeaderMap) -> Response {
    let fly = || async {
        let _turn = server.flights.acquire().await;
        let flown = spawn_blocking(eight_drones).await.map_err(|bug| bug.to_string())?;
        flown
            .map(|frames| TaggedBody::new("application/octet-stream", frames.into()))
            .map_err(|problem| problem.to_string())
    };
    match server.showcase.get_or_try_init(fly).await {
        Ok(body) => body.response(&headers),
        Err(problem) => {
            error!(problem, "there is no flight to show");
            let words = "a bug; the server's log says more";
            error_response(StatusCode::INTERNAL_SERVER_ERROR, "internal", words)
        }
    }
}

/// Eight drones change places, flown by the thesis's controller. Rows and header are those of a replay, with
/// an entry more: `showcase`, which is null.
///
/// # Errors
/// None but for bugs.
pub fn eight_drones() -> Result<Vec<u8>> {
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
    let mut frames = frames::header_bytes(&header).map_err(|e| Error::Config(e.to_string()))?;
    frames.extend_from_slice(bytemuck::cast_slice(&rows));
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn eight_drones_change_places_and_none_comes_near_another() {
        let flight = eight_drones().unwrap();
        let (length, rest) = flight.split_first_chunk().unwrap();
        let (header, rows) = rest.split_at(u32::from_le_bytes(*length) as usize);
        let header: Value = serde_json::from_slice(header).unwrap();
        let rows: Vec<f32> = rows.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let columns: Vec<&str> =
            header["columns"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        let column = |name: &str| columns.iter().position(|known| *known == name).unwrap();
        let (drones, width) = (8, columns.len());
        assert_eq!((&header["drones"], &header["showcase"]), (&json!(8), &Value::Null));
        let moments = header["rows"].as_u64().unwrap() as usize;
        assert_eq!((moments as u64, rows.len()), (SWAP_TICKS + 1, moments * drones * width));
        let value =
            |moment: usize, drone: usize, name: &str| rows[(moment * drones + drone) * width + column(name)];
        let least_m = value(moments - 1, 0, "least_separation_m");
        println!("nearest {least_m} m");
        assert!(least_m > 0.22);
        for drone in 0..drones {
            let [from, to] = [0, moments - 1].map(|moment| ["x", "y"].map(|axis| value(moment, drone, axis)));
            let off_m = (from[0] + to[0]).hypot(from[1] + to[1]);
            assert!(
                off_m < 0.2 && value(moments - 1, drone, "flying") == 1.0,
                "drone {drone}: {from:?} to {to:?}"
            );
        }
    }
}
