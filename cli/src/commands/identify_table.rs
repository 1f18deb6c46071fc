//! Output and pictures of `crazyflie identify`.

use crazyflie_statistics::mean;
use std::collections::BTreeMap;
use std::io::Write;

use crazyflie_env::model::VerticalInput;
use crazyflie_identify::axis_errors::{AxisChange, LEAST_FLIGHTS, axis_changes};
use crazyflie_identify::estimate::{Comparison, ParameterEstimate, ResidualTests};
use crazyflie_identify::metrics::Fit;
use crazyflie_identify::transfer::{Structure, TransferFunctionEstimate};
use crazyflie_identify::vehicle::{self, ModelComparison};
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, Panel, PictureError, Style, chart};
use serde_json::{Value, json};

use super::{Outcome, Table, number, or_dash, percent};

/// A transfer function, and what it makes of the logs of the test.
type TransferResult = (TransferFunctionEstimate, Vec<Comparison>);
/// A number that was found, and the one before.
type EstimateRow<'a> = (&'a ParameterEstimate, Option<f64>);
/// A signal of a part, and what the model before makes of it.
type SignalRow<'a> = (&'static str, &'a Comparison, Option<&'a Comparison>);

/// Transfer functions, the best first.
pub(super) fn transfer(all: &[TransferResult], failed: &[String], out: &mut dyn Write) -> Outcome {
    let Some((best, test)) = all.first() else { return Ok(()) };
    let windows =
        best.window_s().map_or("one window per flight".to_owned(), |s| format!("windows of about {s} s"));
    let (from, to) = (best.channel.spec().input, best.channel.spec().output);
    writeln!(out, "{from} to {to}: {} logs, {} samples, {windows}\n", best.fit.len(), best.samples)?;
    if all.len() > 1 {
        writeln!(out, "{}", orders(all))?;
    }
    for line in failed {
        writeln!(out, "{line}\n")?;
    }
    writeln!(out, "{}", best.function)?;
    let poles: Vec<String> = best.function.poles().iter().map(|p| complex(p.re, p.im)).collect();
    let gain = best.function.gain().map_or(String::new(), |gain| format!(", gain at rest {gain:.5}"));
    let end = if best.converged { "" } else { "; the fit did not converge" };
    writeln!(out, "poles {} 1/s{gain}{end}\n", poles.join(", "))?;
    let rows: Vec<_> = best.parameters.iter().map(|p| (p, None)).collect();
    let (table, noise) = (estimates("coefficient", &rows), significant(best.noise));
    writeln!(out, "{table}standard errors are {}; noise {noise} of {}\n", best.clusters, signal(&best.fit))?;
    let parts = [("fit", &best.fit), ("test", test)];
    let rows = parts.into_iter().flat_map(|(part, all)| all.iter().map(move |c| (part, c, None)));
    writeln!(out, "{}", signals(rows))?;
    residuals("fit", &best.fit, best.parameters.len(), out)?;
    residuals("test", test, 0, out)
}

fn signal(all: &[Comparison]) -> String {
    all.first().map_or(String::new(), |c| format!("{} ({})", c.signal, c.unit))
}

fn complex(re: f64, im: f64) -> String {
    if im == 0.0 {
        number(re, 3)
    } else {
        format!("{} {} {}i", number(re, 3), if im < 0.0 { "-" } else { "+" }, number(im.abs(), 3))
    }
}

/// Four digits are more than any log gives.
fn significant(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        return "unknown".into();
    }
    if size != 0.0 && !(1e-3..1e6).contains(&size) {
        return format!("{value:.3e}");
    }
    let whole = if size < 1.0 { 0 } else { size.log10().floor() as usize + 1 };
    number(value, 5_usize.saturating_sub(whole))
}

/// Numbers that were found, beside those of before.
pub(super) fn estimates<'a>(what: &str, rows: &[EstimateRow<'a>]) -> Table<EstimateRow<'a>> {
    let mut table = Table::from_rows(rows.iter().copied()).words(what, |(p, _)| &p.name);
    if rows.iter().any(|(_, before)| before.is_some()) {
        table = table.values("before", |(_, before)| or_dash(before.map(significant)));
    }
    table
        .values("estimate", |(p, _)| significant(p.value))
        .values("standard error", |(p, _)| significant(p.standard_error))
        .words("unit", |(p, _)| &p.unit)
        .words("", |(p, _)| if p.at_bound { "at its bound" } else { "" })
}

