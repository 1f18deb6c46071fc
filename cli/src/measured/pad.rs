//! Flights with a planted defect, diagnosed against the normal ones of the same recordings.

use std::path::{Path, PathBuf};

use crazyflie_env::model::Model;
use crazyflie_identify::diagnose::demand::{EffectDemand, effect_demands};
use crazyflie_identify::diagnose::{Diagnosis, diagnose};

use crate::trims::read_trims;

/// Folders of the data set: kinds of logs, in each the conditions, one of them the vehicle as it should be.
const KINDS: [&str; 2] = ["controller_data", "motor_data"];
const NORMAL: &str = "normal_flight";

pub(super) struct DefectCondition {
    pub(super) name: String,
    pub(super) diagnosis: Diagnosis,
}

pub(super) struct DefectStudy {
    pub(super) demands: Vec<EffectDemand>,
    pub(super) conditions: Vec<DefectCondition>,
}

/// `None` where the recordings are absent, or the model cannot hover by a thrust command.
pub(super) fn pad(model: &Model, folder: &Path) -> Option<DefectStudy> {
    let folders = |condition: &str| {
        KINDS
            .map(|k| folder.join(k).join(condition))
            .into_iter()
            .filter(|p| p.is_dir())
            .collect::<Vec<PathBuf>>()
    };
    let demands = effect_demands(model).ok()?;
    let normal = read_trims(&folders(NORMAL), &mut Vec::new()).ok()?;
    let mut names: Vec<String> = KINDS
        .iter()
        .flat_map(|kind| std::fs::read_dir(folder.join(kind)).into_iter().flatten().flatten())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name != NORMAL)
        .collect();
    names.sort();
    names.dedup();
    let condition = |name: String| {
        let mut unread = Vec::new();
        let suspect = read_trims(&folders(&name), &mut unread).ok()?;
        let mut diagnosis = diagnose(&normal, &suspect, &demands).ok()?;
        diagnosis.left_out.extend(unread);
        Some(DefectCondition { name, diagnosis })
    };
    let conditions: Vec<DefectCondition> = names.into_iter().filter_map(condition).collect();
    (!conditions.is_empty()).then_some(DefectStudy { demands, conditions })
}
