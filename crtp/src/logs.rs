//! The log variables, declared once: table of contents, documentation and what is sent follow.

use crate::telemetry::Telemetry;
use crate::values::Kind;
use crate::values::Kind::{F32, I16, U8, U16, U32};

/// A log variable.
#[derive(Debug, Clone, Copy)]
pub struct LogVariable {
    /// Group and name with a point between.
    pub name: &'static str,
    /// Kind as it is stored.
    pub kind: Kind,
    /// Symbol of the unit; "1" for a pure number.
    pub unit: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
    pub(crate) read: fn(&Telemetry) -> f64,
}

const fn log(
    name: &'static str,
    kind: Kind,
    unit: &'static str,
    about: &'static str,
    read: fn(&Telemetry) -> f64,
) -> LogVariable {
    LogVariable { name, kind, unit, about, read }
}

const TO_MM: f64 = 1000.0;
const TO_MRADPS: f64 = 1000.0;
const POSITION: &str = "where the filter believes the vehicle";
const VELOCITY: &str = "velocity along the room's axes, by the filter";
const ACC: &str = "specific force along the body's axes, by the IMU";
const LEGACY_PITCH: &str = "pitch by the IMU; as in the firmware, positive lifts the nose";
const PWM: &str = "thrust command: the model has no motors of its own, each gets the same";
const CLEAR: &str =
    "clear way to the room's wall by a Multi-ranger, see `cf2 --deck`; 0 without, 32766 beyond 4 m";
const FLOW: &str = "counts of a Flow deck in a tick, see `cf2 --deck`; 0 without";
const ASKED_PITCH: &str = "pitch asked of the attitude loop; positive lifts the nose";
const THRUST: &str = "thrust command, in PWM counts";