pub(super) fn order(s: &Structure) -> String {
    let delay = if s.delay { " with delay" } else { "" };
    format!("{},{}{}{delay}", s.numerator, s.denominator, if s.integrator { " with integrator" } else { "" })
}

fn orders(all: &[TransferResult]) -> Table<&TransferResult> {
    let least = |value: &dyn Fn(&TransferFunctionEstimate) -> f64| {
        all.iter().map(|(i, _)| value(i)).fold(f64::INFINITY, f64::min)
    };
    let (aic, bic) = (least(&|i| i.criteria.aic), least(&|i| i.criteria.bic));
    Table::from_rows(all)
        .words("order", |(found, _)| order(&found.structure))
        .values("AIC - best", |(found, _)| number(found.criteria.aic - aic, 1))
        .values("BIC - best", |(found, _)| number(found.criteria.bic - bic, 1))
        .values("fit", |(found, _)| percent(mean_fit_percent(&found.fit), 2))
        .values("test", |(_, test)| percent(mean_fit_percent(test), 2))
        .words("function", |(found, _)| &found.function)
}

fn mean_fit_percent(comparisons: &[Comparison]) -> Option<f64> {
    mean(&comparisons.iter().filter_map(|c| c.fit.fit_percent).collect::<Vec<_>>())
}

fn rmse(fit: &Fit, unit: &str) -> String {
    // people read degrees
    match unit {
        "rad" => format!("{} deg", significant(fit.rmse.to_degrees())),
        unit => format!("{} {unit}", significant(fit.rmse)),
    }
}

/// Measured and predicted signals, in windows and over whole flights.
fn signals<'a>(rows: impl Iterator<Item = SignalRow<'a>>) -> Table<SignalRow<'a>> {
    let rows: Vec<_> = rows.collect();
    let has_before = rows.iter().any(|(.., before)| before.is_some());
    let mut table = Table::from_rows(rows)
        .words("log", |(_, c, _)| &c.log)
        .words("part", |(part, ..)| part)
        .words("signal", |(_, c, _)| c.signal);
    for kind in ["windows", "whole flight"] {
        let fit_of = |c: &'a Comparison| if kind == "windows" { Some(&c.fit) } else { c.whole.as_ref() };
        let fit = |c: &'a Comparison| percent(fit_of(c).and_then(|fit| fit.fit_percent), 2);
        let mut header = format!("{kind}: fit");
        if has_before {
            table = table.values(format!("{kind}: before"), |(.., before)| or_dash(before.map(fit)));
            header = "fit".to_owned();
        }
        table = table
            .values(header, |(_, c, _)| fit(c))
            .values("RMSE", |(_, c, _)| or_dash(fit_of(c).map(|fit| rmse(fit, c.unit))));
    }
    table
}

/// One line about the residuals of one signal.
fn residuals(part: &str, all: &[Comparison], parameters: usize, out: &mut dyn Write) -> Outcome {
    if all.is_empty() {
        return Ok(());
    }
    let tests = ResidualTests::new(&all.iter().collect::<Vec<_>>(), parameters);
    Ok(writeln!(out, "residuals of the {part}: {}; {}", whiteness(&tests), independence(&tests))?)
}

fn whiteness(tests: &ResidualTests) -> String {
    let w = match &tests.whiteness {
        Err(why) => return format!("whiteness not tested ({why})"),
        Ok(w) => w,
    };
    let name = if w.is_white() { "white" } else { "not white" };
    let (score, outside, lags) = (number(w.ljung_box, 1), w.outside, w.correlation.len());
    format!("{name} (Ljung-Box {score}, p = {:.2e}, {outside} of {lags} lags outside)", w.p_value)
}

fn independence(tests: &ResidualTests) -> String {
    let i = match &tests.independence {
        Err(why) => return format!("independence of the input not tested ({why})"),
        Ok(i) => i,
    };
    let name =
        if i.is_independent() { "independent of past input" } else { "past input explains some of them" };
    let (outside, lags, feedback) = (i.outside, i.lags.len() / 2 + 1, i.feedback);
    format!("{name} ({outside} of {lags} lags outside 99 %; feedback at {feedback} negative lags)")
}

