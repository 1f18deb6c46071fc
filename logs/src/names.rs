//! Column names in words, and the channel of each.

use crate::variables::variable;

/// A channel that a column may be.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Guess {
    pub(crate) channel: &'static str,
    /// Confidence: the share of the name's words that were understood, higher for the vehicle's own position than for
    /// an estimate.
    pub(crate) score: f64,
    /// The unit in the name.
    pub(crate) unit: Option<String>,
}

const COMMAND: &str = "cmd command commanded des desired ref reference target sp setpoint wanted goal";
const ESTIMATE: &str = "est estimate estimated ekf kalman odom";
const OUTSIDE: &str = "mocap vicon optitrack qualisys truth gt true marker";
const POSITION: &str = "pos position p loc location";
const VELOCITY: &str = "vel velocity v speed";
const ACCELERATION: &str = "acc accel acceleration accelerometer a";
const GYRO: &str = "gyro omega w angvel rate rates angular gyroscope";
const ROTATION: &str = "q quat quaternion orientation rot rotation";
const MOTOR: &str = "motor m motors";
const ROTOR: &str = "rotor rpm";
const THRUST: &str = "thrust throttle collective";
const VOLTAGE: &str = "vbat battery voltage bat vbatt batt";
const HEIGHT: &str = "height altitude alt";
const CAPTURE: &str = "capture captured";
/// Words after which an axis or a number may be glued to a name.
const PARTED: [&str; 9] =
    [COMMAND, ESTIMATE, OUTSIDE, POSITION, VELOCITY, ACCELERATION, GYRO, ROTATION, MOTOR];
const AXES: &str = "x y z w roll pitch yaw phi theta psi heading qw";
/// Units of a mapping file, and the words in names that mean them.
const UNITS: [(&str, &str); 17] = [
    ("deg", "deg degrees"),
    ("rad", "rad radians"),
    ("mrad", "mrad"),
    ("deg/s", "degps dps deg/s"),
    ("rad/s", "radps rad/s"),
    ("rpm", "rpm"),
    ("mm", "mm"),
    ("cm", "cm"),
    ("m", "meters"),
    ("m/s", "mps m/s"),
    ("mm/s", "mm/s"),
    ("m/s2", "mps2 m/s2 m/s^2"),
    ("mg", "mg"),
    ("pwm", "pwm"),
    ("percent", "percent %"),
    ("mV", "mv"),
    ("V", "volt"),
];

/// Returns whether a word is in a list with spaces between.
pub(crate) fn is_in(list: &str, word: &str) -> bool {
    list.split(' ').any(|known| known == word)
}

fn known_unit(word: &str) -> Option<String> {
    UNITS.iter().find(|(_, words)| is_in(words, word)).map(|(unit, _)| (*unit).to_owned())
}

/// Returns the axis of a position that a system outside measured, if a name has both.
pub(crate) fn outside_axis(column: &str) -> Option<usize> {
    let words = words(column);
    let is_outside = words.iter().any(|word| is_in(OUTSIDE, word));
    let guess = channel_of(column).filter(|_| is_outside)?;
    ["x", "y", "z"].iter().position(|axis| *axis == guess.channel)
}

/// Returns whether a name is that of a channel, by the firmware's names or by its words.
pub(crate) fn is_channel_name(name: &str) -> bool {
    variable(name).is_some() || channel_of(name).is_some()
}

/// The unit of a mapping file that a word means.
pub(crate) fn unit_of(word: &str) -> Option<String> {
    let lower = word.to_lowercase();
    known_unit(&lower).or_else(|| {
        Some(lower).filter(|word| matches!(word.as_str(), "m" | "g" | "v")).map(|word| word.replace('v', "V"))
    })
}

