//! A diagnosis in words, as figures and as a picture.

use std::fmt::Write;

use crazyflie_identify::diagnose::demand::{DEMAND, EffectDemand};
use crazyflie_identify::diagnose::fault::{Fault, FaultFit, look_alikes, side_of};
use crazyflie_identify::diagnose::swing::frequencies_hz;
use crazyflie_identify::diagnose::{ALARM_ODDS, Diagnosis, DiagnosisVerdict, SWING_RATE, SetUp};
use crazyflie_picture::{BLUE, Drawing, PURPLE, Panel, PictureError, Style, VERMILION, chart};
use serde_json::{Value as Json, json};

use crate::text::{Table, number};

/// The verdict in one sentence.
pub(crate) fn verdict_text(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    let smallest = diagnosis.smallest;
    let shares = [smallest.motor_loss, smallest.beside, smallest.middle];
    let [motor, beside, middle] = shares.map(|of| number(100.0 * of, 0));
    let smallest = format!(
        "one motor that lost {motor} % of its thrust, a weight of {beside} % of the vehicle's beside the centre or of {middle} % in the middle"
    );
    let first = match &diagnosis.verdict {
        DiagnosisVerdict::TooFew => {
            let none = "too few normal flights: nothing is found, and the smallest that could be is";
            return format!("{none} {smallest}");
        }
        DiagnosisVerdict::Nothing => {
            let none = "nothing beyond what set-ups differ by; the smallest that would be found is";
            return format!("{none} {smallest}");
        }
        DiagnosisVerdict::Unnamed => {
            "something that cannot be named: more than set-ups differ by, and no fault explains it better"
                .into()
        }
        DiagnosisVerdict::SlungLoad { line, length_m } => format!(
            "slung load: a swing at {} Hz, {} times as strong as in normal flights, of a thread of {} m",
            number(line.frequency_hz, 2),
            number(line.ratio, 1),
            number(*length_m, 2)
        ),
        DiagnosisVerdict::Fault(fit) => described(fit),
    };
    let mut names = vec![first];
    names.extend(diagnosis.alternatives.iter().map(described));
    let is_weight = |fault: &Fault| matches!(fault, Fault::AddedWeight { .. });
    let named = match &diagnosis.verdict {
        DiagnosisVerdict::Fault(fit) => Some(fit),
        _ => None,
    };
    if named.into_iter().chain(&diagnosis.alternatives).any(|f| is_weight(&f.fault)) {
        names.push(format!("what hovers like a weight: `{}`", look_alikes(demands).join("`, `")));
    }
    names.join("; or ")
}

fn described(fit: &FaultFit) -> String {
    format!("{} (chance {} %)", fit.fault.description(fit.stderr), number(100.0 * fit.chance, 0))
}

fn percent(share: f64) -> String {
    let sign = if share < 0.0 { "" } else { "+" };
    format!("{sign}{} %", number(100.0 * share, 1))
}

/// Changes by set-up.
pub(crate) fn changes_table(diagnosis: &Diagnosis) -> Table<usize> {
    let row =
        |side: &str, s: &SetUp| (format!("{side} {}", s.name), s.flights.to_string(), s.change.map(percent));
    let all = "all suspects, in standard deviations".to_owned();
    let rows: Vec<_> = (diagnosis.normal.iter().map(|s| row("normal", s)))
        .chain(diagnosis.suspect.iter().map(|s| row("suspect", s)))
        .chain([(all, String::new(), diagnosis.z().map(|z| number(z, 1)))])
        .collect();
    let table = Table::from_rows(0..rows.len())
        .words("set-up", |row| &rows[row].0)
        .values("flights", |row| &rows[row].1);
    let demands = DEMAND.into_iter().enumerate();
    demands.fold(table, |table, (i, demand)| table.values(demand, |row| &rows[row].2[i]))
}

/// Derivation of the verdict.
fn method(diagnosis: &Diagnosis) -> String {
    let sd = diagnosis.standard_deviations.map(|s| format!("{} %", number(100.0 * s, 1))).join(", ");
    let mut text = format!(
        "Demand by {}, in shares of the hover thrust, against the normal mean. Without a fault the suspects would differ by {sd} (thrust, roll, \
         pitch, yaw; one standard deviation, from the normal flights and from what is known of set-ups). A fault makes the change {} times likelier; \
         an alarm from {ALARM_ODDS} on. Chances of faults are among those that the motors can tell.\n",
        diagnosis.source.description(),
        number(diagnosis.odds, 1),
    );
    if let Some(line) = diagnosis.line {
        let (hz, [low, high]) = (number(line.frequency_hz, 2), band_hz());
        let place = if line.is_inside { "" } else { ", no peak inside the band, hence no thread" };
        let _ = writeln!(
            text,
            "Strongest swing from {low} to {high} Hz: {hz} Hz, by chance {}{place}; an alarm below {SWING_RATE}.",
            number(line.p_value, 3)
        );
    }
    let _ = match diagnosis.normal_alarms {
        Some([alarms, tried]) => {
            writeln!(text, "Each normal set-up against the others: {alarms} of {tried} raise an alarm.")
        }
        None => writeln!(
            text,
            "One normal set-up only: how far set-ups differ is what is known of other vehicles."
        ),
    };
    for line in &diagnosis.left_out {
        let _ = writeln!(text, "Left out: {line}.");
    }
    text
}

