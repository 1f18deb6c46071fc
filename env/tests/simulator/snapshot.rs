//! A batch that is restored from a snapshot flies on as the original does, to the bit.

use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};
use crazyflie_env::{effects, task};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::{Map, Value, json};

const ENVS: usize = 37;

/// Every effect, somewhat on and different from drone to drone.
fn all_effects() -> Value {
    let param = |p: &effects::Param| {
        let toward = if p.high > p.off { p.high } else { p.low };
        let some = p.off + 0.1 * (toward - p.off);
        (p.name.to_owned(), json!({"uniform": [p.off.min(some), p.off.max(some)]}))
    };
    let effect =
        |e: &effects::Entry| (e.name.to_owned(), Value::Object(e.params.iter().map(param).collect()));
    Value::Object(effects::registry().iter().map(effect).collect::<Map<_, _>>())
}

struct Batch {
    env: VectorEnv,
    results: [Vec<f32>; 4],
    flags: [Vec<bool>; 3],
}

impl Batch {
    fn new(options: &Value) -> Self {
        let env =
            VectorEnv::new(&[Model::thesis()], &Options::parse(&options.to_string()).unwrap(), ENVS).unwrap();
        let rows = ENVS * env.num_drones();
        let sizes = [rows * env.width(), rows, rows * STATE, ENVS * env.num_metrics()];
        Batch { results: sizes.map(|size| vec![0.0; size]), flags: [(); 3].map(|()| vec![false; rows]), env }
    }

    /// The bits of all results of a step.
    fn step(&mut self, actions: &[f32]) -> Vec<u32> {
        let ([observations, rewards, states, metrics], [terminated, truncated, flying]) =
            (&mut self.results, &mut self.flags);
        self.env
            .step(actions, StepBuffers { observations, rewards, terminated, truncated, flying, metrics })
            .unwrap();
        self.env.states(states).unwrap();
        let numbers = self.results.iter().flatten().map(|number| number.to_bits());
        numbers.chain(self.flags.iter().flatten().map(|flag| u32::from(*flag))).collect()
    }
}

#[test]
fn a_restored_batch_flies_on_as_the_original() {
    let radio = json!({"by": "radio", "delay_s": 0.06, "loss": 0.2});
    for entry in task::registry() {
        for (effects, autoreset) in [(json!({}), "same_step"), (all_effects(), "next_step")] {
            let asked = |threads: usize, isa: Value| {
                json!({"task": entry.name, "effects": effects, "autoreset": autoreset, "max_episode_steps": 60,
                       "threads": threads, "isa": isa, "neighbours": radio})
            };
            let (mut one, mut other) =
                (Batch::new(&asked(1, "baseline".into())), Batch::new(&asked(3, Value::Null)));
            let seeds: Vec<u64> = (0..ENVS as u64).map(|i| i * i).collect();
            one.env.reset(Some(&seeds), None, &mut one.results[0]).unwrap();
            let mut rng = Pcg64Mcg::seed_from_u64(1);
            let mut actions = || -> Vec<f32> {
                (0..one.flags[0].len() * ACTION).map(|_| rng.random_range(-0.6..0.6)).collect()
            };
            let (before, after): (Vec<_>, Vec<_>) =
                ((0..45).map(|_| actions()).collect(), (0..90).map(|_| actions()).collect());
            before.iter().for_each(|actions| drop(one.step(actions)));
            let snapshot = one.env.snapshot();
            other.env.restore(&snapshot).unwrap();
            assert!(snapshot == other.env.snapshot(), "{}: another snapshot", entry.name);
            for (tick, actions) in after.iter().enumerate() {
                assert!(
                    one.step(actions) == other.step(actions),
                    "{} {autoreset}: {tick} ticks later",
                    entry.name
                );
            }
        }
    }
}

#[test]
fn what_is_no_snapshot_of_such_a_batch_is_refused() {
    let mut batch = Batch::new(&json!({}));
    let snapshot = batch.env.snapshot();
    let error = |batch: &mut Batch, bytes: &[u8]| batch.env.restore(bytes).unwrap_err().to_string();
    assert!(error(&mut batch, b"").contains("not the bytes"));
    assert!(error(&mut batch, &[7; 5000]).contains("not the bytes"));
    assert!(error(&mut batch, &snapshot[..snapshot.len() - 1]).contains("cut off"));
    for at in (24..snapshot.len()).step_by(97) {
        let mut damaged = snapshot.clone();
        damaged[at] ^= 16;
        assert!(error(&mut batch, &damaged).contains("damaged"), "byte {at}");
    }
    for options in
        [json!({"effects": {"drag_linear": 0.1}}), json!({"task": "land"}), json!({"max_episode_steps": 3})]
    {
        assert!(
            error(&mut Batch::new(&options), &snapshot).contains("other models, options or size"),
            "{options}"
        );
    }
    assert_eq!(batch.env.snapshot(), snapshot);
}
