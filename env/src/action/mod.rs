//! Action levels: what the four numbers of an action set. Attitudes are what was identified; set-points above
//! them go through the onboard cascade.

mod cascade;
mod interface;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::{Error, Result, find_named};
use crate::model::{FULL_PWM, Model, ROOM_M, VerticalInput};

pub(crate) use cascade::Onboard;
pub use cascade::{Cascade, CascadeGains, LateralSetpoint, THRUST_BASE, VerticalSetpoint, YawSetpoint};
pub use interface::{ActionScale, Interface, SetpointRange, check_attitude};

/// Numbers per action: roll, pitch, yaw rate, height or PWM.
pub const ACTION: usize = 4;

/// Quantities that an action sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ActionLevel {
    /// Roll, pitch, yaw rate and height or PWM: the input of the identified model.
    #[default]
    Attitude,
    /// Velocity in the room, and a yaw rate.
    Velocity,
    /// A place in the room, and a heading.
    Position,
    /// Rates about the body axes, and a thrust PWM.
    BodyRates,
    /// The PWM of each motor.
    Motors,
}

/// One number of an action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Channel {
    /// Key, with the unit as its suffix.
    pub name: &'static str,
    /// Symbol of the unit; "1" for a pure number.
    pub unit: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
}

/// An action level as the rest of the program sees it.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Value of the option.
    pub level: ActionLevel,
    /// Key in configurations.
    pub name: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
    /// The four numbers of an action, in order.
    pub channels: [Channel; ACTION],
    /// Bandwidth of each channel: 1 / (time until 63 % of a small step), on the built-in model in its default form. A
    /// channel that follows within a tick has the rate of ticks.
    pub bandwidth_radps: [f64; ACTION],
    /// Limits of its validity, compared with the identified model.
    pub validity: &'static str,
    /// Equation, paper or firmware.
    pub source: &'static str,
    /// Values set by actions of -1 and of 1, channel by channel.
    pub(crate) ranges: fn(&Model, &Interface) -> [[f64; 2]; ACTION],
}

const fn channel(name: &'static str, unit: &'static str, about: &'static str) -> Channel {
    Channel { name, unit, about }
}

/// The firmware's limit of a velocity set-point that its position loop gives (`posCtlPid.xVelMax`).
pub(crate) const SPEED_MAX_MPS: f64 = 1.0;

const ATTITUDE: Entry = Entry {
    level: ActionLevel::Attitude,
    name: "attitude",
    about: "roll, pitch, yaw rate, and height or thrust: what `send_setpoint` takes",
    channels: [
        channel("roll_rad", "rad", "positive accelerates to the right"),
        channel("pitch_rad", "rad", "positive accelerates forward"),
        channel("yaw_rate_radps", "rad/s", "in the vehicle's own sign: positive turns clockwise (5.2)"),
        channel("lift", "m or 1", "height, or PWM, as the vertical form says"),
    ],
    bandwidth_radps: [2.6, 2.6, 50.0, 1.6],
    validity: "the level at which the model was identified: fits of 5.1 to 5.5",
    source: "thesis 5.1 to 5.4",
    ranges: |_, interface| {
        let (tilt, yaw) = (interface.tilt_max_rad, interface.yaw_rate_max_radps);
        [[-tilt, tilt], [-tilt, tilt], [-yaw, yaw], [0.0, interface.lift_max]]
    },
};

const VELOCITY: Entry = Entry {
    level: ActionLevel::Velocity,
    name: "velocity",
    about: "velocity along the room's axes, and yaw rate: what `send_velocity_world_setpoint` takes",
    channels: [
        channel("x_mps", "m/s", "along the x axis of the room"),
        channel("y_mps", "m/s", "along the y axis of the room"),
        channel("z_mps", "m/s", "up"),
        channel("yaw_rate_radps", "rad/s", "right-handed: positive turns counter-clockwise"),
    ],
    bandwidth_radps: [3.5, 3.5, 50.0, 50.0],
    validity: "the identified model behind the firmware's velocity loop, which sees the true state 50 times a second (firmware: an estimate, 100 times)",
    source: "Crazyflie firmware, position_controller_pid.c with the gains of platform_defaults_cf2.h",
    ranges: |_, interface| {
        let (v, yaw) = ([-SPEED_MAX_MPS, SPEED_MAX_MPS], interface.yaw_rate_max_radps);
        [v, v, v, [-yaw, yaw]]
    },
};

const POSITION: Entry = Entry {
    level: ActionLevel::Position,
    name: "position",
    about: "a place in the room and a heading: what `send_position_setpoint` takes",
    channels: [
        channel("x_m", "m", "place over the marker, along the x axis"),
        channel("y_m", "m", "place over the marker, along the y axis"),
        channel("z_m", "m", "height over the floor"),
        channel("yaw_rad", "rad", "heading, right-handed"),
    ],
    bandwidth_radps: [1.5, 1.5, 1.6, 6.0],
    validity: "as velocity, behind the firmware's position loop; a height form (5.3) gets its height as it is",
    source: "Crazyflie firmware, position_controller_pid.c with the gains of platform_defaults_cf2.h",
    ranges: |model, _| {
        let (half, pi) = (ROOM_M[0], std::f64::consts::PI);
        [[-half, half], [-half, half], [0.0, model.command.height_max.value], [-pi, pi]]
    },
};

const MOTOR_VALIDITY: &str =
    "the motor-level form, a data sheet's and not identified: its attitude step is compared with 5.1 below";

