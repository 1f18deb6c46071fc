//! The estimate of a Kalman filter: the vehicle's own numbers, parameters still to be learned, disturbances,
//! and deviations of the obeyed command. Measurements correct it, and the simulator's slopes carry it on.

use crazyflie_env::dual::Dual;
use crazyflie_env::plant::Command;
use crazyflie_env::sim_scalar::SimScalar;

use super::filter::{Disturbances, GaussMarkov, Innovation, ParameterPrior};
use super::flight::Flight;
use super::huber::huber;
use super::hypothesis::Hypothesis;
use super::matrix::{add_scaled, combine_rows, padded, subtract_outer_product, symmetric_product};
use super::packet_loss_moments::{AXES, PacketLossMoments};
use super::predict::{PUSH, PredictedMeasurement, START, SensitivitySimulator};

/// Initial standard deviations of the measured start: m, m/s, rad and rad/s.
const START_SD: [f64; 4] = [0.05, 0.3, 0.05, 1.0];

/// A state of the filter beyond the vehicle's.
#[derive(Default)]
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

/// Start of a filter.
#[derive(Clone)]
pub(super) struct FilterStart {
    /// The vehicle's own numbers, and the standard deviations of the lags among them.
    pub vehicle: Vec<f64>,
    pub lags_sd: Vec<f64>,
    /// Column of the simulator's slopes at which those by a push begin.
    pub push: usize,
    pub packet_loss: Option<PacketLossMoments>,
}

impl FilterStart {
    /// The measured state of a tick.
    pub fn at_tick(
        simulator: &mut SensitivitySimulator,
        flight: &Flight,
        tick: usize,
        hypothesis: &Hypothesis,
    ) -> Self {
        let mut vehicle = flight.measured_numbers(tick);
        vehicle.extend(simulator.initial_lags(flight, tick, &vehicle));
        let push = vehicle.len() + hypothesis.free_values().len();
        let packet_loss = PacketLossMoments::at_tick(hypothesis, flight, tick);
        FilterStart { vehicle, lags_sd: hypothesis.lags_sd(flight.input), push, packet_loss }
    }

    /// The augmented states: parameters still to be learned, disturbances that are not nothing, deviations of the
    /// obeyed command.
    fn augmented(&self, tick_s: f64, learned: usize, disturbances: &Disturbances) -> Vec<AugmentedState> {
        let (own, push) = (self.vehicle.len(), self.push);
        let constant = |i: usize| {
            let column = Some(own + i);
            AugmentedState { column, unit: 1.0, decay: 1.0, ..AugmentedState::default() }
        };
        let gauss_markov = |(axis, w): (usize, GaussMarkov)| {
            let (decay, variance) = ((-tick_s / w.tau_s).exp(), w.sigma * w.sigma);
            let column = (axis < PUSH).then_some(push + axis);
            AugmentedState {
                column,
                axis,
                unit: 1.0,
                decay,
                variance,
                gain: variance * (1.0 - decay * decay),
            }
        };
        let disturbed = disturbances.processes().into_iter().enumerate().filter(|(_, w)| w.sigma > 0.0);
        let deviations = |packet_loss: &PacketLossMoments| {
            let (units, variances) = (packet_loss.push_per_unit, packet_loss.variance());
            let deviation = move |i: usize| {
                let (column, axis) = (Some(push + AXES[i]), AXES[i]);
                let (unit, variance) = (units[i], variances[i]);
                AugmentedState { column, axis, unit, variance, ..AugmentedState::default() }
            };
            (0..AXES.len()).map(deviation)
        };
        let states = (0..learned).map(constant).chain(disturbed.map(gauss_markov));
        states.chain(self.packet_loss.iter().flat_map(deviations)).collect()
    }

