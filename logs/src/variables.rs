//! The variables of the Crazyflie's firmware that a flight has a use for: unit, sign and what each is.
//!
//! Names, units and signs are those of the firmware's log groups. In it, pitch and its rate are inverted wherever
//! they are from `attitude.pitch` or the legacy rates; the Lee controller's angles are right-handed.

use crate::G_MPS2;
use std::f64::consts::{PI, TAU};
use std::fmt::Write;

/// Meaning of a group of variables in a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Role {
    words: &'static str,
    /// Commands and set-points stay in force until the next.
    is_held: bool,
}

/// All meanings.
pub(crate) mod role {
    use super::Role;

    const fn measured(words: &'static str) -> Role {
        Role { words, is_held: false }
    }

    const fn held(words: &'static str) -> Role {
        Role { words, is_held: true }
    }

    pub(crate) const OUTSIDE_POSITION: Role = measured("position from outside");
    pub(crate) const POSITION: Role = measured("the vehicle's estimate of its position");
    pub(crate) const VELOCITY: Role = measured("the vehicle's estimate of its velocity");
    /// In the world, gravity taken out.
    pub(crate) const WORLD_ACCELERATION: Role = measured("acceleration in the world, without gravity");
    pub(crate) const ANGLES: Role = measured("roll, pitch, yaw");
    pub(crate) const QUATERNION: Role = measured("attitude as a quaternion");
    pub(crate) const BODY_RATES: Role = measured("body rates");
    pub(crate) const SPECIFIC_FORCE: Role = measured("specific force in the body");
    pub(crate) const SPECIFIC_FORCE_UP: Role = measured("specific force along the body's z axis");
    pub(crate) const WANTED_ANGLES: Role = held("roll and pitch commands");
    /// The direction that the thrust shall have.
    pub(crate) const WANTED_AXIS: Role =
        held("direction of the thrust that is wanted: roll and pitch commands");
    pub(crate) const WANTED_YAW: Role = held("yaw set-point");
    pub(crate) const WANTED_RATES: Role = held("body-rate commands");
    pub(crate) const WANTED_TORQUE: Role = held("moments that are commanded");
    pub(crate) const SETPOINT: Role = held("position set-point");
    pub(crate) const THRUST_PWM: Role = held("thrust command");
    pub(crate) const THRUST_FORCE: Role = held("thrust command, turned into PWM by the firmware's own curve");
    /// Thrust and the three moments, as the mixer gets them.
    pub(crate) const MIXER_INPUTS: Role = held("thrust and moments: requests to the motors");
    pub(crate) const MOTOR_PWM: Role = held("motor commands");
    pub(crate) const MOTOR_REQUEST: Role = held("requests to the motors before battery compensation");
    /// PWM of the motors, applied or requested, depending on the version.
    pub(crate) const MOTORS: Role = held("motor commands; requests where `pwm` is logged beside them");
    pub(crate) const ROTOR_SPEED: Role = measured("rotor speeds");
    pub(crate) const VOLTAGE: Role = measured("battery voltage");
}

/// Variables that make sense together.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) role: Role,
    /// Group in the firmware.
    group: &'static str,
    /// Variables of the group, with spaces between.
    names: &'static str,
    pub(crate) unit: Unit,
    /// Against the log's own frame; all the same if there is one.
    signs: &'static [f64],
}

/// A unit of the firmware, and its factor to the log's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unit {
    pub(crate) name: &'static str,
    factor: f64,
}

const fn unit(name: &'static str, factor: f64) -> Unit {
    Unit { name, factor }
}
const M: Unit = unit("m", 1.0);
const MM: Unit = unit("mm", 1e-3);
const MPS: Unit = unit("m/s", 1.0);
const MM_PS: Unit = unit("mm/s", 1e-3);
const G: Unit = unit("g", G_MPS2);
const MM_PS2: Unit = unit("mm/s2", 1e-3);
const DEG: Unit = unit("deg", PI / 180.0);
const RAD: Unit = unit("rad", 1.0);
const DEG_PS: Unit = unit("deg/s", PI / 180.0);
const RAD_PS: Unit = unit("rad/s", 1.0);
const MRAD_PS: Unit = unit("mrad/s", 1e-3);
const RPM: Unit = unit("rpm", TAU / 60.0);
const PWM: Unit = unit("PWM", 1.0);
const V: Unit = unit("V", 1.0);
const MV: Unit = unit("mV", 1e-3);
const N: Unit = unit("N", 1.0);
const NM: Unit = unit("N m", 1.0);
const ONE: Unit = unit("1", 1.0);

const SAME: &[f64] = &[1.0];
const PITCH_INVERTED: &[f64] = &[1.0, -1.0, 1.0];

const fn group(
    role: Role,
    group: &'static str,
    names: &'static str,
    unit: Unit,
    signs: &'static [f64],
) -> Group {
    Group { role, group, names, unit, signs }
}

