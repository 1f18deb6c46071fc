//! The topics of the thesis's rig as a flight: `crazyflie_ros` commands and IMU, the marker's pose.
//!
//! Units and signs are those of that driver: `cmd_vel` has pitch (linear x) and roll (linear y) in degrees, +pitch to
//! +x and +roll to -y, thrust 0..60000 (linear z) and the yaw rate in degrees per second with the thesis's sign
//! (angular z); the IMU has rates in rad/s and specific force in m/s2, and no orientation.

use super::align::{Lag, Track, last_index_before};
use super::attitude::{Rotation, integrate};
use super::marker::{Marker, arrivals};
use super::samples::Samples;
use super::signal::{check_capture, radians, unwrap, usual_step};
use super::topics::{TopicRole, Topics};
use super::{
    AttitudeSource, Content, Fixes, FlightLog, G_MPS2, LogError, Note, PositionSource, Provenance, Result,
};
use crazyflie_statistics::quantile;

/// Height above that of a vehicle at rest by a marker on the floor.
const AIRBORNE_M: f64 = 0.1;
/// The largest command that the driver sends.
const MOST_THRUST: f64 = 60_000.0;
/// Rows where there is no IMU to give them.
const GRID_S: f64 = 0.01;
/// A flight of more rows is a damaged time stamp.
const MOST_ROWS: f64 = 1e7;
/// Rows of a standstill that determine the gyro's bias, and how still that is.
const REST_ROWS: usize = 50;
const REST_RADPS: f64 = 0.05;
/// Three seconds of a camera: a marker's yaw is off by a degree or more, frame by frame.
const YAW_FIXES: usize = 90;
/// A lag known less well than this is not worth shifting by.
const WORST_SIGMA_S: f64 = 0.015;

/// Which numbers of a message are what, see `Kind::path`.
const ORIENTATION: usize = 0;
const COVARIANCE: usize = 4;
const RATE: usize = 13;
const ACCELERATION: usize = 25;
const TURN: usize = 5;

pub(super) fn read(
    format: &'static str,
    content: &Content<'_>,
    topics: Topics,
    mut notes: Vec<Note>,
) -> Result<FlightLog> {
    let file = content.file;
    let mut topics = topics.of_flight(file, content.part, &mut notes)?;
    let body = content.mapping.and_then(|(_, mapping)| mapping.body.as_deref());
    let all: Vec<String> = topics.bodies().into_iter().map(str::to_owned).collect();
    let is_found = body.is_some_and(|body| topics.keep_body(body));
    if body.is_some() != is_found || topics.bodies().len() > 1 {
        return Err(LogError::SeveralBodies { file: file.to_owned(), bodies: all });
    }
    let parts = [TopicRole::Command, TopicRole::Imu, TopicRole::Pose, TopicRole::Goal, TopicRole::Battery]
        .map(|part| topics.best_for(part));
    topics.note_unused(&parts, &mut notes);
    let start_ns = parts.iter().flatten().filter_map(|topic| topic.recorded_ns.iter().min()).min().copied();
    let missing = "IMU (sensor_msgs/Imu) or pose (geometry_msgs/PoseStamped) messages";
    let no_signals = || LogError::MissingSignals { file: file.to_owned(), missing, found: topics.names() };
    let origin_ns = start_ns.ok_or_else(no_signals)?;
    notes.push(Note::TimeShifted { start_s: origin_ns as f64 * 1e-9 });
    for (topic, part) in parts.iter().zip([TopicRole::Command, TopicRole::Imu, TopicRole::Pose]) {
        if topic.is_none() {
            notes.push(Note::TopicMissing { topic: part.usual_name() });
        }
    }
    let [command, imu, pose, goal, battery] =
        parts.map(|topic| topic.map(|topic| Samples::from_topic(topic, origin_ns, &mut notes)));
    let marker = pose.map(|pose| Marker::from_samples(pose, &mut notes));
    let t_s = rows(imu.as_ref(), marker.as_ref()).ok_or_else(no_signals)?;
    let [roll_rad, pitch_rad, mut yaw_rad] = match &imu {
        Some(imu) => attitude(imu, command.as_ref(), &mut notes),
        None => {
            marker.as_ref().and_then(|marker| marker.attitude(&t_s, &mut notes)).ok_or_else(no_signals)?
        }
    };
    unwrap(&mut yaw_rad, "IMU yaw", &mut notes);
    let position = marker
        .as_ref()
        .map_or(PositionSource::Absent, |marker| PositionSource::of_step(usual_step(&marker.samples.t_s)));
    let attitude = if imu.is_some() { AttitudeSource::Imu } else { AttitudeSource::Marker };
    let mut log = FlightLog {
        setpoint_m: goal.as_ref().map(|goal| goal.triple(0).map(|x| hold(goal, &x, &t_s, x[0]))),
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: imu.as_ref().map(|imu| imu.triple(RATE)),
        acc_mps2: imu.as_ref().map(|imu| acceleration(imu, &mut notes)),
        vbat_v: battery
            .as_ref()
            .map(|battery| hold(battery, &battery.channel(0), &t_s, battery.values[0][0])),
        ..FlightLog::empty(Provenance::new(format, position, attitude), t_s)
    };
    if let Some(command) = &command {
        log.hold_commands(command);
    }
    if let Some(marker) = marker {
        log.set_marker(marker, imu.is_some(), &mut notes);
    }
    log.find_airborne_over_rest(Some(AIRBORNE_M));
    Ok(log.with_notes(notes))
}

