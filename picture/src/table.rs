//! Tables as text and as Markdown.

use std::fmt::{self, Display, Write};

/// A table. `R` is the subject of each row.
#[derive(Debug)]
pub struct Table<R> {
    of: Vec<R>,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    left: Vec<usize>,
}

impl<R: Copy> Table<R> {
    /// A row for each of these, without columns.
    pub fn from_rows(rows: impl IntoIterator<Item = R>) -> Self {
        let of: Vec<R> = rows.into_iter().collect();
        Table { header: Vec::new(), rows: vec![Vec::new(); of.len()], left: Vec::new(), of }
    }

    /// With a column of words, which are set flush left.
    pub fn words<C: Display>(mut self, header: impl Into<String>, cell: impl Fn(R) -> C) -> Self {
        self.left.push(self.header.len());
        self.values(header, cell)
    }

    /// With a column of values, which are set flush right.
    pub fn values<C: Display>(mut self, header: impl Into<String>, cell: impl Fn(R) -> C) -> Self {
        self.header.push(header.into());
        self.rows.iter_mut().zip(&self.of).for_each(|(row, of)| row.push(cell(*of).to_string()));
        self
    }
}

impl<R> Table<R> {
    /// Formats the table as Markdown if `markdown`, else as plain text.
    pub fn text(&self, markdown: bool) -> String {
        if markdown { self.markdown() } else { self.plain() }
    }

    /// Columns padded with spaces.
    pub fn plain(&self) -> String {
        let lines = || std::iter::once(&self.header).chain(&self.rows);
        let width = |column: usize| {
            lines().filter_map(|l| l.get(column)).map(|c| c.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.header.len()).map(width).collect();
        let mut text = String::new();
        for line in lines() {
            let mut built = String::new();
            for (column, (cell, width)) in line.iter().zip(&widths).enumerate() {
                let gap = &*" ".repeat(width - cell.chars().count());
                let between = if column == 0 { "" } else { "  " };
                let (before, after) = if self.left.contains(&column) { ("", gap) } else { (gap, "") };
                let _ = write!(built, "{between}{before}{cell}{after}");
            }
            text += built.trim_end();
            text.push('\n');
        }
        text
    }

    /// Formats the table as Markdown; a bar within a cell is escaped.
    pub fn markdown(&self) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_line_up() {
        let t = Table::from_rows(["x"]).words("axis", |axis| axis).values("error", |_| "1.25 cm");
        assert_eq!(t.plain(), "axis    error\nx     1.25 cm\n");
        assert_eq!(t.markdown(), "| axis | error |\n|---|---:|\n| x | 1.25 cm |\n");
        let errors = [("x", 1.25), ("yaw", 0.5)];
        let t = Table::from_rows(&errors).words("axis", |e| e.0).values("error", |e| format!("{} cm", e.1));
        assert_eq!(t.to_string(), "axis    error\nx     1.25 cm\nyaw    0.5 cm\n");
    }
}