/// All groups; of one role, the first that is complete in a log counts.
pub(crate) const GROUPS: &[Group] = {
    use role::*;
    &[
        group(OUTSIDE_POSITION, "locSrv", "x y z", M, SAME),
        group(OUTSIDE_POSITION, "lighthouse", "x y z", M, SAME),
        group(POSITION, "stateEstimate", "x y z", M, SAME),
        group(POSITION, "stateEstimateZ", "x y z", MM, SAME),
        group(POSITION, "kalman", "stateX stateY stateZ", M, SAME),
        group(VELOCITY, "stateEstimate", "vx vy vz", MPS, SAME),
        group(VELOCITY, "stateEstimateZ", "vx vy vz", MM_PS, SAME),
        group(WORLD_ACCELERATION, "stateEstimate", "ax ay az", G, SAME),
        group(WORLD_ACCELERATION, "stateEstimateZ", "ax ay az", MM_PS2, SAME),
        group(ANGLES, "stateEstimate", "roll pitch yaw", DEG, PITCH_INVERTED),
        group(ANGLES, "stabilizer", "roll pitch yaw", DEG, PITCH_INVERTED),
        group(ANGLES, "ctrlLee", "rpyx rpyy rpyz", RAD, SAME),
        group(QUATERNION, "stateEstimate", "qx qy qz qw", ONE, SAME),
        group(QUATERNION, "kalman", "q1 q2 q3 q0", ONE, SAME),
        group(BODY_RATES, "gyro", "x y z", DEG_PS, SAME),
        group(BODY_RATES, "controller", "r_roll r_pitch r_yaw", RAD_PS, PITCH_INVERTED),
        group(BODY_RATES, "ctrlMel", "r_roll r_pitch r_yaw", RAD_PS, PITCH_INVERTED),
        group(BODY_RATES, "ctrlLee", "omegax omegay omegaz", RAD_PS, SAME),
        group(BODY_RATES, "stateEstimateZ", "rateRoll ratePitch rateYaw", MRAD_PS, PITCH_INVERTED),
        group(SPECIFIC_FORCE, "acc", "x y z", G, SAME),
        group(SPECIFIC_FORCE_UP, "controller", "accelz", G, SAME),
        group(SPECIFIC_FORCE_UP, "ctrlMel", "accelz", G, SAME),
        group(SPECIFIC_FORCE_UP, "acc", "z", G, SAME),
        group(WANTED_ANGLES, "controller", "roll pitch", DEG, PITCH_INVERTED),
        group(WANTED_ANGLES, "ctrltarget", "roll pitch", DEG, PITCH_INVERTED),
        group(WANTED_ANGLES, "ctrlLee", "rpydx rpydy", RAD, SAME),
        group(WANTED_AXIS, "ctrlMel", "zdx zdy zdz", ONE, SAME),
        group(WANTED_YAW, "controller", "yaw", DEG, SAME),
        group(WANTED_YAW, "ctrlLee", "rpydz", RAD, SAME),
        group(WANTED_RATES, "controller", "rollRate pitchRate yawRate", DEG_PS, PITCH_INVERTED),
        group(WANTED_RATES, "ctrlLee", "omegarx omegary omegarz", RAD_PS, SAME),
        group(WANTED_TORQUE, "ctrlLee", "torquex torquey torquez", NM, SAME),
        group(SETPOINT, "ctrltarget", "x y z", M, SAME),
        group(SETPOINT, "ctrltargetZ", "x y z", MM, SAME),
        group(SETPOINT, "posCtl", "targetX targetY targetZ", M, SAME),
        group(THRUST_PWM, "controller", "cmd_thrust", PWM, SAME),
        group(THRUST_PWM, "stabilizer", "thrust", PWM, SAME),
        group(THRUST_PWM, "ctrlMel", "cmd_thrust", PWM, SAME),
        group(THRUST_PWM, "ctrlINDI", "cmd_thrust", PWM, SAME),
        group(THRUST_FORCE, "ctrlLee", "thrustSI", N, SAME),
        group(THRUST_FORCE, "ctrlLee", "thrustSi", N, SAME),
        group(MIXER_INPUTS, "controller", "cmd_thrust cmd_roll cmd_pitch cmd_yaw", PWM, SAME),
        group(MIXER_INPUTS, "ctrlMel", "cmd_thrust cmd_roll cmd_pitch cmd_yaw", PWM, SAME),
        group(MIXER_INPUTS, "ctrlINDI", "cmd_thrust cmd_roll cmd_pitch cmd_yaw", PWM, SAME),
        group(MOTOR_PWM, "pwm", "m1_pwm m2_pwm m3_pwm m4_pwm", PWM, SAME),
        group(MOTOR_REQUEST, "motor", "m1req m2req m3req m4req", PWM, SAME),
        group(MOTORS, "motor", "m1 m2 m3 m4", PWM, SAME),
        group(ROTOR_SPEED, "rpm", "m1 m2 m3 m4", RPM, SAME),
        group(VOLTAGE, "pm", "vbat", V, SAME),
        group(VOLTAGE, "pm", "vbatMV", MV, SAME),
    ]
};

