//! Small operations on sampled signals that the readers share.

use super::align::drift_ppm;
use crazyflie_statistics::quantile;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

use super::{Fixes, Note};

/// Dips below the airborne height shorter than this are outliers of the marker.
const BRIDGED_S: f64 = 0.5;
/// Wide enough for the millimetres of motion capture against accelerations of 0.1 m/s2.
const CURVATURE_HALF_S: f64 = 0.1;
/// A time step longer than this many usual steps is a gap.
const GAP_STEPS: f64 = 1.5;

pub(super) fn radians(degrees: Vec<f64>) -> Vec<f64> {
    degrees.into_iter().map(f64::to_radians).collect()
}

/// Makes a wrapped angle continuous: steps of more than half a turn are wraps.
pub(super) fn unwrap(angle_rad: &mut [f64], channel: &'static str, notes: &mut Vec<Note>) {
    let mut turns = 0.0;
    let mut jumps = 0;
    let mut previous = angle_rad.first().copied().unwrap_or(0.0);
    for angle in angle_rad {
        let step = *angle - previous;
        previous = *angle;
        if step.abs() > PI {
            turns -= (step / TAU).round();
            jumps += 1;
        }
        // Untouched where nothing wrapped, so that reading back what was written changes no digit.
        if turns != 0.0 {
            *angle += turns * TAU;
        }
    }
    if jumps > 0 {
        notes.push(Note::Unwrapped { channel, jumps });
    }
}

/// Acceleration of positions: the curvature of the parabola through the samples within 0.1 s, or through five
/// of a slow one.
pub(super) fn acceleration_of(t_s: &[f64], pos_m: &[Vec<f64>; 3]) -> [Vec<f64>; 3] {
    acceleration_over(t_s, pos_m, CURVATURE_HALF_S)
}

/// Acceleration as above, through the samples within `half_s`.
pub(super) fn acceleration_over(t_s: &[f64], pos_m: &[Vec<f64>; 3], half_s: f64) -> [Vec<f64>; 3] {
    let half_s = half_s.max(2.5 * usual_step(t_s));
    pos_m.each_ref().map(|x| {
        let at_row = |row: usize| {
            let near = t_s.partition_point(|t| *t < t_s[row] - half_s)
                ..t_s.partition_point(|t| *t <= t_s[row] + half_s);
            curvature(&t_s[near.clone()], &x[near])
        };
        (0..t_s.len()).map(at_row).collect()
    })
}

/// Second derivative of the least-squares parabola, in polynomials that are orthogonal on the samples; 0 for
/// fewer than three.
fn curvature(t_s: &[f64], x: &[f64]) -> f64 {
    if t_s.len() < 3 {
        return 0.0;
    }
    let count = t_s.len() as f64;
    let mean = t_s.iter().sum::<f64>() / count;
    let u: Vec<f64> = t_s.iter().map(|t| t - mean).collect();
    let square = u.iter().map(|u| u * u).sum::<f64>();
    let slant = u.iter().map(|u| u * u * u).sum::<f64>() / square;
    let parabola: Vec<f64> = u.iter().map(|u| u * u - slant * u - square / count).collect();
    let norm = parabola.iter().map(|p| p * p).sum::<f64>();
    if norm > 0.0 { 2.0 * parabola.iter().zip(x).map(|(p, x)| p * x).sum::<f64>() / norm } else { 0.0 }
}

/// The mean over `width_s` around each sample, less at the ends: nothing is delayed.
pub(super) fn centred_mean(t_s: &[f64], values: &[f64], width_s: f64) -> Vec<f64> {
    let (mut first, mut end, mut sum) = (0, 0, 0.0);
    let mean = |row: usize| {
        while end < t_s.len() && t_s[end] <= t_s[row] + 0.5 * width_s {
            sum += values[end];
            end += 1;
        }
        while t_s[first] < t_s[row] - 0.5 * width_s {
            sum -= values[first];
            first += 1;
        }
        sum / (end - first) as f64
    };
    (0..t_s.len()).map(mean).collect()
}