fn band_hz() -> [f64; 2] {
    let all = frequencies_hz();
    [all[0], all[all.len() - 1]]
}

pub(crate) fn as_text(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    let (verdict, table) = (verdict_text(diagnosis, demands), changes_table(diagnosis).plain());
    format!("{verdict}\n\n{table}\n{}", method(diagnosis))
}

pub(crate) fn as_markdown(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> String {
    let (verdict, table) = (verdict_text(diagnosis, demands), changes_table(diagnosis).markdown());
    format!("# Diagnosis\n\n**{verdict}**\n\n{table}\n{}\n![Trims](trims.svg)\n", method(diagnosis))
}

fn fault_json(fit: &FaultFit) -> Json {
    let mut json = match &fit.fault {
        Fault::AddedWeight { mass_kg, left, front } => {
            json!({"effect": "mass_change", "added_kg": mass_kg, "stderr_kg": fit.stderr,
            "left": left, "front": front, "side": side_of(*left, *front)})
        }
        Fault::WeakMotors(motors) => {
            let all: Vec<Json> = motors.iter().map(|m| json!({"motor": m.motor, "loss": m.loss})).collect();
            json!({"effect": "weak_motor", "motor": motors[0].motor, "loss": motors[0].loss, "stderr": fit.stderr, "motors": all})
        }
        Fault::Unnamed => json!({"effect": Json::Null}),
    };
    json["chance"] = json!(fit.chance);
    json
}

pub(crate) fn as_json(diagnosis: &Diagnosis, demands: &[EffectDemand]) -> Json {
    let (kind, details) = match &diagnosis.verdict {
        DiagnosisVerdict::TooFew => ("too_few", Json::Null),
        DiagnosisVerdict::Nothing => ("nothing", Json::Null),
        DiagnosisVerdict::Unnamed => ("unnamed", Json::Null),
        DiagnosisVerdict::SlungLoad { line, length_m } => {
            ("slung_load", json!({"frequency_hz": line.frequency_hz, "length_m": length_m}))
        }
        DiagnosisVerdict::Fault(fit) => {
            let kind = match &fit.fault {
                Fault::WeakMotors(motors) if motors.len() > 1 => "weak_motors",
                Fault::WeakMotors(_) => "weak_motor",
                _ => "added_weight",
            };
            (kind, fault_json(fit))
        }
    };
    let set_up = |s: &SetUp| json!({"name": s.name, "flights": s.flights, "change": s.change});
    let smallest = diagnosis.smallest;
    // NaN, where nothing can be said, is null
    json!({
        "verdict": kind,
        "text": verdict_text(diagnosis, demands),
        "fault": details,
        "alternatives": diagnosis.alternatives.iter().map(fault_json).collect::<Vec<_>>(),
        "smallest_found": {"motor_loss": smallest.motor_loss, "weight_beside": smallest.beside, "weight_in_the_middle": smallest.middle},
        "source": diagnosis.source.description(),
        "demands": DEMAND,
        "change": diagnosis.change,
        "z": diagnosis.z(),
        "standard_deviations": diagnosis.standard_deviations,
        "degrees_of_freedom": diagnosis.freedom,
        "odds": diagnosis.odds,
        "swing": diagnosis.line.map(|l| json!({"frequency_hz": l.frequency_hz, "ratio": l.ratio, "p_value": l.p_value, "is_inside": l.is_inside})),
        "swing_band_hz": band_hz(),
        "normal": diagnosis.normal.iter().map(set_up).collect::<Vec<_>>(),
        "suspect": diagnosis.suspect.iter().map(set_up).collect::<Vec<_>>(),
        "normal_alarms": diagnosis.normal_alarms.map(|[alarms, tried]| json!({"alarms": alarms, "tried": tried})),
        "left_out": diagnosis.left_out,
    })
}

/// Draws changes by set-up: thrust against yaw, which distinguish faults, and roll against pitch, which show the
/// place.
pub(crate) fn picture(diagnosis: &Diagnosis) -> Result<Drawing, PictureError> {
    let percent = |set_ups: &[SetUp], i: usize, sign: f64| {
        set_ups.iter().map(|s| 100.0 * sign * s.change[i]).collect::<Vec<f64>>()
    };
    let two_deviations = |i: usize| 200.0 * diagnosis.standard_deviations[i];
    let angles = (0..=72).map(|k| f64::from(k) * std::f64::consts::TAU / 72.0);
    let panel = |title, [x_label, y_label]: [&str; 2], [i, j]: [usize; 2], sign: f64| {
        let (a, b) = (two_deviations(i), two_deviations(j));
        let [normal, suspect] = [&diagnosis.normal, &diagnosis.suspect]
            .map(|set_ups| (percent(set_ups, i, sign), percent(set_ups, j, 1.0)));
        let ellipse = (angles.clone().map(|t| a * t.cos()), angles.clone().map(|t| b * t.sin()));
        Panel::new(x_label, y_label)
            .title(title)
            .curve(Style::Dashed, PURPLE, "two standard deviations without a fault", ellipse.0, ellipse.1)
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
