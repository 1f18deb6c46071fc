//! Output of `crazyflie explain`.

use std::fmt::Display;
use std::io::Write;
use std::path::PathBuf;

use crazyflie_identify::explain::errors::AXES;
use crazyflie_identify::explain::signals::Signal;
use crazyflie_identify::explain::verdict::{Explanation, Finding};

use super::{Outcome, Table, number, or_dash};
use crate::explanation::{
    NextStep, Run, SHORT_HORIZONS, ahead, axis_units, change_percent, closed_loop_line, confusable,
    flight_axis_errors, foreign_sentence, next_steps, p_value, sentence, shared_trim_lines, signal_rows,
    signed_percent, significant, total_lines, with_error,
};

pub(super) fn print(run: &Run, written: &[PathBuf], out: &mut dyn Write) -> Outcome {
    let explanation = &run.found;
    let foreign = run.foreign_model();
    writeln!(out, "{}", sentence(explanation))?;
    if let Some(foreign) = &foreign {
        writeln!(out, "{}", foreign_sentence(run, foreign))?;
    }
    writeln!(out, "model {}, vertical form {}\n", run.model.name, run.vertical().name())?;
    signals(run, out)?;
    for line in shared_trim_lines(run) {
        writeln!(out, "{line}")?;
    }
    let lists = [
        ("missing", &explanation.effects, total_lines(run)),
        ("lowers the errors, accounts for nothing", &explanation.partial, Vec::new()),
        ("no causes of their own: they make up for declared numbers", &explanation.corrections, Vec::new()),
        ("the model holds it already, and needs it", &explanation.confirmed, Vec::new()),
    ];
    let shown = || lists.iter().filter(|(_, findings, _)| !findings.is_empty());
    for (title, findings, totals) in shown() {
        write!(out, "\n{title}\n{}", effects(findings))?;
        for line in totals {
            writeln!(out, "{line}")?;
        }
    }
    if shown().next().is_some() {
        let flights = "on the flights of the fit and of the test";
        writeln!(out, "worth: log-likelihood lost without the effect, {flights}")?;
    }
    if !explanation.needless.is_empty() {
        writeln!(out, "the model holds, and predictions do not miss: {}", explanation.needless.join(", "))?;
    }
    if !explanation.numbers.is_empty() {
        writeln!(out, "\nnumbers of the model, fitted beside the effects")?;
    }
    for number in &explanation.numbers {
        let [declared, fitted] = [number.declared, number.value].map(|value| significant(value, 4));
        writeln!(out, "{} {declared} -> {fitted} {}", number.path, number.unit)?;
    }
    writeln!(out, "\nerrors of prediction on the test flights, RMS\n{}", errors(explanation))?;
    writeln!(out, "errors of each test flight, 2 s ahead\n{}", flights(run))?;
    if let Some(line) = closed_loop_line(run) {
        writeln!(out, "{line}\n")?;
    }
    let names: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
    writeln!(out, "written in {} s: {}", number(explanation.seconds, 0), names.join(", "))?;
    next(&next_steps(run), out)
}

/// The verdict on each signal: the share explained, what is left by axis, the structure in it.
fn signals(run: &Run, out: &mut dyn Write) -> Outcome {
    for row in signal_rows(run) {
        let [half, two] = row.explained.each_ref().map(|cell| cell.text());
        let [p_half, p_two] = &row.sure;
        let by = [("by", &row.effects), ("lowered by", &row.lowered_by)].map(|(how, names)| {
            match names.as_str() {
                "" => String::new(),
                names => format!(", {how} {names}"),
            }
        });
        writeln!(out, "{}: {}{}", row.name, row.state, by.concat())?;
        if row.is_negligible {
            writeln!(out, "  explained: no error to speak of, before or after")?;
        } else {
            writeln!(
                out,
                "  explained: {half} of the error 0.5 s ahead (p {p_half}), {two} of that 2 s ahead (p {p_two})"
            )?;
        }
        writeln!(out, "  left: {}", row.left_line())?;
        writeln!(out, "  test: {}", row.test)?;
        for finding in &row.structure {
            writeln!(out, "  left in {finding}")?;
        }
    }
    Ok(())
}

fn effects(of: &[Finding]) -> impl Display {
    let rows = of
        .iter()
        .flat_map(Finding::all)
        .flat_map(|effect| effect.params.iter().enumerate().map(move |(i, param)| (effect, i == 0, param)));
    // the first line of an effect has the columns that all its parameters share
    let once = |is_first: bool, text: String| if is_first { text } else { String::new() };
    Table::from_rows(rows)
        .words("effect", |(effect, first, _)| once(first, effect.name.into()))
        .words("parameter", |(.., e)| e.name)
        .values("declared", |(.., e)| significant(e.declared, 3))
        .values("value", |(.., e)| with_error(e.value, e.stderr))
        .words("unit", |(.., e)| e.unit)
        .values("worth, fit", |(effect, first, _)| once(first, number(effect.worth_fit, 0)))
        .values("test", |(effect, first, _)| once(first, number(effect.worth_test, 0)))
        .words("or instead", |(effect, first, _)| once(first, confusable(effect)))
}

fn errors(found: &Explanation) -> impl Display {
    let axes = &found.errors.axes;
    let error = |table: &[[f64; 5]; 6], (axis, h): (usize, usize)| table[axis][h] / axis_units(axis).2;
    let change = |cell| change_percent(error(&axes.before, cell), error(&axes.after, cell));
    let rows = (0..AXES.len()).flat_map(|axis| SHORT_HORIZONS.map(|h| (axis, h)));
    Table::from_rows(rows)
        .words("", |(axis, h)| if h == SHORT_HORIZONS[0] { axis_units(axis).0 } else { "" })
        .words("ahead", |(_, h)| ahead(h))
        .values("declared", |cell| significant(error(&axes.before, cell), 3))
        .values("completed", |cell| significant(error(&axes.after, cell), 3))
        .values("no model", |cell| significant(error(&axes.naive, cell), 3))
        .words("unit", |(axis, _)| axis_units(axis).1)
        .values("change", |cell| or_dash(change(cell).map(signed_percent)))
        .values("p", |(axis, h)| p_value(axes.p_value[axis][h], axes.stretches[axis][h]))
}

fn flights(run: &Run) -> impl Display {
    let rows = run.test.sources.iter().zip(&run.found.errors.flights);
    let table = Table::from_rows(rows).words("flight", |(source, _)| &source.name);
    let headers = ["sideways (m/s)", "vertical (m/s)", "tilt (deg)", "yaw (deg)"];
    headers.into_iter().zip(Signal::ALL).fold(table, |table, (header, signal)| {
        let (.., one) = axis_units(signal.error_row());
        table.values(header, |(_, errors)| {
            let [before, after] = flight_axis_errors(errors, signal).map(|e| significant(e / one, 2));
            format!("{before} -> {after}")
        })
    })
}

fn next(steps: &[NextStep], out: &mut dyn Write) -> Outcome {
    writeln!(out, "\nwhat to do next")?;
    for (i, step) in steps.iter().enumerate() {
        let signal = step.signal.map_or(String::new(), |signal| format!("{}: ", signal.name()));
        writeln!(out, "{}. {signal}{}", i + 1, step.text)?;
        for command in &step.commands {
            writeln!(out, "     {command}")?;
        }
    }
    Ok(())
}
