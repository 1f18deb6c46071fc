//! Numbers with their uncertainty, and findings in sentences.

use crazyflie_env::effects::{Entry, registry};
use crazyflie_identify::explain::signals::{Signal, SignalState, SignalVerdict, is_negligible};
use crazyflie_identify::explain::verdict::{
    EffectParameterEstimate, Explanation, Finding, Leftover, Structure, Verdict,
};
use crazyflie_identify::vehicle::{SharedTrim, shared_trims};

use super::Run;
use crate::text::number;

/// A number with so many significant digits, without an exponent where that reads well.
pub(crate) fn significant(value: f64, digits: i32) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let size = value.abs().log10().floor() as i32;
    if !(-5..7).contains(&size) {
        return format!("{value:.*e}", (digits - 1).max(0) as usize);
    }
    number(value, (digits - 1 - size).max(0) as usize)
}

/// Decimals up to the second digit of a standard error; none if it is unknown.
fn decimals_of(stderr: f64) -> Option<usize> {
    let is_known = stderr.is_finite() && stderr > 0.0;
    is_known.then(|| (1 - stderr.log10().floor() as i32).clamp(0, 7) as usize)
}

/// Value and standard error, both to the second digit of the error.
pub(crate) fn with_error(value: f64, stderr: f64) -> String {
    let Some(decimals) = decimals_of(stderr) else { return significant(value, 4) };
    format!("{} ± {}", number(value, decimals), number(stderr, decimals))
}

/// Returns the interval that contains the true value in 95 of 100 such flights.
pub(crate) fn interval(estimate: &EffectParameterEstimate) -> String {
    let Some(decimals) = decimals_of(estimate.stderr) else { return "unknown".into() };
    let bound = |by: f64| number(estimate.value + by * estimate.stderr, decimals);
    format!("{} to {}", bound(-1.96), bound(1.96))
}

/// A unit as it follows a number; ratios have none.
pub(crate) fn unit(unit: &str) -> String {
    if unit == "1" { String::new() } else { format!(" {unit}") }
}

pub(crate) fn estimate(e: &EffectParameterEstimate) -> String {
    // most effects are off at zero, and an effect that the model lacks is off
    let is_off = e.declared == 0.0 || e.declared == 1.0;
    let declared = (!is_off).then(|| format!(" (declared {})", significant(e.declared, 3)));
    let value = with_error(e.value, e.stderr) + &unit(e.unit);
    format!("{} {value}{}", e.name, declared.unwrap_or_default())
}

/// Words joined as in a sentence.
pub(crate) fn join_words<S: AsRef<str>>(words: &[S], last: &str) -> String {
    match words {
        [] => String::new(),
        [only] => only.as_ref().into(),
        [first @ .., end] => {
            let first: Vec<&str> = first.iter().map(AsRef::as_ref).collect();
            format!("{} {last} {}", first.join(", "), end.as_ref())
        }
    }
}

pub(crate) fn confusable(effect: &Finding) -> String {
    join_words(&effect.confusable_with, "or")
}

/// An effect with its values, and what else it may be.
fn effect_phrase(effect: &Finding) -> String {
    let values: Vec<String> = effect.params.iter().map(estimate).collect();
    let or = (!effect.confusable_with.is_empty()).then(|| format!(", or {} instead", confusable(effect)));
    format!("{} ({}{})", effect.name, values.join(", "), or.unwrap_or_default())
}

/// Sums of numbers of the model and of the effects that add to them: path, sum, standard error of the effect,
/// unit.
pub(crate) fn totals(run: &Run) -> Vec<(&'static str, f64, f64, &'static str)> {
    let named = || run.found.effects.iter().chain(&run.found.partial).flat_map(Finding::all);
    let total = |entry: &Entry| {
        let path = entry.model_number?;
        let declared = run.model.parameter(path).ok().filter(|value| *value != 0.0)?;
        let effect = named().find(|e| e.name == entry.name)?;
        let added = effect.params.iter().find(|p| p.name == entry.params[0].name && p.declared == 0.0)?;
        Some((path, declared + added.value, added.stderr, added.unit))
    };
    registry().iter().filter_map(total).collect()
}

