//! What is hidden in a case, and whether an explanation says so.

use std::collections::BTreeMap;
use std::path::Path;

use crazyflie_env::effects::find;
use crazyflie_identify::explain::verdict::{Explanation, Finding, Verdict};
use serde::Deserialize;
use thiserror::Error;

/// Parameters by the names of the answers and by ours.
const NAMES: [(&str, &str); 24] = [
    ("drag_linear", "rate_ps"),
    ("drag_quadratic", "coefficient_pm"),
    ("wind_x", "x_mps2"),
    ("wind_y", "y_mps2"),
    ("ground_effect", "coefficient"),
    ("thrust_scale", "scale"),
    ("mass_add", "added_kg"),
    ("battery_exponent", "exponent"),
    ("cmd_delay", "delay_s"),
    ("motor_lag", "lag_s"),
    ("com_roll", "roll_deg"),
    ("com_pitch", "pitch_deg"),
    ("imu_tilt_roll", "roll_deg"),
    ("imu_tilt_pitch", "pitch_deg"),
    ("attitude_gain", "gain"),
    ("frame_yaw", "angle_deg"),
    ("cam_scale", "scale"),
    ("cam_latency", "undeclared_s"),
    ("cmd_deadband", "tilt_deg"),
    ("cmd_limit", "tilt_deg"),
    ("heave_add", "added_ps"),
    ("yaw_drift", "rate_degps"),
    ("gust_sigma", "sigma_mps2"),
    ("gust_tau", "tau_s"),
];
/// What the exact geometry and slightly moving air of the rigid flights add, whatever is hidden.
const BENIGN_IF_RIGID: [&str; 4] = ["rigid_body", "tilt_loss", "euler_kinematics", "gust"];
/// A name with its rivals that is still an answer.
const LARGEST_GROUP: usize = 3;
/// A parameter is near if it is this close, as a share of what it changes.
const NEAR: f64 = 0.15;
const STANDARD_ERRORS: f64 = 3.0;

/// Why an answer cannot be used.
#[derive(Debug, Error)]
pub(crate) enum TruthError {
    #[error("{file}: cannot be read")]
    Io {
        file: String,
        #[source]
        source: std::io::Error,
    },
    #[error("{file}: not an answer")]
    Malformed {
        file: String,
        #[source]
        source: serde_json::Error,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Group {
    Null,
    Single,
    Compound,
    Outside,
    Unexcited,
}

impl Group {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Group::Null => "null",
            Group::Single => "single",
            Group::Compound => "compound",
            Group::Outside => "outside",
            Group::Unexcited => "unexcited",
        }
    }
}

#[derive(Debug, Clone, Deserialize)]
pub(crate) struct HiddenEffect {
    pub name: String,
    pub params: BTreeMap<String, f64>,
}

impl HiddenEffect {
    /// Parameters under our names.
    pub(crate) fn ours(&self) -> Vec<(&'static str, f64)> {
        let ours = |(theirs, value): (&String, &f64)| Some((NAMES.iter().find(|(name, _)| name == theirs)?.1, *value));
        self.params.iter().filter_map(ours).collect()
    }
}

#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Truth {
    pub group: Group,
    pub tier: String,
    pub effects: Vec<HiddenEffect>,
    benign: Vec<String>,
}

