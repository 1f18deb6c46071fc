//! NanoBench: real Crazyflie 2.1 flights under motion capture, onboard data resampled to the capture clock.
//!
//! The traps, all measured on the files: pitch is inverted in the firmware; the motion capture angles are
//! radians; `sp_ctrltarget_yaw` is a rate, the derivative of `pid_controller_yaw`, which is the yaw setpoint;
//! onboard data is extrapolated after its last packet; whole packet groups may be dead.

use crazyflie_statistics::quantile;
use std::ops::Range;

use super::radio::{End, Group, SHORTEST_TAIL_S};
use super::wander::wander;
use crate::columns::Layout;
use crate::signal::{radians, time_gaps, unwrap};
use crate::skew::{self, Rates};
use crate::table::{Accept, NUMBER, PWM, Table};
use crate::{
    AttitudeSource, Fixes, FlightLog, G_MPS2, Note, Onboard, PositionSource, Provenance, Reader, Result,
};

/// An angle in radians that wraps: anything larger is degrees.
const RADIANS: Accept = Accept::between(-6.3, 6.3, "an angle in radians (-6.3 to 6.3)");
/// Only the battery voltage is used among the optional columns.
const LAYOUT: Layout = Layout {
    required: &[&TRUTH, &IMU, &MOTOR, &EST, &ATT, &SP, &PID],
    optional: &[
        &["qx", "qy", "qz", "qw", "wx_vicon", "wy_vicon", "wz_vicon"],
        &["est_stateEstimate_ax", "est_stateEstimate_ay", "est_stateEstimate_az"],
        &["att_stateEstimate_qx", "att_stateEstimate_qy", "att_stateEstimate_qz", "att_stateEstimate_qw"],
        &[VBAT],
    ],
    ..Layout::NONE
};
/// Time and motion capture.
const TRUTH: [&str; 10] = ["t", "px", "py", "pz", "roll", "pitch", "yaw", "vx", "vy", "vz"];
const IMU: [&str; 6] = ["imu_acc_x", "imu_acc_y", "imu_acc_z", "imu_gyro_x", "imu_gyro_y", "imu_gyro_z"];
const MOTOR: [&str; 4] = ["motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4"];
const EST: [&str; 6] = [
    "est_stateEstimate_x",
    "est_stateEstimate_y",
    "est_stateEstimate_z",
    "est_stateEstimate_vx",
    "est_stateEstimate_vy",
    "est_stateEstimate_vz",
];
const ATT: [&str; 3] = ["att_stateEstimate_roll", "att_stateEstimate_pitch", "att_stateEstimate_yaw"];
const SP: [&str; 4] = ["sp_ctrltarget_x", "sp_ctrltarget_y", "sp_ctrltarget_z", "sp_ctrltarget_yaw"];
const PID: [&str; 4] =
    ["pid_controller_roll", "pid_controller_pitch", "pid_controller_yaw", "pid_controller_cmd_thrust"];
const SETPOINT_NAME: &str = "the setpoint";
const VBAT: &str = "pwr_pm_vbat";

/// Height above the vehicle at rest; its marker rests at 0.053 to 0.072 m, differently in each session.
const OVER_REST_M: f64 = 0.05;
/// Height that counts as flight in a log that begins in the air, whose floor is unknown: higher than that of any
/// vehicle at rest.
const AIRBORNE_M: f64 = 0.1;

pub(crate) static READER: Reader = Reader {
    name: "nanobench_csv",
    title: "a NanoBench CSV",
    layout: Some(&LAYOUT),
    read: |content, notes| read(content.table()?, notes),
    ..Reader::TEXT
};

