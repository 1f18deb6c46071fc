//! Attempts of built-in controllers on a remote server, over the protocol of `docs/protocol.md` like any
//! other client.

use crazyflie_env::observation::{ACTION, Interface};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crazyflie_server::bench::{AttemptSpec, Document, Entrant, PlannedPhase};
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::phase_at;

/// The replies that submitting needs, with the fields that it reads.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Response {
    Welcome { scenarios: Vec<String> },
    Begun(AttemptInfo),
    Result { observation: Vec<Vec<f32>>, over: bool },
    Finished { attempt: Map<String, Value> },
}

#[derive(Debug, Deserialize)]
struct AttemptInfo {
    tick_s: f64,
    interface: Interface,
    phases: Vec<PlannedPhase>,
    drones: usize,
    observation: Vec<Vec<f32>>,
}

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
        match client.request("hello", json!({"client": name, "token": token}))? {
            Response::Welcome { scenarios } => Ok(RemoteAttempts { client, token: token.into(), scenarios }),
            other => Err(unexpected_response(&client, &other)),
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
        let fields = json!({"scenario": scenario, "controller": entrant.name(), "token": self.token});
        match self.client.request("benchmark", fields)? {
            Response::Begun(attempt) => self.fly(attempt, entrant)?,
            other => return Err(unexpected_response(&self.client, &other)),
        }
        let mut attempt = match self.client.request("finish", json!({}))? {
            Response::Finished { attempt } => attempt,
            other => return Err(unexpected_response(&self.client, &other)),
        };
        // fields that the server adds to the signed document
        attempt.remove("signature");
        attempt.remove("at");
        serde_json::from_value(attempt.into()).map_err(|e| self.client.unexpected(e))
    }

    fn fly(&mut self, attempt: AttemptInfo, entrant: &Entrant) -> Result<(), Error> {
        let AttemptInfo { tick_s, interface, phases, drones, mut observation } = attempt;
        let rows = observation.len();
        let phases = phases.iter().map(PlannedPhase::phase).collect::<Result<Vec<_>, _>>()?;
        if phases.is_empty() || rows == 0 || drones == 0 || rows % drones != 0 {
            return Err(self.client.unexpected("an attempt without phases or episodes"));
        }
        let mode = |tick: u32| phase_at(&phases, f64::from(tick) * tick_s).mode;
        let mut pilot =
            entrant.pilot(AttemptSpec { interface, tick_s, episodes: rows / drones, drones }, mode(0))?;
        let mut actions = vec![0.0; rows * ACTION];
        for tick in 0.. {
            pilot.set_mode(mode(tick));
            pilot.act(&observation.concat(), &mut actions)?;
            // as the f64 that they are: they come back bit for bit
            let fields: Vec<[f64; ACTION]> =
                actions.as_chunks().0.iter().map(|row: &[f32; ACTION]| row.map(f64::from)).collect();
            match self.client.request("step", json!({"action": fields}))? {
                Response::Result { observation: _, over: true } => break,
                Response::Result { observation: next, over: false } if next.len() == rows => {
                    observation = next
                }
                other => return Err(unexpected_response(&self.client, &other)),
            }
        }
        Ok(())
    }
}

fn unexpected_response(client: &Client, response: &Response) -> Error {
    let words: String = format!("{response:?}").chars().take(80).collect();
    client.unexpected(format!("an unexpected reply, {words}"))
}
