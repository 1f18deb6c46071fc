//! Spatial repeatability of a drifting force: whether it is the same again when the vehicle returns. The cause may be
//! a fan, a wall, a warm floor.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use super::calibration::place::{AFTER_S, APART_S, BEHIND_S, DRAWS, FORGOTTEN, NEAR_M};
use super::leftover::{CLEAR, FINDING};
use super::shape::{EVERY_S, LEAST_MPS2};
use super::signals::Signal;
use super::verdict::{Leftover, Structure};
use crate::fit::filter::{Disturbances, FilterResult, GaussMarkov};
use crate::fit::flight::Flight;

/// A horizontal force and where it acted, sampled evenly.
struct Revisits {
    force_mps2: Vec<[f64; 2]>,
    pos_m: Vec<[f64; 3]>,
    every_s: f64,
}

/// Returns a finding if the horizontal force of some flights, where it is large, is alike whenever they return to a
/// place: each flight by itself, all together. A measured place may be the consequence of the force; a set-point is
/// not.
pub fn spatial_repeatability<'a>(
    flights: impl Iterator<Item = &'a (&'a Flight, FilterResult)>,
    disturbances: &Disturbances,
) -> Option<Leftover> {
    let GaussMarkov { sigma, tau_s } = disturbances.force;
    if sigma < LEAST_MPS2 {
        return None;
    }
    let z_by_cause = |(flight, filtered): &(&Flight, FilterResult)| {
        let measured = Revisits::new(flight, filtered, |k| Some([0, 1, 2].map(|i| filtered.states[k][i])));
        let setpoints = Revisits::new(flight, filtered, |k| flight.setpoint_m(k));
        [
            measured.and_then(|v| v.similarity_z(tau_s, true)),
            setpoints.and_then(|v| v.similarity_z(tau_s, false)),
        ]
    };
    let found: Vec<[Option<f64>; 2]> = flights.map(z_by_cause).collect();
    let combined_z = |which: usize| {
        let clear: Vec<f64> = found.iter().filter_map(|f| f[which]).collect();
        clear.iter().sum::<f64>() / (clear.len() as f64).sqrt()
    };
    let z = combined_z(0).max(combined_z(1));
    let finding = format!("is the same again in the same place ({z:.1} standard deviations)");
    let size = FINDING.get() * z / CLEAR.get();
    // less alike than by chance is nothing that a place does
    (z > 0.0).then(|| Leftover::new(Structure::State, Signal::Sideways, "force", finding, size))
}

/// Two visits of a place, by index, and how near they were.
struct RevisitPair(usize, usize, f64);

impl Revisits {
    fn new(
        flight: &Flight,
        filtered: &FilterResult,
        place: impl Fn(usize) -> Option<[f64; 3]>,
    ) -> Option<Self> {
        let every = ((EVERY_S / flight.tick_s).round() as usize).max(1);
        let some = (0..filtered.states.len()).step_by(every);
        let force_mps2 = some.clone().map(|k| [0, 1].map(|i| filtered.disturbance_estimates[k][i])).collect();
        let pos_m = some.map(place).collect::<Option<_>>()?;
        Some(Revisits { force_mps2, pos_m, every_s: every as f64 * flight.tick_s })
    }

    fn pairs(&self, tau_s: f64) -> Vec<RevisitPair> {
        let apart = (APART_S.max(FORGOTTEN * tau_s) / self.every_s) as usize;
        let near = |i: usize, j: usize| {
            let square: f64 = (0..3).map(|k| (self.pos_m[i][k] - self.pos_m[j][k]).powi(2)).sum();
            (-0.5 * square / (NEAR_M * NEAR_M)).exp()
        };
        let n = self.pos_m.len();
        let all = (0..n).flat_map(|i| (i + apart..n).map(move |j| (i, j)));
        all.map(|(i, j)| RevisitPair(i, j, near(i, j))).filter(|pair| pair.2 > 0.01).collect()
    }

