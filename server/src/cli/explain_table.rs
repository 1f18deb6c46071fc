//! What `crazyflie explain` prints.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_identify::explain::errors::{Errors, HORIZONS};
use crazyflie_identify::explain::verdict::{Explanation, Finding};

use super::{Outcome, Table, files::vertical_name, number};
use crate::explained::{
    Run, change_percent, closed_loop_line, confusable, findings, foreign_line, horizon, p_value, sentence, signal_lines, signed,
    significant, total_lines, with_error,
};

pub(super) fn print(run: &Run, written: &[PathBuf], out: &mut dyn Write) -> Outcome {
    let found = &run.found;
    if let Some(line) = foreign_line(run) {
        writeln!(out, "{line}\n")?;
    }
    writeln!(out, "model {}, vertical form {}\n{}\n", run.model.name, vertical_name(run.vertical()), sentence(found))?;
    if !(found.effects.is_empty() && found.partial.is_empty() && found.confirmed.is_empty()) {
        writeln!(
            out,
            "{}worth: log-likelihood lost without the effect, on the flights of the fit and of the test\n",
            effects(found).plain()
        )?;
    }
    if !found.confirmed.is_empty() {
        let names: Vec<&str> = found.confirmed.iter().map(|e| e.name).collect();
        writeln!(out, "the model holds already, and needs: {}", names.join(", "))?;
    }
    if !found.needless.is_empty() {
        writeln!(out, "the model holds, and predictions do not miss: {}", found.needless.join(", "))?;
    }
    for number in &found.numbers {
        writeln!(out, "{} {} -> {} {}", number.path, significant(number.declared, 4), significant(number.value, 4), number.unit)?;
    }
    for line in total_lines(run) {
        writeln!(out, "{line}")?;
    }
    for effect in found.effects.iter().filter(|e| !e.manoeuvre.is_empty()) {
        writeln!(out, "to tell {} from {}: {}", effect.name, confusable(effect), effect.manoeuvre)?;
    }
    for line in signal_lines(found) {
        writeln!(out, "{line}")?;
    }
    left(found, out)?;
    writeln!(out, "\nerrors of prediction on the test flights, RMS\n{}", errors(&found.errors).plain())?;
    if let Some(line) = closed_loop_line(run) {
        writeln!(out, "{line}")?;
    }
    let names: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
    Ok(writeln!(out, "written in {} s: {}", number(found.seconds, 0), names.join(", "))?)
}

fn effects(found: &Explanation) -> Table {
    let mut table = Table::new(&["effect", "parameter", "declared", "value", "unit", "worth, fit", "test", "or instead"]).left(&[1, 4, 7]);
    for effect in found.effects.iter().chain(&found.partial).chain(&found.confirmed).flat_map(Finding::all) {
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

fn left(found: &Explanation, out: &mut dyn Write) -> Outcome {
    let all = findings(found);
    if all.is_empty() {
        return Ok(writeln!(out, "left: nothing beyond chance")?);
    }
    for one in all {
        writeln!(out, "left: {}, {}", one.signal, one.finding)?;
    }
    Ok(())
}

fn errors(errors: &Errors) -> Table {
    let mut table = Table::new(&["", "ahead", "declared", "completed", "no model", "change", "p"]).left(&[1]);
    let quantities = [("position (m)", 1.0), ("velocity (m/s)", 1.0), ("attitude (deg)", 1.0_f64.to_radians())];
    for (q, (name, one)) in quantities.into_iter().enumerate() {
        for h in 0..HORIZONS.len() {
            let [before, after, naive] = [&errors.before, &errors.after, &errors.naive].map(|t| t[q][h] / one);
            table.row(vec![
                if h == 0 { name.into() } else { String::new() },
                horizon(h),
                significant(before, 3),
                significant(after, 3),
                significant(naive, 3),
                change_percent(before, after).map_or("-".into(), signed),
                p_value(errors.p_value[q][h]),
            ]);
        }
    }
    table
}
