//! Tests of the residual: the filter's innovations must be independent of each other and of past commands, and
//! contain no line.

use crazyflie_logs::spectrum::power_spectrum;

pub use super::calibration::leftover::{CLEAR, FINDING};
use super::calibration::leftover::{
    JUMP_CLIP, JUMP_S, LINE_CHANCE, LINE_FROM_HZ, LINE_SHARE, LONGEST_S, OUTLIER, TOGETHER_S, TRUSTED,
    WHITE_S,
};
use super::signals::Signal;
use super::verdict::{Leftover, Structure};
use crate::fit::filter::FilterResult;
use crate::fit::flight::Flight;

/// Channels by name, in the order of [`crate::fit::predict::PredictedMeasurement::channel`].
pub const CHANNELS: [&str; 6] = ["roll", "pitch", "yaw", "x", "y", "z"];

/// One value per tick, the mean of what was measured in it.
fn innovations_by_tick(flight: &Flight, filtered: &FilterResult, channel: usize) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0.0); flight.ticks];
    for i in filtered.innovations.iter().filter(|i| i.channel == channel) {
        let tick = ((i.t_s / flight.tick_s - 1e-6) as usize).min(flight.ticks - 1);
        sums[tick].0 += i.normalised.clamp(-JUMP_CLIP, JUMP_CLIP);
        sums[tick].1 += 1.0;
    }
    sums.into_iter().map(|(sum, n)| (n > 0.0).then(|| sum / n)).collect()
}

/// The same with outliers cut off: they are no structure that lasts.
fn clipped(e: &[Option<f64>], most: f64) -> Vec<Option<f64>> {
    e.iter().map(|v| v.map(|v| v.clamp(-most, most))).collect()
}

/// Correlation with a signal so many ticks before, and of how many pairs.
fn lagged_correlation(e: &[Option<f64>], past: &[Option<f64>], lag: usize) -> (f64, f64) {
    let (mut ab, mut aa, mut bb, mut n) = (0.0, 0.0, 0.0, 0.0);
    for (a, b) in e.get(lag..).unwrap_or_default().iter().zip(past).filter_map(|(a, b)| Some(((*a)?, (*b)?)))
    {
        (ab, aa, bb, n) = (ab + a * b, aa + a * a, bb + b * b, n + 1.0);
    }
    if aa * bb > 0.0 { (ab / f64::sqrt(aa * bb), n) } else { (0.0, n) }
}

/// Largest correlation with a signal of the past, in standard deviations of that of independent series, and
/// its lag.
fn largest_correlation(e: &[Option<f64>], past: &[Option<f64>], nearest_s: f64, tick_s: f64) -> (f64, f64) {
    let lags = ((nearest_s / tick_s).ceil() as usize).max(1)..=(LONGEST_S / tick_s) as usize;
    let z_at_lag = |lag: usize| {
        let (r, n) = lagged_correlation(e, past, lag);
        (r * n.sqrt(), lag as f64 * tick_s)
    };
    largest(lags.map(z_at_lag))
}

/// The sum of the squared correlations with a signal of the past over many lags (Haugh 1976), as standard
/// deviations of a normal: what a command does over a while, and never much at one time. The signal's own
/// correlation leaves fewer degrees of freedom than lags (Satterthwaite 1946); the cube root of a chi-square
/// is all but normal (Wilson, Hilferty 1931). None for less than chance would have, or a signal that never
/// moves.
fn haugh_statistic(e: &[Option<f64>], past: &[Option<f64>], tick_s: f64) -> f64 {
    let lags = (TOGETHER_S / tick_s) as usize;
    let sum: f64 = (0..lags).map(|lag| lagged_correlation(e, past, lag)).map(|(r, n)| r * r * n).sum();
    let own: Vec<f64> = (0..lags).map(|lag| lagged_correlation(past, past, lag).0).collect();
    let spread: f64 =
        (0..lags).flat_map(|i| (0..lags).map(move |j| i.abs_diff(j))).map(|lag| own[lag].powi(2)).sum();
    if spread == 0.0 {
        return 0.0;
    }
    let lags = lags as f64;
    let spread_of_root = 2.0 / (9.0 * lags * lags / spread);
    (((sum / lags).cbrt() - (1.0 - spread_of_root)) / spread_of_root.sqrt()).max(0.0)
}

