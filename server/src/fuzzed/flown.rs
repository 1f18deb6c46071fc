//! Flies every accepted environment.

use crazyflie_env::action::ACTION;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};

/// Flies an accepted environment and checks that its numbers are finite.
pub(crate) fn fly_env(mut env: VectorEnv) {
    let (envs, rows) = (env.num_envs(), env.num_envs() * env.num_drones());
    let mut observations = vec![0.0; rows * env.width()];
    let (mut rewards, mut states, mut metrics) =
        (vec![0.0; rows], vec![0.0; rows * STATE], vec![0.0; envs * env.num_metrics()]);
    let [mut terminated, mut truncated, mut flying] = [(); 3].map(|()| vec![false; rows]);
    let seeds: Vec<u64> = (0..envs as u64).collect();
    env.reset(Some(&seeds), None, &mut observations).expect("a reset of all");
    for action in [0.0, 1.0, -1.0] {
        let out = StepBuffers {
            observations: &mut observations,
            rewards: &mut rewards,
            terminated: &mut terminated,
            truncated: &mut truncated,
            flying: &mut flying,
            metrics: &mut metrics,
        };
        match env.step(&vec![action; rows * ACTION], out) {
            Ok(()) | Err(crazyflie_env::Error::Ended { .. }) => {}
            Err(error) => panic!("{error}"),
        }
        env.states(&mut states).expect("states of all");
        let all = observations.iter().chain(&rewards).chain(&states).chain(&metrics);
        assert!(all.clone().all(|number| number.is_finite()), "{:?}", all.collect::<Vec<_>>());
    }
}
