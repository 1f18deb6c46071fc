//! Curves of a flight under a hypothesis: residuals of restarted windows, innovations, a free run.

use std::ops::Range;

use crazyflie_identify::explain::leftover::CHANNELS;
use crazyflie_identify::fit::filter::{Disturbances, Innovation, filter_fixed};
use crazyflie_identify::fit::flight::{Flight, WINDOW_S, Window};
use crazyflie_identify::fit::hypothesis::Hypothesis;
use crazyflie_identify::fit::predict::MeanSimulator;

/// Channels in the order in which they are shown: x, y, z, roll, pitch, yaw.
pub(super) const SHOWN: [usize; 6] = [3, 4, 5, 0, 1, 2];
/// Lags up to so long.
const LONGEST_S: f64 = 1.0;
/// Bound on the correlation of independent series: 99 in 100 are within so many standard deviations.
const BOUND: f64 = 2.576;
/// Outliers are not structure.
const OUTLIER: f64 = 3.0;

/// Name and unit of a channel, and what one of it is in SI units.
pub(super) fn channel(at: usize) -> (&'static str, &'static str, f64) {
    if at < 3 { (CHANNELS[at], "deg", 1.0_f64.to_radians()) } else { (CHANNELS[at], "m", 1.0) }
}

/// A curve without a gap.
#[derive(Debug, Clone, Default)]
pub(super) struct Curve {
    pub x: Vec<f64>,
    pub y: Vec<f64>,
}

impl Curve {
    fn push(&mut self, x: f64, y: f64) {
        self.x.push(x);
        self.y.push(y);
    }
}

/// The hypothesis without its random terms, which have no expectation to predict with.
pub(super) fn without_disturbances(hypothesis: &Hypothesis) -> Hypothesis {
    let mut mean = hypothesis.without_free();
    mean.terms.retain(|t| t.entry.observability.shapes_mean());
    mean
}

/// Measured and predicted per channel over some ticks, from the state measured at their start.
pub(super) fn predict(
    hypothesis: &Hypothesis,
    flight: &Flight,
    ticks: Range<usize>,
) -> Option<[[Curve; 2]; 6]> {
    let mut worker = MeanSimulator::new(hypothesis, flight, false).ok()?;
    Some(predict_curves(&mut worker, flight, ticks))
}

fn predict_curves(worker: &mut MeanSimulator, flight: &Flight, ticks: Range<usize>) -> [[Curve; 2]; 6] {
    let mut own = flight.measured_numbers(ticks.start);
    let lags = worker.initial_lags(flight, ticks.start, &own);
    own.extend(lags);
    worker.predict(flight, &Window { flight: 0, ticks }, &own);
    let mut curves: [[Curve; 2]; 6] = Default::default();
    for row in worker.rows().iter().filter(|r| r.predicted.is_finite()) {
        let (_, _, one) = channel(row.channel);
        let [measured, predicted] = &mut curves[row.channel];
        measured.push(row.t_s, row.measured / one);
        predicted.push(row.t_s, row.predicted / one);
    }
    curves
}

/// Measured less predicted per channel, one curve per window.
pub(super) fn residuals(hypothesis: &Hypothesis, flight: &Flight) -> Option<[Vec<Curve>; 6]> {
    let mut worker = MeanSimulator::new(hypothesis, flight, false).ok()?;
    let mut all: [Vec<Curve>; 6] = Default::default();
    for window in flight.windows(0, WINDOW_S) {
        for (channel, [measured, predicted]) in
            predict_curves(&mut worker, flight, window.ticks).into_iter().enumerate()
        {
            let y = measured.y.iter().zip(&predicted.y).map(|(m, p)| m - p).collect();
            all[channel].push(Curve { x: measured.x, y });
        }
    }
    Some(all)
}

