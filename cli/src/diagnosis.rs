//! A diagnosis in words, as figures and as a picture.

use std::fmt::Write;

use crazyflie_identify::diagnose::demand::{DEMAND, EffectDemand};
use crazyflie_identify::diagnose::fault::{Fault, FaultFit, look_alikes, side_of};
use crazyflie_identify::diagnose::swing::frequencies_hz;
use crazyflie_identify::diagnose::{Diagnosis, DiagnosisVerdict, SetUp};
use crazyflie_picture::{BLUE, Drawing, PURPLE, Panel, PictureError, Style, VERMILION, chart};
use serde_json::{Value as Json, json};

use crate::text::{Table, number};

/// The verdict in one sentence.
pub(crate) fn verdict_text(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    match &diagnosis.verdict {
        DiagnosisVerdict::TooFew { .. } => {
            "too few normal flights to say how far set-ups differ: three flights at least, better of several set-ups".into()
        }
        DiagnosisVerdict::Nothing => "nothing beyond what set-ups differ by".into(),
        DiagnosisVerdict::Unnamed => {
            "something that cannot be named: more than set-ups differ by, and no fault asks the same of the motors".into()
        }
        DiagnosisVerdict::SlungLoad { line, length_m } => format!(
            "slung load: a swing at {} Hz, {} times as strong as in normal flights, of a thread of {} m",
            number(line.frequency_hz, 2),
            number(line.ratio, 1),
            number(*length_m, 2)
        ),
        DiagnosisVerdict::Fault(fit) => {
            let mut others: Vec<String> = diagnosis.alternatives.iter().map(|a| a.fault.description(a.stderr)).collect();
            if matches!(fit.fault, Fault::AddedWeight { .. }) {
                others.extend(look_alikes(demands).into_iter().map(|name| format!("`{name}`")));
            }
            let or = if others.is_empty() { String::new() } else { format!("; or as well {}", others.join("; ")) };
            fit.fault.description(fit.stderr) + &or
        }
    }
}

fn percent(share: f64) -> String {
    let sign = if share < 0.0 { "" } else { "+" };
    format!("{sign}{} %", number(100.0 * share, 1))
}

/// Changes by set-up, with the named fault fitted to each alone.
pub(crate) fn changes_table(diagnosis: &Diagnosis) -> Table {
    let header: Vec<&str> = ["set-up", "flights"].into_iter().chain(DEMAND).chain(["fitted alone"]).collect();
    let mut table = Table::new(&header).left(&[6]);
    let row = |side: &str, s: &SetUp| {
        let alone = s.fault.as_ref().map_or(String::new(), |f| f.fault.description(f.stderr));
        let mut cells = vec![format!("{side} {}", s.name), s.flights.to_string()];
        cells.extend(s.change.iter().map(|c| percent(*c)));
        cells.push(alone);
        cells
    };
    diagnosis.normal.iter().for_each(|s| table.row(row("normal", s)));
    diagnosis.suspect.iter().for_each(|s| table.row(row("suspect", s)));
    let mut all = vec!["all suspects, in standard deviations".to_owned(), String::new()];
    all.extend(diagnosis.z.iter().map(|z| number(*z, 1)));
    all.push(String::new());
    table.row(all);
    table
}

/// Derivation of the verdict.
fn method(diagnosis: &Diagnosis) -> String {
    let [thrust, yaw, swing] = diagnosis.p_values;
    let sd: Vec<String> = diagnosis
        .standard_deviations
        .iter()
        .map(|s| percent(*s).trim_start_matches('+').to_owned())
        .collect();
    let mut text = format!(
        "Demand by {}, in shares of the hover thrust, against the normal mean. A new normal set-up differs by {} (thrust, roll, pitch, yaw; \
         standard deviations with {}, {} degrees of freedom for thrust and yaw). Chances times three looks: thrust {}, yaw {}, swing {}; \
         an alarm below 0.05.\n",
        diagnosis.source.description(),
        sd.join(", "),
        number(diagnosis.freedom[0], 1),
        number(diagnosis.freedom[3], 1),
        number(thrust, 3),
        number(yaw, 3),
        number(swing, 3),
    );
    let _ = match diagnosis.normal_alarms {
        Some([alarms, tried]) => {
            writeln!(text, "Each normal set-up against the others: {alarms} of {tried} raise an alarm.")
        }
        None => writeln!(
            text,
            "One normal set-up only: how far set-ups differ is taken from how its flights do, which may be less."
        ),
    };
    for line in &diagnosis.left_out {
        let _ = writeln!(text, "Left out: {line}.");
    }
    text
}

pub(crate) fn as_text(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    format!(
        "{}\n\n{}\n{}",
        verdict_text(diagnosis, demands),
        changes_table(diagnosis).plain(),
        method(diagnosis)
    )
}

