//! Controllers where the vehicle is what they believe, where it is drawn anew in every flight, and where
//! something is wrong that none was told of.

use crazyflie_control::ControllerSpec;
use crazyflie_env::config::EffectTable;

use super::baselines::evaluate;
use super::error::Result;
use super::scenario::Scenario;
use crazyflie_server::flight::{Trace, TraceRow};

/// Effects that are added to those of a scenario.
#[derive(Debug)]
pub struct Condition {
    /// Key in tables.
    pub name: &'static str,
    /// Description for users.
    pub about: &'static str,
    effects: &'static str,
}

/// The ground effect of all conditions: coefficient fitted on small quadrotors (see `crazyflie effects`).
pub const CONDITIONS: [Condition; 3] = [
    Condition {
        name: "nominal",
        about: "the scenario as declared, with ground effect",
        effects: r#"{"ground_effect": {"coefficient": 9}}"#,
    },
    Condition {
        name: "randomised",
        about: "mass, thrust, attitude gain, drag, gusts and command delay drawn for every flight",
        effects: r#"{"ground_effect": {"coefficient": {"uniform": [0, 14]}}, "mass_change": {"uniform": [-0.002, 0.004]},
            "thrust_scale": {"uniform": [0.93, 1.07]}, "attitude_gain": {"uniform": [0.8, 1.2]}, "drag_linear": {"uniform": [0, 0.6]},
            "gust": {"sigma_mps2": {"uniform": [0, 0.4]}, "tau_s": 1}, "cmd_delay": {"uniform": [0, 0.03]}}"#,
    },
    Condition {
        name: "undeclared",
        about: "a centre of mass off centre, of which no controller is told and no randomisation knows",
        effects: r#"{"ground_effect": {"coefficient": 9}, "com_offset": {"roll_deg": 2.5, "pitch_deg": -2}}"#,
    },
];

/// Result of one controller in one scenario under one condition.
#[derive(Debug, Clone, serde::Serialize)]
pub struct RobustnessRow {
    /// The controller's label.
    pub controller: String,
    /// Name and version.
    pub scenario: String,
    /// One of [`CONDITIONS`].
    pub condition: &'static str,
    /// As the benchmark scores: median, times the share of flights that did not fail.
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
    /// Of the first flight, at every tick: time, and distance to the set-point, at most 1.2 m.
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

impl Condition {
    pub(super) fn table(&self) -> EffectTable {
        // a test reads them all
        serde_json::from_str(self.effects).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_condition_is_in_range_and_flies() {
        for condition in &CONDITIONS {
            let table: EffectTable = serde_json::from_str(condition.effects).unwrap();
            crazyflie_env::effects::check_effects(&table).unwrap();
            Scenario::with_effects("fly-80cm", table).unwrap();
        }
    }
}
