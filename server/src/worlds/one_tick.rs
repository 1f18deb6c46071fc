//! The same drones with the same commands in a batch, a recording in double precision, a shared world and a free
//! flight, which simulated Crazyflies fly: the same motion, and the same collisions.

use crazyflie_env::action::ACTION;
use crazyflie_env::config::{Autoreset, Options};
use crazyflie_env::coupling::load::Load;
use crazyflie_env::free_flight::{FreeFlight, FreeStart};
use crazyflie_env::model::Model;
use crazyflie_env::plant::State;
use crazyflie_env::recording::{fly_double, record_environment};
use crazyflie_env::vector::{STATE, VectorEnv};
use serde_json::{Value, json};

use super::{WorldFlight, WorldPlan};
use crate::flight::EnvBatch;

const SEED: u64 = 5;

/// State of each drone of a kind of flight at the end of each tick, and whether it collided in it.
type Track = Vec<Vec<([f64; STATE], bool)>>;

/// A flight up to its first collision, or to its end.
struct Case {
    mission: &'static str,
    options: Value,
    load: Option<Load>,
    /// Actions of all drones in a tick; `level` is the fourth number of one that hovers.
    actions: fn(tick: usize, level: f32) -> Vec<[f32; ACTION]>,
    ticks: usize,
}

fn plan(case: &Case) -> WorldPlan {
    let options = case.options.as_object().unwrap().clone();
    WorldPlan { options, seed: SEED, ..WorldPlan::new(case.mission) }
}

fn options(case: &Case) -> Options {
    plan(case).options().unwrap()
}

fn actions(case: &Case) -> Vec<Vec<[f32; ACTION]>> {
    let env = VectorEnv::new(&[Model::thesis()], &options(case), 1).unwrap();
    let interface = env.interfaces()[0];
    let level = (2.0 * interface.hover_lift / interface.lift_max - 1.0) as f32;
    (0..case.ticks).map(|tick| (case.actions)(tick, level)).collect()
}

fn rows(states: &[f32]) -> Vec<[f64; STATE]> {
    states.as_chunks::<STATE>().0.iter().map(|row| row.map(f64::from)).collect()
}

/// In a batch of three, of which the second flies with the seed.
fn fly_batch(case: &Case) -> Track {
    let options = Options { autoreset: Autoreset::NextStep, ..options(case) };
    let env = VectorEnv::new(&[Model::thesis()], &options, 3).unwrap();
    let n = env.num_drones();
    let mut batch = EnvBatch::begin(env, &[1, SEED, 2]).unwrap();
    let mut track = Track::new();
    for actions in actions(case) {
        batch.actions.copy_from_slice(actions.repeat(3).as_flattened());
        batch.step().unwrap();
        let own = n..2 * n;
        let states = rows(&batch.states[own.start * STATE..own.end * STATE]);
        track.push(states.into_iter().zip(batch.terminated[own].to_vec()).collect());
    }
    track
}

fn fly_recording(case: &Case) -> Track {
    let rows: Vec<f64> = actions(case).concat().as_flattened().iter().map(|a| f64::from(*a)).collect();
    let flight = fly_double(&[Model::thesis()], &options(case), SEED, &rows).unwrap();
    let drones = actions(case)[0].len();
    let states: Vec<[f64; STATE]> = flight.states.as_chunks::<STATE>().0.to_vec();
    let all: Vec<_> = states.into_iter().zip(flight.terminated).collect();
    all.chunks(drones).map(<[_]>::to_vec).collect()
}

fn fly_shared_world(case: &Case) -> Track {
    let mut flight = WorldFlight::new(&plan(case)).unwrap();
    let mut track = Track::new();
    for actions in actions(case) {
        if flight.is_over() {
            break;
        }
        flight.step_with(&actions).unwrap();
        track.push(rows(&flight.batch.states).into_iter().zip(flight.batch.terminated.clone()).collect());
    }
    track
}

fn fly_free(case: &Case) -> Track {
    let (model, options) = (Model::thesis(), options(case));
    let interface = VectorEnv::new(std::slice::from_ref(&model), &options, 1).unwrap().interfaces()[0];
    let recording = record_environment(std::slice::from_ref(&model), &options, (SEED, 1)).unwrap();
    let numbers = &recording.starts[0].numbers;
    let drones = actions(case)[0].len();
    let per_drone = (numbers.len() - board(case)) / drones;
    let pos_m = (0..drones).map(|i| std::array::from_fn(|axis| numbers[i * per_drone + axis])).collect();
    let start = FreeStart { pos_m, load: case.load, seed: SEED };
    let mut flight = FreeFlight::new(&model, &options, start).unwrap();
    let tick = |actions: Vec<[f32; ACTION]>| {
        let commands: Vec<_> = actions.iter().map(|row| interface.command(&row.map(f64::from))).collect();
        flight.tick(&commands);
        flight.drones().iter().map(|drone| (state_row(&drone.state), drone.collided)).collect()
    };
    actions(case).into_iter().map(tick).collect()
}

