//! The vertical forms of a model: height over command, one form for each input.

use serde::{Deserialize, Serialize};

use super::{ANY, AxisForm, Model, NOT_NEGATIVE, POSITIVE, Quantity, or_zero};
use crate::error::{Error, Result, find_named, unknown};
use crate::tree::is_default;

/// Counts at which a motor is driven in full.
pub const FULL_PWM: f64 = 65_535.0;

/// Which of the model's height inputs is commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", try_from = "String")]
pub enum VerticalInput {
    /// The height, in metres (thesis 5.3).
    Height,
    /// The thrust PWM, on the first-order form (thesis 5.4).
    Pwm,
    /// The thrust PWM, on the acceleration form.
    Thrust,
    /// The thrust PWM, on the motor-level form, whose tilt and yaw are its own too.
    Motors,
}

impl VerticalInput {
    /// Returns the name in model files.
    pub fn name(self) -> &'static str {
        match self {
            VerticalInput::Height => "height",
            VerticalInput::Pwm => "pwm",
            VerticalInput::Thrust => "thrust",
            VerticalInput::Motors => "motors",
        }
    }

    /// Every input.
    pub const ALL: [VerticalInput; 4] =
        [VerticalInput::Height, VerticalInput::Pwm, VerticalInput::Thrust, VerticalInput::Motors];

    /// The input of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Self> {
        find_named("vertical form", name, Self::ALL, |input| input.name())
    }

    /// Returns whether the command is a thrust PWM (counts) rather than a height (metres).
    pub fn is_pwm(self) -> bool {
        self != VerticalInput::Height
    }
}

impl TryFrom<String> for VerticalInput {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        Self::named(&name)
    }
}

/// Variable of a flight log with the PWM that drives the forms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PwmSource {
    /// In the thrust command, before the firmware makes up for the battery's voltage.
    #[default]
    Command,
    /// In what the motors get: their mean PWM times the battery's voltage, over the reference voltage. A
    /// simulated vehicle makes up for its voltage, so there it is the command.
    Motors,
}

impl PwmSource {
    /// Every source.
    pub const ALL: [PwmSource; 2] = [PwmSource::Command, PwmSource::Motors];

    /// Returns the name in model files.
    pub fn name(self) -> &'static str {
        match self {
            PwmSource::Command => "command",
            PwmSource::Motors => "motors",
        }
    }

    /// The source of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Self> {
        find_named("source of the PWM", name, Self::ALL, |source| source.name())
    }
}

/// height / command
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "snake_case", deny_unknown_fields)]
pub enum Vertical {
    /// z' = gain (u - offset) - pole z + w, w' = push - push_damping w   (thesis 5.3, 5.4). The identified
    /// form has velocity for its input, so a push (an acceleration) needs a lag of its own, `w`, which is
    /// zero without effects.
    FirstOrder {
        /// Climb rate per input: 1/s for a height command, m/s for PWM counts.
        gain: Quantity,
        /// Decay rate of the height, 1/s.
        pole: Quantity,
        /// Input at which the height settles at zero, in metres or PWM counts; 0 unless given.
        offset: Option<Quantity>,
        /// Input that carries the weight, in PWM counts; needed for a PWM form.
        hover: Option<Quantity>,
        /// Decay rate of `w`, 1/s.
        push_damping: Quantity,
    },
    /// z'' = gain (u - offset) - damping z' - stiffness z + push   (thesis 4.15)
    SecondOrder {
        /// Upward acceleration per input: 1/s^2 for a height command, m/s^2 for PWM counts.
        gain: Quantity,
        /// Deceleration per climb rate, 1/s.
        damping: Quantity,
        /// Deceleration per height, 1/s^2.
        stiffness: Quantity,
        /// Input at which the height settles at zero, in metres or PWM counts; 0 unless given.
        offset: Option<Quantity>,
        /// Input that carries the weight, in PWM counts; needed for a PWM form.
        hover: Option<Quantity>,
    },
    /// z'' = gravity (u / hover - 1) - heave z' + push
    Thrust {
        /// Input that carries the weight, in PWM counts.
        hover: Quantity,
        /// Deceleration per climb rate, 1/s.
        heave: Quantity,
    },
    /// Thrust and torques of four motors (see [`Motors`]).
    Motors(Box<Motors>),
}

