//! Built-in controllers in attempts on a server elsewhere: a client like anyone's own, which knows what `docs/protocol.md` tells it.

use crazyflie_env::observation::{ACTION, Interface};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crazyflie_server::bench::{Document, Entrant, PlannedPhase, Seat};
use crazyflie_server::flight::phase_at;
use crazyflie_server::link::{Error, Link};

/// A reply, as far as it is of use here.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum ServerMessage {
    Welcome { scenarios: Vec<String> },
    Begun(Begun),
    Result { observation: Vec<Vec<f32>>, over: bool },
    Finished { attempt: Map<String, Value> },
}

#[derive(Debug, Deserialize)]
struct Begun {
    tick_s: f64,
    interface: Interface,
    phases: Vec<PlannedPhase>,
    drones: usize,
    observation: Vec<Vec<f32>>,
}

/// A connection to a server, for a team.
pub(crate) struct Afar {
    link: Link,
    token: String,
    scenarios: Vec<String>,
}

impl Afar {
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn open(url: &str, token: &str) -> Result<Afar, Error> {
        let mut link = Link::open(url)?;
        let client = concat!("crazyflie bench submit ", env!("CARGO_PKG_VERSION"));
        match link.ask("hello", json!({"client": client, "token": token}))? {
            ServerMessage::Welcome { scenarios } => Ok(Afar { link, token: token.into(), scenarios }),
            other => Err(unexpected(&link, &other)),
        }
    }

    /// What there is to fly, by `name@version`.
    pub(crate) fn scenarios(&self) -> &[String] {
        &self.scenarios
    }

    /// One attempt from beginning to end, and the row that the server has signed and stored.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn submit(&mut self, scenario: &str, entrant: &Entrant) -> Result<Document, Error> {
        let asked = json!({"scenario": scenario, "controller": entrant.name(), "token": self.token});
        match self.link.ask("benchmark", asked)? {
            ServerMessage::Begun(begun) => self.fly(begun, entrant)?,
            other => return Err(unexpected(&self.link, &other)),
        }
        let mut attempt = match self.link.ask("finish", json!({}))? {
            ServerMessage::Finished { attempt } => attempt,
            other => return Err(unexpected(&self.link, &other)),
        };
        // what the server adds to what it signed
        attempt.remove("signature");
        attempt.remove("at");
        serde_json::from_value(attempt.into()).map_err(|e| self.link.strange(e))
    }

    fn fly(&mut self, begun: Begun, entrant: &Entrant) -> Result<(), Error> {
        let Begun { tick_s, interface, phases, drones, mut observation } = begun;
        let rows = observation.len();
        let phases = phases.iter().map(PlannedPhase::phase).collect::<Result<Vec<_>, _>>()?;
        if phases.is_empty() || rows == 0 || drones == 0 || rows % drones != 0 {
            return Err(self.link.strange("an attempt without phases or episodes"));
        }
        let mode = |tick: u32| phase_at(&phases, f64::from(tick) * tick_s).mode;
        let mut pilot = entrant.pilot(Seat { interface, tick_s, episodes: rows / drones, drones }, mode(0))?;
        let mut actions = vec![0.0; rows * ACTION];
        for tick in 0.. {
            pilot.set_mode(mode(tick));
            pilot.act(&observation.concat(), &mut actions)?;
            // as the f64 that they are: they come back bit for bit
            let asked: Vec<[f64; ACTION]> = actions.as_chunks().0.iter().map(|row: &[f32; ACTION]| row.map(f64::from)).collect();
            match self.link.ask("step", json!({"action": asked}))? {
                ServerMessage::Result { observation: _, over: true } => break,
                ServerMessage::Result { observation: next, over: false } if next.len() == rows => observation = next,
                other => return Err(unexpected(&self.link, &other)),
            }
        }
        Ok(())
    }
}

fn unexpected(link: &Link, said: &ServerMessage) -> Error {
    let words: String = format!("{said:?}").chars().take(80).collect();
    link.strange(format!("an unexpected reply, {words}"))
}
