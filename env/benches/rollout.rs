//! Drone-steps per second of rollouts beside single steps: a large batch beside a small one, two cores beside one.
//! The compared ways take turns in one run, so that a busy machine slows both; a ratio is the median over the rounds.
//! `cargo bench -p crazyflie-env --bench rollout`.

use std::hint::black_box;
use std::time::{Duration, Instant};

use crazyflie_control::{Controller, ControllerContext, ControllerSpec, Mode};
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::{RolloutBuffers, StepBuffers, VectorEnv};

const STEPS: usize = 20;
const ROUNDS: usize = 9;
const TURN: Duration = Duration::from_millis(150);
const SMALL: usize = 1024;
const LARGE: usize = 65536;
const EFFECTS: &str = r#", "vertical": "pwm", "effects": {"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5},
    "ground_effect": 1.0, "drag_linear": 0.3, "cmd_delay": 0.03, "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1}}"#;

/// The ways to fly a batch.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// Step by step.
    Steps,
    /// A rollout with actions that are known.
    Actions,
    /// A rollout with the thesis's PID.
    Controller,
}

struct Rig {
    env: VectorEnv,
    way: Way,
    controllers: Vec<Box<dyn Controller>>,
    actions: Vec<f32>,
    /// With room to begin the rows at a cache line, where they are written faster.
    room: Vec<f32>,
    skip: usize,
    rewards: Vec<f32>,
    returns: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Rig {
    fn new(envs: usize, threads: usize, way: Way, more: &str) -> Self {
        let text = format!("{{\"max_episode_steps\": 500, \"threads\": {threads}{more}}}");
        let model = Model::thesis();
        let options = Options::parse(&text).expect("options of the benchmark");
        let mut env = VectorEnv::new(std::slice::from_ref(&model), &options, envs).expect("environments");
        let mut room = vec![0.0_f32; envs * OBSERVATION + 16];
        let skip = room.as_ptr().align_offset(64);
        let seeds: Vec<u64> = (0..envs as u64).collect();
        env.reset(Some(&seeds), None, &mut room[skip..skip + envs * OBSERVATION]).expect("reset");
        let (interface, tick_s) = (env.interfaces()[0], env.tick_s());
        let pid = ControllerSpec::named("thesis-pid").expect("a controller");
        let controllers = env.shard_envs().map(|envs| {
            let site = ControllerContext { model: &model, interface, tick_s, envs, mode: Mode::Automatic };
            pid.build(&site).expect("a controller")
        });
        let controllers = controllers.collect();
        // small tilts to all sides, the weight carried: flights last, and still end at all times
        let lift = if interface.hover_lift > 0.0 {
            (2.0 * interface.hover_lift / interface.lift_max - 1.0) as f32
        } else {
            0.0
        };
        let steps = if way == Way::Actions { STEPS } else { 1 };
        let actions = (0..steps * envs * ACTION)
            .map(|i| if i % ACTION == 3 { lift } else { 0.02 * ((i * 7919 % 199) as f32 / 99.0 - 1.0) })
            .collect();
        let (numbers, flags) = (vec![0.0; envs], vec![false; envs]);
        Rig {
            env,
            way,
            controllers,
            actions,
            room,
            skip,
            rewards: numbers.clone(),
            returns: numbers,
            terminated: flags.clone(),
            truncated: flags,
        }
    }

    /// [`STEPS`] steps.
    fn fly(&mut self) {
        let Rig { env, way, controllers, actions, room, skip, rewards, returns, terminated, truncated } =
            self;
        let rows = &mut room[*skip..*skip + rewards.len() * OBSERVATION];
        if *way == Way::Steps {
            for _ in 0..STEPS {
                let out = StepBuffers::new(rows, rewards, terminated, truncated);
                env.step(black_box(actions), out).expect("step");
            }
            return;
        }
        let last = StepBuffers::new(rows, rewards, terminated, truncated);
        let out = RolloutBuffers {
            last,
            returns,
            observations: &mut [],
            rewards: &mut [],
            terminated: &mut [],
            truncated: &mut [],
        };
        match way {
            Way::Controller => env.rollout_with(controllers, STEPS, actions, out).expect("rollout"),
            _ => env.rollout(black_box(actions), STEPS, out).expect("rollout"),
        }
    }

    /// Drone-steps per second of one turn.
    fn rate(&mut self) -> f64 {
        let (begin, mut flown) = (Instant::now(), 0);
        while begin.elapsed() < TURN {
            self.fly();
            flown += STEPS * self.rewards.len();
        }
        flown as f64 / begin.elapsed().as_secs_f64()
    }
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[numbers.len() / 2]
}

/// Prints rates of the small batch, the large one, and the large one on two cores, and their ratios.
fn compare(name: &str, way: Way, more: &str) {
    let mut rigs =
        [(SMALL, 1), (LARGE, 1), (LARGE, 2)].map(|(envs, threads)| Rig::new(envs, threads, way, more));
    for rig in &mut rigs {
        for _ in 0..if rig.rewards.len() == SMALL { 30 } else { 3 } {
            rig.fly();
        }
    }
    let rounds: Vec<[f64; 3]> = (0..ROUNDS).map(|_| std::array::from_fn(|i| rigs[i].rate())).collect();
    let rate = |i: usize| median(rounds.iter().map(|round| round[i]).collect()) / 1e6;
    let ratio = |i: usize, j: usize| median(rounds.iter().map(|round| round[i] / round[j]).collect());
    println!(
        "{name:32} {SMALL}: {:6.1} M/s, {LARGE}: {:6.1} M/s ({:.2} of it), on two cores {:6.1} M/s ({:.2} times one)",
        rate(0),
        rate(1),
        ratio(1, 0),
        rate(2),
        ratio(2, 1)
    );
}

fn main() {
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!(
        "{} logical cores, load {}; hover, next-step resets, {STEPS} steps each",
        std::thread::available_parallelism().map_or(0, usize::from),
        load.split(' ').next().unwrap_or("unknown")
    );
    for (name, more) in [("no effects", ""), ("five effects", EFFECTS)] {
        compare(&format!("steps, {name}"), Way::Steps, more);
        compare(&format!("rollout of actions, {name}"), Way::Actions, more);
        compare(&format!("rollout of the PID, {name}"), Way::Controller, more);
    }
}
