//! The controllers that come with the program fly attempts as anyone does: they see what anyone sees, and go the same way.

use crazyflie_env::control::{Chosen, Controller, Mode, Site};
use crazyflie_env::model::Model;
use crazyflie_env::observation::{ACTION, Interface};
use crazyflie_env::vector::Out;

use super::attempt::{Judged, judge};
use super::episodes::Episodes;
use super::error::Result;
use super::scenario::Scenario;
use super::{Attempt, Bench, Document, Who};
use crate::flight::{Trace, phase_at};

/// One attempt by a controller of the registry, from beginning to end.
pub(crate) fn submit(bench: &Bench, scenario: &str, controller: &Chosen) -> Result<Document> {
    let mut attempt = bench.begin(scenario, Who::Local, &name(controller))?;
    fly(&mut attempt, controller)?;
    attempt.finish()
}

/// What the leaderboard calls it: a long file name is no reason to refuse an attempt.
pub(crate) fn name(controller: &Chosen) -> String {
    controller.label.chars().filter(|c| !c.is_control()).take(64).collect()
}

/// Built for the scenarios' vehicle, which is the thesis's.
pub(crate) fn pilot(
    controller: &Chosen,
    interface: Interface,
    tick_s: f64,
    envs: usize,
    mode: Mode,
) -> crazyflie_env::Result<Box<dyn Controller>> {
    controller.build(&Site { model: &Model::thesis(), interface, tick_s, envs, mode })
}

fn fly(attempt: &mut Attempt, controller: &Chosen) -> Result<()> {
    let envs = attempt.num_envs();
    let (interface, tick_s) = attempt.interface()?;
    let mut pilot = pilot(controller, interface, tick_s, envs, attempt.phase()?.mode)?;
    let (mut observations, mut actions) = (attempt.observations()?.to_vec(), vec![0.0; envs * ACTION]);
    let (mut rewards, mut terminated, mut truncated) = (vec![0.0; envs], vec![false; envs], vec![false; envs]);
    loop {
        pilot.set_mode(attempt.phase()?.mode);
        pilot.act(&observations, &mut actions)?;
        let out = Out { observations: &mut observations, rewards: &mut rewards, terminated: &mut terminated, truncated: &mut truncated };
        if attempt.step(&actions, out)? {
            return Ok(());
        }
    }
}

/// Flights of the same kind with seeds of one's own, scored as those of an attempt are, and kept nowhere; with the first of them.
pub(crate) fn evaluate(scenario: &Scenario, controller: &Chosen, seeds: &[u64]) -> Result<(Judged, Option<Trace>)> {
    let mut episodes = Episodes::begin(scenario, seeds)?;
    let tick_s = episodes.tick_s();
    let mut pilot = pilot(controller, episodes.interface(), tick_s, seeds.len(), scenario.phases[0].mode)?;
    let mut actions = vec![0.0; seeds.len() * ACTION];
    loop {
        pilot.set_mode(phase_at(&scenario.phases, episodes.tick() as f64 * tick_s).mode);
        pilot.act(episodes.observations(), &mut actions)?;
        if episodes.step(&actions)? {
            let flights = episodes.finish()?;
            let judged = judge(scenario, &flights)?;
            return Ok((judged, flights.into_iter().next().map(|flight| flight.trace)));
        }
    }
}
