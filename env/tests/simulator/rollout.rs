//! A rollout is its steps one after the other, to the bit.

use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController};
use crazyflie_env::Result;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::task;
use crazyflie_env::vector::{RolloutBuffers, STATE, StepBuffers, VectorEnv};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::{Value, json};

/// More than one shard for each of two threads, with a last tile that is not full.
const ENVS: usize = 1045;
const STEPS: usize = 25;

/// A batch with room for the results of a step, and for those of a rollout.
struct Batch {
    env: VectorEnv,
    last: Step,
    returns: Vec<f32>,
    history: Step,
}

/// Results of one step or of several.
#[derive(Clone, Default)]
struct Step {
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    flying: Vec<bool>,
    metrics: Vec<f32>,
}

impl Step {
    fn buffers(&mut self) -> StepBuffers<'_> {
        let Step { observations, rewards, terminated, truncated, flying, metrics } = self;
        StepBuffers { observations, rewards, terminated, truncated, flying, metrics }
    }
    fn bits(&self) -> Vec<u32> {
        let numbers = [&self.observations, &self.rewards, &self.metrics];
        let flags = [&self.terminated, &self.truncated, &self.flying];
        let numbers = numbers.into_iter().flatten().map(|number| number.to_bits());
        numbers.chain(flags.into_iter().flatten().map(|flag| u32::from(*flag))).collect()
    }
}

impl Batch {
    fn new(options: &Value, envs: usize) -> Self {
        let options = Options::parse(&options.to_string()).unwrap();
        let env = VectorEnv::new(&[Model::thesis()], &options, envs).unwrap();
        let rows = envs * env.num_drones();
        let results = |steps: usize| Step {
            observations: vec![0.0; steps * rows * env.width()],
            rewards: vec![0.0; steps * rows],
            terminated: vec![false; steps * rows],
            truncated: vec![false; steps * rows],
            flying: vec![true; rows],
            metrics: vec![0.0; envs * env.num_metrics()],
        };
        let mut batch = Batch { last: results(1), history: results(STEPS), returns: vec![0.0; rows], env };
        let seeds: Vec<u64> = (0..envs as u64).collect();
        batch.env.reset(Some(&seeds), None, &mut batch.last.observations).unwrap();
        batch
    }

    fn rows(&self) -> usize {
        self.returns.len()
    }

    fn rollout(&mut self, actions: &[f32]) -> Result<()> {
        let Batch { env, last, returns, history, .. } = self;
        env.rollout(actions, STEPS, buffers(last, returns, history))
    }

    fn rollout_with(&mut self, controllers: &mut [MultiController], actions: &mut [f32]) -> Result<()> {
        let Batch { env, last, returns, history, .. } = self;
        env.rollout_with(controllers, STEPS, actions, buffers(last, returns, history))
    }

    fn states(&self) -> Vec<u32> {
        let mut states = vec![0.0; self.rows() * STATE];
        self.env.states(&mut states).unwrap();
        states.into_iter().map(f32::to_bits).collect()
    }

    /// Compares a rollout of this batch with steps of another one.
    fn check(&self, steps: &[Step], other: &Batch, what: &str) {
        assert!(self.last.bits() == other.last.bits(), "{what}: last step");
        assert!(self.states() == other.states(), "{what}: states");
        let rows = self.rows();
        let mut returns = vec![0.0; rows];
        let mut over = vec![false; rows];
        for (k, step) in steps.iter().enumerate() {
            let (at, wide) = (k * rows..(k + 1) * rows, rows * self.env.width());
            assert!(self.history.rewards[at.clone()] == step.rewards, "{what}: rewards of step {k}");
            assert!(self.history.terminated[at.clone()] == step.terminated, "{what}: ends of step {k}");
            assert!(self.history.truncated[at] == step.truncated, "{what}: ends of step {k}");
            let observations = &self.history.observations[k * wide..(k + 1) * wide];
            assert!(observations == step.observations, "{what}: observations of step {k}");
            for row in 0..rows {
                returns[row] += if over[row] { 0.0 } else { step.rewards[row] };
                over[row] |= step.terminated[row] | step.truncated[row];
            }
        }
        assert!(self.returns == returns, "{what}: returns");
    }
}

fn buffers<'a>(last: &'a mut Step, returns: &'a mut [f32], history: &'a mut Step) -> RolloutBuffers<'a> {
    let Step { observations, rewards, terminated, truncated, .. } = history;
    RolloutBuffers { last: last.buffers(), returns, observations, rewards, terminated, truncated }
}