/// The largest sum of neighbouring values within [`JUMP_S`], in standard deviations of that of independent ones, and
/// its time: what a marker that slips, or a push of a hand, leaves at once. Single outliers count little.
fn largest_jump(e: &[Option<f64>], tick_s: f64) -> (f64, f64) {
    let values = clipped(e, JUMP_CLIP);
    let (sum, n) = values.iter().flatten().fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    let scale = f64::sqrt(sum / n);
    let z = |(at, within): (usize, &[Option<f64>])| {
        let known = within.iter().flatten();
        let z = known.clone().sum::<f64>() / (known.count().max(1) as f64).sqrt() / scale;
        (z, at as f64 * tick_s)
    };
    largest(values.windows(((JUMP_S / tick_s) as usize).max(1)).enumerate().map(z))
}

/// The statistic farthest from zero with its time; zeros of none. One that is no number counts for nothing.
fn largest(all: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    all.fold((0.0, 0.0), |best: (f64, f64), now| if now.0.abs() > best.0.abs() { now } else { best })
}

/// Share of the power in the strongest line, and its frequency.
pub fn strongest_line(series: &[f64], tick_s: f64) -> (f64, f64) {
    strongest_line_above(series, tick_s, LINE_FROM_HZ)
}

/// Share of the power in the strongest line above a frequency, and its frequency.
pub fn strongest_line_above(series: &[f64], tick_s: f64, from_hz: f64) -> (f64, f64) {
    let n = series.len();
    let mean = series.iter().sum::<f64>() / n as f64;
    let tapered = |(i, v): (usize, &f64)| (v - mean) * (std::f64::consts::PI * i as f64 / n as f64).sin();
    let power = power_spectrum(series.iter().enumerate().map(tapered).collect());
    if power.is_empty() {
        return (0.0, 0.0);
    }
    let per_bin_hz = 1.0 / (n as f64 * tick_s);
    let first = (from_hz / per_bin_hz).ceil() as usize;
    let total: f64 = power.iter().sum();
    // the window spreads a line over three bins
    let strongest =
        (first.max(1)..power.len().saturating_sub(1)).map(|i| (power[i - 1..=i + 1].iter().sum::<f64>(), i));
    let (most, at) = strongest.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
    (if total > 0.0 { most / total } else { 0.0 }, at as f64 * per_bin_hz)
}

/// The share that makes a finding of a line in a series of so many samples: the shorter, the more of a white
/// one lies in three neighbouring bins by chance. Behind the sine window their powers are together
/// distributed as exponentials with means of 1 and 1 +- 1/sqrt 2.
fn line_finding_share(samples: usize) -> f64 {
    let bins = samples as f64 / 2.0;
    let widest = 1.0 + std::f64::consts::FRAC_1_SQRT_2;
    let often = widest / (widest - 1.0) * widest / (2.0 * (widest - 1.0));
    LINE_SHARE.get().max(widest * (often * bins / LINE_CHANCE).ln() / bins)
}

