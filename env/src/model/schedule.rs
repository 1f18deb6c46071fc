//! The rig's clocks on one base clock: 50 Hz control, 100 Hz IMU and 30 Hz camera all tick on whole counts of
//! 300 Hz.

use super::Model;
use crate::error::{Error, Result};

/// Periods in counts of the base clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    /// Counts per second: the least common multiple of the three rates.
    pub base_hz: u32,
    /// Counts per control tick (the environment's step).
    pub control: u32,
    /// Counts per IMU sample.
    pub imu: u32,
    /// Counts per camera frame.
    pub camera: u32,
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

impl Schedule {
    /// Creates the schedule of a model's rig.
    ///
    /// # Errors
    /// [`Error::Model`] unless the rates are whole numbers, the IMU's a multiple of the control rate, the
    /// camera's at most the control rate (one new frame per observation), and the base clock at most 20 kHz.
    pub fn from_model(model: &Model) -> Result<Schedule> {
        let bad = |problem: String| Error::Model { name: model.name.clone(), problem };
        let mut hz = [0_u32; 3];
        for (slot, (name, q)) in hz.iter_mut().zip([
            ("control", &model.rig.control),
            ("imu", &model.rig.imu),
            ("camera", &model.rig.camera),
        ]) {
            if q.value.fract() != 0.0 {
                return Err(bad(format!("rig.{name} is {} Hz, expected a whole number", q.value)));
            }
            *slot = q.value as u32;
        }
        let [control, imu, camera] = hz;
        let imu_multiple = u64::from(imu) / u64::from(gcd(control, imu)) * u64::from(control);
        let base =
            imu_multiple / gcd((imu_multiple % u64::from(camera)) as u32, camera) as u64 * u64::from(camera);
        if !imu.is_multiple_of(control) {
            return Err(bad(format!(
                "rig.imu is {imu} Hz, expected a multiple of rig.control, {control} Hz"
            )));
        }
        if camera > control {
            return Err(bad(format!(
                "rig.camera is {camera} Hz, expected at most rig.control, {control} Hz: one frame per observation"
            )));
        }
        if base > 20_000 {
            return Err(bad(format!(
                "the rig's rates {control}, {imu} and {camera} Hz meet only on a clock of {base} Hz, expected at most 20000"
            )));
        }
        let base_hz = base as u32;
        Ok(Schedule { base_hz, control: base_hz / control, imu: base_hz / imu, camera: base_hz / camera })
    }

    /// Seconds per control tick.
    pub fn tick_s(&self) -> f64 {
        self.seconds(self.control)
    }

    /// Seconds of so many counts.
    pub fn seconds(&self, counts: u32) -> f64 {
        f64::from(counts) / f64::from(self.base_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirty_frames_fall_between_fifty_ticks() {
        let s = Schedule::from_model(&Model::thesis()).unwrap();
        assert_eq!(s, Schedule { base_hz: 300, control: 6, imu: 3, camera: 10 });
        let offsets: Vec<u32> = (0..6).map(|frame| frame * s.camera % s.control).collect();
        assert_eq!(offsets, [0, 4, 2, 0, 4, 2], "frames fall on a tick only every third time");
    }

    #[test]
    fn impossible_rigs_are_refused() {
        for (control, imu, camera, word) in [
            (50.0, 75.0, 30.0, "multiple"),
            (50.0, 100.0, 60.0, "at most"),
            (50.5, 100.0, 30.0, "whole"),
            (997.0, 997.0, 991.0, "clock"),
        ] {
            let mut m = Model::thesis();
            (m.rig.control.value, m.rig.imu.value, m.rig.camera.value) = (control, imu, camera);
            let error = Schedule::from_model(&m).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
