//! Attempts of built-in controllers on a remote server, over the protocol of `docs/protocol.md` like any
//! other client.

use crazyflie_env::action::ACTION;
use crazyflie_server::bench::{AttemptSpec, Document, Entrant, PlannedPhase};
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::phase_at;
use crazyflie_server::protocol::{
    Actions, AttemptInfo, Benchmark, Hello, Request, Response, ServerInfo, Step,
};

/// Attempts of a team over one connection to a server.
pub(crate) struct RemoteAttempts {
    client: Client,
    token: String,
    scenarios: Vec<String>,
}

impl RemoteAttempts {
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn open(url: &str, token: &str) -> Result<RemoteAttempts, Error> {
        let mut client = Client::open(url)?;
        let name = concat!("crazyflie submit ", env!("CARGO_PKG_VERSION"));
        let hello = Hello { client: name.into(), token: Some(token.into()) };
        match client.request(&Request::Hello(hello))? {
            Response::Welcome(ServerInfo { scenarios, .. }) => {
                Ok(RemoteAttempts { client, token: token.into(), scenarios })
            }
            other => Err(client.unexpected_response(&other)),
        }
    }

    /// The scenarios of the server, by `name@version`.
    pub(crate) fn scenarios(&self) -> &[String] {
        &self.scenarios
    }

    /// One attempt from beginning to end, and the row that the server has signed and stored.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn submit(&mut self, scenario: &str, entrant: &Entrant) -> Result<Document, Error> {
        let benchmark =
            Benchmark { scenario: scenario.into(), controller: entrant.name(), token: self.token.clone() };
        match self.client.request(&Request::Benchmark(benchmark))? {
            Response::Begun(attempt) => self.fly(*attempt, entrant)?,
            other => return Err(self.client.unexpected_response(&other)),
        }
        let mut attempt = match self.client.request(&Request::Finish)? {
            Response::Finished { attempt, .. } => attempt,
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
        let mut pilot =
            entrant.pilot(AttemptSpec { interface, tick_s, episodes: rows / drones, drones }, mode(0))?;
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
