//! The drones as simulated vehicles feel them: a free flight of the simulator, so that wakes and collisions are those
//! of the environments.

use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::error::Result;
use crazyflie_env::free_flight::{FreeFlight, FreeStart};
use crazyflie_env::model::{Model, VerticalInput};

/// Between neighbours on the ground before the first flight.
const SPACING_M: f64 = 1.0;

/// Drones at rest on the floor, a metre apart.
///
/// # Errors
/// For effects that there are not, and what cannot be stepped.
pub(crate) fn on_ground(
    model: &Model,
    input: VerticalInput,
    effects: &EffectTable,
    drones: usize,
    seed: u64,
) -> Result<FreeFlight> {
    let place = |drone: usize| {
        let (x_m, y_m) = ground_place(drone, drones);
        [x_m, y_m, 0.0]
    };
    at_rest(model, input, effects, (0..drones).map(place).collect(), seed)
}

fn at_rest(
    model: &Model,
    input: VerticalInput,
    effects: &EffectTable,
    pos_m: Vec<[f64; 3]>,
    seed: u64,
) -> Result<FreeFlight> {
    let options = Options { vertical: Some(input), effects: effects.clone(), ..Options::default() };
    FreeFlight::new(model, &options, FreeStart { pos_m, load: None, seed })
}

/// Rows of a square around the origin.
fn ground_place(drone: usize, drones: usize) -> (f64, f64) {
    let columns = (drones as f64).sqrt().ceil() as usize;
    let rows = drones.div_ceil(columns);
    let along = |place: usize, count: usize| SPACING_M * (place as f64 - 0.5 * (count as f64 - 1.0));
    (along(drone % columns, columns), along(drone / columns, rows))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::plant::Command;

    fn serde_json_effects(text: &str) -> EffectTable {
        crazyflie_env::config::Options::parse(&format!("{{\"effects\": {{{text}}}}}")).unwrap().effects
    }

    #[test]
    fn drones_stand_a_metre_apart() {
        let effects = EffectTable::new();
        let fleet = on_ground(&Model::thesis(), VerticalInput::Thrust, &effects, 8, 1).unwrap();
        for one in 0..8 {
            for other in one + 1..8 {
                let [a, b] = [one, other].map(|i| fleet.drones()[i].state.pos_m);
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 0.999);
            }
        }
        assert_eq!(super::ground_place(0, 1), (0.0, 0.0));
    }

    #[test]
    fn who_flies_below_another_sinks_and_who_touches_it_collides() {
        let hover = Command::level(39_342.5);
        let effects = serde_json_effects("\"downwash\": 0.118");
        let fleet_at = |heights_m: [f64; 2]| {
            let pos_m = heights_m.map(|z_m| [0.0, 0.0, z_m]).to_vec();
            at_rest(&Model::thesis(), VerticalInput::Thrust, &effects, pos_m, 1).unwrap()
        };
        let mut fleet = fleet_at([0.75, 0.5]);
        for _ in 0..20 {
            fleet.tick(&[hover; 2]);
        }
        let [above, below] = [0, 1].map(|i| fleet.drones()[i].state.pos_m[2]);
        assert!((above - 0.75).abs() < 1e-6 && below < 0.49, "{above} {below}");
        assert!(!fleet.drones()[0].collided);
        let mut fleet = fleet_at([above, above + 0.1]);
        fleet.tick(&[hover; 2]);
        assert!(fleet.drones().iter().all(|drone| drone.collided));
    }
}
