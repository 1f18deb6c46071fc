//! Micro-SD logs: real ones, made-up ones, and damaged ones.

mod common;
#[path = "common/recording.rs"]
mod recording;

use std::path::PathBuf;

use common::{correlation, data, derivative};
use crazyflie_logs::{FlightLog, LogError, Note};
use proptest::prelude::*;
use recording::{Card, check};

const CONDITIONS: [&str; 4] =
    ["normal_flight", "add_weight_W1_near_M3_M4", "cut_propeller_M3_2mm", "weight_on_string_W2_near_M3"];
/// The one flight that turned over at take-off.
const CRASHED: &str = "controller_data/weight_on_string_W2_near_M3/E8_log02";

fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("E8_log00", bytes)
}

/// Every recorded file, with its name from the kind of data on.
fn read_recordings() -> Vec<(String, FlightLog)> {
    let folder = data("crazypad");
    let mut all = Vec::new();
    for kind in ["controller_data", "motor_data"] {
        for condition in CONDITIONS {
            let mut files: Vec<PathBuf> = std::fs::read_dir(folder.join(kind).join(condition))
                .unwrap()
                .map(|e| e.unwrap().path())
                .collect();
            files.sort();
            for path in files {
                let name = path.strip_prefix(&folder).unwrap().display().to_string();
                all.push((name, FlightLog::read(&path).unwrap()));
            }
        }
    }
    assert_eq!(all.len(), 30);
    all
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn every_recorded_file_is_whole() {
    for (name, log) in read_recordings() {
        check(&log);
        assert_eq!(log.provenance.format, "micro_sd", "{name}");
        assert!((2585..=2606).contains(&log.len()), "{name}: {}", log.len());
        assert!(log.notes.contains(&Note::PositionEstimated), "{name}");
        let damaged = |note: &Note| {
            matches!(
                note,
                Note::CutShort { .. }
                    | Note::WrongChecksum
                    | Note::OddValues { .. }
                    | Note::StampsOutOfOrder { .. }
            )
        };
        assert!(!log.notes.iter().any(damaged), "{name}: {:?}", log.notes);
        let fallen = log.notes.iter().any(|note| matches!(note, Note::UpsideDown { .. }));
        assert_eq!(fallen, name == CRASHED, "{name}");
    }
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn the_flights_rise_to_half_a_metre_and_go_two_metres_forward() {
    for (name, log) in read_recordings().into_iter().filter(|(name, _)| name != CRASHED) {
        let flown = log.airborne.clone();
        let seconds = log.t_s[flown.end - 1] - log.t_s[flown.start];
        assert!((7.0..9.5).contains(&seconds), "{name}: {seconds} s");
        let thrust = &log.cmd_thrust_pwm.as_ref().unwrap()[flown.clone()];
        let mean = thrust.iter().sum::<f64>() / thrust.len() as f64;
        assert!((38_000.0..44_000.0).contains(&mean), "{name}: {mean}");
        let x = &log.fixes.pos_m[0][flown.clone()];
        let travelled = x.iter().fold(f64::MIN, |a, b| a.max(*b)) - x.iter().fold(f64::MAX, |a, b| a.min(*b));
        assert!((1.8..2.4).contains(&travelled), "{name}: {travelled}");
    }
}

/// The sign of pitch, and that what was derived is the attitude: forward acceleration follows pitch.
#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn pitch_accelerates_forward() {
    for (name, log) in read_recordings().into_iter().filter(|(name, _)| name != CRASHED) {
        let rows = log.airborne.start + 60..log.airborne.end - 60;
        let reach = 25;
        let wide = |x: &[f64]| derivative(&log.t_s, &derivative(&log.t_s, x, reach), reach);
        let acceleration = wide(&log.fixes.pos_m[0]);
        let seen: Vec<f64> = rows.clone().map(|row| acceleration[row - 2 * reach]).collect();
        let alike = correlation(&seen, &log.pitch_rad[rows.clone()]);
        let least = if name.contains("motor_data") { 0.5 } else { 0.3 };
        assert!(alike > least, "{name}: {alike}");
        if let Some(command) = &log.cmd_pitch_rad {
            let alike = correlation(&seen, &command[rows]);
            assert!(alike > 0.5, "{name}: {alike} for the command");
        }
    }
}

/// The two kinds of file agree on the request to a motor: the mixer, put together again from the moments.
#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn motor_requests_show_the_planted_weight() {
    let logs = read_recordings();
    let left_heavier = |name: &str, kind: &str| {
        let flights = logs
            .iter()
            .filter(|(n, log)| n.contains(name) && n.contains(kind) && n != CRASHED && log.onboard.is_some());
        let moments: Vec<f64> = flights
            .map(|(_, log)| {
                let motors = log.onboard.as_ref().unwrap().motor_request_pwm.as_ref().unwrap();
                let mean =
                    |m: &Vec<f64>| m[log.airborne.clone()].iter().sum::<f64>() / log.airborne.len() as f64;
                let [m1, m2, m3, m4] = motors.each_ref().map(mean);
                (m3 + m4 - m1 - m2) / 2.0
            })
            .collect();
        moments.iter().sum::<f64>() / moments.len().max(1) as f64
    };
    for kind in ["controller_data", "motor_data"] {
        let (normal, loaded) = (left_heavier("normal_flight", kind), left_heavier("add_weight", kind));
        assert!(loaded - normal > 3000.0, "{kind}: {normal} to {loaded}");
    }
}

