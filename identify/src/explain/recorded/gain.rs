//! Gain of a change of a hypothesis: its effect on predictions, stretch by stretch and axis by axis.

use std::collections::BTreeMap;

use crate::axis_errors::AxisErrors;
use crate::explain::calibration::recorded::{CHANCE_OF_HARM, FLIGHTS_TO_TEST, HARM, LEAST_GAIN};
use crazyflie_statistics::{mean, paired_p_value};

/// Rows of [`AxisErrors`] that are judged: sideways and vertical velocity, and tilt. The velocity in space adds
/// nothing to them.
pub(super) const JUDGED: [usize; 3] = [0, 1, 3];

/// Logarithms of errors over those before: per stretch, judged axis and horizon.
pub struct Gain {
    log_ratios: Vec<[[f64; 2]; 3]>,
    /// Flight of each stretch.
    flights: Vec<String>,
}

impl Gain {
    pub fn new(before: &[AxisErrors], after: &[AxisErrors]) -> Self {
        let ratio = |(b, a): (&AxisErrors, &AxisErrors)| {
            JUDGED.map(|axis| [0, 1].map(|h| (a.rms[axis][h] / b.rms[axis][h]).ln()))
        };
        Gain {
            log_ratios: before.iter().zip(after).map(ratio).collect(),
            flights: before.iter().map(|e| e.flight.clone()).collect(),
        }
    }

    /// Computes the mean of each stretch over axes and horizons.
    fn per_stretch(&self) -> Vec<f64> {
        self.log_ratios.iter().map(|cells| cells.iter().flatten().sum::<f64>() / 6.0).collect()
    }

    /// The mean over all: below zero the change helps.
    pub fn mean(&self) -> f64 {
        mean(&self.per_stretch()).unwrap_or(f64::NAN)
    }

    /// Computes the mean of each judged axis.
    pub fn by_axis(&self) -> [f64; 3] {
        let both =
            |axis: usize| self.log_ratios.iter().map(move |cells| 0.5 * (cells[axis][0] + cells[axis][1]));
        [0, 1, 2].map(|axis| mean(&both(axis).collect::<Vec<_>>()).unwrap_or(f64::NAN))
    }

    /// Probability that chance alone gives so large a mean, by a paired test over stretches.
    pub fn p_value(&self) -> f64 {
        paired_p_value(&self.per_stretch()).unwrap_or(1.0)
    }

    /// Returns whether any axis is worse at any horizon, beyond chance.
    pub fn harms(&self) -> bool {
        let harms = |cell: usize| {
            let ratios = self.log_ratios.iter().map(|cells| cells.as_flattened()[cell]).collect::<Vec<f64>>();
            let worse = mean(&ratios).unwrap_or(f64::NAN);
            worse > HARM && paired_p_value(&ratios).is_none_or(|p| p < CHANCE_OF_HARM)
        };
        (0..6).any(harms)
    }

    /// Returns whether predictions gain this share in all, and no axis and no flight loses.
    pub fn helps(&self, least: f64) -> bool {
        self.mean() < -least && !self.harms() && self.spares_every_flight()
    }

    /// Returns whether no one of a few flights loses: stretches of one flight are not independent, and a test over
    /// them would generalise a property of one flight to all.
    fn spares_every_flight(&self) -> bool {
        let mut by_flight: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (flight, ratio) in self.flights.iter().zip(self.per_stretch()) {
            by_flight.entry(flight).or_default().push(ratio);
        }
        by_flight.len() >= FLIGHTS_TO_TEST
            || by_flight.values().all(|ratios| mean(ratios).unwrap_or(f64::NAN) < LEAST_GAIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(sideways: f64, vertical: impl Fn(usize) -> f64) -> Vec<AxisErrors> {
        let rms = |i: usize| [[sideways; 2], [vertical(i); 2], [1.0; 2], [0.1; 2]];
        (0..8).map(|i| AxisErrors { flight: i.to_string(), predictions: 10, rms: rms(i) }).collect()
    }

    #[test]
    fn a_large_gain_on_one_axis_does_not_hide_harm_to_another() {
        let before = errors(1.0, |_| 1.0);
        let worse = Gain::new(&before, &errors(0.2, |i| 1.1 + 0.01 * i as f64));
        assert!(worse.mean() < -0.4 && worse.harms());
        let chance = Gain::new(&before, &errors(0.2, |i| if i % 2 == 0 { 1.3 } else { 0.8 }));
        assert!(!chance.harms());
        let [sideways, vertical, tilt] = chance.by_axis();
        // here every flight has one stretch, and there are enough of them for a test
        assert!(chance.spares_every_flight());
        let few = Gain::new(&before[..4], &errors(0.9, |i| if i == 2 { 1.5 } else { 0.9 })[..4]);
        assert!(few.mean() < 0.0 && !few.spares_every_flight());
        assert!((sideways - 0.2_f64.ln()).abs() < 1e-12 && vertical.abs() < 0.1 && tilt == 0.0);
    }
}
