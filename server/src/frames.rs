//! Flights as the page draws them, live or replayed: a header once ([`header_bytes`]), then rows of
//! little-endian f32 (`COLUMNS`), for each moment as many as there are drones.

use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::config::{EffectParams, EffectTable};
use crazyflie_env::observation::{MARKER_POS, OBSERVATION, SETPOINT, index};
use crazyflie_env::plant::Command;
use crazyflie_env::vector::{STATE, state_index};
use serde_json::{Value, json};

/// Columns of a row, SI units and radians. `fix` is the pose that the camera measures, `u` the command in
/// force from the row on.
pub const COLUMNS: [&str; 25] = [
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
pub const WORLD_COLUMNS: [&str; 3] = ["flying", "separation_m", "least_separation_m"];

/// [`COLUMNS`] and [`WORLD_COLUMNS`].
pub const ALL_COLUMNS: [&str; COLUMNS.len() + WORLD_COLUMNS.len()] = {
    let mut all = [""; COLUMNS.len() + WORLD_COLUMNS.len()];
    let (own, shared) = all.split_at_mut(COLUMNS.len());
    own.copy_from_slice(&COLUMNS);
    shared.copy_from_slice(&WORLD_COLUMNS);
    all
};

/// Header of a flight with these effects, whose length and end are not known yet.
pub fn header(effects: &EffectTable, columns: &[&str], drones: usize, tick_s: f64) -> Value {
    // a parameter drawn for every episode has no single value
    let number = |effect: &str, param: &str, first: bool, or: f64| {
        let number = effects.get(effect).and_then(|params| match params {
            EffectParams::First(number) => Some(number).filter(|_| first),
            EffectParams::Named(map) => map.get(param),
        });
        number.and_then(|number| number.fixed()).unwrap_or(or)
    };
    let pitch_m = number("markers", "pitch_m", false, 0.5);
    let side = |param, first| {
        let count = number("markers", param, first, 1.0).round();
        (0..count as usize).map(move |i| (i as f64 - 0.5 * (count - 1.0)) * pitch_m)
    };
    let marker: Vec<_> =
        side("columns", true).flat_map(|x| side("rows", false).map(move |y| [x, y, 0.0])).collect();
    let (fov_deg, offset_m) =
        (number("camera_fov", "diagonal_deg", true, 0.0), number("camera_fov", "lens_below_m", false, 0.02));
    let camera = json!({"fov_deg": if fov_deg > 0.0 { Some(fov_deg) } else { None }, "offset_m": offset_m});
    let side_m = number("camera_fov", "side_m", false, 0.197);
    json!({"columns": columns, "drones": drones, "rows": null, "tick_s": tick_s, "marker": marker, "marker_side_m": side_m, "camera": camera, "end": null})
}

/// A header as it is sent: length as little-endian u32, JSON, padding with spaces so that the rows begin at a
/// multiple of four bytes.
///
/// # Errors
/// The errors of serde, for numbers that JSON cannot represent.
pub fn header_bytes(header: &Value) -> serde_json::Result<Vec<u8>> {
    let mut json = serde_json::to_vec(header)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    Ok([&(json.len() as u32).to_le_bytes()[..], &json].concat())
}

/// Numbers in the order of [`COLUMNS`].
pub type FrameRow = [f32; COLUMNS.len()];

/// A row from an observation, the true state, and the action in force from then on.
pub fn row(
    t_s: f64,
    o: &[f32; OBSERVATION],
    x: &[f32; STATE],
    action: &[f32; ACTION],
    interface: &Interface,
    reward: f32,
) -> FrameRow {
    // commands of other levels have no columns
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
pub fn separations_m(states: &[f32], flying: &[bool]) -> impl Iterator<Item = f32> {
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
    use super::*;

    #[test]
    fn rows_begin_at_a_multiple_of_four_bytes() {
        for name in ["t_s", "x", "yaw", "u_lift"] {
            let bytes = header_bytes(&json!({"columns": [name]})).unwrap();
            let (length, json) = bytes.split_first_chunk().unwrap();
            assert!(bytes.len().is_multiple_of(4) && json.len() == u32::from_le_bytes(*length) as usize);
            assert_eq!(serde_json::from_slice::<Value>(json).unwrap(), json!({"columns": [name]}));
        }
    }
}