/// The stretch of a flight with the most speed in it, and the mean square speed there.
pub(super) fn liveliest(flight: &Flight, seconds: f64) -> (f64, Range<usize>) {
    let each = ((seconds / flight.tick_s) as usize).min(flight.ticks);
    let every = (0.5 / flight.tick_s) as usize;
    let speed2 = |k: usize| flight.measured_state(k).vel_mps.iter().map(|v| v * v).sum::<f64>();
    let motion = |first: usize| (first..first + each).map(speed2).sum::<f64>();
    let starts = (0..=flight.ticks - each).step_by(every.max(1)).map(|first| (motion(first), first));
    let (max, first) = starts.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
    (max / each.max(1) as f64, first..first + each)
}

/// Autocorrelation of the innovations of a channel.
#[derive(Debug, Clone, Default)]
pub(super) struct Whiteness {
    pub correlation: Curve,
    /// Between plus and minus this are 99 of 100 lags of an independent series.
    pub bound: f64,
    /// Percentage of lags beyond.
    pub beyond_percent: f64,
    /// Root mean square of the innovations, in their own predicted standard deviations.
    pub size: f64,
}

/// Per channel; `None` where the filter breaks down.
pub(super) fn whiteness(
    hypothesis: &Hypothesis,
    disturbances: &Disturbances,
    flight: &Flight,
) -> Option<[Whiteness; 6]> {
    let filtered = filter_fixed(flight, hypothesis, disturbances)?;
    Some(std::array::from_fn(|channel| {
        let own: Vec<Innovation> =
            filtered.innovations.iter().filter(|i| i.channel == channel).copied().collect();
        whiteness_of(&own)
    }))
}

fn whiteness_of(own: &[Innovation]) -> Whiteness {
    let mut steps: Vec<f64> = own.windows(2).map(|i| i[1].t_s - i[0].t_s).collect();
    steps.sort_by(f64::total_cmp);
    let Some(step_s) = steps.get(steps.len() / 2).copied().filter(|s| *s > 0.0) else {
        return Whiteness::default();
    };
    let e: Vec<f64> = own.iter().map(|i| i.normalised.clamp(-OUTLIER, OUTLIER)).collect();
    let power = e.iter().map(|v| v * v).sum::<f64>() / e.len() as f64;
    let bound = BOUND / (e.len() as f64).sqrt();
    let mut correlation = Curve::default();
    for lag in 1..=((LONGEST_S / step_s).round() as usize).min(e.len().saturating_sub(2)) {
        // a lost frame moves what follows: such pairs have another lag
        let kept = |i: &usize| (own[i + lag].t_s - own[*i].t_s - lag as f64 * step_s).abs() < 0.6 * step_s;
        let pairs: Vec<f64> = (0..e.len() - lag).filter(kept).map(|i| e[i] * e[i + lag]).collect();
        if !pairs.is_empty() && power > 0.0 {
            correlation.push(lag as f64 * step_s, pairs.iter().sum::<f64>() / pairs.len() as f64 / power);
        }
    }
    let beyond = correlation.y.iter().filter(|r| r.abs() > bound).count();
    let beyond_percent = 100.0 * beyond as f64 / correlation.y.len().max(1) as f64;
    Whiteness { correlation, bound, beyond_percent, size: power.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn innovations(of: impl Fn(usize) -> f64) -> Vec<Innovation> {
        (0..3000)
            .map(|i| Innovation {
                t_s: i as f64 * 0.01,
                channel: 0,
                normalised: of(i),
                log_sd: 0.0,
                loss: 0.0,
            })
            .collect()
    }

    #[test]
    fn a_slow_series_is_not_white_and_a_scrambled_one_is() {
        let slow = whiteness_of(&innovations(|i| (i as f64 * 0.02).sin()));
        assert!(slow.beyond_percent > 90.0 && slow.correlation.x.len() == 100, "{slow:?}");
        let mut state = 1_u64;
        let noise: Vec<f64> = (0..3000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) as f64 / f64::from(u32::MAX >> 1) - 0.5
            })
            .collect();
        let white = whiteness_of(&innovations(|i| noise[i]));
        assert!(white.beyond_percent < 6.0, "{white:?}");
        assert_eq!(whiteness_of(&[]).correlation.x.len(), 0);
    }
}
