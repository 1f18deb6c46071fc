//! The drones as simulated vehicles feel them: a free flight of the simulator, so that wakes and collisions are those
//! of the environments.

use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::error::Result;
use crazyflie_env::free_flight::{FreeDrone, FreeFlight, FreeStart};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::Command;
use crazyflie_env::world::has_battery;

use crate::pilot::SensorState;

/// Between neighbours on the ground before the first flight.
const SPACING_M: f64 = 1.0;

pub(crate) struct Fleet {
    flight: FreeFlight,
    sensed: Vec<SensorState>,
    has_battery: bool,
}

impl Fleet {
    /// Drones at rest on the floor, a metre apart.
    ///
    /// # Errors
    /// For effects that there are not, and what cannot be stepped.
    pub(crate) fn new(
        model: &Model,
        input: VerticalInput,
        effects: &EffectTable,
        drones: usize,
        seed: u64,
    ) -> Result<Fleet> {
        let on_ground = |drone: usize| {
            let (x_m, y_m) = ground_place(drone, drones);
            [x_m, y_m, 0.0]
        };
        Fleet::at(model, input, effects, (0..drones).map(on_ground).collect(), seed)
    }

    fn at(
        model: &Model,
        input: VerticalInput,
        effects: &EffectTable,
        pos_m: Vec<[f64; 3]>,
        seed: u64,
    ) -> Result<Fleet> {
        let options = Options { vertical: Some(input), effects: effects.clone(), ..Options::default() };
        let flight = FreeFlight::new(model, &options, FreeStart { pos_m, load: None, seed })?;
        let mut fleet =
            Fleet { flight, sensed: Vec::new(), has_battery: has_battery(model, effects, input)? };
        fleet.sense();
        Ok(fleet)
    }

    pub(crate) fn sensed(&self) -> &[SensorState] {
        &self.sensed
    }

    /// All drones obey for a tick.
    pub(crate) fn step(&mut self, commands: &[Command<f64>]) {
        self.flight.tick(commands);
        self.sense();
    }

    fn sense(&mut self) {
        let has_battery = self.has_battery;
        let sensed = |drone: &FreeDrone| SensorState {
            reading: drone.reading,
            state: drone.state,
            standing: drone.contact.standing,
            collided: drone.collided,
            vbat_v: has_battery.then_some(drone.reading.vbat_v),
        };
        self.sensed.clear();
        self.sensed.extend(self.flight.drones().iter().map(sensed));
    }
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

    fn fleet(drones: usize, effects: &str) -> Fleet {
        let effects = serde_json_effects(effects);
        Fleet::new(&Model::thesis(), VerticalInput::Thrust, &effects, drones, 1).unwrap()
    }

    fn serde_json_effects(text: &str) -> EffectTable {
        crazyflie_env::config::Options::parse(&format!("{{\"effects\": {{{text}}}}}")).unwrap().effects
    }

    #[test]
    fn drones_stand_a_metre_apart() {
        let fleet = fleet(8, "");
        for one in 0..8 {
            for other in one + 1..8 {
                let [a, b] = [one, other].map(|i| fleet.sensed()[i].state.pos_m);
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 0.999);
            }
        }
        assert_eq!(super::ground_place(0, 1), (0.0, 0.0));
    }

    #[test]
    fn who_flies_below_another_sinks_and_who_touches_it_collides() {
        let hover = Command::level(39_342.5);
        let effects = serde_json_effects("\"downwash\": 0.118");
        let at = |heights_m: [f64; 2]| {
            let pos_m = heights_m.map(|z_m| [0.0, 0.0, z_m]).to_vec();
            Fleet::at(&Model::thesis(), VerticalInput::Thrust, &effects, pos_m, 1).unwrap()
        };
        let mut fleet = at([0.75, 0.5]);
        for _ in 0..20 {
            fleet.step(&[hover; 2]);
        }
        let [above, below] = [0, 1].map(|i| fleet.sensed()[i].state.pos_m[2]);
        assert!((above - 0.75).abs() < 1e-6 && below < 0.49, "{above} {below}");
        assert!(!fleet.sensed()[0].collided);
        let mut fleet = at([above, above + 0.1]);
        fleet.step(&[hover; 2]);
        assert!(fleet.sensed().iter().all(|drone| drone.collided));
    }

    #[test]
    fn a_battery_is_shown_where_something_says_it() {
        assert!(fleet(1, "").sensed()[0].vbat_v.is_none());
        let vbat_v = fleet(1, "\"battery_sag\": {\"charge\": 0.3}").sensed()[0].vbat_v.unwrap();
        assert!((3.0..4.0).contains(&vbat_v), "{vbat_v}");
    }
}