impl Truth {
    /// The answer beside a case file, if there is one.
    pub(crate) fn beside(case: &Path) -> Result<Option<Self>, TruthError> {
        let path = case.with_extension("answer.json");
        let file = path.display().to_string();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(TruthError::Io { file, source }),
        };
        serde_json::from_str(&text).map(Some).map_err(|source| TruthError::Malformed { file, source })
    }

    /// Effects that may be named though they are not what was hidden.
    pub(crate) fn benign(&self) -> Vec<&str> {
        let rigid = BENIGN_IF_RIGID.into_iter().filter(|_| self.tier == "rigid");
        self.benign.iter().map(String::as_str).chain(rigid).collect()
    }

    /// Whether the right effects were named, by the rule of the group.
    pub(crate) fn named(&self, found: &Explanation) -> bool {
        if self.group == Group::Outside {
            return found.verdict == Verdict::Unexplained;
        }
        let (matched, extra) = self.matched(&found.effects);
        let all = self.group == Group::Unexcited || matched.len() == self.effects.len();
        all && !extra
    }

    /// Each hidden effect with what names it, and whether anything else is named.
    fn matched<'a>(&'a self, effects: &'a [Finding]) -> (Vec<(&'a HiddenEffect, &'a Finding)>, bool) {
        let mut free: Vec<&Finding> = effects.iter().flat_map(Finding::all).collect();
        let mut matched = Vec::new();
        // by its own name first: a rival's group is for what is then still to be found
        for exact in [true, false] {
            for hidden in &self.effects {
                if matched.iter().any(|(h, _): &(&HiddenEffect, _)| h.name == hidden.name) {
                    continue;
                }
                if let Some(at) = free.iter().position(|e| if exact { e.name == hidden.name } else { in_group(e, &hidden.name) }) {
                    matched.push((hidden, free.remove(at)));
                }
            }
        }
        let benign = self.benign();
        let extra = free.iter().any(|e| !benign.contains(&e.name));
        (matched, extra)
    }

    /// Whether all parameters of effects that were named by their own name are near, and within their standard errors.
    pub(crate) fn parameters(&self, found: &Explanation) -> (Option<bool>, Option<bool>) {
        let (matched, _) = self.matched(&found.effects);
        let (mut near, mut within) = (None, None);
        for (hidden, named) in matched.into_iter().filter(|(h, e)| h.name == e.name) {
            for (name, truth) in hidden.ours() {
                let off = find(named.name).ok().and_then(|(_, e)| e.params.iter().find(|p| p.name == name)).map_or(0.0, |p| p.off);
                let estimate = named.params.iter().find(|p| p.name == name);
                // a parameter that stayed idle was not found
                let error = estimate.map_or(f64::INFINITY, |e| (e.value - truth).abs());
                let stderr = estimate.map_or(0.0, |e| e.stderr);
                near = Some(near.unwrap_or(true) && error <= NEAR * reach(truth, off));
                within = Some(within.unwrap_or(true) && error <= STANDARD_ERRORS * stderr);
            }
        }
        (near, within)
    }
}

/// What a parameter changes: of a scale of 0.9, the tenth that is missing; of a limit, the limit itself.
fn reach(truth: f64, off: f64) -> f64 {
    truth.abs().min((truth - off).abs())
}

/// Whether an effect stands for a small group that contains the name.
fn in_group(effect: &Finding, name: &str) -> bool {
    effect.confusable_with.len() < LARGEST_GROUP && effect.confusable_with.contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &'static str, confusable_with: Vec<&'static str>) -> Finding {
        Finding {
            name,
            params: Vec::new(),
            confusable_with,
            manoeuvre: String::new(),
            worth_fit: 0.0,
            worth_test: 0.0,
            worth_by_signal: [0.0; 4],
            with: Vec::new(),
        }
    }

    fn truth(group: Group, names: &[&str]) -> Truth {
        let hidden = |name: &&str| HiddenEffect { name: (*name).into(), params: BTreeMap::new() };
        Truth { group, tier: "rigid".into(), effects: names.iter().map(hidden).collect(), benign: vec!["inertia_scale".into()] }
    }

    #[test]
    fn a_group_counts_for_one_effect_and_what_is_benign_is_not_extra() {
        let pair = truth(Group::Compound, &["mass_change", "wind"]);
        let both =
            [named("thrust_scale", vec!["mass_change"]), named("wind", vec![]), named("gust", vec![]), named("inertia_scale", vec![])];
        let (matched, extra) = pair.matched(&both);
        assert!(matched.len() == 2 && !extra);
        let (matched, extra) = pair.matched(&both[..1]);
        assert!(matched.len() == 1 && !extra);
        let wrong = [named("wind", vec![]), named("drag_linear", vec![])];
        assert!(pair.matched(&wrong).1);
        // four that cannot be told apart are no answer
        let wide = [named("thrust_scale", vec!["mass_change", "battery_sag", "heave_damping"])];
        assert!(pair.matched(&wide).0.is_empty());
    }

    #[test]
    fn every_name_of_an_answer_leads_to_a_parameter_of_the_registry() {
        let registry = crazyflie_env::effects::registry();
        for (theirs, ours) in NAMES {
            assert!(registry.iter().any(|e| e.params.iter().any(|p| p.name == ours)), "{theirs}");
        }
        let reaches = [reach(0.9, 1.0), reach(5.5, 90.0), reach(-7.5, 0.0)];
        assert!(reaches.iter().zip([0.1, 5.5, 7.5]).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
