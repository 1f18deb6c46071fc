//! An extended Kalman filter around the simulator. Its innovations show whether anything is left, and its likelihood
//! compares hypotheses. Besides the vehicle's state it estimates slow disturbances, and parameters of the hypothesis
//! as constants still to be learned.

use std::ops::Range;

use super::flight::{Flight, Window};
use super::hypothesis::Hypothesis;
use super::kalman::{FilterStart, KalmanFilter};
use super::packet_loss_moments::PacketLossMoments;
use super::predict::{PUSH, PredictedMeasurement, SensitivitySimulator};

/// Other disturbances that fall this much log-likelihood behind on the way are given up. A move is taken for a
/// fraction of one: a hypothesis twenty behind does not become the best.
const ABANDON_LOSS: f64 = 20.0;

/// A first-order Gauss-Markov process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussMarkov {
    /// Standard deviation; 0 for none.
    pub sigma: f64,
    /// Correlation time.
    pub tau_s: f64,
}

/// Random disturbances of a flight beyond white measurement noise, each a Gauss-Markov process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbances {
    /// Horizontal acceleration, m/s^2.
    pub force: GaussMarkov,
    /// Vertical acceleration, m/s^2.
    pub lift: GaussMarkov,
    /// Angular acceleration of roll and pitch, rad/s^2.
    pub torque: GaussMarkov,
    /// Angular acceleration of yaw, rad/s^2.
    pub turn: GaussMarkov,
    /// Position of the marker, m.
    pub marker: GaussMarkov,
}

impl Disturbances {
    /// The process of each disturbed number: the push, then the marker.
    pub(super) fn processes(&self) -> [GaussMarkov; PUSH + 3] {
        let Disturbances { force, lift, torque, turn, marker } = *self;
        [force, force, lift, torque, torque, turn, marker, marker, marker]
    }

    pub(crate) fn processes_mut(&mut self) -> [&mut GaussMarkov; 5] {
        [&mut self.force, &mut self.lift, &mut self.torque, &mut self.turn, &mut self.marker]
    }
}

/// Normal prior of the free parameters. After a flight it is the posterior, and the prior of the next flight.
#[derive(Debug, Clone, Default)]
pub struct ParameterPrior {
    /// Expected values, in the order of [`Hypothesis::free_values`].
    pub mean: Vec<f64>,
    /// Covariance, row by row.
    pub covariance: Vec<f64>,
}

impl ParameterPrior {
    /// Independent parameters.
    pub fn independent(mean: Vec<f64>, sd: &[f64]) -> Self {
        let n = mean.len();
        let mut covariance = vec![0.0; n * n];
        for i in 0..n {
            covariance[i * n + i] = sd[i] * sd[i];
        }
        ParameterPrior { mean, covariance }
    }

    /// Returns the standard deviation of the parameter at this place, in its own unit.
    pub fn sd(&self, i: usize) -> f64 {
        self.covariance[i * self.mean.len() + i].max(0.0).sqrt()
    }
}

/// A measured number less its prediction from all data before, in standard deviations of that difference.
#[derive(Debug, Clone, Copy)]
pub struct Innovation {
    /// Time of the measurement since the first tick of the flight.
    pub t_s: f64,
    /// See [`super::predict::PredictedMeasurement::channel`].
    pub channel: usize,
    /// The difference in its standard deviations, outliers as they are.
    pub normalised: f64,
    /// Logarithm of that standard deviation, over the measurement's own.
    pub log_sd: f64,
    /// Its share of the negative log-likelihood.
    pub loss: f64,
}

/// Likelihood, innovations and estimates of one pass over a flight.
#[derive(Debug, Clone, Default)]
pub struct FilterResult {
    /// Negative log-likelihood of the measurements, robust as in the fits.
    pub loss: f64,
    /// The same up to each tick, that one left out.
    pub losses: Vec<f64>,
    /// One innovation per measured number, tick by tick.
    pub innovations: Vec<Innovation>,
    /// The free parameters after the flight.
    pub posterior: ParameterPrior,
    /// The vehicle's own numbers at the start of each tick (see [`SensitivitySimulator`]), from all
    /// measurements before it.
    pub states: Vec<Vec<f64>>,
    /// Estimated disturbance after each tick: push, then marker.
    pub disturbance_estimates: Vec<[f64; PUSH + 3]>,
}