/// The IMU's own times; without it, a grid over the marker's.
fn rows(imu: Option<&Samples>, marker: Option<&Marker>) -> Option<Vec<f64>> {
    if let Some(imu) = imu {
        return Some(imu.t_s.clone());
    }
    let arrived_s = &marker?.samples.arrived_s;
    let (from_s, to_s) = (arrived_s.first()?, arrived_s.iter().copied().fold(f64::MIN, f64::max));
    let count = ((to_s - from_s) / GRID_S).ceil() + 1.0;
    (count <= MOST_ROWS).then(|| (0..count as usize).map(|i| from_s + i as f64 * GRID_S).collect())
}

/// Repeats a value from message to message; `before` until the first.
fn hold(samples: &Samples, values: &[f64], rows_s: &[f64], before: f64) -> Vec<f64> {
    let indices = last_index_before(&samples.t_s, rows_s).into_iter();
    indices.map(|index| index.map_or(before, |i| values[i])).collect()
}

/// The IMU's orientation where somebody filled it, else its rates integrated as the thesis did, less their
/// bias.
fn attitude(imu: &Samples, command: Option<&Samples>, notes: &mut Vec<Note>) -> [Vec<f64>; 3] {
    let rotation = |values: &[f64]| {
        let filled = values[COVARIANCE] >= 0.0;
        let xyzw: [f64; 4] = values[ORIENTATION..ORIENTATION + 4].try_into().ok()?;
        Rotation::from_xyzw(xyzw).filter(|_| filled)
    };
    let recorded: Option<Vec<[f64; 3]>> =
        imu.values.iter().map(|values| rotation(values).map(Rotation::angles)).collect();
    if let Some(angles) = recorded {
        return [0, 1, 2].map(|axis| angles.iter().map(|a| a[axis]).collect());
    }
    let mut gyro = imu.triple(RATE);
    let off = command.map_or(0, |command| {
        let sent_s =
            command.t_s.iter().zip(&command.values).find(|(_, values)| values[2] > 0.0).map(|(t, _)| *t);
        sent_s.map_or(0, |sent_s| imu.t_s.partition_point(|t| *t < sent_s))
    });
    let is_still = |rates: &[f64]| {
        let middle = quantile(rates, 0.5).unwrap_or(0.0);
        rates.iter().all(|rate| (rate - middle).abs() < REST_RADPS)
    };
    let at_rest = off >= REST_ROWS && gyro.iter().all(|g| is_still(&g[..off]));
    let mean = |g: &[f64]| g.iter().sum::<f64>() / g.len() as f64;
    // Without a standstill: a flight that starts and ends level turns by nothing about x and y.
    let bias = if at_rest {
        gyro.each_ref().map(|g| mean(&g[..off]))
    } else {
        [mean(&gyro[0]), mean(&gyro[1]), 0.0]
    };
    for (rates, bias) in gyro.iter_mut().zip(bias) {
        rates.iter_mut().for_each(|rate| *rate -= bias);
    }
    notes.push(Note::AttitudeIntegrated { bias_radps: Some(bias), at_rest });
    integrate(&imu.t_s, &gyro, |_| None)
}