    /// The first estimate and its covariance.
    fn estimate(&self, prior: &ParameterPrior, augmented: &[AugmentedState]) -> (Vec<f64>, Vec<f64>) {
        let (own, learned) = (self.vehicle.len(), prior.mean.len());
        let n = own + augmented.len();
        let mut x = [&self.vehicle[..], &prior.mean].concat();
        x.resize(n, 0.0);
        let stride = padded(n);
        let mut p = vec![0.0; n * stride];
        for i in 0..own {
            let sd = if i < START { START_SD[i / 3] } else { self.lags_sd[i - START] };
            p[i * stride + i] = sd * sd;
        }
        for (i, row) in prior.covariance.chunks_exact(learned.max(1)).enumerate() {
            p[(own + i) * stride + own..][..learned].copy_from_slice(row);
        }
        for (i, state) in (own..n).zip(augmented).skip(learned) {
            p[i * stride + i] = state.variance;
        }
        (x, p)
    }
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
    /// Gain of the last update, see [`MeasurementUpdate`].
    gain: f64,
    error: f64,
    /// Room for a propagation: the vehicle's rows of F, F transposed, F P, and the others' decays.
    f: Vec<f64>,
    ft: Vec<f64>,
    fp: Vec<f64>,
    decays: Vec<f64>,
}

/// Update of a filter by a measurement, in standard deviations of the measurement.
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

/// Propagation of a filter's states in a tick: the vehicle's own by a matrix of padded rows over all states, the
/// others by a factor each.
pub(super) struct TickPropagation<'a> {
    pub transition: &'a [f64],
    pub decays: &'a [f64],
}

impl KalmanFilter {
    /// Starts with these parameters. Free numbers of the hypothesis without a prior are fixed.
    pub fn new(flight: &Flight, start: FilterStart, prior: &ParameterPrior, under: &Disturbances) -> Self {
        let (own, learned) = (start.vehicle.len(), prior.mean.len());
        let augmented = start.augmented(flight.tick_s, learned, under);
        let (x, p) = start.estimate(prior, &augmented);
        let (n, row) = (x.len(), vec![0.0; padded(x.len())]);
        let rows = vec![0.0; own * padded(n)];
        KalmanFilter {
            own,
            learned,
            augmented,
            packet_loss: start.packet_loss,
            x,
            p,
            h: row.clone(),
            ph: row.clone(),
            correction: row,
            gain: 0.0,
            error: 0.0,
            f: rows.clone(),
            ft: vec![0.0; n * padded(own)],
            fp: rows,
            decays: vec![0.0; n - own],
        }
    }

    /// The estimate of the vehicle's own numbers.
    pub fn vehicle(&self) -> &[f64] {
        &self.x[..self.own]
    }

    /// The estimate of the parameters that are learned.
    pub fn parameters(&self) -> &[f64] {
        &self.x[self.own..self.own + self.learned]
    }

    /// The parameters as they are known by now.
    pub fn posterior(&self) -> ParameterPrior {
        let (first, stride) = (self.own, padded(self.x.len()));
        let rows = self.p.chunks_exact(stride).skip(first).take(self.learned);
        let covariance = rows.flat_map(|row| &row[first..first + self.learned]).copied().collect();
        ParameterPrior { mean: self.parameters().to_vec(), covariance }
    }

    /// Number of the states, the vehicle's own and all others.
    pub fn states(&self) -> usize {
        self.x.len()
    }

    /// Returns the last measurement update.
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
        let (loss, weight) = huber(z);
        let log_sd = 0.5 * variance.ln();
        (self.gain, self.error) = (weight / variance, error);
        add_scaled(&mut self.correction, self.gain * error, &self.ph);
        subtract_outer_product(&mut self.p, self.gain, &self.ph);
        Some(Innovation { t_s: row.t_s, channel: row.channel, normalised: z, log_sd, loss: loss + log_sd })
    }

    /// State and covariance one tick on.
    pub fn propagate(&mut self, end: &[f64], slopes: &[f64]) -> TickPropagation<'_> {
        let KalmanFilter { own, augmented, x, p, correction, f, ft, fp, decays, .. } = self;
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
        correction.fill(0.0);
        TickPropagation { transition: f, decays }
    }
}
