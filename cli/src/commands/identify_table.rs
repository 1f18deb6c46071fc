//! Output of `crazyflie identify`.

use crazyflie_statistics::mean;
use std::io::Write;

use crazyflie_env::model::VerticalInput;
use crazyflie_identify::axis_errors::{AxisChange, LEAST_FLIGHTS, axis_changes};
use crazyflie_identify::estimate::{Comparison, ParameterEstimate, ResidualTests};
use crazyflie_identify::metrics::Fit;
use crazyflie_identify::transfer::{Structure, TransferFunctionEstimate};
use crazyflie_identify::vehicle::{self, ModelComparison};
use serde_json::{Value, json};

use super::{Outcome, Table, number};

/// A transfer function, and what it makes of the logs of the test.
type TransferResult = (TransferFunctionEstimate, Vec<Comparison>);

/// Transfer functions, the best first.
pub(super) fn transfer(all: &[TransferResult], failed: &[String], out: &mut dyn Write) -> Outcome {
    let Some((best, test)) = all.first() else { return Ok(()) };
    let windows =
        best.window_s().map_or("one window per flight".to_owned(), |s| format!("windows of about {s} s"));
    let (from, to) = (best.channel.input(), best.channel.output());
    writeln!(out, "{from} to {to}: {} logs, {} samples, {windows}\n", best.fit.len(), best.samples)?;
    if all.len() > 1 {
        orders(all, out)?;
    }
    for line in failed {
        writeln!(out, "{line}\n")?;
    }
    writeln!(out, "{}", best.function)?;
    let poles: Vec<String> = best.function.poles().iter().map(|p| complex(p.re, p.im)).collect();
    let gain = best.function.gain().map_or(String::new(), |gain| format!(", gain at rest {gain:.5}"));
    writeln!(
        out,
        "poles {} 1/s{gain}{}\n",
        poles.join(", "),
        if best.converged { "" } else { "; the fit did not converge" }
    )?;
    let mut table = Table::new(&["coefficient", "estimate", "standard error", "unit", ""]).left(&[3, 4]);
    for p in &best.parameters {
        table.row(vec![
            p.name.clone(),
            significant(p.value),
            significant(p.standard_error),
            p.unit.clone(),
            bound(p).into(),
        ]);
    }
    writeln!(
        out,
        "{}standard errors are {}; noise {} of {}\n",
        table.plain(),
        best.clusters,
        significant(best.noise),
        signal(&best.fit)
    )?;
    fits(&best.fit, test, out)?;
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

fn bound(p: &ParameterEstimate) -> &'static str {
    if p.at_bound { "at its bound" } else { "" }
}

pub(super) fn order(s: &Structure) -> String {
    let delay = if s.delay { " with delay" } else { "" };
    format!("{},{}{}{delay}", s.numerator, s.denominator, if s.integrator { " with integrator" } else { "" })
}

fn orders(all: &[TransferResult], out: &mut dyn Write) -> Outcome {
    let mut table = Table::new(&["order", "AIC - best", "BIC - best", "fit", "test", "function"]).left(&[5]);
    let least = |value: &dyn Fn(&TransferFunctionEstimate) -> f64| {
        all.iter().map(|(i, _)| value(i)).fold(f64::INFINITY, f64::min)
    };
    let (aic, bic) = (least(&|i| i.criteria.aic), least(&|i| i.criteria.bic));
    for (identified, test) in all {
        table.row(vec![
            order(&identified.structure),
            number(identified.criteria.aic - aic, 1),
            number(identified.criteria.bic - bic, 1),
            percent(mean_fit_percent(&identified.fit)),
            percent(mean_fit_percent(test)),
            identified.function.to_string(),
        ]);
    }
    Ok(writeln!(out, "{}", table.plain())?)
}

fn mean_fit_percent(comparisons: &[Comparison]) -> Option<f64> {
    mean(&comparisons.iter().filter_map(|c| c.fit.fit_percent).collect::<Vec<_>>())
}

fn percent(fit: Option<f64>) -> String {
    fit.map_or(
        "-".into(),
        |fit| if fit < -9999.0 { "< -9999 %".into() } else { format!("{} %", number(fit, 2)) },
    )
}

