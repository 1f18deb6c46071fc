//! The Crazyflie's own variables, as its micro-SD deck logs them, as a flight.
//!
//! Which variables a file holds is up to whoever flew: what is there is used. No outside measurement is: position and
//! velocity are the vehicle's estimate. In the firmware, pitch and its rate are inverted, see [`Variables::attitude`].

use super::attitude::integrate;
use super::signal::{centred_mean, longest_above, radians, time_gaps, unwrap};
use super::usd::{self, Event};
use super::{Fixes, FlightLog, Format, LogError, Note, Onboard};

const G_MPS2: f64 = 9.80665;
const MOTOR: [&str; 4] = ["motor.m1", "motor.m2", "motor.m3", "motor.m4"];
const MOTOR_PWM: [&str; 4] = ["pwm.m1_pwm", "pwm.m2_pwm", "pwm.m3_pwm", "pwm.m4_pwm"];
const POSITION: [&str; 3] = ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"];
const VELOCITY: [&str; 3] = ["stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz"];
const ACCELERATION: [&str; 3] = ["stateEstimate.ax", "stateEstimate.ay", "stateEstimate.az"];
const ANGLES: [&str; 3] = ["stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw"];
const CONTROL: [&str; 4] = ["controller.cmd_thrust", "controller.cmd_roll", "controller.cmd_pitch", "controller.cmd_yaw"];
const RATES: [&str; 3] = ["controller.r_roll", "controller.r_pitch", "controller.r_yaw"];
const WANTED_RATES: [&str; 3] = ["controller.rollRate", "controller.pitchRate", "controller.yawRate"];
const GYRO: [&str; 3] = ["gyro.x", "gyro.y", "gyro.z"];
const FORCE: [&str; 3] = ["acc.x", "acc.y", "acc.z"];
const FORCE_Z: &str = "controller.accelz";
const WANTED_ANGLES: [&str; 2] = ["controller.roll", "controller.pitch"];
const SETPOINT: [&str; 3] = ["ctrltarget.x", "ctrltarget.y", "ctrltarget.z"];
const THRUST: &str = "stabilizer.thrust";
const VBAT: [&str; 2] = ["pm.vbat", "pm.vbatMV"];
const YAW_SETPOINT: &str = "controller.yaw";
/// Estimates of vehicles that stand wander by up to 0.1 m.
const AIRBORNE_M: f64 = 0.15;
/// A vehicle on the ground with its motors off turns no faster than the gyro's noise.
const AT_REST_RADPS: f64 = 0.05;
/// The accelerometer shakes with the motors: 2 to 4 degrees as read, below 1 degree over 0.15 s.
const AVERAGED_S: f64 = 0.15;
/// Beyond this no variable makes sense.
const LARGEST: f64 = 1e12;

