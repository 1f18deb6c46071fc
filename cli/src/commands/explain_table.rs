//! Output of `crazyflie explain`.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_identify::explain::errors::AXES;
use crazyflie_identify::explain::signals::Signal;
use crazyflie_identify::explain::verdict::{Explanation, Finding};

use super::{Outcome, Table, number};
use crate::explanation::{
    NextStep, Run, SHORT_HORIZONS, ahead, axis_units, change_percent, closed_loop_line, confusable,
    flight_axis_errors, foreign_sentence, next_steps, p_value, sentence, shared_trim_lines, signal_rows,
    signed_percent, significant, total_lines, with_error,
};

pub(super) fn print(run: &Run, written: &[PathBuf], out: &mut dyn Write) -> Outcome {
    let found = &run.found;
    let foreign = run.foreign_model();
    writeln!(out, "{}", sentence(found))?;
    if let Some(foreign) = &foreign {
        writeln!(out, "{}", foreign_sentence(run, foreign))?;
    }
    writeln!(out, "model {}, vertical form {}\n", run.model.name, run.vertical().name())?;
    signals(run, out)?;
    for line in shared_trim_lines(run) {
        writeln!(out, "{line}")?;
    }
    if !found.effects.is_empty() {
        write!(out, "\nmissing\n{}", effects(&found.effects).plain())?;
        for line in total_lines(run) {
            writeln!(out, "{line}")?;
        }
    }
    if !found.partial.is_empty() {
        write!(out, "\nlowers the errors, accounts for nothing\n{}", effects(&found.partial).plain())?;
    }
    if !found.corrections.is_empty() {
        write!(
            out,
            "\nno causes of their own: they make up for declared numbers\n{}",
            effects(&found.corrections).plain()
        )?;
    }
    if !found.confirmed.is_empty() {
        write!(out, "\nthe model holds it already, and needs it\n{}", effects(&found.confirmed).plain())?;
    }
    if ![&found.effects, &found.partial, &found.corrections, &found.confirmed].into_iter().all(Vec::is_empty)
    {
        writeln!(
            out,
            "worth: log-likelihood lost without the effect, on the flights of the fit and of the test"
        )?;
    }
    if !found.needless.is_empty() {
        writeln!(out, "the model holds, and predictions do not miss: {}", found.needless.join(", "))?;
    }
    if !found.numbers.is_empty() {
        writeln!(out, "\nnumbers of the model, fitted beside the effects")?;
    }
    for number in &found.numbers {
        writeln!(
            out,
            "{} {} -> {} {}",
            number.path,
            significant(number.declared, 4),
            significant(number.value, 4),
            number.unit
        )?;
    }
    writeln!(out, "\nerrors of prediction on the test flights, RMS\n{}", errors(found).plain())?;
    writeln!(out, "errors of each test flight, 2 s ahead\n{}", flights(run).plain())?;
    if let Some(line) = closed_loop_line(run) {
        writeln!(out, "{line}\n")?;
    }
    let names: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
    writeln!(out, "written in {} s: {}", number(found.seconds, 0), names.join(", "))?;
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

fn effects(of: &[Finding]) -> Table {
    let mut table =
        Table::new(&["effect", "parameter", "declared", "value", "unit", "worth, fit", "test", "or instead"])
            .left(&[1, 4, 7]);
    for effect in of.iter().flat_map(Finding::all) {
        for (i, e) in effect.params.iter().enumerate() {
            // what concerns the effect stands in its first line only
            let once = |text: String| if i == 0 { text } else { String::new() };
            table.row(vec![
                once(effect.name.into()),
                e.name.into(),
                significant(e.declared, 3),
                with_error(e.value, e.stderr),
                e.unit.into(),
                once(number(effect.worth_fit, 0)),
                once(number(effect.worth_test, 0)),
                once(confusable(effect)),
            ]);
        }
    }
    table
}

fn errors(found: &Explanation) -> Table {
    let mut table =
        Table::new(&["", "ahead", "declared", "completed", "no model", "unit", "change", "p"]).left(&[1, 5]);
    let axes = &found.errors.axes;
    for axis in 0..AXES.len() {
        let (name, unit, one) = axis_units(axis);
        for (i, h) in SHORT_HORIZONS.into_iter().enumerate() {
            let [before, after, naive] = [&axes.before, &axes.after, &axes.naive].map(|t| t[axis][h] / one);
            table.row(vec![
                if i == 0 { name.into() } else { String::new() },
                ahead(h),
                significant(before, 3),
                significant(after, 3),
                significant(naive, 3),
                unit.into(),
                change_percent(before, after).map_or("-".into(), signed_percent),
                p_value(axes.p_value[axis][h], axes.stretches[axis][h]),
            ]);
        }
    }
    table
}

fn flights(run: &Run) -> Table {
    let mut table = Table::new(&["flight", "sideways (m/s)", "vertical (m/s)", "tilt (deg)", "yaw (deg)"]);
    for (source, errors) in run.test.sources.iter().zip(&run.found.errors.flights) {
        let cell = |signal: Signal| {
            let (.., one) = axis_units(signal.error_row());
            let [before, after] = flight_axis_errors(errors, signal).map(|e| significant(e / one, 2));
            format!("{before} -> {after}")
        };
        table.row(std::iter::once(source.name.clone()).chain(Signal::ALL.map(cell)).collect());
    }
    table
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
