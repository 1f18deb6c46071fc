//! Made-up recordings in binary formats, written here byte by byte.
#![allow(dead_code, unused_imports)] // each test file uses its own part

#[path = "damage.rs"]
mod damage;
#[path = "sound.rs"]
mod sound;

pub use damage::damage;
pub use sound::{check, read};

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
    let names = [
        "stateEstimate.x",
        "stateEstimate.y",
        "stateEstimate.z",
        "controller.cmd_thrust",
        "controller.cmd_roll",
        "controller.cmd_pitch",
    ];
    let more = [
        "controller.cmd_yaw",
        "controller.r_roll",
        "controller.r_pitch",
        "controller.r_yaw",
        "controller.accelz",
        "controller.yaw",
    ];
    let variables: Vec<String> = names.iter().chain(&more).map(|name| format!("{name}(f)")).collect();
    let mut card = Card::new(2, &variables.iter().map(String::as_str).collect::<Vec<_>>());
    for i in 0..200_u64 {
        let t = i as f32 * 0.01;
        let on = if i > 50 { 1.0 } else { 0.0 };
        let values = [
            t,
            0.1,
            on * (t - 0.5),
            on * 40_000.0,
            10.0,
            -20.0,
            500.0,
            0.1 * on,
            0.2 * on,
            -0.3 * on,
            1.0,
            5.0,
        ];
        card.record(i * 10_000, &values.map(f32::to_le_bytes).concat());
    }
    card.finish()
}
