//! The starts of episodes as a table: numbers that are the same in all of them are written once.

use std::fmt::Write as _;

/// Python lines of the starts' numbers: a list with a number for each constant column, and `None` for the others;
/// then the table of these.
pub(crate) fn write_starts(rows: &[Vec<f64>]) -> String {
    let width = rows.first().map_or(0, Vec::len);
    let varies = |column: usize| rows.iter().any(|row| row[column] != rows[0][column]);
    let columns: Vec<usize> = (0..width).filter(|column| varies(*column)).collect();
    let constant = |column: usize| {
        if columns.contains(&column) { "None".to_owned() } else { format!("{:?}", rows[0][column]) }
    };
    let constants: Vec<String> = (0..width).map(constant).collect();
    let mut text = format!("START = ({},)\n", constants.join(", "));
    text.push_str("STARTS = np.array(\"\"\"\n");
    for row in rows {
        let numbers: Vec<String> = columns.iter().map(|column| format!("{:?}", row[*column])).collect();
        writeln!(text, "{}", numbers.join(" ")).unwrap_or_default();
    }
    writeln!(text, "\"\"\".split(), float).reshape({}, {})", rows.len(), columns.len()).unwrap_or_default();
    text
}
