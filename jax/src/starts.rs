//! The starts of episodes as a table: numbers that are the same in all of them are written once.

use crazyflie_env::recording::{Recording, common_numbers};

/// Python lines of the starts' numbers: a list with each number that is the same in all of them, and `None` for the
/// others; then a table of these, a row for each.
pub(crate) fn write_starts(recording: &Recording) -> String {
    let common = common_numbers(&recording.starts);
    let words: Vec<String> =
        common.iter().map(|number| number.map_or_else(|| "None".into(), |n| format!("{n:?}"))).collect();
    let row = |i: usize| {
        let numbers: Vec<String> =
            recording.starts.iter().map(|start| format!("{:?}", start.numbers[i])).collect();
        numbers.join(" ")
    };
    let rows: Vec<String> = (0..common.len()).filter(|i| common[*i].is_none()).map(row).collect();
    format!(
        "START = ({},)\nSTARTS = np.array(\"\"\"\n{}\n\"\"\".split(), float).reshape({}, {})\n",
        words.join(", "),
        rows.join("\n"),
        rows.len(),
        recording.starts.len()
    )
}
