//! Controllers that come with the program. They see what anyone sees, and go the same way.

use crazyflie_env::control::pid::{Gains, Mode, PidBatch};
use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use crazyflie_env::plant::Command;
use crazyflie_env::vector::Out;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::error::Result;
use super::{Attempt, Bench, Document, Who};

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Baseline {
    /// The thesis's PID with the gains that it found (table 7.1)
    ThesisPid,
    /// The same PID with the defaults of `crazyflie_ros`, which the thesis began with
    StockPid,
    /// Level, with the thrust that carries the weight
    Hover,
    /// Any action, as likely as any other
    Random,
}

impl Baseline {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Baseline::ThesisPid => "thesis-pid",
            Baseline::StockPid => "stock-pid",
            Baseline::Hover => "hover",
            Baseline::Random => "random",
        }
    }

    pub(super) fn pilot(self, envs: usize, interface: Interface, tick_s: f64, mode: Mode) -> Pilot {
        let pid = |gains| Pilot::Pid(Box::new(PidBatch::new(envs, gains, interface, tick_s, mode)));
        match self {
            Baseline::ThesisPid => pid(Gains::THESIS),
            Baseline::StockPid => pid(Gains::CRAZYFLIE_ROS),
            Baseline::Hover => Pilot::Hover(interface),
            Baseline::Random => Pilot::Random(Pcg64Mcg::seed_from_u64(0)),
        }
    }
}

pub(super) enum Pilot {
    Pid(Box<PidBatch>),
    Hover(Interface),
    Random(Pcg64Mcg),
}

impl Pilot {
    pub(super) fn act(&mut self, mode: Mode, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        match self {
            Pilot::Pid(pid) => {
                pid.set_mode(mode);
                pid.act(observations, actions)?;
            }
            Pilot::Hover(interface) => {
                for (action, seen) in actions.chunks_exact_mut(ACTION).zip(observations.chunks_exact(OBSERVATION)) {
                    // a height is commanded where there is no thrust to command
                    let lift = if interface.input.is_pwm() { interface.hover_lift } else { f64::from(seen[18]) };
                    action.copy_from_slice(&interface.action(&Command::level(lift)).map(|a| a as f32));
                }
            }
            Pilot::Random(rng) => actions.iter_mut().for_each(|a| *a = rng.random_range(-1.0..=1.0)),
        }
        Ok(())
    }
}

/// One attempt by a baseline, from beginning to end.
pub(crate) fn submit(bench: &Bench, scenario: &str, baseline: Baseline) -> Result<Document> {
    let mut attempt = bench.begin(scenario, Who::Local, baseline.name())?;
    fly(&mut attempt, baseline)?;
    attempt.finish()
}

fn fly(attempt: &mut Attempt, baseline: Baseline) -> Result<()> {
    let envs = attempt.num_envs();
    let (interface, tick_s) = attempt.interface()?;
    let mut pilot = baseline.pilot(envs, interface, tick_s, attempt.phase()?.mode);
    let (mut observations, mut actions) = (attempt.observations()?.to_vec(), vec![0.0; envs * ACTION]);
    let (mut rewards, mut terminated, mut truncated) = (vec![0.0; envs], vec![false; envs], vec![false; envs]);
    loop {
        pilot.act(attempt.phase()?.mode, &observations, &mut actions)?;
        let out = Out { observations: &mut observations, rewards: &mut rewards, terminated: &mut terminated, truncated: &mut truncated };
        if attempt.step(&actions, out)? {
            return Ok(());
        }
    }
}
