//! Tables as text and as Markdown.

use std::fmt::Write;

/// A table; the first column is set flush left, so are columns named in `left`.
#[derive(Debug, Default)]
pub(crate) struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    left: Vec<usize>,
}

impl Table {
    pub(crate) fn new(header: &[&str]) -> Self {
        Table { header: header.iter().map(|&h| h.to_owned()).collect(), rows: Vec::new(), left: vec![0] }
    }

    /// Sets these columns flush left.
    pub(crate) fn left(mut self, columns: &[usize]) -> Self {
        self.left.extend(columns);
        self
    }

    pub(crate) fn row(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
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
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!([number(-0.001, 2), number(-0.1, 1), number(2.0, 0)], ["0.00", "-0.1", "2"]);
    }
}
