//! Flights as the page draws them, live or replayed: a header once (`Header::bytes`), then rows of
//! little-endian f32 (`COLUMNS`), for each moment as many as there are drones.

use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::observation::{MARKER_POS, OBSERVATION, SETPOINT, index};
use crazyflie_env::plant::Command;
use crazyflie_env::vector::{STATE, state_index};
use serde::Serialize;
use serde_json::Value;

/// Columns of a row, SI units and radians. `fix` is the pose that the camera measures, `u` the command in
/// force from the row on.
pub(crate) const COLUMNS: [&str; 25] = [
    "t_s",
    "x",
    "y",
    "z",
    "roll",
    "pitch",
    "yaw",
    "vx",
    "vy",
    "vz",
    "setpoint_x",
    "setpoint_y",
    "setpoint_z",
    "setpoint_yaw",
    "fix_x",
    "fix_y",
    "fix_z",
    "fix_yaw",
    "fix_valid",
    "fix_age_s",
    "u_roll",
    "u_pitch",
    "u_yaw_rate",
    "u_lift",
    "reward",
];

/// Further columns of drones that share a world: whether the drone flies, its distance to the nearest other
/// flying one, and the smallest distance so far between any two.
pub(crate) const WORLD_COLUMNS: [&str; 3] = ["flying", "separation_m", "least_separation_m"];

/// [`COLUMNS`] and [`WORLD_COLUMNS`].
pub(crate) const ALL_COLUMNS: [&str; COLUMNS.len() + WORLD_COLUMNS.len()] = {
    let mut all = [""; COLUMNS.len() + WORLD_COLUMNS.len()];
    let (own, shared) = all.split_at_mut(COLUMNS.len());
    own.copy_from_slice(&COLUMNS);
    shared.copy_from_slice(&WORLD_COLUMNS);
    all
};

/// The camera under the vehicle; no limit to its view is 0 degrees.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Camera {
    /// Across the picture's diagonal.
    pub fov_deg: f64,
    /// Below the centre of mass.
    pub offset_m: f64,
}

#[derive(Debug, Clone, Serialize)]
pub(crate) struct Header {
    pub columns: &'static [&'static str],
    /// Rows for each moment.
    pub drones: usize,
    pub rows: usize,
    pub tick_s: f64,
    /// Centres of the markers on the floor.
    pub marker: Vec<[f64; 3]>,
    pub camera: Camera,
    /// Reason that the flight ended.
    pub end: String,
}

impl Header {
    /// Length as little-endian u32, JSON, padding with spaces so that the rows begin at a multiple of four
    /// bytes.
    ///
    /// # Errors
    /// Of serde, for numbers that JSON cannot say.
    pub(crate) fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        header_bytes(self)
    }
}

/// See [`Header::bytes`].
pub(crate) fn header_bytes(header: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut json = serde_json::to_vec(header)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    Ok([&(json.len() as u32).to_le_bytes()[..], &json].concat())
}

/// The same flight with one more entry in its header. None for bytes that are no flight.
pub(crate) fn with_entry(flight: &[u8], name: &str, entry: Value) -> Option<Vec<u8>> {
    let (length, rest) = flight.split_first_chunk::<4>()?;
    let (json, rows) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let mut header: Value = serde_json::from_slice(json).ok()?;
    header.as_object_mut()?.insert(name.to_owned(), entry);
    let mut bytes = header_bytes(&header).ok()?;
    bytes.extend(rows);
    Some(bytes)
}

/// Numbers in the order of [`COLUMNS`].
pub(crate) type FrameRow = [f32; COLUMNS.len()];

/// A row from an observation, the true state, and the action in force from then on.
pub(crate) fn row(
    t_s: f64,
    o: &[f32; OBSERVATION],
    x: &[f32; STATE],
    action: &[f32; ACTION],
    interface: &Interface,
    reward: f32,
) -> FrameRow {
    // what is commanded at another level no column shows
    let u = if interface.level().is_default() {
        interface.command(&action.map(f64::from))
    } else {
        Command::level(interface.hover_lift)
    };
    let mut out = [0.0; COLUMNS.len()];
    out[0] = t_s as f32;
    out[1..4].copy_from_slice(&x[state_index::POS..][..3]);
    out[4..7].copy_from_slice(&x[state_index::ROLL..=state_index::YAW]);
    out[7..10].copy_from_slice(&x[state_index::VEL..][..3]);
    out[10..14].copy_from_slice(&o[SETPOINT.range()]);
    out[14..18].copy_from_slice(&o[MARKER_POS.first..=index::MARKER_YAW]);
    out[18..20].copy_from_slice(&[o[index::MARKER_VALID], o[index::MARKER_AGE]]);
    out[20..24].copy_from_slice(&[u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift].map(|v| v as f32));
    out[24] = reward;
    out
}

/// The distance of each drone that flies to the nearest other one that does; infinite without one. `states`
/// are rows of [`STATE`].
pub(crate) fn separations_m(states: &[f32], flying: &[bool]) -> impl Iterator<Item = f32> {
    let (states, _) = states.as_chunks::<STATE>();
    (0..states.len()).map(move |own| {
        let others = (0..states.len()).filter(|other| *other != own && flying[own] && flying[*other]);
        let distance_m =
            |other: usize| (0..3).map(|i| (states[own][i] - states[other][i]).powi(2)).sum::<f32>().sqrt();
        others.map(distance_m).fold(f32::INFINITY, f32::min)
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn an_entry_more_leaves_the_rows() {
        let rows = [1_u8, 2, 3, 4, 5, 6, 7, 8];
        let flight = [header_bytes(&json!({"columns": ["t_s"]})).unwrap(), rows.to_vec()].concat();
        let told = with_entry(&flight, "about", json!({"title": "a name"})).unwrap();
        let length = u32::from_le_bytes(*told.first_chunk().unwrap()) as usize;
        assert!(length.is_multiple_of(4) && told[4 + length..] == rows);
        let header: Value = serde_json::from_slice(&told[4..4 + length]).unwrap();
        assert_eq!(header, json!({"columns": ["t_s"], "about": {"title": "a name"}}));
        for broken in [&flight[..3], &flight[..9], &[255, 255, 255, 255, 0][..]] {
            assert!(with_entry(broken, "about", Value::Null).is_none());
        }
    }
}