/// The usual time step, 0 for fewer than two rows.
pub(super) fn usual_step(t_s: &[f64]) -> f64 {
    let steps: Vec<f64> = t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    quantile(&steps, 0.5).unwrap_or(0.0)
}

/// Time steps longer than usual: where each begins, and how long it is.
pub(super) fn gaps(t_s: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    let usual_s = usual_step(t_s);
    let steps = t_s.windows(2).map(|pair| (pair[0], pair[1] - pair[0]));
    steps.filter(move |(_, step)| *step > GAP_STEPS * usual_s)
}

/// Number of time steps longer than usual, and the longest of them.
pub(super) fn gap_steps(t_s: &[f64]) -> (usize, f64) {
    gaps(t_s).fold((0, 0.0_f64), |(count, longest), (_, step)| (count + 1, longest.max(step)))
}

/// Clocks part by 100 millionths at most, unless one of them is wrong: by this 60 ms in a minute.
const MOST_DRIFT_PPM: f64 = 1000.0;

/// Notes time steps longer than usual.
pub(super) fn time_gaps(t_s: &[f64], notes: &mut Vec<Note>) {
    let (count, longest_s) = gap_steps(t_s);
    if count > 0 {
        notes.push(Note::TimeGaps { count, usual_s: usual_step(t_s), longest_s });
    }
}

/// Brings capture times to the log's clock where the camera's runs at another rate, and notes those that do not
/// increase or lie after the arrival.
pub(super) fn check_capture(t_s: &[f64], fixes: &mut Fixes, notes: &mut Vec<Note>) {
    let arrived_s: Vec<f64> = fixes.row.iter().map(|row| t_s[*row]).collect();
    let late_s: Vec<f64> = arrived_s.iter().zip(&fixes.capture_t_s).map(|(a, c)| a - c).collect();
    let fast_ppm = drift_ppm(&arrived_s, &late_s).map_or(0.0, |late_ppm| -late_ppm);
    if fast_ppm.abs() > MOST_DRIFT_PPM {
        let first_s = fixes.capture_t_s[0];
        fixes.capture_t_s.iter_mut().for_each(|t| *t = first_s + (*t - first_s) / (1.0 + 1e-6 * fast_ppm));
        notes.push(Note::CaptureDrift { fast_ppm });
    }
    let count = fixes.capture_t_s.windows(2).filter(|pair| pair[1] <= pair[0]).count();
    if count > 0 {
        notes.push(Note::CaptureOutOfOrder { count });
    }
    let count = arrived_s.iter().zip(&fixes.capture_t_s).filter(|(t, capture)| *capture > *t).count();
    if count > 0 {
        notes.push(Note::CaptureInFuture { count });
    }
}

/// The last measured height in each of `rows` rows; before the first fix, that fix's. `None` without any fix.
pub(super) fn height_by_row(rows: usize, fixes: &Fixes) -> Option<Vec<f64>> {
    let mut height = *fixes.pos_m[2].first()?;
    let mut arrived = fixes.row.iter().zip(&fixes.pos_m[2]).peekable();
    let mut by_row = Vec::with_capacity(rows);
    for row in 0..rows {
        while let Some((_, z)) = arrived.next_if(|(at, _)| **at <= row) {
            height = *z;
        }
        by_row.push(height);
    }
    Some(by_row)
}

