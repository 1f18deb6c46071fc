//! Structure in a wandering force: correlation with the state of the vehicle, and sudden changes. Air that
//! moves by itself knows nothing of where the vehicle is. A force that is there whenever the vehicle is in
//! one place, or late in the flight, is structure.

pub use super::calibration::shape::EVERY_S;
use super::calibration::shape::{AFTER_S, CHANGE_S, SETTLED_S, UNEVEN};
use super::leftover::{CLEAR, FINDING};
use super::signals::Signal;
use super::verdict::{Leftover, Structure};
use crate::fit::filter::{Disturbances, FilterResult};
use crate::fit::flight::Flight;

/// Forces smaller than this (m/s^2) are small errors of the model, which go with all sorts of things.
pub(super) const LEAST_MPS2: f64 = 0.1;

/// A series without its mean, scaled to unit norm.
struct StandardSeries(Vec<f64>);

impl StandardSeries {
    /// The values without their mean, scaled to unit norm.
    fn new(values: Vec<f64>) -> Option<Self> {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let norm = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>().sqrt();
        (norm > 1e-9).then(|| StandardSeries(values.iter().map(|v| (v - mean) / norm).collect()))
    }

    /// Correlation with another one that many samples later.
    fn correlation(&self, other: &StandardSeries, later: usize) -> f64 {
        self.0.iter().zip(other.0.get(later..).unwrap_or_default()).map(|(a, b)| a * b).sum()
    }

    /// Correlation with another one in standard deviations of that of independent series as slow as these
    /// (Bartlett). `None` if it is larger later.
    fn correlation_z(&self, other: &StandardSeries) -> Option<f64> {
        let (n, r) = (self.0.len(), self.correlation(other, 0));
        let lags = 1..=(AFTER_S / EVERY_S) as usize;
        let after = lags.map(|lag| self.correlation(other, lag).abs()).fold(0.0, f64::max);
        let both = |lag: usize| self.correlation(self, lag) * other.correlation(other, lag);
        let independent = n as f64 / (1.0 + 2.0 * (1..n / 4).map(both).sum::<f64>()).max(1.0);
        (r.abs() > after && independent > 4.0)
            .then(|| r.clamp(-0.999, 0.999).atanh() * (independent - 3.0).sqrt())
    }
}

/// Computes how unevenly a force changes: the fourth moment of its changes within [`CHANGE_S`], over the square of
/// the second. The figure is 3 for moving air, and the number of changes for a single jump.
fn change_kurtosis(axes: &[Vec<f64>]) -> f64 {
    let changes = || axes.iter().flat_map(|force| force.windows(2).map(|w| w[1] - w[0]));
    let mean = |power: i32| changes().map(|c| c.powi(power)).sum::<f64>() / changes().count() as f64;
    mean(4) / mean(2).powi(2)
}

/// Findings about the forces of a filtered flight, where they are large.
pub fn force_findings(flight: &Flight, filtered: &FilterResult, under: &Disturbances) -> Vec<Leftover> {
    let every = ((EVERY_S / flight.tick_s).round() as usize).max(1);
    let sample = |value: &dyn Fn(usize) -> f64| {
        StandardSeries::new((0..filtered.states.len()).step_by(every).map(value).collect())
    };
    let state = |i: usize| sample(&|k| filtered.states[k][i]);
    let speed = |k: usize| filtered.states[k][3..6].iter().map(|v| v * v).sum::<f64>().sqrt();
    let voltage = |k: usize| flight.voltage_v(k as isize).unwrap_or(0.0);
    let with = [
        ("x", state(0)),
        ("y", state(1)),
        ("height", state(2)),
        ("speed", sample(&speed)),
        ("time", sample(&|k| k as f64)),
        ("battery voltage", flight.voltage_v(0).and_then(|_| sample(&voltage))),
    ];
    let (force, lift) = (under.force, under.lift);
    let forces = [
        (Signal::Sideways, "force in x", 0, force),
        (Signal::Sideways, "force in y", 1, force),
        (Signal::Vertical, "lift", 2, lift),
    ];
    let mut found = Vec::new();
    let mut add = |part, signal, finding, size: f64| {
        found.push(Leftover::new(Structure::State, part, signal, finding, size));
    };
    for (part, name, axis, _) in forces.into_iter().filter(|(.., wander)| wander.sigma > LEAST_MPS2) {
        let Some(force) = sample(&|k| filtered.disturbance_estimates[k][axis]) else { continue };
        for (input, series) in with.iter().filter_map(|(input, series)| Some((input, series.as_ref()?))) {
            let Some(z) = force.correlation_z(series) else { continue };
            let finding = format!("goes with {input} (correlation {:.2})", force.correlation(series, 0));
            add(part, name, finding, FINDING.get() * z / CLEAR.get());
        }
    }
    let apart = ((CHANGE_S / flight.tick_s).round() as usize).max(1);
    let settled = (SETTLED_S / flight.tick_s) as usize;
    let estimates = filtered.disturbance_estimates.iter().skip(settled).step_by(apart);
    let axis = |i: usize| estimates.clone().map(|w| w[i]).collect::<Vec<f64>>();
    let all = [
        (Signal::Sideways, "force", vec![axis(0), axis(1)], force),
        (Signal::Vertical, "lift", vec![axis(2)], lift),
    ];
    for (part, name, axes, wander) in all {
        let kurtosis = change_kurtosis(&axes);
        if wander.sigma > LEAST_MPS2 && kurtosis.is_finite() {
            let moment = format!("fourth moment of its changes {kurtosis:.1}; of air that moves by itself 3");
            let size = FINDING.get() * (kurtosis - 3.0) / (UNEVEN - 3.0);
            add(part, name, format!("comes and goes at once ({moment})"), size);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slow walk that keeps to the middle.
    fn random_walk(seed: u64) -> Vec<f64> {
        let (mut state, mut position) = (seed, 0.0);
        let mut step = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            position = 0.9 * position + (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
            position
        };
        (0..310).map(|_| step()).collect()
    }

    #[test]
    fn a_cause_is_told_from_a_consequence_and_from_chance() {
        let series = |walk: &[f64]| StandardSeries::new(walk[..300].to_vec()).unwrap();
        let walk = random_walk(1);
        let place = series(&walk);
        assert!(series(&walk).correlation_z(&place).unwrap() > CLEAR.get());
        // the vehicle is there a second after it was pushed
        assert!(series(&walk[5..]).correlation_z(&place).is_none());
        for seed in 2..20 {
            assert!(
                series(&random_walk(seed)).correlation_z(&place).is_none_or(|z| z.abs() < CLEAR.get()),
                "{seed}"
            );
        }
    }

    #[test]
    fn what_comes_at_once_is_told_from_what_wanders() {
        for seed in 1..40 {
            // five steps are a second, of which there are sixty
            let by_second = |seed: u64| random_walk(seed).into_iter().step_by(5).collect();
            assert!(change_kurtosis(&[by_second(seed), by_second(100 + seed)]) < UNEVEN, "{seed}");
        }
        let fan: Vec<f64> = random_walk(1)
            .iter()
            .take(60)
            .enumerate()
            .map(|(k, v)| 0.02 * v + if k > 25 { 0.5 } else { 0.0 })
            .collect();
        assert!(change_kurtosis(&[fan]) > UNEVEN);
        assert!(change_kurtosis(&[Vec::new()]).is_nan());
    }
}