    /// Computes by how much the forces of different visits are more alike than by chance. The unit is the standard
    /// deviation of the same figure for forces that drift with that correlation time. Returns `None` if the places
    /// are the consequence, or none was visited again.
    fn similarity_z(&self, tau_s: f64, may_lead: bool) -> Option<f64> {
        let pairs = self.pairs(tau_s);
        if pairs.is_empty() {
            return None;
        }
        let samples = |time_s: f64| (time_s / self.every_s) as isize;
        let most = |force: &[[f64; 2]], shifts: std::ops::RangeInclusive<isize>| {
            shifts.map(|shift| force_similarity(force, &pairs, shift)).fold(f64::NEG_INFINITY, f64::max)
        };
        let here = most(&self.force_mps2, 0..=samples(BEHIND_S));
        if may_lead && most(&self.force_mps2, -samples(AFTER_S)..=-1) > here {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(0);
        let keep = (-self.every_s / tau_s).exp();
        let mut draw = || simulate_gauss_markov(self.force_mps2.len(), keep, &mut rng);
        let chance: Vec<f64> = (0..DRAWS).map(|_| most(&draw(), 0..=samples(BEHIND_S))).collect();
        let mean = chance.iter().sum::<f64>() / DRAWS as f64;
        let sd = (chance.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / DRAWS as f64).sqrt();
        Some((here - mean) / sd)
    }
}

/// Mean product of the forces of two visits, over their mean square; the forces taken `shift` samples after
/// the visit.
fn force_similarity(force: &[[f64; 2]], pairs: &[RevisitPair], shift: isize) -> f64 {
    let n = force.len() as f64;
    let mean = [0, 1].map(|k| force.iter().map(|f| f[k]).sum::<f64>() / n);
    let off = |i: usize| [force[i][0] - mean[0], force[i][1] - mean[1]];
    let square = (0..force.len()).map(|i| off(i).iter().map(|v| v * v).sum::<f64>()).sum::<f64>() / n;
    let (mut sum, mut weight) = (0.0, 0.0);
    for RevisitPair(i, j, near) in pairs {
        let (Some(i), Some(j)) =
            (i.checked_add_signed(shift), j.checked_add_signed(shift).filter(|j| *j < force.len()))
        else {
            continue;
        };
        let (a, b) = (off(i), off(j));
        sum += near * (a[0] * b[0] + a[1] * b[1]);
        weight += near;
    }
    if weight * square > 0.0 { sum / (weight * square) } else { 0.0 }
}

fn simulate_gauss_markov(n: usize, keep: f64, rng: &mut Pcg64Mcg) -> Vec<[f64; 2]> {
    let mut state = [rng.sample(StandardNormal), rng.sample(StandardNormal)];
    let mut step = || {
        let now = state;
        for slot in &mut state {
            *slot = keep * *slot + (1.0 - keep * keep).sqrt() * rng.sample::<f64, _>(StandardNormal);
        }
        now
    };
    (0..n).map(|_| step()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAU_S: f64 = 1.0;
    const SAMPLES: usize = 250;

    fn gusts(seed: u64) -> Vec<[f64; 2]> {
        simulate_gauss_markov(SAMPLES, (-EVERY_S / TAU_S).exp(), &mut Pcg64Mcg::seed_from_u64(seed))
    }

    /// Returns a track that visits most places more than once, never after the same time.
    fn track() -> Vec<[f64; 3]> {
        let at = |k: usize| k as f64 * EVERY_S;
        (0..SAMPLES).map(|k| [(0.9 * at(k)).sin(), (1.27 * at(k)).sin(), 1.0]).collect()
    }

    #[test]
    fn a_fan_blows_where_it_stands() {
        let fan = |p: &[f64; 3]| [0.5 * (-((p[0] - 0.5).powi(2) + p[1] * p[1]) / 0.1).exp(), 0.0];
        // the delay of the filter's estimate
        let delayed = |places: &[[f64; 3]]| (0..SAMPLES).map(|k| fan(&places[k.saturating_sub(1)])).collect();
        let visits = Revisits { force_mps2: delayed(&track()), pos_m: track(), every_s: EVERY_S };
        let z = visits.similarity_z(TAU_S, true).unwrap();
        assert!(z > CLEAR.get(), "{z}");
    }

    #[test]
    fn gusts_know_no_places() {
        for seed in 1..40 {
            let z = Revisits { force_mps2: gusts(seed), pos_m: track(), every_s: EVERY_S }
                .similarity_z(TAU_S, true);
            assert!(z.is_none_or(|z| z < CLEAR.get()), "{seed}: {z:?}");
        }
    }

    /// Blown about over one spot, the vehicle is in the same place because the same force has brought it
    /// there.
    #[test]
    fn a_place_may_be_the_consequence() {
        for seed in 1..10 {
            let force_mps2 = gusts(seed);
            let pushed = |k: usize| force_mps2[k.saturating_sub(5)].map(|f| 0.1 * f);
            let pos_m = (0..SAMPLES).map(|k| [pushed(k)[0], pushed(k)[1], 1.0]).collect();
            assert_eq!(
                Revisits { force_mps2: force_mps2.clone(), pos_m, every_s: EVERY_S }
                    .similarity_z(TAU_S, true),
                None,
                "{seed}"
            );
        }
    }

    /// Round after round, a force that depends on the place is as much alike later as at once; only a set-point is
    /// never a consequence of the force.
    #[test]
    fn rounds_of_one_track_need_to_be_told() {
        let at = |k: usize| (0.8 * k as f64 * EVERY_S).sin_cos();
        let pos_m: Vec<[f64; 3]> = (0..SAMPLES).map(|k| [at(k).0, at(k).1, 1.0]).collect();
        let spot = |k: usize| [0.5 * (-((at(k).0 - 0.5).powi(2)) / 0.1).exp() * at(k).1, 0.0];
        let z_of = |force_mps2: Vec<[f64; 2]>| {
            Revisits { force_mps2, pos_m: pos_m.clone(), every_s: EVERY_S }.similarity_z(TAU_S, false)
        };
        assert!(z_of((0..SAMPLES).map(|k| spot(k.saturating_sub(3))).collect()).unwrap() > CLEAR.get());
        for seed in 1..40 {
            let z = z_of(gusts(seed)).unwrap();
            assert!(z < CLEAR.get(), "{seed}: {z}");
        }
    }

    #[test]
    fn a_place_never_visited_again_says_nothing() {
        let pos_m = (0..SAMPLES).map(|k| [k as f64, 0.0, 1.0]).collect();
        assert_eq!(
            Revisits { force_mps2: gusts(1), pos_m, every_s: EVERY_S }.similarity_z(TAU_S, true),
            None
        );
    }
}
