//! The project's own CSV, as `FlightLog::write_csv` writes it.

use crate::columns::Layout;
use crate::signal::{check_capture, radians, time_gaps, unwrap, usual_step};
use crate::table::{Accept, NUMBER, PWM, Table};
use crate::{AttitudeSource, Fixes, FlightLog, Note, PositionSource, Provenance, Reader, Result, Truth};

/// The height above the start from which the stock driver takes the vehicle for flying (`crazyflie_ros`
/// take-off).
pub(crate) const AIRBORNE_M: f64 = 0.05;

pub(crate) const TIME: &str = "t_s";
pub(crate) const SETPOINT: [&str; 3] = ["setpoint_x_m", "setpoint_y_m", "setpoint_z_m"];
pub(crate) const SETPOINT_YAW: &str = "setpoint_yaw_deg";
pub(crate) const CMD_ROLL: &str = "cmd_roll_deg";
pub(crate) const CMD_PITCH: &str = "cmd_pitch_deg";
pub(crate) const CMD_YAW_RATE: &str = "cmd_yaw_rate_degps";
pub(crate) const CMD_THRUST: &str = "cmd_thrust_pwm";
pub(crate) const CMD_HEIGHT: &str = "cmd_height_m";
/// Position, yaw and capture time of a marker fix: empty together where no new frame arrived.
pub(crate) const MARKER: [&str; 5] =
    ["marker_x_m", "marker_y_m", "marker_z_m", "marker_yaw_deg", "marker_t_s"];
pub(crate) const ATTITUDE: [&str; 3] = ["imu_roll_deg", "imu_pitch_deg", "imu_yaw_deg"];
pub(crate) const GYRO: [&str; 3] = ["gyro_x_radps", "gyro_y_radps", "gyro_z_radps"];
pub(crate) const ACC: [&str; 3] = ["acc_x_mps2", "acc_y_mps2", "acc_z_mps2"];
pub(crate) const VBAT: &str = "vbat_v";
pub(crate) const TRUE_POS: [&str; 3] = ["true_x_m", "true_y_m", "true_z_m"];
pub(crate) const TRUE_VEL: [&str; 3] = ["true_vx_mps", "true_vy_mps", "true_vz_mps"];
pub(crate) const TRUE_ATTITUDE: [&str; 3] = ["true_roll_deg", "true_pitch_deg", "true_yaw_deg"];

const COMMANDS: [&str; 4] = [SETPOINT_YAW, CMD_ROLL, CMD_PITCH, CMD_YAW_RATE];
/// Revision of the vehicle's firmware, in every row: 0 for a simulated one.
const FIRMWARE: &str = "firmware_revision";
/// Capture times that agree with the rows' times to this are the rows' own.
const SAME_TIME_S: f64 = 1e-6;
/// Beside these in logs of `crazyflie deploy`, for people: the vehicle's clock, and what was sent and received
/// when by the host's.
const DEPLOYED: [&[&str]; 2] = [
    &[FIRMWARE, "vehicle_clock_ms", "received_clock_s", "sent_clock_s"],
    &["sent_roll_deg", "sent_pitch_deg", "sent_yaw_rate_degps", "sent_thrust_pwm", "sent_height_m"],
];
pub(crate) const LAYOUT: Layout = Layout {
    required: &[&[TIME], &SETPOINT, &COMMANDS, &MARKER, &ATTITUDE, &GYRO, &ACC, &[VBAT]],
    optional: &DEPLOYED,
    // the vertical command: at least one of the two
    alternatives: &[CMD_THRUST, CMD_HEIGHT],
    // a simulator's truth: all of it or none
    together: &[&TRUE_POS, &TRUE_VEL, &TRUE_ATTITUDE],
};

pub(crate) static READER: Reader = Reader {
    name: "project_csv",
    title: "a project CSV",
    layout: Some(&LAYOUT),
    read: |content, notes| read(content.table()?, notes),
    ..Reader::TEXT
};