pub(crate) fn read(table: &Table, mut notes: Vec<Note>) -> Result<FlightLog> {
    let mut log = motion_capture(table, &mut notes)?;
    log.find_flight_over_markers();
    let flies = log.airborne.clone();
    let t_s = &log.t_s;
    let imu = Packets::read(table, t_s, &flies, "the IMU", IMU)?;
    let motor = Packets::read(table, t_s, &flies, "the motor commands", MOTOR)?;
    let est = Packets::read(table, t_s, &flies, "the position estimate", EST)?;
    let att = Packets::read(table, t_s, &flies, "the attitude estimate", ATT)?;
    let sp = Packets::read(table, t_s, &flies, SETPOINT_NAME, SP)?;
    let pid = Packets::read(table, t_s, &flies, "the controller's commands", PID)?;
    let ends = [imu.last(), motor.last(), est.last(), att.last(), sp.last(), pid.last()];
    let vbat = battery(table, t_s, &mut notes)?;
    log.cut(ends.into_iter().flatten().min(), &mut notes);
    log.vbat_v = vbat.map(|v| v[..log.len()].to_vec());

    let imu = imu.keep(&log, &mut notes);
    let pid = pid.keep(&log, &mut notes);
    let sp = sp.keep(&log, &mut notes);
    let motor_pwm = motor.keep(&log, &mut notes);
    let est = est.keep(&log, &mut notes);
    let att = att.keep(&log, &mut notes);
    for (column, values) in MOTOR.iter().zip(motor_pwm.iter().flatten()) {
        table.recheck(column, values, PWM)?;
    }
    if let Some([_, _, _, thrust]) = &pid {
        table.recheck(PID[3], thrust, PWM)?;
    }
    log.set_commands(pid);
    let setpoint_yaw_rate_radps = log.set_setpoint(sp);
    log.set_imu(imu);
    let (pos_m, vel_mps) = est.map(|[x, y, z, vx, vy, vz]| ([x, y, z], [vx, vy, vz])).unzip();
    let attitude_rad = att.map(|angles| to_right_handed(angles, &mut notes));
    log.onboard = Some(Onboard {
        pos_m,
        vel_mps,
        attitude_rad,
        motor_pwm,
        setpoint_yaw_rate_radps,
        ..Onboard::default()
    });
    log.compare_clocks(&mut notes);
    notes.push(Note::Negated { columns: &["pid_controller_pitch", "att_stateEstimate_pitch"] });
    notes.push(Note::ReadAs { columns: "pid_controller_yaw", unit: "the yaw setpoint in degrees" });
    notes.push(Note::ReadAs {
        columns: "sp_ctrltarget_yaw",
        unit: "the rate of the yaw setpoint in degrees per second",
    });
    notes.push(Note::NoYawRateCommand);
    Ok(log.with_notes(notes))
}

/// The log with what motion capture measured, over the whole file.
fn motion_capture(table: &Table, notes: &mut Vec<Note>) -> Result<FlightLog> {
    let mut t_s = table.time("t")?;
    let start_s = t_s[0];
    for t in &mut t_s {
        *t -= start_s;
    }
    notes.push(Note::TimeShifted { start_s });
    time_gaps(&t_s, notes);
    let mut yaw_rad = table.column("yaw", RADIANS)?;
    unwrap(&mut yaw_rad, "motion-capture yaw", notes);
    notes.push(Note::ReadAs { columns: "roll, pitch, yaw", unit: "radians" });
    let provenance = Provenance {
        format: READER.name,
        position: PositionSource::MotionCapture,
        attitude: AttitudeSource::MotionCapture,
        onboard_interpolated: true,
    };
    Ok(FlightLog {
        fixes: Fixes {
            yaw_rad: Some(table.column("yaw", RADIANS)?),
            ..Fixes::in_every_row(&t_s, table.triple(["px", "py", "pz"])?)
        },
        vel_mps: Some(table.triple(["vx", "vy", "vz"])?),
        roll_rad: table.column("roll", RADIANS)?,
        pitch_rad: table.column("pitch", RADIANS)?,
        yaw_rad,
        ..FlightLog::empty(provenance, t_s)
    })
}

/// Returns the battery voltage, which arrives twice a second or so: its last value is repeated, rather than costing
/// rows.
fn battery(table: &Table, t_s: &[f64], notes: &mut Vec<Note>) -> Result<Option<Vec<f64>>> {
    if !table.has(VBAT) {
        return Ok(None);
    }
    let mut vbat = table.column(VBAT, NUMBER)?;
    let last = Group::new(t_s, vec![&vbat]).tail_start();
    let held = vbat[last];
    let moves = vbat[last..].iter().any(|v| *v != held);
    if moves && t_s[t_s.len() - 1] - t_s[last] >= SHORTEST_TAIL_S {
        vbat[last..].fill(held);
        notes.push(Note::BatteryHeld { from_s: t_s[last] });
    }
    Ok(Some(vbat))
}

/// Degrees with inverted pitch to radians in the right-handed frame, yaw continuous.
fn to_right_handed([roll, pitch, yaw]: [Vec<f64>; 3], notes: &mut Vec<Note>) -> [Vec<f64>; 3] {
    let mut yaw = radians(yaw);
    unwrap(&mut yaw, "onboard yaw", notes);
    [radians(roll), negate(radians(pitch)), yaw]
}

fn negate(values: Vec<f64>) -> Vec<f64> {
    values.into_iter().map(|v| -v).collect()
}

impl FlightLog {
    fn find_flight_over_markers(&mut self) {
        let over_rest_m = self.resting_height_m().map_or(AIRBORNE_M, |rest_m| rest_m + OVER_REST_M);
        self.find_airborne(over_rest_m);
    }

