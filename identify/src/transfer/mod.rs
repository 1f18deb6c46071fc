//! Transfer functions from flight logs, as the thesis found its own (5.1): of a given order, by output error.
//!
//! The thesis used MATLAB's `tfest` on one recording each. Here every log of a list counts, and windows start
//! from states of their own. The input is held as the vehicle held it, delayed by any fraction of a sample.

mod channel;
mod fit;
mod response;
mod start;
mod structure;
mod write;

use crate::estimate::{Clusters, Comparison, ParameterEstimate, at_bound, covariance};
use crate::metrics::Fit;
use crate::{Error, Result};
use crazyflie_statistics::{Criteria, criteria};

pub use channel::{Channel, Record};
use fit::{MultipleShooting, fit_best};
use response::Segment;
pub use structure::{DELAY_MAX_S, LARGEST, Offset, Structure, TransferFunction};

/// Shorter windows have fewer samples than unknowns.
const WINDOW_MIN_S: f64 = 0.5;

/// An identified transfer function: values, standard errors, and predictions of the logs.
#[derive(Debug, Clone)]
pub struct TransferFunctionEstimate {
    /// Input and output that it relates.
    pub channel: Channel,
    /// Structure that was fitted.
    pub structure: Structure,
    /// Transfer function at the fitted values.
    pub function: TransferFunction,
    /// Coefficients, highest power first, then delay and offsets.
    pub parameters: Vec<ParameterEstimate>,
    /// Standard deviation of what the model leaves, in the unit of the output (of its integral, where
    /// velocity is not measured).
    pub noise: f64,
    /// Information criteria, to compare structures on the same logs.
    pub criteria: Criteria,
    /// Groups behind the standard errors.
    pub clusters: Clusters,
    /// Convergence: the fit ended before its limit of steps.
    pub converged: bool,
    /// Number of output samples in the fit.
    pub samples: usize,
    /// Every log of the fit.
    pub fit: Vec<Comparison>,
    window_s: Option<f64>,
    numbers: Vec<f64>,
}

/// Window length of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WindowLength {
    /// The usual one of its [`Channel`].
    OfChannel,
    /// This many seconds, at least 0.5.
    Seconds(f64),
    /// Each flight is one window.
    Whole,
}

/// Fits a transfer function to records of one channel.
///
/// # Errors
/// [`Error`]: no records, no excitation, an order that is not supported, numbers that the records do not
/// determine.
pub fn identify(
    records: &[Record],
    channel: Channel,
    structure: Structure,
    window: WindowLength,
) -> Result<TransferFunctionEstimate> {
    structure.check()?;
    let spec = channel.spec();
    let window_s = match window {
        WindowLength::Whole => None,
        WindowLength::OfChannel => Some(spec.window_s),
        WindowLength::Seconds(s) if s >= WINDOW_MIN_S && s.is_finite() => Some(s),
        WindowLength::Seconds(value_s) => {
            let expected = format!("expected at least {WINDOW_MIN_S} s");
            return Error::options(format!("a window of {value_s} s is not possible, {expected}"));
        }
    };
    let first = records.first().ok_or_else(Error::no_logs)?;
    if let Some(other) = records.iter().find(|r| r.integrated != first.integrated) {
        return Err(Error::mixed(&first.name, &other.name));
    }
    if !records.iter().any(Record::is_excited) {
        return Err(Error::no_excitation(spec.input, &format!("{}'s response to it", spec.output)));
    }
    let segments: Vec<Segment> =
        records.iter().enumerate().flat_map(|(i, r)| Segment::cut(i, r, window_s)).collect();
    let candidates = start::candidates(&structure, records);
    let what = || Error::no_start(&format!("{} to {} transfer function", spec.input, spec.output));
    let (solution, noise) = fit_best(records, &structure, &segments, &candidates).ok_or_else(what)?;
    let flights: Vec<String> = records.iter().map(|r| r.name.clone()).collect();
    let names = structure.names(spec.ratio, spec.units[1], &flights);
    let bounds = structure.bounds(records.len());
    let flight_of: Vec<usize> = segments.iter().map(|s| s.flight).collect();
    let labels: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
    let (number_covariance, clusters) = covariance(&solution, &flight_of, &labels, &bounds)?;
    let (values, slopes) = structure.coefficients(&solution.shared);
    let coefficient_covariance = &slopes * number_covariance * slopes.transpose();
    let parameters = names.into_iter().enumerate().map(|(i, (name, unit))| ParameterEstimate {
        name,
        unit,
        value: values[i],
        standard_error: coefficient_covariance[(i, i)].max(0.0).sqrt(),
        at_bound: at_bound(solution.shared[i], bounds[i]),
    });
    let mut identified = TransferFunctionEstimate {
        channel,
        structure,
        function: structure.function(&solution.shared),
        parameters: parameters.collect(),
        noise,
        criteria: Criteria { aic: 0.0, bic: 0.0 },
        clusters,
        converged: solution.converged,
        samples: segments.iter().map(Segment::len).sum(),
        fit: Vec::new(),
        window_s,
        numbers: solution.shared,
    };
    identified.fit = identified.compare(records)?;
    let squares: f64 = identified.fit.iter().flat_map(Comparison::residuals).map(|e| e * e).sum();
    // the windows' initial states are parameters too, and a larger order has more of them
    let unknowns =
        identified.numbers.len() + segments.len() * (structure.denominator + usize::from(first.integrated));
    identified.criteria = criteria(&[(squares, identified.samples)], unknowns);
    Ok(identified)
}

