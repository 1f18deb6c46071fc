//! Starts for the fit of an effect that has no slope at "off": part of the windows, predicted from many values, each
//! with the starts that then fit it best.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::calibration::search::{EVERY_TO_START, STEPS_TO_START};
use super::scores::Score;
use super::search::Search;
use crate::fit::flight::Window;
use crate::fit::huber::huber;
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::predict::{MeanSimulator, PredictedMeasurement, SensitivitySimulator};
use crate::fit::solve::Solution;

/// A subset of the windows, with their starts and their loss.
pub(super) struct WindowSubset<'a> {
    search: Search<'a>,
    windows: Vec<LinearisedWindow>,
    before: f64,
    /// All windows over those of the subset.
    scale: f64,
}

/// A window with the slopes of its residuals by its start.
struct LinearisedWindow {
    own: Vec<f64>,
    slopes: DMatrix<f64>,
    /// The slopes, each row by its weight.
    weighted: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    /// Distance of the start from the measured one, in standard deviations, if motion capture constrains it.
    start_residuals: Vec<f64>,
}

impl LinearisedWindow {
    fn new(
        search: &Search,
        simulator: &mut SensitivitySimulator,
        window: &Window,
        own: &[f64],
    ) -> Option<Self> {
        let flight = &search.flights[window.flight];
        simulator.predict(flight, window, own);
        let mut residuals: Vec<f64> = simulator.rows().iter().map(PredictedMeasurement::residual).collect();
        let mut slopes: Vec<f64> = simulator.slopes().flatten().copied().collect();
        let (start_residuals, of_start): (Vec<f64>, Vec<f64>) =
            flight.start_residuals(window.ticks.start, own).into_iter().unzip();
        for (i, slope) in of_start.into_iter().enumerate() {
            slopes.extend((0..own.len()).map(|j| if i == j { slope } else { 0.0 }));
        }
        residuals.extend(&start_residuals);
        let slopes = DMatrix::from_row_slice(residuals.len(), own.len(), &slopes);
        let mut weighted = slopes.clone();
        for (mut row, residual) in weighted.row_iter_mut().zip(&residuals) {
            row *= huber(*residual).1;
        }
        let mut curvature = weighted.tr_mul(&slopes);
        for i in 0..own.len() {
            // a number that nothing depends on stays where it is
            curvature[(i, i)] += 1e-9 * (1.0 + curvature[(i, i)]);
        }
        let factor = Cholesky::new(curvature)?;
        Some(LinearisedWindow { own: own.to_vec(), slopes, weighted, factor, start_residuals })
    }

    /// Loss of other predictions, the start following.
    fn loss(&self, residuals: impl Iterator<Item = f64>) -> f64 {
        let residuals: Vec<f64> = residuals.chain(self.start_residuals.iter().copied()).collect();
        let residuals = DVector::from_vec(residuals);
        let moved = self.factor.solve(&self.weighted.tr_mul(&residuals));
        (residuals - &self.slopes * moved).iter().map(|r| huber(*r).0).sum()
    }
}

impl<'a> WindowSubset<'a> {
    /// A part of the windows of a search whose fit is `base`. `None` if the hypothesis cannot be simulated.
    pub fn new(search: &Search<'a>, hypothesis: &Hypothesis, base: &Solution) -> Option<Self> {
        let some = (0..search.windows.len()).step_by(EVERY_TO_START);
        let own: Vec<Vec<f64>> = some.clone().map(|i| base.own[i].clone()).collect();
        let windows = some.map(|i| search.windows[i].clone()).collect();
        let part = Search { flights: search.flights, windows };
        let fitted = part.fit(hypothesis, Some(&own), STEPS_TO_START);
        // from where an effect is fitted, in as many steps: what starts gain by themselves is no gain of its
        let before = part.fit(hypothesis, Some(&fitted.own), STEPS_TO_START).loss;
        let hypothesis = part.rough(hypothesis);
        let mut simulator = SensitivitySimulator::new(&hypothesis, search.flights.first()?, false).ok()?;
        let mut linearised =
            |(window, own): (&Window, &Vec<f64>)| LinearisedWindow::new(&part, &mut simulator, window, own);
        let windows: Option<Vec<_>> = part.windows.iter().zip(&fitted.own).map(&mut linearised).collect();
        let scale = search.windows.len() as f64 / part.windows.len() as f64;
        Some(WindowSubset { search: part, windows: windows?, before, scale })
    }

    /// Returns the start from which the windows gain most, and that gain, for an effect without a slope at "off".
    pub fn best_alternative_start(&self, hypothesis: &Hypothesis, starts: &[Term]) -> Option<Score> {
        let from = |start: &Term| {
            let with = hypothesis.with(start.clone());
            let own: Vec<Vec<f64>> = self.windows.iter().map(|w| w.own.clone()).collect();
            let solution = self.search.fit(&with, Some(&own), STEPS_TO_START);
            (self.scale * (self.before - solution.loss), with.with_values(&solution.shared))
        };
        let nearest = self.nearest_start(hypothesis, starts);
        let tried: Vec<(f64, Hypothesis)> = nearest.par_iter().map(|start| from(start)).collect();
        let (gain, best) = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let start = best.terms.into_iter().find(|t| t.entry.name == starts[0].entry.name)?;
        Some(Score { sd: vec![f64::INFINITY; start.free.len()], start, gain, ahead: None })
    }

