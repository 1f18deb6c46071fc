//! The variables of the Crazyflie's firmware as a flight, whatever recorded them: the micro-SD deck, cfclient
//! or cflib.
//!
//! Which variables a file holds is up to whoever flew: what is there is used. Without a position from
//! outside, position and velocity are the vehicle's estimate. In the firmware, pitch and its rate are
//! inverted, see [`Variables::attitude`].

use super::attitude::{integrate, tilt};
use super::series::{Interpolation, Series};
use super::signal::{acceleration_of, height_by_row, longest_above, radians, time_gaps, unwrap};
use super::usd::Event;
use super::{AttitudeSource, Fixes, FlightLog, LogError, Note, Onboard, PositionSource, Provenance};

const G_MPS2: f64 = 9.80665;
const MOTOR: [&str; 4] = ["motor.m1", "motor.m2", "motor.m3", "motor.m4"];
const MOTOR_PWM: [&str; 4] = ["pwm.m1_pwm", "pwm.m2_pwm", "pwm.m3_pwm", "pwm.m4_pwm"];
/// With their unit in metres; the compressed estimate is in millimetres.
const POSITION: [([&str; 3], f64); 3] = [
    (["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"], 1.0),
    (["stateEstimateZ.x", "stateEstimateZ.y", "stateEstimateZ.z"], 1e-3),
    (["kalman.stateX", "kalman.stateY", "kalman.stateZ"], 1.0),
];
const VELOCITY: [([&str; 3], f64); 2] = [
    (["stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz"], 1.0),
    (["stateEstimateZ.vx", "stateEstimateZ.vy", "stateEstimateZ.vz"], 1e-3),
];
/// In multiples of g; the compressed one in mm/s2.
const ACCELERATION: [([&str; 3], f64); 2] = [
    (["stateEstimate.ax", "stateEstimate.ay", "stateEstimate.az"], 1.0),
    (["stateEstimateZ.ax", "stateEstimateZ.ay", "stateEstimateZ.az"], 1e-3 / G_MPS2),
];
/// Positions that a system outside sent to the vehicle.
const OUTSIDE: [[&str; 3]; 2] =
    [["locSrv.x", "locSrv.y", "locSrv.z"], ["lighthouse.x", "lighthouse.y", "lighthouse.z"]];
const ANGLES: [[&str; 3]; 2] = [
    ["stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw"],
    ["stabilizer.roll", "stabilizer.pitch", "stabilizer.yaw"],
];
const CONTROL: [&str; 4] =
    ["controller.cmd_thrust", "controller.cmd_roll", "controller.cmd_pitch", "controller.cmd_yaw"];
const RATES: [&str; 3] = ["controller.r_roll", "controller.r_pitch", "controller.r_yaw"];
const WANTED_RATES: [&str; 3] = ["controller.rollRate", "controller.pitchRate", "controller.yawRate"];
const GYRO: [&str; 3] = ["gyro.x", "gyro.y", "gyro.z"];
const FORCE: [&str; 3] = ["acc.x", "acc.y", "acc.z"];
const FORCE_Z: &str = "controller.accelz";
/// Commands of the attitude loop; the set-point has them where the pilot commands angles.
const WANTED_ANGLES: [[&str; 2]; 2] =
    [["controller.roll", "controller.pitch"], ["ctrltarget.roll", "ctrltarget.pitch"]];
const SETPOINT: [[&str; 3]; 2] = [
    ["ctrltarget.x", "ctrltarget.y", "ctrltarget.z"],
    ["posCtl.targetX", "posCtl.targetY", "posCtl.targetZ"],
];
/// The thrust command, 16 bits wide.
pub(super) const PWM_VARIABLES: [&str; 2] = [CONTROL[0], "stabilizer.thrust"];
const VBAT: [&str; 2] = ["pm.vbat", "pm.vbatMV"];
const YAW_SETPOINT: &str = "controller.yaw";
/// A position from outside that never changes is none.
const LEAST_FIXES: usize = 5;
/// Estimates of vehicles that stand wander by up to 0.1 m.
const AIRBORNE_M: f64 = 0.15;
/// A vehicle on the ground with its motors off turns no faster than the gyro's noise.
const AT_REST_RADPS: f64 = 0.05;
/// Beyond this no variable makes sense.
const LARGEST: f64 = 1e12;

