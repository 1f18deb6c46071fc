//! An explanation for machines. A value that is not a number is null.

use std::collections::BTreeMap;

use crazyflie_identify::explain::errors::{AXES, COMPONENTS, ErrorTable, ErrorsByComponent, HORIZONS};
use crazyflie_identify::explain::signals::SignalVerdict;
use crazyflie_identify::explain::verdict::{Explanation, Finding};
use crazyflie_identify::fit::filter::{Disturbances, GaussMarkov};
use crazyflie_identify::vehicle::shared_trims;
use serde::Serialize;
use serde_json::{Value, json};

use super::next::next_of_signal;
use super::signal_view::left_cells;
use super::view::{self, estimated_param};
use super::{Run, next_steps, sentence};

/// Keys of the predicted quantities, in the order of the errors' tables.
const QUANTITIES: [&str; 3] = ["position_m", "velocity_mps", "attitude_rad"];

/// Key of an axis of the errors, with the unit last.
pub(super) fn axis_key(axis: usize) -> String {
    key(AXES[axis])
}

/// Key of a component of the errors.
pub(super) fn component_key(component: usize) -> String {
    key(COMPONENTS[component])
}

fn key((name, unit): (&str, &str)) -> String {
    format!("{}_{}", name.replace(' ', "_"), unit.replace("m/s", "mps"))
}

/// Returns the object that is printed and saved beside the page; `files` are those written.
pub(crate) fn as_json(run: &Run, files: &Value) -> Value {
    let explanation = &run.found;
    let [before, after] = explanation.disturbances.map(|d| disturbances(&d));
    let names = |flights: &super::Flights| flights.sources.iter().map(|s| s.file.clone()).collect::<Vec<_>>();
    let mut written = json!({"fit": names(&run.fit), "test": names(&run.test)});
    if let (Some(all), Some(more)) = (written.as_object_mut(), files.as_object()) {
        all.extend(more.clone());
    }
    json!({
        "verdict": explanation.verdict.name(),
        "sentence": sentence(explanation),
        "foreign_model": run.foreign_model(),
        "model": run.model.name,
        "vertical": run.vertical().name(),
        "effects": explanation.effects.iter().map(effect).collect::<Vec<_>>(),
        "signals": signals(run),
        "totals": super::totals(run).iter().map(|(path, value, stderr, unit)| json!({"number": path, "value": value, "stderr": stderr, "unit": unit})).collect::<Vec<_>>(),
        "shared_trims": shared_trims(&run.model, &run.trims),
        "partial": explanation.partial.iter().map(effect).collect::<Vec<_>>(),
        "corrections": explanation.corrections.iter().map(effect).collect::<Vec<_>>(),
        "confirmed": explanation.confirmed.iter().map(effect).collect::<Vec<_>>(),
        "needless": explanation.needless,
        "withdrawn": explanation.withdrawn,
        "numbers": explanation.numbers,
        "learned": explanation.learned,
        "error": error(run),
        "closed_loop": run.closed_loop.map(|(controller, [before, after])| json!({"controller": controller.name(), "before": before, "after": after})),
        "leftover": explanation.leftover,
        "not_excited": not_excited(explanation),
        "disturbances": {"before": before, "after": after},
        "next": next_steps(run),
        "path": explanation.path,
        "files": written,
        "seconds": explanation.seconds,
    })
}

fn effect(effect: &Finding) -> Value {
    let params = effect.params.iter().map(|p| {
        (p.name, json!({"value": p.value, "stderr": p.stderr, "unit": p.unit, "declared": p.declared}))
    });
    json!({"name": effect.name, "params": params.collect::<BTreeMap<_, _>>(), "confusable_with": effect.confusable_with,
        "manoeuvre": effect.manoeuvre, "worth": {"fit": effect.worth_fit, "test": effect.worth_test},
        "with": effect.with.iter().map(self::effect).collect::<Vec<_>>()})
}

/// The verdicts on signals, with what is left by axis and what to do next.
fn signals(run: &Run) -> Vec<Value> {
    let signal = |verdict: &SignalVerdict| {
        let after = &run.found.errors.components.after;
        let left = left_cells(&run.found, verdict.signal).into_iter();
        let left = left.map(|(row, h)| (component_key(row), json!({HORIZONS[h]: after[row][h]})));
        let mut value = json!(verdict);
        value["left_by_axis"] = left.collect();
        value["next"] = json!(next_of_signal(run, verdict));
        value
    };
    run.found.signals.iter().map(signal).collect()
}

/// Numbers by name and horizon.
fn by_horizon<T: Serialize>(names: impl Iterator<Item = String>, table: &[[T; 5]]) -> Value {
    let rows = table.iter().map(|row| HORIZONS.iter().zip(row).collect::<BTreeMap<_, _>>());
    json!(names.zip(rows).collect::<BTreeMap<_, _>>())
}

/// Errors by quantity, by axis under keys that end in the unit, by component and by flight.
fn error(run: &Run) -> Value {
    let errors = &run.found.errors;
    let mut all = table(&errors.quantities, QUANTITIES.map(str::to_owned));
    all["axes"] = table(&errors.axes, std::array::from_fn(axis_key));
    all["components"] = components(&errors.components);
    all["flights"] = json!(flights(run));
    all
}

fn table<const ROWS: usize>(errors: &ErrorTable<ROWS>, names: [String; ROWS]) -> Value {
    let rows = |table: &[[f64; 5]; ROWS]| by_horizon(names.iter().cloned(), table);
    json!({"before": rows(&errors.before), "after": rows(&errors.after), "naive": rows(&errors.naive),
        "p_value": rows(&errors.p_value), "stretches": by_horizon(names.iter().cloned(), &errors.stretches)})
}

fn components(errors: &ErrorsByComponent) -> Value {
    let table = |t: &[[f64; 5]; 9]| by_horizon((0..COMPONENTS.len()).map(component_key), t);
    json!({"before": table(&errors.before), "after": table(&errors.after)})
}

/// Errors of each test flight alone.
fn flights(run: &Run) -> Vec<Value> {
    let flight = |(source, errors): (&super::FlightSource, &ErrorsByComponent)| {
        let mut value = components(errors);
        value["name"] = json!(source.name);
        value
    };
    run.test.sources.iter().zip(&run.found.errors.flights).map(flight).collect()
}

/// Effects that the flights could not have shown. No standard error: without a slope at "off", only trial
/// fits spoke of it.
fn not_excited(found: &Explanation) -> Vec<Value> {
    let entry = |(name, stderr): (&'static str, f64)| {
        let param = estimated_param(name).map(|(_, param)| param);
        json!({"name": name, "param": param.map(|p| p.name), "stderr": stderr, "unit": param.map(|p| p.unit)})
    };
    view::not_excited(found).map(entry).collect()
}

fn disturbances(d: &Disturbances) -> Value {
    let wander = |w: GaussMarkov, unit: &str| json!({"sigma": w.sigma, "unit": unit, "tau_s": w.tau_s});
    json!({"force": wander(d.force, "m/s^2"), "lift": wander(d.lift, "m/s^2"), "torque": wander(d.torque, "rad/s^2"), "turn": wander(d.turn, "rad/s^2"),
        "marker": wander(d.marker, "m")})
}
