//! Controllers on the vehicle that they assume, on vehicles drawn anew in every flight, and with faults unknown to
//! them.

use crazyflie_control::ControllerSpec;

use super::baselines::evaluate;
use super::conditions::CONDITIONS;
use super::error::Result;
use super::scenario::Scenario;
use crazyflie_server::flight::{Trace, TraceRow};

/// Result of one controller in one scenario under one condition.
#[derive(Debug, Clone, serde::Serialize)]
pub struct RobustnessRow {
    /// The controller's label.
    pub controller: String,
    /// Name and version.
    pub scenario: String,
    /// One of [`CONDITIONS`].
    pub condition: &'static str,
    /// Score of the benchmark: median, times the share of flights that did not fail.
    pub score: f64,
    /// Lower end of the score's 95 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Flights that failed.
    pub failed: usize,
    /// Flights in all.
    pub flights: usize,
    /// Median over the flights that did not fail, as the next ones.
    pub rmse_m: Option<f64>,
    /// Overshoot.
    pub overshoot_m: Option<f64>,
    /// Flights that settled.
    pub settled: usize,
    /// Settling time.
    pub settling_s: Option<f64>,
    /// The first flight, at every tick: time, and distance to the set-point, at most 1.2 m.
    #[serde(skip)]
    pub first: [Vec<f64>; 2],
}

/// Flies every controller in every scenario under every condition, with the same seeds; `done` is called
/// after each.
///
/// # Errors
/// Those of the benchmark.
pub fn compare(
    controllers: &[ControllerSpec],
    scenarios: &[String],
    seeds: &[u64],
    done: &dyn Fn(),
) -> Result<Vec<RobustnessRow>> {
    let mut lines = Vec::new();
    for scenario in scenarios {
        for condition in &CONDITIONS {
            let varied = Scenario::with_effects(scenario, condition.table())?;
            for controller in controllers {
                lines.push(line(controller, &varied, condition.name, seeds)?);
                done();
            }
        }
    }
    Ok(lines)
}

fn line(
    controller: &ControllerSpec,
    scenario: &Scenario,
    condition: &'static str,
    seeds: &[u64],
) -> Result<RobustnessRow> {
    let (judged, first) = evaluate(scenario, &controller.clone().into(), seeds)?;
    let (s, m) = (judged.score, judged.metrics);
    Ok(RobustnessRow {
        controller: controller.label.clone(),
        scenario: scenario.id(),
        condition,
        score: s.score,
        low: s.low,
        high: s.high,
        failed: s.failed,
        flights: s.episodes,
        rmse_m: m.rmse_m,
        overshoot_m: m.overshoot_m,
        settled: m.settled,
        settling_s: m.settling_s,
        first: first.as_ref().map(distance).unwrap_or_default(),
    })
}

/// Farther away is drawn as this far, so that the others can be seen.
const SHOWN_M: f64 = 1.2;

fn distance(trace: &Trace) -> [Vec<f64>; 2] {
    let shown = |row: &TraceRow| row.error_m().min(SHOWN_M);
    [(0..trace.rows.len()).map(|row| trace.t_s(row)).collect(), trace.rows.iter().map(shown).collect()]
}