/// Predicts a tick from a filter's estimate; rows, slopes and end are then in the simulator.
pub(super) fn predict_tick(
    simulator: &mut SensitivitySimulator,
    k: &KalmanFilter,
    flight: &Flight,
    tick: usize,
) {
    let disturbed = k.disturbance_estimate();
    simulator.set_push(std::array::from_fn(|i| disturbed[i]));
    simulator.clear_start_slopes();
    simulator.predict_from(flight, &Window { flight: 0, ticks: tick..tick + 1 }, k.vehicle());
}

/// Runs the filter over a whole flight with all parameters fixed, see [`filter_below`].
pub fn filter_fixed(flight: &Flight, hypothesis: &Hypothesis, under: &Disturbances) -> Option<FilterResult> {
    filter_below(flight, &hypothesis.without_free(), &ParameterPrior::default(), under, &|_| f64::INFINITY)
}

/// Runs the filter over a whole flight, and gives up once the loss before a tick exceeds `most` there. The parameters
/// that `hypothesis` has free are learned, starting from `prior`. `None` if the hypothesis cannot be simulated or the
/// filter breaks down.
pub fn filter_below(
    flight: &Flight,
    hypothesis: &Hypothesis,
    prior: &ParameterPrior,
    disturbances: &Disturbances,
    most: &dyn Fn(usize) -> f64,
) -> Option<FilterResult> {
    let mut go_on = |seen: ObservedTick| seen.loss <= most(seen.tick);
    filter_observed(flight, flight.all_ticks(), hypothesis, prior, disturbances, &mut go_on)
}

/// State of a tick that was predicted and not yet compared.
struct ObservedTick<'a> {
    tick: usize,
    simulator: &'a SensitivitySimulator,
    /// Estimate and disturbances from which it went on.
    x: &'a [f64],
    disturbed: &'a [f64; PUSH + 3],
    /// Loss of all ticks before.
    loss: f64,
}

/// Observer that returns whether to continue.
type TickObserver<'a> = dyn FnMut(ObservedTick<'_>) -> bool + 'a;

/// Runs the filter with an observer called in each tick. Returns `None` also if the observer stops it.
fn filter_observed(
    flight: &Flight,
    ticks: Range<usize>,
    hypothesis: &Hypothesis,
    prior: &ParameterPrior,
    disturbances: &Disturbances,
    observe: &mut TickObserver<'_>,
) -> Option<FilterResult> {
    let start_hypothesis = hypothesis.with_values(&prior.mean);
    let mut simulator = SensitivitySimulator::new(&start_hypothesis, flight, true).ok()?;
    let start = FilterStart::at_tick(&mut simulator, flight, ticks.start, &start_hypothesis);
    let mut k = KalmanFilter::new(flight, start, prior, disturbances);
    let mut out = FilterResult::default();
    for tick in ticks {
        simulator.set_free(k.parameters()).ok()?;
        let disturbed = k.disturbance_estimate();
        out.disturbance_estimates.push(disturbed);
        out.states.push(k.vehicle().to_vec());
        predict_tick(&mut simulator, &k, flight, tick);
        let (simulator_seen, x) = (&simulator, k.vehicle());
        let seen = ObservedTick { tick, simulator: simulator_seen, x, disturbed: &disturbed, loss: out.loss };
        observe(seen).then_some(())?;
        out.losses.push(out.loss);
        for (row, slopes) in simulator.rows().iter().zip(simulator.slopes()) {
            let innovation = k.update(row, row.predicted, &disturbed, slopes)?;
            out.loss += innovation.loss;
            out.innovations.push(innovation);
        }
        k.accept_command(flight.command(tick as isize + 1));
        simulator.remember_tick(flight.tick_s);
        let (end, slopes) = simulator.end();
        k.propagate(end, slopes);
    }
    out.posterior = k.posterior();
    Some(out)
}

