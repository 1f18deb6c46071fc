//! Columns of a text format, and those that a file lacks.

use super::table::Table;
use super::{LogError, MissingColumn, Note, Result};

/// With a smaller share of a format's columns than this, a file is not taken for that format at all.
pub(crate) const LEAST_SHARE: f64 = 0.3;
/// Jaro-Winkler similarity from which a name is offered as a misspelling (`imu_rol_deg` for `imu_roll_deg`
/// has 0.98).
const ALIKE: f64 = 0.85;

/// The columns a format needs and the ones it may have besides.
pub struct Layout {
    pub(crate) required: Groups,
    pub(crate) optional: Groups,
    /// At least one of these; no demand if empty.
    pub(crate) alternatives: &'static [&'static str],
    /// All of these or none: part of them is a mistake, not a choice.
    pub(crate) together: Groups,
}

/// Columns in groups that belong together.
type Groups = &'static [&'static [&'static str]];

impl Layout {
    /// A format without columns.
    pub(crate) const NONE: Self = Self { required: &[], optional: &[], alternatives: &[], together: &[] };

    /// Returns the share of the required columns in a header.
    pub(crate) fn share(&self, header: &[String]) -> f64 {
        let required = self.required_columns(header);
        let count = required.iter().filter(|c| has(header, c)).count();
        count as f64 / required.len() as f64
    }

    /// Checks that a table has all that the format needs, and notes the columns that it does not know.
    pub(crate) fn check(&self, format: &'static str, table: &Table, notes: &mut Vec<Note>) -> Result<()> {
        let groups = [self.required, self.optional, &[self.alternatives], self.together].concat();
        let is_unknown = |c: &&String| !groups.iter().any(|group| group.contains(&c.as_str()));
        let unknown: Vec<&String> = table.header.iter().filter(is_unknown).collect();
        let missing = self.missing(&table.header, &unknown);
        if !missing.is_empty() {
            return Err(LogError::MissingColumns { file: table.file.clone(), format, missing });
        }
        if !unknown.is_empty() {
            notes.push(Note::IgnoredColumns { columns: unknown.into_iter().cloned().collect() });
        }
        Ok(())
    }

    fn required_columns(&self, header: &[String]) -> Vec<&'static str> {
        let begun = self.together.iter().copied().flatten().any(|c| has(header, c));
        let together: Groups = if begun { self.together } else { &[] };
        self.required.iter().chain(together).copied().flatten().copied().collect()
    }

    fn missing(&self, header: &[String], unknown: &[&String]) -> Vec<MissingColumn> {
        let absent = self.required_columns(header).into_iter().filter(|c| !has(header, c));
        let mut missing: Vec<MissingColumn> =
            absent.map(|c| MissingColumn { name: c.to_owned(), did_you_mean: closest(c, unknown) }).collect();
        if !self.alternatives.is_empty() && !self.alternatives.iter().any(|c| has(header, c)) {
            let did_you_mean = self.alternatives.iter().find_map(|c| closest(c, unknown));
            missing.push(MissingColumn { name: self.alternatives.join(" or "), did_you_mean });
        }
        missing
    }
}

fn has(header: &[String], column: &str) -> bool {
    header.iter().any(|name| name == column)
}

/// The candidate that is spelled most alike, if any is alike enough.
pub(crate) fn closest<S: AsRef<str>>(name: &str, candidates: &[S]) -> Option<String> {
    let scored = candidates.iter().map(AsRef::as_ref).map(|other| (strsim::jaro_winkler(name, other), other));
    let alike = scored.filter(|(alike, _)| *alike >= ALIKE).max_by(|a, b| a.0.total_cmp(&b.0));
    alike.map(|(_, candidate)| candidate.to_owned())
}
