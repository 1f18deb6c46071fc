//! The effect that a scenario does not declare: drawn from a pool by the server's secret, so that each server
//! has its own, and committed to, so that the server cannot change it unseen.

use crazyflie_env::config::{EffectParams, EffectTable, Number};
use crazyflie_env::effects::check_effects;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::error::{Error, Result};
use super::secrets::{Secrets, canonical, sha256_hex};

/// The effects of which one is drawn.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct EffectPool(Vec<Candidate>);

/// An effect with a range for each of its parameters that is not off.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Candidate {
    effect: String,
    /// Parameter and the ranges that its value may lie in, of which one is drawn.
    ranges: std::collections::BTreeMap<String, Vec<[f64; 2]>>,
}

/// The effect that was drawn. It is never written down.
#[derive(Clone)]
pub(super) struct HiddenDraw {
    pub effects: EffectTable,
    /// SHA-256 over the effect and a salt: published, to be opened one day.
    pub commitment: String,
}

impl std::fmt::Debug for HiddenDraw {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Hidden({})", self.commitment)
    }
}

impl EffectPool {
    /// Those that a scenario does not declare already.
    pub(super) fn without(&self, declared: &EffectTable) -> EffectPool {
        EffectPool(self.0.iter().filter(|one| !declared.contains_key(&one.effect)).cloned().collect())
    }

    /// Draws for the scenario whose public part has the hash `public`.
    pub(super) fn draw(&self, secrets: &Secrets, public: &str) -> Result<HiddenDraw> {
        let key = secrets.derive(&[b"hidden effect", public.as_bytes()])?;
        let mut rng = Pcg64Mcg::from_seed(std::array::from_fn(|i| key[i]));
        let bad = |problem: &str| Error::Internal(format!("pool of hidden effects: {problem}"));
        let chosen = self.0.get(rng.random_range(0..self.0.len().max(1))).ok_or_else(|| bad("empty"))?;
        let mut params = std::collections::BTreeMap::new();
        for (param, ranges) in &chosen.ranges {
            let [low, high] = ranges
                .get(rng.random_range(0..ranges.len().max(1)))
                .ok_or_else(|| bad("a parameter without a range"))?;
            params.insert(param.clone(), Number::Fixed(low + (high - low) * rng.random::<f64>()));
        }
        let effects = EffectTable::from([(chosen.effect.clone(), EffectParams::Named(params))]);
        check_effects(&effects)?;
        let salt = hex::encode(secrets.derive(&[b"salt", public.as_bytes()])?);
        let commitment = sha256_hex(&canonical(&json!({"effects": effects, "salt": salt}))?);
        Ok(HiddenDraw { effects, commitment })
    }

    /// Every effect at every bound, for tests of the pool.
    #[cfg(test)]
    pub(super) fn corners(&self) -> Vec<EffectTable> {
        let corner = |c: &Candidate, end: usize, range: usize| {
            let value = |ranges: &Vec<[f64; 2]>| Number::Fixed(ranges[range.min(ranges.len() - 1)][end]);
            let params = c.ranges.iter().map(|(name, ranges)| (name.clone(), value(ranges))).collect();
            EffectTable::from([(c.effect.clone(), EffectParams::Named(params))])
        };
        self.0
            .iter()
            .flat_map(|c| [0, 1].into_iter().flat_map(move |end| [0, 1].map(|range| corner(c, end, range))))
            .collect()
    }
}
