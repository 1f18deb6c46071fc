//! A flight out of channels that each have their own times.

use crate::attitude::{Rotation, integrate, tilt};
use crate::marker::arrivals;
use crate::series::{Interpolation, Series, TURN_RAD};
use crate::signal::{acceleration_of, check_capture, time_gaps, unwrap, usual_step};
use crate::{AttitudeSource, Fixes, FlightLog, G_MPS2, Note, Onboard, PositionSource, Provenance};

/// With more repeated positions than this, a slower instrument was repeated between its fixes.
const REPEATED_SHARE: f64 = 0.25;

/// Declared facts that the channels do not show.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Facts {
    pub(crate) position: Option<PositionSource>,
    pub(crate) attitude: Option<AttitudeSource>,
    pub(crate) airborne_above_m: Option<f64>,
}

/// Channels by the names of a mapping file, in the log's units, each on its own times; and the times of the
/// rows.
pub(crate) struct Channels {
    rows_s: Vec<f64>,
    series: Vec<Series>,
}

impl Channels {
    /// Channels on the clock of what was measured most often; `otherwise` gives the rows where nothing was.
    pub(crate) fn new(series: Vec<Series>, otherwise: impl FnOnce() -> Vec<f64>) -> Self {
        Self { rows_s: Self::rows(&series).unwrap_or_else(otherwise), series }
    }

    /// The rows: the times at which the vehicle's motion was measured most often, commands aside.
    fn rows(series: &[Series]) -> Option<Vec<f64>> {
        let measures = ["roll", "qw", "gyro_x", "acc_x", "vx", "x"];
        let measured =
            series.iter().filter(|series| measures.contains(&series.name.as_str()) && series.t_s.len() > 1);
        measured.max_by_key(|series| series.t_s.len()).map(|series| series.t_s.clone())
    }

    fn get(&self, name: &str) -> Option<&Series> {
        self.series.iter().find(|series| series.name == name && !series.t_s.is_empty())
    }

    /// A channel at the rows.
    fn at_rows(&self, name: &str, between: Interpolation) -> Option<Vec<f64>> {
        let turn = if name.ends_with("yaw") { TURN_RAD } else { None };
        let series = self.get(name)?;
        Some(if series.t_s == self.rows_s {
            series.values.clone()
        } else {
            series.resample(&self.rows_s, between, turn)
        })
    }

    fn all<const N: usize>(&self, names: [&str; N], between: Interpolation) -> Option<[Vec<f64>; N]> {
        let series: Option<Vec<Vec<f64>>> = names.iter().map(|name| self.at_rows(name, between)).collect();
        series?.try_into().ok()
    }

    /// The flight that they make up.
    pub(crate) fn flight(&self, format: &'static str, facts: &Facts, mut notes: Vec<Note>) -> FlightLog {
        time_gaps(&self.rows_s, &mut notes);
        let resampled: Vec<String> =
            self.series.iter().filter(|s| s.t_s != self.rows_s).map(|s| s.name.clone()).collect();
        if !resampled.is_empty() {
            notes.push(Note::Resampled { channels: resampled });
        }
        let (mut fixes, guessed) = self.fixes(&mut notes);
        let position = facts.position.unwrap_or(guessed);
        let ([roll_rad, pitch_rad, mut yaw_rad], own) = self.attitude(&mut notes);
        unwrap(&mut yaw_rad, "yaw", &mut notes);
        let attitude = if own == AttitudeSource::Imu { facts.attitude.unwrap_or(own) } else { own };
        check_capture(&self.rows_s, &mut fixes, &mut notes);
        let command = |name: &str| self.at_rows(name, Interpolation::Held);
        let motor_pwm = self.all(["motor_1", "motor_2", "motor_3", "motor_4"], Interpolation::Held);
        let onboard = Onboard {
            pos_m: self.all(["estimate_x", "estimate_y", "estimate_z"], Interpolation::Line),
            vel_mps: self.all(["estimate_vx", "estimate_vy", "estimate_vz"], Interpolation::Line),
            rotor_radps: self.all(["rotor_1", "rotor_2", "rotor_3", "rotor_4"], Interpolation::Line),
            motor_pwm,
            cmd_rates_radps: self.all(["cmd_rate_x", "cmd_rate_y", "cmd_rate_z"], Interpolation::Held),
            cmd_torque_nm: self.all(["cmd_torque_x", "cmd_torque_y", "cmd_torque_z"], Interpolation::Held),
            ..Onboard::default()
        };
        let mut log = FlightLog {
            cmd_roll_rad: command("cmd_roll"),
            cmd_pitch_rad: command("cmd_pitch"),
            cmd_yaw_rate_radps: command("cmd_yaw_rate"),
            cmd_thrust_pwm: command("cmd_thrust"),
            cmd_height_m: command("cmd_height"),
            setpoint_m: self.all(["setpoint_x", "setpoint_y", "setpoint_z"], Interpolation::Held),
            setpoint_yaw_rad: command("setpoint_yaw"),
            vel_mps: self.all(["vx", "vy", "vz"], Interpolation::Line),
            gyro_radps: self.all(["gyro_x", "gyro_y", "gyro_z"], Interpolation::Line),
            acc_mps2: self.all(["acc_x", "acc_y", "acc_z"], Interpolation::Line),
            vbat_v: self.at_rows("vbat", Interpolation::Line),
            onboard: (onboard != Onboard::default()).then_some(onboard),
            fixes,
            roll_rad,
            pitch_rad,
            yaw_rad,
            ..FlightLog::empty(Provenance::new(format, position, attitude), self.rows_s.clone())
        };
        match facts.airborne_above_m {
            Some(above_m) => log.find_airborne(above_m),
            None => log.find_airborne_over_rest(None),
        }
        log.with_notes(notes)
    }

