//! The truth of a case, and whether an explanation matches it.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use crazyflie_env::effects::find;
use serde::{Deserialize, Serialize};

use crate::record::{Answer, NamedEffect, ValueError};

/// Parameters by the names of the answers and by ours.
const NAMES: [(&str, &str); 29] = [
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
    ("motor_lag", "torque_lag_s"),
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
    ("inertia_scale", "scale"),
    ("backlash", "play_deg"),
    ("slung_ratio", "mass_ratio"),
    ("slung_length", "length_m"),
];
/// Effects of the exact geometry and slightly moving air of the rigid flights, whatever is hidden.
const BENIGN_IF_RIGID: [&str; 4] = ["rigid_body", "tilt_loss", "euler_kinematics", "gust"];
/// Verdicts by which nothing accounts for a residual, or not for all of it.
const LEAVES_STRUCTURE: [&str; 2] = ["unexplained", "partly_explained"];
/// A name with its rivals that is still an answer.
const LARGEST_GROUP: usize = 3;
/// A parameter is near if it is this close, as a share of what it changes.
const NEAR: f64 = 0.15;
const STANDARD_ERRORS: f64 = 3.0;

/// The kind of a case, in the order of tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Group {
    Null,
    Single,
    Compound,
    Outside,
    Unexcited,
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// An effect that a case hides, with its parameters under the names of the answers.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct HiddenEffect {
    pub name: String,
    pub params: BTreeMap<String, f64>,
}

impl HiddenEffect {
    /// Parameters under our names.
    pub fn ours<'a>(&'a self) -> Vec<(&'static str, f64)> {
        let ours = |(theirs, value): (&'a String, &'a f64)| {
            NAMES.iter().filter(move |(name, _)| name == theirs).map(|(_, ours)| (*ours, *value))
        };
        self.params.iter().flat_map(ours).collect()
    }
}

/// An answer file.
#[derive(Debug, Clone, Deserialize)]
pub struct Truth {
    pub group: Group,
    pub tier: String,
    pub effects: Vec<HiddenEffect>,
    benign: Vec<String>,
    #[serde(default)]
    pub excitation: Vec<String>,
    #[serde(default)]
    pub noise: String,
    #[serde(default)]
    pub seed: Option<u64>,
}

impl Truth {
    /// The answer beside a case file.
    pub fn beside(case: &Path) -> Result<Self> {
        let path = case.with_extension("answer.json");
        let file = path.display();
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("{file}: cannot be read; a case needs its answer to be scored"))?;
        Truth::parse(&text).with_context(|| format!("{file}: not an answer"))
    }

    fn parse(text: &str) -> Result<Self> {
        let truth: Truth = serde_json::from_str(text)?;
        let (expected, fits): (_, fn(usize) -> bool) = match truth.group {
            Group::Null => ("nothing", |count| count == 0),
            Group::Single => ("one effect", |count| count == 1),
            Group::Compound => ("two effects or more", |count| count >= 2),
            Group::Outside | Group::Unexcited => ("one effect or more", |count| count >= 1),
        };
        let count = truth.effects.len();
        ensure!(fits(count), "a {} case hides {expected}, not {count}", truth.group);
        Ok(truth)
    }

    /// Effects that may be named though they are not what was hidden.
    pub fn benign(&self) -> Vec<&str> {
        let rigid = BENIGN_IF_RIGID.into_iter().filter(|_| self.tier == "rigid");
        self.benign.iter().map(String::as_str).chain(rigid).collect()
    }

    /// Returns whether the answers are right, by the rule of the group. A cause that no effect described when it was
    /// flown may have a name since.
    pub fn is_answered(&self, verdict: &str, answers: &[Answer], extra: &[String]) -> bool {
        let all = answers.iter().all(|answer| *answer != Answer::Missed);
        match self.group {
            Group::Outside => extra.is_empty() && (all || LEAVES_STRUCTURE.contains(&verdict)),
            Group::Unexcited => extra.is_empty(),
            Group::Null | Group::Single | Group::Compound => all && extra.is_empty(),
        }
    }

    /// Answer to each hidden effect, and the named effects that are not there.
    pub fn answers(&self, effects: &[NamedEffect]) -> (Vec<Answer>, Vec<String>) {
        let (matches, rest) = self.matches(effects);
        let answer = |(hidden, named): (&HiddenEffect, &Option<&NamedEffect>)| match named {
            Some(named) if named.name == hidden.name => Answer::ByName,
            Some(named) => Answer::InGroup(named.name.clone()),
            None => Answer::Missed,
        };
        let answers = self.effects.iter().zip(&matches).map(answer).collect();
        let benign = self.benign();
        let extra = rest
            .into_iter()
            .map(|e| e.name.clone())
            .filter(|name| !benign.contains(&name.as_str()))
            .collect();
        (answers, extra)
    }

    /// Named effects for each hidden one, and the other named effects.
    fn matches<'a>(
        &self,
        effects: &'a [NamedEffect],
    ) -> (Vec<Option<&'a NamedEffect>>, Vec<&'a NamedEffect>) {
        let mut free: Vec<&NamedEffect> = effects.iter().flat_map(NamedEffect::all).collect();
        let mut matches = vec![None; self.effects.len()];
        // by its own name first: a rival's group is for what is then still to be found
        for exact in [true, false] {
            for (hidden, found) in self.effects.iter().zip(&mut matches) {
                let fits =
                    |e: &&NamedEffect| if exact { e.name == hidden.name } else { in_group(e, &hidden.name) };
                if found.is_none() {
                    *found = free.iter().position(fits).map(|at| free.remove(at));
                }
            }
        }
        (matches, free)
    }

    /// The errors of all parameters of effects that were named by their own name.
    pub fn value_errors(&self, effects: &[NamedEffect]) -> Vec<ValueError> {
        let (matches, _) = self.matches(effects);
        let pairs =
            self.effects.iter().zip(matches).filter_map(|(h, e)| Some((h, e.filter(|e| e.name == h.name)?)));
        pairs
            .flat_map(|(hidden, named)| {
                hidden.ours().into_iter().map(|(name, truth)| ValueError::new(named, name, truth))
            })
            .collect()
    }
}

