//! Log of a world: the actions of every tick, from which the flight can be replayed. Its text is JSON lines:
//! plan, ticks, summary.

use std::collections::BTreeMap;

use crazyflie_env::action::ACTION;
use serde::{Deserialize, Serialize};

use super::{WorldFigures, WorldFlight, WorldPlan};

/// Format name in the first line.
const FORMAT: &str = "crazyflie.world.v1";

/// Bytes of text for each drone and tick, about.
const DRONE_TEXT: usize = 100;

/// Source of the action that a drone obeyed in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub(crate) enum ActionSource {
    Pilot,
    /// The pilot was late: its last action, the autopilot's if it has given none.
    Late,
    Autopilot,
    /// The drone flies no more, and its action means nothing.
    Nobody,
}

/// Log of a flight. It takes 17 bytes for each drone and tick.
#[derive(Debug, Clone)]
pub struct WorldLog {
    pub(crate) head: LogHeader,
    actions: Vec<[f32; ACTION]>,
    by: Vec<ActionSource>,
    /// Number of ticks in which each drone's pilot was late.
    pub late: Vec<u64>,
    /// For the list of flights by hand; the text does not have them.
    pub(crate) figures: WorldFigures,
}

/// Ticks of a log, copied so that the world flies on while they are written.
#[derive(Debug)]
pub(crate) struct LogPart {
    /// In the first part.
    head: Option<LogHeader>,
    drones: usize,
    actions: Vec<[f32; ACTION]>,
    by: Vec<ActionSource>,
    /// The tick of the next part, if this is not the last.
    pub next: Option<usize>,
}

/// The first line: format, program and plan.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename = "Head")]
pub(crate) struct LogHeader {
    format: String,
    /// Name and version of the program that flew it.
    program: String,
    world: String,
    drones: usize,
    tick_s: f64,
    #[serde(flatten)]
    pub plan: WorldPlan,
}

#[derive(Debug, Serialize, Deserialize)]
struct TickRecord {
    /// With all digits, so that they round to the same `f32`.
    actions: Vec<[f64; ACTION]>,
    by: Vec<ActionSource>,
}

/// State of a flight, as the last line of the log has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorldSummary {
    /// Control ticks that were flown.
    pub ticks: u64,
    /// Number of ticks in which each drone's pilot was late.
    pub late: Vec<u64>,
    /// Values by the names of [`crazyflie_env::vector::METRICS`].
    pub metrics: BTreeMap<String, f32>,
    pub(crate) over: bool,
    /// Hash of all states and observations, see `WorldFlight::hash`.
    pub sha256: String,
}

/// A line of the log.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum LogLine {
    End(WorldSummary),
    Tick(TickRecord),
}

#[derive(Debug, thiserror::Error)]
pub enum LogError {
    #[error("line {line}: {problem}")]
    Line { line: usize, problem: String },
    #[error("the log has no last line: it was cut off")]
    Cut,
}

/// Replay of a log, with both summaries.
#[derive(Debug, Serialize)]
pub struct WorldReplay {
    /// Name of the world on its server.
    pub world: String,
    /// Name of the task that was flown.
    pub mission: String,
    /// Drones of the world, piloted or not.
    pub drones: usize,
    /// The summary in the log.
    #[serde(rename = "told")]
    pub logged: WorldSummary,
    /// The summary of the flight now.
    #[serde(rename = "flown")]
    pub replayed: WorldSummary,
}

impl WorldLog {
    pub(crate) fn new(world: &str, plan: &WorldPlan, flight: &WorldFlight) -> WorldLog {
        let drones = flight.drones();
        let head = LogHeader {
            format: FORMAT.into(),
            program: concat!("crazyflie ", env!("CARGO_PKG_VERSION")).into(),
            world: world.into(),
            drones,
            tick_s: flight.tick_s(),
            plan: plan.clone(),
        };
        let (late, figures) = (vec![0; drones], WorldFigures::new(drones));
        WorldLog { head, actions: Vec::new(), by: Vec::new(), late, figures }
    }

