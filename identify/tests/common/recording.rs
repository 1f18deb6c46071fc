//! Made-up recordings in binary formats, written here byte by byte, and ways to damage them.
#![allow(dead_code)] // each test file uses its own part

use crazyflie_identify::log::FlightLog;
use proptest::prelude::*;

/// What must hold of every log, however odd its file was.
pub fn check(log: &FlightLog) {
    let rows = log.len();
    assert!(rows > 0 && log.airborne.end <= rows);
    assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
    let sound = |channel: &Vec<f64>| assert!(channel.len() == rows && channel.iter().all(|v| v.is_finite()));
    [&log.t_s, &log.roll_rad, &log.pitch_rad, &log.yaw_rad].into_iter().for_each(sound);
    let commands =
        [&log.cmd_roll_rad, &log.cmd_pitch_rad, &log.cmd_yaw_rate_radps, &log.cmd_thrust_pwm, &log.vbat_v, &log.setpoint_yaw_rad];
    commands.into_iter().flatten().for_each(sound);
    [&log.gyro_radps, &log.acc_mps2, &log.setpoint_m].into_iter().flatten().flatten().for_each(sound);
    if let Some(onboard) = &log.onboard {
        [&onboard.pos_m, &onboard.vel_mps, &onboard.attitude_rad, &onboard.acc_world_mps2].into_iter().flatten().flatten().for_each(sound);
        [&onboard.motor_pwm, &onboard.motor_request_pwm].into_iter().flatten().flatten().for_each(sound);
    }
    let fixes = &log.fixes;
    assert!(fixes.row.windows(2).all(|w| w[0] < w[1]) && fixes.row.last().is_none_or(|last| *last < rows));
    for channel in fixes.pos_m.iter().chain([&fixes.capture_t_s]).chain(&fixes.yaw_rad) {
        assert!(channel.len() == fixes.row.len() && channel.iter().all(|v| v.is_finite()));
    }
    for note in &log.notes {
        assert!(!note.to_string().is_empty(), "{note:?}");
    }
}

/// A micro-SD log with one event type.
pub struct Card {
    bytes: Vec<u8>,
    version: u8,
}

impl Card {
    pub fn new(version: u8, variables: &[&str]) -> Self {
        let mut bytes = vec![0xbc, version, 0, 1, 0, 0xff, 0xff];
        bytes.extend(b"fixedFrequency\0");
        bytes.extend((variables.len() as u16).to_le_bytes());
        for variable in variables {
            bytes.extend(variable.as_bytes());
            bytes.push(0);
        }
        Self { bytes, version }
    }

    pub fn record(&mut self, time_us: u64, values: &[u8]) {
        self.bytes.extend([0xff, 0xff]);
        match self.version {
            1 => self.bytes.extend(((time_us / 1000) as u32).to_le_bytes()),
            _ => self.bytes.extend(time_us.to_le_bytes()),
        }
        self.bytes.extend(values);
    }

    pub fn finish(mut self) -> Vec<u8> {
        let sum = crc32fast::hash(&self.bytes);
        self.bytes.extend(sum.to_le_bytes());
        self.bytes
    }
}

/// A hop of two seconds with the variables of the controller.
pub fn hop() -> Vec<u8> {
    let names =
        ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "controller.cmd_thrust", "controller.cmd_roll", "controller.cmd_pitch"];
    let more = ["controller.cmd_yaw", "controller.r_roll", "controller.r_pitch", "controller.r_yaw", "controller.accelz", "controller.yaw"];
    let variables: Vec<String> = names.iter().chain(&more).map(|name| format!("{name}(f)")).collect();
    let mut card = Card::new(2, &variables.iter().map(String::as_str).collect::<Vec<_>>());
    for i in 0..200_u64 {
        let t = i as f32 * 0.01;
        let on = if i > 50 { 1.0 } else { 0.0 };
        let values = [t, 0.1, on * (t - 0.5), on * 40_000.0, 10.0, -20.0, 500.0, 0.1 * on, 0.2 * on, -0.3 * on, 1.0, 5.0];
        card.record(i * 10_000, &values.map(f32::to_le_bytes).concat());
    }
    card.finish()
}

/// A way to damage a file.
#[derive(Debug, Clone)]
pub enum Damage {
    Byte(usize, u8),
    Bit(usize, u8),
    Delete(usize, usize),
    Insert(usize, Vec<u8>),
    Repeat(usize, usize),
    Truncate(usize),
}

pub fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<u32>().prop_map(|at| at as usize);
    // Lengths that ask for too much, and numbers that are none.
    let odd = prop::sample::select(vec![
        vec![0xff; 4],
        vec![0xff; 8],
        vec![0; 8],
        vec![0xff, 0xff, 0xff, 0x7f],
        f64::NAN.to_le_bytes().to_vec(),
        f64::MAX.to_le_bytes().to_vec(),
        f32::INFINITY.to_le_bytes().to_vec(),
    ]);
    prop_oneof![
        (at.clone(), any::<u8>()).prop_map(|(a, b)| Damage::Byte(a, b)),
        (at.clone(), 0..8_u8).prop_map(|(a, b)| Damage::Bit(a, b)),
        (at.clone(), 1..200_usize).prop_map(|(a, n)| Damage::Delete(a, n)),
        (at.clone(), odd).prop_map(|(a, s)| Damage::Insert(a, s)),
        (at.clone(), 1..400_usize).prop_map(|(a, n)| Damage::Repeat(a, n)),
        at.prop_map(Damage::Truncate),
    ]
}

impl Damage {
    pub fn apply(&self, bytes: &mut Vec<u8>) {
        let length = bytes.len();
        let wrap = |at: &usize| at % (length + 1);
        match self {
            Self::Byte(at, value) => {
                if let Some(byte) = bytes.get_mut(wrap(at)) {
                    *byte = *value;
                }
            }
            Self::Bit(at, bit) => {
                if let Some(byte) = bytes.get_mut(wrap(at)) {
                    *byte ^= 1 << bit;
                }
            }
            Self::Delete(at, count) => {
                let at = wrap(at);
                bytes.drain(at..(at + count).min(length));
            }
            Self::Insert(at, new) => {
                let at = wrap(at);
                let end = (at + new.len()).min(length);
                // Over what is there, so that fields stay in place.
                bytes.splice(at..end, new.iter().copied());
            }
            Self::Repeat(at, count) => {
                let at = wrap(at);
                let copy = bytes[at..(at + count).min(length)].to_vec();
                bytes.splice(at..at, copy);
            }
            Self::Truncate(at) => bytes.truncate(wrap(at)),
        }
    }
}