/// A board's attitude and rate loops, by the gains of its firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum AttitudeLoop {
    /// The loop of the Crazyflie 2.0, 2.1 and 2.1+.
    #[default]
    #[serde(rename = "crazyflie-firmware")]
    Firmware,
    /// The loop of the Crazyflie 2.1 Brushless.
    #[serde(rename = "crazyflie-firmware-brushless")]
    FirmwareBrushless,
}

impl AttitudeLoop {
    /// Every loop.
    pub const ALL: [AttitudeLoop; 2] = [AttitudeLoop::Firmware, AttitudeLoop::FirmwareBrushless];

    /// Returns the name in model files and data sheets.
    pub fn name(self) -> &'static str {
        match self {
            AttitudeLoop::Firmware => "crazyflie-firmware",
            AttitudeLoop::FirmwareBrushless => "crazyflie-firmware-brushless",
        }
    }

    /// The loop of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Self> {
        find_named("attitude loop", name, Self::ALL, |each| each.name())
    }
}

/// A rigid body with four motors on its diagonals, each with a lag, a thrust curve and limits, behind the
/// firmware's mixer and loops. Numbers of a data sheet, not identified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motors {
    /// PWM of each motor that carries the weight.
    pub hover: Quantity,
    /// Share of the thrust at full PWM that grows with the PWM; the rest grows with its square.
    pub linear_share: Quantity,
    /// The firmware's loops that command the motors; those of the Crazyflie 2.0 unless given.
    #[serde(default, skip_serializing_if = "is_default")]
    pub attitude_loop: AttitudeLoop,
    /// Time constant of a motor, s.
    pub lag: Quantity,
    /// Time constant of a motor that slows down, s; `lag` unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag_falling: Option<Quantity>,
    /// Moment of inertia about the roll axis, kg m^2, and about the pitch axis unless that is given.
    pub tilt_inertia: Quantity,
    /// Moment of inertia about the pitch axis, kg m^2; `tilt_inertia` unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pitch_inertia: Option<Quantity>,
    /// Moment of inertia about the yaw axis, kg m^2.
    pub yaw_inertia: Quantity,
    /// Torque about the vertical per thrust, m.
    pub torque_per_thrust: Quantity,
    /// Deceleration per climb rate by the air through the propellers, 1/s.
    pub heave: Quantity,
}

impl Motors {
    /// Moments of inertia about the roll, pitch and yaw axis.
    pub fn inertias_kgm2(&self) -> [f64; 3] {
        let pitch = self.pitch_inertia.as_ref().unwrap_or(&self.tilt_inertia);
        [self.tilt_inertia.value, pitch.value, self.yaw_inertia.value]
    }

    /// Time constants of a motor that speeds up, and that slows down.
    pub fn lags_s(&self) -> [f64; 2] {
        [self.lag.value, self.lag_falling.as_ref().unwrap_or(&self.lag).value]
    }
}

/// The height inputs that the model has; at least one.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Verticals {
    /// The form that is driven by default: the one in which the vehicle was identified. The first that the model has,
    /// unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<VerticalInput>,
    /// Source of the PWM of the forms `pwm` and `thrust` in a flight log: the one that the vehicle was identified
    /// with.
    #[serde(default, skip_serializing_if = "is_default")]
    pub pwm_source: PwmSource,
    /// Form with the commanded height in metres for its input (thesis 5.3).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<Vertical>,
    /// Form of first or second order with the thrust PWM for its input (thesis 5.4).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pwm: Option<Vertical>,
    /// Form in which the thrust PWM accelerates the vehicle; a flight log can be fitted to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thrust: Option<Vertical>,
    /// The motor-level form: it has attitude loops of its own, besides those of roll, pitch and yaw.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motors: Option<Vertical>,
}