/// Specific force; some drivers leave it in g.
fn acceleration(imu: &Samples, notes: &mut Vec<Note>) -> [Vec<f64>; 3] {
    let mut acc = imu.triple(ACCELERATION);
    let size: Vec<f64> =
        (0..imu.t_s.len()).map(|i| acc.iter().map(|a| a[i] * a[i]).sum::<f64>().sqrt()).collect();
    if (0.5..2.0).contains(&quantile(&size, 0.5).unwrap_or(0.0)) {
        notes.push(Note::ReadAs { columns: "linear_acceleration", unit: "multiples of g" });
        acc.iter_mut().flatten().for_each(|a| *a *= G_MPS2);
    }
    acc
}

impl FlightLog {
    fn hold_commands(&mut self, command: &Samples) {
        // Before the first command the motors are off.
        let held = |at: usize| hold(command, &command.channel(at), &self.t_s, 0.0);
        self.cmd_pitch_rad = Some(radians(held(0)));
        self.cmd_roll_rad = Some(radians(held(1)));
        self.cmd_thrust_pwm = Some(held(2).into_iter().map(|pwm| pwm.clamp(0.0, MOST_THRUST)).collect());
        self.cmd_yaw_rate_radps = Some(radians(held(TURN)));
    }

    /// Puts the marker's poses into the rows in which they arrived, and compares the camera's clock with the
    /// IMU's.
    fn set_marker(&mut self, mut marker: Marker, has_imu: bool, notes: &mut Vec<Note>) {
        if has_imu {
            self.turn_to_marker(&marker, notes);
            let is_stamped = marker.samples.clock.is_some_and(|clock| clock.same);
            match self.lag_of_positions(&marker.samples.t_s, &marker.pos_m, marker.yaw_rad.as_deref()) {
                None => notes.push(Note::CameraLagUnknown),
                Some(Lag { lag_s, sigma_s, correlation, by }) => {
                    // Stamps of one clock are believed; without them the data knows better.
                    let shifted = !is_stamped && sigma_s <= WORST_SIGMA_S;
                    if shifted {
                        marker.samples.t_s.iter_mut().for_each(|t| *t -= lag_s);
                    }
                    notes.push(Note::CameraLag { lag_s, sigma_s, correlation, by, shifted });
                }
            }
        }
        let (row, arrived) = arrivals(&marker.samples.arrived_s, &self.t_s);
        let pick = |values: &[f64]| arrived.iter().map(|at| values[*at]).collect::<Vec<f64>>();
        self.fixes = Fixes {
            row,
            capture_t_s: pick(&marker.samples.t_s),
            pos_m: marker.pos_m.each_ref().map(|x| pick(x)),
            yaw_rad: marker.yaw_rad.as_ref().map(|yaw| pick(yaw)),
        };
        check_capture(&self.t_s, &mut self.fixes, notes);
    }

    /// An integrated yaw counts from the take-off, the marker's from the marker: the first seconds'
    /// difference is added.
    fn turn_to_marker(&mut self, marker: &Marker, notes: &mut Vec<Note>) {
        let Some(yaw) = marker.yaw_rad.as_ref() else { return };
        let own = Track { t_s: &self.t_s, values: &self.yaw_rad };
        let first = marker.samples.t_s.iter().zip(yaw).take(YAW_FIXES);
        let offsets: Vec<f64> =
            first.map(|(t, seen)| seen - own.value_at(*t)).map(|d| d.sin().atan2(d.cos())).collect();
        let offset_rad = quantile(&offsets, 0.5).unwrap_or(0.0);
        self.yaw_rad.iter_mut().for_each(|yaw| *yaw += offset_rad);
        notes.push(Note::YawFromMarker { offset_rad });
    }
}