    /// Cuts the rows after `last`, if there is such an end, and finds the airborne interval again.
    fn cut(&mut self, last: Option<(usize, &'static str)>, notes: &mut Vec<Note>) {
        let Some((last, channels)) = last else { return };
        let rows = last + 1;
        let end_s = self.t_s[self.len() - 1];
        let kept_s = self.t_s[last];
        notes.push(Note::CutAfterLastPacket { channels, kept_s, cut_s: end_s - kept_s });
        let fixes = &mut self.fixes;
        fixes.row.truncate(rows);
        let dense = [&mut self.t_s, &mut self.roll_rad, &mut self.pitch_rad, &mut self.yaw_rad];
        let dense = dense.into_iter().chain([&mut fixes.capture_t_s]).chain(&mut fixes.pos_m);
        for values in dense.chain(&mut fixes.yaw_rad).chain(self.vel_mps.iter_mut().flatten()) {
            values.truncate(rows);
        }
        self.notes.clear();
        self.find_flight_over_markers();
    }

    fn set_commands(&mut self, pid: Option<[Vec<f64>; 4]>) {
        if let Some([roll, pitch, yaw, thrust]) = pid {
            self.cmd_roll_rad = Some(radians(roll));
            self.cmd_pitch_rad = Some(negate(radians(pitch)));
            self.cmd_thrust_pwm = Some(thrust);
            self.setpoint_yaw_rad = Some(radians(yaw));
        }
    }

    /// Returns the rate of the yaw setpoint. It is not the yaw-rate command, which the firmware computes from
    /// the yaw error and does not log.
    fn set_setpoint(&mut self, sp: Option<[Vec<f64>; 4]>) -> Option<Vec<f64>> {
        let [x, y, z, yaw_rate] = sp?;
        self.setpoint_m = Some([x, y, z]);
        Some(radians(yaw_rate))
    }

    fn set_imu(&mut self, imu: Option<[Vec<f64>; 6]>) {
        if let Some([ax, ay, az, gx, gy, gz]) = imu {
            let from_g = |x: Vec<f64>| x.into_iter().map(|v| v * G_MPS2).collect();
            self.acc_mps2 = Some([from_g(ax), from_g(ay), from_g(az)]);
            self.gyro_radps = Some([gx, gy, gz]);
        }
    }

    /// Finds how onboard time differs from motion capture and notes it, and how yaw does, in flight.
    fn compare_clocks(&mut self, notes: &mut Vec<Note>) {
        if let Some([gx, gy, _]) = &self.gyro_radps {
            let rates =
                Rates { t_s: &self.t_s, angles_rad: [&self.roll_rad, &self.pitch_rad], gyro_radps: [gx, gy] };
            notes.push(skew::estimate(&rates, &self.airborne));
            let late_s = wander(&rates, &self.airborne);
            self.onboard.get_or_insert_default().late_s = late_s;
        }
        let attitude = self.onboard.as_ref().and_then(|o| o.attitude_rad.as_ref());
        if let Some([_, _, yaw]) = attitude.filter(|_| !self.airborne.is_empty()) {
            let pairs = self.airborne.clone().map(|row| yaw[row] - self.yaw_rad[row]);
            let offsets: Vec<f64> = pairs.map(|d| d.sin().atan2(d.cos())).collect();
            notes.push(Note::YawOffset { median_rad: quantile(&offsets, 0.5).unwrap_or(0.0) });
        }
    }
}

/// The columns of one packet group and where their real data ends.
struct Packets<const N: usize> {
    name: &'static str,
    columns: [Vec<f64>; N],
    end: End,
}

impl<const N: usize> Packets<N> {
    fn read(
        table: &Table,
        t_s: &[f64],
        flies: &Range<usize>,
        name: &'static str,
        names: [&str; N],
    ) -> Result<Self> {
        let mut columns = [const { Vec::new() }; N];
        for (values, column) in columns.iter_mut().zip(names) {
            *values = table.column(column, NUMBER)?;
        }
        let group = Group::new(t_s, columns.iter().map(Vec::as_slice).collect());
        let end = group.end(flies, name == SETPOINT_NAME);
        Ok(Self { name, columns, end })
    }

    /// The last row with real data, if the group's data ends during the flight or after it.
    fn last(&self) -> Option<(usize, &'static str)> {
        match self.end {
            End::At(row) => Some((row, self.name)),
            End::Live | End::Dead => None,
        }
    }

    /// The columns over the rows of `log`, or `None` if they are dead. Notes that, and gaps.
    fn keep(mut self, log: &FlightLog, notes: &mut Vec<Note>) -> Option<[Vec<f64>; N]> {
        if self.end == End::Dead {
            notes.push(Note::DeadChannels { channels: self.name });
            return None;
        }
        for values in &mut self.columns {
            values.truncate(log.len());
        }
        // A setpoint that moves in a straight line is a setpoint, not a gap.
        if self.name != SETPOINT_NAME {
            let group = Group::new(&log.t_s, self.columns.iter().map(Vec::as_slice).collect());
            let (count, longest_s) = group.gaps(&log.airborne);
            if count > 0 {
                notes.push(Note::RadioGaps { channels: self.name, count, longest_s });
            }
        }
        Some(self.columns)
    }
}