impl TransferFunctionEstimate {
    /// Predicts records, which the fit need not have seen: only initial states are taken from them, and the
    /// offset where each flight has its own.
    ///
    /// # Errors
    /// [`Error::Logs`].
    pub fn compare(&self, records: &[Record]) -> Result<Vec<Comparison>> {
        records.iter().map(|record| self.compare_one(record)).collect()
    }

    fn compare_one(&self, record: &Record) -> Result<Comparison> {
        let structure = match self.structure.offset {
            Offset::None => self.structure,
            _ => Structure { offset: Offset::Shared, ..self.structure },
        };
        let (dynamic, offsets) = self.numbers.split_at(structure.dynamic());
        let name = format!("offset {}", record.name);
        let own = self.parameters.iter().find(|p| p.name == name).map(|p| p.value);
        let mut numbers = dynamic.to_vec();
        numbers.extend(own.or(offsets.first().copied()));
        if own.is_none() && self.structure.offset == Offset::PerFlight {
            own_offset(record, &structure, &mut numbers, self.window_s)?;
        }
        let (windows, fit) = predict(record, &structure, &numbers, self.window_s)?;
        let (_, whole) = predict(record, &structure, &numbers, None)?;
        let began = |t_s: &f64| *t_s > record.span_s[0] + 5e-6;
        let t_s: Vec<f64> = record.output_t_s.iter().copied().filter(began).collect();
        // samples filtered by time and those counted by clock must be the same
        let t_s = t_s[t_s.len() - windows.0.len()..].to_vec();
        let input = t_s.iter().map(|t| record.input_at(*t)).collect();
        let [unit, _] = self.channel.spec().units;
        let (signal, unit) = match (record.integrated, self.channel.spec().output) {
            (true, "vx") => ("x", "m"),
            (true, _) => ("y", "m"),
            (false, name) => (name, unit),
        };
        let (log, (measured, predicted), whole) = (record.name.clone(), windows, Some(whole));
        Ok(Comparison { log, signal, unit, t_s, measured, predicted, input, fit, whole })
    }

    /// Residual noise, the window length: what a reader needs to judge the errors.
    pub fn window_s(&self) -> Option<f64> {
        self.window_s
    }
}

/// Puts the offset in its place, which is last, that fits a record best: the prediction is linear in it, the
/// loss a parabola.
fn own_offset(
    record: &Record,
    structure: &Structure,
    numbers: &mut [f64],
    window_s: Option<f64>,
) -> Result<()> {
    let (at, spread) = (numbers.len() - 1, standard_deviation(&record.input).max(1e-9));
    let (here, mut losses) = (numbers[at], [0.0; 3]);
    for (loss, by) in losses.iter_mut().zip([-spread, 0.0, spread]) {
        numbers[at] = here + by;
        let ((measured, predicted), _) = predict(record, structure, numbers, window_s)?;
        *loss = measured.iter().zip(predicted).map(|(y, p)| (y - p).powi(2)).sum();
    }
    let [before, middle, after] = losses;
    let bend = before - 2.0 * middle + after;
    numbers[at] = here + if bend > 0.0 { 0.5 * spread * (before - after) / bend } else { 0.0 };
    Ok(())
}

fn standard_deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

type SamplePair = (Vec<f64>, Vec<f64>);

/// Measured and predicted samples of a record in windows whose initial states are fitted.
fn predict(
    record: &Record,
    structure: &Structure,
    numbers: &[f64],
    window_s: Option<f64>,
) -> Result<(SamplePair, Fit)> {
    let segments = Segment::cut(0, record, window_s);
    // so wide that no sample is taken for an outlier: initial states as MATLAB's `compare` has them
    let sigma = record.output.iter().fold(1e-9_f64, |a, y| a.max(y.abs()));
    let shooting =
        MultipleShooting { structure, segments: &segments, flights: 1, integrated: record.integrated, sigma };
    let failed = || Error::no_start(&format!("prediction of {}", record.name));
    let (own, _) = shooting.settle(numbers).ok_or_else(failed)?;
    let measured: Vec<f64> = segments.iter().flat_map(Segment::samples).collect();
    let predicted: Vec<f64> = shooting.predict(numbers, &own).concat();
    let fit = Fit::new(&measured, &predicted).map_err(|_| failed())?;
    Ok(((measured, predicted), fit))
}