pub(crate) fn as_markdown(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    format!(
        "# Diagnosis\n\n**{}**\n\n{}\n{}\n![Trims](trims.svg)\n",
        verdict_text(diagnosis, demands),
        changes_table(diagnosis).markdown(),
        method(diagnosis)
    )
}

fn fault_json(fit: &FaultFit) -> Json {
    match &fit.fault {
        Fault::AddedWeight { mass_kg, left, front } => {
            json!({"effect": "mass_change", "added_kg": mass_kg, "stderr_kg": fit.stderr,
            "left": left, "front": front, "side": side_of(*left, *front), "misfit": fit.misfit})
        }
        Fault::WeakMotor { motor, loss } => {
            json!({"effect": "weak_motor", "motor": motor, "loss": loss, "stderr": fit.stderr, "misfit": fit.misfit})
        }
    }
}

pub(crate) fn as_json(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> Json {
    let (kind, details) = match &diagnosis.verdict {
        DiagnosisVerdict::TooFew { freedom } => ("too_few", json!({"degrees_of_freedom": freedom})),
        DiagnosisVerdict::Nothing => ("nothing", Json::Null),
        DiagnosisVerdict::Unnamed => ("unnamed", Json::Null),
        DiagnosisVerdict::SlungLoad { line, length_m } => {
            ("slung_load", json!({"frequency_hz": line.frequency_hz, "length_m": length_m}))
        }
        DiagnosisVerdict::Fault(fit) => match fit.fault {
            Fault::AddedWeight { .. } => ("added_weight", fault_json(fit)),
            Fault::WeakMotor { .. } => ("weak_motor", fault_json(fit)),
        },
    };
    let set_up = |s: &SetUp| json!({"name": s.name, "flights": s.flights, "change": s.change, "fault": s.fault.as_ref().map(fault_json)});
    // NaN, where nothing can be said, is null
    json!({
        "verdict": kind,
        "text": verdict_text(diagnosis, demands),
        "fault": details,
        "alternatives": diagnosis.alternatives.iter().map(fault_json).collect::<Vec<_>>(),
        "source": diagnosis.source.description(),
        "demands": DEMAND,
        "change": diagnosis.change,
        "z": diagnosis.z,
        "standard_deviations": diagnosis.standard_deviations,
        "degrees_of_freedom": diagnosis.freedom,
        "p_values": {"thrust": diagnosis.p_values[0], "yaw": diagnosis.p_values[1], "swing": diagnosis.p_values[2]},
        "swing": diagnosis.line.map(|l| json!({"frequency_hz": l.frequency_hz, "ratio": l.ratio, "p_value": l.p_value})),
        "swing_band_hz": [frequencies_hz().first(), frequencies_hz().last()],
        "normal": diagnosis.normal.iter().map(set_up).collect::<Vec<_>>(),
        "suspect": diagnosis.suspect.iter().map(set_up).collect::<Vec<_>>(),
        "normal_alarms": diagnosis.normal_alarms.map(|[alarms, tried]| json!({"alarms": alarms, "tried": tried})),
        "left_out": diagnosis.left_out,
    })
}

/// Changes by set-up: thrust against yaw, which tell faults, and roll against pitch, which tell where.
pub(crate) fn picture(diagnosis: &Diagnosis) -> Result<Drawing, PictureError> {
    let percent = |set_ups: &[SetUp], i: usize, sign: f64| {
        set_ups.iter().map(|s| 100.0 * sign * s.change[i]).collect::<Vec<f64>>()
    };
    let two_deviations =
        |i: usize| 200.0 * Some(diagnosis.standard_deviations[i]).filter(|s| s.is_finite()).unwrap_or(0.0);
    let angles = (0..=72).map(|k| f64::from(k) * std::f64::consts::TAU / 72.0);
    let panel = |title, [x_label, y_label]: [&str; 2], [i, j]: [usize; 2], sign: f64| {
        let (a, b) = (two_deviations(i), two_deviations(j));
        let [normal, suspect] = [&diagnosis.normal, &diagnosis.suspect]
            .map(|set_ups| (percent(set_ups, i, sign), percent(set_ups, j, 1.0)));
        let ellipse = (angles.clone().map(|t| a * t.cos()), angles.clone().map(|t| b * t.sin()));
        Panel::new(x_label, y_label)
            .title(title)
            .curve(Style::Dashed, PURPLE, "two standard deviations of a set-up", ellipse.0, ellipse.1)
            .curve(Style::Points, BLUE, "normal set-ups", normal.0, normal.1)
            .curve(Style::Points, VERMILION, "suspect set-ups", suspect.0, suspect.1)
    };
    let sides = ["roll, left or right (% of thrust)", "pitch, front or back (% of thrust)"];
    let panels = [
        panel("What is wrong", ["yaw (% of thrust)", "thrust (%)"], [3, 0], 1.0),
        // to the right is to the right, so that the picture lies as the vehicle does
        panel("Where", sides, [1, 2], -1.0),
    ];
    chart(&panels, 2, "Change of what hovering asks of the motors")
}
