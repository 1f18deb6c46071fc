//! The command interface: what an action of -1..1 sets, at each level.

use serde::{Deserialize, Serialize};

use super::{ACTION, ActionLevel};
use crate::error::{Error, Result};
use crate::model::{Model, VerticalInput};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, tabulate};

/// Commands of an action of 1, as numbers of the lanes.
#[derive(Debug, Clone, Copy)]
pub struct ActionScale<R> {
    tilt_rad: R,
    yaw_rate_radps: R,
    half_lift: R,
}

impl<R: Scalar> ActionScale<R> {
    /// The command of an action row.
    #[inline(always)]
    pub fn command(&self, a: &[R; ACTION]) -> Command<R> {
        Command {
            roll_rad: a[0] * self.tilt_rad,
            pitch_rad: a[1] * self.tilt_rad,
            yaw_rate_radps: a[2] * self.yaw_rate_radps,
            lift: (a[3] + R::from_f64(1.0)) * self.half_lift,
        }
    }
}

/// The command interface: what an action of -1..1 means.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interface {
    /// Height input that the fourth number of an action commands.
    #[serde(rename = "vertical")]
    pub input: VerticalInput,
    /// Roll and pitch that an action of 1 commands; of a model whose commands are no angles, rad/s or N m.
    pub tilt_max_rad: f64,
    /// In the vehicle's own sign (5.2): +1 turns clockwise on the thesis's Crazyflie.
    pub yaw_rate_max_radps: f64,
    /// -1 is 0, +1 is this: metres or PWM counts.
    pub lift_max: f64,
    /// PWM that carries the weight; zero for a height command.
    pub hover_lift: f64,
    /// +1 or -1: the direction in which a positive yaw-rate command turns, right-handed.
    pub yaw_sign: f64,
    /// Quantity that actions set, unless it is the attitude.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_point: Option<SetpointRange>,
}

/// Level and ranges of actions at another level than attitude.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SetpointRange {
    /// Which level.
    pub level: ActionLevel,
    /// Values set by actions of -1 and of 1, channel by channel of the level's entry.
    pub ranges: [[f64; 2]; ACTION],
}

impl Interface {
    /// Creates the interface of a model for one of its height inputs; actions are attitudes.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] if the model lacks that input.
    pub fn from_model(model: &Model, input: VerticalInput) -> Result<Self> {
        let hover = model.vertical(input)?.hover_pwm().filter(|_| input.is_pwm());
        let c = &model.command;
        Ok(Interface {
            input,
            tilt_max_rad: c.tilt.limit_si(c.tilt_max.value),
            yaw_rate_max_radps: c.yaw_rate_max.value.to_radians(),
            lift_max: if input.is_pwm() { c.pwm_max.value } else { c.height_max.value },
            hover_lift: hover.unwrap_or(0.0),
            yaw_sign: model.yaw.sign(),
            set_point: None,
        })
    }

    /// The factors of [`ActionScale::command`].
    #[inline(always)]
    pub fn action_scale<R: Scalar>(&self) -> ActionScale<R> {
        ActionScale {
            tilt_rad: R::from_f64(self.tilt_max_rad),
            yaw_rate_radps: R::from_f64(self.yaw_rate_max_radps),
            half_lift: R::from_f64(0.5 * self.lift_max),
        }
    }

    /// The command of an action row.
    pub fn command<R: Scalar>(&self, a: &[R; ACTION]) -> Command<R> {
        self.action_scale().command(a)
    }

    /// The action row of a command, cut off at -1..1.
    #[inline(always)]
    pub fn action<R: Scalar>(&self, u: &Command<R>) -> [R; ACTION] {
        [
            within_one(u.roll_rad * R::from_f64(1.0 / self.tilt_max_rad)),
            within_one(u.pitch_rad * R::from_f64(1.0 / self.tilt_max_rad)),
            within_one(u.yaw_rate_radps * R::from_f64(1.0 / self.yaw_rate_max_radps)),
            within_one(u.lift * R::from_f64(2.0 / self.lift_max) - R::from_f64(1.0)),
        ]
    }

    /// Creates the interface of a model for one of its height inputs and an action level.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model lacks that input.
    pub fn at_level(model: &Model, input: VerticalInput, level: ActionLevel) -> Result<Self> {
        let mut interface = Interface::from_model(model, input)?;
        if !level.is_default() {
            let ranges = (level.entry().ranges)(model, &interface);
            interface.set_point = Some(SetpointRange { level, ranges });
        }
        Ok(interface)
    }

    /// Returns the action level.
    pub fn level(&self) -> ActionLevel {
        self.set_point.map_or(ActionLevel::Attitude, |set_point| set_point.level)
    }

    /// Returns the values set by actions of -1 and of 1, channel by channel of [`ActionLevel::entry`].
    pub fn ranges(&self) -> [[f64; 2]; ACTION] {
        let [tilt, yaw] = [self.tilt_max_rad, self.yaw_rate_max_radps];
        let attitude = [[-tilt, tilt], [-tilt, tilt], [-yaw, yaw], [0.0, self.lift_max]];
        self.set_point.map_or(attitude, |set_point| set_point.ranges)
    }

    /// The set-point of an action row: numbers in the units of the level's channels.
    #[inline(always)]
    pub fn set_point<R: Scalar>(&self, action: &[R; ACTION]) -> [R; ACTION] {
        let ranges = self.ranges();
        tabulate(
            #[inline(always)]
            |i| {
                let [low, high] = ranges[i];
                R::from_f64(0.5 * (low + high)) + R::from_f64(0.5 * (high - low)) * action[i]
            },
        )
    }

    /// The action row of a set-point, cut off at -1..1.
    pub fn action_of<R: Scalar>(&self, set_point: &[R; ACTION]) -> [R; ACTION] {
        let ranges = self.ranges();
        tabulate(|i| {
            let [low, high] = ranges[i];
            let share = (set_point[i] - R::from_f64(0.5 * (low + high))) * R::from_f64(2.0 / (high - low));
            within_one(share)
        })
    }

    /// The action in force before an episode that begins at `x`, at rest, with the command `u`.
    #[inline(always)]
    pub(crate) fn action_before<R: Scalar>(&self, x: &State<R>, u: &Command<R>) -> [R; ACTION] {
        let zero = R::zero();
        match self.level() {
            ActionLevel::Attitude => self.action(u),
            ActionLevel::Velocity => self.action_of(&[zero; ACTION]),
            ActionLevel::Position => {
                let [x_m, y_m, z_m] = x.pos_m;
                self.action_of(&[x_m, y_m, z_m, x.att_rad[2]])
            }
            ActionLevel::BodyRates => self.action_of(&[zero, zero, zero, u.lift]),
            ActionLevel::Motors => self.action_of(&[u.lift; ACTION]),
        }
    }
}

/// An action's number is cut off at -1..1.
#[inline(always)]
fn within_one<R: Scalar>(share: R) -> R {
    share.clamp(R::from_f64(-1.0), R::from_f64(1.0))
}

/// # Errors
/// [`Error::Config`] unless actions are attitudes, which `who` commands.
pub fn check_attitude(who: &str, interface: &Interface) -> Result<()> {
    match interface.level() {
        ActionLevel::Attitude => Ok(()),
        level => Err(Error::Config(format!(
            "{who} commands attitudes, and the actions of this environment are of the level {:?}: make it with \
             action=\"attitude\" (--action attitude)",
            level.name()
        ))),
    }
}
