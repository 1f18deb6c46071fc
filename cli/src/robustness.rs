//! Controllers where the vehicle is what they believe, where it is drawn anew in every flight, and where
//! something is wrong that none was told of.

use crazyflie_control::ControllerSpec;
use crazyflie_env::config::EffectTable;
use crazyflie_picture::{PALETTE, Panel, PictureError, Series, Style, chart};

use crazyflie_server::bench::baselines::evaluate;
use crazyflie_server::bench::{Error, Scenario};
use crazyflie_server::flight::{Trace, TraceRow};

/// Effects that are added to those of a scenario.
pub(crate) struct Condition {
    pub name: &'static str,
    pub about: &'static str,
    effects: &'static str,
}

/// The ground effect of all conditions: coefficient fitted on small quadrotors (see `crazyflie effects`).
pub(crate) const CONDITIONS: [Condition; 3] = [
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
pub(crate) struct RobustnessRow {
    pub controller: String,
    pub scenario: String,
    pub condition: &'static str,
    /// As the benchmark scores: median, times the share of flights that did not fail, with the 95 % interval.
    pub score: f64,
    pub low: f64,
    pub high: f64,
    pub failed: usize,
    pub flights: usize,
    /// Medians over the flights that did not fail.
    pub rmse_m: Option<f64>,
    pub overshoot_m: Option<f64>,
    pub settled: usize,
    pub settling_s: Option<f64>,
    /// Of the first flight, at every tick: time, and distance to the set-point.
    #[serde(skip)]
    pub first: [Vec<f64>; 2],
}

/// Flies every controller in every scenario under every condition, with the same seeds; `done` is called
/// after each.
///
/// # Errors
/// Those of the benchmark.
pub(crate) fn compare(
    controllers: &[ControllerSpec],
    scenarios: &[String],
    seeds: &[u64],
    done: &dyn Fn(),
) -> Result<Vec<RobustnessRow>, Error> {
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
) -> Result<RobustnessRow, Error> {
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
    fn table(&self) -> EffectTable {
        // a test reads them all
        serde_json::from_str(self.effects).unwrap_or_default()
    }
}

/// Per scenario: scores with their intervals, and the first nominal flight; a colour per controller.
///
/// # Errors
/// Those of drawing.
pub(crate) fn picture(lines: &[RobustnessRow]) -> Result<String, PictureError> {
    let controllers = names(lines, |l| &l.controller);
    let scenarios: Vec<(&str, Vec<ScoreCurve>)> = names(lines, |l| &l.scenario)
        .into_iter()
        .map(|scenario| {
            (scenario, controllers.iter().enumerate().map(|(i, c)| curve(lines, scenario, c, i)).collect())
        })
        .collect();
    let panels: Vec<Panel> = scenarios
        .iter()
        .flat_map(|(scenario, curves)| [scores(scenario, &controllers, curves), flights(scenario, lines)])
        .collect();
    chart(
        &panels,
        2,
        "Score and 95 % interval: 1 nominal, 2 randomised, 3 undeclared effect; beside it the first nominal flight",
    )
}

/// Distances over time.
fn flights<'a>(scenario: &'a str, lines: &'a [RobustnessRow]) -> Panel<'a> {
    let nominal = lines
        .iter()
        .filter(|l| l.scenario == scenario && l.condition == CONDITIONS[0].name && !l.first[0].is_empty());
    let series = nominal.enumerate().map(|(i, l)| Series {
        label: &l.controller,
        x: &l.first[0],
        y: &l.first[1],
        style: Style::Solid,
        color: PALETTE[i % PALETTE.len()],
    });
    Panel {
        title: scenario,
        x_label: "time (s)",
        y_label: "distance to the set-point (m)",
        series: series.collect(),
        ..Panel::default()
    }
}

/// Points of one controller, and its intervals from below to above.
struct ScoreCurve {
    x: Vec<f64>,
    y: Vec<f64>,
    intervals: Vec<([f64; 2], [f64; 2])>,
}

fn names<'a>(lines: &'a [RobustnessRow], name_of: impl Fn(&'a RobustnessRow) -> &'a String) -> Vec<&'a str> {
    let mut all: Vec<&str> = Vec::new();
    for name in lines.iter().map(name_of).map(String::as_str) {
        if !all.contains(&name) {
            all.push(name);
        }
    }
    all
}

fn curve(lines: &[RobustnessRow], scenario: &str, controller: &str, place: usize) -> ScoreCurve {
    let own: Vec<&RobustnessRow> =
        lines.iter().filter(|l| l.scenario == scenario && l.controller == controller).collect();
    // side by side, so that intervals can be told apart
    let x: Vec<f64> = (0..own.len()).map(|i| 1.0 + i as f64 + 0.04 * place as f64).collect();
    let intervals = x.iter().zip(&own).map(|(x, l)| ([*x, *x], [l.low, l.high])).collect();
    ScoreCurve { y: own.iter().map(|l| l.score).collect(), x, intervals }
}

fn scores<'a>(scenario: &'a str, controllers: &[&'a str], curves: &'a [ScoreCurve]) -> Panel<'a> {
    let mut series = Vec::new();
    for (i, (label, curve)) in controllers.iter().zip(curves).enumerate() {
        let color = PALETTE[i % PALETTE.len()];
        let all = curve.intervals.iter().map(|(x, y)| Series { label: "", x, y, style: Style::Solid, color });
        series.extend(all);
        series.push(Series { label, x: &curve.x, y: &curve.y, style: Style::Dashed, color });
    }
    Panel { title: scenario, x_label: "condition", y_label: "score", series, ..Panel::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_condition_is_in_range_and_flies() {
        for condition in &CONDITIONS {
            let table: EffectTable = serde_json::from_str(condition.effects).unwrap();
            crazyflie_env::config::check_effects(&table).unwrap();
            Scenario::with_effects("fly-80cm", table).unwrap();
        }
    }
}
