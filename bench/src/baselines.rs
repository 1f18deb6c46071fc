//! Attempts of controllers in this process. They see the same observations as any client and take the same
//! path.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController, build_each};
use crazyflie_env::action::ACTION;
use crazyflie_env::model::Model;
use crazyflie_env::vector::StepBuffers;

use super::attempt::{AttemptScore, score_attempt};
use super::episodes::{AttemptSpec, EpisodeBatch};
use super::error::Result;
use super::scenario::Scenario;
use super::{Attempt, Bench, Document, Submitter};
use crazyflie_server::flight::{Trace, phase_at};

/// A controller that enters the benchmark.
#[derive(Debug, Clone)]
pub struct Entrant {
    /// One controller for all drones, or one for each.
    pub controllers: Vec<ControllerSpec>,
    /// Drones that share the air keep out of each other's way.
    pub avoid: bool,
}

impl From<ControllerSpec> for Entrant {
    fn from(controller: ControllerSpec) -> Entrant {
        Entrant { controllers: vec![controller], avoid: false }
    }
}

impl Entrant {
    /// Name on the leaderboard, cut to 64 characters: a long file name must not fail an attempt.
    pub fn name(&self) -> String {
        let how = if self.avoid { "avoid+" } else { "" };
        let labels: Vec<&str> = self.controllers.iter().map(|controller| &controller.label[..]).collect();
        how.chars().chain(labels.join(",").chars()).filter(|c| !c.is_control()).take(64).collect()
    }

    /// Built for the scenarios' vehicle, which is the thesis's.
    pub fn pilot(&self, spec: AttemptSpec, mode: Mode) -> crazyflie_env::Result<MultiController> {
        let AttemptSpec { interface, tick_s, episodes, drones } = spec;
        let model = Model::thesis();
        let site = |_| ControllerContext { model: &model, interface, tick_s, envs: episodes, mode };
        let controllers = build_each(&self.controllers, (0..drones).map(site), 0)?;
        let avoid = (self.avoid && drones > 1).then(CollisionAvoidance::default);
        MultiController::new(controllers, episodes, avoid, tick_s)
    }

    /// [`Self::pilot`] for a ranked attempt, which shows measurements only.
    ///
    /// # Errors
    /// [`crazyflie_env::Error::Config`] for a controller that reads the true state.
    pub fn ranked_pilot(&self, spec: AttemptSpec, mode: Mode) -> crazyflie_env::Result<MultiController> {
        let pilot = self.pilot(spec, mode)?;
        let name = format!("controller {}", self.name());
        pilot.needs().refuse_truth(&name, "ranked attempts show measurements only")?;
        Ok(pilot)
    }
}

/// One attempt from beginning to end.
pub fn submit(bench: &Bench, scenario: &str, entrant: &Entrant) -> Result<Document> {
    if entrant.controllers.iter().all(ControllerSpec::is_divisible) {
        // a controller that cannot fly the scenario leaves no attempt behind; Python's are made once
        let first = bench.scenario(scenario)?;
        entrant.ranked_pilot(EpisodeBatch::begin(first, &[0])?.spec(), first.phases[0].mode)?;
    }
    let mut attempt = bench.begin(scenario, Submitter::Local, entrant.name().as_str())?;
    fly(&mut attempt, entrant)?;
    attempt.finish()
}

fn fly(attempt: &mut Attempt, entrant: &Entrant) -> Result<()> {
    let rows = attempt.rows()?;
    let mut pilot = entrant.ranked_pilot(attempt.spec()?, attempt.phase()?.mode)?;
    let (mut observations, mut actions) = (attempt.observations()?.to_vec(), vec![0.0; rows * ACTION]);
    let (mut rewards, mut terminated, mut truncated) =
        (vec![0.0; rows], vec![false; rows], vec![false; rows]);
    loop {
        pilot.set_mode(attempt.phase()?.mode);
        pilot.act(&observations, &mut actions)?;
        let out = StepBuffers::new(&mut observations, &mut rewards, &mut terminated, &mut truncated);
        if attempt.step(&actions, out)? {
            return Ok(());
        }
    }
}

/// Flies the scenario for the given seeds and scores it like an attempt, but stores nothing. Also returns the
/// first trace.
pub fn evaluate(
    scenario: &Scenario,
    entrant: &Entrant,
    seeds: &[u64],
) -> Result<(AttemptScore, Option<Trace>)> {
    let mut episodes = EpisodeBatch::begin(scenario, seeds)?;
    let spec = episodes.spec();
    let mut pilot = entrant.pilot(spec, scenario.phases[0].mode)?;
    let mut actions = vec![0.0; episodes.rows() * ACTION];
    loop {
        pilot.set_mode(phase_at(&scenario.phases, episodes.tick() as f64 * spec.tick_s).mode);
        pilot.set_states(episodes.states());
        pilot.act(episodes.observations(), &mut actions)?;
        if episodes.step(&actions)? {
            let flights = episodes.finish()?;
            let score = score_attempt(scenario, &flights)?;
            let first = flights.into_iter().next().and_then(|flight| flight.paths.into_iter().next());
            return Ok((score, first.map(|path| path.trace)));
        }
    }
}