/// An identified model, and the errors of it and of its predecessor on the logs.
pub(super) struct ModelIdentification<'a> {
    pub found: &'a vehicle::ModelEstimate,
    pub before_fit: &'a ModelComparison,
    /// By the model before, then by the one found.
    pub test: Option<&'a [ModelComparison; 2]>,
    /// True if the mass was given; otherwise it is that of the model before.
    pub mass_is_given: bool,
}

impl ModelIdentification<'_> {
    /// Logs of the fit and of the test, before and after.
    fn parts(&self) -> Vec<(&'static str, &ModelComparison, &ModelComparison)> {
        let fit = ("fit", self.before_fit, &self.found.fit);
        std::iter::once(fit).chain(self.test.map(|[before, after]| ("test", before, after))).collect()
    }
}

pub(super) fn write_model(shown: &ModelIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let fitted = shown.found;
    let (form, name, samples) = (fitted.input.name(), &fitted.model.name, fitted.samples);
    let logs = fitted.fit.comparisons.len() / 6;
    if let Some(sentence) = unexplained(fitted) {
        writeln!(out, "{sentence}\n")?;
    }
    writeln!(out, "model {name}: {logs} logs, {samples} samples, vertical form {form}")?;
    writeln!(out, "{}", if fitted.converged { "" } else { "the fit did not converge\n" })?;
    let rows: Vec<_> = fitted.parameters.iter().zip(fitted.before.iter().map(|value| Some(*value))).collect();
    let (table, criteria) = (estimates("number", &rows), &fitted.criteria);
    let (aic, bic) = (criteria.aic, criteria.bic);
    writeln!(out, "{table}standard errors are {}; AIC {aic:.1}, BIC {bic:.1}\n", fitted.clusters)?;
    if !fitted.left_out.is_empty() {
        let names = fitted.left_out.join(", ");
        writeln!(
            out,
            "these flights do not determine: {names}; numbers stay as the fit began, effects are off\n"
        )?;
    }
    write!(out, "{}", not_fitted(shown))?;
    write!(out, "{}", trims(shown))?;
    let rows = shown.parts().into_iter().flat_map(|(part, before, after)| {
        after.comparisons.iter().zip(&before.comparisons).map(move |(c, before)| (part, c, Some(before)))
    });
    writeln!(out, "{}", signals(rows))?;
    for (part, _, all) in shown.parts() {
        let groups = by_signal(&all.comparisons);
        let tests: Vec<_> = groups.iter().map(|(name, group)| (name, ResidualTests::new(group, 0))).collect();
        let table = Table::from_rows(&tests)
            .words("signal", |(name, _)| name)
            .words(format!("residuals of the {part}"), |(_, tests)| whiteness(tests))
            .words("", |(_, tests)| independence(tests));
        writeln!(out, "{table}")?;
    }
    shown.parts().into_iter().try_for_each(|(part, before, after)| axes(part, before, after, out))
}

/// The sentence about angles that the model does not follow.
pub(super) fn unexplained(found: &vehicle::ModelEstimate) -> Option<String> {
    let angles = found.unexplained();
    let fit = |angle, fit| format!("the fit of {angle} is {}", percent(Some(fit), 0));
    let fits = angles.iter().map(|u| fit(u.angle, u.fit_percent)).collect::<Vec<_>>().join(", ");
    (!angles.is_empty())
        .then(|| format!("The attitude stays unexplained, so no model is written: {fits} (100 % is perfect)"))
}

/// Lines about what no fit of a thrust command finds.
fn not_fitted(shown: &ModelIdentification<'_>) -> String {
    let (model, mut lines) = (&shown.found.model, String::new());
    if !shown.found.input.is_pwm() {
        return lines;
    }
    if !model.effects.contains_key("motor_lag") {
        lines += "not fitted: motor lag (--effects motor_lag fits it, `crazyflie horizons` does from rotor speeds)\n";
    }
    if !shown.mass_is_given {
        let mass_kg = model.vehicle.mass.value;
        lines += &format!(
            "not fitted: mass, {mass_kg} kg as in the model before; forces in N scale with it, so give --mass\n"
        );
    }
    lines + "\n"
}

