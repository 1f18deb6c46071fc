//! A flight for a motor-level model: measured motion and rotor commands on one even clock.

use crazyflie_statistics::quantile;

use crate::fit::clock::usual_step;
use crate::lift::motor_voltages;
use crate::replay::measurements::interpolate;
use crate::{Error, FlightLog, Result};

/// The clock of the horizons.
pub const STEP_S: f64 = 0.01;
/// Logs whose usual step is further from it are on another clock.
const STEP_TOLERANCE_S: f64 = 5e-4;
/// Below this height the floor is felt.
const CLEAR_OF_FLOOR_M: f64 = 0.3;
/// Two seconds to learn trims from, and a second to predict.
const LEAST_ROWS: usize = 300;

/// Measured motion and rotor commands, row by row.
#[derive(Debug, Clone)]
pub struct MotorFlight {
    /// Name of the log.
    pub name: String,
    /// Position, velocity, roll, pitch, yaw and body rates.
    pub motion: Vec<[f64; 12]>,
    /// Rotor speeds in rad/s where they were measured, else the mean voltage of each motor: share of full PWM
    /// times battery voltage.
    pub speeds: Vec<[f64; 4]>,
    /// So many rows later than in the log the rotors are, see [`super::regression::align`].
    pub rotors_later: isize,
}

impl MotorFlight {
    /// The part of a log that flies clear of the floor.
    ///
    /// # Errors
    /// [`Error`]: a signal is missing, the clock is another one, or it hardly flies.
    pub fn from_log(name: &str, log: &FlightLog) -> Result<Self> {
        let missing = |missing| move || Error::about(name, format!("the log lacks {missing}"));
        let onboard = log.onboard.as_ref();
        let speeds = onboard.and_then(|onboard| onboard.rotor_radps.clone()).or_else(|| motor_voltages(log));
        let speeds =
            speeds.ok_or_else(missing("rotor speeds, and motor PWM with battery voltage in their place"))?;
        let gyro = log.gyro_radps.as_ref().ok_or_else(missing("body rates"))?;
        let velocity = log.vel_mps.as_ref().or_else(|| onboard.and_then(|o| o.vel_mps.as_ref()));
        let velocity = velocity.ok_or_else(missing("velocity"))?;
        let place_m = positions(log).ok_or_else(missing("a position in every tenth row"))?;
        let step_s = usual_step(&log.t_s).unwrap_or(0.0);
        if (step_s - STEP_S).abs() > STEP_TOLERANCE_S {
            return Err(Error::about(name, format!("the usual step is {step_s:.4} s, expected {STEP_S} s")));
        }
        let rows = log.interval_above(CLEAR_OF_FLOOR_M);
        if rows.len() < LEAST_ROWS {
            let found = format!("{} rows fly above {CLEAR_OF_FLOOR_M} m", rows.len());
            return Err(Error::about(name, format!("{found}, at least {LEAST_ROWS} are needed")));
        }
        let motion = |row: usize| {
            let angles = [log.roll_rad[row], log.pitch_rad[row], log.yaw_rad[row]];
            std::array::from_fn(|i| match i {
                0..3 => place_m[i][row],
                3..6 => velocity[i - 3][row],
                6..9 => angles[i - 6],
                _ => gyro[i - 9][row],
            })
        };
        Ok(Self {
            name: name.to_owned(),
            motion: rows.clone().map(motion).collect(),
            speeds: rows.map(|row| speeds.each_ref().map(|motor| motor[row])).collect(),
            rotors_later: 0,
        })
    }

    /// Delays the rotors against the motion by rows; the first or the last speeds are repeated.
    pub(super) fn delay_rotors(&mut self, rows: isize) {
        let last = self.speeds.len().saturating_sub(1);
        let of_row = |row: usize| self.speeds[row.saturating_add_signed(-rows).min(last)];
        self.speeds = (0..self.speeds.len()).map(of_row).collect();
        self.rotors_later += rows;
    }
}

/// The position of every row. An estimate that repeats has no fix of its own, and a line between its neighbours is
/// its place. A tenth of the rows is a position at 10 Hz.
fn positions(log: &FlightLog) -> Option<[Vec<f64>; 3]> {
    let fixes = &log.fixes;
    if fixes.row.len() < 2 || 10 * fixes.row.len() < log.len() {
        return None;
    }
    let known: Vec<f64> = fixes.row.iter().map(|row| *row as f64).collect();
    let at = |axis: &[f64], row: usize| interpolate(&known, axis, row as f64);
    Some(fixes.pos_m.each_ref().map(|axis| (0..log.len()).map(|row| at(axis, row)).collect()))
}

/// Median rotor speed of some flights: the unit of a model's speeds.
#[must_use]
pub fn median_speed(flights: &[MotorFlight]) -> f64 {
    let all: Vec<f64> = flights.iter().flat_map(|f| f.speeds.iter().flatten().copied()).collect();
    quantile(&all, 0.5).unwrap_or(f64::NAN)
}