/// Every log variable, in the order of the table of contents.
pub static LOGS: &[LogVariable] = &[
    log("stateEstimate.x", F32, "m", POSITION, |t| t.pos_m[0]),
    log("stateEstimate.y", F32, "m", POSITION, |t| t.pos_m[1]),
    log("stateEstimate.z", F32, "m", POSITION, |t| t.pos_m[2]),
    log("stateEstimate.vx", F32, "m/s", VELOCITY, |t| t.vel_mps[0]),
    log("stateEstimate.vy", F32, "m/s", VELOCITY, |t| t.vel_mps[1]),
    log("stateEstimate.vz", F32, "m/s", VELOCITY, |t| t.vel_mps[2]),
    log("stateEstimate.ax", F32, "g", ACC, |t| t.acc_g[0]),
    log("stateEstimate.ay", F32, "g", ACC, |t| t.acc_g[1]),
    log("stateEstimate.az", F32, "g", "specific force upwards without gravity, by the IMU", |t| {
        t.acc_g[2] - 1.0
    }),
    log("stateEstimate.roll", F32, "deg", "roll by the IMU", |t| t.att_deg[0]),
    log("stateEstimate.pitch", F32, "deg", LEGACY_PITCH, |t| -t.att_deg[1]),
    log("stateEstimate.yaw", F32, "deg", "heading by the filter, right-handed", |t| t.att_deg[2]),
    log("stateEstimate.qx", F32, "1", "attitude as a quaternion", |t| t.quaternion()[0]),
    log("stateEstimate.qy", F32, "1", "attitude as a quaternion", |t| t.quaternion()[1]),
    log("stateEstimate.qz", F32, "1", "attitude as a quaternion", |t| t.quaternion()[2]),
    log("stateEstimate.qw", F32, "1", "attitude as a quaternion", |t| t.quaternion()[3]),
    log("stateEstimateZ.x", I16, "mm", POSITION, |t| t.pos_m[0] * TO_MM),
    log("stateEstimateZ.y", I16, "mm", POSITION, |t| t.pos_m[1] * TO_MM),
    log("stateEstimateZ.z", I16, "mm", POSITION, |t| t.pos_m[2] * TO_MM),
    log("stateEstimateZ.vx", I16, "mm/s", VELOCITY, |t| t.vel_mps[0] * TO_MM),
    log("stateEstimateZ.vy", I16, "mm/s", VELOCITY, |t| t.vel_mps[1] * TO_MM),
    log("stateEstimateZ.vz", I16, "mm/s", VELOCITY, |t| t.vel_mps[2] * TO_MM),
    log("stateEstimateZ.rateRoll", I16, "mrad/s", "rate by the gyroscope", |t| {
        t.gyro_degps[0].to_radians() * TO_MRADPS
    }),
    log("stateEstimateZ.ratePitch", I16, "mrad/s", "rate by the gyroscope", |t| {
        t.gyro_degps[1].to_radians() * TO_MRADPS
    }),
    log("stateEstimateZ.rateYaw", I16, "mrad/s", "rate by the gyroscope", |t| {
        t.gyro_degps[2].to_radians() * TO_MRADPS
    }),
    log("stateEstimateZ.quat", U32, "1", "attitude as a quaternion in 32 bits", Telemetry::packed_quaternion),
    log("stabilizer.roll", F32, "deg", "roll by the IMU", |t| t.att_deg[0]),
    log("stabilizer.pitch", F32, "deg", LEGACY_PITCH, |t| -t.att_deg[1]),
    log("stabilizer.yaw", F32, "deg", "heading by the filter, right-handed", |t| t.att_deg[2]),
    log("stabilizer.thrust", F32, "1", THRUST, |t| t.thrust_pwm),
    log("stabilizer.intToOut", U32, "us", "from measurement to motors: one tick", |t| t.tick_s * 1e6),
    log("kalman.stateX", F32, "m", POSITION, |t| t.pos_m[0]),
    log("kalman.stateY", F32, "m", POSITION, |t| t.pos_m[1]),
    log("kalman.stateZ", F32, "m", POSITION, |t| t.pos_m[2]),
    log("kalman.statePX", F32, "m/s", VELOCITY, |t| t.vel_mps[0]),
    log("kalman.statePY", F32, "m/s", VELOCITY, |t| t.vel_mps[1]),
    log("kalman.statePZ", F32, "m/s", VELOCITY, |t| t.vel_mps[2]),
    log("kalman.varX", F32, "m^2", "variance of the position", |t| t.var_pos_m2[0]),
    log("kalman.varY", F32, "m^2", "variance of the position", |t| t.var_pos_m2[1]),
    log("kalman.varZ", F32, "m^2", "variance of the position", |t| t.var_pos_m2[2]),
    log("kalman.varPX", F32, "m^2/s^2", "variance of the velocity", |t| t.var_vel_m2ps2[0]),
    log("kalman.varPY", F32, "m^2/s^2", "variance of the velocity", |t| t.var_vel_m2ps2[1]),
    log("kalman.varPZ", F32, "m^2/s^2", "variance of the velocity", |t| t.var_vel_m2ps2[2]),
    log("pm.vbat", F32, "V", "battery, by the effect `battery_sag`; 4.2 V without", |t| t.vbat_v),
    log("pm.vbatMV", U16, "mV", "battery, by the effect `battery_sag`; 4200 mV without", |t| {
        t.vbat_v * 1000.0
    }),
    log("pm.batteryLevel", U8, "%", "charge by the voltage", |t| t.battery_percent),
    log("pm.state", U8, "1", "0 fine, 3 low, 4 empty", |t| t.power_state),
    log("gyro.x", F32, "deg/s", "rate by the gyroscope", |t| t.gyro_degps[0]),
    log("gyro.y", F32, "deg/s", "rate by the gyroscope", |t| t.gyro_degps[1]),
    log("gyro.z", F32, "deg/s", "rate by the gyroscope", |t| t.gyro_degps[2]),
    log("acc.x", F32, "g", ACC, |t| t.acc_g[0]),
    log("acc.y", F32, "g", ACC, |t| t.acc_g[1]),
    log("acc.z", F32, "g", ACC, |t| t.acc_g[2]),
    log("motor.m1", U16, "1", PWM, |t| t.thrust_pwm),
    log("motor.m2", U16, "1", PWM, |t| t.thrust_pwm),
    log("motor.m3", U16, "1", PWM, |t| t.thrust_pwm),
    log("motor.m4", U16, "1", PWM, |t| t.thrust_pwm),
    log("controller.cmd_thrust", F32, "1", THRUST, |t| t.thrust_pwm),
    log("controller.actuatorThrust", F32, "1", THRUST, |t| t.thrust_pwm),
    log("controller.roll", F32, "deg", "roll asked of the attitude loop", |t| t.asked_deg[0]),
    log("controller.pitch", F32, "deg", ASKED_PITCH, |t| -t.asked_deg[1]),
    log("controller.yawRate", F32, "deg/s", "yaw rate asked of the attitude loop, right-handed", |t| {
        t.asked_deg[2]
    }),
    log("controller.yaw", F32, "deg", "heading asked for; 0 where none is", |t| t.target_yaw_deg),
    log("ctrltarget.roll", F32, "deg", "roll asked of the attitude loop", |t| t.asked_deg[0]),
    log("ctrltarget.pitch", F32, "deg", ASKED_PITCH, |t| -t.asked_deg[1]),
    log("ctrltarget.x", F32, "m", "set-point; 0 where none is a place", |t| t.target_m[0]),
    log("ctrltarget.y", F32, "m", "set-point; 0 where none is a place", |t| t.target_m[1]),
    log("ctrltarget.z", F32, "m", "set-point; 0 where none is a height", |t| t.target_m[2]),
    log("ctrltarget.vx", F32, "m/s", "set-point; 0 where none is a velocity", |t| t.target_mps[0]),
    log("ctrltarget.vy", F32, "m/s", "set-point; 0 where none is a velocity", |t| t.target_mps[1]),
    log("ctrltarget.vz", F32, "m/s", "set-point; 0 where none is a climb rate", |t| t.target_mps[2]),
    log("ctrltarget.yaw", F32, "deg", "set-point; 0 where none is a heading", |t| t.target_yaw_deg),
    log("supervisor.info", U16, "1", "bits of the supervisor, as the supervisor port sends them", |t| {
        t.info.into()
    }),
    log("sys.canfly", U8, "1", "whether motors may turn", |t| (t.info >> 3 & 1).into()),
    log("sys.isFlying", U8, "1", "whether motors turned within two seconds", |t| (t.info >> 4 & 1).into()),
    log("sys.isTumbled", U8, "1", "whether it lies or hangs wrongly", |t| (t.info >> 5 & 1).into()),
    log("sys.armed", U8, "1", "whether it is armed", |t| (t.info >> 1 & 1).into()),
    log("radio.rssi", U8, "-dBm", "no radio: always 40", |_| 40.0),
    log("radio.isConnected", U8, "1", "whether a client is heard", |t| t.connected.into()),
    log("locSrv.x", F32, "m", "last position from outside", |t| t.extpos_m[0]),
    log("locSrv.y", F32, "m", "last position from outside", |t| t.extpos_m[1]),
    log("locSrv.z", F32, "m", "last position from outside", |t| t.extpos_m[2]),
    log("range.front", U16, "mm", CLEAR, |t| t.range_mm(0)),
    log("range.back", U16, "mm", CLEAR, |t| t.range_mm(1)),
    log("range.left", U16, "mm", CLEAR, |t| t.range_mm(2)),
    log("range.right", U16, "mm", CLEAR, |t| t.range_mm(3)),
    log("range.up", U16, "mm", CLEAR, |t| t.range_mm(4)),
    log("range.zrange", U16, "mm", "height by a Flow deck or Z-ranger, see `cf2 --deck`; 0 without", |t| {
        t.range_mm(5)
    }),
    log("motion.deltaX", I16, "1", FLOW, |t| t.flow[0]),
    log("motion.deltaY", I16, "1", FLOW, |t| t.flow[1]),
    log("baro.asl", F32, "m", "height over the floor", |t| t.true_pos_m[2]),
    log("sim.x", F32, "m", "the true position, which no vehicle knows", |t| t.true_pos_m[0]),
    log("sim.y", F32, "m", "the true position, which no vehicle knows", |t| t.true_pos_m[1]),
    log("sim.z", F32, "m", "the true position, which no vehicle knows", |t| t.true_pos_m[2]),
];