/// A flight out of the firmware's variables; `format` is the name of the reader.
pub(super) fn flight(
    format: &'static str,
    variables: &Variables,
    mut notes: Vec<Note>,
) -> Result<FlightLog, LogError> {
    let t_s = &variables.t_s;
    time_gaps(t_s, &mut notes);
    let onboard = variables.onboard();
    let ([roll_rad, pitch_rad, mut yaw_rad], attitude) = variables.attitude(&onboard, &mut notes)?;
    unwrap(&mut yaw_rad, "onboard yaw", &mut notes);
    let (fixes, position) = variables.fixes(&onboard, &mut notes);
    let mut log = FlightLog {
        provenance: Provenance { format, position, attitude, onboard_interpolated: false },
        airborne: 0..0,
        cmd_roll_rad: variables
            .first(&WANTED_ANGLES.map(|[roll, _]| ([roll], 1.0)))
            .map(|[roll]| radians(roll)),
        cmd_pitch_rad: variables
            .first(&WANTED_ANGLES.map(|[_, pitch]| ([pitch], 1.0)))
            .map(|[pitch]| negate(radians(pitch))),
        // The attitude loop's rate is no command of the pilot, and holds a trim that the rate loop works off
        // for seconds.
        cmd_yaw_rate_radps: None,
        cmd_thrust_pwm: variables.thrust(&onboard, &mut notes)?,
        cmd_height_m: None,
        setpoint_m: variables.first(&SETPOINT.map(|names| (names, 1.0))),
        setpoint_yaw_rad: variables.radians(YAW_SETPOINT),
        fixes,
        vel_mps: None,
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: variables.gyro(),
        acc_mps2: variables.all(FORCE).map(in_mps2),
        vbat_v: variables.vbat(),
        onboard: Some(onboard),
        truth: None,
        t_s: t_s.clone(),
        notes: Vec::new(),
    };
    notes.push(Note::NoYawRateCommand);
    log.find_flight(&mut notes);
    log.notes = notes;
    Ok(log)
}

impl FlightLog {
    /// Airborne: above the ground with the motors on, since the estimated height of a vehicle that stands may
    /// be anything.
    fn find_flight(&mut self, notes: &mut Vec<Note>) {
        let Some(z) = height_by_row(self.len(), &self.fixes) else {
            notes.push(Note::NoPosition);
            return;
        };
        let thrust = self.cmd_thrust_pwm.as_ref();
        let is_on = |row: usize| thrust.is_none_or(|thrust| thrust[row] > 0.0);
        let height: Vec<f64> =
            z.iter().enumerate().map(|(row, z)| if is_on(row) { *z } else { 0.0 }).collect();
        self.airborne = longest_above(&self.t_s, &height, AIRBORNE_M);
        if self.airborne.is_empty() {
            notes.push(Note::NeverAirborne { above_m: AIRBORNE_M });
        }
        let level = |row: &usize| {
            self.onboard.as_ref().and_then(|o| o.acc_z_mps2.as_ref()).is_none_or(|acc| acc[*row] > 0.0)
        };
        let fallen = (0..self.len()).filter(|row| !level(row)).count();
        if fallen as f64 > FALLEN_SHARE * self.len() as f64 {
            notes.push(Note::UpsideDown { share: fallen as f64 / self.len() as f64 });
        }
    }
}

/// In free fall the accelerometer reads zero; only a vehicle on its back reads below that for long.
const FALLEN_SHARE: f64 = 0.02;

/// The firmware's variables on one clock, unit as logged.
pub(super) struct Variables {
    file: String,
    /// Names and values, one per row.
    columns: Vec<(String, Vec<f64>)>,
    /// From the first row.
    t_s: Vec<f64>,
}

impl Variables {
    /// The variables of all events on the clock of the one with the most values.
    pub(super) fn from_events(
        file: &str,
        events: Vec<Event>,
        notes: &mut Vec<Note>,
    ) -> Result<Self, LogError> {
        let mut events: Vec<Event> = events.into_iter().filter(|event| !event.t_s.is_empty()).collect();
        // A stable sort: of equals, the last one counts.
        events.sort_by_key(|event| event.t_s.len() * event.variables.len());
        events.reverse();
        let mut series: Vec<Series> = Vec::new();
        let mut rows_s = Vec::new();
        for (at, mut event) in events.into_iter().enumerate() {
            drop_odd_rows(&mut event, notes);
            if at == 0 {
                rows_s.clone_from(&event.t_s);
            }
            let columns = event.variables.into_iter().zip(event.columns);
            let fresh = columns.filter(|(name, _)| {
                at == 0 || (is_used(name) && !series.iter().any(|known| known.name == *name))
            });
            let fresh: Vec<Series> =
                fresh.map(|(name, values)| Series { name, t_s: event.t_s.clone(), values }).collect();
            series.extend(fresh);
        }
        Self::on_rows(file, &rows_s, series, notes)
    }

