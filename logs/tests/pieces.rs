//! Pieces of recorded flights (see `data/cut.py`): the results of the readers and the inspection.

mod common;
#[path = "common/sound.rs"]
mod sound;

use common::piece;
use crazyflie_logs::inspect::{Inspection, SignVerdict};
use crazyflie_logs::{AttitudeSource, FlightLog, Note, PositionSource};

fn read(file: &str) -> (FlightLog, Inspection) {
    let log = FlightLog::read(&piece(file)).unwrap();
    sound::check(&log);
    let inspection = Inspection::from_log(&log);
    (log, inspection)
}

fn verdict(inspection: &Inspection, channel: &str) -> Option<SignVerdict> {
    inspection.signs.iter().find(|check| check.channel == channel).map(|check| check.verdict)
}

#[test]
fn a_real_take_off_under_motion_capture_is_understood() {
    let (log, inspection) = read("nanobench_start.csv.gz");
    let provenance = inspection.provenance;
    assert_eq!(
        (provenance.position, provenance.attitude),
        (PositionSource::MotionCapture, AttitudeSource::MotionCapture)
    );
    assert!(provenance.onboard_interpolated && (inspection.rate_hz - 100.0).abs() < 1.0);
    // The markers of a vehicle that stands are 53 to 72 mm above the floor.
    let rest_m = inspection.resting_height_m.unwrap();
    assert!((0.05..0.075).contains(&rest_m), "{rest_m}");
    let [from_s, _] = inspection.airborne_s.unwrap();
    assert!((0.9..2.2).contains(&from_s), "{from_s}");
    for channel in ["pitch", "roll", "acc_z", "gyro_x"] {
        assert_eq!(
            verdict(&inspection, channel),
            Some(SignVerdict::Agrees),
            "{channel}: {:?}",
            inspection.signs
        );
    }
    assert!(
        inspection.signs.iter().all(|check| check.verdict != SignVerdict::Contradicts),
        "{:?}",
        inspection.signs
    );
    let diagnose = inspection.needs.iter().find(|need| need.command == "diagnose").unwrap();
    assert!(diagnose.missing.iter().any(|missing| missing.starts_with("motor requests")), "{diagnose:?}");
    assert!(log.vbat_v.is_some() && log.onboard.unwrap().motor_pwm.is_some());
}

#[test]
fn a_wrong_sign_in_a_real_flight_is_seen() {
    let mut log = FlightLog::read(&piece("nanobench_start.csv.gz")).unwrap();
    log.pitch_rad.iter_mut().for_each(|pitch| *pitch = -*pitch);
    assert_eq!(verdict(&Inspection::from_log(&log), "pitch"), Some(SignVerdict::Contradicts));
}

/// A log of 40 s in slow circles with something faster beside, of a vehicle that a spring pulls to a place at 0.8 1/s^2;
/// `sign` of the pitch as logged.
fn pulled_to_a_place(sign: f64) -> FlightLog {
    let mut text = String::from(
        "t,ref_x,ref_y,ref_z,ref_yaw,cmd_roll,cmd_pitch,cmd_yawrate,cmd_thrust_pwm,x,y,z,roll,pitch,yaw,t_cam,vbat\n",
    );
    for row in 0..4000 {
        let t = row as f64 * 0.01;
        let wave =
            |rate: f64, size_m: f64| [size_m * (rate * t).sin(), -rate * rate * size_m * (rate * t).sin()];
        let [x, acceleration] = [0, 1].map(|i| wave(0.6, 1.0)[i] + wave(2.2, 0.03)[i]);
        let pitch_deg = sign * ((acceleration + 0.8 * (x - 0.75)) / 9.81).to_degrees();
        text += &format!("{t:.2},0,0,1,0,0,{pitch_deg:.4},0,39000,{x:.5},0,1,0,{pitch_deg:.4},0,{t:.2},4\n");
    }
    FlightLog::from_bytes("made.csv", text.as_bytes()).unwrap()
}

#[test]
fn a_force_of_place_turns_no_sign() {
    let pitch = |sign: f64| {
        let signs = Inspection::from_log(&pulled_to_a_place(sign)).signs;
        let check = signs.into_iter().find(|check| check.channel == "pitch").unwrap();
        (check.correlation, check.verdict)
    };
    let (correlation, verdict) = pitch(1.0);
    assert!(correlation < -0.35 && verdict == SignVerdict::NotSeen, "{correlation} {verdict:?}");
}

#[test]
fn the_end_of_a_real_flight_is_cut_at_its_last_packet() {
    let (log, inspection) = read("nanobench_end.csv.gz");
    let cut = log
        .notes
        .iter()
        .find_map(|note| if let Note::CutAfterLastPacket { cut_s, .. } = note { Some(*cut_s) } else { None });
    assert!((0.15..0.5).contains(&cut.unwrap()), "{cut:?}");
    let motors = log.onboard.as_ref().unwrap().motor_pwm.as_ref().unwrap();
    assert!(motors.iter().flatten().all(|pwm| (0.0..=65_535.0).contains(pwm)));
    let rest_m = inspection.resting_height_m.unwrap();
    assert!((0.05..0.075).contains(&rest_m), "{rest_m}");
}

#[test]
fn commands_that_never_came_are_missing() {
    let (log, inspection) = read("nanobench_no_commands.csv.gz");
    assert!(
        log.cmd_roll_rad.is_none() && log.notes.iter().any(|note| matches!(note, Note::DeadChannels { .. }))
    );
    let replay = inspection.needs.iter().find(|need| need.command == "replay").unwrap();
    assert!(replay.missing.iter().any(|lack| lack.starts_with("roll and pitch commands")), "{replay:?}");
}

#[test]
fn cards_of_real_flights_hold_what_the_deck_logged() {
    for (file, has_commands) in [("crazypad_controller.usd.gz", true), ("crazypad_motor.usd.gz", false)] {
        let (log, inspection) = read(file);
        assert_eq!(
            (log.provenance.format, log.provenance.position),
            ("micro_sd", PositionSource::Estimate),
            "{file}"
        );
        assert!(!log.notes.contains(&Note::WrongChecksum), "{file}");
        assert_eq!(log.cmd_pitch_rad.is_some(), has_commands, "{file}: {:?}", inspection.channels);
        assert_eq!(log.vbat_v.is_some(), !has_commands, "{file}");
        let diagnose = inspection.needs.iter().find(|need| need.command == "diagnose").unwrap();
        assert_eq!(diagnose.missing, [""; 0], "{file}");
        assert!(
            inspection.signs.iter().all(|check| check.verdict != SignVerdict::Contradicts),
            "{file}: {:?}",
            inspection.signs
        );
    }
}
