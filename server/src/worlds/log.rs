//! What was obeyed in a world, tick by tick, and the flight again from it. As text: JSON, one object a line; the plan, the ticks, the end.

use std::collections::BTreeMap;
use std::io::Write;

use crazyflie_env::observation::ACTION;
use serde::{Deserialize, Serialize};

use super::{Flight, Plan};

/// What the first line begins with.
const FORMAT: &str = "crazyflie.world.v1";

/// Whose action a drone obeyed in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum By {
    Pilot,
    /// The pilot was late: its last action, the autopilot's if it has given none.
    Late,
    Autopilot,
    /// The drone flies no more, and its action means nothing.
    Nobody,
}

/// Grows with the flight: 17 bytes for each drone and tick.
#[derive(Debug, Clone)]
pub struct Log {
    head: Head,
    actions: Vec<[f32; ACTION]>,
    by: Vec<By>,
    /// How often each drone's pilot was late.
    pub late: Vec<u64>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Head {
    format: String,
    /// That has flown it.
    program: String,
    world: String,
    drones: usize,
    tick_s: f64,
    #[serde(flatten)]
    plan: Plan,
}

#[derive(Debug, Serialize, Deserialize)]
struct Tick {
    /// With all digits: read again and rounded they are the same `f32`.
    actions: Vec<[f64; ACTION]>,
    by: Vec<By>,
}

/// How a flight stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct End {
    pub ticks: u64,
    /// How often each drone's pilot was late.
    pub late: Vec<u64>,
    pub metrics: BTreeMap<String, f32>,
    pub over: bool,
    /// Of all that was seen and true, see [`Flight::hash`].
    pub sha256: String,
}

/// A line of the log.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Line {
    End(End),
    Tick(Tick),
}

#[derive(Debug, thiserror::Error)]
pub enum LogError {
    #[error("line {line}: {problem}")]
    Line { line: usize, problem: String },
    #[error("line {line}: {problem}")]
    Flight { line: usize, problem: crazyflie_env::Error },
    #[error("the log has no last line: it was cut off")]
    Cut,
}

/// A log flown again.
#[derive(Debug, Serialize)]
pub struct Flown {
    pub world: String,
    pub mission: String,
    pub drones: usize,
    /// As the log says it, and as it was now.
    pub told: End,
    pub flown: End,
}

impl Log {
    pub(crate) fn new(world: &str, plan: &Plan, flight: &Flight) -> Log {
        let (format, program) = (FORMAT.into(), concat!("crazyflie ", env!("CARGO_PKG_VERSION")).into());
        let head = Head { format, program, world: world.into(), drones: flight.drones(), tick_s: flight.tick_s(), plan: plan.clone() };
        Log { head, actions: Vec::new(), by: Vec::new(), late: vec![0; flight.drones()] }
    }

    /// Bytes that a world of so many drones and steps takes.
    pub(crate) fn bytes(drones: usize, steps: u32) -> usize {
        drones.saturating_mul(steps as usize).saturating_mul(size_of::<[f32; ACTION]>() + size_of::<By>())
    }

    /// Adds the tick that `flight` has just flown.
    pub(crate) fn push(&mut self, flight: &Flight, by: &[By]) {
        self.actions.extend(flight.actions.as_chunks::<ACTION>().0);
        self.by.extend(by);
        count(&mut self.late, by);
    }

    pub(crate) fn plan(&self) -> &Plan {
        &self.head.plan
    }

    /// With the last line, which says how the flight stands.
    ///
    /// # Errors
    /// Of the writer.
    pub(crate) fn write(&self, end: &End, out: &mut dyn Write) -> std::io::Result<()> {
        let mut line = |value: serde_json::Result<String>| writeln!(out, "{}", value?);
        line(serde_json::to_string(&self.head))?;
        let n = self.head.drones;
        for (actions, by) in self.actions.chunks(n).zip(self.by.chunks(n)) {
            let actions = actions.iter().map(|action| action.map(f64::from)).collect();
            line(serde_json::to_string(&Tick { actions, by: by.into() }))?;
        }
        line(serde_json::to_string(end))
    }
}

fn count(late: &mut [u64], by: &[By]) {
    late.iter_mut().zip(by).for_each(|(late, by)| *late += u64::from(*by == By::Late));
}

impl End {
    pub(crate) fn of(flight: &Flight, late: &[u64]) -> End {
        let metrics = flight.metrics().map(|(name, value)| (name.to_owned(), value)).collect();
        End { ticks: flight.ticks, late: late.into(), metrics, over: flight.over(), sha256: flight.hash() }
    }
}

/// Flies a log again.
///
/// # Errors
/// [`LogError`] with the line that is not as it should be.
pub fn fly_again(text: &str) -> Result<Flown, LogError> {
    let mut lines = text.lines().enumerate().map(|(i, text)| (i + 1, text));
    let problem = |line, problem: String| LogError::Line { line, problem };
    let (_, first) = lines.next().ok_or(LogError::Cut)?;
    let head: Head = serde_json::from_str(first).map_err(|e| problem(1, format!("expected the plan of a world: {e}")))?;
    if head.format != FORMAT {
        return Err(problem(1, format!("the format is {:?}, expected {FORMAT:?}", head.format)));
    }
    let mut flight = Flight::new(&head.plan).map_err(|problem| LogError::Flight { line: 1, problem })?;
    let mut late = vec![0; flight.drones()];
    for (line, text) in lines {
        match serde_json::from_str(text).map_err(|_| problem(line, "expected actions and by of every drone, or the end".into()))? {
            Line::Tick(tick) => {
                let actions: Vec<_> = tick.actions.iter().map(|action| action.map(|number| number as f32)).collect();
                flight.step_with(&actions).map_err(|problem| LogError::Flight { line, problem })?;
                count(&mut late, &tick.by);
            }
            Line::End(told) => {
                let (world, mission, drones) = (head.world, head.plan.mission, flight.drones());
                return Ok(Flown { world, mission, drones, told, flown: End::of(&flight, &late) });
            }
        }
    }
    Err(LogError::Cut)
}
