//! Built-in controllers in attempts on a server elsewhere: a client like anyone's own, which knows what `docs/protocol.md` tells it.

use crazyflie_env::control::Chosen;
use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::bench::baselines;
use crate::bench::{Document, PlannedPhase};
use crate::flight::phase_at;
use crate::link::{Error, Link};

/// A reply, as far as it is of use here.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Said {
    Welcome { scenarios: Vec<String> },
    Begun(Begun),
    Result { observation: Vec<[f32; OBSERVATION]>, over: bool },
    Finished { attempt: Map<String, Value> },
}

#[derive(Debug, Deserialize)]
struct Begun {
    tick_s: f64,
    interface: Interface,
    phases: Vec<PlannedPhase>,
    observation: Vec<[f32; OBSERVATION]>,
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
        let client = concat!("crazyflie submit ", env!("CARGO_PKG_VERSION"));
        match link.ask("hello", json!({"client": client, "token": token}))? {
            Said::Welcome { scenarios } => Ok(Afar { link, token: token.into(), scenarios }),
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
    pub(crate) fn submit(&mut self, scenario: &str, controller: &Chosen) -> Result<Document, Error> {
        let asked = json!({"scenario": scenario, "controller": baselines::name(controller), "token": self.token});
        match self.link.ask("benchmark", asked)? {
            Said::Begun(begun) => self.fly(begun, controller)?,
            other => return Err(unexpected(&self.link, &other)),
        }
        let mut attempt = match self.link.ask("finish", json!({}))? {
            Said::Finished { attempt } => attempt,
            other => return Err(unexpected(&self.link, &other)),
        };
        // what the server adds to what it signed
        attempt.remove("signature");
        attempt.remove("at");
        serde_json::from_value(attempt.into()).map_err(|e| self.link.strange(e))
    }

    fn fly(&mut self, begun: Begun, controller: &Chosen) -> Result<(), Error> {
        let Begun { tick_s, interface, phases, mut observation } = begun;
        let envs = observation.len();
        let phases = phases.iter().map(PlannedPhase::phase).collect::<Result<Vec<_>, _>>()?;
        if phases.is_empty() || envs == 0 {
            return Err(self.link.strange("an attempt without phases or episodes"));
        }
        let mode = |tick: u32| phase_at(&phases, f64::from(tick) * tick_s).mode;
        let mut pilot = baselines::pilot(controller, interface, tick_s, envs, mode(0))?;
        let mut actions = vec![0.0; envs * ACTION];
        for tick in 0.. {
            pilot.set_mode(mode(tick));
            pilot.act(observation.as_flattened(), &mut actions)?;
            // as the f64 that they are: they come back bit for bit
            let rows: Vec<[f64; ACTION]> = actions.as_chunks().0.iter().map(|row: &[f32; ACTION]| row.map(f64::from)).collect();
            match self.link.ask("step", json!({"action": rows}))? {
                Said::Result { observation: _, over: true } => break,
                Said::Result { observation: rows, over: false } if rows.len() == envs => observation = rows,
                other => return Err(unexpected(&self.link, &other)),
            }
        }
        Ok(())
    }
}

fn unexpected(link: &Link, said: &Said) -> Error {
    let words: String = format!("{said:?}").chars().take(80).collect();
    link.strange(format!("an unexpected reply, {words}"))
}
