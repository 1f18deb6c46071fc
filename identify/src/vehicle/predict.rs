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

/// What was compared.
pub(super) struct Rows(Vec<Compared>);

/// The predictions of hypotheses without free numbers, one for each flight, from these initial states.
pub(super) fn rows(each: &[Hypothesis], flights: &[Flight], windows: &[Window], own: &[Vec<f64>]) -> Rows {
    let of = |(window, own): (&Window, &Vec<f64>)| {
        let flight = &flights[window.flight];
        let Ok(mut worker) = Worker::new(&each[window.flight], flight, false, false) else { return Vec::new() };
        worker.predict(flight, window, own);
        worker.rows().to_vec()
    };
    Rows(windows.par_iter().zip(own).map(of).collect::<Vec<_>>().concat())
}

impl Rows {
    /// Standard deviation of the residuals per channel, by the median against outliers.
    pub(super) fn noise(&self, floor: &Noise) -> [f64; 6] {
        let least = [floor.att_rad, floor.pos_m].concat();
        std::array::from_fn(|channel| {
            let of = self.0.iter().filter(|row| row.channel == channel).map(|row| (row.measured - row.predicted).abs() / row.spread);
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

    fn channel(&self, channel: usize) -> Vec<Compared> {
        self.0.iter().filter(|row| row.channel == channel).copied().collect()
    }
}

/// Every signal of a flight by a hypothesis without free numbers, in windows and in one run over the whole flight, from initial states that are fitted.
pub(super) fn compare(at: &Hypothesis, flight: &Flight) -> Vec<Comparison> {
    let flights = std::slice::from_ref(flight);
    let settled = |windows: Vec<Window>| {
        let prediction = Prediction { flights, windows: &windows, hypothesis: at, inflation: 1.0 };
        let solution = solve(&prediction, prediction.starts(), prediction.shared());
        rows(std::slice::from_ref(at), flights, &windows, &solution.own)
    };
    let windows = settled(super::windows(flights));
    let whole = settled(vec![Window { flight: 0, ticks: flight.all() }]);
    let signals = SIGNALS.into_iter().enumerate();
    let one =
        |(channel, (signal, unit))| comparison(flight, channel, signal, unit, &windows.channel(channel), fit_of(&whole.channel(channel)));
    signals.filter_map(one).collect()
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
