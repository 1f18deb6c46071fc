//! Figures of the drones of a world, while somebody flies one of them: how near each was to its set-point, and
//! how its flight ended.

use crazyflie_env::observation::SETPOINT;
use crazyflie_env::vector::{STATE, state_index};
use serde::Serialize;

use super::{ActionSource, WorldFlight};
use crate::flight::{metric, squared_distance};

/// End of a drone's flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DroneEnd {
    Collided,
    HitFloor,
    LeftRoom,
    /// By the task itself, such as a landing.
    Done,
    /// The time of the world was over.
    Time,
}

/// Figures of one drone, over the ticks in which a pilot flew any drone of the world, so that drones can be compared.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DroneFigures {
    /// Ticks that it flew while somebody was pilot.
    pub ticks: u64,
    /// Number of these ticks with an action of its own pilot.
    pub piloted_ticks: u64,
    /// None while it flies, and after the last pilot has left.
    pub end: Option<DroneEnd>,
    /// Sum of the squared distances from its set-point.
    squares_m2: f64,
}

impl DroneFigures {
    /// Root mean square distance from the set-point; none without a tick.
    pub(crate) fn rms_m(&self) -> Option<f64> {
        (self.ticks > 0).then(|| (self.squares_m2 / self.ticks as f64).sqrt())
    }
}

/// Figures of all drones of a world.
#[derive(Debug, Clone)]
pub(crate) struct WorldFigures {
    pub drones: Vec<DroneFigures>,
    /// Drones that collided and that crashed, before the next tick.
    harmed: [f32; 2],
}

impl WorldFigures {
    pub(crate) fn new(drones: usize) -> WorldFigures {
        WorldFigures { drones: vec![DroneFigures::default(); drones], harmed: [0.0; 2] }
    }

    /// Adds the tick that `flight` has just flown; `by` whom each drone was flown in it.
    pub(crate) fn add(&mut self, flight: &WorldFlight, by: &[ActionSource]) {
        let harmed = ["collisions", "crashes"].map(|name| metric(&flight.batch.metrics, name).unwrap_or(0.0));
        let [collided, crashed] = [0, 1].map(|kind| harmed[kind] > self.harmed[kind]);
        self.harmed = harmed;
        if !by.iter().any(|by| matches!(by, ActionSource::Pilot | ActionSource::Late)) {
            return;
        }
        let (states, _) = flight.batch.states.as_chunks::<STATE>();
        for (drone, (figures, by)) in self.drones.iter_mut().zip(by).enumerate() {
            if *by == ActionSource::Nobody {
                continue;
            }
            let (state, observation) = (&states[drone], flight.observation(drone));
            figures.ticks += 1;
            figures.piloted_ticks += u64::from(*by == ActionSource::Pilot);
            figures.squares_m2 += squared_distance(&state[..3], &observation[SETPOINT.range()]);
            if flight.batch.terminated[drone] {
                figures.end = Some(match state[state_index::HEIGHT] <= 0.0 {
                    true if crashed => DroneEnd::HitFloor,
                    _ if collided => DroneEnd::Collided,
                    false if crashed => DroneEnd::LeftRoom,
                    _ => DroneEnd::Done,
                });
            } else if flight.batch.truncated[drone] {
                figures.end = Some(DroneEnd::Time);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::worlds::WorldPlan;

    /// Level at 80 cm.
    const LEVEL: [f32; 4] = [0.0, 0.0, 0.0, 2.0 * 0.8 / 1.5 - 1.0];
    const AHEAD: [f32; 4] = [0.0, 1.0, 0.0, LEVEL[3]];
    const BACK: [f32; 4] = [0.0, -1.0, 0.0, LEVEL[3]];

    /// Two drones a metre apart along x, the second one behind; who has an action is flown `by` that source.
    fn fly(actions: [Option<[f32; 4]>; 2], by: ActionSource) -> WorldFigures {
        fly_form("height", actions, by)
    }

    fn fly_form(vertical: &str, actions: [Option<[f32; 4]>; 2], by: ActionSource) -> WorldFigures {
        let task_options = json!({"spacing_m": 1.0});
        let options = json!({"drones": 2, "max_episode_steps": 400, "vertical": vertical, "task_options": task_options});
        let options = options.as_object().unwrap().clone();
        let mut flight = WorldFlight::new(&WorldPlan { options, ..WorldPlan::new("formation") }).unwrap();
        let mut figures = WorldFigures::new(2);
        while !flight.is_over() {
            let by = [0, 1].map(|drone| match (flight.batch.flying[drone], actions[drone]) {
                (false, _) => ActionSource::Nobody,
                (true, None) => ActionSource::Autopilot,
                (true, Some(_)) => by,
            });
            flight.step(&actions).unwrap();
            figures.add(&flight, &by);
        }
        figures
    }

    fn ends(figures: &WorldFigures) -> [Option<DroneEnd>; 2] {
        [0, 1].map(|drone| figures.drones[drone].end)
    }

    #[test]
    fn how_a_flight_ends_is_told() {
        use ActionSource::Pilot;
        use DroneEnd::{Collided, HitFloor, LeftRoom, Time};
        let gone = fly([None, Some(BACK)], Pilot);
        let [autopilot, pilot] = &gone.drones[..] else { panic!("two drones") };
        // ticks of a drone that flies on alone do not count
        assert_eq!((ends(&gone), autopilot.ticks), ([None, Some(LeftRoom)], pilot.ticks));
        assert!(pilot.rms_m().unwrap() > 3.0 * autopilot.rms_m().unwrap());
        assert_eq!(ends(&fly([Some(BACK), Some(AHEAD)], Pilot)), [Some(Collided); 2]);
        let to_the_end = fly([None, Some(LEVEL)], Pilot);
        assert_eq!(ends(&to_the_end), [Some(Time); 2]);
        assert_eq!(to_the_end.drones[1].piloted_ticks, 400);
        let fallen = fly_form("thrust", [None, Some([0.0, 0.0, 0.0, -1.0])], Pilot);
        assert_eq!(ends(&fallen), [None, Some(HitFloor)]);
    }

    #[test]
    fn without_a_pilot_nothing_is_counted() {
        let figures = fly([Some(LEVEL), None], ActionSource::Autopilot);
        assert!(figures.drones.iter().all(|drone| drone.ticks == 0 && drone.rms_m().is_none()));
        let late = fly([None, Some(LEVEL)], ActionSource::Late);
        assert_eq!((late.drones[1].ticks, late.drones[1].piloted_ticks), (400, 0));
    }
}
