//! An explanation for machines. What is not a number is null.

use crazyflie_identify::explain::errors::{AXES, AxisErrors, AxisTable, HORIZONS, Table};
use crazyflie_identify::explain::verdict::{Explanation, Finding, Verdict};
use crazyflie_identify::fit::filter::{Disturbances, Wander};
use serde_json::{Map, Value, json};

use super::view::{self, measured};
use super::{Run, sentence};
use crate::cli::vertical_name;

/// Keys of the predicted quantities, in the order of the errors' tables.
const QUANTITIES: [&str; 3] = ["position_m", "velocity_mps", "attitude_rad"];

/// The object that is printed and stands beside the page; `files` are those written.
pub(crate) fn as_json(run: &Run, files: &Value) -> Value {
    let found = &run.found;
    let errors = &found.errors;
    let [before, after] = found.disturbances.map(|d| disturbances(&d));
    let names = |flights: &super::Flights| flights.sources.iter().map(|s| s.file.clone()).collect::<Vec<_>>();
    let mut written = json!({"fit": names(&run.fit), "test": names(&run.test)});
    if let (Some(all), Some(more)) = (written.as_object_mut(), files.as_object()) {
        all.extend(more.clone());
    }
    json!({
        "verdict": verdict_name(found.verdict),
        "sentence": sentence(found),
        "foreign_hover_pwm": run.foreign_hover_pwm().map(|[flown, model]| json!({"flown": flown, "model": model})),
        "model": run.model.name,
        "vertical": vertical_name(run.vertical()),
        "effects": found.effects.iter().map(effect).collect::<Vec<_>>(),
        "signals": found.signals,
        "totals": super::totals(run).iter().map(|(path, value, stderr, unit)| json!({"number": path, "value": value, "stderr": stderr, "unit": unit})).collect::<Vec<_>>(),
        "partial": found.partial.iter().map(effect).collect::<Vec<_>>(),
        "confirmed": found.confirmed.iter().map(effect).collect::<Vec<_>>(),
        "needless": found.needless,
        "numbers": found.numbers,
        "foreign": found.foreign,
        "learned": found.learned,
        "error": {"before": table(&errors.before), "after": table(&errors.after), "naive": table(&errors.naive), "p_value": table(&errors.p_value),
            "axes": axes(&errors.axes)},
        "closed_loop": run.closed_loop.map(|(controller, [before, after])| json!({"controller": controller.name(), "before": before, "after": after})),
        "leftover": found.leftover,
        "not_excited": not_excited(found),
        "disturbances": {"before": before, "after": after},
        "path": found.path,
        "files": written,
        "seconds": found.seconds,
    })
}

pub(crate) fn verdict_name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Explained => "explained",
        Verdict::PartlyExplained => "partly_explained",
        Verdict::NothingMissing => "nothing_missing",
        Verdict::Unexplained => "unexplained",
        Verdict::NotDecidable => "not_decidable",
    }
}

fn effect(effect: &Finding) -> Value {
    let params = effect
        .params
        .iter()
        .map(|p| (p.name.to_owned(), json!({"value": p.value, "stderr": p.stderr, "unit": p.unit, "declared": p.declared})));
    json!({"name": effect.name, "params": params.collect::<Map<_, _>>(), "confusable_with": effect.confusable_with,
        "manoeuvre": effect.manoeuvre, "worth": {"fit": effect.worth_fit, "test": effect.worth_test},
        "with": effect.with.iter().map(self::effect).collect::<Vec<_>>()})
}

fn table(table: &Table) -> Value {
    let row = |row: &[f64; 5]| HORIZONS.iter().zip(row).map(|(name, v)| ((*name).to_owned(), json!(v))).collect::<Map<_, _>>();
    QUANTITIES.iter().zip(table).map(|(name, values)| ((*name).to_owned(), Value::Object(row(values)))).collect::<Map<_, _>>().into()
}

/// Errors by axis, under keys that end in the unit.
fn axes(errors: &AxisErrors) -> Value {
    let key = |(name, unit): &(&str, &str)| format!("{}_{}", name.replace(' ', "_"), unit.replace("m/s", "mps"));
    let row = |row: &[f64; 5]| HORIZONS.iter().zip(row).map(|(name, v)| ((*name).to_owned(), json!(v))).collect::<Map<_, _>>();
    let table = |t: &AxisTable| AXES.iter().zip(t).map(|(axis, values)| (key(axis), Value::Object(row(values)))).collect::<Map<_, _>>();
    json!({"before": table(&errors.before), "after": table(&errors.after), "naive": table(&errors.naive), "p_value": table(&errors.p_value)})
}

/// Effects that the flights could not have shown. No standard error: without a slope at "off", only trial fits spoke of it.
fn not_excited(found: &Explanation) -> Vec<Value> {
    let one = |(name, stderr): (&'static str, f64)| {
        let param = measured(name).map(|(_, param)| param);
        json!({"name": name, "param": param.map(|p| p.name), "stderr": stderr, "unit": param.map(|p| p.unit)})
    };
    view::not_excited(found).map(one).collect()
}

fn disturbances(d: &Disturbances) -> Value {
    let of = |w: Wander, unit: &str| json!({"sigma": w.sigma, "unit": unit, "tau_s": w.tau_s});
    json!({"force": of(d.force, "m/s^2"), "lift": of(d.lift, "m/s^2"), "torque": of(d.torque, "rad/s^2"), "turn": of(d.turn, "rad/s^2"),
        "marker": of(d.marker, "m")})
}
