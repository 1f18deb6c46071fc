//! Measured and predicted outputs of the simulator on windows of flights.

use rayon::prelude::*;

use crate::estimate::{Comparison, robust_sd};
use crate::fit::flight::{Flight, MeasurementNoise, WINDOW_S, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::predict::{MeanSimulator, PredictedMeasurement};
use crate::fit::solve::solve;
use crate::metrics::Fit;

/// Outputs by their channel in [`PredictedMeasurement`].
const SIGNALS: [(&str, &str); 6] =
    [("roll", "rad"), ("pitch", "rad"), ("yaw", "rad"), ("x", "m"), ("y", "m"), ("z", "m")];

/// Measurements with their predictions.
pub struct ResidualRows(Vec<PredictedMeasurement>);

/// The predictions of hypotheses without free numbers, one for each flight, from these initial states.
pub fn rows(each: &[Hypothesis], flights: &[Flight], windows: &[Window], own: &[Vec<f64>]) -> ResidualRows {
    let window_rows = |(window, own): (&Window, &Vec<f64>)| {
        let flight = &flights[window.flight];
        let Ok(mut simulator) = MeanSimulator::new(&each[window.flight], flight, false) else {
            return Vec::new();
        };
        simulator.predict(flight, window, own);
        simulator.rows().to_vec()
    };
    ResidualRows(windows.par_iter().zip(own).map(window_rows).collect::<Vec<_>>().concat())
}

impl ResidualRows {
    /// Standard deviation of the residuals per channel, by the median against outliers.
    pub fn noise(&self, floor: &MeasurementNoise) -> [f64; 6] {
        let least = [floor.att_rad, floor.pos_m].concat();
        std::array::from_fn(|channel| {
            let rows = self.0.iter().filter(|row| row.channel == channel);
            let residuals = rows.map(|row| (row.measured - row.predicted) / row.noise_scale);
            robust_sd(residuals).max(least[channel])
        })
    }

    /// Sums of squared residuals per signal, and how many.
    pub fn squares(all: &[Comparison]) -> Vec<(f64, usize)> {
        let squares_of = |(name, _): &(&str, &str)| {
            let residuals = all.iter().filter(|c| c.signal == *name).flat_map(Comparison::residuals);
            residuals.fold((0.0, 0), |(sum, count), e| (sum + e * e, count + 1))
        };
        SIGNALS.iter().map(squares_of).filter(|(_, count)| *count > 0).collect()
    }

    fn channel(&self, channel: usize) -> Vec<PredictedMeasurement> {
        self.0.iter().filter(|row| row.channel == channel).copied().collect()
    }
}

/// Every signal of a flight by a hypothesis without free numbers, in windows and in one run over the whole
/// flight, from initial states that are fitted.
pub fn compare(hypothesis: &Hypothesis, flight: &Flight) -> Vec<Comparison> {
    let flights = std::slice::from_ref(flight);
    let settled = |windows: Vec<Window>| {
        let prediction = OutputErrorProblem::new(flights, &windows, hypothesis);
        let solution = solve(&prediction, prediction.measured_starts(), prediction.shared());
        rows(std::slice::from_ref(hypothesis), flights, &windows, &solution.own)
    };
    let windows = settled(super::windows(flights, WINDOW_S));
    let whole = settled(vec![Window { flight: 0, ticks: flight.all_ticks() }]);
    let comparison = |(channel, (signal, unit)): (usize, (&'static str, &'static str))| {
        let rows = windows.channel(channel);
        let input = |row: &PredictedMeasurement| {
            let u = flight.command((row.t_s / flight.tick_s - 1e-6).floor() as isize);
            // roll moves along y, pitch along x
            [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.pitch_rad, u.roll_rad, u.lift][channel]
        };
        Some(Comparison {
            log: flight.name.clone(),
            signal,
            unit,
            t_s: rows.iter().map(|r| r.t_s + flight.start_s).collect(),
            measured: rows.iter().map(|r| r.measured).collect(),
            predicted: rows.iter().map(|r| r.predicted).collect(),
            input: rows.iter().map(input).collect(),
            fit: fit_of(&rows)?,
            whole: fit_of(&whole.channel(channel)),
        })
    };
    SIGNALS.into_iter().enumerate().filter_map(comparison).collect()
}

fn fit_of(rows: &[PredictedMeasurement]) -> Option<Fit> {
    let (measured, predicted): (Vec<f64>, Vec<f64>) = rows.iter().map(|r| (r.measured, r.predicted)).unzip();
    Fit::new(&measured, &predicted).ok()
}
