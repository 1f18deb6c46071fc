//! A flight log from the page beside its model: what was measured, what the model predicts, and how well both agree.

use crazyflie_env::model::Model;
use crazyflie_identify::motor::carried::other_motors;
use crazyflie_identify::replay::{HoverSource, Replay, ReplayOptions, SIGNALS, replay};
use crazyflie_logs::inspect::{Finding, Grade};
use crazyflie_logs::{FlightLog, LogError, ReadOptions};
use serde::Deserialize;
use serde_json::{Value, json};

/// A flight of an hour at 100 Hz with 10 columns is about 32 MiB of text.
const LIMIT_MIB: u64 = 32;
/// The battery of a Crazyflie lasts seven minutes.
const LONGEST_S: f64 = 3600.0;
/// Rows of the answer are so far apart, in a long flight farther.
const TICK_S: f64 = 0.02;
const MOST_ROWS: f64 = 20_000.0;

/// Choices for the replay of a log.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LogQuery {
    /// Name of the file, for messages.
    file: Option<String>,
    /// A vehicle's name; the thesis's unless given.
    vehicle: Option<String>,
    /// The model starts again from the measurement after so many seconds; never unless given.
    horizon_s: Option<f64>,
    /// The PWM that carries the vehicle: a number, or `auto` for the median command.
    hover_pwm: Option<String>,
    /// Number of the flight in a file of several.
    part: Option<usize>,
    /// Goes on with grave findings.
    #[serde(default)]
    anyway: bool,
}

/// Why a log was not replayed.
#[derive(Debug)]
pub(crate) enum Problem {
    /// A choice is wrong.
    Query(String),
    /// The log cannot be read or replayed.
    Log(String),
    /// Signs, units or clocks are wrong, with the cures.
    Grave(Vec<Finding>),
    /// Nobody waits for the answer any more.
    Gone,
}

impl LogQuery {
    /// Reads the log and replays it. It ends early if `is_gone`.
    ///
    /// # Errors
    /// [`Problem`].
    pub(crate) fn answer(&self, bytes: &[u8], is_gone: impl Fn() -> bool) -> Result<Value, Problem> {
        let query = |error: &dyn ToString| Problem::Query(error.to_string());
        let model = self.vehicle.as_deref().map_or_else(|| Ok(Model::thesis()), Model::parse);
        let model = model.map_err(|e| query(&e))?;
        let hover = self.hover_pwm.as_ref().map_or(Ok(HoverSource::OfModel), |text| text.parse());
        let hover = hover.map_err(|e| query(&format!("hover_pwm: {e}")))?;
        let unless_gone = || if is_gone() { Err(Problem::Gone) } else { Ok(()) };
        unless_gone()?;
        let (part, anyway, limit_mib) = (self.part, self.anyway, Some(LIMIT_MIB));
        let options = ReadOptions { part, anyway, limit_mib, ..ReadOptions::default() };
        let file = self.file.as_deref().unwrap_or("the log");
        let log = FlightLog::open_bytes(file, bytes, &options).map_err(|error| match error {
            LogError::Grave { findings, .. } => Problem::Grave(findings),
            other => Problem::Log(other.to_string()),
        })?;
        let ends = [log.airborne.start, log.airborne.end.saturating_sub(1)].map(|row| log.t_s.get(row));
        if let [Some(from_s), Some(to_s)] = ends
            && to_s - from_s > LONGEST_S
        {
            let flight_s = to_s - from_s;
            let problem = format!("the flight lasts {flight_s:.0} s, expected at most {LONGEST_S:.0} s");
            return Err(Problem::Log(problem));
        }
        unless_gone()?;
        let plan = ReplayOptions { horizon_s: self.horizon_s, hover, ..ReplayOptions::default() };
        let run = replay(&model, &log, &plan).map_err(|e| Problem::Log(e.to_string()))?;
        unless_gone()?;
        let mut findings = log.findings();
        findings.extend(other_motors(&model, None, &[&log]).map(|other| Finding {
            grade: Grade::Warning,
            text: other.to_string(),
            cure: None,
        }));
        let (format, run_summary) = (log.provenance.title(), run.summary(self.horizon_s));
        let [tick_s, measured, model_rows] = rows(&run);
        let columns: Vec<&str> = SIGNALS.iter().map(|signal| signal.name).collect();
        Ok(
            json!({"vehicle": model.name, "format": format, "findings": findings, "replay": run_summary, "tick_s": tick_s,
            "columns": columns, "measured": measured, "model": model_rows}),
        )
    }
}

/// The tick of the answer, and the measured and the predicted signals at each, SI and radians.
fn rows(run: &Replay) -> [Value; 3] {
    let span_s = run.end_s - run.start_s;
    let tick_s = TICK_S.max(span_s / MOST_ROWS);
    let times_s = (0..=(span_s / tick_s) as usize).map(|tick| run.start_s + tick as f64 * tick_s);
    // a tenth of a millimetre: no measurement is finer
    let rounded = |value: f64| (1e4 * value).round() / 1e4;
    let row = |t_s| run.signals.each_ref().map(|signal| signal.values_at(t_s).map(rounded));
    let pairs: Vec<_> = times_s.map(row).collect();
    let of = |which: usize| pairs.iter().map(|row| row.map(|pair| pair[which])).collect::<Vec<_>>();
    [json!(tick_s), json!(of(0)), json!(of(1))]
}
