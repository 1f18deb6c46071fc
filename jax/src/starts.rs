//! The starts of episodes as a table: numbers that are the same in all of them are written once.

use std::fmt::Write as _;

use crazyflie_env::recording::Recording;

/// Python lines of the starts' numbers: a list with each number that is the same in all of them, and `None` for the
/// others; then a table of these, a row for each.
pub(crate) fn write_starts(recording: &Recording) -> String {
    let common = recording.common_numbers();
    let words: Vec<String> =
        common.iter().map(|number| number.map_or_else(|| "None".into(), |n| format!("{n:?}"))).collect();
    let mut text = format!("START = ({},)\nSTARTS = np.array(\"\"\"\n", words.join(", "));
    let columns = (0..common.len()).filter(|i| common[*i].is_none());
    let mut rows = 0;
    for i in columns {
        let numbers: Vec<String> =
            recording.starts.iter().map(|start| format!("{:?}", start.numbers[i])).collect();
        writeln!(text, "{}", numbers.join(" ")).unwrap_or_default();
        rows += 1;
    }
    let starts = recording.starts.len();
    writeln!(text, "\"\"\".split(), float).reshape({rows}, {starts})").unwrap_or_default();
    text
}
