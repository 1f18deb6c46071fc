//! The view of a result: tables as text and as Markdown, values with their units, and JSON.

use std::fmt::{self, Display, Write as _};
use std::io::Write;

use serde::Serialize;

use crate::failure::Outcome;

/// A table. Of `R` is what each row tells of, for the columns that are still to come.
#[derive(Debug, Default)]
pub(crate) struct Table<R = ()> {
    of: Vec<R>,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    left: Vec<usize>,
}

impl Table {
    /// A table of cells; the first column is set flush left.
    pub(crate) fn new(header: &[&str]) -> Self {
        Table { header: header.iter().map(|&h| h.to_owned()).collect(), left: vec![0], ..Table::default() }
    }

    /// Sets these columns flush left.
    pub(crate) fn left(mut self, columns: &[usize]) -> Self {
        self.left.extend(columns);
        self
    }

    pub(crate) fn row(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }
}

impl<R: Copy> Table<R> {
    /// A row for each of these, without columns.
    pub(crate) fn of(of: impl IntoIterator<Item = R>) -> Self {
        let of: Vec<R> = of.into_iter().collect();
        Table { header: Vec::new(), rows: vec![Vec::new(); of.len()], left: Vec::new(), of }
    }

    /// With a column of words, which are set flush left.
    pub(crate) fn words<C: Display>(mut self, header: impl Into<String>, cell: impl Fn(R) -> C) -> Self {
        self.left.push(self.header.len());
        self.values(header, cell)
    }

    /// With a column of values, which are set flush right.
    pub(crate) fn values<C: Display>(mut self, header: impl Into<String>, cell: impl Fn(R) -> C) -> Self {
        self.header.push(header.into());
        self.rows.iter_mut().zip(&self.of).for_each(|(row, of)| row.push(cell(*of).to_string()));
        self
    }
}

impl<R> Table<R> {
    /// As Markdown, if that is asked for.
    pub(crate) fn text(&self, markdown: bool) -> String {
        if markdown { self.markdown() } else { self.plain() }
    }

    /// Columns padded with spaces.
    pub(crate) fn plain(&self) -> String {
        let lines = || std::iter::once(&self.header).chain(&self.rows);
        let width = |column: usize| {
            lines().filter_map(|l| l.get(column)).map(|c| c.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.header.len()).map(width).collect();
        let mut text = String::new();
        for line in lines() {
            let mut built = String::new();
            for (column, (cell, width)) in line.iter().zip(&widths).enumerate() {
                let gap = " ".repeat(width - cell.chars().count());
                let between = if column == 0 { "" } else { "  " };
                built += between;
                built += &if self.left.contains(&column) {
                    format!("{cell}{gap}")
                } else {
                    format!("{gap}{cell}")
                };
            }
            text += built.trim_end();
            text.push('\n');
        }
        text
    }

    /// As Markdown; a bar within a cell is escaped.
    pub(crate) fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            format!("| {} |\n", cells.iter().map(|c| c.replace('|', "\\|")).collect::<Vec<_>>().join(" | "))
        };
        let mut text = line(&self.header);
        let rule: Vec<&str> =
            (0..self.header.len()).map(|c| if self.left.contains(&c) { "---" } else { "---:" }).collect();
        let _ = writeln!(text, "|{}|", rule.join("|"));
        self.rows.iter().for_each(|row| text += &line(row));
        text
    }
}

impl<R> Display for Table<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.plain())
    }
}

/// Writes a result for machines, as JSON over several lines.
pub(crate) fn write_json(result: &(impl Serialize + ?Sized), out: &mut dyn Write) -> Outcome {
    serde_json::to_writer_pretty(&mut *out, result)?;
    Ok(writeln!(out)?)
}

/// What there is; a dash where there is nothing.
pub(crate) fn or_dash<T: Display>(value: Option<T>) -> String {
    value.map_or("-".into(), |value| value.to_string())
}

/// A number with so many decimals and its unit; a dash where there is none.
pub(crate) fn quantity(value: f64, decimals: usize, unit: &str) -> String {
    or_dash(value.is_finite().then(|| format!("{} {unit}", number(value, decimals))))
}

/// A fit in percent with so many decimals. A free run of an integrator leaves any frame.
pub(crate) fn percent(fit: Option<f64>, decimals: usize) -> String {
    match fit {
        Some(fit) if fit < -9999.0 => "< -9999 %".into(),
        fit => quantity(fit.unwrap_or(f64::NAN), decimals, "%"),
    }
}

/// Seconds with so many decimals, until what may never happen.
pub(crate) fn seconds(value: Option<f64>, decimals: usize) -> String {
    value.map_or("never".into(), |s| quantity(s, decimals, "s"))
}

/// A number with so many decimals; no minus before a zero.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| matches!(c, '0' | '.')) => rest.to_owned(),
        _ => text,
    }
}

/// An error with all that caused it; what an error repeats of its cause is said once.
pub(crate) fn with_cause(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(now) = cause {
        let more = now.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = now.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_line_up() {
        let mut t = Table::new(&["axis", "error"]);
        t.row(vec!["x".into(), "1.25 cm".into()]);
        assert_eq!(t.plain(), "axis    error\nx     1.25 cm\n");
        assert_eq!(t.markdown(), "| axis | error |\n|---|---:|\n| x | 1.25 cm |\n");
        let errors = [("x", 1.25), ("yaw", f64::NAN)];
        let t = Table::of(&errors).words("axis", |e| e.0).values("error", |e| quantity(e.1, 2, "cm"));
        assert_eq!(t.to_string(), "axis    error\nx     1.25 cm\nyaw         -\n");
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!([number(-0.001, 2), number(-0.1, 1), number(2.0, 0)], ["0.00", "-0.1", "2"]);
    }
}
