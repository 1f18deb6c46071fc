//! Slopes of a flight's likelihood by parameters that are fixed: gradient and information, by the sensitivities of
//! the filter's estimate. One run yields those of all effects.

use crazyflie_env::dual::Dual;
use crazyflie_env::sim_scalar::SimScalar;

use super::filter::{Disturbances, ParameterPrior, predict_tick};
use super::flight::Flight;
use super::hypothesis::Hypothesis;
use super::kalman::{FilterStart, KalmanFilter, TickPropagation};
use super::matrix::{add_scaled, combine_rows, padded};
use super::predict::SensitivitySimulator;
use super::solve::NormalEquations;

/// Computes the negative log-likelihood of a flight near the values of a hypothesis, to second order in its free
/// parameters. Returns `None` if it cannot be simulated or the filter breaks down.
pub fn likelihood_slopes(
    flight: &Flight,
    hypothesis: &Hypothesis,
    disturbances: &Disturbances,
) -> Option<NormalEquations> {
    let parameters = hypothesis.free_values().len();
    let mut sum = NormalEquations::new(parameters);
    let mut simulator = SensitivitySimulator::new(hypothesis, flight, true).ok()?;
    let start = FilterStart::at_tick(&mut simulator, flight, 0, hypothesis);
    let mut k = KalmanFilter::new(flight, start, &ParameterPrior::default(), disturbances);
    let mut estimate = EstimateSlopes::new(k.states(), k.vehicle().len(), parameters);
    for tick in flight.all_ticks() {
        predict_tick(&mut simulator, &k, flight, tick);
        let disturbed = k.disturbance_estimate();
        for (row, slopes) in simulator.rows().iter().zip(simulator.slopes()) {
            sum.loss += k.update(row, row.predicted, &disturbed, slopes)?.loss;
            Dual::run(
                #[inline(always)]
                || estimate.update(&k, slopes, &mut sum),
            );
        }
        k.accept_command(flight.command(tick as isize + 1));
        simulator.remember_tick(flight.tick_s);
        let (end, slopes) = simulator.end();
        let propagation = k.propagate(end, slopes);
        Dual::run(
            #[inline(always)]
            || estimate.propagate(&propagation, slopes),
        );
    }
    sum.symmetrise();
    Some(sum)
}

/// Slopes of the filter's estimate by the parameters, a padded row for each of its states.
struct EstimateSlopes {
    own: usize,
    states: usize,
    parameters: usize,
    rows: Vec<f64>,
    next: Vec<f64>,
    predicted: Vec<f64>,
}

impl EstimateSlopes {
    fn new(states: usize, own: usize, parameters: usize) -> Self {
        let stride = padded(parameters);
        let (rows, predicted) = (vec![0.0; states * stride], vec![0.0; stride]);
        EstimateSlopes { own, states, parameters, next: rows.clone(), rows, predicted }
    }

    /// After a measurement, whose prediction has these slopes by all unknowns of the simulator.
    #[inline(always)]
    fn update(&mut self, k: &KalmanFilter, slopes: &[f64], sum: &mut NormalEquations) {
        let (p, stride) = (self.parameters, padded(self.parameters));
        let update = k.last_update();
        combine_rows(&mut self.predicted, &update.slopes[..self.states], &self.rows);
        add_scaled(&mut self.predicted[..p], 1.0, &slopes[self.own..self.own + p]);
        for (row, by) in self.rows.chunks_exact_mut(stride.max(1)).zip(update.covariance) {
            add_scaled(row, -update.gain * by, &self.predicted);
        }
        add_scaled(sum.gradient.as_mut_slice(), update.gain * update.error, &self.predicted);
        let information = sum.information.as_mut_slice();
        for (j, by) in self.predicted[..p].iter().enumerate().filter(|(_, by)| **by != 0.0) {
            // the upper triangle, column by column
            add_scaled(&mut information[j * p..=j * p + j], update.gain * by, &self.predicted);
        }
    }

    /// A tick on, by the transition of the filter and the simulator's slopes at its end.
    #[inline(always)]
    fn propagate(&mut self, tick: &TickPropagation, end_slopes: &[f64]) {
        let (own, states, p) = (self.own, self.states, self.parameters);
        let (stride, unknowns) = (padded(p), end_slopes.len() / own);
        for i in 0..own {
            let next = &mut self.next[i * stride..(i + 1) * stride];
            combine_rows(next, &tick.transition[i * padded(states)..][..states], &self.rows);
            add_scaled(&mut next[..p], 1.0, &end_slopes[i * unknowns + own..i * unknowns + own + p]);
        }
        for (j, decay) in tick.decays.iter().enumerate() {
            let here = (own + j) * stride..(own + j + 1) * stride;
            for (next, row) in self.next[here.clone()].iter_mut().zip(&self.rows[here]) {
                *next = decay * row;
            }
        }
        std::mem::swap(&mut self.rows, &mut self.next);
    }
}