impl ValueError {
    fn new(named: &NamedEffect, parameter: &str, truth: f64) -> Self {
        let param = find(&named.name).ok().and_then(|(_, e)| e.params.iter().find(|p| p.name == parameter));
        let reach = param.map_or(truth.abs(), |p| p.reach(truth));
        // a parameter that stayed idle was not found
        let found = named.params.iter().find(|p| p.name == parameter);
        let estimate = found.and_then(|p| p.value);
        let stderr = found.and_then(|p| p.stderr).filter(|stderr| *stderr > 0.0);
        let error = estimate.map(|value| value - truth);
        ValueError {
            effect: named.name.clone(),
            parameter: parameter.to_owned(),
            truth,
            estimate,
            share: error.map(|error| error.abs() / reach).filter(|share| share.is_finite()),
            z: error.zip(stderr).map(|(error, stderr)| error / stderr),
        }
    }

    pub fn is_near(&self) -> bool {
        self.share.is_some_and(|share| share <= NEAR)
    }

    pub fn is_within(&self) -> bool {
        self.z.is_some_and(|z| z.abs() <= STANDARD_ERRORS)
    }
}

/// Returns whether an effect represents a small group that contains the name.
fn in_group(effect: &NamedEffect, name: &str) -> bool {
    effect.confusable_with.len() < LARGEST_GROUP && effect.confusable_with.iter().any(|rival| rival == name)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::record::ParameterEstimate;

    fn named(name: &str, confusable_with: &[&str]) -> NamedEffect {
        let confusable_with = confusable_with.iter().map(|&rival| rival.to_owned()).collect();
        NamedEffect {
            name: name.into(),
            params: Vec::new(),
            confusable_with,
            worth_fit: None,
            worth_test: None,
            with: Vec::new(),
        }
    }

    fn truth(group: &str, names: &[&str]) -> Truth {
        let effects: Vec<_> =
            names.iter().map(|name| serde_json::json!({"name": name, "params": {}})).collect();
        let answer = serde_json::json!({"group": group, "tier": "rigid", "effects": effects, "benign": ["inertia_scale"]});
        Truth::parse(&answer.to_string()).unwrap()
    }

    fn is_right(truth: &Truth, verdict: &str, effects: &[NamedEffect]) -> bool {
        let (answers, extra) = truth.answers(effects);
        truth.is_answered(verdict, &answers, &extra)
    }

    #[test]
    fn a_group_counts_for_one_effect_and_what_is_benign_is_not_extra() {
        let pair = truth("compound", &["mass_change", "wind"]);
        let both = [
            named("thrust_scale", &["mass_change"]),
            named("wind", &[]),
            named("gust", &[]),
            named("inertia_scale", &[]),
        ];
        assert_eq!(
            pair.answers(&both),
            (vec![Answer::InGroup("thrust_scale".into()), Answer::ByName], vec![])
        );
        assert!(is_right(&pair, "explained", &both) && !is_right(&pair, "explained", &both[..1]));
        assert_eq!(
            pair.answers(&[named("drag_linear", &[])]),
            (vec![Answer::Missed; 2], vec!["drag_linear".into()])
        );
        // one name stands for one effect, though its group holds both
        let one = [named("thrust_scale", &["mass_change", "wind"])];
        assert_eq!(pair.answers(&one).0, [Answer::InGroup("thrust_scale".into()), Answer::Missed]);
        // four that cannot be told apart are no answer
        let wide = [named("thrust_scale", &["mass_change", "battery_sag", "heave_damping"])];
        assert_eq!(pair.answers(&wide).0, [Answer::Missed, Answer::Missed]);
    }

    #[test]
    fn each_group_has_its_rule() {
        let wrong = [named("drag_linear", &[])];
        let null = truth("null", &[]);
        assert!(
            is_right(&null, "nothing_missing", &[]) && is_right(&null, "explained", &[named("gust", &[])])
        );
        assert!(!is_right(&null, "explained", &wrong));
        let outside = truth("outside", &["slung_load"]);
        assert!(is_right(&outside, "unexplained", &[]) && !is_right(&outside, "nothing_missing", &[]));
        assert!(
            is_right(&outside, "partly_explained", &[named("gust", &[])])
                && !is_right(&outside, "unexplained", &wrong)
        );
        assert!(
            !is_right(&outside, "explained", &wrong)
                && is_right(&outside, "explained", &[named("slung_load", &[])])
        );
        let unexcited = truth("unexcited", &["drag_quadratic"]);
        assert!(is_right(&unexcited, "not_decidable", &[]) && !is_right(&unexcited, "explained", &wrong));
    }

    #[test]
    fn errors_are_shares_of_what_a_parameter_changes() {
        let mut scale = named("thrust_scale", &[]);
        let estimate = |value, stderr| ParameterEstimate {
            name: "scale".into(),
            value: Some(value),
            stderr,
            unit: "1".into(),
        };
        scale.params = vec![estimate(0.91, Some(0.004))];
        let error = ValueError::new(&scale, "scale", 0.9);
        assert!((error.share.unwrap() - 0.1).abs() < 1e-9 && (error.z.unwrap() - 2.5).abs() < 1e-9);
        assert!(error.is_near() && error.is_within());
        scale.params = vec![estimate(0.92, None)];
        let error = ValueError::new(&scale, "scale", 0.9);
        assert!(!error.is_near() && !error.is_within() && error.z.is_none());
        // nothing is off in a gust of 1 s, from which its length is declared
        let mut gust = named("gust", &[]);
        gust.params = vec![ParameterEstimate {
            name: "tau_s".into(),
            value: Some(0.99),
            stderr: None,
            unit: "s".into(),
        }];
        assert!((ValueError::new(&gust, "tau_s", 0.9).share.unwrap() - 0.1).abs() < 1e-9);
        let idle = ValueError::new(&named("wind", &[]), "x_mps2", 0.3);
        assert!(!idle.is_near() && !idle.is_within() && idle.estimate.is_none());
    }

    #[test]
    fn answers_that_cannot_be_say_why() {
        let problem = |text: &str| Truth::parse(text).unwrap_err().to_string();
        assert!(problem("{\n\"group\": \"singel\"").contains("line 2"));
        let two = r#"{"group": "single", "tier": "linear", "effects": [], "benign": []}"#;
        assert_eq!(problem(two), "a single case hides one effect, not 0");
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC{0,80}", cut in 0_usize..120) {
            let _ = Truth::parse(&text);
            let whole = r#"{"group": "single", "tier": "rigid", "effects": [{"name": "gust", "params": {"gust_tau": 1}}], "benign": []}"#;
            let parsed = Truth::parse(&whole[..cut.min(whole.len())]);
            prop_assert_eq!(parsed.is_ok(), cut >= whole.len());
        }
    }

    #[test]
    fn every_name_of_an_answer_leads_to_a_parameter_of_the_registry() {
        let registry = crazyflie_env::effects::registry();
        for (theirs, ours) in NAMES {
            assert!(registry.iter().any(|e| e.params.iter().any(|p| p.name == ours)), "{theirs}");
        }
    }
}
