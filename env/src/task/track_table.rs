//! A track given by points in time.

use crate::error::{Error, Result, out_of_range};
use crate::lanes::LANES;
use crate::observation::Setpoint;
use crate::scalar::Scalar;

/// Columns of a track, in order; the last may be absent.
pub const TRACK_COLUMNS: [&str; 5] = ["t_s", "x_m", "y_m", "z_m", "yaw_rad"];

/// Most rows of a track: half an hour at 50 Hz.
const MOST_ROWS: usize = 100_000;

/// Smallest and largest value of each column.
const BOUNDS: [[f64; 2]; 5] = [
    [0.0, 3600.0],
    [-2.4, 2.4],
    [-2.4, 2.4],
    [0.0, 2.6],
    [-1000.0 * std::f64::consts::TAU, 1000.0 * std::f64::consts::TAU],
];

/// Rows of [`TRACK_COLUMNS`], later ones later in time, the heading without jumps of a whole turn.
pub(crate) struct TrackTable {
    rows: Vec<[f64; 5]>,
}

impl TrackTable {
    /// None for no rows.
    ///
    /// # Errors
    /// [`Error::Shape`] for rows of another length, [`Error::Range`] for points out of the room and for times
    /// out of order.
    pub(crate) fn from_rows(given: &[Vec<f64>]) -> Result<Option<Self>> {
        let most = 1..=MOST_ROWS;
        if given.is_empty() {
            return Ok(None);
        }
        if !most.contains(&given.len()) {
            return Err(out_of_range(
                "the number of points",
                given.len() as f64,
                format!("at most {MOST_ROWS}"),
            ));
        }
        let mut rows: Vec<[f64; 5]> = Vec::with_capacity(given.len());
        for (i, row) in given.iter().enumerate() {
            if row.len() != given[0].len() || !(4..=5).contains(&row.len()) {
                return Err(Error::Config(format!(
                    "points[{i}] has {} numbers, expected 4 (t_s, x_m, y_m, z_m) or 5 (and yaw_rad), in every row the same",
                    row.len()
                )));
            }
            let mut full = [0.0; 5];
            full[..row.len()].copy_from_slice(row);
            let earliest_s = rows.last().map_or(0.0, |last| last[0]);
            for (j, (value, [low, high])) in full.iter().zip(BOUNDS).enumerate() {
                let low = if j == 0 { earliest_s } else { low };
                // times rise from row to row
                let repeated = j == 0 && i > 0 && *value <= low;
                if repeated || !(low..=high).contains(value) {
                    let above = if j == 0 && i > 0 { "more than " } else { "" };
                    return Err(out_of_range(
                        format!("points[{i}][{j}] ({})", TRACK_COLUMNS[j]),
                        *value,
                        format!("{above}{low} to {high}"),
                    ));
                }
            }
            if let Some(last) = rows.last() {
                // the short way round
                let turn = full[4] - last[4];
                full[4] = last[4] + turn - std::f64::consts::TAU * libm::rint(turn / std::f64::consts::TAU);
            }
            rows.push(full);
        }
        Ok(Some(TrackTable { rows }))
    }

    /// Position and heading at a time: straight between rows, still before the first and behind the last.
    pub(crate) fn interpolate(&self, t_s: f64) -> [f64; 4] {
        let next = self.rows.partition_point(|row| row[0] <= t_s);
        let (before, after) = (&self.rows[next.saturating_sub(1)], &self.rows[next.min(self.rows.len() - 1)]);
        let span_s = after[0] - before[0];
        let share = if span_s > 0.0 { ((t_s - before[0]) / span_s).clamp(0.0, 1.0) } else { 0.0 };
        let mut pose: [f64; 4] =
            std::array::from_fn(|i| before[i + 1] + share * (after[i + 1] - before[i + 1]));
        pose[3] -= std::f64::consts::TAU * libm::rint(pose[3] / std::f64::consts::TAU);
        pose
    }

    #[inline(always)]
    pub(crate) fn setpoint<R: Scalar>(&self, t_s: R) -> Setpoint<R> {
        let mut setpoint = Setpoint::<R>::origin();
        for lane in 0..LANES {
            let [x, y, z, yaw_rad] = self.interpolate(t_s.lane(lane));
            for (slot, value) in setpoint.pos_m.iter_mut().zip([x, y, z]) {
                slot.set_lane(lane, value);
            }
            setpoint.yaw_rad.set_lane(lane, yaw_rad);
        }
        setpoint
    }
}