    /// Returns the positions as fixes in the rows in which they arrived, and the source inferred from their rate.
    fn fixes(&self, notes: &mut Vec<Note>) -> (Fixes, PositionSource) {
        let [Some(x), Some(y), Some(z)] = ["x", "y", "z"].map(|name| self.get(name)) else {
            return (Fixes::default(), PositionSource::Absent);
        };
        let axes = [x, y, z];
        let pos_m = axes.map(|axis| axis.resample(&x.t_s, Interpolation::Line, None));
        let is_new = |at: &usize| *at == 0 || pos_m.iter().any(|axis| axis[*at] != axis[at - 1]);
        let fresh: Vec<usize> = (0..x.t_s.len()).filter(is_new).collect();
        let share = 1.0 - fresh.len() as f64 / x.t_s.len() as f64;
        let kept = if share > REPEATED_SHARE && fresh.len() > 1 {
            notes.push(Note::RepeatedPositions { share });
            fresh
        } else {
            (0..x.t_s.len()).collect()
        };
        let arrived_s: Vec<f64> = kept.iter().map(|at| x.t_s[*at]).collect();
        let source = PositionSource::of_step(usual_step(&arrived_s));
        let (row, which) = arrivals(&arrived_s, &self.rows_s);
        let pick = |values: &[f64]| which.iter().map(|at| values[kept[*at]]).collect::<Vec<f64>>();
        let captured = self
            .get("capture_time")
            .map_or(x.t_s.clone(), |series| series.resample(&x.t_s, Interpolation::Held, None));
        (
            Fixes {
                row,
                capture_t_s: pick(&captured),
                pos_m: pos_m.each_ref().map(|axis| pick(axis)),
                yaw_rad: None,
            },
            source,
        )
    }

    /// Roll, pitch and yaw by the best of what is there: angles, a quaternion, the gyro, or the acceleration
    /// of the motion.
    fn attitude(&self, notes: &mut Vec<Note>) -> ([Vec<f64>; 3], AttitudeSource) {
        let yaw = self.at_rows("yaw", Interpolation::Line);
        let heading = || yaw.clone().unwrap_or_else(|| vec![0.0; self.rows_s.len()]);
        if let Some([roll, pitch]) = self.all(["roll", "pitch"], Interpolation::Line) {
            if yaw.is_none() {
                notes.push(Note::TiltFromAcceleration { roll: false, pitch: false, yaw_taken_as_zero: true });
            }
            return ([roll, pitch, heading()], AttitudeSource::Imu);
        }
        if let Some(angles) = self.quaternion(notes) {
            return (angles, AttitudeSource::Imu);
        }
        if let Some(gyro) = self.all(["gyro_x", "gyro_y", "gyro_z"], Interpolation::Line) {
            notes.push(Note::AttitudeIntegrated { bias_radps: Some([0.0; 3]), at_rest: false });
            return (integrate(&self.rows_s, &gyro, |_| None), AttitudeSource::Imu);
        }
        let zero = vec![0.0; self.rows_s.len()];
        let pos_m = self
            .all(["x", "y", "z"], Interpolation::Line)
            .unwrap_or_else(|| [zero.clone(), zero.clone(), zero]);
        let in_g =
            acceleration_of(&self.rows_s, &pos_m).map(|axis| axis.into_iter().map(|a| a / G_MPS2).collect());
        let [roll, pitch] = tilt(&self.rows_s, &in_g, &heading());
        notes.push(Note::TiltFromAcceleration { roll: true, pitch: true, yaw_taken_as_zero: yaw.is_none() });
        ([roll, pitch, heading()], AttitudeSource::Motion)
    }

    /// Returns the angles of a quaternion, unless a part of the rows is no rotation.
    fn quaternion(&self, notes: &mut Vec<Note>) -> Option<[Vec<f64>; 3]> {
        let names = ["qx", "qy", "qz", "qw"];
        let [x, y, z, w] = names.map(|name| self.get(name));
        let (x, y, z, w) = (x?, y?, z?, w?);
        // Half-way between two quaternions is no rotation: the last one holds.
        let held = [x, y, z, w].map(|part| part.resample(&self.rows_s, Interpolation::Held, None));
        let angles = Rotation::angles_of_columns(&held);
        if angles.is_none() {
            notes.push(Note::OddValues { name: "quaternion".to_owned(), count: self.rows_s.len() });
        }
        angles
    }
}