    /// Series of times of their own, brought to the times of the rows: commands are held, measurements
    /// interpolated.
    pub(super) fn on_rows(
        file: &str,
        rows_s: &[f64],
        series: Vec<Series>,
        notes: &mut Vec<Note>,
    ) -> Result<Self, LogError> {
        let Some(start_s) = rows_s.first().copied() else {
            return Err(LogError::NoRows { file: file.to_owned() });
        };
        notes.push(Note::TimeShifted { start_s });
        let mut resampled = Vec::new();
        let mut columns = Vec::new();
        for series in series.into_iter().filter(|series| !series.t_s.is_empty()) {
            let values = if series.t_s == rows_s {
                series.values
            } else {
                resampled.push(series.name.clone());
                let hold = if is_command(&series.name) { Interpolation::Held } else { Interpolation::Line };
                series.resample(rows_s, hold, series.name.ends_with("yaw").then_some(360.0))
            };
            columns.push((series.name, values));
        }
        if !resampled.is_empty() {
            notes.push(Note::Resampled { channels: resampled });
        }
        Ok(Self { file: file.to_owned(), columns, t_s: rows_s.iter().map(|t| t - start_s).collect() })
    }

    fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(known, _)| known == name).map(|(_, values)| values.as_slice())
    }

    fn names(&self) -> String {
        self.columns.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ")
    }

    fn get(&self, name: &str) -> Option<Vec<f64>> {
        self.column(name).map(<[f64]>::to_vec)
    }

    fn radians(&self, name: &str) -> Option<Vec<f64>> {
        self.get(name).map(radians)
    }

    /// All of several variables, or `None` if one is missing.
    fn all<const N: usize>(&self, names: [&str; N]) -> Option<[Vec<f64>; N]> {
        let found: Option<Vec<_>> = names.iter().map(|name| self.get(name)).collect();
        found?.try_into().ok()
    }

    /// The first of several groups of variables that is there as a whole, times its factor.
    fn first<const N: usize>(&self, groups: &[([&str; N], f64)]) -> Option<[Vec<f64>; N]> {
        let scaled = |(names, factor): &([&str; N], f64)| {
            let values = self.all(*names)?;
            Some(values.map(|values| values.into_iter().map(|v| v * factor).collect::<Vec<f64>>()))
        };
        groups.iter().find_map(scaled)
    }

    /// Fixes from outside, where they were logged; else the estimate.
    fn fixes(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> (Fixes, PositionSource) {
        if let Some(fixes) = self
            .first(&OUTSIDE.map(|names| (names, 1.0)))
            .map(|pos_m| self.new_fixes(&pos_m))
            .filter(|f| f.row.len() >= LEAST_FIXES)
        {
            return (fixes, PositionSource::MotionCapture);
        }
        let Some(pos_m) = onboard.pos_m.clone() else { return (Fixes::default(), PositionSource::Absent) };
        notes.push(Note::PositionEstimated);
        let fixes =
            Fixes { row: (0..self.t_s.len()).collect(), capture_t_s: self.t_s.clone(), pos_m, yaw_rad: None };
        (fixes, PositionSource::Estimate)
    }

    /// The variable repeats the last position that arrived: a new one is one that differs.
    fn new_fixes(&self, pos_m: &[Vec<f64>; 3]) -> Fixes {
        let is_new = |row: &usize| *row == 0 || pos_m.iter().any(|axis| axis[*row] != axis[row - 1]);
        let row: Vec<usize> = (0..self.t_s.len()).filter(is_new).collect();
        let pick = |values: &[f64]| row.iter().map(|at| values[*at]).collect::<Vec<f64>>();
        Fixes {
            capture_t_s: pick(&self.t_s),
            pos_m: pos_m.each_ref().map(|axis| pick(axis)),
            yaw_rad: None,
            row: row.clone(),
        }
    }

    /// Body rates, right-handed. The controller's are those of the gyro with pitch inverted.
    fn gyro(&self) -> Option<[Vec<f64>; 3]> {
        let own = self.all(GYRO).map(|rates| rates.map(radians));
        own.or_else(|| self.all(RATES).map(|[roll, pitch, yaw]| [roll, negate(pitch), yaw]))
    }

    fn vbat(&self) -> Option<Vec<f64>> {
        let from_mv = |mv: Vec<f64>| mv.into_iter().map(|v| v * 1e-3).collect();
        self.get(VBAT[0]).or_else(|| self.get(VBAT[1]).map(from_mv))
    }

    fn onboard(&self) -> Onboard {
        let angles = self
            .first(&ANGLES.map(|names| (names, 1.0)))
            .map(|[roll, pitch, yaw]| [radians(roll), negate(radians(pitch)), radians(yaw)]);
        let pwm = self.all(MOTOR_PWM);
        // Newer firmware logs in `motor` what the motors get; only beside `pwm` it is known to be the
        // request.
        let requests =
            pwm.as_ref().and_then(|_| self.all(MOTOR)).or_else(|| self.all(CONTROL).map(mix_motors));
        Onboard {
            pos_m: self.first(&POSITION),
            vel_mps: self.first(&VELOCITY),
            attitude_rad: angles,
            motor_pwm: pwm.or_else(|| self.all(MOTOR)),
            rotor_radps: None,
            setpoint_yaw_rate_radps: None,
            cmd_rates_radps: self
                .all(WANTED_RATES)
                .map(|[roll, pitch, yaw]| [radians(roll), negate(radians(pitch)), radians(yaw)]),
            motor_request_pwm: requests,
            acc_world_mps2: self.first(&ACCELERATION).map(in_mps2),
            acc_z_mps2: self
                .get(FORCE_Z)
                .or_else(|| self.get(FORCE[2]))
                .map(|acc| in_mps2([acc]))
                .map(|[acc]| acc),
            late_s: None,
        }
    }

    /// The thrust command: logged, or the mean of the motors' requests, from which the mixer's moments
    /// cancel.
    fn thrust(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> Result<Option<Vec<f64>>, LogError> {
        for name in PWM_VARIABLES {
            if let Some(thrust) = self.get(name) {
                let expected = "a PWM command from 0 to 65535";
                let bad = thrust.iter().position(|pwm| !(0.0..=65_535.0).contains(pwm));
                return match bad {
                    None => Ok(Some(thrust)),
                    Some(row) => Err(LogError::BadRecord {
                        file: self.file.clone(),
                        source_name: name.to_owned(),
                        index: row,
                        value: thrust[row].to_string(),
                        expected,
                    }),
                };
            }
        }
        let Some(requests) = &onboard.motor_request_pwm else { return Ok(None) };
        notes.push(Note::ThrustFromMotors);
        Ok(Some(
            (0..self.t_s.len())
                .map(|row| requests.iter().map(|m| m[row].clamp(0.0, 65_535.0)).sum::<f64>() / 4.0)
                .collect(),
        ))
    }

    /// The estimated attitude; what of it is not logged is derived. Positive pitch of the firmware lifts the
    /// nose.
    fn attitude(
        &self,
        onboard: &Onboard,
        notes: &mut Vec<Note>,
    ) -> Result<([Vec<f64>; 3], AttitudeSource), LogError> {
        let whole = ANGLES.into_iter().find(|names| self.all(*names).is_some());
        if let Some((names, angles)) = whole.zip(onboard.attitude_rad.clone()) {
            notes.push(Note::Negated {
                columns: if names == ANGLES[0] { &["stateEstimate.pitch"] } else { &["stabilizer.pitch"] },
            });
            return Ok((angles, AttitudeSource::Imu));
        }
        let [roll, pitch, yaw] = [0, 1, 2]
            .map(|axis| self.first(&ANGLES.map(|names| ([names[axis]], 1.0))).map(|[angle]| radians(angle)));
        if let Some(gyro) = self.gyro() {
            notes.push(Note::AttitudeIntegrated { bias_radps: None, at_rest: true });
            return Ok((integrate(&self.t_s, &gyro, |row| self.at_rest(&gyro, row)), AttitudeSource::Imu));
        }
        let moved = || {
            onboard.pos_m.as_ref().map(|pos| {
                acceleration_of(&self.t_s, pos).map(|axis| axis.into_iter().map(|a| a / G_MPS2).collect())
            })
        };
        let Some(acc) = self.first(&ACCELERATION).or_else(moved) else {
            let missing = "attitude (stateEstimate or stabilizer roll, pitch, yaw), gyro (gyro or controller.r_*), acceleration \
                           (stateEstimate.ax, ay, az) or position (stateEstimate.x, y, z)";
            return Err(LogError::MissingSignals { file: self.file.clone(), missing, found: self.names() });
        };
        let heading = yaw.clone().unwrap_or_else(|| vec![0.0; self.t_s.len()]);
        let [derived_roll, derived_pitch] = tilt(&self.t_s, &acc, &heading);
        notes.push(Note::TiltFromAcceleration {
            roll: roll.is_none(),
            pitch: pitch.is_none(),
            yaw_taken_as_zero: yaw.is_none(),
        });
        let source =
            if roll.is_none() || pitch.is_none() { AttitudeSource::Motion } else { AttitudeSource::Imu };
        Ok(([roll.unwrap_or(derived_roll), pitch.map_or(derived_pitch, negate), heading], source))
    }

    /// The attitude of a vehicle that stands: level, and with motors off the yaw setpoint follows the
    /// estimate.
    fn at_rest(&self, gyro: &[Vec<f64>; 3], row: usize) -> Option<[f64; 3]> {
        let off = self.column(CONTROL[0])?[row] == 0.0;
        let still = gyro.iter().all(|g| g[row].abs() < AT_REST_RADPS);
        let upright = self.column(FORCE_Z).is_none_or(|acc| acc[row] > 0.9);
        let yaw = self.column(YAW_SETPOINT).map_or(0.0, |yaw| yaw[row].to_radians());
        (off && still && upright).then_some([0.0, 0.0, yaw])
    }
}

/// Drops rows whose time does not increase and rows with values that are not finite.
fn drop_odd_rows(event: &mut Event, notes: &mut Vec<Note>) {
    let (mut late, mut odd) = (0, 0);
    let mut previous_s = f64::NEG_INFINITY;
    let mut keep = Vec::new();
    let named = event.variables.iter().zip(&event.columns);
    let used: Vec<&Vec<f64>> = named.filter(|(name, _)| is_used(name)).map(|(_, column)| column).collect();
    for (row, t_s) in event.t_s.iter().enumerate() {
        let sound = used.iter().all(|column| column[row].abs() <= LARGEST) && *t_s <= LARGEST;
        let ordered = *t_s > previous_s;
        odd += usize::from(!sound);
        late += usize::from(sound && !ordered);
        keep.push(sound && ordered);
        if sound && ordered {
            previous_s = *t_s;
        }
    }
    for column in event.columns.iter_mut().chain([&mut event.t_s]) {
        let mut kept = keep.iter();
        column.retain(|_| kept.next() == Some(&true));
    }
    if odd > 0 {
        notes.push(Note::OddValues { source: event.name.clone(), count: odd });
    }
    if late > 0 {
        notes.push(Note::StampsOutOfOrder { source: event.name.clone(), count: late });
    }
}

/// Whether a variable is a command or set-point, which holds until the next.
fn is_command(name: &str) -> bool {
    let fours = [MOTOR, MOTOR_PWM, CONTROL];
    let threes = SETPOINT.concat().contains(&name) || WANTED_RATES.contains(&name);
    threes
        || fours.concat().contains(&name)
        || WANTED_ANGLES.concat().contains(&name)
        || PWM_VARIABLES.contains(&name)
        || name == YAW_SETPOINT
}

/// Whether a variable has a place in a flight. Others may hold anything.
pub(super) fn is_used(name: &str) -> bool {
    let measured = [RATES, GYRO, FORCE].concat();
    let estimated =
        POSITION.iter().chain(&VELOCITY).chain(&ACCELERATION).any(|(names, _)| names.contains(&name));
    is_command(name)
        || measured.contains(&name)
        || estimated
        || ANGLES.concat().contains(&name)
        || OUTSIDE.concat().contains(&name)
        || name == FORCE_Z
        || VBAT.contains(&name)
}

/// Outputs of the mixer to the four motors, before limits: thrust, and moments about roll, pitch (firmware)
/// and yaw.
fn mix_motors([thrust, roll, pitch, yaw]: [Vec<f64>; 4]) -> [Vec<f64>; 4] {
    let motor_pwm = |signs: [f64; 3]| {
        let motor = |row: usize| {
            thrust[row] + signs[0] * roll[row] / 2.0 + signs[1] * pitch[row] / 2.0 + signs[2] * yaw[row]
        };
        (0..thrust.len()).map(motor).map(|pwm| pwm.clamp(0.0, 65_535.0)).collect()
    };
    [
        motor_pwm([-1.0, 1.0, 1.0]),
        motor_pwm([-1.0, -1.0, -1.0]),
        motor_pwm([1.0, -1.0, 1.0]),
        motor_pwm([1.0, 1.0, -1.0]),
    ]
}

fn in_mps2<const N: usize>(acc: [Vec<f64>; N]) -> [Vec<f64>; N] {
    acc.map(|axis| axis.into_iter().map(|g| g * G_MPS2).collect())
}

fn negate(values: Vec<f64>) -> Vec<f64> {
    values.into_iter().map(|v| -v).collect()
}