impl Group {
    /// Names of the variables with their group before a point.
    pub(crate) fn names(&self) -> impl Iterator<Item = String> {
        self.names.split(' ').map(|name| format!("{}.{name}", self.group))
    }

    /// The factor from a variable to the log's unit and frame.
    pub(crate) fn factor(&self, at: usize) -> f64 {
        self.unit.factor * self.signs.get(at).or(self.signs.first()).copied().unwrap_or(1.0)
    }

    /// A full turn of a variable that wraps, as logged.
    pub(crate) fn turn(&self, at: usize) -> Option<f64> {
        let wraps = (self.role == role::ANGLES && at == 2) || self.role == role::WANTED_YAW;
        wraps.then_some(TAU / self.unit.factor)
    }

    /// Returns whether the variables are commands or set-points, which stay in force until the next.
    pub(crate) fn is_held(&self) -> bool {
        self.role.is_held
    }
}

/// Groups of the firmware that a flight does not need.
const UNUSED: [(&str, &str); 9] = [
    ("pid_attitude, pid_rate", "outputs of the stages of the attitude and rate loops"),
    ("posCtl", "beside its targets: outputs of the stages of the position and velocity loops"),
    ("ctrlINDI, ctrlBrescianini", "beside thrust and moments: states of these controllers"),
    ("powerDist", "forces of the motors as the mixer wants them"),
    ("range", "distances to walls, floor and ceiling, mm"),
    ("motion", "pixels of the flow deck"),
    ("kalman", "beside the position and the attitude: variances and the velocity in the body"),
    ("health", "results of the test of propellers and battery"),
    ("lighthouse", "beside the position: angles and status of the base stations"),
];

const PAGE: &str = "# Variables of the firmware

These variables of a Crazyflie are read from micro-SD logs, and from CSVs of cfclient or cflib. If several groups have one meaning, the first that is complete in the
log counts. `crazyflie inspect --variables` prints this page.

";

/// The group of a variable and its place in it; of several, the first.
pub(crate) fn group_of(name: &str) -> Option<(&'static Group, usize)> {
    let (of, name) = name.split_once('.')?;
    let place = |group: &Group| group.names.split(' ').position(|known| group.group == of && known == name);
    GROUPS.iter().find_map(|group| Some((group, place(group)?)))
}

/// Returns whether a variable has a place in a flight. Others may contain anything.
pub(crate) fn is_used(name: &str) -> bool {
    group_of(name).is_some()
}

/// The firmware's name of a column, if a flight has a use for it; some scripts write an underscore for the
/// dot, or a unit behind the name.
pub(crate) fn variable(column: &str) -> Option<String> {
    let name = column.split(['[', '(']).next().unwrap_or(column).trim();
    let name = if name.contains('.') { name.to_owned() } else { name.replacen('_', ".", 1) };
    is_used(&name).then_some(name)
}

/// The page of all variables that are read, in Markdown.
pub fn variables_markdown() -> String {
    let mut text = String::from(PAGE);
    text += "| variables | read as | unit | sign |\n|---|---|---|---|\n";
    for group in GROUPS {
        let inverted = group.names().enumerate().filter(|(at, _)| group.factor(*at) < 0.0);
        let inverted: Vec<String> = inverted.map(|(_, name)| name).collect();
        let some = || format!("`{}` inverted", inverted.join("`, `"));
        let sign = if inverted.is_empty() { "as logged".to_owned() } else { some() };
        let names = group.names().collect::<Vec<_>>().join("`, `");
        let (role, unit) = (group.role.words, group.unit.name);
        let _ = writeln!(text, "| `{names}` | {role} | {unit} | {sign} |");
    }
    text += "\nOther groups are passed over, and `inspect` lists what it passed over:\n\n| group | holds |\n|---|---|\n";
    for (group, holds) in UNUSED {
        let _ = writeln!(text, "| `{}` | {holds} |", group.replace(", ", "`, `"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variable_is_named_once_in_a_role_and_every_group_on_the_page() {
        for (at, group) in GROUPS.iter().enumerate() {
            let same = |other: &Group| other.role == group.role && other.names().eq(group.names());
            let again = GROUPS[..at].iter().any(same);
            assert!(!again, "{:?}", group.names);
        }
        let page = include_str!("../../docs/firmware.md");
        assert!(page == variables_markdown(), "docs/firmware.md is stale: make docs");
        for group in ["stateEstimateZ", "ctrltargetZ", "pid_rate", "ctrlBrescianini", "powerDist", "health"] {
            assert!(page.contains(group), "{group}");
        }
    }
}
