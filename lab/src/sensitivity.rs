//! Answers that change when a threshold of the search is another.

use anyhow::Result;
use crazyflie_identify::explain::threshold::Threshold;
use serde::{Deserialize, Serialize};

use crate::case_file::CaseFile;
use crate::record::CaseRecord;
use crate::scoring::{Schedule, score_all};

/// Factors by which each threshold is tried.
const FACTORS: [f64; 2] = [0.7, 1.4];

/// The same cases with a threshold that is scaled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensitivityRow {
    /// Stage and name.
    pub threshold: String,
    pub declared: f64,
    pub factor: f64,
    /// Cases that are answered right.
    pub right: usize,
    /// Cases with a name of what is not there.
    pub wrong_names: usize,
    /// Cases whose names or verdict are other than with the declared threshold.
    pub changed: Vec<String>,
}

impl SensitivityRow {
    fn new(threshold: &Threshold, factor: f64, baseline: &[CaseRecord], records: &[CaseRecord]) -> Self {
        let pairs = baseline.iter().zip(records);
        SensitivityRow {
            threshold: threshold.path(),
            declared: threshold.declared(),
            factor,
            right: records.iter().filter(|r| r.score.criteria.named).count(),
            wrong_names: records.iter().filter(|r| !r.score.extra.is_empty()).count(),
            changed: pairs.filter(|(a, b)| answer(a) != answer(b)).map(|(a, _)| a.case.clone()).collect(),
        }
    }
}

/// Verdict and names of an explanation, with the rivals of each.
fn answer(record: &CaseRecord) -> (&str, Vec<Vec<&str>>) {
    let mut names: Vec<Vec<&str>> = record
        .named_effects()
        .map(|effect| {
            let rivals = effect.confusable_with.iter().map(String::as_str);
            let mut group: Vec<&str> = rivals.chain([effect.name.as_str()]).collect();
            group.sort_unstable();
            group
        })
        .collect();
    names.sort_unstable();
    (&record.verdict, names)
}

/// Explains the cases anew with each threshold scaled by each of [`FACTORS`], one after the other.
/// `baseline` are the records with the declared thresholds.
pub fn measure_sensitivity(
    cases: &[CaseFile],
    schedule: Schedule,
    baseline: &[CaseRecord],
    thresholds: &[&Threshold],
) -> Result<Vec<SensitivityRow>> {
    let schedule = Schedule { with_oracle: false, ..schedule };
    let mut rows = Vec::new();
    for threshold in thresholds {
        for factor in FACTORS {
            eprintln!("{} x{factor}", threshold.path());
            threshold.scale(factor);
            let records = score_all(cases, schedule, None);
            threshold.scale(1.0);
            rows.push(SensitivityRow::new(threshold, factor, baseline, &records?));
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{NamedEffect, tests};

    fn record(case: &str, verdict: &str, names: &[(&str, &[&str])], named: bool) -> CaseRecord {
        let effect = |(name, rivals): &(&str, &[&str])| NamedEffect {
            name: (*name).to_owned(),
            params: Vec::new(),
            confusable_with: rivals.iter().map(|&rival| rival.to_owned()).collect(),
            worth_fit: None,
            worth_test: None,
            with: Vec::new(),
        };
        CaseRecord {
            case: case.into(),
            verdict: verdict.into(),
            effects: names.iter().map(effect).collect(),
            ..tests::record("single", &[], named)
        }
    }

    #[test]
    fn the_order_of_names_and_rivals_is_no_other_answer() {
        let before = [
            record("d0", "explained", &[("wind", &["imu_tilt"]), ("flap", &[])], true),
            record("d1", "explained", &[("wind", &[])], true),
            record("d2", "explained", &[], true),
        ];
        let after = [
            record("d0", "explained", &[("flap", &[]), ("imu_tilt", &["wind"])], true),
            record("d1", "explained", &[("gust", &[])], false),
            record("d2", "unexplained", &[], true),
        ];
        let threshold =
            crazyflie_identify::explain::threshold::all().find(|t| t.path() == "search.CLEAR").unwrap();
        let row = SensitivityRow::new(threshold, 0.7, &before, &after);
        assert_eq!((row.right, row.declared), (2, 4.0));
        assert_eq!(row.changed, ["d1", "d2"]);
    }
}
