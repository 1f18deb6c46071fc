//! The control clock of a log: how long a tick lasts and where ticks begin.

use std::f64::consts::TAU;

use crazyflie_statistics::quantile;

use crate::FlightLog;

/// Rows of a log and ticks of a world differ only by rounding.
pub const ROUNDING_S: f64 = 1e-6;
/// Changes of commands fall on every second row if their times, as angles of a circle that is two rows long, have
/// a mean vector of this length. Changes on all rows have next to 0. One lost row in ten shortens it to 0.8,
/// stamps that jitter by 0.4 of a row to 0.76: half was set before a look at any log.
const CONCENTRATED: f64 = 0.5;
/// The median interval of jittering stamps is within this share of the mean one.
const REACH: f64 = 0.03;
/// Changes that a search for the circle begins with; each round has twice as many.
const FIRST_CHANGES: usize = 128;

/// Rows and control ticks of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlClock {
    /// Sampling interval of the rows.
    pub row_s: f64,
    /// Length of a control tick.
    pub tick_s: f64,
    /// Time of the log at which a tick begins.
    pub phase_s: f64,
    /// Commands change on every second row only.
    pub skips_rows: bool,
}

/// The usual distance of neighbouring times; `None` for fewer than two.
pub(crate) fn usual_step(times_s: &[f64]) -> Option<f64> {
    quantile(&times_s.windows(2).map(|t| t[1] - t[0]).collect::<Vec<_>>(), 0.5)
}

impl ControlClock {
    /// The clock of a log. The controller of a 100 Hz log runs at 50 Hz where its commands change every second row,
    /// or are interpolated from less. Times decide, not row numbers: a row may be lost.
    pub fn from_log(log: &FlightLog) -> Self {
        let (row_s, first_s) = (usual_step(&log.t_s).unwrap_or(0.0), log.t_s[0]);
        let every_row = ControlClock { row_s, tick_s: row_s, phase_s: first_s, skips_rows: false };
        if log.provenance.onboard_interpolated {
            return ControlClock { tick_s: 2.0 * row_s, ..every_row };
        }
        let changes_s = changes_s(log);
        let Some((circle_s, phase_s)) = circle(&changes_s, 2.0 * row_s) else { return every_row };
        // exact stamps have an exact phase
        let phase_s = if phase_s.abs() < ROUNDING_S { 0.0 } else { phase_s };
        ControlClock { row_s: 0.5 * circle_s, tick_s: circle_s, phase_s: first_s + phase_s, skips_rows: true }
    }

    /// The first tick that begins at or after a time.
    pub fn tick_from(&self, t_s: f64) -> f64 {
        self.phase_s + ((t_s - self.phase_s) / self.tick_s - ROUNDING_S).ceil() * self.tick_s
    }
}

/// Times at which any command changes, from the first row on.
fn changes_s(log: &FlightLog) -> Vec<f64> {
    let commands = [
        &log.cmd_roll_rad,
        &log.cmd_pitch_rad,
        &log.cmd_yaw_rate_radps,
        &log.cmd_thrust_pwm,
        &log.cmd_height_m,
    ];
    let changes = |i: &usize| commands.iter().any(|c| c.as_ref().is_some_and(|v| v[*i] != v[*i - 1]));
    (1..log.len()).filter(changes).map(|i| log.t_s[i] - log.t_s[0]).collect()
}

/// Length of the mean vector of times on a circle, and its phase in seconds.
fn mean_vector(times_s: &[f64], circle_s: f64) -> (f64, f64) {
    let sum = times_s.iter().map(|t| (TAU * t / circle_s).sin_cos());
    let (sine, cosine) = sum.fold((0.0, 0.0), |(s, c), (sine, cosine)| (s + sine, c + cosine));
    (f64::hypot(sine, cosine) / times_s.len() as f64, sine.atan2(cosine) * circle_s / TAU)
}

