//! An extended Kalman filter around the simulator. Its innovations tell whether anything is left, and its
//! likelihood compares hypotheses. Besides the vehicle's state it estimates slow disturbances, and parameters
//! of the hypothesis as constants still to be learned.

use std::ops::Range;

use crazyflie_env::dual::Dual;
use crazyflie_env::plant::Command;
use crazyflie_env::sim_scalar::SimScalar;

use super::flight::{Flight, Window};
use super::hypothesis::Hypothesis;
use super::matrix::{add_scaled, combine_rows, padded, subtract_outer_product, symmetric_product};
use super::packet_loss_moments::{AXES, PacketLossMoments};
use super::predict::{PUSH, PredictedMeasurement, START, SensitivitySimulator};
use super::solve::HUBER;

/// Initial standard deviations of the measured start: m, m/s, rad and rad/s.
const START_SD: [f64; 4] = [0.05, 0.3, 0.05, 1.0];

/// A likelihood search abandons a candidate that falls this much log-likelihood behind.
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
    /// No disturbances: every standard deviation is 0.
    pub const NONE: Disturbances = Disturbances {
        force: GaussMarkov { sigma: 0.0, tau_s: 1.0 },
        lift: GaussMarkov { sigma: 0.0, tau_s: 1.0 },
        torque: GaussMarkov { sigma: 0.0, tau_s: 0.3 },
        turn: GaussMarkov { sigma: 0.0, tau_s: 1.0 },
        marker: GaussMarkov { sigma: 0.0, tau_s: 3.0 },
    };

    /// The process of each disturbed number: the push, then the marker.
    fn processes(&self) -> [GaussMarkov; PUSH + 3] {
        let Disturbances { force, lift, torque, turn, marker } = *self;
        [force, force, lift, torque, torque, turn, marker, marker, marker]
    }

    pub(crate) fn processes_mut(&mut self) -> [&mut GaussMarkov; 5] {
        [&mut self.force, &mut self.lift, &mut self.torque, &mut self.turn, &mut self.marker]
    }
}

/// Normal prior of the free parameters. After a flight it is the posterior, and the prior of the next flight.
#[derive(Debug, Clone)]
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

/// A measured number less its prediction from all that came before, in standard deviations of that
/// difference.
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
#[derive(Debug, Clone)]
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

/// A state of the filter beyond the vehicle's.
struct AugmentedState {
    /// Its column among the simulator's slopes; a marker's error has none: it moves one measured axis.
    column: Option<usize>,
    axis: usize,
    /// Its effect on that axis, per unit.
    unit: f64,
    decay: f64,
    /// Variance in the long run, and gained per tick.
    variance: f64,
    gain: f64,
}

/// The augmented states: parameters still to be learned, disturbances that are not nothing, deviations of the
/// obeyed command. The simulator's slopes by a push begin at the column `push`.
fn augmented_states(
    flight: &Flight,
    own: usize,
    learned: usize,
    push: usize,
    disturbances: &Disturbances,
    packet_loss: Option<&PacketLossMoments>,
) -> Vec<AugmentedState> {
    let constant = |i: usize| AugmentedState {
        column: Some(own + i),
        axis: 0,
        unit: 1.0,
        decay: 1.0,
        variance: 0.0,
        gain: 0.0,
    };
    let gauss_markov = |(i, w): (usize, GaussMarkov)| {
        let (decay, variance) = ((-flight.tick_s / w.tau_s).exp(), w.sigma * w.sigma);
        let column = (i < PUSH).then_some(push + i);
        AugmentedState { column, axis: i, unit: 1.0, decay, variance, gain: variance * (1.0 - decay * decay) }
    };
    let disturbed = disturbances.processes().into_iter().enumerate().filter(|(_, w)| w.sigma > 0.0);
    let deviations = |packet_loss: &PacketLossMoments| {
        let (push_per_unit, variance) = (packet_loss.push_per_unit, packet_loss.variance());
        let deviation = move |i: usize| {
            let column = Some(push + AXES[i]);
            AugmentedState {
                column,
                axis: AXES[i],
                unit: push_per_unit[i],
                decay: 0.0,
                variance: variance[i],
                gain: 0.0,
            }
        };
        (0..AXES.len()).map(deviation)
    };
    (0..learned)
        .map(constant)
        .chain(disturbed.map(gauss_markov))
        .chain(packet_loss.into_iter().flat_map(deviations))
        .collect()
}