/// The longest interval of rows above `height_m`, dips shorter than [`BRIDGED_S`] included.
pub(super) fn longest_above(t_s: &[f64], z_m: &[f64], height_m: f64) -> Range<usize> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (row, _) in z_m.iter().enumerate().filter(|(_, z)| **z > height_m) {
        match runs.last_mut() {
            Some(run) if t_s[row] - t_s[run.end - 1] <= BRIDGED_S => run.end = row + 1,
            _ => runs.push(row..row + 1),
        }
    }
    let duration = |run: &Range<usize>| t_s[run.end - 1] - t_s[run.start];
    let longest = runs.into_iter().max_by(|a, b| duration(a).total_cmp(&duration(b)));
    longest.unwrap_or(0..0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_clock_of_another_rate_is_brought_to_the_logs() {
        let t_s: Vec<f64> = (0..3000).map(|row| 0.01 * f64::from(row)).collect();
        for (rate, is_noted) in [(1.005, true), (0.997, true), (1.0001, false)] {
            let row: Vec<usize> = (10..3000).step_by(3).collect();
            // 50 ms late, some frames by a queue of up to 20 ms more
            let captured_s = |row: &usize| t_s[*row] - 0.05 - 0.001 * (row * 7 % 20) as f64;
            let capture_t_s = row.iter().map(|row| rate * captured_s(row)).collect();
            let pos_m = std::array::from_fn(|_| vec![0.0; row.len()]);
            let (mut fixes, mut notes) = (Fixes { row, capture_t_s, pos_m, yaw_rad: None }, Vec::new());
            check_capture(&t_s, &mut fixes, &mut notes);
            assert_eq!(
                notes.iter().any(|note| matches!(note, Note::CaptureDrift { .. })),
                is_noted,
                "{notes:?}"
            );
            let off_s = |(row, capture): (&usize, &f64)| capture - captured_s(row);
            let worst =
                fixes.row.iter().zip(&fixes.capture_t_s).map(off_s).fold(0.0, |a: f64, b| a.max(b.abs()));
            assert!(worst < 0.004, "{rate}: {worst} s");
        }
    }

    #[test]
    fn unwrap_follows_a_turning_yaw() {
        let truth: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.1 - 5.0).collect();
        let mut wrapped: Vec<f64> = truth.iter().map(|a| a.sin().atan2(a.cos())).collect();
        let mut notes = Vec::new();
        let offset = truth[0] - wrapped[0];
        unwrap(&mut wrapped, "yaw", &mut notes);
        for (angle, expected) in wrapped.iter().zip(&truth) {
            assert!((angle + offset - expected).abs() < 1e-9);
        }
        assert_eq!(notes.len(), 1);
    }

    #[test]
    fn longest_above_bridges_a_dip_and_prefers_the_longer_flight() {
        let t: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.1).collect();
        let mut z = vec![0.0; 100];
        z[5..15].fill(1.0);
        z[30..90].fill(1.0);
        z[50..53].fill(0.0);
        assert_eq!(longest_above(&t, &z, 0.1), 30..90);
        assert_eq!(longest_above(&t, &z, 2.0), 0..0);
    }

    #[test]
    fn a_centred_mean_leaves_a_line_where_it_is() {
        let t: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.01).collect();
        let smooth = centred_mean(&t, &t, 0.05);
        assert!(smooth.iter().zip(&t).skip(3).take(44).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(centred_mean(&[0.0], &[2.0], 0.1), [2.0]);
    }

    #[test]
    fn a_fall_is_an_acceleration() {
        let t: Vec<f64> = (0..60).map(|i| f64::from(i) * 0.011).collect();
        let fall: Vec<f64> = t.iter().map(|t| 1.0 + 0.3 * t - 0.5 * 9.81 * t * t).collect();
        let [x, _, z] = acceleration_of(&t, &[t.clone(), vec![0.0; 60], fall]);
        assert!(z.iter().all(|a| (a + 9.81).abs() < 1e-6) && x.iter().all(|a| a.abs() < 1e-6), "{z:?}");
    }

    #[test]
    fn height_holds_between_fixes_and_is_unknown_without_any() {
        let mut fixes = Fixes::default();
        assert_eq!(height_by_row(3, &fixes), None);
        fixes.row = vec![1, 3];
        fixes.pos_m[2] = vec![0.5, 0.7];
        assert_eq!(height_by_row(5, &fixes), Some(vec![0.5, 0.5, 0.5, 0.7, 0.7]));
    }
}