/// The circle of about this length on which nearly all times share a phase, and that phase. Jittering stamps have
/// a median interval that is off by a little: the circle is searched on the first times, and refined on ever more.
fn circle(times_s: &[f64], about_s: f64) -> Option<(f64, f64)> {
    let shared = |circle_s: f64, times_s: &[f64]| {
        let (length, phase_s) = mean_vector(times_s, circle_s);
        (length > CONCENTRATED).then_some((circle_s, phase_s))
    };
    if let Some(found) = shared(about_s, times_s) {
        return Some(found);
    }
    let mut circle_s = about_s;
    let (mut reach_s, mut count) = (REACH * about_s, FIRST_CHANGES);
    loop {
        let part = &times_s[..count.min(times_s.len())];
        // a circle that is off by this turns the last time against the first by an eighth
        let step_s = 0.125 * circle_s * circle_s / part.last()?;
        let steps = (reach_s / step_s).ceil();
        let tried = (0..=2 * steps as usize).map(|i| circle_s + (i as f64 - steps) * step_s);
        circle_s = tried.max_by(|a, b| mean_vector(part, *a).0.total_cmp(&mean_vector(part, *b).0))?;
        if part.len() == times_s.len() {
            return shared(circle_s, times_s);
        }
        shared(circle_s, part)?;
        (reach_s, count) = (2.0 * step_s, 2 * count);
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A 100 Hz log of a controller that changes its commands every `rows` rows.
    fn log(rows: usize, stamp: impl Fn(usize) -> Option<f64>) -> FlightLog {
        let line = |i: usize| {
            let u = (0.7 * (i / rows) as f64).sin();
            Some(format!(
                "{:.6},0,0,1,0,{u},{u},0,{},{i}e-3,0,0.7,{u},{u},0,{:.6},4.0\n",
                stamp(i)?,
                39_000.0 + u,
                stamp(i)?
            ))
        };
        let head = "t,ref_x,ref_y,ref_z,ref_yaw,cmd_roll,cmd_pitch,cmd_yawrate,cmd_thrust_pwm,x,y,z,roll,pitch,yaw,t_cam,vbat\n";
        let text: String = (0..3000).filter_map(line).collect();
        FlightLog::from_bytes("made.csv", format!("{head}{text}").as_bytes()).unwrap()
    }

    fn at(i: usize) -> Option<f64> {
        Some(i as f64 / 100.0)
    }

    #[test]
    fn a_row_that_is_lost_does_not_change_the_clock() {
        let whole = ControlClock::from_log(&log(2, at));
        assert_eq!((whole.tick_s, whole.phase_s, whole.skips_rows), (2.0 * whole.row_s, 0.0, true));
        for lost in 0..40 {
            let less = ControlClock::from_log(&log(2, |i| at(i).filter(|_| i != lost)));
            assert!((less.tick_s - 0.02).abs() < 1e-9, "{less:?}");
            // ticks stay where they were, whichever row the log begins with
            let shift = less.phase_s / 0.02;
            assert!((shift - shift.round()).abs() < 0.01, "row {lost}: {less:?}");
        }
        let one_in_ten = ControlClock::from_log(&log(2, |i| at(i).filter(|_| (i * 7919) % 10 != 3)));
        assert!((one_in_ten.tick_s - 0.02).abs() < 1e-6, "{one_in_ten:?}");
    }

    #[test]
    fn stamps_that_jitter_do_not_change_the_clock() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let jitter_s: Vec<f64> = (0..3000).map(|_| 0.004 * (2.0 * rng.random::<f64>() - 1.0)).collect();
        let clock = ControlClock::from_log(&log(2, |i| at(i).map(|t| t + jitter_s[i])));
        assert!((clock.tick_s - 0.02).abs() < 2e-6 && clock.skips_rows, "{clock:?}");
        let shift = (clock.phase_s / 0.02).rem_euclid(1.0);
        assert!(shift.min(1.0 - shift) < 0.05, "{clock:?}");
    }

    #[test]
    fn a_controller_as_fast_as_the_log_has_ticks_of_one_row() {
        let clock = ControlClock::from_log(&log(1, at));
        assert!(!clock.skips_rows && clock.tick_s == clock.row_s);
    }
}