const BODY_RATES: Entry = Entry {
    level: ActionLevel::BodyRates,
    name: "body_rates",
    about: "rates about the body axes and a thrust, on the form `motors`",
    channels: [
        channel("roll_rate_radps", "rad/s", "right-handed about the nose"),
        channel("pitch_rate_radps", "rad/s", "positive lowers the nose"),
        channel("yaw_rate_radps", "rad/s", "right-handed: positive turns counter-clockwise"),
        channel("thrust_pwm", "1", "PWM of all motors, before the mixer adds what turns"),
    ],
    bandwidth_radps: [35.9, 35.9, 10.7, MOTOR_RADPS],
    validity: MOTOR_VALIDITY,
    source: "Crazyflie firmware, attitude_pid_controller.c with the gains of platform_defaults_cf2.h; Foerster 2015",
    ranges: |_, interface| {
        let (tilt, yaw) = (std::f64::consts::TAU, interface.yaw_rate_max_radps);
        [[-tilt, tilt], [-tilt, tilt], [-yaw, yaw], [0.0, interface.lift_max]]
    },
};

/// A motor follows with Foerster's pole.
const MOTOR_RADPS: f64 = 15.5;

const MOTORS: Entry = Entry {
    level: ActionLevel::Motors,
    name: "motors",
    about: "the PWM of each motor, on the form `motors`",
    channels: [
        channel("m1_pwm", "1", "front right, turns counter-clockwise"),
        channel("m2_pwm", "1", "back right, turns clockwise"),
        channel("m3_pwm", "1", "back left, turns counter-clockwise"),
        channel("m4_pwm", "1", "front left, turns clockwise"),
    ],
    bandwidth_radps: [MOTOR_RADPS; ACTION],
    validity: MOTOR_VALIDITY,
    source: "Foerster 2015: thrust curve, motor lag, inertia",
    ranges: |_, _| [[0.0, FULL_PWM]; ACTION],
};

impl Entry {
    /// Returns the interface of a model at this level, in the requested form if the level has it; nothing if the
    /// model lacks the form that the level needs.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model lacks the requested form.
    pub fn interface(&self, model: &Model, asked: Option<VerticalInput>) -> Result<Option<Interface>> {
        let lower = self.level.is_below_attitude();
        if lower && model.vertical.motors.is_none() {
            return Ok(None);
        }
        let input = self.level.input(model, asked.filter(|_| !lower))?;
        Interface::at_level(model, input, self.level).map(Some)
    }
}

/// Returns every action level; the first is the default.
pub fn registry() -> &'static [Entry] {
    const REGISTRY: &[Entry] = &[ATTITUDE, VELOCITY, POSITION, BODY_RATES, MOTORS];
    REGISTRY
}

impl ActionLevel {
    /// The level of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Self> {
        find_named("action level", name, registry(), |entry| entry.name).map(|entry| entry.level)
    }

    /// Its line of [`registry`].
    pub fn entry(self) -> &'static Entry {
        // the registry has a line for each level, which a test sees to
        registry().iter().find(|entry| entry.level == self).unwrap_or(&registry()[0])
    }

    /// Returns whether actions set a quantity below the attitude; only the motor-level form accepts these.
    pub fn is_below_attitude(self) -> bool {
        matches!(self, ActionLevel::BodyRates | ActionLevel::Motors)
    }

    /// Returns the height input that is commanded: the requested one, or the model's first that has this level.
    ///
    /// # Errors
    /// [`Error::Config`] if the model has none, or the requested one lacks this level.
    pub fn input(self, model: &Model, asked: Option<VerticalInput>) -> Result<VerticalInput> {
        if self.is_below_attitude() {
            return match asked {
                None | Some(VerticalInput::Motors) => Ok(VerticalInput::Motors),
                Some(other) => Err(Error::Config(format!(
                    "actions of the level {:?} are for the vertical form \"motors\", got {:?}, whose attitude \
                     loops are closed",
                    self.name(),
                    other.name()
                ))),
            };
        }
        model.input(asked)
    }

    /// Key in configurations.
    pub fn name(self) -> &'static str {
        self.entry().name
    }

    /// Returns whether this is the default level, which configurations leave out.
    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
    pub fn is_default(&self) -> bool {
        *self == ActionLevel::default()
    }
}

impl Serialize for ActionLevel {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for ActionLevel {
    fn deserialize<D: Deserializer<'de>>(from: D) -> std::result::Result<Self, D::Error> {
        ActionLevel::named(&String::deserialize(from)?).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_has_a_line_and_is_found_by_its_name() {
        for entry in registry() {
            assert_eq!(entry.level.entry().name, entry.name);
            assert_eq!(ActionLevel::named(entry.name).unwrap(), entry.level);
        }
        let error = ActionLevel::named("velocty").unwrap_err().to_string();
        assert!(error.contains("action level") && error.contains("did you mean \"velocity\""), "{error}");
    }

    #[test]
    fn an_action_is_its_set_point_and_back() {
        for entry in registry() {
            let interface =
                Interface::at_level(&Model::thesis(), VerticalInput::Motors, entry.level).unwrap();
            let ranges = interface.ranges();
            assert_eq!(ranges, (entry.ranges)(&Model::thesis(), &interface), "{}", entry.name);
            let action = [-1.0, 1.0, 0.25, -0.5];
            let set_point = interface.set_point(&action);
            assert!((set_point[0] - ranges[0][0]).abs() < 1e-12, "{}", entry.name);
            assert!((set_point[1] - ranges[1][1]).abs() < 1e-12, "{}", entry.name);
            let again = interface.action_of(&set_point);
            assert!(again.iter().zip(action).all(|(a, b)| (a - b).abs() < 1e-12), "{}", entry.name);
        }
    }
}