/// Trims of each flight.
fn trims(shown: &ModelIdentification<'_>) -> String {
    let Some(first) = shown.found.fit.trims.first() else { return String::new() };
    let parts = shown.parts();
    let rows = parts.iter().flat_map(|(part, _, judged)| judged.trims.iter().map(move |trim| (part, trim)));
    let mut table = Table::from_rows(rows)
        .words("of its own: log", |(_, trim)| &trim.log)
        .words("part", |(part, _)| part);
    for (i, (name, unit, _)) in first.values.iter().enumerate() {
        let header = if *unit == "1" { name.clone() } else { format!("{name} ({unit})") };
        table = table.values(header, |(_, trim)| significant(trim.values[i].2));
    }
    format!("{table}\n")
}

/// Errors of prediction by axis and horizon, before and after.
fn axes(part: &str, before: &ModelComparison, after: &ModelComparison, out: &mut dyn Write) -> Outcome {
    if after.errors.is_empty() || before.errors.len() != after.errors.len() {
        return Ok(());
    }
    let changes = axis_changes(&before.errors, &after.errors);
    let in_unit = |c: &AxisChange, v: f64| significant(if c.unit == "rad" { v.to_degrees() } else { v });
    let table = Table::from_rows(&changes)
        .words(format!("{part}: error of the"), |c| c.axis)
        .values("ahead", |c| format!("{} s", c.horizon_s))
        .values("before", |c| in_unit(c, c.before))
        .values("after", |c| in_unit(c, c.after))
        .words("unit", |c| if c.unit == "rad" { "deg" } else { c.unit })
        .values("better", |c| format!("{} of {}", c.better, c.flights))
        .values("paired p", |c| match c.p_value {
            Some(p) => format!("{p:.1e}"),
            None => format!("fewer than {LEAST_FLIGHTS} flights"),
        });
    Ok(writeln!(out, "{table}")?)
}