/// Findings about structure that is left in a filtered flight.
pub fn leftover_findings(flight: &Flight, filtered: &FilterResult) -> Vec<Leftover> {
    let mut found = Vec::new();
    let command = |value: &dyn Fn(usize) -> f64| {
        let all: Vec<f64> = (0..flight.ticks).map(value).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        all.into_iter().map(|v| Some(v - mean)).collect::<Vec<_>>()
    };
    let u = |k: usize| flight.command(k as isize);
    let commands = [
        ("roll command", command(&|k| u(k).roll_rad)),
        ("pitch command", command(&|k| u(k).pitch_rad)),
        ("yaw-rate command", command(&|k| u(k).yaw_rate_radps)),
        ("thrust command", command(&|k| u(k).lift)),
    ];
    let before = |k: usize| flight.command(k as isize - 1);
    let changes = [
        ("change of roll command", command(&|k| u(k).roll_rad - before(k).roll_rad)),
        ("change of pitch command", command(&|k| u(k).pitch_rad - before(k).pitch_rad)),
    ];
    for (channel, name) in CHANNELS.iter().enumerate() {
        let innovations = innovations_by_tick(flight, filtered, channel);
        let e = clipped(&innovations, OUTLIER);
        let known: Vec<f64> = e.iter().flatten().copied().collect();
        if known.iter().map(|v| v * v).sum::<f64>() < TRUSTED * TRUSTED * known.len() as f64 {
            continue;
        }
        let part = Signal::from_channel(channel);
        let nearest_s = if channel < 3 { 0.0 } else { WHITE_S };
        let mut add = |kind, finding, size| found.push(Leftover::new(kind, part, name, finding, size));
        let (z, lag_s) = largest_correlation(&e, &e, nearest_s, flight.tick_s);
        add(Structure::Memory, format!("correlated with itself {lag_s:.2} s before"), z);
        let series: Vec<f64> = e.iter().map(|v| v.unwrap_or(0.0)).collect();
        let (share, hz) = strongest_line(&series, flight.tick_s);
        // in units of what makes a finding
        let size = FINDING.get() * share / line_finding_share(series.len());
        let line = format!("a line at {hz:.2} Hz holds {:.1} % of its power", 100.0 * share);
        add(Structure::Line, line, size);
        let (z, at_s) = largest_jump(&innovations, flight.tick_s);
        add(Structure::State, format!("jumps at {at_s:.1} s"), z);
        for (input, past) in commands.iter().chain(&changes) {
            let (z, lag_s) = largest_correlation(&e, past, 0.0, flight.tick_s);
            add(Structure::Memory, format!("correlated with the {input} {lag_s:.2} s before"), z);
        }
        // a slow signal is much the same at all lags: only the changes tell more together than one by one
        for (input, past) in &changes {
            let finding = format!("correlated with the {input}s of the last {TOGETHER_S} s, taken together");
            let size = FINDING.get() * haugh_statistic(&e, past, flight.tick_s) / CLEAR.get();
            add(Structure::Memory, finding, size);
        }
    }
    found.sort_by(|a, b| b.size.abs().total_cmp(&a.size.abs()));
    found
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const TICK_S: f64 = 0.02;

    /// Changes of a command that is given anew now and then, and residuals that follow them by a little for a
    /// while.
    fn series(seed: u64, follow: f64) -> [Vec<Option<f64>>; 2] {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let changes: Vec<f64> =
            (0..1500).map(|k| if k % 20 == 0 { rng.sample(StandardNormal) } else { 0.0 }).collect();
        let shape = |lag: usize| if lag < 8 { -1.0 } else { 1.0 };
        let residual = |k: usize| {
            let followed: f64 = (0..16.min(k)).map(|lag| shape(lag) * changes[k - lag]).sum();
            follow * followed + rng.sample::<f64, _>(StandardNormal)
        };
        let residuals = (0..1500).map(residual).map(Some).collect();
        [residuals, changes.into_iter().map(Some).collect()]
    }

    #[test]
    fn what_is_small_at_each_lag_is_clear_together() {
        let [residuals, changes] = series(1, 0.5);
        assert!(largest_correlation(&residuals, &changes, 0.0, TICK_S).0.abs() < FINDING.get());
        assert!(haugh_statistic(&residuals, &changes, TICK_S) > CLEAR.get());
    }

    #[test]
    fn a_command_that_never_moves_is_no_finding() {
        let [residuals, _] = series(1, 0.5);
        assert_eq!(haugh_statistic(&residuals, &vec![Some(0.0); residuals.len()], TICK_S), 0.0);
    }

    /// However short the flight; and a line is found in each.
    #[test]
    fn white_series_hold_no_line() {
        for samples in [150, 250, 500, 1500, 3000] {
            let mut rng = Pcg64Mcg::seed_from_u64(samples as u64);
            for _ in 0..200 {
                let white: Vec<f64> = (0..samples).map(|_| rng.sample(StandardNormal)).collect();
                assert!(strongest_line(&white, TICK_S).0 < line_finding_share(samples), "{samples}");
                let lined: Vec<f64> =
                    white.iter().enumerate().map(|(i, w)| w + 2.0 * (i as f64 * 0.7).sin()).collect();
                assert!(strongest_line(&lined, TICK_S).0 > line_finding_share(samples), "{samples}");
            }
        }
    }

    #[test]
    fn a_slip_is_a_jump_and_outliers_are_none() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let mut series: Vec<Option<f64>> = (0..3000).map(|k| (k % 2 == 0).then(&mut normal)).collect();
        // one in a hundred is far off
        series.iter_mut().step_by(200).for_each(|v| *v = v.map(|v| v + 25.0));
        assert!(largest_jump(&series, TICK_S).0.abs() < FINDING.get());
        // remainder of a slip until the filter has followed
        for (k, left) in [9.0, 7.0, 5.5, 4.0, 3.0, 2.0].into_iter().enumerate() {
            series[1000 + 2 * k] = series[1000 + 2 * k].map(|v| v + left);
        }
        let (z, at_s) = largest_jump(&series, TICK_S);
        assert!(z > FINDING.get() && (at_s - 20.0).abs() < 0.3, "{z} at {at_s} s");
    }

    #[test]
    fn independent_series_are_no_finding() {
        for seed in 0..100 {
            let [residuals, changes] = series(seed, 0.0);
            let z = haugh_statistic(&residuals, &changes, TICK_S);
            assert!(z < 0.8 * CLEAR.get(), "{seed}: {z}");
        }
    }
}