fn rmse(fit: &Fit, unit: &str) -> String {
    // people read degrees
    match unit {
        "rad" => format!("{} deg", significant(fit.rmse.to_degrees())),
        unit => format!("{} {unit}", significant(fit.rmse)),
    }
}

fn fits(fit: &[Comparison], test: &[Comparison], out: &mut dyn Write) -> Outcome {
    let mut table =
        Table::new(&["log", "part", "signal", "windows: fit", "RMSE", "whole flight: fit", "RMSE"])
            .left(&[1, 2]);
    for (part, all) in [("fit", fit), ("test", test)] {
        for c in all {
            let whole = c.whole.as_ref();
            let (of_whole, rmse_whole) =
                (whole.and_then(|f| f.fit_percent), whole.map_or("-".into(), |f| rmse(f, c.unit)));
            let own = [
                c.log.clone(),
                part.into(),
                c.signal.into(),
                percent(c.fit.fit_percent),
                rmse(&c.fit, c.unit),
            ];
            table.row(own.into_iter().chain([percent(of_whole), rmse_whole]).collect());
        }
    }
    Ok(writeln!(out, "{}", table.plain())?)
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
    match &tests.whiteness {
        Err(why) => format!("whiteness not tested ({why})"),
        Ok(w) => {
            let name = if w.is_white() { "white" } else { "not white" };
            format!(
                "{name} (Ljung-Box {}, p = {:.2e}, {} of {} lags outside)",
                number(w.ljung_box, 1),
                w.p_value,
                w.outside,
                w.correlation.len()
            )
        }
    }
}

fn independence(tests: &ResidualTests) -> String {
    match &tests.independence {
        Err(why) => format!("independence of the input not tested ({why})"),
        Ok(i) => {
            let name = if i.is_independent() {
                "independent of past input"
            } else {
                "past input explains some of them"
            };
            format!(
                "{name} ({} of {} lags outside 99 %; feedback at {} negative lags)",
                i.outside,
                i.lags.len() / 2 + 1,
                i.feedback
            )
        }
    }
}

/// An identified model, and the errors of it and of its predecessor on the logs.
pub(super) struct ModelIdentification<'a> {
    pub found: &'a vehicle::ModelEstimate,
    pub before_fit: &'a ModelComparison,
    /// By the model before, then by the one found.
    pub test: Option<&'a [ModelComparison; 2]>,
}

impl ModelIdentification<'_> {
    /// Logs of the fit and of the test, before and after.
    fn parts(&self) -> Vec<(&'static str, &ModelComparison, &ModelComparison)> {
        let fit = ("fit", self.before_fit, &self.found.fit);
        std::iter::once(fit).chain(self.test.map(|[before, after]| ("test", before, after))).collect()
    }
}

pub(super) fn write_model(shown: &ModelIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let found = shown.found;
    let form = found.input.name();
    let logs = found.fit.comparisons.len() / 6;
    writeln!(
        out,
        "model {}: {logs} logs, {} samples, vertical form {form}",
        found.model.name, found.samples
    )?;
    writeln!(out, "{}", if found.converged { "" } else { "the fit did not converge\n" })?;
    let mut table = Table::new(&["number", "before", "estimate", "standard error", "unit", ""]).left(&[4, 5]);
    for (p, before) in found.parameters.iter().zip(&found.before) {
        let numbers = [significant(*before), significant(p.value), significant(p.standard_error)];
        table.row(
            std::iter::once(p.name.clone()).chain(numbers).chain([p.unit.clone(), bound(p).into()]).collect(),
        );
    }
    writeln!(
        out,
        "{}standard errors are {}; AIC {:.1}, BIC {:.1}\n",
        table.plain(),
        found.clusters,
        found.criteria.aic,
        found.criteria.bic
    )?;
    if !found.left_out.is_empty() {
        writeln!(out, "left out, as these logs would send it to a bound: {}\n", found.left_out.join(", "))?;
    }
    trims(shown, out)?;
    signals(shown, out)?;
    for (part, _, all) in shown.parts() {
        let mut table = Table::new(&["signal", &format!("residuals of the {part}"), ""]).left(&[1, 2]);
        for (name, group) in by_signal(&all.comparisons) {
            let tests = ResidualTests::new(&group, 0);
            table.row(vec![name.into(), whiteness(&tests), independence(&tests)]);
        }
        writeln!(out, "{}", table.plain())?;
    }
    for (part, before, after) in shown.parts() {
        axes(part, before, after, out)?;
    }
    Ok(())
}