/// The same in words.
pub(crate) fn total_lines(run: &Run) -> Vec<String> {
    let line = |(path, value, stderr, unit): (&str, f64, f64, &str)| {
        format!("{path}, what the model declares included: {} {unit}", with_error(value, stderr))
    };
    totals(run).into_iter().map(line).collect()
}

/// The trims that all flights share, in words.
pub(crate) fn shared_trim_lines(run: &Run) -> Vec<String> {
    let line = |SharedTrim { name, value, spread, unit: of, declared, causes, .. }: SharedTrim| {
        let (value, declared) = (with_error(value, spread) + &unit(of), significant(declared, 4));
        format!("all flights share {name} {value} (declared {declared}): {causes}")
    };
    shared_trims(&run.model, &run.trims).into_iter().map(line).collect()
}

/// The verdict in one sentence.
pub(crate) fn sentence(found: &Explanation) -> String {
    let names = |effects: &[Finding]| {
        join_words(&effects.iter().flat_map(Finding::all).map(effect_phrase).collect::<Vec<_>>(), "and")
    };
    let (effects, partial) = (names(&found.effects), names(&found.partial));
    let left = strongest_left(found).map_or_else(String::new, |l| format!(" ({}: {})", l.signal, l.finding));
    let lowering = "These lower the errors on the test flights but do not account for it";
    let besides = if partial.is_empty() { String::new() } else { format!(" {lowering}: {partial}.") };
    match found.verdict {
        Verdict::NotDecidable if found.foreign => {
            "Not decidable: the numbers of the declared model are not this vehicle's, and beside its own no effect stands out.".into()
        }
        Verdict::NotDecidable if !found.withdrawn.is_empty() => format!(
            "Not decidable: {} would lower the errors on the flights of the fit and raise one on the test flights. The model stays as declared.",
            join_words(&found.withdrawn, "and")
        ),
        Verdict::Explained => format!("Explained: the declared model lacks {effects}. {}", shares(found)),
        Verdict::NothingMissing => "Nothing is missing: the declared model accounts for these flights.".into(),
        Verdict::NotDecidable if untested(found).next().is_some() => {
            let names = |all: &[&'static str]| join_words(all, "and");
            let accounted: Vec<&str> = in_state(found, SignalState::NothingMissing).collect();
            let nothing = || format!(" Nothing is missing in {}.", names(&accounted));
            let rest = if accounted.is_empty() { String::new() } else { nothing() };
            format!("Not decidable: these flights do not test {}.{rest}", names(&untested(found).collect::<Vec<_>>()))
        }
        Verdict::NotDecidable => "Not decidable: something is missing, but these flights do not identify the effect.".into(),
        Verdict::PartlyExplained => {
            format!("Explained in part: the declared model lacks {effects}. Structure is left that no effect accounts for{left}. {}{besides}", shares(found))
        }
        Verdict::Unexplained => {
            let learned =
                if found.learned { " A term learned from the residual, which names no cause, is in the completed model." } else { "" };
            format!("Unexplained: no effect of the library accounts for what these flights show{left}. {}{besides}{learned}", remainders(found))
        }
    }
}

/// Names of the signals in a state.
fn in_state(found: &Explanation, state: SignalState) -> impl Iterator<Item = &'static str> {
    found.signals.iter().filter(move |verdict| verdict.state == state).map(|verdict| verdict.signal.name())
}

fn untested(found: &Explanation) -> impl Iterator<Item = &'static str> {
    in_state(found, SignalState::NotTested)
}