impl Vertical {
    /// Returns the differential equation of the height, with `gravity` in m/s^2.
    pub fn form(&self, gravity: f64) -> AxisForm {
        match self {
            Vertical::FirstOrder { gain, pole, offset, push_damping, .. } => {
                AxisForm::first_order(gain.value, pole.value, or_zero(offset), push_damping.value)
            }
            Vertical::SecondOrder { gain, damping, stiffness, offset, .. } => {
                AxisForm::second_order(gain.value, damping.value, stiffness.value, or_zero(offset))
            }
            Vertical::Thrust { hover, heave } => {
                AxisForm::second_order(gravity / hover.value, heave.value, 0.0, hover.value)
            }
            // for small changes of the thrust
            Vertical::Motors(form) => {
                AxisForm::second_order(gravity * form.slope(), form.heave.value, 0.0, form.hover.value)
            }
        }
    }
    /// Deceleration per climb rate by the air through the propellers; 0 for forms that do not know it.
    pub fn heave_ps(&self) -> f64 {
        match self {
            Vertical::Thrust { heave, .. } => heave.value,
            Vertical::Motors(form) => form.heave.value,
            Vertical::FirstOrder { .. } | Vertical::SecondOrder { .. } => 0.0,
        }
    }
    /// The PWM that carries the weight; infinite where the command is a height.
    pub fn hover_pwm(&self) -> Option<f64> {
        match self {
            Vertical::FirstOrder { hover, .. } | Vertical::SecondOrder { hover, .. } => {
                hover.as_ref().map(|q| q.value)
            }
            Vertical::Thrust { hover, .. } => Some(hover.value),
            Vertical::Motors(form) => Some(form.hover.value),
        }
    }
}

/// A number of a model: its path, the quantity, its unit and the interval it must lie in.
pub(crate) type CheckedQuantity<'a> = (String, &'a Quantity, &'static str, [f64; 2]);

impl Verticals {
    /// The form of an input, if the model has it.
    pub(crate) fn form(&self, input: VerticalInput) -> Option<&Vertical> {
        match input {
            VerticalInput::Height => self.height.as_ref(),
            VerticalInput::Pwm => self.pwm.as_ref(),
            VerticalInput::Thrust => self.thrust.as_ref(),
            VerticalInput::Motors => self.motors.as_ref(),
        }
    }

    /// Returns the numbers in the order of [`Model::parameters`].
    pub(crate) fn quantities(&self) -> Vec<CheckedQuantity<'_>> {
        let mut all = Vec::new();
        for which in VerticalInput::ALL {
            let path = |field: &str| format!("vertical.{}.{field}", which.name());
            let [first, second, input] = match which {
                VerticalInput::Height => ["1/s", "1/s^2", "m"],
                VerticalInput::Pwm => ["m/s", "m/s^2", "1"],
                VerticalInput::Thrust | VerticalInput::Motors => ["", "", "1"],
            };
            match self.form(which) {
                None => {}
                Some(Vertical::FirstOrder { gain, pole, offset, hover, push_damping }) => {
                    all.push((path("gain"), gain, first, POSITIVE));
                    all.push((path("pole"), pole, "1/s", NOT_NEGATIVE));
                    all.push((path("push_damping"), push_damping, "1/s", POSITIVE));
                    all.extend(offset.iter().map(|q| (path("offset"), q, input, ANY)));
                    all.extend(hover.iter().map(|q| (path("hover"), q, input, POSITIVE)));
                }
                Some(Vertical::SecondOrder { gain, damping, stiffness, offset, hover }) => {
                    all.push((path("gain"), gain, second, POSITIVE));
                    all.push((path("damping"), damping, "1/s", NOT_NEGATIVE));
                    all.push((path("stiffness"), stiffness, "1/s^2", NOT_NEGATIVE));
                    all.extend(offset.iter().map(|q| (path("offset"), q, input, ANY)));
                    all.extend(hover.iter().map(|q| (path("hover"), q, input, POSITIVE)));
                }
                Some(Vertical::Thrust { hover, heave }) => {
                    all.push((path("hover"), hover, "1", POSITIVE));
                    all.push((path("heave"), heave, "1/s", NOT_NEGATIVE));
                }
                Some(Vertical::Motors(form)) => {
                    all.push((path("hover"), &form.hover, "1", [1.0, 65_000.0]));
                    all.push((path("linear_share"), &form.linear_share, "1", [0.0, 1.0]));
                    all.push((path("lag"), &form.lag, "s", [1e-3, 1.0]));
                    all.extend(form.lag_falling.iter().map(|q| (path("lag_falling"), q, "s", [1e-3, 1.0])));
                    all.push((path("tilt_inertia"), &form.tilt_inertia, "kg m^2", POSITIVE));
                    all.extend(
                        form.pitch_inertia.iter().map(|q| (path("pitch_inertia"), q, "kg m^2", POSITIVE)),
                    );
                    all.push((path("yaw_inertia"), &form.yaw_inertia, "kg m^2", POSITIVE));
                    all.push((path("torque_per_thrust"), &form.torque_per_thrust, "m", POSITIVE));
                    all.push((path("heave"), &form.heave, "1/s", NOT_NEGATIVE));
                }
            }
        }
        all
    }
}

