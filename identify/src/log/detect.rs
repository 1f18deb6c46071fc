//! Which format a header belongs to, and which columns it lacks.

use super::table::Table;
use super::{Format, LogError, MissingColumn, Note, hidden_effects, nanobench, nanodrone, project};

/// With a smaller share of a format's columns than this, a file is not taken for that format at all.
const LEAST_SHARE: f64 = 0.3;
/// Jaro-Winkler similarity from which a name is offered as a misspelling (`imu_rol_deg` for `imu_roll_deg` has 0.98).
const ALIKE: f64 = 0.85;

/// The columns a format needs and the ones it may have besides.
struct Columns {
    format: Format,
    required: Vec<&'static str>,
    optional: Vec<&'static str>,
}

impl Columns {
    fn of(format: Format, table: &Table) -> Self {
        let (mut required, optional) = match format {
            Format::NanoBench => (nanobench::REQUIRED.to_vec(), nanobench::OPTIONAL.to_vec()),
            Format::NanoDrone => (nanodrone::REQUIRED.to_vec(), nanodrone::OPTIONAL.to_vec()),
            Format::HiddenEffects => (hidden_effects::REQUIRED.to_vec(), Vec::new()),
            // The others are no tables.
            _ => (project::REQUIRED.to_vec(), project::OPTIONAL.to_vec()),
        };
        // Part of the truth is a mistake, not a choice.
        if format == Format::Project && project::TRUTH.iter().any(|c| table.has(c)) {
            required.extend(project::TRUTH);
        }
        Self { format, required, optional }
    }

    fn share_in(&self, table: &Table) -> f64 {
        let found = self.required.iter().filter(|c| table.has(c)).count();
        found as f64 / self.required.len() as f64
    }

    fn knows(&self, column: &str) -> bool {
        self.required.contains(&column) || self.optional.contains(&column)
    }
}

/// Chooses the format whose columns the header holds most of, and checks that it holds them all.
pub(super) fn format(table: &Table, notes: &mut Vec<Note>) -> Result<Format, LogError> {
    let mut best: Option<(f64, Columns)> = None;
    for format in [Format::Project, Format::NanoBench, Format::HiddenEffects, Format::NanoDrone] {
        let columns = Columns::of(format, table);
        let share = columns.share_in(table);
        if share >= LEAST_SHARE && best.as_ref().is_none_or(|(most, _)| share > *most) {
            best = Some((share, columns));
        }
    }
    let Some((_, columns)) = best else {
        return Err(LogError::UnknownFormat { file: table.file.clone(), found: table.header.join(", ").chars().take(200).collect() });
    };
    let unknown: Vec<&String> = table.header.iter().filter(|c| !columns.knows(c)).collect();
    let missing = missing(&columns, table, &unknown);
    if !missing.is_empty() {
        return Err(LogError::MissingColumns { file: table.file.clone(), format: columns.format, missing });
    }
    if !unknown.is_empty() {
        let columns = unknown.into_iter().cloned().collect();
        notes.push(Note::IgnoredColumns { columns });
    }
    Ok(columns.format)
}

fn missing(columns: &Columns, table: &Table, unknown: &[&String]) -> Vec<MissingColumn> {
    let mut missing: Vec<MissingColumn> = columns
        .required
        .iter()
        .filter(|c| !table.has(c))
        .map(|c| MissingColumn { name: (*c).to_owned(), did_you_mean: closest(c, unknown) })
        .collect();
    let has_vertical = project::VERTICAL.iter().any(|c| table.has(c));
    if columns.format == Format::Project && !has_vertical {
        missing.push(MissingColumn {
            name: project::VERTICAL.join(" or "),
            did_you_mean: project::VERTICAL.iter().find_map(|c| closest(c, unknown)),
        });
    }
    missing
}

fn closest(column: &str, unknown: &[&String]) -> Option<String> {
    unknown
        .iter()
        .map(|name| (strsim::jaro_winkler(column, name), *name))
        .filter(|(alike, _)| *alike >= ALIKE)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name.clone())
}
