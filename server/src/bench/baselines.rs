//! The controllers that come with the program fly attempts as anyone does: they see what anyone sees, and go the same way.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController};
use crazyflie_env::model::Model;
use crazyflie_env::observation::{ACTION, Interface};
use crazyflie_env::vector::StepBuffers;

use super::attempt::{AttemptScore, judge};
use super::episodes::Episodes;
use super::error::Result;
use super::scenario::Scenario;
use super::{Attempt, Bench, Document, Who};
use crate::flight::{Trace, phase_at};

/// Who flies an attempt.
#[derive(Debug, Clone)]
pub struct Entrant {
    pub controller: ControllerSpec,
    /// Drones that share the air keep out of each other's way.
    pub avoid: bool,
}

impl From<ControllerSpec> for Entrant {
    fn from(controller: ControllerSpec) -> Entrant {
        Entrant { controller, avoid: false }
    }
}

/// What an attempt asks of who flies it.
#[derive(Debug, Clone, Copy)]
pub struct Seat {
    pub interface: Interface,
    pub tick_s: f64,
    pub episodes: usize,
    /// In each episode.
    pub drones: usize,
}

impl Entrant {
    /// What the leaderboard calls it: a long file name is no reason to refuse an attempt.
    pub fn name(&self) -> String {
        let how = if self.avoid { "avoid+" } else { "" };
        how.chars().chain(self.controller.label.chars()).filter(|c| !c.is_control()).take(64).collect()
    }

    /// Built for the scenarios' vehicle, which is the thesis's.
    pub fn pilot(&self, seat: Seat, mode: Mode) -> crazyflie_env::Result<MultiController> {
        let Seat { interface, tick_s, episodes, drones } = seat;
        let one = |_| self.controller.build(&ControllerContext { model: &Model::thesis(), interface, tick_s, envs: episodes, mode });
        let avoid = (self.avoid && drones > 1).then(CollisionAvoidance::default);
        MultiController::new((0..drones).map(one).collect::<crazyflie_env::Result<_>>()?, episodes, avoid, tick_s)
    }
}

/// One attempt from beginning to end.
pub fn submit(bench: &Bench, scenario: &str, entrant: &Entrant) -> Result<Document> {
    let mut attempt = bench.begin(scenario, Who::Local, &entrant.name())?;
    fly(&mut attempt, entrant)?;
    attempt.finish()
}

fn fly(attempt: &mut Attempt, entrant: &Entrant) -> Result<()> {
    let rows = attempt.rows()?;
    let mut pilot = entrant.pilot(attempt.seat()?, attempt.phase()?.mode)?;
    let (mut observations, mut actions) = (attempt.observations()?.to_vec(), vec![0.0; rows * ACTION]);
    let (mut rewards, mut terminated, mut truncated) = (vec![0.0; rows], vec![false; rows], vec![false; rows]);
    loop {
        pilot.set_mode(attempt.phase()?.mode);
        pilot.act(&observations, &mut actions)?;
        let out = StepBuffers::new(&mut observations, &mut rewards, &mut terminated, &mut truncated);
        if attempt.step(&actions, out)? {
            return Ok(());
        }
    }
}

/// Flights of the same kind with seeds of one's own, scored as those of an attempt are, and kept nowhere; with the first of them.
pub fn evaluate(scenario: &Scenario, entrant: &Entrant, seeds: &[u64]) -> Result<(AttemptScore, Option<Trace>)> {
    let mut episodes = Episodes::begin(scenario, seeds)?;
    let seat = episodes.seat();
    let mut pilot = entrant.pilot(seat, scenario.phases[0].mode)?;
    let mut actions = vec![0.0; episodes.rows() * ACTION];
    loop {
        pilot.set_mode(phase_at(&scenario.phases, episodes.tick() as f64 * seat.tick_s).mode);
        pilot.act(episodes.observations(), &mut actions)?;
        if episodes.step(&actions)? {
            let flights = episodes.finish()?;
            let judged = judge(scenario, &flights)?;
            let first = flights.into_iter().next().and_then(|flight| flight.paths.into_iter().next());
            return Ok((judged, first.map(|path| path.trace)));
        }
    }
}