/// Estimate and covariance, whose rows are padded, with room to compute.
pub(super) struct KalmanFilter {
    own: usize,
    learned: usize,
    augmented: Vec<AugmentedState>,
    packet_loss: Option<PacketLossMoments>,
    x: Vec<f64>,
    p: Vec<f64>,
    /// Rows as long as those of `p`, padded.
    h: Vec<f64>,
    ph: Vec<f64>,
    /// Correction of the estimate by the measurements of a tick.
    correction: Vec<f64>,
    /// Of the last update, see [`MeasurementUpdate`].
    gain: f64,
    error: f64,
    buffers: PropagationBuffers,
}

/// What a measurement did to a filter, in standard deviations of the measurement.
pub(super) struct MeasurementUpdate<'a> {
    /// The prediction's slopes by the states of the filter.
    pub slopes: &'a [f64],
    /// Covariance of the states with the prediction.
    pub covariance: &'a [f64],
    /// Weight of the error over its variance.
    pub gain: f64,
    /// Measured less predicted.
    pub error: f64,
}

/// How the states of a filter went on in a tick: the vehicle's own by a matrix of padded rows over all
/// states, the others by a factor each.
pub(super) struct TickPropagation<'a> {
    pub transition: &'a [f64],
    pub decays: &'a [f64],
}

impl KalmanFilter {
    /// At the measured start of a tick. What is free in the hypothesis without a prior is held fast.
    pub fn at_tick(
        simulator: &mut SensitivitySimulator,
        flight: &Flight,
        tick: usize,
        hypothesis: &Hypothesis,
        prior: &ParameterPrior,
        disturbances: &Disturbances,
    ) -> Self {
        let mut start = flight.measured_numbers(tick);
        let lags = simulator.initial_lags(flight, tick, &start);
        start.extend(lags);
        let push = start.len() + hypothesis.free_values().len();
        let packet_loss = PacketLossMoments::at_tick(hypothesis, flight, tick);
        Self::new(flight, start, push, &hypothesis.lags_sd(flight.input), prior, disturbances, packet_loss)
    }

    fn new(
        flight: &Flight,
        start: Vec<f64>,
        push: usize,
        lags_sd: &[f64],
        prior: &ParameterPrior,
        disturbances: &Disturbances,
        packet_loss: Option<PacketLossMoments>,
    ) -> Self {
        let (own, learned) = (start.len(), prior.mean.len());
        let augmented = augmented_states(flight, own, learned, push, disturbances, packet_loss.as_ref());
        let n = own + augmented.len();
        let (x, p) = initial_estimate(start, lags_sd, prior, &augmented);
        let row = vec![0.0; padded(n)];
        KalmanFilter {
            own,
            learned,
            augmented,
            packet_loss,
            x,
            p,
            h: row.clone(),
            ph: row.clone(),
            correction: row,
            gain: 0.0,
            error: 0.0,
            buffers: PropagationBuffers::new(own, n),
        }
    }

    /// Numbers of the vehicle itself, the first of the states.
    pub fn own(&self) -> usize {
        self.own
    }

    /// Number of the states.
    pub fn states(&self) -> usize {
        self.x.len()
    }