/// Returns the channel of a column's name.
pub(crate) fn channel_of(column: &str) -> Option<Guess> {
    let words = words(column);
    let unit = words.iter().find_map(|word| known_unit(word));
    let has = |list: &str| words.iter().any(|word| is_in(list, word));
    let (command, estimate, outside) = (has(COMMAND), has(ESTIMATE), has(OUTSIDE));
    let axis = words.iter().find_map(|word| ["x", "y", "z"].iter().position(|axis| axis == word));
    let turn = ["roll phi", "pitch theta", "yaw psi heading"].into_iter().position(has);
    let number = words.iter().find_map(|word| word.parse::<usize>().ok());
    let rated = has(GYRO) || matches!(unit.as_deref(), Some("deg/s" | "rad/s"));
    let channel = match (turn, axis, number) {
        (Some(2), ..) if command && rated => "cmd_yaw_rate",
        (Some(_), ..) if command && rated => return None,
        (Some(turn), ..) if rated => ["gyro_x", "gyro_y", "gyro_z"][turn],
        (Some(2), ..) if command => "setpoint_yaw",
        (Some(turn), ..) if command => ["cmd_roll", "cmd_pitch"][turn],
        (Some(turn), ..) => ["roll", "pitch", "yaw"][turn],
        (_, Some(axis), _) if has(ROTATION) && !command => ["qx", "qy", "qz"][axis],
        _ if has("qw") || (has(ROTATION) && has("w")) => "qw",
        (_, Some(axis), _) if has(ACCELERATION) && !command => ["acc_x", "acc_y", "acc_z"][axis],
        (_, Some(axis), _) if has(GYRO) && !command => ["gyro_x", "gyro_y", "gyro_z"][axis],
        (_, Some(axis), _) if has(VELOCITY) && estimate => {
            ["estimate_vx", "estimate_vy", "estimate_vz"][axis]
        }
        (_, Some(_), _) if (has(VELOCITY) || has(ACCELERATION) || has(GYRO)) && command => return None,
        (_, Some(axis), _) if has(VELOCITY) => ["vx", "vy", "vz"][axis],
        (_, Some(axis), _) if command => ["setpoint_x", "setpoint_y", "setpoint_z"][axis],
        (_, Some(axis), _) if estimate => ["estimate_x", "estimate_y", "estimate_z"][axis],
        (_, Some(axis), _) => ["x", "y", "z"][axis],
        (_, _, Some(n)) if has(ROTOR) && (1..=4).contains(&n) => {
            ["rotor_1", "rotor_2", "rotor_3", "rotor_4"][n - 1]
        }
        (_, _, Some(n)) if has(MOTOR) && (1..=4).contains(&n) => {
            ["motor_1", "motor_2", "motor_3", "motor_4"][n - 1]
        }
        _ if has(THRUST) => "cmd_thrust",
        _ if has(VOLTAGE) => "vbat",
        _ if has(HEIGHT) && command => "cmd_height",
        _ if has(HEIGHT) => "z",
        _ if has(CAPTURE) => "capture_time",
        _ => return None,
    };
    let others = [ROTOR, THRUST, VOLTAGE, HEIGHT, CAPTURE, AXES];
    let is_known = |word: &&String| {
        PARTED.iter().chain(&others).any(|list| is_in(list, word))
            || known_unit(word).is_some()
            || word.parse::<usize>().is_ok()
    };
    let understood = words.iter().filter(is_known).count() as f64 / words.len().max(1) as f64;
    Some(Guess { channel, score: understood + if outside { 1.0 } else { 0.0 }, unit })
}

/// The words of a name in lower case: parted at signs and capitals, and an axis or number parted from what it
/// is glued to.
fn words(column: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let (name, unit) = match column.find(['[', '(']) {
        Some(at) => (&column[..at], column[at + 1..].trim_end_matches([']', ')']).trim().to_lowercase()),
        None => (column, String::new()),
    };
    let mut word = String::new();
    let mut after_lower = false;
    for c in name.chars() {
        if !c.is_alphanumeric() || (c.is_uppercase() && after_lower) {
            words.push(std::mem::take(&mut word));
        }
        if c.is_alphanumeric() {
            word.extend(c.to_lowercase());
        }
        after_lower = c.is_lowercase();
    }
    words.push(word);
    words.retain(|word| !word.is_empty());
    let mut parted: Vec<String> = words.iter().flat_map(|word| part(word)).collect();
    parted.extend((!unit.is_empty()).then_some(unit));
    parted
}

/// Words with an axis or a number behind them, such as `px`, `gyrox` or `m1`.
fn part(word: &str) -> Vec<String> {
    let (head, tail) = match word.char_indices().last() {
        Some((at, last)) if at > 0 && ("xyzw".contains(last) || last.is_ascii_digit()) => word.split_at(at),
        _ => return vec![word.to_owned()],
    };
    if !PARTED.iter().chain(&["g t rpm rotor r"]).any(|list| is_in(list, head)) {
        return vec![word.to_owned()];
    }
    // gx is a rate, as every IMU has it; mx is no motor
    let head = if head == "g" { "gyro" } else { head };
    vec![head.to_owned(), tail.to_owned()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_labs_are_understood() {
        for (column, channel) in [
            ("px", "x"),
            ("Position Y [mm]", "y"),
            ("mocap_z", "z"),
            ("velX", "vx"),
            ("drone.pose.position.z", "z"),
            ("roll_deg", "roll"),
            ("theta", "pitch"),
            ("cmdPitch", "cmd_pitch"),
            ("roll_ref", "cmd_roll"),
            ("yaw_rate_cmd", "cmd_yaw_rate"),
            ("thrust", "cmd_thrust"),
            ("m3", "motor_3"),
            ("motor_pwm_4", "motor_4"),
            ("gyro_x (deg/s)", "gyro_x"),
            ("gz", "gyro_z"),
            ("az", "acc_z"),
            ("q_w", "qw"),
            ("quat_x", "qx"),
            ("battery voltage", "vbat"),
            ("target_x", "setpoint_x"),
            ("ekf_vy", "estimate_vy"),
            ("Rigid Body cf1 Rotation X", "qx"),
            ("Rigid Body cf1 Position Z", "z"),
            ("/vicon/cf1/position/x", "x"),
            ("__stateEstimate_y", "estimate_y"),
        ] {
            assert_eq!(
                channel_of(column).map(|guess| guess.channel),
                Some(channel),
                "{column}: {:?}",
                words(column)
            );
        }
        assert_eq!(channel_of("temperature"), None);
        assert_eq!(channel_of("Position Y [mm]").unwrap().unit.as_deref(), Some("mm"));
    }
}