pub(super) fn read(file: &str, data: &[u8], mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
    let events = usd::parse(file, data, &mut notes)?;
    let Some(event) = events.into_iter().max_by_key(|event| event.t_s.len() * event.variables.len()).filter(|event| !event.t_s.is_empty())
    else {
        return Err(LogError::NoRows { file: file.to_owned() });
    };
    let variables = Variables::of(file, event, &mut notes)?;
    let t_s = &variables.t_s;
    time_gaps(t_s, &mut notes);
    let onboard = variables.onboard();
    let [roll_rad, pitch_rad, mut yaw_rad] = variables.attitude(&mut notes)?;
    unwrap(&mut yaw_rad, "onboard yaw", &mut notes);
    let fixes = onboard.pos_m.clone().map_or(Fixes::default(), |pos_m| {
        notes.push(Note::PositionEstimated);
        Fixes { row: (0..t_s.len()).collect(), capture_t_s: t_s.clone(), pos_m, yaw_rad: None }
    });
    let mut log = FlightLog {
        format: Format::MicroSd,
        airborne: 0..0,
        cmd_roll_rad: variables.radians(WANTED_ANGLES[0]),
        cmd_pitch_rad: variables.radians(WANTED_ANGLES[1]).map(negated),
        // The attitude loop's rate is no command of the pilot, and holds a trim that the rate loop works off for seconds.
        cmd_yaw_rate_radps: None,
        cmd_thrust_pwm: variables.thrust(&onboard, &mut notes)?,
        cmd_height_m: None,
        setpoint_m: variables.all(SETPOINT),
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
    /// Airborne: above the ground with the motors on, since the estimated height of a vehicle that stands may be anything.
    fn find_flight(&mut self, notes: &mut Vec<Note>) {
        let z = &self.fixes.pos_m[2];
        if z.is_empty() {
            notes.push(Note::NoPosition);
            return;
        }
        let thrust = self.cmd_thrust_pwm.as_ref();
        let is_on = |row: usize| thrust.is_none_or(|thrust| thrust[row] > 0.0);
        let height: Vec<f64> = z.iter().enumerate().map(|(row, z)| if is_on(row) { *z } else { 0.0 }).collect();
        self.airborne = longest_above(&self.t_s, &height, AIRBORNE_M);
        if self.airborne.is_empty() {
            notes.push(Note::NeverAirborne { above_m: AIRBORNE_M });
        }
        let level = |row: &usize| self.onboard.as_ref().and_then(|o| o.acc_z_mps2.as_ref()).is_none_or(|acc| acc[*row] > 0.0);
        let fallen = (0..self.len()).filter(|row| !level(row)).count();
        if fallen as f64 > FALLEN_SHARE * self.len() as f64 {
            notes.push(Note::UpsideDown { share: fallen as f64 / self.len() as f64 });
        }
    }
}

/// In free fall the accelerometer reads zero; only a vehicle on its back reads below that for long.
const FALLEN_SHARE: f64 = 0.02;

/// The variables of one event, rows in order of time, unit as logged.
struct Variables {
    file: String,
    event: Event,
    /// From the first record.
    t_s: Vec<f64>,
}

impl Variables {
    /// Drops rows whose time does not increase and rows with values that are not finite.
    fn of(file: &str, mut event: Event, notes: &mut Vec<Note>) -> Result<Self, LogError> {
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
        let Some(start_s) = event.t_s.first().copied() else { return Err(LogError::NoRows { file: file.to_owned() }) };
        notes.push(Note::TimeShifted { start_s });
        let t_s = event.t_s.iter().map(|t| t - start_s).collect();
        Ok(Self { file: file.to_owned(), event, t_s })
    }

    fn get(&self, name: &str) -> Option<Vec<f64>> {
        self.event.column(name).map(<[f64]>::to_vec)
    }

    fn radians(&self, name: &str) -> Option<Vec<f64>> {
        self.get(name).map(radians)
    }

    /// All of several variables, or `None` if one is missing.
    fn all<const N: usize>(&self, names: [&str; N]) -> Option<[Vec<f64>; N]> {
        let found: Option<Vec<_>> = names.iter().map(|name| self.get(name)).collect();
        found?.try_into().ok()
    }

    /// Body rates, right-handed. The controller's are those of the gyro with pitch inverted.
    fn gyro(&self) -> Option<[Vec<f64>; 3]> {
        let own = self.all(GYRO).map(|rates| rates.map(radians));
        own.or_else(|| self.all(RATES).map(|[roll, pitch, yaw]| [roll, negated(pitch), yaw]))
    }

    fn vbat(&self) -> Option<Vec<f64>> {
        let from_mv = |mv: Vec<f64>| mv.into_iter().map(|v| v * 1e-3).collect();
        self.get(VBAT[0]).or_else(|| self.get(VBAT[1]).map(from_mv))
    }

    fn onboard(&self) -> Onboard {
        let angles = self.all(ANGLES).map(|[roll, pitch, yaw]| [radians(roll), negated(radians(pitch)), radians(yaw)]);
        let pwm = self.all(MOTOR_PWM);
        // Newer firmware logs in `motor` what the motors get; only beside `pwm` it is known to be the request.
        let requests = pwm.as_ref().and_then(|_| self.all(MOTOR)).or_else(|| self.all(CONTROL).map(mixed));
        Onboard {
            pos_m: self.all(POSITION),
            vel_mps: self.all(VELOCITY),
            attitude_rad: angles,
            motor_pwm: pwm.or_else(|| self.all(MOTOR)),
            rotor_speed_radps: None,
            setpoint_yaw_rate_radps: None,
            cmd_rates_radps: self.all(WANTED_RATES).map(|[roll, pitch, yaw]| [radians(roll), negated(radians(pitch)), radians(yaw)]),
            motor_request_pwm: requests,
            acc_world_mps2: self.all(ACCELERATION).map(in_mps2),
            acc_z_mps2: self.get(FORCE_Z).or_else(|| self.get(FORCE[2])).map(|acc| in_mps2([acc])).map(|[acc]| acc),
        }
    }

    /// The thrust command: logged, or the mean of the motors' requests, from which the mixer's moments cancel.
    fn thrust(&self, onboard: &Onboard, notes: &mut Vec<Note>) -> Result<Option<Vec<f64>>, LogError> {
        for name in [CONTROL[0], THRUST] {
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
        Ok(Some((0..self.t_s.len()).map(|row| requests.iter().map(|m| m[row].clamp(0.0, 65_535.0)).sum::<f64>() / 4.0).collect()))
    }

    /// The estimated attitude; what of it is not logged is derived. Positive pitch of the firmware lifts the nose.
    fn attitude(&self, notes: &mut Vec<Note>) -> Result<[Vec<f64>; 3], LogError> {
        let [roll, pitch, yaw] = ANGLES.map(|name| self.radians(name));
        if let (Some(roll), Some(pitch), Some(yaw)) = (&roll, &pitch, &yaw) {
            notes.push(Note::Negated { columns: &["stateEstimate.pitch"] });
            return Ok([roll.clone(), negated(pitch.clone()), yaw.clone()]);
        }
        if let Some(gyro) = self.gyro() {
            notes.push(Note::AttitudeIntegrated { bias_radps: None, at_rest: true });
            return Ok(integrate(&self.t_s, &gyro, |row| self.at_rest(&gyro, row)));
        }
        let Some(acc) = self.all(ACCELERATION) else {
            let missing =
                "attitude (stateEstimate.roll, pitch, yaw), gyro (gyro or controller.r_*) or acceleration (stateEstimate.ax, ay, az)";
            return Err(LogError::MissingSignals { file: self.file.clone(), missing, found: self.event.variables.join(", ") });
        };
        let heading = yaw.clone().unwrap_or_else(|| vec![0.0; self.t_s.len()]);
        let [derived_roll, derived_pitch] = tilt(&self.t_s, &acc, &heading);
        notes.push(Note::TiltFromAcceleration { roll: roll.is_none(), pitch: pitch.is_none(), yaw_taken_as_zero: yaw.is_none() });
        Ok([roll.unwrap_or(derived_roll), pitch.map_or(derived_pitch, negated), heading])
    }

    /// The attitude of a vehicle that stands: level, and with motors off the yaw setpoint follows the estimate.
    fn at_rest(&self, gyro: &[Vec<f64>; 3], row: usize) -> Option<[f64; 3]> {
        let off = self.event.column(CONTROL[0])?[row] == 0.0;
        let still = gyro.iter().all(|g| g[row].abs() < AT_REST_RADPS);
        let upright = self.event.column(FORCE_Z).is_none_or(|acc| acc[row] > 0.9);
        let yaw = self.event.column(YAW_SETPOINT).map_or(0.0, |yaw| yaw[row].to_radians());
        (off && still && upright).then_some([0.0, 0.0, yaw])
    }
}

/// Whether a variable has a place in a flight. Others may hold anything.
fn is_used(name: &str) -> bool {
    let threes = [POSITION, VELOCITY, ACCELERATION, ANGLES, RATES, WANTED_RATES, GYRO, FORCE, SETPOINT];
    let fours = [MOTOR, MOTOR_PWM, CONTROL];
    let single = [FORCE_Z, THRUST, YAW_SETPOINT];
    threes.concat().contains(&name)
        || fours.concat().contains(&name)
        || single.contains(&name)
        || WANTED_ANGLES.contains(&name)
        || VBAT.contains(&name)
}

/// What the mixer sends to the four motors, before limits: thrust, and moments about roll, pitch (firmware) and yaw.
fn mixed([thrust, roll, pitch, yaw]: [Vec<f64>; 4]) -> [Vec<f64>; 4] {
    let of = |signs: [f64; 3]| {
        let motor = |row: usize| thrust[row] + signs[0] * roll[row] / 2.0 + signs[1] * pitch[row] / 2.0 + signs[2] * yaw[row];
        (0..thrust.len()).map(motor).map(|pwm| pwm.clamp(0.0, 65_535.0)).collect()
    };
    [of([-1.0, 1.0, 1.0]), of([-1.0, -1.0, -1.0]), of([1.0, -1.0, 1.0]), of([1.0, 1.0, -1.0])]
}

/// Roll and pitch that point the thrust along the specific force, averaged; drag, which is small, is taken for tilt.
fn tilt(t_s: &[f64], [ax, ay, az]: &[Vec<f64>; 3], yaw: &[f64]) -> [Vec<f64>; 2] {
    let [mut roll, mut pitch] = [const { Vec::new() }; 2];
    for (row, yaw) in yaw.iter().enumerate() {
        let (sin, cos) = yaw.sin_cos();
        let forward = ax[row] * cos + ay[row] * sin;
        let left = ay[row] * cos - ax[row] * sin;
        let up = az[row] + 1.0;
        pitch.push(forward.atan2(up));
        roll.push((-left).atan2((forward * forward + up * up).sqrt()));
    }
    [roll, pitch].map(|angle| centred_mean(t_s, &angle, AVERAGED_S))
}

fn in_mps2<const N: usize>(acc: [Vec<f64>; N]) -> [Vec<f64>; N] {
    acc.map(|axis| axis.into_iter().map(|g| g * G_MPS2).collect())
}

fn negated(values: Vec<f64>) -> Vec<f64> {
    values.into_iter().map(|v| -v).collect()
}
