//! The variables of the Crazyflie's firmware as a flight, whatever recorded them: the micro-SD deck, cfclient
//! or cflib.
//!
//! A file has the variables that the user chose: all that are there are used. Without a position from outside,
//! position and velocity are the vehicle's estimate. In the firmware, pitch and its rate are inverted, see
//! [`Variables::attitude`].

use super::attitude::{Rotation, integrate, tilt};
use super::series::{Interpolation, Series};
use super::signal::{acceleration_of, time_gaps, unwrap};
use super::usd::Event;
use super::variables::{GROUPS, Group, Role, group_of, is_used, role};
use super::{
    AttitudeSource, Fixes, FlightLog, G_MPS2, LogError, Note, Onboard, PositionSource, Provenance, Result,
};

/// A position from outside that never changes is none.
const LEAST_FIXES: usize = 5;
/// Estimates of vehicles at rest drift by up to 0.1 m.
const AIRBORNE_M: f64 = 0.15;
/// A vehicle on the ground with its motors off turns no faster than the gyro's noise.
const AT_REST_RADPS: f64 = 0.05;
/// Beyond this no variable makes sense.
const LARGEST: f64 = 1e12;

/// A flight out of the firmware's variables; `format` is the name of the reader.
pub(super) fn flight(format: &'static str, variables: &Variables, mut notes: Vec<Note>) -> Result<FlightLog> {
    let t_s = &variables.t_s;
    time_gaps(t_s, &mut notes);
    let onboard = variables.onboard();
    let ([roll_rad, pitch_rad, mut yaw_rad], attitude) = variables.attitude(&onboard, &mut notes)?;
    unwrap(&mut yaw_rad, "onboard yaw", &mut notes);
    let (fixes, position) = variables.fixes(&onboard, &mut notes);
    let [cmd_roll_rad, cmd_pitch_rad] = variables.wanted_tilt(&yaw_rad);
    // without a yaw-rate command: the attitude loop's rate is none of the pilot's, and contains a trim that the rate
    // loop works off for seconds
    let mut log = FlightLog {
        cmd_roll_rad,
        cmd_pitch_rad,
        cmd_thrust_pwm: variables.thrust(&onboard, &mut notes)?,
        setpoint_m: variables.get(role::SETPOINT),
        setpoint_yaw_rad: variables.single(role::WANTED_YAW),
        fixes,
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: variables.get(role::BODY_RATES),
        acc_mps2: variables.get(role::SPECIFIC_FORCE),
        vbat_v: variables.single(role::VOLTAGE),
        onboard: Some(onboard),
        ..FlightLog::empty(Provenance::new(format, position, attitude), t_s.clone())
    };
    notes.push(Note::NoYawRateCommand);
    log.find_flight(&mut notes);
    log.notes = notes;
    Ok(log)
}