/// Measured and predicted signals, in windows and over whole flights.
fn signals(shown: &ModelIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let header =
        ["log", "part", "signal", "windows: before", "fit", "RMSE", "whole flight: before", "fit", "RMSE"];
    let mut table = Table::new(&header).left(&[1, 2]);
    for (part, before, after) in shown.parts() {
        for (c, before) in after.comparisons.iter().zip(&before.comparisons) {
            let whole = |c: &Comparison| c.whole.as_ref().and_then(|f| f.fit_percent);
            table.row(vec![
                c.log.clone(),
                part.into(),
                c.signal.into(),
                percent(before.fit.fit_percent),
                percent(c.fit.fit_percent),
                rmse(&c.fit, c.unit),
                percent(whole(before)),
                percent(whole(c)),
                c.whole.as_ref().map_or("-".into(), |f| rmse(f, c.unit)),
            ]);
        }
    }
    Ok(writeln!(out, "{}", table.plain())?)
}

/// Trims of each flight.
fn trims(shown: &ModelIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let Some(first) = shown.found.fit.trims.first() else { return Ok(()) };
    let header: Vec<String> = first
        .values
        .iter()
        .map(|(name, unit, _)| if *unit == "1" { name.clone() } else { format!("{name} ({unit})") })
        .collect();
    let header: Vec<&str> =
        ["of its own: log", "part"].into_iter().chain(header.iter().map(String::as_str)).collect();
    let mut table = Table::new(&header).left(&[1]);
    for (part, _, judged) in shown.parts() {
        for trim in &judged.trims {
            let values = trim.values.iter().map(|(.., value)| significant(*value));
            table.row([trim.log.clone(), part.into()].into_iter().chain(values).collect());
        }
    }
    Ok(writeln!(out, "{}", table.plain())?)
}

/// Errors of prediction by axis and horizon, before and after.
fn axes(part: &str, before: &ModelComparison, after: &ModelComparison, out: &mut dyn Write) -> Outcome {
    if after.errors.is_empty() || before.errors.len() != after.errors.len() {
        return Ok(());
    }
    let mut table = Table::new(&[
        &format!("{part}: error of the"),
        "ahead",
        "before",
        "after",
        "unit",
        "better",
        "paired p",
    ])
    .left(&[4]);
    for change in axis_changes(&before.errors, &after.errors) {
        let value = |v: f64| significant(if change.unit == "rad" { v.to_degrees() } else { v });
        table.row(vec![
            change.axis.into(),
            format!("{} s", change.horizon_s),
            value(change.before),
            value(change.after),
            if change.unit == "rad" { "deg".into() } else { change.unit.into() },
            format!("{} of {}", change.better, change.flights),
            change.p_value.map_or(format!("fewer than {LEAST_FLIGHTS} flights"), |p| format!("{p:.1e}")),
        ]);
    }
    Ok(writeln!(out, "{}", table.plain())?)
}

