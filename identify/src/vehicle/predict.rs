//! Measured and predicted outputs of the simulator on windows of flights.

use rayon::prelude::*;

use crate::estimate::Comparison;
use crate::fit::flight::{Flight, Noise, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::{Compared, Prediction, Worker};
use crate::fit::solve::solve;
use crate::metrics::Fit;
use crate::replay::measured::median;

/// Outputs by their channel in [`Compared`].
const SIGNALS: [(&str, &str); 6] = [("roll", "rad"), ("pitch", "rad"), ("yaw", "rad"), ("x", "m"), ("y", "m"), ("z", "m")];

/// What was compared, each row with the flight that it is from.
pub(super) struct Rows(Vec<(usize, Compared)>);

/// The predictions of a hypothesis without free numbers from these initial states.
pub(super) fn rows(at: &Hypothesis, flights: &[Flight], windows: &[Window], own: &[Vec<f64>]) -> Rows {
    let of = |(window, own): (&Window, &Vec<f64>)| {
        let flight = &flights[window.flight];
        let Ok(mut worker) = Worker::new(at, flight, false, false) else { return Vec::new() };
        worker.predict(flight, window, own);
        worker.rows().iter().map(|row| (window.flight, *row)).collect()
    };
    Rows(windows.par_iter().zip(own).map(of).collect::<Vec<_>>().concat())
}

impl Rows {
    /// Standard deviation of the residuals per channel, by the median against outliers.
    pub(super) fn noise(&self, floor: &Noise) -> [f64; 6] {
        let least = [floor.att_rad, floor.pos_m].concat();
        std::array::from_fn(|channel| {
            let of =
                self.0.iter().filter(|(_, row)| row.channel == channel).map(|(_, row)| (row.measured - row.predicted).abs() / row.spread);
            // the median of |normal| is 0.6745 standard deviations
            (median(&of.collect::<Vec<_>>()) / 0.6745).max(least[channel])
        })
    }

    /// Sums of squared residuals per signal, and how many.
    pub(super) fn squares(all: &[Comparison]) -> Vec<(f64, usize)> {
        let of = |(name, _): &(&str, &str)| {
            let residuals = all.iter().filter(|c| c.signal == *name).flat_map(Comparison::residuals);
            residuals.fold((0.0, 0), |(sum, count), e| (sum + e * e, count + 1))
        };
        SIGNALS.iter().map(of).filter(|(_, count)| *count > 0).collect()
    }

    fn channel(&self, flight: usize, channel: usize) -> Vec<Compared> {
        self.0.iter().filter(|(f, row)| *f == flight && row.channel == channel).map(|(_, row)| *row).collect()
    }
}

/// Every signal of every flight, in windows and in one run over the whole flight, from initial states (and trims, if the hypothesis
/// leaves them free) that are fitted.
pub(super) fn compare(at: &Hypothesis, flights: &[Flight], window_s: f64) -> Vec<Comparison> {
    let settled = |windows: Vec<Window>| {
        let prediction = Prediction { flights, windows: &windows, hypothesis: at, inflation: 1.0 };
        let solution = solve(&prediction, prediction.starts(), at.shared());
        rows(&at.at(&solution.shared).fixed(), flights, &windows, &solution.own)
    };
    let windows = settled(super::windows(flights, window_s));
    let whole = settled(flights.iter().enumerate().map(|(flight, f)| Window { flight, ticks: 0..f.ticks }).collect());
    let mut all = Vec::new();
    for (index, flight) in flights.iter().enumerate() {
        for (channel, (signal, unit)) in SIGNALS.into_iter().enumerate() {
            let (rows, whole) = (windows.channel(index, channel), whole.channel(index, channel));
            all.extend(comparison(flight, channel, signal, unit, &rows, fit_of(&whole)));
        }
    }
    all
}

fn fit_of(rows: &[Compared]) -> Option<Fit> {
    let (measured, predicted): (Vec<f64>, Vec<f64>) = rows.iter().map(|r| (r.measured, r.predicted)).unzip();
    Fit::of(&measured, &predicted).ok()
}

fn comparison(
    flight: &Flight,
    channel: usize,
    signal: &'static str,
    unit: &'static str,
    rows: &[Compared],
    whole: Option<Fit>,
) -> Option<Comparison> {
    let fit = fit_of(rows)?;
    let input = |row: &Compared| {
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
        fit,
        whole,
    })
}
