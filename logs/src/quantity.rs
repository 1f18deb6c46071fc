//! Channels of a mapping file: quantities, units and frames.

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

const G_MPS2: f64 = 9.80665;
/// Turns of the field, of which a motor makes one per pair of poles.
pub(crate) const ERPM: &str = "erpm";
const RPM_RADPS: f64 = std::f64::consts::TAU / 60.0;
pub(crate) const DEG_RAD: f64 = std::f64::consts::PI / 180.0;

impl Quantity {
    pub(crate) const ALL: [Self; 10] = [
        Self::Length,
        Self::Speed,
        Self::Angle,
        Self::Rate,
        Self::Acceleration,
        Self::Torque,
        Self::Pwm,
        Self::Voltage,
        Self::Number,
        Self::Time,
    ];

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

const fn channel(name: &'static str, quantity: Quantity, signs: [f64; 3], group: &'static str) -> Channel {
    Channel { name, quantity, signs, group }
}

/// All channels of a mapping.
pub(crate) const CHANNELS: [Channel; 50] = [
    channel("x", Quantity::Length, SAME, "position"),
    channel("y", Quantity::Length, TURNED, "position"),
    channel("z", Quantity::Length, TURNED, "position"),
    channel("capture_time", Quantity::Time, SAME, "capture_time"),
    channel("vx", Quantity::Speed, SAME, "velocity"),
    channel("vy", Quantity::Speed, TURNED, "velocity"),
    channel("vz", Quantity::Speed, TURNED, "velocity"),
    channel("roll", Quantity::Angle, SAME, "tilt"),
    channel("pitch", Quantity::Angle, PITCH, "tilt"),
    channel("yaw", Quantity::Angle, TURNED, "yaw"),
    channel("qx", Quantity::Number, SAME, "quaternion"),
    channel("qy", Quantity::Number, TURNED, "quaternion"),
    channel("qz", Quantity::Number, TURNED, "quaternion"),
    channel("qw", Quantity::Number, SAME, "quaternion"),
    channel("gyro_x", Quantity::Rate, SAME, "gyro"),
    channel("gyro_y", Quantity::Rate, TURNED, "gyro"),
    channel("gyro_z", Quantity::Rate, TURNED, "gyro"),
    channel("acc_x", Quantity::Acceleration, SAME, "acceleration"),
    channel("acc_y", Quantity::Acceleration, TURNED, "acceleration"),
    channel("acc_z", Quantity::Acceleration, TURNED, "acceleration"),
    channel("cmd_roll", Quantity::Angle, SAME, "tilt command"),
    channel("cmd_pitch", Quantity::Angle, PITCH, "tilt command"),
    channel("cmd_yaw_rate", Quantity::Rate, YAW_RATE, "cmd_yaw_rate"),
    channel("cmd_rate_x", Quantity::Rate, SAME, "body-rate commands"),
    channel("cmd_rate_y", Quantity::Rate, PITCH, "body-rate commands"),
    channel("cmd_rate_z", Quantity::Rate, TURNED, "body-rate commands"),
    channel("cmd_torque_x", Quantity::Torque, SAME, "torque commands"),
    channel("cmd_torque_y", Quantity::Torque, PITCH, "torque commands"),
    channel("cmd_torque_z", Quantity::Torque, TURNED, "torque commands"),
    channel("cmd_thrust", Quantity::Pwm, SAME, "cmd_thrust"),
    channel("cmd_height", Quantity::Length, SAME, "cmd_height"),
    channel("setpoint_x", Quantity::Length, SAME, "set-point"),
    channel("setpoint_y", Quantity::Length, TURNED, "set-point"),
    channel("setpoint_z", Quantity::Length, TURNED, "set-point"),
    channel("setpoint_yaw", Quantity::Angle, TURNED, "setpoint_yaw"),
    channel("motor_1", Quantity::Pwm, SAME, "motors"),
    channel("motor_2", Quantity::Pwm, SAME, "motors"),
    channel("motor_3", Quantity::Pwm, SAME, "motors"),
    channel("motor_4", Quantity::Pwm, SAME, "motors"),
    channel("rotor_1", Quantity::Rate, SAME, "rotor speeds"),
    channel("rotor_2", Quantity::Rate, SAME, "rotor speeds"),
    channel("rotor_3", Quantity::Rate, SAME, "rotor speeds"),
    channel("rotor_4", Quantity::Rate, SAME, "rotor speeds"),
    channel("vbat", Quantity::Voltage, SAME, "vbat"),
    channel("estimate_x", Quantity::Length, SAME, "position estimate"),
    channel("estimate_y", Quantity::Length, TURNED, "position estimate"),
    channel("estimate_z", Quantity::Length, TURNED, "position estimate"),
    channel("estimate_vx", Quantity::Speed, SAME, "velocity estimate"),
    channel("estimate_vy", Quantity::Speed, TURNED, "velocity estimate"),
    channel("estimate_vz", Quantity::Speed, TURNED, "velocity estimate"),
];

impl Channel {
    /// The channel that a vector's part is, and its sign, where the file's y axis is up and its z axis to the
    /// right.
    pub(crate) fn in_y_up(self) -> (Self, f64) {
        let (stem, other, sign) = match self.name.char_indices().last() {
            Some((at, 'y')) => (&self.name[..at], 'z', 1.0),
            Some((at, 'z')) => (&self.name[..at], 'y', -1.0),
            _ => return (self, 1.0),
        };
        let turned = CHANNELS.into_iter().find(|channel| channel.name == format!("{stem}{other}"));
        turned.map_or((self, 1.0), |channel| (channel, sign))
    }
}
