//! The drones' physics: a world of the simulator for each, stepped together, so that they feel each other.

use crazyflie_env::config::EffectTable;
use crazyflie_env::effects::Neighbour;
use crazyflie_env::error::Result;
use crazyflie_env::model::{Model, VEHICLE_RADIUS_M, VerticalInput};
use crazyflie_env::noise::episode_key;
use crazyflie_env::plant::{Accelerations, Command, State};
use crazyflie_env::world::{Around, Settings, Tick, World, has_battery};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::pilot::SensorState;

/// Between neighbours on the ground before the first flight.
const SPACING_M: f64 = 1.0;

pub(crate) struct Fleet {
    worlds: Vec<World<f64>>,
    sensed: Vec<SensorState>,
    neighbours: Vec<Neighbour<f64>>,
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
        let (mut worlds, mut sensed) = (Vec::new(), Vec::new());
        let none = Command::level(0.0);
        let has_battery = has_battery(model, effects)?;
        for drone in 0..drones {
            let mut world = World::new(model, effects, Settings { input, physics_hz: None }, 1)?;
            let key = episode_key(seed, drone as u64);
            world.draw_lane(0, 0, key, &mut Pcg64Mcg::seed_from_u64(key));
            let mut state = State::rest();
            (state.pos_m[0], state.pos_m[1]) = ground_place(drone, drones);
            let reading = world.start(0, true, &state, &none);
            let vbat_v = has_battery.then_some(reading.vbat_v);
            sensed.push(SensorState {
                reading,
                state,
                impact_mps: 0.0,
                standing: true,
                collided: false,
                vbat_v,
            });
            worlds.push(world);
        }
        Ok(Fleet { worlds, sensed, neighbours: vec![Neighbour::gone(); drones], has_battery })
    }

    pub(crate) fn sensed(&self) -> &[SensorState] {
        &self.sensed
    }

    /// All drones obey for a tick.
    pub(crate) fn step(&mut self, commands: &[Command<f64>]) {
        let half_s = 0.5 * self.worlds[0].tick_s();
        for ((seen, world), command) in self.neighbours.iter_mut().zip(&self.worlds).zip(commands) {
            let (state, acc_mps2) = (world.state(0), world.acc_mps2(0));
            let ahead = |i: usize| state.pos_m[i] + half_s * state.vel_mps[i];
            *seen = Neighbour {
                pos_m: std::array::from_fn(ahead),
                vel_mps: std::array::from_fn(|i| state.vel_mps[i] + half_s * acc_mps2[i]),
                // without thrust there is no wake
                here: if command.lift > 0.0 { 1.0 } else { 0.0 },
            };
        }
        for (own, (world, command)) in self.worlds.iter_mut().zip(commands).enumerate() {
            let around = Around { neighbours: &self.neighbours, own, push: Accelerations::none() };
            let mut ticks = [Tick::none()];
            world.step_group(0, std::slice::from_ref(command), Some(&[around; 2]), &mut ticks);
            let [Tick { contact, reading }] = ticks;
            self.sensed[own] = SensorState {
                reading,
                state: *world.state(0),
                impact_mps: contact.impact_mps,
                standing: contact.standing,
                collided: false,
                vbat_v: self.has_battery.then_some(reading.vbat_v),
            };
        }
        self.collide();
    }

    fn collide(&mut self) {
        for one in 0..self.sensed.len() {
            for other in one + 1..self.sensed.len() {
                let (a, b) = (&self.sensed[one], &self.sensed[other]);
                if a.standing && b.standing {
                    continue;
                }
                let distance2: f64 = (0..3).map(|i| (a.state.pos_m[i] - b.state.pos_m[i]).powi(2)).sum();
                if distance2 < 4.0 * VEHICLE_RADIUS_M * VEHICLE_RADIUS_M {
                    self.sensed[one].collided = true;
                    self.sensed[other].collided = true;
                }
            }
        }
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
        let mut fleet = fleet(2, "\"downwash\": 0.118");
        let hover = Command::level(39_342.5);
        for (world, z_m) in fleet.worlds.iter_mut().zip([0.75, 0.5]) {
            let mut state = State::rest();
            state.pos_m[2] = z_m;
            world.start(0, true, &state, &hover);
        }
        for _ in 0..20 {
            fleet.step(&[hover; 2]);
        }
        let [above, below] = [0, 1].map(|i| fleet.sensed()[i].state.pos_m[2]);
        assert!((above - 0.75).abs() < 1e-6 && below < 0.49, "{above} {below}");
        assert!(!fleet.sensed()[0].collided);
        let mut state = State::rest();
        state.pos_m[2] = above + 0.1;
        fleet.worlds[1].start(0, true, &state, &hover);
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
