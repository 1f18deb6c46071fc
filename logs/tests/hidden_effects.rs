//! Tests of the reader on the simulated flights with a hidden effect.

mod common;

use std::sync::OnceLock;

use common::data;
use crazyflie_logs::{FlightLog, Note};

/// All flights, read once.
static LOGS: OnceLock<Vec<(String, FlightLog)>> = OnceLock::new();

fn each(mut check: impl FnMut(&str, &FlightLog)) {
    let folder = data("hidden_effects");
    let names = (0..35).flat_map(|case| ["a", "b"].map(|flight| format!("d{case:02}_{flight}")));
    let read = |name: String| (FlightLog::read(&folder.join(format!("{name}.csv.gz"))).unwrap(), name);
    for (name, log) in LOGS.get_or_init(|| names.map(read).map(|(log, name)| (name, log)).collect()) {
        check(name, log);
    }
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn every_flight_is_whole_and_in_the_air() {
    each(|name, log| {
        assert_eq!(log.provenance.format, "hidden_effects_csv");
        assert!(log.len() == 6000 || log.len() == 15000, "{name}: {} rows", log.len());
        assert_eq!(log.airborne, 0..log.len(), "{name}");
        assert!(!log.notes.iter().any(|n| matches!(n, Note::TimeGaps { .. })), "{name}");
        assert!(log.cmd_yaw_rate_radps.is_some() && log.cmd_thrust_pwm.is_some());
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn fixes_are_sparse_and_captured_before_they_arrive() {
    each(|name, log| {
        let fixes = &log.fixes;
        // 30 Hz of 100 Hz, less in flights with drop-outs.
        let share = fixes.row.len() as f64 / log.len() as f64;
        assert!((0.28..0.305).contains(&share), "{name}: {share}");
        assert_eq!(fixes.row.len(), fixes.capture_t_s.len());
        assert!(fixes.pos_m.iter().all(|x| x.len() == fixes.row.len()));
        assert!(fixes.yaw_rad.is_none());
        for (row, capture) in fixes.row.iter().zip(&fixes.capture_t_s) {
            let age = log.t_s[*row] - capture;
            assert!((0.049..0.061).contains(&age), "{name}: {age}");
        }
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn yaw_is_continuous_and_follows_minus_the_yaw_rate_command() {
    each(|name, log| {
        let widest = log.yaw_rad.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(widest < 1.0, "{name}: a step of {widest} rad");
        // Two cases turn steadily: the yaw rate is minus the command, within the effect that hides there.
        if name.starts_with("d07") || name.starts_with("d16") {
            assert!(log.notes.iter().any(|n| matches!(n, Note::Unwrapped { .. })));
            let last = log.len() - 1;
            let rate = (log.yaw_rad[last] - log.yaw_rad[0]) / (log.t_s[last] - log.t_s[0]);
            let command = log.cmd_yaw_rate_radps.as_ref().unwrap();
            let mean = command.iter().sum::<f64>() / command.len() as f64;
            assert!((0.9..1.1).contains(&(rate / -mean)), "{name}: {rate} for {mean}");
        }
    });
}
