//! Commands of the program, and what of a log each lacks.

use serde::Serialize;

use super::{Finding, Grade, airborne_s};
use crate::{AttitudeSource, FlightLog, PositionSource};

/// Fewer fixes or shorter flights do not determine a motion.
const LEAST_FIXES: usize = 5;
const SHORTEST_S: f64 = 5.0;

/// One command and whether the log suffices for it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CommandRequirement {
    /// Command of the program, such as `replay`.
    pub command: &'static str,
    /// Missing channels; empty if the log suffices.
    pub missing: Vec<&'static str>,
    /// Channels that are there but weak.
    pub weak: Vec<&'static str>,
}

pub(super) fn needs(log: &FlightLog, findings: &[Finding]) -> Vec<CommandRequirement> {
    let flown_s = airborne_s(log).map_or(0.0, |[from_s, to_s]| to_s - from_s);
    let onboard = log.onboard.as_ref();
    let requests = onboard.is_some_and(|onboard| onboard.motor_request_pwm.is_some());
    let motors = onboard.is_some_and(|onboard| onboard.motor_pwm.is_some() || onboard.rotor_radps.is_some());
    let no_position = (log.fixes.row.len() < LEAST_FIXES, "position (x, y, z)");
    let no_angles = log.cmd_roll_rad.is_none() || log.cmd_pitch_rad.is_none();
    let by_rates = onboard.is_some_and(|o| o.cmd_rates_radps.is_some() || o.cmd_torque_nm.is_some());
    let no_tilt_command = (no_angles && !by_rates, "roll and pitch commands (angles, body rates or moments)");
    let no_angle_command = (
        no_angles && by_rates,
        "roll and pitch commands as angles, or a model whose commands are body rates: identify it",
    );
    let no_lift_command =
        (log.cmd_thrust_pwm.is_none() && log.cmd_height_m.is_none(), "a thrust or height command");
    let never_flies = (flown_s < SHORTEST_S, "five seconds of flight");
    let is_grave = findings.iter().any(|finding| finding.grade == Grade::Grave);
    let grave = (is_grave, "sound channels: see the grave findings");
    let commanded = [no_position, no_tilt_command, no_lift_command, never_flies, grave];
    let replayed = [no_angle_command, no_position, no_tilt_command, no_lift_command, never_flies, grave];
    let derived = (log.provenance.attitude == AttitudeSource::Motion, "attitude is derived from the motion");
    let estimated =
        (log.provenance.position == PositionSource::Estimate, "position is the vehicle's own estimate");
    let no_yaw = (log.cmd_yaw_rate_radps.is_none(), "no yaw-rate command: yaw follows the measurement");
    let no_voltage = (log.vbat_v.is_none(), "no battery voltage: a sagging battery looks like lost thrust");
    let no_motors = (!motors && !requests, "no motors: motor faults look like faults of the body");
    let weak = [derived, estimated, no_yaw, no_voltage, no_motors];
    let requirement = |command, lacks: &[(bool, &'static str)], weak: &[(bool, &'static str)]| {
        let texts = |list: &[(bool, &'static str)]| {
            list.iter().filter(|(is, _)| *is).map(|(_, text)| *text).collect()
        };
        CommandRequirement { command, missing: texts(lacks), weak: texts(weak) }
    };
    let no_requests =
        (!requests, "motor requests before battery compensation (motors beside pwm, or the mixer's inputs)");
    vec![
        requirement("replay", &replayed, &weak[..3]),
        requirement("identify", &commanded, &weak[..4]),
        requirement("explain", &replayed, &weak),
        requirement("diagnose", &[no_requests, never_flies, grave], &[no_voltage]),
    ]
}