    /// Returns the best-predicting start among those that differ from "off"; all of them if the effect has its own
    /// states, which would have to be fitted.
    fn nearest_start<'s>(&self, hypothesis: &Hypothesis, starts: &'s [Term]) -> Vec<&'s Term> {
        let is_off = |t: &Term| t.free.iter().all(|i| t.values[*i] == t.entry.params[*i].off);
        let (off, moved): (Vec<_>, Vec<_>) = starts.iter().partition(|t| t.entry.lags > 0 || is_off(t));
        let loss = |start: &&'s Term| (self.predicted_loss(&hypothesis.with((*start).clone())), *start);
        let losses = moved.par_iter().map(loss);
        let nearest = losses.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start);
        if let (Some(nearest), true) = (nearest, off.iter().all(|t| t.entry.lags == 0)) {
            return vec![nearest];
        }
        off.into_iter().chain(nearest).collect()
    }

    /// Loss of the windows with nothing fitted but where they start.
    fn predicted_loss(&self, hypothesis: &Hypothesis) -> f64 {
        let hypothesis = self.search.rough(&hypothesis.without_free());
        let simulator =
            self.search.flights.first().map(|flight| MeanSimulator::new(&hypothesis, flight, false));
        let Some(Ok(mut simulator)) = simulator else { return f64::INFINITY };
        let loss = |(window, linearised): (&Window, &LinearisedWindow)| {
            simulator.predict(&self.search.flights[window.flight], window, &linearised.own);
            let loss = linearised.loss(simulator.rows().iter().map(PredictedMeasurement::residual));
            if loss.is_finite() { loss } else { f64::INFINITY }
        };
        self.search.windows.iter().zip(&self.windows).map(loss).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explain::calibration::search::STEPS;
    use crate::explain::tests::CommittedCase;
    use crate::fit::flight::Flight;
    use crazyflie_env::effects::find;

    /// The flight that a committed case is fitted to, and what is declared of it.
    fn flights_and_declared(case: &str) -> ([Flight; 1], Hypothesis) {
        let case = CommittedCase::read(case);
        (case.flights(&case.fit), case.declared)
    }

    #[test]
    fn a_prediction_tells_most_of_what_a_fit_of_its_starts_would() {
        let (flights, declared) = flights_and_declared("d01");
        let search = Search::new(&flights);
        let subset = WindowSubset::new(&search, &declared, &search.fit(&declared, None, STEPS)).unwrap();
        let own: Vec<Vec<f64>> = subset.windows.iter().map(|w| w.own.clone()).collect();
        let with = |effect: &str, value: f64| {
            let mut term = Term::off(find(effect).unwrap().1);
            (term.values[0], term.free) = (value, Vec::new());
            declared.with(term)
        };
        for (hypothesis, least_change) in [
            (declared.clone(), 0.0),
            (with("cmd_delay", 0.03), 20.0),
            (with("drag_linear", 0.5), 100.0),
            (with("attitude_gain", 0.9), 20.0),
        ] {
            let fitted = subset.search.fit(&hypothesis, Some(&own), STEPS).loss;
            let predicted = subset.predicted_loss(&hypothesis);
            println!(
                "{:?}: {predicted} predicted, {fitted} fitted, {} before",
                hypothesis.terms, subset.before
            );
            // outliers keep the weights that they had before
            let change = (fitted - subset.before).abs();
            assert!(
                (predicted - fitted).abs() < 0.2 * change + 0.02 * fitted,
                "{predicted} against {fitted}"
            );
            assert!((fitted - subset.before).abs() >= least_change, "{fitted}: it does something");
        }
    }

    #[test]
    fn what_starts_gain_by_themselves_is_no_gain_of_an_effect() {
        let (flights, declared) = flights_and_declared("d01");
        let search = Search::new(&flights);
        let unfinished = search.fit(&declared, None, 0);
        let subset = WindowSubset::new(&search, &declared, &unfinished).unwrap();
        let own: Vec<Vec<f64>> = subset.windows.iter().map(|w| w.own.clone()).collect();
        let starts_gain = subset.search.fit(&declared, Some(&own), 0).loss - subset.before;
        assert!(starts_gain > 1.0, "{starts_gain}: these starts still move");
        // no command is as large
        let idle = Term::off(find("cmd_limit").unwrap().1);
        let score = subset.best_alternative_start(&declared, &[idle]).unwrap();
        assert!(score.gain.abs() < 1e-3 * starts_gain, "{} of {starts_gain}", score.gain);
    }

    #[test]
    fn starts_that_say_nothing_by_themselves_are_all_kept() {
        let (flights, declared) = flights_and_declared("d07");
        let search = Search::new(&flights);
        let subset = WindowSubset::new(&search, &declared, &search.fit(&declared, None, STEPS)).unwrap();
        let start = |effect: &str, values: &[f64]| {
            let mut term = Term::off(find(effect).unwrap().1);
            term.values[..values.len()].copy_from_slice(values);
            term
        };
        // at "off" a weak motor of any number is none; commands that are lost are late in the mean
        let motors: Vec<Term> = [1.0, 2.0, 3.0, 4.0].map(|motor| start("weak_motor", &[motor])).to_vec();
        assert_eq!(subset.nearest_start(&declared, &motors).len(), 4);
        let delays: Vec<Term> = [0.0, 0.012, 0.1].map(|delay_s| start("cmd_delay", &[delay_s])).to_vec();
        let nearest = subset.nearest_start(&declared, &delays);
        assert_eq!(nearest.iter().map(|t| t.values[0]).collect::<Vec<_>>(), [0.012]);
    }
}