impl FlightLog {
    /// Finds the flight, and whether the vehicle lies on its back.
    fn find_flight(&mut self, notes: &mut Vec<Note>) {
        self.find_airborne_over_rest(Some(AIRBORNE_M));
        notes.append(&mut self.notes);
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
    pub(super) fn from_events(file: &str, events: Vec<Event>, notes: &mut Vec<Note>) -> Result<Self> {
        let mut events: Vec<Event> = events.into_iter().filter(|event| !event.t_s.is_empty()).collect();
        // A stable sort: of equals, the last one counts.
        events.sort_by_key(|event| event.t_s.len() * event.variables.len());
        events.reverse();
        let mut series: Vec<Series> = Vec::new();
        let mut rows_s = Vec::new();
        let names = events.iter().flat_map(|event| &event.variables);
        let unused: Vec<String> = names.filter(|name| !is_used(name)).cloned().collect();
        if !unused.is_empty() {
            notes.push(Note::IgnoredColumns { columns: unused });
        }
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

    /// Brings series with times of their own to the times of the rows: commands are repeated, measurements
    /// interpolated.
    pub(super) fn on_rows(
        file: &str,
        rows_s: &[f64],
        series: Vec<Series>,
        notes: &mut Vec<Note>,
    ) -> Result<Self> {
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
                let of = group_of(&series.name);
                let is_held = of.is_some_and(|(group, _)| group.is_held());
                let hold = if is_held { Interpolation::Held } else { Interpolation::Line };
                series.resample(rows_s, hold, of.and_then(|(group, at)| group.turn(at)))
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

    /// The first group of a role that is there as a whole, in the log's units and frame.
    fn get<const N: usize>(&self, role: Role) -> Option<[Vec<f64>; N]> {
        let scaled = |group: &Group| {
            let columns: Option<Vec<&[f64]>> = group.names().map(|name| self.column(&name)).collect();
            let in_log = |(at, values): (usize, &[f64])| {
                values.iter().map(|value| value * group.factor(at)).collect::<Vec<f64>>()
            };
            columns?.into_iter().enumerate().map(in_log).collect::<Vec<_>>().try_into().ok()
        };
        GROUPS.iter().filter(|group| group.role == role).find_map(scaled)
    }

    fn single(&self, role: Role) -> Option<Vec<f64>> {
        self.get(role).map(|[values]| values)
    }

    /// The first variable of a role.
    fn name_of(&self, role: Role) -> String {
        let mut names =
            GROUPS.iter().filter(|group| group.role == role).flat_map(|group| group.names().take(1));
        names.find(|name| self.column(name).is_some()).unwrap_or_default()
    }

    /// One variable of the first group of a role that has it, where others of the group are missing.
    fn part(&self, role: Role, at: usize) -> Option<Vec<f64>> {
        let scaled = |group: &Group| {
            let values = self.column(&group.names().nth(at)?)?;
            Some(values.iter().map(|value| value * group.factor(at)).collect())
        };
        GROUPS.iter().filter(|group| group.role == role).find_map(scaled)
    }

    /// Roll and pitch commands: logged, or those that turn the thrust into the wanted direction.
    fn wanted_tilt(&self, yaw_rad: &[f64]) -> [Option<Vec<f64>>; 2] {
        let logged = [0, 1].map(|at| self.part(role::WANTED_ANGLES, at));
        let Some([x, y, z]) = self.get::<3>(role::WANTED_AXIS).filter(|_| logged.iter().all(Option::is_none))
        else {
            return logged;
        };
        let tilt = |row: usize| {
            let (sin, cos) = yaw_rad[row].sin_cos();
            let (forward, left) = (x[row] * cos + y[row] * sin, y[row] * cos - x[row] * sin);
            [(-left).atan2(forward.hypot(z[row])), forward.atan2(z[row])]
        };
        [0, 1].map(|at| Some((0..yaw_rad.len()).map(|row| tilt(row)[at]).collect()))
    }

    /// Fixes from outside, where they were logged; else the estimate.
    fn fixes(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> (Fixes, PositionSource) {
        let outside = self.get(role::OUTSIDE_POSITION).map(|pos_m| self.new_fixes(&pos_m));
        if let Some(fixes) = outside.filter(|fixes| fixes.row.len() >= LEAST_FIXES) {
            return (fixes, PositionSource::MotionCapture);
        }
        let Some(pos_m) = onboard.pos_m.clone() else { return (Fixes::default(), PositionSource::Absent) };
        notes.push(Note::PositionEstimated);
        (Fixes::in_every_row(&self.t_s, pos_m), PositionSource::Estimate)
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

    fn onboard(&self) -> Onboard {
        let pwm = self.get(role::MOTOR_PWM);
        let motors = self.get(role::MOTORS);
        // Newer firmware logs in `motor` what the motors get; only beside `pwm` it is known to be the
        // request.
        let requests = self
            .get(role::MOTOR_REQUEST)
            .or_else(|| pwm.as_ref().and(motors.clone()))
            .or_else(|| self.get(role::MIXER_INPUTS).map(mix_motors));
        Onboard {
            pos_m: self.get(role::POSITION),
            vel_mps: self.get(role::VELOCITY),
            attitude_rad: self.get(role::ANGLES),
            motor_pwm: pwm.or(motors),
            rotor_radps: self.get(role::ROTOR_SPEED),
            setpoint_yaw_rate_radps: None,
            cmd_rates_radps: self.get(role::WANTED_RATES),
            cmd_torque_nm: self.get(role::WANTED_TORQUE),
            motor_request_pwm: requests,
            acc_world_mps2: self.get(role::WORLD_ACCELERATION),
            acc_z_mps2: self.single(role::SPECIFIC_FORCE_UP),
            late_s: None,
        }
    }

    /// The thrust command: logged, or the mean of the motors' requests, from which the mixer's moments
    /// cancel.
    fn thrust(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> Result<Option<Vec<f64>>> {
        if let Some(thrust) = self.single(role::THRUST_PWM) {
            let Some(row) = thrust.iter().position(|pwm| !(0.0..=65_535.0).contains(pwm)) else {
                return Ok(Some(thrust));
            };
            let (file, name, pwm) = (&self.file, self.name_of(role::THRUST_PWM), thrust[row]);
            return Err(LogError::Unusable(format!(
                "{file}, \"{name}\", record {row}: found {pwm}, expected a PWM command from 0 to 65535"
            )));
        }
        if let Some(force_n) = self.single(role::THRUST_FORCE) {
            notes.push(Note::ScaledToPwm { channel: "thrust command".to_owned(), unit: "N".to_owned() });
            return Ok(Some(force_n.into_iter().map(pwm_of_force).collect()));
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
    fn attitude(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> Result<([Vec<f64>; 3], AttitudeSource)> {
        if let Some(angles) = onboard.attitude_rad.clone() {
            return Ok((angles, AttitudeSource::Imu));
        }
        if let Some(quaternion) = self.get(role::QUATERNION)
            && let Some(angles) = Rotation::angles_of_columns(&quaternion)
        {
            return Ok((angles, AttitudeSource::Imu));
        }
        let [roll, pitch, yaw] = [0, 1, 2].map(|axis| self.part(role::ANGLES, axis));
        if let Some(gyro) = self.get(role::BODY_RATES) {
            notes.push(Note::AttitudeIntegrated { bias_radps: None, at_rest: true });
            return Ok((integrate(&self.t_s, &gyro, |row| self.at_rest(&gyro, row)), AttitudeSource::Imu));
        }
        let moved = || Some(acceleration_of(&self.t_s, onboard.pos_m.as_ref()?));
        let Some(acc_mps2) = onboard.acc_world_mps2.clone().or_else(moved) else {
            let missing = "attitude, gyro, acceleration or position; cfclient writes one file per log block: name all files of the flight \
                           (a.csv+b.csv) or their folder";
            return Err(LogError::MissingSignals { file: self.file.clone(), missing, found: self.names() });
        };
        let heading = yaw.clone().unwrap_or_else(|| vec![0.0; self.t_s.len()]);
        let acc = acc_mps2.map(|axis| axis.into_iter().map(|a| a / G_MPS2).collect());
        let [derived_roll, derived_pitch] = tilt(&self.t_s, &acc, &heading);
        notes.push(Note::TiltFromAcceleration {
            roll: roll.is_none(),
            pitch: pitch.is_none(),
            yaw_taken_as_zero: yaw.is_none(),
        });
        let source =
            if roll.is_none() || pitch.is_none() { AttitudeSource::Motion } else { AttitudeSource::Imu };
        Ok(([roll.unwrap_or(derived_roll), pitch.unwrap_or(derived_pitch), heading], source))
    }

    /// Returns the attitude of a vehicle at rest: level, and with motors off the yaw setpoint follows the estimate.
    fn at_rest(&self, gyro: &[Vec<f64>; 3], row: usize) -> Option<[f64; 3]> {
        let off = self.column("controller.cmd_thrust")?[row] == 0.0;
        let still = gyro.iter().all(|g| g[row].abs() < AT_REST_RADPS);
        let upright = self.column("controller.accelz").is_none_or(|acc| acc[row] > 0.9);
        let yaw = self.column("controller.yaw").map_or(0.0, |yaw| yaw[row].to_radians());
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
        notes.push(Note::OddValues { name: event.name.clone(), count: odd });
    }
    if late > 0 {
        notes.push(Note::StampsOutOfOrder { name: event.name.clone(), count: late });
    }
}

/// Coefficients of the firmware's curve of a motor's force over its share of PWM, N (`quadSysId` of the
/// Crazyflie 2.x: `pwmToThrustA` and `pwmToThrustB`).
const FORCE_SQUARE_N: f64 = 0.091_492_681;
const FORCE_LINE_N: f64 = 0.067_673_604;

/// The PWM that the firmware gives four motors for a force together.
pub(super) fn pwm_of_force(force_n: f64) -> f64 {
    let of_one_n = (force_n / 4.0).max(0.0);
    let root = (FORCE_LINE_N * FORCE_LINE_N + 4.0 * FORCE_SQUARE_N * of_one_n).sqrt();
    (65_535.0 * (root - FORCE_LINE_N) / (2.0 * FORCE_SQUARE_N)).clamp(0.0, 65_535.0)
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
