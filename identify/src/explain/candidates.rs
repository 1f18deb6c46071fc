//! Which effects are tried, and from where.

use crazyflie_env::effects::{Entry, Geometry, Role, registry};

use super::calibration::candidates::STARTS;
use crate::fit::hypothesis::{Hypothesis, Term};

/// An effect to try, with the values to start from.
pub struct Candidate {
    pub entry: &'static Entry,
    pub starts: Vec<Term>,
    /// Number of the first starts that are variants of the effect rather than other values.
    pub variants: usize,
}

/// Every effect of the registry that changes what is expected and that the hypothesis does not have yet. In a
/// whole geometry no part of it is missing.
pub fn candidates(hypothesis: &Hypothesis) -> Vec<Candidate> {
    let has = |e: &Entry| hypothesis.has(e.name) || hypothesis.model.effects.contains_key(e.name);
    let is_whole = registry().iter().any(|e| e.geometry == Geometry::Whole && has(e));
    let absent =
        |e: &&Entry| e.observability.is_expected() && !has(e) && !(is_whole && e.geometry == Geometry::Part);
    registry()
        .iter()
        .filter(absent)
        .map(|entry| Candidate { entry, starts: starts(entry), variants: variants(entry).len() })
        .collect()
}

fn starts(entry: &'static Entry) -> Vec<Term> {
    let variants = variants(entry);
    // only an effect on the command has no slope at "off"
    if !entry.hooks.command {
        return variants;
    }
    let mut all = variants.clone();
    for variant in &variants {
        for i in &variant.free {
            let p = &entry.params[*i];
            let start = |share: &f64| variant.with_value(*i, p.off + share * (p.farthest_bound() - p.off));
            all.extend(STARTS.iter().map(start));
        }
    }
    all
}

/// One term per combination of the parameters that select a variant, or that have values of their own to
/// start from, and those that the effect gives.
fn variants(entry: &'static Entry) -> Vec<Term> {
    let mut all = vec![Term::off(entry)];
    for (i, p) in entry.params.iter().enumerate() {
        let choices = p.low.round() as i64..=p.high.round() as i64;
        let values: Vec<f64> = match p.role {
            Role::Choice => choices.map(|choice| choice as f64).collect(),
            Role::Companion => continue,
            _ if !p.starts.is_empty() => [&[p.off], p.starts].concat(),
            _ => continue,
        };
        let with = |value: f64| all.iter().map(move |term| term.with_value(i, value));
        all = values.into_iter().flat_map(with).collect();
    }
    all.extend(Term::at_given_starts(entry));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::model::Model;

    #[test]
    fn every_effect_on_the_mean_is_tried_once_and_variants_each() {
        let model = Model::thesis();
        let all = candidates(&Hypothesis::from_model(&model));
        assert!(all.iter().all(|c| c.entry.observability.is_expected() && !c.starts.is_empty()));
        let weak = all.iter().find(|c| c.entry.name == "weak_motor").unwrap();
        assert_eq!(weak.starts.iter().map(|t| t.values[0]).collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0]);
        let delay = all.iter().find(|c| c.entry.name == "cmd_delay").unwrap();
        assert!(delay.starts.len() > 2 && delay.starts[1].values[0] > 0.0);
        let has = Hypothesis::from_model(&model).with(Term::off(delay.entry));
        assert!(candidates(&has).iter().all(|c| c.entry.name != "cmd_delay"));
    }
}
