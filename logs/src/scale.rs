//! Factors that mend a channel of a log: a turned sign, or a wrong unit.

use crate::{FlightLog, Note};

/// Channels that a mapping may scale.
pub(crate) const CHANNELS: &str =
    "roll pitch yaw cmd_roll cmd_pitch cmd_yaw_rate gyro_x gyro_y gyro_z acc_x acc_y acc_z";

impl FlightLog {
    /// Multiplies a channel, if the log has it.
    pub(crate) fn scale(&mut self, name: &'static str, factor: f64) {
        let axis = ["_x", "_y", "_z"].iter().position(|end| name.ends_with(end)).unwrap_or_default();
        let channel: Option<&mut Vec<f64>> = match name {
            "roll" => Some(&mut self.roll_rad),
            "pitch" => Some(&mut self.pitch_rad),
            "yaw" => Some(&mut self.yaw_rad),
            "cmd_roll" => self.cmd_roll_rad.as_mut(),
            "cmd_pitch" => self.cmd_pitch_rad.as_mut(),
            "cmd_yaw_rate" => self.cmd_yaw_rate_radps.as_mut(),
            "gyro_x" | "gyro_y" | "gyro_z" => self.gyro_radps.as_mut().map(|axes| &mut axes[axis]),
            "acc_x" | "acc_y" | "acc_z" => self.acc_mps2.as_mut().map(|axes| &mut axes[axis]),
            _ => None,
        };
        if let Some(values) = channel {
            values.iter_mut().for_each(|value| *value *= factor);
            self.notes.push(Note::Scaled { channel: name, factor });
        }
    }
}
