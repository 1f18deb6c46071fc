//! A race: gates in order, what is hit, what is seen of them.

use std::ops::Range;

use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController};
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{RolloutBuffers, StepBuffers, VectorEnv};
use serde_json::{Value, json};

/// Twenty seconds.
const STEPS: usize = 1000;
const ENVS: usize = 48;
/// Numbers of the chosen observation: next gate, the one after it, nearest obstacle, true position.
const WIDTH: usize = 12;
const GATE: Range<usize> = 0..3;
const NEXT_GATE: Range<usize> = 3..6;
const OBSTACLE: Range<usize> = 6..9;

/// Flights of one controller.
struct Race {
    returns: Vec<f32>,
    /// Ticks until each ended.
    lasted: Vec<usize>,
    /// Tick by tick, then by environment.
    observations: Vec<f32>,
}

impl Race {
    fn fly(task_options: &Value, controller: &str) -> Self {
        let options = json!({"task": "race", "task_options": task_options, "autoreset": "disabled", "max_episode_steps": STEPS + 1,
                             "observation": ["gate_pos_m", "next_gate_pos_m", "obstacle_m", "pos_m"]});
        let (model, options) = (Model::thesis(), Options::parse(&options.to_string()).unwrap());
        let mut env = VectorEnv::new(std::slice::from_ref(&model), &options, ENVS).unwrap();
        let pilot = |envs: usize| {
            let (interface, tick_s) = (env.interfaces()[0], env.tick_s());
            let context = ControllerContext { model: &model, interface, tick_s, envs, mode: Mode::Automatic };
            let one = ControllerSpec::named(controller).unwrap().build(&context).unwrap();
            MultiController::new(vec![one], envs, None, tick_s).unwrap()
        };
        let mut pilots: Vec<MultiController> = env.shard_envs().map(pilot).collect();
        let mut last = vec![0.0; ENVS * WIDTH];
        let seeds: Vec<u64> = (0..ENVS as u64).collect();
        env.reset(Some(&seeds), None, &mut last).unwrap();
        let (mut returns, mut rewards) = (vec![0.0; ENVS], vec![0.0; ENVS]);
        let (mut terminated, mut truncated) = (vec![false; ENVS], vec![false; ENVS]);
        let mut observations = vec![0.0; STEPS * ENVS * WIDTH];
        let (mut all_rewards, mut ends, mut overs) =
            (vec![0.0; STEPS * ENVS], vec![false; STEPS * ENVS], vec![false; STEPS * ENVS]);
        let buffers = RolloutBuffers {
            last: StepBuffers {
                observations: &mut last,
                rewards: &mut rewards,
                terminated: &mut terminated,
                truncated: &mut truncated,
                flying: &mut [],
                metrics: &mut [],
            },
            returns: &mut returns,
            observations: &mut observations,
            rewards: &mut all_rewards,
            terminated: &mut ends,
            truncated: &mut overs,
        };
        env.rollout_with(&mut pilots, STEPS, &mut vec![0.0; ENVS * ACTION], buffers).unwrap();
        let lasted = (0..ENVS)
            .map(|env| (0..STEPS).find(|step| ends[step * ENVS + env]).map_or(STEPS, |step| step + 1))
            .collect();
        Race { returns, lasted, observations }
    }

    fn finished(&self) -> usize {
        // four gates bring 20, a hit at the last takes 10
        self.returns.iter().zip(&self.lasted).filter(|(sum, ticks)| **ticks < STEPS && **sum > 25.0).count()
    }

    /// Returns the observations of an environment during its flight.
    fn rows(&self, env: usize) -> impl Iterator<Item = &[f32]> {
        let row = move |step: usize| &self.observations[(step * ENVS + env) * WIDTH..][..WIDTH];
        (0..self.lasted[env] - 1).map(row)
    }
}

#[test]
fn controllers_that_follow_the_set_point_fly_through_every_gate() {
    for (level, controller) in [(1, "lqr"), (1, "thesis-pid"), (2, "lqr"), (2, "thesis-pid")] {
        let race = Race::fly(&json!({"level": level}), controller);
        assert_eq!(race.finished(), ENVS, "{controller} at level {level}: {:?}", race.returns);
    }
}

