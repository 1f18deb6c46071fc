//! Explanations held against the truth, where a case has one. The truth is read after the explanation is there.

mod told;
mod truth;

use std::path::{Path, PathBuf};

use crazyflie_identify::explain::verdict::Explanation;

use crate::explained::{Declared, ExplainError, Run};

pub(crate) use told::WORST_RATIO;
pub(crate) use truth::{HiddenEffect, Truth, TruthError};

/// A case with what was found, and the marks that the truth gives.
pub(crate) struct Scored {
    pub id: String,
    pub outcome: Result<Found, String>,
}

pub(crate) struct Found {
    pub explanation: Explanation,
    pub marks: Option<Marks>,
}

/// One mark per criterion; `None` where a criterion does not apply.
pub(crate) struct Marks {
    pub truth: Truth,
    /// Named what is hidden and nothing else, or said rightly that nothing can be named.
    pub named: bool,
    /// Every comparable parameter within 15 %.
    pub near: Option<bool>,
    /// Every comparable parameter within three standard errors.
    pub within: Option<bool>,
    /// Largest error on the held-out flight over that of a fit that was told the answer.
    pub told_ratio: Option<f64>,
}

impl Marks {
    /// Criteria by name.
    pub(crate) fn criteria(&self) -> [(&'static str, Option<bool>); 4] {
        let told = self.told_ratio.map(|r| r <= WORST_RATIO);
        [("named", Some(self.named)), ("15 %", self.near), ("3 stderr", self.within), ("held-out error", told)]
    }
}

/// The case files of a folder, in order.
pub(crate) fn cases(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if is_case(&path) {
            all.push(path);
        }
    }
    all.sort();
    Ok(all)
}

/// Whether a file is called like a case: `dNN.json`.
fn is_case(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let number = name.strip_prefix('d').and_then(|rest| rest.strip_suffix(".json"));
    number.is_some_and(|n| !n.is_empty() && n.chars().all(|c| c.is_ascii_digit()))
}

/// The name of a case by its file.
pub(crate) fn id(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// Explains one case, then reads the truth beside it.
pub(crate) fn score(path: &Path, told: bool, progress: &dyn Fn(&str)) -> Scored {
    Scored { id: id(path), outcome: found(path, told, progress) }
}

fn found(path: &Path, told: bool, progress: &dyn Fn(&str)) -> Result<Found, String> {
    let explained = |e: ExplainError| crate::cli::with_cause(&e);
    let declared = Declared::read(path).map_err(explained)?;
    let case = declared.case.ok_or_else(|| format!("{}: not a case file", path.display()))?;
    let run = Run::of(declared.model, None, [&[case.identify_on], &[case.held_out]], progress).map_err(explained)?;
    let truth = Truth::beside(path).map_err(|e: TruthError| crate::cli::with_cause(&e))?;
    let marks = truth.map(|truth| {
        progress("a fit that is told the answer");
        let told_ratio = if told { told::ratio(&run, &truth) } else { None };
        let (near, within) = truth.parameters(&run.found);
        Marks { named: truth.named(&run.found), near, within, told_ratio, truth }
    });
    Ok(Found { explanation: run.found, marks })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_no_cases() {
        let of = |name: &str| is_case(Path::new(name));
        assert!(of("x/d05.json") && !of("x/d05.answer.json") && !of("d.json") && !of("d05_a.csv.gz"));
        assert_eq!(id(Path::new("x/d05.json")), "d05");
    }
}