/// A tick of a filtered flight, linearised about the estimate of then.
struct LinearisedTick {
    /// The vehicle's own numbers, then the push.
    point: Vec<f64>,
    rows: Vec<PredictedMeasurement>,
    slopes: Vec<f64>,
    end: Vec<f64>,
    end_slopes: Vec<f64>,
}

/// A filtered segment of a flight, linearised about its estimate. Under other disturbances it is filtered
/// again without the simulator, exact to first order in the difference of the estimates.
pub struct LinearisedSegment {
    start: FilterStart,
    first: isize,
    ticks: Vec<LinearisedTick>,
}

impl LinearisedSegment {
    /// Filters a segment and keeps its linearisation. Nothing is learned.
    pub fn new(
        flight: &Flight,
        ticks: Range<usize>,
        hypothesis: &Hypothesis,
        disturbances: &Disturbances,
    ) -> Option<Self> {
        let (first, mut linearised) = (ticks.start, Vec::with_capacity(ticks.len()));
        let mut linearise = |seen: ObservedTick| {
            let simulator = seen.simulator;
            let (end, end_slopes) = simulator.end();
            linearised.push(LinearisedTick {
                point: [seen.x, &seen.disturbed[..PUSH]].concat(),
                rows: simulator.rows().to_vec(),
                slopes: simulator.slopes().flatten().copied().collect(),
                end: end.to_vec(),
                end_slopes: end_slopes.to_vec(),
            });
            true
        };
        let (fixed, nothing) = (hypothesis.without_free(), ParameterPrior::default());
        let filtered = filter_observed(flight, ticks, &fixed, &nothing, disturbances, &mut linearise)?;
        let vehicle = filtered.states.into_iter().next()?;
        let start = FilterStart {
            push: vehicle.len(),
            vehicle,
            lags_sd: hypothesis.lags_sd(flight.input),
            packet_loss: PacketLossMoments::at_tick(hypothesis, flight, first),
        };
        Some(LinearisedSegment { start, first: first as isize, ticks: linearised })
    }

    /// Negative log-likelihood under other disturbances, summed up to each tick. Ends early where it has
    /// fallen hopelessly behind `least`.
    pub fn losses(&self, flight: &Flight, under: &Disturbances, least: Option<&[f64]>) -> Option<Vec<f64>> {
        let mut k = KalmanFilter::new(flight, self.start.clone(), &ParameterPrior::default(), under);
        let (own, mut loss) = (self.start.vehicle.len(), 0.0);
        let (mut off, mut end) = (vec![0.0; own + PUSH], vec![0.0; own]);
        let mut losses = Vec::with_capacity(self.ticks.len());
        for (index, tick) in self.ticks.iter().enumerate() {
            let disturbed = k.disturbance_estimate();
            for (i, off) in off.iter_mut().enumerate() {
                *off = if i < own { k.vehicle()[i] } else { disturbed[i - own] } - tick.point[i];
            }
            let change_along = |slopes: &[f64]| slopes.iter().zip(&off).map(|(s, o)| s * o).sum::<f64>();
            for (row, slopes) in tick.rows.iter().zip(tick.slopes.chunks_exact(own + PUSH)) {
                let predicted = row.predicted + row.sigma * change_along(slopes);
                loss += k.update(row, predicted, &disturbed, slopes)?.loss;
            }
            k.accept_command(flight.command(self.first + index as isize + 1));
            losses.push(loss);
            if least.is_some_and(|least| loss > least[index] + ABANDON_LOSS) {
                return None;
            }
            let ends = tick.end.iter().zip(tick.end_slopes.chunks_exact(own + PUSH));
            end.iter_mut()
                .zip(ends)
                .for_each(|(end, (at_point, slopes))| *end = at_point + change_along(slopes));
            k.propagate(&end, &tick.end_slopes);
        }
        Some(losses)
    }

    /// Negative log-likelihood of the whole segment.
    pub fn loss(&self, flight: &Flight, disturbances: &Disturbances) -> f64 {
        let losses = self.losses(flight, disturbances, None);
        losses.and_then(|losses| losses.last().copied()).unwrap_or(f64::INFINITY)
    }
}