/// Numbers of a start behind those of the drones: where the load hangs, and the board of `carry`.
fn board(case: &Case) -> usize {
    if case.load.is_some() { 3 + 4 } else { 0 }
}

fn state_row(x: &State<f64>) -> [f64; STATE] {
    let numbers = [x.pos_m, x.vel_mps, x.att_rad, x.rate_radps];
    std::array::from_fn(|i| numbers[i / 3][i % 3])
}

/// The tick of the first collision; one past the end where there is none.
fn first_hit(track: &Track) -> usize {
    track.iter().position(|drones| drones.iter().any(|(_, hit)| *hit)).unwrap_or(track.len())
}

/// Flies a case everywhere and compares; returns the track in double precision up to its first collision.
fn fly_everywhere(case: &Case) -> Track {
    let [batch, recording, world, free] =
        [fly_batch(case), fly_recording(case), fly_shared_world(case), fly_free(case)];
    let end = (first_hit(&recording) + 1).min(case.ticks);
    for tick in 0..end {
        for drone in 0..recording[tick].len() {
            let (expected, hit) = recording[tick][drone];
            assert_eq!(free[tick][drone], (expected, hit), "free flight, tick {tick}, drone {drone}");
            for (name, track) in [("batch", &batch), ("shared world", &world)] {
                let (state, other_hit) = track[tick][drone];
                assert_eq!(hit, other_hit, "{name}, tick {tick}, drone {drone}");
                let off = (0..STATE).map(|i| (state[i] - expected[i]).abs()).fold(0.0, f64::max);
                assert!(off < 1e-4, "{name}, tick {tick}, drone {drone}: {off}");
            }
            assert_eq!(batch[tick][drone], world[tick][drone], "tick {tick}, drone {drone}");
        }
    }
    recording[..end].to_vec()
}

fn formation(effects: Value, actions: fn(usize, f32) -> Vec<[f32; ACTION]>, ticks: usize) -> Case {
    let task_options = json!({"spacing_m": 0.3, "height_m": 0.4});
    let options = json!({
        "drones": 2, "vertical": "thrust", "max_episode_steps": 1000, "task_options": task_options, "effects": effects
    });
    Case { mission: "formation", options, load: None, actions, ticks }
}

#[test]
fn a_wake_is_felt_alike() {
    // the first climbs and drifts over the second one
    let actions = |tick, level: f32| match tick {
        0..40 => vec![[0.0, 0.0, 0.0, level + 0.12], [0.0, 0.0, 0.0, level]],
        40..80 => vec![[0.0, -0.3, 0.0, level - 0.12], [0.0, 0.0, 0.0, level]],
        _ => vec![[0.0, -0.1, 0.0, level], [0.0, 0.0, 0.0, level]],
    };
    let felt = fly_everywhere(&formation(json!({"downwash": 0.118}), actions, 110));
    let calm = fly_everywhere(&formation(json!({"downwash": 0.0}), actions, 110));
    let sunk_m = calm.last().unwrap()[1].0[2] - felt.last().unwrap()[1].0[2];
    assert!(felt.len() == 110 && sunk_m > 1e-3, "{sunk_m}");
}

#[test]
fn a_collision_happens_in_the_same_tick() {
    let actions = |_, level| vec![[0.0, -0.3, 0.0, level], [0.0, 0.3, 0.0, level]];
    let track = fly_everywhere(&formation(json!({"downwash": 0.118}), actions, 150));
    assert!(track.len() < 150 && track.last().unwrap().iter().all(|(_, hit)| *hit));
}

#[test]
fn a_drone_that_lands_stands_and_is_still_there() {
    // the second one lands gently; the first one then flies over it and comes down on it
    let actions = |tick, level: f32| {
        let second = if tick < 90 { level - 0.06 } else { -1.0 };
        let first = match tick {
            0..60 => [0.0, 0.0, 0.0, level],
            60..80 => [0.0, -0.3, 0.0, level],
            80..100 => [0.0, -0.3, 0.0, level - 0.15],
            _ => [0.0, 0.0, 0.0, level - 0.15],
        };
        vec![first, [0.0, 0.0, 0.0, second]]
    };
    let track = fly_everywhere(&formation(json!({}), actions, 250));
    let second: Vec<f64> = track.iter().map(|drones| drones[1].0[2]).collect();
    assert!(second[99] == 0.0, "{second:?}");
    assert!(track.len() < 250 && track.last().unwrap()[1].1, "it is hit where it stands");
}

#[test]
fn ropes_pull_alike() {
    let actions = |tick, level: f32| {
        let tilt = if tick < 25 { 0.1 } else { -0.1 };
        vec![[0.0, tilt, 0.0, level + 0.04], [0.0, 0.0, 0.0, level + 0.03], [tilt, 0.0, 0.0, level + 0.05]]
    };
    let options = json!({"drones": 3, "vertical": "thrust", "max_episode_steps": 1000});
    let load = Some(Load { mass_kg: 0.01, rope_m: 0.6 });
    let track = fly_everywhere(&Case { mission: "carry", options, load, actions, ticks: 50 });
    assert_eq!(track.len(), 50);
}
