//! Flight logs: one structure, many file formats.

mod align;
mod attitude;
mod bag;
mod bytes;
mod detect;
mod error;
mod firmware;
mod hidden_effects;
mod marker;
mod mcap_read;
mod mcap_write;
mod message;
mod nanobench;
mod note;
mod project;
mod radio;
mod ros;
mod same;
mod samples;
mod signal;
mod skew;
mod table;
mod text;
mod topics;
mod usd;
mod write;

use std::fmt;
use std::ops::Range;
use std::path::Path;

pub use error::{LogError, MissingColumn};
pub use note::Note;
pub use same::first_duplicate;

/// The file format a log came from: known by the first bytes of binary files, by the column names of CSV.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// This project's own form, written by [`FlightLog::write_csv`] or [`FlightLog::write_mcap`].
    Project,
    /// NanoBench: a real Crazyflie 2.1 under motion capture, 100 Hz.
    NanoBench,
    /// Simulated closed-loop flights with an undeclared effect.
    HiddenEffects,
    /// Messages of the thesis's rig (`crazyflie_ros` and a marker) in a ROS 1 bag or an MCAP.
    Ros,
    /// The firmware's variables on the Crazyflie's micro-SD card.
    MicroSd,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Project => "a project CSV",
            Self::NanoBench => "a NanoBench CSV",
            Self::HiddenEffects => "a hidden-effects CSV",
            Self::Ros => "a recording of ROS messages",
            Self::MicroSd => "a micro-SD log",
        })
    }
}

/// Position measurements, each with the time it was captured. They exist only where one arrived: k fixes, k <= rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Fixes {
    /// Row of the log in which the fix arrived, ascending.
    pub row: Vec<usize>,
    /// When the picture was taken, on the clock of `t_s`; about 50 ms before arrival for a camera,
    /// equal to the row's time for motion capture. In order of arrival, see [`Note::CaptureOutOfOrder`].
    pub capture_t_s: Vec<f64>,
    /// x, y, z.
    pub pos_m: [Vec<f64>; 3],
    /// Yaw of the marker, where the format has it, as recorded (may wrap).
    pub yaw_rad: Option<Vec<f64>>,
}

/// The vehicle's own estimates, one value per row. NanoBench has them on their own clock, see [`Note::ClockSkew`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Onboard {
    pub pos_m: Option<[Vec<f64>; 3]>,
    pub vel_mps: Option<[Vec<f64>; 3]>,
    /// Roll, pitch and yaw; yaw continuous.
    pub attitude_rad: Option<[Vec<f64>; 3]>,
    /// The four motor commands after battery compensation, counts.
    pub motor_pwm: Option<[Vec<f64>; 4]>,
    /// Rate of the yaw setpoint, right-handed (yaw' = +rate). The firmware's yaw-rate command is not logged.
    pub setpoint_yaw_rate_radps: Option<Vec<f64>>,
    /// Body rates that the attitude loop asks of the rate loop, right-handed.
    pub cmd_rates_radps: Option<[Vec<f64>; 3]>,
    /// What the mixer asks of the four motors before battery compensation, counts: their mean is the thrust command, their
    /// differences are the moments that the rate controller needs to keep the vehicle straight.
    pub motor_request_pwm: Option<[Vec<f64>; 4]>,
    /// Acceleration in the world frame, gravity taken out.
    pub acc_world_mps2: Option<[Vec<f64>; 3]>,
    /// Specific force along the body's z axis, where the log holds no more of it than that.
    pub acc_z_mps2: Option<Vec<f64>>,
}

/// What a simulator knows to be true. One value per row.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    pub pos_m: [Vec<f64>; 3],
    pub vel_mps: [Vec<f64>; 3],
    pub roll_rad: Vec<f64>,
    pub pitch_rad: Vec<f64>,
    /// Continuous.
    pub yaw_rad: Vec<f64>,
}

