//! Channels of a mapping file: quantities, units and frames.

use std::sync::LazyLock;

use crate::G_MPS2;

/// A physical quantity, with the units in which it may be logged and their factors to ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quantity {
    Length,
    Speed,
    Angle,
    Rate,
    Acceleration,
    Torque,
    Pwm,
    Voltage,
    Number,
    Time,
}

/// Turns of the field, of which a motor makes one per pair of poles.
pub(crate) const ERPM: &str = "erpm";
const RPM_RADPS: f64 = std::f64::consts::TAU / 60.0;
pub(crate) const DEG_RAD: f64 = std::f64::consts::PI / 180.0;

impl Quantity {
    /// The factor of a unit to ours.
    pub(crate) fn factor(self, unit: &str) -> Option<f64> {
        self.units().iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
    }

    /// Names of the units and their factors; the first is ours.
    pub(crate) fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Length => &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)],
            Self::Speed => &[("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)],
            Self::Angle => &[("rad", 1.0), ("deg", DEG_RAD), ("mrad", 1e-3), ("centideg", 1e-2 * DEG_RAD)],
            Self::Rate => {
                &[("rad/s", 1.0), ("deg/s", DEG_RAD), ("mrad/s", 1e-3), ("rpm", RPM_RADPS), (ERPM, RPM_RADPS)]
            }
            Self::Acceleration => &[("m/s2", 1.0), ("g", G_MPS2), ("mg", 1e-3 * G_MPS2), ("mm/s2", 1e-3)],
            Self::Torque => &[("N m", 1.0), ("mN m", 1e-3), ("uN m", 1e-6)],
            Self::Pwm => &[
                ("pwm", 1.0),
                ("fraction", 65_535.0),
                ("share", 65_535.0),
                ("throttle", 65_535.0),
                ("percent", 655.35),
                ("pwm8", 257.0),
                ("N", 1.0),
                ("m/s2", 1.0),
            ],
            Self::Voltage => &[("V", 1.0), ("mV", 1e-3)],
            Self::Number => &[("1", 1.0)],
            Self::Time => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)],
        }
    }
}

/// A channel that a mapping may fill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Channel {
    pub(crate) name: &'static str,
    pub(crate) quantity: Quantity,
    /// Signs of the frames z-up, ned and crazyflie against the log's own channel.
    pub(crate) signs: [f64; 3],
    /// Channels that make sense only together have one group.
    pub(crate) group: &'static str,
}

/// Frames by the name that a mapping gives them, in the order of [`Channel::signs`]; the last has its axes
/// exchanged, see [`Channel::in_y_up`].
pub(crate) const FRAMES: [&str; 4] = ["z-up", "ned", "crazyflie", "y-up"];

const SAME: [f64; 3] = [1.0, 1.0, 1.0];
/// Turned about x by half a turn, as NED is against z-up.
const TURNED: [f64; 3] = [1.0, -1.0, 1.0];
/// Signs of pitch: as above, and the firmware has it inverted.
const PITCH: [f64; 3] = [1.0, -1.0, -1.0];
/// The log has the thesis's sign, clockwise from above.
const YAW_RATE: [f64; 3] = [-1.0, 1.0, 1.0];

/// Signs along the axes x, y and z, and about them.
const VECTOR: &[[f64; 3]] = &[SAME, TURNED, TURNED];
const ABOUT: &[[f64; 3]] = &[SAME, PITCH, TURNED];

/// All channels of a mapping.
pub(crate) static CHANNELS: LazyLock<Vec<Channel>> = LazyLock::new(|| {
    let groups: [(&str, Quantity, &[[f64; 3]], &str); 21] = [
        ("x y z", Quantity::Length, VECTOR, "position"),
        ("capture_time", Quantity::Time, &[SAME], "capture_time"),
        ("vx vy vz", Quantity::Speed, VECTOR, "velocity"),
        ("roll pitch", Quantity::Angle, ABOUT, "tilt"),
        ("yaw", Quantity::Angle, &[TURNED], "yaw"),
        ("qx qy qz qw", Quantity::Number, &[SAME, TURNED, TURNED, SAME], "quaternion"),
        ("gyro_x gyro_y gyro_z", Quantity::Rate, VECTOR, "gyro"),
        ("acc_x acc_y acc_z", Quantity::Acceleration, VECTOR, "acceleration"),
        ("cmd_roll cmd_pitch", Quantity::Angle, ABOUT, "tilt command"),
        ("cmd_yaw_rate", Quantity::Rate, &[YAW_RATE], "cmd_yaw_rate"),
        ("cmd_rate_x cmd_rate_y cmd_rate_z", Quantity::Rate, ABOUT, "body-rate commands"),
        ("cmd_torque_x cmd_torque_y cmd_torque_z", Quantity::Torque, ABOUT, "torque commands"),
        ("cmd_thrust", Quantity::Pwm, &[SAME], "cmd_thrust"),
        ("cmd_height", Quantity::Length, &[SAME], "cmd_height"),
        ("setpoint_x setpoint_y setpoint_z", Quantity::Length, VECTOR, "set-point"),
        ("setpoint_yaw", Quantity::Angle, &[TURNED], "setpoint_yaw"),
        ("motor_1 motor_2 motor_3 motor_4", Quantity::Pwm, &[SAME; 4], "motors"),
        ("rotor_1 rotor_2 rotor_3 rotor_4", Quantity::Rate, &[SAME; 4], "rotor speeds"),
        ("vbat", Quantity::Voltage, &[SAME], "vbat"),
        ("estimate_x estimate_y estimate_z", Quantity::Length, VECTOR, "position estimate"),
        ("estimate_vx estimate_vy estimate_vz", Quantity::Speed, VECTOR, "velocity estimate"),
    ];
    let channels = groups.into_iter().flat_map(|(names, quantity, signs, group)| {
        names.split(' ').zip(signs).map(move |(name, signs)| Channel { name, quantity, signs: *signs, group })
    });
    channels.collect()
});

impl Channel {
    /// The channel that a vector's part is, and its sign, where the file's y axis is up and its z axis to the
    /// right.
    pub(crate) fn in_y_up(self) -> (Self, f64) {
        let (stem, other, sign) = match self.name.char_indices().last() {
            Some((at, 'y')) => (&self.name[..at], 'z', 1.0),
            Some((at, 'z')) => (&self.name[..at], 'y', -1.0),
            _ => return (self, 1.0),
        };
        let turned = CHANNELS.iter().copied().find(|channel| channel.name == format!("{stem}{other}"));
        turned.map_or((self, 1.0), |channel| (channel, sign))
    }
}