/// The rows of a track in a CSV file, for the option `points` of the task `track`. Its first line names the
/// columns, [`TRACK_COLUMNS`] in any order; `t`, `x`, `y`, `z`, `yaw` and `yaw_deg` are understood too. `name`
/// is the file's, for errors.
///
/// # Errors
/// [`Error::Config`] with file, line and column.
pub fn track_rows(text: &str, name: &str) -> Result<Vec<Vec<f64>>> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let wrong = |line: usize, words: String| Error::Config(format!("{name}, line {}: {words}", line + 1));
    let Some((first, header)) = lines.next() else {
        return Err(wrong(0, format!("no columns, expected {}", TRACK_COLUMNS.join(","))));
    };
    let titles: Vec<&str> = header.trim_start_matches('\u{feff}').split(',').map(str::trim).collect();
    let columns = find_columns(&titles).map_err(|words| wrong(first, words))?;
    let mut rows = Vec::new();
    for (line, text) in lines {
        let cells: Vec<&str> = text.split(',').map(str::trim).collect();
        if cells.len() != titles.len() {
            let words = format!("{} columns, expected {} as in the first line", cells.len(), titles.len());
            return Err(wrong(line, words));
        }
        let row: Result<Vec<f64>> = columns
            .iter()
            .map(|(at, factor)| match cells[*at].parse::<f64>() {
                Ok(number) if number.is_finite() => Ok(number * factor),
                _ => {
                    Err(wrong(line, format!("column {} is {:?}, expected a number", titles[*at], cells[*at])))
                }
            })
            .collect();
        rows.push(row?);
        let made = TrackTable::from_rows(&rows[rows.len().saturating_sub(2)..]);
        made.map_err(|error| match error {
            // the last two rows are checked: the numbers of the rows are not those of the file
            Error::Range { name, value, want } => {
                let column =
                    name.split_once('(').map_or(&name[..], |(_, column)| column.trim_end_matches(')'));
                wrong(line, format!("column {column} is {value}, expected {want}"))
            }
            other => wrong(line, other.to_string()),
        })?;
    }
    if rows.is_empty() {
        return Err(wrong(first, "no rows follow it".into()));
    }
    Ok(rows)
}

/// Column of the file and factor for each of [`TRACK_COLUMNS`] that it has, or words about what is wrong.
fn find_columns(titles: &[&str]) -> std::result::Result<Vec<(usize, f64)>, String> {
    let mut places: [Option<(usize, f64)>; 5] = [None; 5];
    for (at, title) in titles.iter().enumerate() {
        let (place, factor) = match TRACK_COLUMNS.iter().position(|known| {
            known == title || known.split_once('_').is_some_and(|(short, _)| short == *title)
        }) {
            Some(place) => (place, 1.0),
            None if *title == "yaw_deg" => (4, std::f64::consts::PI / 180.0),
            None => return Err(crate::error::unknown("column", title, TRACK_COLUMNS).to_string()),
        };
        if places[place].replace((at, factor)).is_some() {
            return Err(format!("column {} is there twice", TRACK_COLUMNS[place]));
        }
    }
    match (0..4).find(|i| places[*i].is_none()) {
        Some(missing) => Err(format!("there is no column {}", TRACK_COLUMNS[missing])),
        None => Ok(places.into_iter().flatten().collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_straight_between_its_rows_and_turns_the_short_way() {
        let rows = [vec![1.0, 0.0, 0.0, 0.5, 3.0], vec![3.0, 1.0, -1.0, 1.5, -3.0]];
        let table = TrackTable::from_rows(&rows).unwrap().unwrap();
        assert_eq!(table.interpolate(0.0), [0.0, 0.0, 0.5, 3.0]);
        let [x, y, z, yaw] = table.interpolate(2.0);
        assert_eq!([x, y, z], [0.5, -0.5, 1.0]);
        assert!((yaw.abs() - std::f64::consts::PI).abs() < 1e-9, "{yaw}");
        assert_eq!(table.interpolate(9.0)[..3], [1.0, -1.0, 1.5]);
    }

    #[test]
    fn a_csv_file_is_read_in_any_order_of_columns() {
        let rows =
            track_rows("x_m, t, z_m,y_m,yaw_deg\n0.5,0,0.7,0,90\n\n1,2.5,0.8,-1,180\n", "a.csv").unwrap();
        assert_eq!(rows[1][..4], [2.5, 1.0, -1.0, 0.8]);
        assert!((rows[0][4] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!(track_rows("t_s,x_m,y_m,z_m\n0,0,0,1\n", "a.csv").unwrap().iter().all(|row| row.len() == 4));
    }

    #[test]
    fn a_bad_csv_file_is_refused_with_file_line_and_column() {
        for (text, words) in [
            ("", vec!["a.csv, line 1", "t_s,x_m"]),
            ("t_s,x_m,y_m\n0,0,0", vec!["a.csv, line 1", "no column z_m"]),
            ("t_s,x_m,y_m,zz_m\n0,0,0,1", vec!["a.csv, line 1", "zz_m", "did you mean \"z_m\""]),
            ("t_s,t,x_m,y_m,z_m\n0,0,0,0,1", vec!["line 1", "t_s is there twice"]),
            ("t_s,x_m,y_m,z_m\n", vec!["line 1", "no rows"]),
            ("t_s,x_m,y_m,z_m\n0,0,0,1\n1,0,0", vec!["line 3", "3 columns, expected 4"]),
            ("t_s,x_m,y_m,z_m\n0,0,0,1\n1,0,up,1", vec!["line 3", "column y_m is \"up\""]),
            ("t_s,x_m,y_m,z_m\n0,0,nan,1", vec!["line 2", "column y_m", "nan"]),
            ("t_s,x_m,y_m,z_m\n0,0,0,1\n2,0,0,1\n2,0,0,1", vec!["line 4", "column t_s is 2", "more than 2"]),
            ("t_s,x_m,y_m,z_m\n0,0,0,1\n1,0,0,9", vec!["line 3", "column z_m is 9", "0 to 2.6"]),
        ] {
            let error = track_rows(text, "a.csv").unwrap_err().to_string();
            assert!(words.iter().all(|word| error.contains(word)), "{text:?} gave: {error}");
        }
    }
}