/// One flight. SI units and radians; right-handed, z up, +pitch accelerates to +x, +roll to -y.
///
/// Every `Vec` outside [`Fixes`] has one finite value per row. A channel that the file lacks, or whose packets
/// never came, is `None`.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightLog {
    pub format: Format,
    /// Time of each row, strictly increasing.
    pub t_s: Vec<f64>,
    /// Rows during which the vehicle flies, empty if it never does: 0.05 m above where this flight's vehicle stood for NanoBench (0.1 m if the
    /// log does not hold it standing), above 0.1 m for ROS, above 0.05 m in project files, above 0.15 m with the motors on in micro-SD logs,
    /// whose height is an estimate, and all rows of hidden-effects files, which hold
    /// neither take-off nor landing. The ends fly through ground effect: see [`FlightLog::interval_above`].
    pub airborne: Range<usize>,

    pub cmd_roll_rad: Option<Vec<f64>>,
    pub cmd_pitch_rad: Option<Vec<f64>>,
    /// With the thesis's sign: yaw' = -cmd.
    pub cmd_yaw_rate_radps: Option<Vec<f64>>,
    /// Thrust command before any battery compensation, 0..65535.
    pub cmd_thrust_pwm: Option<Vec<f64>>,
    pub cmd_height_m: Option<Vec<f64>>,
    /// NanoBench logs (0, 0, 0) before and after the flight, meaning "no setpoint".
    pub setpoint_m: Option<[Vec<f64>; 3]>,
    /// As recorded (may wrap).
    pub setpoint_yaw_rad: Option<Vec<f64>>,

    /// Camera fixes, or motion capture (one fix per row), or the vehicle's estimate where nothing else measured it, see
    /// [`Note::PositionEstimated`].
    pub fixes: Fixes,
    /// Measured velocity in the world frame (motion capture only).
    pub vel_mps: Option<[Vec<f64>; 3]>,
    /// Measured attitude: motion capture for NanoBench, else the vehicle's IMU estimate.
    pub roll_rad: Vec<f64>,
    pub pitch_rad: Vec<f64>,
    /// Continuous (no wraps).
    pub yaw_rad: Vec<f64>,
    /// Angular rate in the body frame.
    pub gyro_radps: Option<[Vec<f64>; 3]>,
    /// Specific force in the body frame: +9.81 on z at rest.
    pub acc_mps2: Option<[Vec<f64>; 3]>,
    pub vbat_v: Option<Vec<f64>>,

    pub onboard: Option<Onboard>,
    pub truth: Option<Truth>,
    /// Everything that was detected, cut or converted.
    pub notes: Vec<Note>,
}

impl FlightLog {
    /// Reads a log file, gzipped or not, of any [`Format`].
    ///
    /// # Errors
    /// [`LogError`] names the file and, where there is one, the line, the column, the value and what was expected.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let file = path.display().to_string();
        let bytes = text::load(path, &file)?;
        Self::from_bytes(&file, &bytes)
    }

    /// Reads a log from the bytes of a file; `file` is the name used in errors.
    ///
    /// # Errors
    /// As [`FlightLog::read`].
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, LogError> {
        let mut notes = Vec::new();
        let text = text::decompress(file, bytes, &mut notes)?;
        if text.starts_with(bag::MAGIC) {
            let topics = bag::read(file, &text, &mut notes)?;
            return ros::read(file, &topics, notes);
        }
        if text.starts_with(mcap::MAGIC) {
            return mcap_read::read(file, &text, notes);
        }
        if text.first() == Some(&usd::MAGIC) {
            return firmware::read(file, &text, notes);
        }
        let table = table::Table::parse(file, &text, &mut notes)?;
        match detect::format(&table, &mut notes)? {
            Format::NanoBench => nanobench::read(&table, notes),
            Format::HiddenEffects => hidden_effects::read(&table, notes),
            _ => project::read(&table, notes),
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether the log has no rows (no reader returns such a log).
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// The longest interval of rows during which the vehicle stays above `height_m`, empty if there is none.
    ///
    /// Dips shorter than 0.5 s are bridged: they are outliers of the marker. Between fixes the last one holds;
    /// without any fix the true height is used, where the log has it.
    pub fn interval_above(&self, height_m: f64) -> Range<usize> {
        match signal::height_by_row(self.len(), &self.fixes) {
            Some(z) => signal::longest_above(&self.t_s, &z, height_m),
            None => match &self.truth {
                Some(truth) => signal::longest_above(&self.t_s, &truth.pos_m[2], height_m),
                None => 0..0,
            },
        }
    }

    /// Fills `airborne` and says so in the notes when there is no such interval.
    fn find_airborne(&mut self, above_m: f64) {
        self.airborne = self.interval_above(above_m);
        if self.fixes.row.is_empty() && self.truth.is_none() {
            self.notes.push(Note::NoPosition);
        } else if self.airborne.is_empty() {
            self.notes.push(Note::NeverAirborne { above_m });
        }
    }
}