fn actions(rows: usize) -> Vec<f32> {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    (0..STEPS * rows * ACTION).map(|_| rng.random_range(-0.5..0.5)).collect()
}

/// Options under which episodes end at all times, of two threads or one.
fn asked(task: &str, autoreset: &str, threads: usize) -> Value {
    json!({"task": task, "autoreset": autoreset, "max_episode_steps": 11, "threads": threads,
           "effects": {"camera_noise": {"xy_m": 0.004}, "cmd_delay": 0.03, "gust": 0.2},
           "observation": if task == "hover" { "estimate" } else { "measured" },
           "history": if autoreset == "same_step" { 2 } else { 1 }})
}

#[test]
fn a_rollout_is_its_steps() {
    for entry in task::registry() {
        for (autoreset, threads) in [("next_step", 2), ("same_step", 1)] {
            let envs = if entry.drones == 1 { ENVS } else { 75 };
            let mut whole = Batch::new(&asked(entry.name, autoreset, threads), envs);
            let mut single = Batch::new(&asked(entry.name, autoreset, 1), envs);
            let actions = actions(whole.rows());
            whole.rollout(&actions).unwrap();
            let steps: Vec<Step> = actions
                .chunks(whole.rows() * ACTION)
                .map(|actions| {
                    single.env.step(actions, single.last.buffers()).unwrap();
                    single.last.clone()
                })
                .collect();
            whole.check(&steps, &single, &format!("{} {autoreset}", entry.name));
            let (one, other) = (whole.env.snapshot(), single.env.snapshot());
            assert!(one == other, "{} {autoreset}: what flights go on from", entry.name);
        }
    }
}

/// Returns options with a user's reward and end, over velocities as actions and a history.
fn own_judgement(threads: usize) -> Value {
    json!({"task": "hover", "max_episode_steps": 11, "threads": threads, "action": "velocity", "history": 3,
           "observation": ["error_m", "vel_mps"], "reward": "exp(-4*dist**2) - 0.01*rate2",
           "termination": "dist > 0.6"})
}

#[test]
fn a_rollout_with_expressions_and_velocities_is_its_steps() {
    for threads in [1, 2] {
        let mut whole = Batch::new(&own_judgement(threads), ENVS);
        let mut single = Batch::new(&own_judgement(1), ENVS);
        let actions = actions(whole.rows());
        whole.rollout(&actions).unwrap();
        let mut steps = Vec::new();
        for actions in actions.chunks(whole.rows() * ACTION) {
            single.env.step(actions, single.last.buffers()).unwrap();
            steps.push(single.last.clone());
        }
        whole.check(&steps, &single, &format!("{threads} threads"));
        assert!(whole.history.terminated.contains(&true), "the own end of a flight");
        assert!(whole.env.snapshot() == single.env.snapshot(), "what flights go on from");
    }
}

#[test]
fn the_first_reward_that_is_no_number_is_told_as_steps_tell_it() {
    let options = |threads: usize| json!({"task": "hover", "threads": threads, "reward": "sqrt(0.09 - dist**2)", "autoreset": "same_step"});
    let actions = actions(ENVS);
    let mut single = Batch::new(&options(1), ENVS);
    let told = actions
        .chunks(ENVS * ACTION)
        .find_map(|actions| single.env.step(actions, single.last.buffers()).err())
        .expect("drones further than 30 cm from where they should be")
        .to_string();
    let mut states = Vec::new();
    for threads in [1, 2, 3] {
        let mut batch = Batch::new(&options(threads), ENVS);
        assert_eq!(batch.rollout(&actions).unwrap_err().to_string(), told, "{threads} threads");
        // all steps have been flown, and nothing is left over for the next one
        states.push(batch.states());
        batch.env.reset(None, None, &mut batch.last.observations).unwrap();
    }
    assert!(states[0] == states[1] && states[0] == states[2]);
}

/// The PID for every drone of each shard.
fn pilots(env: &VectorEnv) -> Vec<MultiController> {
    let model = Model::thesis();
    let one = |drone: usize, envs: usize| {
        let (interface, tick_s) = (env.interfaces()[drone], env.tick_s());
        let site = ControllerContext { model: &model, interface, tick_s, envs, mode: Mode::Automatic };
        ControllerSpec::named("thesis-pid").unwrap().build(&site).unwrap()
    };
    let shard = |envs: usize| {
        let all = (0..env.num_drones()).map(|drone| one(drone, envs)).collect();
        MultiController::new(all, envs, None, env.tick_s()).unwrap()
    };
    env.shard_envs().map(shard).collect()
}

