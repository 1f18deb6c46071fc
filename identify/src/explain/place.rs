//! Whether a wandering force belongs to places: where the vehicle comes again, it is the same again. Whatever the shape of it, a fan, a wall, a warm floor.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use super::leftover::FINDING;
use super::shape::{CLEAR, EVERY_S, LEAST_MPS2};
use super::verdict::Leftover;
use crate::fit::filter::{Disturbances, Filtered};

/// Places so far apart are the same place.
const NEAR_M: f64 = 0.2;
/// Moments so far apart are different visits, if the force has been forgotten in between.
const APART_S: f64 = 3.0;
const FORGOTTEN: f64 = 2.0;
/// A vehicle that is pushed is elsewhere soon after: if a force is more alike where it leads to within this time, the place is its consequence.
const AFTER_S: f64 = 2.0;
/// Wandering forces that chance is judged by.
const DRAWS: usize = 200;

/// A horizontal force and where it acted, sampled evenly.
struct Visits {
    force_mps2: Vec<[f64; 2]>,
    pos_m: Vec<[f64; 3]>,
    every_s: f64,
}

/// A finding if the horizontal force of some flights, where it is large, is alike wherever they come again: each flight by itself, all together.
pub fn belongs<'a>(flights: impl Iterator<Item = &'a Filtered>, tick_s: f64, disturbances: &Disturbances) -> Option<Leftover> {
    if disturbances.force.sigma < LEAST_MPS2 {
        return None;
    }
    let clear: Vec<f64> = flights.filter_map(|filtered| Visits::of(filtered, tick_s).alike(disturbances.force.tau_s)).collect();
    let z = clear.iter().sum::<f64>() / (clear.len() as f64).sqrt();
    let finding = format!("is the same again in the same place ({z:.1} standard deviations)");
    (!clear.is_empty()).then(|| Leftover { signal: "force".into(), finding, size: FINDING * z / CLEAR })
}

/// Two visits of a place, by index, and how near they were.
struct Pair(usize, usize, f64);

impl Visits {
    fn of(filtered: &Filtered, tick_s: f64) -> Self {
        let every = ((EVERY_S / tick_s).round() as usize).max(1);
        let some = (0..filtered.states.len()).step_by(every);
        Visits {
            force_mps2: some.clone().map(|k| [filtered.wandered[k][0], filtered.wandered[k][1]]).collect(),
            pos_m: some.map(|k| [0, 1, 2].map(|i| filtered.states[k][i])).collect(),
            every_s: every as f64 * tick_s,
        }
    }

    fn pairs(&self, tau_s: f64) -> Vec<Pair> {
        let apart = (APART_S.max(FORGOTTEN * tau_s) / self.every_s) as usize;
        let near = |i: usize, j: usize| {
            let square: f64 = (0..3).map(|k| (self.pos_m[i][k] - self.pos_m[j][k]).powi(2)).sum();
            (-0.5 * square / (NEAR_M * NEAR_M)).exp()
        };
        let n = self.pos_m.len();
        let all = (0..n).flat_map(|i| (i + apart..n).map(move |j| (i, j)));
        all.map(|(i, j)| Pair(i, j, near(i, j))).filter(|pair| pair.2 > 0.01).collect()
    }

    /// How much more alike the forces of different visits are than chance would have it, in standard deviations of the same for forces that
    /// wander with that correlation time. `None` if the places are the consequence, or none was visited again.
    fn alike(&self, tau_s: f64) -> Option<f64> {
        let pairs = self.pairs(tau_s);
        if pairs.is_empty() {
            return None;
        }
        let here = likeness(&self.force_mps2, &pairs, 0);
        let after = (1..=(AFTER_S / self.every_s) as usize).map(|lag| likeness(&self.force_mps2, &pairs, lag));
        if after.fold(f64::NEG_INFINITY, f64::max) > here {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(0);
        let keep = (-self.every_s / tau_s).exp();
        let mut draws = || likeness(&wandering(self.force_mps2.len(), keep, &mut rng), &pairs, 0);
        let chance: Vec<f64> = (0..DRAWS).map(|_| draws()).collect();
        let mean = chance.iter().sum::<f64>() / DRAWS as f64;
        let sd = (chance.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / DRAWS as f64).sqrt();
        Some((here - mean) / sd)
    }
}

/// Mean product of the forces of two visits, over their mean square; the forces taken `before` samples before the visit.
fn likeness(force: &[[f64; 2]], pairs: &[Pair], before: usize) -> f64 {
    let n = force.len() as f64;
    let mean = [0, 1].map(|k| force.iter().map(|f| f[k]).sum::<f64>() / n);
    let off = |i: usize| [force[i][0] - mean[0], force[i][1] - mean[1]];
    let square = (0..force.len()).map(|i| off(i).iter().map(|v| v * v).sum::<f64>()).sum::<f64>() / n;
    let (mut sum, mut weight) = (0.0, 0.0);
    for Pair(i, j, near) in pairs.iter().filter(|pair| pair.0 >= before) {
        let (a, b) = (off(i - before), off(j - before));
        sum += near * (a[0] * b[0] + a[1] * b[1]);
        weight += near;
    }
    if weight * square > 0.0 { sum / (weight * square) } else { 0.0 }
}

fn wandering(n: usize, keep: f64, rng: &mut Pcg64Mcg) -> Vec<[f64; 2]> {
    let mut at = [rng.sample(StandardNormal), rng.sample(StandardNormal)];
    let mut step = || {
        let now = at;
        for slot in &mut at {
            *slot = keep * *slot + (1.0 - keep * keep).sqrt() * rng.sample::<f64, _>(StandardNormal);
        }
        now
    };
    (0..n).map(|_| step()).collect()
}
