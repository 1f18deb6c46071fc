//! Simulated flights with an undeclared effect: degrees, thesis signs, a 30 Hz camera.

use crate::columns::Layout;
use crate::signal::{check_capture, radians, time_gaps, unwrap};
use crate::table::{NUMBER, PWM, Table};
use crate::{AttitudeSource, Fixes, FlightLog, Note, PositionSource, Provenance, Reader, Result};

/// Every column of the format.
const LAYOUT: Layout = Layout {
    required: &[
        &["t", "ref_x", "ref_y", "ref_z", "ref_yaw"],
        &["cmd_roll", "cmd_pitch", "cmd_yawrate", "cmd_thrust_pwm"],
        &["x", "y", "z", "t_cam", "roll", "pitch", "yaw", "vbat"],
    ],
    ..Layout::NONE
};

pub(crate) static READER: Reader = Reader {
    name: "hidden_effects_csv",
    title: "a hidden-effects CSV",
    layout: Some(&LAYOUT),
    read: |content, notes| read(content.table()?, notes),
    ..Reader::TEXT
};

pub(crate) fn read(table: &Table, mut notes: Vec<Note>) -> Result<FlightLog> {
    let t_s = table.time("t")?;
    time_gaps(&t_s, &mut notes);
    let angle = |column| table.column(column, NUMBER).map(radians);
    let mut fixes = read_fixes(table)?;
    check_capture(&t_s, &mut fixes, &mut notes);
    let mut yaw_rad = angle("yaw")?;
    unwrap(&mut yaw_rad, "yaw", &mut notes);
    let provenance = Provenance::new(READER.name, PositionSource::Camera, AttitudeSource::Imu);
    let mut log = FlightLog {
        cmd_roll_rad: Some(angle("cmd_roll")?),
        cmd_pitch_rad: Some(angle("cmd_pitch")?),
        cmd_yaw_rate_radps: Some(angle("cmd_yawrate")?),
        cmd_thrust_pwm: Some(table.column("cmd_thrust_pwm", PWM)?),
        setpoint_m: Some(table.triple(["ref_x", "ref_y", "ref_z"])?),
        setpoint_yaw_rad: Some(angle("ref_yaw")?),
        fixes,
        roll_rad: angle("roll")?,
        pitch_rad: angle("pitch")?,
        yaw_rad,
        vbat_v: Some(table.column("vbat", NUMBER)?),
        notes,
        ..FlightLog::empty(provenance, t_s)
    };
    // these flights start and end in the air: some hover at 0.1 m with a biased sensor
    log.find_airborne_over_rest(None);
    Ok(log)
}

fn read_fixes(table: &Table) -> Result<Fixes> {
    let (row, values) = table.sparse(&["x", "y", "z", "t_cam"])?;
    let mut values = values.into_iter();
    let mut next = || values.next().unwrap_or_default();
    Ok(Fixes { row, pos_m: [next(), next(), next()], capture_t_s: next(), yaw_rad: None })
}