pub(crate) fn read(table: &Table, mut notes: Vec<Note>) -> Result<FlightLog> {
    let t_s = table.time(TIME)?;
    time_gaps(&t_s, &mut notes);
    let angle = |column| table.column(column, NUMBER).map(radians);
    let mut fixes = read_fixes(table)?;
    check_capture(&t_s, &mut fixes, &mut notes);
    let [roll_rad, pitch_rad, yaw_rad] = read_attitude(table, ATTITUDE, "IMU yaw", &mut notes)?;
    let truth = read_truth(table, &mut notes)?;
    let position = position_source(table, &t_s, &fixes)?;
    let mut log = FlightLog {
        cmd_roll_rad: Some(angle(CMD_ROLL)?),
        cmd_pitch_rad: Some(angle(CMD_PITCH)?),
        cmd_yaw_rate_radps: Some(angle(CMD_YAW_RATE)?),
        cmd_thrust_pwm: optional(table, CMD_THRUST, PWM)?,
        cmd_height_m: optional(table, CMD_HEIGHT, NUMBER)?,
        setpoint_m: Some(table.triple(SETPOINT)?),
        setpoint_yaw_rad: Some(angle(SETPOINT_YAW)?),
        fixes,
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: Some(table.triple(GYRO)?),
        acc_mps2: Some(table.triple(ACC)?),
        vbat_v: Some(table.column(VBAT, NUMBER)?),
        truth,
        notes,
        ..FlightLog::empty(Provenance::new(READER.name, position, AttitudeSource::Imu), t_s)
    };
    log.find_airborne_over_rest(Some(AIRBORNE_M));
    Ok(log)
}

/// Returns the source of the position. A simulated flight has it from a camera. A real vehicle has a firmware: its
/// own estimate is in every row, other fixes at steps of their own.
fn position_source(table: &Table, t_s: &[f64], fixes: &Fixes) -> Result<PositionSource> {
    let revision = optional(table, FIRMWARE, NUMBER)?;
    if revision.is_none_or(|revision| revision.iter().all(|number| *number == 0.0)) {
        return Ok(PositionSource::Camera);
    }
    let is_own = |(row, capture_s): (&usize, &f64)| (t_s[*row] - capture_s).abs() < SAME_TIME_S;
    Ok(if fixes.row.iter().zip(&fixes.capture_t_s).all(is_own) {
        PositionSource::Estimate
    } else {
        PositionSource::of_step(usual_step(&fixes.capture_t_s))
    })
}

fn optional(table: &Table, column: &str, accept: Accept) -> Result<Option<Vec<f64>>> {
    if !table.has(column) {
        return Ok(None);
    }
    table.column(column, accept).map(Some)
}

fn read_fixes(table: &Table) -> Result<Fixes> {
    let (row, values) = table.sparse(&MARKER)?;
    let mut values = values.into_iter();
    let mut next = || values.next().unwrap_or_default();
    Ok(Fixes { row, pos_m: [next(), next(), next()], yaw_rad: Some(radians(next())), capture_t_s: next() })
}

fn read_attitude(
    table: &Table,
    columns: [&str; 3],
    yaw_name: &'static str,
    notes: &mut Vec<Note>,
) -> Result<[Vec<f64>; 3]> {
    let mut angles = table.triple(columns)?.map(radians);
    unwrap(&mut angles[2], yaw_name, notes);
    Ok(angles)
}

fn read_truth(table: &Table, notes: &mut Vec<Note>) -> Result<Option<Truth>> {
    if !table.has(TRUE_POS[0]) {
        return Ok(None);
    }
    let [roll_rad, pitch_rad, yaw_rad] = read_attitude(table, TRUE_ATTITUDE, "true yaw", notes)?;
    Ok(Some(Truth {
        pos_m: table.triple(TRUE_POS)?,
        vel_mps: table.triple(TRUE_VEL)?,
        roll_rad,
        pitch_rad,
        yaw_rad,
    }))
}