impl Model {
    pub(crate) fn check_verticals(&self) -> Result<()> {
        if matches!(self.vertical.height, Some(Vertical::Thrust { .. })) {
            return Err(self.problem(
                "vertical.height has the form \"thrust\", whose input is a PWM: name it vertical.thrust"
                    .into(),
            ));
        }
        let forms =
            || VerticalInput::ALL.into_iter().filter_map(|input| Some((input, self.vertical.form(input)?)));
        for (input, form) in forms() {
            let is_motors = matches!(form, Vertical::Motors(_));
            if is_motors && input != VerticalInput::Motors {
                return Err(self.problem(format!(
                    "vertical.{} has the form \"motors\", which has attitude loops of its own: name it \
                     vertical.motors",
                    input.name()
                )));
            }
            if !is_motors && input == VerticalInput::Motors {
                return Err(self.problem("vertical.motors has another form than \"motors\"".into()));
            }
        }
        if let Some((input, _)) = forms().find(|(input, form)| input.is_pwm() && form.hover_pwm().is_none()) {
            let problem = format!("vertical.{} needs hover, the PWM that carries the weight", input.name());
            return Err(self.problem(problem));
        }
        if self.inputs().is_empty() {
            return Err(self.problem("vertical has no form: give height, pwm or thrust".into()));
        }
        if let Some(default) = self.vertical.default.filter(|input| self.vertical(*input).is_err()) {
            return Err(self
                .problem(format!("vertical.default is {:?}, a form that the model lacks", default.name())));
        }
        Ok(())
    }

    /// Returns the height input that is commanded: the requested one, or the default.
    ///
    /// # Errors
    /// [`Error::Config`] if the model has none.
    pub fn input(&self, asked: Option<VerticalInput>) -> Result<VerticalInput> {
        // a checked model has at least one input
        asked
            .or(self.vertical.default)
            .or(self.inputs().first().copied())
            .ok_or_else(|| Error::Config("the model has no vertical form".into()))
    }

    /// The identified height inputs that this model has, the default first; [`VerticalInput::Motors`] is none
    /// of them.
    pub fn inputs(&self) -> Vec<VerticalInput> {
        let is_there = |input: &VerticalInput| self.vertical.form(*input).is_some();
        let mut inputs = vec![VerticalInput::Height, VerticalInput::Pwm, VerticalInput::Thrust];
        inputs.retain(is_there);
        inputs.sort_by_key(|input| Some(*input) != self.vertical.default);
        inputs
    }

    /// The declared form, if it is one of [`Model::inputs`]: no log of one command for all motors drives
    /// [`VerticalInput::Motors`].
    pub fn default_input(&self) -> Option<VerticalInput> {
        self.vertical.default.filter(|input| *input != VerticalInput::Motors)
    }

    /// The vertical form for an input.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model has no such form.
    pub fn vertical(&self, input: VerticalInput) -> Result<&Vertical> {
        self.vertical.form(input).ok_or_else(|| {
            let known = VerticalInput::ALL.into_iter().filter(|input| self.vertical.form(*input).is_some());
            unknown("vertical form of this model", input.name(), known.map(VerticalInput::name))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::THESIS_TOML;

    #[test]
    fn a_model_says_where_a_log_holds_its_pwm() {
        assert_eq!(Model::thesis().vertical.pwm_source, PwmSource::Command);
        assert!(!Model::thesis().to_toml().unwrap().contains("pwm_source"));
        let mut model = Model::thesis();
        model.vertical.pwm_source = PwmSource::Motors;
        let again = Model::parse(&model.to_toml().unwrap()).unwrap();
        assert_eq!(again.vertical.pwm_source, PwmSource::Motors);
        let text = format!("{THESIS_TOML}\n[vertical]\npwm_source = \"rotors\"\n");
        let refused = Model::parse(&text).unwrap_err().to_string();
        assert!(refused.contains("rotors") && refused.contains("motors"), "{refused}");
        assert_eq!(PwmSource::ALL.map(|source| PwmSource::named(source.name()).unwrap()), PwmSource::ALL);
        assert!(PwmSource::named("motor").unwrap_err().to_string().contains("motors"));
    }
}
