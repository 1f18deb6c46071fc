//! Attempts of built-in controllers on a remote server, over the protocol of `docs/protocol.md` like any
//! other client.

use crazyflie_bench::serve::protocol::{self, AttemptInfo, Benchmark, Finish, Offer};
use crazyflie_bench::{AttemptSpec, Document, Entrant, PlannedPhase};
use crazyflie_env::action::ACTION;
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::phase_at;
use crazyflie_server::protocol::{Actions, Code, Hello, Request, Response, Step};

/// Attempts of a team over one connection to a server.
pub(super) struct RemoteAttempts {
    client: Client,
    token: String,
    scenarios: Vec<String>,
    /// They may take the place of the team's entry, if that has another name.
    new_entry: bool,
}

impl RemoteAttempts {
    /// # Errors
    /// [`Error`] of most kinds.
    pub(super) fn open(url: &str, token: &str, new_entry: bool) -> Result<RemoteAttempts, Error> {
        let mut client = Client::open(url)?;
        let name = concat!("crazyflie submit ", env!("CARGO_PKG_VERSION"));
        let hello = Hello { client: name.into(), token: Some(token.into()) };
        let Offer { scenarios } = client.request(&Request::Hello(hello))?;
        if scenarios.is_empty() {
            return Err(Error::Refused {
                code: Code::Unavailable,
                message: "this server has no benchmark".into(),
                retry_after_s: None,
            });
        }
        Ok(RemoteAttempts { client, token: token.into(), scenarios, new_entry })
    }

    /// The scenarios of the server, by `name@version`.
    pub(super) fn scenarios(&self) -> &[String] {
        &self.scenarios
    }

    /// One attempt from beginning to end, and the row that the server has signed and stored.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub(super) fn submit(&mut self, scenario: &str, entrant: &Entrant) -> Result<Document, Error> {
        let (controller, token) = (entrant.name(), self.token.clone());
        let benchmark = Benchmark { scenario: scenario.into(), controller, token, new_entry: self.new_entry };
        match self.client.request(&protocol::Request::Benchmark(benchmark))? {
            protocol::Response::Begun(attempt) => self.fly(*attempt, entrant)?,
            other => return Err(self.client.unexpected_response(&other)),
        }
        let mut attempt = match self.client.request(&protocol::Request::Finish(Finish {}))? {
            protocol::Response::Finished { attempt, .. } => attempt,
            other => return Err(self.client.unexpected_response(&other)),
        };
        // fields that the server adds to the signed document
        attempt.remove("signature");
        attempt.remove("at");
        serde_json::from_value(attempt.into()).map_err(|e| self.client.unexpected(e))
    }

    fn fly(&mut self, attempt: AttemptInfo<'_>, entrant: &Entrant) -> Result<(), Error> {
        let AttemptInfo { tick_s, interface, phases, drones, mut observation, .. } = attempt;
        let rows = observation.count();
        let phases = phases.iter().map(PlannedPhase::phase).collect::<Result<Vec<_>, _>>()?;
        if phases.is_empty() || drones == 0 || rows % drones != 0 {
            return Err(self.client.unexpected("an attempt without phases or episodes"));
        }
        let mode = |tick: u32| phase_at(&phases, f64::from(tick) * tick_s).mode;
        let mut pilot = entrant
            .ranked_pilot(AttemptSpec { interface, tick_s, episodes: rows / drones, drones }, mode(0))?;
        let mut actions = vec![0.0; rows * ACTION];
        for tick in 0.. {
            pilot.set_mode(mode(tick));
            pilot.act(&observation.numbers, &mut actions)?;
            let step = Step { action: Actions::Many(actions.as_chunks().0.to_vec()), states: false };
            observation = match self.client.request(&Request::Step(step))? {
                Response::Result(result) if result.over == Some(true) => break,
                Response::Result(result) if result.observation.count() == rows => result.observation,
                other => return Err(self.client.unexpected_response(&other)),
            };
        }
        Ok(())
    }
}