#[test]
fn a_controller_flies_a_rollout_as_its_steps() {
    for (task, envs) in [("hover", ENVS), ("swap", 75)] {
        for autoreset in ["next_step", "same_step"] {
            let mut whole = Batch::new(&asked(task, autoreset, 2), envs);
            let mut single = Batch::new(&asked(task, autoreset, 1), envs);
            let mut last = vec![0.0; whole.rows() * ACTION];
            whole.rollout_with(&mut pilots(&whole.env), &mut last).unwrap();
            let mut controllers = pilots(&single.env);
            let mut actions = last.clone();
            let drones = single.env.num_drones();
            let wide = drones * single.env.measured_width();
            let mut steps: Vec<Step> = Vec::new();
            for _ in 0..STEPS {
                let measured = single.env.measured(&single.last.observations).to_vec();
                let sizes: Vec<usize> = single.env.shard_envs().collect();
                let (mut rows, mut slots) = (&measured[..], &mut actions[..]);
                for (controller, envs) in controllers.iter_mut().zip(&sizes) {
                    let (seen, others) = rows.split_at(envs * wide);
                    let (out, left) = slots.split_at_mut(envs * drones * ACTION);
                    controller.act(seen, out).unwrap();
                    (rows, slots) = (others, left);
                }
                let over = |step: &Step, env: usize| {
                    (env * drones..(env + 1) * drones).all(|d| step.terminated[d] | step.truncated[d])
                };
                single.env.step(&actions, single.last.buffers()).unwrap();
                // nothing ends an episode here but the time, and that for all drones
                let ends = if autoreset == "same_step" { Some(&single.last) } else { steps.last() };
                let mut first = 0;
                for (controller, envs) in controllers.iter_mut().zip(&sizes) {
                    controller.reset(&|env| ends.is_some_and(|step| over(step, first + env)));
                    first += envs;
                }
                steps.push(single.last.clone());
            }
            whole.check(&steps, &single, &format!("{task} {autoreset}"));
            assert_eq!(last, actions);
        }
    }
}

#[test]
fn without_resets_what_has_ended_stands_still() {
    for task in ["hover", "swap"] {
        let mut batch = Batch::new(&asked(task, "disabled", 2), 75);
        let rows = batch.rows();
        batch.rollout(&vec![0.0; STEPS * rows * ACTION]).unwrap();
        assert!(batch.history.truncated[10 * rows..11 * rows].contains(&true), "{task}");
        for later in 11 * rows..STEPS * rows {
            assert_eq!(batch.history.rewards[later], 0.0, "{task}");
            assert!(!(batch.history.terminated[later] | batch.history.truncated[later]), "{task}");
        }
        assert!(batch.history.observations[11 * rows * batch.env.width()..].iter().all(|x| *x == 0.0));
        let error = batch.rollout(&vec![0.0; STEPS * rows * ACTION]).unwrap_err().to_string();
        assert!(error.contains("ended"), "{error}");
    }
}

#[test]
fn mistakes_are_named_before_anything_moves() {
    let mut batch = Batch::new(&json!({"task": "hover", "threads": 2}), 40);
    let (before, mut bad) = (batch.env.snapshot(), actions(40));
    assert!(batch.rollout(&bad[1..]).unwrap_err().to_string().contains("actions"));
    bad[(7 * 40 + 33) * ACTION + 2] = f32::NAN;
    let error = batch.rollout(&bad).unwrap_err().to_string();
    assert!(error.contains("33") && error.contains('2') && error.contains("NaN"), "{error}");
    batch.history.rewards.pop();
    assert!(batch.rollout(&actions(40)).unwrap_err().to_string().contains("rewards"));
    batch.returns.pop();
    let Batch { env, last, returns, history, .. } = &mut batch;
    let error = env.rollout(&actions(40), STEPS, buffers(last, returns, history)).unwrap_err().to_string();
    assert!(error.contains("returns"), "{error}");
    assert!(
        env.rollout_with::<MultiController>(&mut [], STEPS, &mut [], buffers(last, returns, history))
            .is_err()
    );
    assert!(batch.env.snapshot() == before);
}