    /// What the last measurement did.
    pub fn last_update(&self) -> MeasurementUpdate<'_> {
        MeasurementUpdate { slopes: &self.h, covariance: &self.ph, gain: self.gain, error: self.error }
    }

    /// The disturbances as they are estimated: push, then marker.
    pub fn disturbance_estimate(&self) -> [f64; PUSH + 3] {
        let mut all = [0.0; PUSH + 3];
        for (state, value) in self.augmented[self.learned..].iter().zip(&self.x[self.own + self.learned..]) {
            all[state.axis] += state.unit * value;
        }
        all
    }

    /// Advances the moments of the obeyed command to a new command.
    pub fn accept_command(&mut self, u: &Command<f64>) {
        let Some(packet_loss) = &mut self.packet_loss else { return };
        let first = self.augmented.len() - AXES.len();
        for (state, deviation) in self.augmented[first..].iter_mut().zip(packet_loss.advance(u)) {
            (state.decay, state.gain) = (deviation.stays, deviation.gain);
        }
    }

    /// Measurement update for a row whose prediction at the estimate, and its slopes in standard deviations,
    /// are known. `None` where the filter breaks down.
    pub fn update(
        &mut self,
        row: &PredictedMeasurement,
        predicted: f64,
        disturbed: &[f64; PUSH + 3],
        slopes: &[f64],
    ) -> Option<Innovation> {
        let own = self.own;
        let marker = if row.channel < 3 { 0.0 } else { disturbed[PUSH + row.channel - 3] };
        self.h[..own].copy_from_slice(&slopes[..own]);
        for (slot, state) in self.h[own..].iter_mut().zip(&self.augmented) {
            let seen = || if state.axis == PUSH + row.channel - 3 { 1.0 / row.sigma } else { 0.0 };
            *slot = state.column.map_or_else(
                || if row.channel < 3 { 0.0 } else { seen() },
                |column| slopes[column] * state.unit,
            );
        }
        let already: f64 = self.h.iter().zip(&self.correction).map(|(h, m)| h * m).sum();
        // in standard deviations of the measurement, whose variance is then 1
        let error = (row.measured - predicted - marker) / row.sigma - already;
        symmetric_product(&self.p, &self.h, &mut self.ph);
        let variance = 1.0 + self.h.iter().zip(&self.ph).map(|(h, p)| h * p).sum::<f64>();
        let z = error / variance.sqrt();
        if !z.is_finite() {
            return None;
        }
        let weight = if z.abs() > HUBER { HUBER / z.abs() } else { 1.0 };
        let log_sd = 0.5 * variance.ln();
        let loss = if weight < 1.0 { HUBER * (z.abs() - 0.5 * HUBER) } else { 0.5 * z * z } + log_sd;
        (self.gain, self.error) = (weight / variance, error);
        add_scaled(&mut self.correction, self.gain * error, &self.ph);
        subtract_outer_product(&mut self.p, self.gain, &self.ph);
        Some(Innovation { t_s: row.t_s, channel: row.channel, normalised: z, log_sd, loss })
    }
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
    simulator.predict_from(flight, &Window { flight: 0, ticks: tick..tick + 1 }, &k.x[..k.own]);
}

/// Run the filter over some ticks of a flight. The parameters that `hypothesis` has free are learned,
/// starting from `prior`. `None` if the hypothesis cannot be simulated or the filter breaks down.
pub fn filter(
    flight: &Flight,
    ticks: Range<usize>,
    hypothesis: &Hypothesis,
    prior: &ParameterPrior,
    disturbances: &Disturbances,
) -> Option<FilterResult> {
    filter_observed(flight, ticks, hypothesis, prior, disturbances, &mut |_| true)
}

/// As [`filter`], over a whole flight, given up where the loss before a tick exceeds `most` there.
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

/// What there is to see of a tick that was predicted and not yet compared.
struct ObservedTick<'a> {
    tick: usize,
    simulator: &'a SensitivitySimulator,
    /// Estimate and disturbances from which it went on.
    x: &'a [f64],
    disturbed: &'a [f64; PUSH + 3],
    /// Of all ticks before.
    loss: f64,
}

/// Observer that says whether to go on.
type TickObserver<'a> = dyn FnMut(ObservedTick<'_>) -> bool + 'a;