#[test]
fn gates_come_in_their_order_and_round_after_round() {
    let race = Race::fly(&json!({"level": 1, "laps": 2, "pace_mps": 0.8}), "lqr");
    assert_eq!(race.finished(), ENVS);
    let gates = [[1.1, 0.0, 1.0], [0.0, 1.1, 1.0], [-1.1, 0.0, 1.0], [0.0, -1.1, 1.0]];
    let place = |numbers: &[f32]| {
        gates
            .iter()
            .position(|gate| gate.iter().zip(numbers).all(|(a, b)| (*a as f32 - b).abs() < 1e-5))
            .unwrap()
    };
    let mut order = vec![place(race.rows(0).next().unwrap())];
    for row in race.rows(0) {
        let (gate, next) = (place(&row[GATE]), place(&row[NEXT_GATE]));
        if *order.last().unwrap() != gate {
            order.push(gate);
        }
        assert_eq!(next, if order.len() == 8 { gate } else { (gate + 1) % 4 });
        assert_eq!(row[OBSTACLE], [10.0; 3], "an empty room");
    }
    assert_eq!(order, [0, 1, 2, 3, 0, 1, 2, 3]);
}

#[test]
fn what_stands_in_the_way_is_hit_and_ends_the_flight() {
    // the chord from gate to gate leads past the poles: whoever touches one loses 10
    let race = Race::fly(&json!({"level": 3}), "lqr");
    let finished = race.finished();
    assert!((1..ENVS).contains(&finished), "{finished} of {ENVS}");
    for env in 0..ENVS {
        let nearest =
            race.rows(env).map(|row| row[OBSTACLE].iter().map(|axis| axis * axis).sum::<f32>().sqrt());
        let nearest = nearest.fold(f32::INFINITY, f32::min);
        assert!(nearest >= 0.069, "{env} flew on at {nearest} m from a pole");
    }
    // a wall before the first gate
    let walled = json!({"gates": [[1.0, 0.0, 1.0, 0.0]], "boxes": [[0.6, 0.0, 1.0, 0.05, 2.0, 2.0]]});
    let race = Race::fly(&walled, "lqr");
    assert!(race.returns.iter().all(|sum| (-11.0..-7.0).contains(sum)), "{:?}", race.returns);
    assert!(race.lasted.iter().all(|ticks| *ticks < 200));
}

#[test]
fn gates_of_one_s_own_are_flown_and_bad_ones_are_named() {
    let own = json!({"gates": [[-1.0, 1.0, 1.2, 0.0], [1.0, 1.0, 0.8, 0.0], [0.0, -1.0, 1.0, 3.1]], "opening_m": 0.5});
    let race = Race::fly(&own, "lqr");
    assert_eq!(race.finished(), ENVS, "{:?}", race.returns);
    let error = |task_options: &Value| {
        let options = json!({"task": "race", "task_options": task_options}).to_string();
        let made = Options::parse(&options).and_then(|o| VectorEnv::new(&[Model::thesis()], &o, 1));
        made.map(|_| ()).unwrap_err().to_string()
    };
    for (options, words) in [
        (json!({"level": 5}), "level is 5, expected 1 to 4"),
        (json!({"gates": [[0.0, 0.0, 1.0]]}), "gates[0] has 3 numbers, expected 4"),
        (json!({"gates": [[0.0, 0.0, 0.3, 0.0]]}), "gates[0][2] is 0.3, expected 0.38 to 2.42"),
        (json!({"gates": [[2.0, 0.0, 1.0, 3.2]]}), "gates[0][0] is 2, expected within 2.5 m of the middle"),
        (json!({"poles": [[0.0, 0.0, -0.1]]}), "poles[0][2] is -0.1, expected 0.01 to 1"),
        (json!({"level": 2, "poles": [[0.0, 0.0, 0.1]]}), "a level is given"),
        (json!({"gates": vec![[0.0, 0.0, 1.0, 0.0]; 17]}), "the number of gates is 17, expected at most 16"),
    ] {
        assert!(error(&options).contains(words), "{options} gave: {}", error(&options));
    }
}