/// The share of the error 2 s ahead that is explained, signal by signal.
fn shares(found: &Explanation) -> String {
    let share = |verdict: &SignalVerdict| {
        let share =
            if is_negligible(&found.errors, verdict.signal) { f64::NAN } else { verdict.explained_share[1] };
        format!("{} {}", verdict.signal.name(), percent(share))
    };
    let all: Vec<String> = found.signals.iter().map(share).collect();
    format!("Explained share of the error 2 s ahead: {}.", all.join(", "))
}

/// The errors that are left in the signals without an explanation.
fn remainders(found: &Explanation) -> String {
    let left = found.signals.iter().filter(|verdict| verdict.state == SignalState::Unexplained);
    let size = |verdict: &SignalVerdict| {
        let [error, no_model] =
            [verdict.error[1], verdict.no_model[1]].map(|size| with_unit(size, verdict.unit));
        format!("{} errs by {error} (without a model by {no_model})", verdict.signal.name())
    };
    format!("2 s ahead: {}.", left.map(size).collect::<Vec<_>>().join(", "))
}

/// A share in percent.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{} %", number(100.0 * share, 0).replace('-', "−")) } else { "-".into() }
}

/// A size with its unit; angles in degrees.
pub(super) fn with_unit(size: f64, unit: &str) -> String {
    match unit {
        "rad" => format!("{} deg", significant(size.to_degrees(), 2)),
        unit => format!("{} {unit}", significant(size, 2)),
    }
}

/// Returns the strongest leftover of a signal that is not accounted for; one that shows where or when a force acts is
/// first.
fn strongest_left(found: &Explanation) -> Option<&Leftover> {
    let is_left = |verdict: &&SignalVerdict| {
        matches!(verdict.state, SignalState::PartlyExplained | SignalState::Unexplained)
    };
    let parts: Vec<Signal> = found.signals.iter().filter(is_left).map(|verdict| verdict.signal).collect();
    let left = || findings(found).into_iter().filter(|l| parts.contains(&l.part));
    left().find(|l| matches!(l.kind, Structure::Line | Structure::State)).or_else(|| left().next())
}

/// Leftovers that are too strong to be chance.
pub(crate) fn findings(found: &Explanation) -> Vec<&Leftover> {
    found.leftover.iter().filter(|l| l.is_structure()).collect()
}

/// Change of an error in percent; below zero is better.
pub(crate) fn change_percent(before: f64, after: f64) -> Option<f64> {
    let change = 100.0 * (after / before - 1.0);
    change.is_finite().then_some(change)
}

/// Accuracy of the closed-loop prediction, in words.
pub(crate) fn closed_loop_line(run: &super::Run) -> Option<String> {
    let (controller, [before, after]) = run.closed_loop?;
    let cm = |m: f64| significant(100.0 * m, 3);
    let [declared, completed] = [before.predicted_m, after.predicted_m].map(cm);
    let [first, second] = [before.predicted_tracking_m, after.predicted_tracking_m].map(cm);
    let (name, measured) = (controller.name(), cm(before.measured_tracking_m));
    Some(format!(
        "Closed loop: the {name} along the set-points of the test flights comes within {declared} cm of where they were flown on the declared model, {completed} cm on \
         the completed one (the set-points themselves: {measured} cm); its tracking error is predicted as {first} and {second} cm, it was {measured} cm"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_show_what_is_known_of_them() {
        assert_eq!(with_error(0.374_21, 0.004_13), "0.3742 ± 0.0041");
        assert_eq!(with_error(39_342.0, 12.0), "39342 ± 12");
        assert_eq!(with_error(0.5, f64::INFINITY), "0.5000");
        assert_eq!(
            [significant(0.012_34, 3), significant(123.4, 3), significant(0.0, 3)],
            ["0.0123", "123", "0"]
        );
        assert_eq!(significant(f64::NAN, 3), "-");
    }

    #[test]
    fn lists_read_as_sentences() {
        assert_eq!([join_words(&["a"], "or"), join_words(&["a", "b", "c"], "or")], ["a", "a, b or c"]);
    }
}