/// As [`filter`], with an observer called in each tick. `None` too where it does not go on.
fn filter_observed(
    flight: &Flight,
    ticks: Range<usize>,
    hypothesis: &Hypothesis,
    prior: &ParameterPrior,
    disturbances: &Disturbances,
    observe: &mut TickObserver<'_>,
) -> Option<FilterResult> {
    let learned = prior.mean.len();
    let start_hypothesis = hypothesis.with_values(&prior.mean);
    let mut simulator = SensitivitySimulator::new(&start_hypothesis, flight, true).ok()?;
    let mut k =
        KalmanFilter::at_tick(&mut simulator, flight, ticks.start, &start_hypothesis, prior, disturbances);
    let own = k.own;
    let mut out = FilterResult {
        loss: 0.0,
        losses: Vec::new(),
        innovations: Vec::new(),
        posterior: prior.clone(),
        states: Vec::new(),
        disturbance_estimates: Vec::new(),
    };
    for tick in ticks {
        simulator.set_free(&k.x[own..own + learned]).ok()?;
        let disturbed = k.disturbance_estimate();
        out.disturbance_estimates.push(disturbed);
        out.states.push(k.x[..own].to_vec());
        predict_tick(&mut simulator, &k, flight, tick);
        let seen = ObservedTick {
            tick,
            simulator: &simulator,
            x: &k.x[..own],
            disturbed: &disturbed,
            loss: out.loss,
        };
        if !observe(seen) {
            return None;
        }
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
    let stride = padded(k.x.len());
    out.posterior.mean.copy_from_slice(&k.x[own..own + learned]);
    for i in 0..learned {
        for j in 0..learned {
            out.posterior.covariance[i * learned + j] = k.p[(own + i) * stride + own + j];
        }
    }
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
    start: Vec<f64>,
    lags_sd: Vec<f64>,
    first: isize,
    packet_loss: Option<PacketLossMoments>,
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
        let nothing = ParameterPrior::independent(Vec::new(), &[]);
        let mut linearised = Vec::with_capacity(ticks.len());
        let (first, packet_loss) =
            (ticks.start as isize, PacketLossMoments::at_tick(hypothesis, flight, ticks.start));
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
        let filtered = filter_observed(
            flight,
            ticks,
            &hypothesis.without_free(),
            &nothing,
            disturbances,
            &mut linearise,
        )?;
        Some(LinearisedSegment {
            start: filtered.states.into_iter().next()?,
            lags_sd: hypothesis.lags_sd(flight.input),
            first,
            packet_loss,
            ticks: linearised,
        })
    }

    /// Negative log-likelihood under other disturbances, summed up to each tick. Ends early where it has
    /// fallen hopelessly behind `least`.
    pub fn losses(
        &self,
        flight: &Flight,
        disturbances: &Disturbances,
        least: Option<&[f64]>,
    ) -> Option<Vec<f64>> {
        let nothing = ParameterPrior::independent(Vec::new(), &[]);
        let mut k = KalmanFilter::new(
            flight,
            self.start.clone(),
            self.start.len(),
            &self.lags_sd,
            &nothing,
            disturbances,
            self.packet_loss.clone(),
        );
        let (own, mut loss) = (k.own, 0.0);
        let (mut off, mut end) = (vec![0.0; own + PUSH], vec![0.0; own]);
        let mut losses = Vec::with_capacity(self.ticks.len());
        for (index, tick) in self.ticks.iter().enumerate() {
            let disturbed = k.disturbance_estimate();
            for (i, off) in off.iter_mut().enumerate() {
                *off = if i < own { k.x[i] } else { disturbed[i - own] } - tick.point[i];
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
            for ((end, end_at_point), slopes) in
                end.iter_mut().zip(&tick.end).zip(tick.end_slopes.chunks_exact(own + PUSH))
            {
                *end = end_at_point + change_along(slopes);
            }
            k.propagate(&end, &tick.end_slopes);
        }
        Some(losses)
    }

    /// Negative log-likelihood of the whole segment.
    pub fn loss(&self, flight: &Flight, disturbances: &Disturbances) -> f64 {
        self.losses(flight, disturbances, None)
            .and_then(|losses| losses.last().copied())
            .unwrap_or(f64::INFINITY)
    }
}

/// The filter's state and covariance before the first measurement.
fn initial_estimate(
    start: Vec<f64>,
    lags_sd: &[f64],
    prior: &ParameterPrior,
    augmented: &[AugmentedState],
) -> (Vec<f64>, Vec<f64>) {
    let (own, learned) = (start.len(), prior.mean.len());
    let n = own + augmented.len();
    let mut x = start;
    x.extend(&prior.mean);
    x.resize(n, 0.0);
    let stride = padded(n);
    let mut p = vec![0.0; n * stride];
    for i in 0..own {
        let sd = if i < START { START_SD[i / 3] } else { lags_sd[i - START] };
        p[i * stride + i] = sd * sd;
    }
    for i in 0..learned {
        for j in 0..learned {
            p[(own + i) * stride + own + j] = prior.covariance[i * learned + j];
        }
    }
    for (i, state) in (own..n).zip(augmented).skip(learned) {
        p[i * stride + i] = state.variance;
    }
    (x, p)
}

/// Matrices of [`propagate`].
struct PropagationBuffers {
    /// The vehicle's rows of the transition, and their transpose.
    f: Vec<f64>,
    ft: Vec<f64>,
    fp: Vec<f64>,
    decays: Vec<f64>,
}

impl PropagationBuffers {
    fn new(own: usize, n: usize) -> Self {
        let rows = || vec![0.0; own * padded(n)];
        PropagationBuffers {
            f: rows(),
            ft: vec![0.0; n * padded(own)],
            fp: rows(),
            decays: vec![0.0; n - own],
        }
    }
}

impl KalmanFilter {
    /// State and covariance one tick on.
    pub fn propagate(&mut self, end: &[f64], slopes: &[f64]) -> TickPropagation<'_> {
        propagate(end, slopes, self);
        self.correction.fill(0.0);
        TickPropagation { transition: &self.buffers.f, decays: &self.buffers.decays }
    }
}