/// Comparisons of one signal together, in the order of their first appearance.
fn by_signal(all: &[Comparison]) -> Vec<(&'static str, Vec<&Comparison>)> {
    let mut groups: Vec<(&'static str, Vec<&Comparison>)> = Vec::new();
    for c in all {
        match groups.iter_mut().find(|(name, _)| *name == c.signal) {
            Some((_, group)) => group.push(c),
            None => groups.push((c.signal, vec![c])),
        }
    }
    groups
}

pub(super) fn transfer_json(all: &[TransferResult], failed: &[String]) -> Value {
    let transfer_json = |(identified, test): &TransferResult| {
        let poles: Vec<[f64; 2]> = identified.function.poles().iter().map(|p| [p.re, p.im]).collect();
        json!({"channel": identified.channel.spec().name, "numerator": identified.function.numerator, "denominator": identified.function.denominator,
            "delay_s": identified.function.delay_s, "offsets": identified.function.offsets, "text": identified.function.to_string(), "poles": poles,
            "parameters": identified.parameters, "noise": identified.noise, "aic": identified.criteria.aic, "bic": identified.criteria.bic,
            "converged": identified.converged, "samples": identified.samples, "window_s": identified.window_s(), "standard_errors": identified.clusters.to_string(),
            "fit": comparisons(&identified.fit, identified.parameters.len()), "test": comparisons(test, 0)})
    };
    let all: Vec<Value> = all.iter().map(transfer_json).collect();
    json!({"transfer_functions": all, "failed": failed})
}

pub(super) fn model_json(shown: &ModelIdentification<'_>) -> Value {
    let fitted = shown.found;
    let vertical = if fitted.input == VerticalInput::Height { "height" } else { fitted.input.name() };
    let part = |all: Option<&ModelComparison>| comparisons(all.map_or(&[], |judged| &judged.comparisons), 0);
    json!({"model": fitted.model.name, "vertical": vertical, "parameters": fitted.parameters, "before": fitted.before,
        "left_out": fitted.left_out, "unexplained": fitted.unexplained(), "mass_kg": fitted.model.vehicle.mass.value, "mass_is_given": shown.mass_is_given, "noise": fitted.noise, "aic": fitted.criteria.aic, "bic": fitted.criteria.bic, "converged": fitted.converged, "samples": fitted.samples,
        "standard_errors": fitted.clusters.to_string(), "fit": part(Some(&fitted.fit)), "test": part(shown.test.map(|t| &t[1])),
        "before_fit": part(Some(shown.before_fit)), "before_test": part(shown.test.map(|t| &t[0])),
        "flights": shown.parts().into_iter().map(|(name, _, judged)| (name.to_owned(), flights_json(judged))).collect::<serde_json::Map<_, _>>(),
        "axis_errors": shown.parts().into_iter().map(|(name, before, after)| (name.to_owned(), json!(axis_changes(&before.errors, &after.errors)))).collect::<serde_json::Map<_, _>>()})
}

/// Trims and errors of each flight.
fn flights_json(judged: &ModelComparison) -> Value {
    let trim = |trim: &vehicle::NuisanceParameters| {
        let values =
            trim.values.iter().map(|(name, unit, value)| (name, json!({"value": value, "unit": unit})));
        json!({"log": trim.log, "own": values.collect::<BTreeMap<_, _>>()})
    };
    let errors = judged.errors.iter();
    let errors = errors.map(|e| json!({"log": e.flight, "predictions": e.predictions, "rms": e.rms}));
    json!({"own": judged.trims.iter().map(trim).collect::<Value>(), "errors": errors.collect::<Value>()})
}

fn comparisons(all: &[Comparison], parameters: usize) -> Value {
    let comparison = |c: &Comparison| json!({"log": c.log, "signal": c.signal, "unit": c.unit, "samples": c.t_s.len(), "windows": c.fit, "whole": c.whole});
    let tests = by_signal(all).into_iter().map(|(name, group)| {
        let tests = ResidualTests::new(&group, parameters);
        let white = tests.whiteness.as_ref().ok().map(|w| {
            json!({"white": w.is_white(), "ljung_box": w.ljung_box, "p_value": w.p_value, "outside": w.outside, "bound": w.bound,
                "correlation": w.correlation})
        });
        let independent = tests.independence.as_ref().ok().map(|i| {
            json!({"independent": i.is_independent(), "outside": i.outside, "feedback": i.feedback, "bound": i.bound, "lags": i.lags,
                "correlation": i.correlation})
        });
        (name.to_owned(), json!({"whiteness": white, "independence": independent}))
    });
    json!({"logs": all.iter().map(comparison).collect::<Vec<_>>(), "residuals": tests.collect::<serde_json::Map<_, _>>()})
}

/// A row of three panels per signal and part; of several logs the first one's prediction, and the
/// correlations of all.
pub(super) fn picture(fit: &[Comparison], test: &[Comparison]) -> Result<Drawing, PictureError> {
    let mut all_panels = Vec::new();
    for (part, all) in [("fit", fit), ("test", test)] {
        for (signal, group) in by_signal(all) {
            all_panels.extend(panels(part, signal, &group));
        }
    }
    chart(&all_panels, 3, "measured and predicted, and what the residuals say")
}

fn panels(part: &str, signal: &str, group: &[&Comparison]) -> [Panel; 3] {
    let first = group[0];
    let (scale, unit) = if first.unit == "rad" { (1.0_f64.to_degrees(), "deg") } else { (1.0, first.unit) };
    let prediction = Panel::new("time (s)", format!("{signal} ({unit})"))
        .title(format!("{part}: {}", first.log))
        .curve(Style::Solid, BLACK, "measured", &first.t_s, first.measured.iter().map(|v| v * scale))
        .curve(Style::Solid, BLUE, "predicted", &first.t_s, first.predicted.iter().map(|v| v * scale));
    let correlation = |labels: [&str; 2], tested: Option<(Vec<f64>, &[f64], f64)>| {
        let [x_label, y_label] = labels;
        let panel = Panel::new(x_label, y_label).title(format!("{part}: {signal}, residuals"));
        match tested {
            // no hole in the grid
            None => panel.curve(Style::Dashed, BLACK, "not tested", [0.0, 1.0], [0.0, 0.0]),
            Some((lags, values, bound)) => {
                panel.curve(Style::Points, BLUE, "", lags, values).band(GREEN, "99 %", [-bound, bound])
            }
        }
    };
    let tests = ResidualTests::new(group, 0);
    let whiteness = tests.whiteness.as_ref().ok().map(|w| {
        let lags = (1..=w.correlation.len()).map(|lag| lag as f64).collect();
        (lags, &w.correlation[..], w.bound)
    });
    let independence = tests.independence.as_ref().ok().map(|i| {
        let lags = i.lags.iter().map(|lag| *lag as f64).collect();
        (lags, &i.correlation[..], i.bound)
    });
    [
        prediction,
        correlation(["lag (samples)", "autocorrelation (1)"], whiteness),
        correlation(["lag (samples), + of the input before", "correlation with the input (1)"], independence),
    ]
}