/// Comparisons of one signal together, in the order of their first appearance.
pub(super) fn by_signal(all: &[Comparison]) -> Vec<(&'static str, Vec<&Comparison>)> {
    let mut groups: Vec<(&'static str, Vec<&Comparison>)> = Vec::new();
    for c in all {
        match groups.iter_mut().find(|(name, _)| *name == c.signal) {
            Some((_, group)) => group.push(c),
            None => groups.push((c.signal, vec![c])),
        }
    }
    groups
}

pub(super) fn transfer_json(all: &[TransferResult], failed: &[String], out: &mut dyn Write) -> Outcome {
    let transfer_json = |(identified, test): &TransferResult| {
        let poles: Vec<[f64; 2]> = identified.function.poles().iter().map(|p| [p.re, p.im]).collect();
        json!({"channel": identified.channel.name(), "numerator": identified.function.numerator, "denominator": identified.function.denominator,
            "delay_s": identified.function.delay_s, "offsets": identified.function.offsets, "text": identified.function.to_string(), "poles": poles,
            "parameters": estimates(&identified.parameters), "noise": identified.noise, "aic": identified.criteria.aic, "bic": identified.criteria.bic,
            "converged": identified.converged, "samples": identified.samples, "window_s": identified.window_s(), "standard_errors": identified.clusters.to_string(),
            "fit": comparisons(&identified.fit, identified.parameters.len()), "test": comparisons(test, 0)})
    };
    let all: Vec<Value> = all.iter().map(transfer_json).collect();
    serde_json::to_writer_pretty(&mut *out, &json!({"transfer_functions": all, "failed": failed}))?;
    Ok(writeln!(out)?)
}

pub(super) fn write_model_json(shown: &ModelIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let found = shown.found;
    let vertical = if found.input == VerticalInput::Height { "height" } else { found.input.name() };
    let part = |all: Option<&ModelComparison>| comparisons(all.map_or(&[], |judged| &judged.comparisons), 0);
    let value = json!({"model": found.model.name, "vertical": vertical, "parameters": estimates(&found.parameters), "before": found.before,
        "left_out": found.left_out, "noise": found.noise, "aic": found.criteria.aic, "bic": found.criteria.bic, "converged": found.converged, "samples": found.samples,
        "standard_errors": found.clusters.to_string(), "fit": part(Some(&found.fit)), "test": part(shown.test.map(|t| &t[1])),
        "before_fit": part(Some(shown.before_fit)), "before_test": part(shown.test.map(|t| &t[0])),
        "flights": shown.parts().into_iter().map(|(name, _, judged)| (name.to_owned(), flights_json(judged))).collect::<serde_json::Map<_, _>>(),
        "axis_errors": shown.parts().into_iter().map(|(name, before, after)| (name.to_owned(), axes_json(before, after))).collect::<serde_json::Map<_, _>>()});
    serde_json::to_writer_pretty(&mut *out, &value)?;
    Ok(writeln!(out)?)
}

/// Trims and errors of each flight.
fn flights_json(judged: &ModelComparison) -> Value {
    let values = |trim: &vehicle::NuisanceParameters| -> serde_json::Map<String, Value> {
        trim.values
            .iter()
            .map(|(name, unit, value)| (name.clone(), json!({"value": value, "unit": unit})))
            .collect()
    };
    let trims: Vec<Value> =
        judged.trims.iter().map(|trim| json!({"log": trim.log, "own": values(trim)})).collect();
    let errors: Vec<Value> = judged
        .errors
        .iter()
        .map(|e| json!({"log": e.flight, "predictions": e.predictions, "rms": e.rms}))
        .collect();
    json!({"own": trims, "errors": errors})
}

fn axes_json(before: &ModelComparison, after: &ModelComparison) -> Value {
    let change = |c: AxisChange| {
        json!({"axis": c.axis, "unit": c.unit, "horizon_s": c.horizon_s, "before": c.before, "after": c.after, "better": c.better,
            "flights": c.flights, "p_value": c.p_value})
    };
    axis_changes(&before.errors, &after.errors).into_iter().map(change).collect()
}

pub(super) fn estimates(all: &[ParameterEstimate]) -> Vec<Value> {
    let error = |e: f64| e.is_finite().then_some(e);
    let estimate = |p: &ParameterEstimate| json!({"name": p.name, "unit": p.unit, "value": p.value, "standard_error": error(p.standard_error), "at_bound": p.at_bound});
    all.iter().map(estimate).collect()
}

fn comparisons(all: &[Comparison], parameters: usize) -> Value {
    let fit = |f: &Fit| json!({"fit_percent": f.fit_percent, "rmse": f.rmse, "mae": f.mae, "max_error": f.max_error});
    let comparison = |c: &Comparison| json!({"log": c.log, "signal": c.signal, "unit": c.unit, "samples": c.t_s.len(), "windows": fit(&c.fit), "whole": c.whole.as_ref().map(fit)});
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