/// State and covariance one tick on.
fn propagate(end: &[f64], slopes: &[f64], k: &mut KalmanFilter) {
    let KalmanFilter { own, augmented, x, p, correction, buffers, .. } = k;
    let PropagationBuffers { f, ft, fp, decays } = buffers;
    let (own, n) = (*own, x.len());
    let (stride, own_stride) = (padded(n), padded(own));
    let unknowns = slopes.len() / own;
    for i in 0..own {
        let row = &slopes[i * unknowns..(i + 1) * unknowns];
        let to = &mut f[i * stride..i * stride + n];
        to[..own].copy_from_slice(&row[..own]);
        for (to, state) in to[own..].iter_mut().zip(augmented.iter()) {
            *to = state.column.map_or(0.0, |column| row[column] * state.unit);
        }
        x[i] = end[i] + to.iter().zip(&*correction).map(|(f, m)| f * m).sum::<f64>();
        for (k, f) in to.iter().enumerate() {
            ft[k * own_stride + i] = *f;
        }
    }
    for (j, state) in augmented.iter().enumerate() {
        x[own + j] = state.decay * (x[own + j] + correction[own + j]);
        decays[j] = state.decay;
    }
    Dual::run(
        #[inline(always)]
        || {
            // the vehicle's rows of F P; those of the augmented states only shrink
            for (fp, f) in fp.chunks_exact_mut(stride).zip(f.chunks_exact(stride)) {
                combine_rows(fp, &f[..n], p);
            }
            // and that times the transpose of F
            for (row, out) in fp.chunks_exact(stride).zip(p.chunks_exact_mut(stride)) {
                combine_rows(&mut out[..own_stride], &row[..n], ft);
                for ((out, row), decay) in out[own..n].iter_mut().zip(&row[own..n]).zip(&*decays) {
                    *out = row * decay;
                }
            }
        },
    );
    // symmetric but for rounding
    for i in 0..n {
        for j in 0..i.min(own) {
            p[i * stride + j] = p[j * stride + i];
        }
    }
    for (i, decay) in decays.iter().enumerate() {
        let row = &mut p[(own + i) * stride + own..][..decays.len()];
        for (out, other) in row.iter_mut().zip(&*decays) {
            *out *= decay * other;
        }
        row[i] += augmented[i].gain;
    }
}