#[test]
fn both_versions_and_all_types_are_read() {
    for version in [1, 2] {
        let mut card = Card::new(
            version,
            &[
                "stateEstimate.roll(f)",
                "stateEstimate.pitch(d)",
                "stateEstimate.yaw(h)",
                "pm.vbatMV(H)",
                "odd(q)",
            ],
        );
        for i in 0..20_u8 {
            let values: [&[u8]; 5] = [
                &1.5_f32.to_le_bytes(),
                &(-2.0_f64).to_le_bytes(),
                &(-3_i16).to_le_bytes(),
                &3700_u16.to_le_bytes(),
                &[i; 8],
            ];
            card.record(u64::from(i) * 10_000 + 5_000_000, &values.concat());
        }
        let log = read(&card.finish()).unwrap();
        check(&log);
        assert_eq!(
            (log.len(), log.roll_rad[3], log.pitch_rad[3]),
            (20, 1.5_f64.to_radians(), 2.0_f64.to_radians())
        );
        assert_eq!((log.yaw_rad[0], log.vbat_v.as_ref().unwrap()[0]), ((-3.0_f64).to_radians(), 3.7));
        assert!((log.t_s[19] - 0.19).abs() < 1e-12);
        let ignored = Note::IgnoredColumns { columns: vec!["odd".to_owned()] };
        assert_eq!(
            log.notes,
            [ignored, Note::TimeShifted { start_s: 5.0 }, Note::NoYawRateCommand, Note::NoPosition]
        );
    }
}

#[test]
fn a_cut_file_gives_its_whole_records_and_says_so() {
    let bytes = recording::hop();
    let whole = read(&bytes).unwrap();
    let log = read(&bytes[..bytes.len() - 30]).unwrap();
    assert_eq!(log.len(), whole.len() - 1);
    assert_eq!(log.pitch_rad, whole.pitch_rad[..log.len()]);
    assert!(
        log.notes.iter().any(|note| matches!(note, Note::CutShort { kept, .. } if *kept == log.len())),
        "{:?}",
        log.notes
    );
    let mut flipped = bytes.clone();
    *flipped.last_mut().unwrap() ^= 1;
    assert!(read(&flipped).unwrap().notes.contains(&Note::WrongChecksum));
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let unknown = Card::new(2, &["a(f)"]);
    let mut useless = Card::new(2, &["a(f)"]);
    useless.record(1, &1_f32.to_le_bytes());
    let mut thrust = Card::new(
        2,
        &[
            "stateEstimate.roll(f)",
            "stateEstimate.pitch(f)",
            "stateEstimate.yaw(f)",
            "controller.cmd_thrust(f)",
        ],
    );
    thrust.record(1, &[0, 0, 0, 1e6_f32.to_bits()].map(u32::to_le_bytes).concat());
    type Case = (Vec<u8>, &'static str);
    let cases: [Case; 6] = [
        (vec![0xbc, 9, 0, 1, 0], "byte 3: expected version 1 or 2"),
        (vec![0xbc, 2, 0, 1, 0, 0xff, 0xff, b'a'], "expected the name of an event type"),
        (Card::new(2, &["a(x)"]).finish(), "expected a variable as name(type)"),
        (unknown.finish(), "no whole row"),
        (useless.finish(), "contains no attitude"),
        (thrust.finish(), "\"controller.cmd_thrust\", record 0: found 1000000, expected a PWM"),
    ];
    for (bytes, expected) in cases {
        let message = read(&bytes).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("E8_log00"), "{message} lacks {expected}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn damaged_cards_give_an_answer(damages in prop::collection::vec(recording::damage(), 1..5)) {
        let mut bytes = recording::hop();
        for damage in &damages {
            damage.apply(&mut bytes);
        }
        match read(&bytes) {
            Ok(log) => check(&log),
            Err(error) => prop_assert!(error.to_string().contains("E8_log00"), "{}", error),
        }
    }

    #[test]
    fn any_bytes_after_the_magic_give_an_answer(mut bytes in prop::collection::vec(any::<u8>(), 0..600), version in 0..3_u8) {
        bytes.splice(0..0, [0xbc, version, 0, 1, 0]);
        if let Ok(log) = read(&bytes) {
            check(&log);
        }
    }
}