    /// Memory of the log of a world with this many drones and steps.
    pub(crate) fn bytes(drones: usize, steps: u32) -> usize {
        drones
            .saturating_mul(steps as usize)
            .saturating_mul(size_of::<[f32; ACTION]>() + size_of::<ActionSource>())
    }

    /// Adds the tick that `flight` has just flown.
    pub(crate) fn push(&mut self, flight: &WorldFlight, by: &[ActionSource]) {
        self.actions.extend(flight.batch.actions.as_chunks::<ACTION>().0);
        self.by.extend(by);
        count(&mut self.late, by);
        self.figures.add(flight, by);
    }

    /// Copies the part that begins at tick `from` of the first `ticks`, as many as make about so many bytes of text.
    pub(crate) fn part(&self, from: usize, bytes: usize, ticks: u64) -> LogPart {
        let n = self.head.drones;
        let ticks = ticks as usize;
        let to = ticks.min(from + (bytes / (n * DRONE_TEXT)).max(1));
        LogPart {
            head: (from == 0).then(|| self.head.clone()),
            drones: n,
            actions: self.actions[from * n..to * n].into(),
            by: self.by[from * n..to * n].into(),
            next: (to < ticks).then_some(to),
        }
    }
}

impl LogPart {
    /// Its lines; the summary ends the last part.
    ///
    /// # Errors
    /// The errors of serde, for numbers that JSON cannot represent.
    pub(crate) fn text(&self, end: &WorldSummary) -> serde_json::Result<String> {
        let mut text = String::new();
        let mut line = |value: serde_json::Result<String>| {
            text += &value?;
            text.push('\n');
            Ok(())
        };
        if let Some(head) = &self.head {
            line(serde_json::to_string(head))?;
        }
        for (actions, by) in self.actions.chunks(self.drones).zip(self.by.chunks(self.drones)) {
            let actions = actions.iter().map(|action| action.map(f64::from)).collect();
            line(serde_json::to_string(&TickRecord { actions, by: by.into() }))?;
        }
        if self.next.is_none() {
            line(serde_json::to_string(end))?;
        }
        Ok(text)
    }
}

fn count(late: &mut [u64], by: &[ActionSource]) {
    late.iter_mut().zip(by).for_each(|(late, by)| *late += u64::from(*by == ActionSource::Late));
}

impl WorldSummary {
    pub(crate) fn from_flight(flight: &WorldFlight, late: &[u64]) -> WorldSummary {
        let metrics = flight.metrics().map(|(name, value)| (name.to_owned(), value)).collect();
        WorldSummary {
            ticks: flight.ticks,
            late: late.into(),
            metrics,
            over: flight.is_over(),
            sha256: flight.hash(),
        }
    }
}

/// Replays a log.
///
/// # Errors
/// An error with the line that is not as it should be.
pub fn replay_log(text: &str) -> Result<WorldReplay, LogError> {
    let mut lines = text.lines().enumerate().map(|(i, text)| (i + 1, text));
    let problem = |line, problem: String| LogError::Line { line, problem };
    let (_, first) = lines.next().ok_or(LogError::Cut)?;
    let head: LogHeader =
        serde_json::from_str(first).map_err(|e| problem(1, format!("expected the plan of a world: {e}")))?;
    if head.format != FORMAT {
        return Err(problem(1, format!("the format is {:?}, expected {FORMAT:?}", head.format)));
    }
    let mut flight = WorldFlight::new(&head.plan).map_err(|e| problem(1, e.to_string()))?;
    let mut late = vec![0; flight.drones()];
    for (line, text) in lines {
        match serde_json::from_str(text)
            .map_err(|_| problem(line, "expected actions and by of every drone, or the end".into()))?
        {
            LogLine::Tick(tick) => {
                let actions: Vec<_> =
                    tick.actions.iter().map(|action| action.map(|number| number as f32)).collect();
                flight.step_with(&actions).map_err(|e| problem(line, e.to_string()))?;
                count(&mut late, &tick.by);
            }
            LogLine::End(logged) => {
                return Ok(WorldReplay {
                    world: head.world,
                    mission: head.plan.mission,
                    drones: flight.drones(),
                    logged,
                    replayed: WorldSummary::from_flight(&flight, &late),
                });
            }
        }
    }
    Err(LogError::Cut)
}
