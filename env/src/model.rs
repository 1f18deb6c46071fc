//! A model is data: transfer functions with units and provenance, read from one TOML or JSON text. The
//! thesis's is built in.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::config::EffectTable;
use crate::error::{Error, Result, unknown};
use crate::identified::IdentifiedVehicle;
pub use crate::state_space::StateSpace;

/// The text of the model that the thesis identified.
pub const THESIS_TOML: &str = include_str!("../models/thesis.toml");

/// A number with its unit and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantity {
    /// Amount in `unit`.
    pub value: f64,
    /// Symbol of the unit; each path of a model file demands a certain one.
    pub unit: String,
    /// Origin, in free text: an equation, a table, a measurement.
    pub source: String,
}

/// angle / commanded angle = gain / (s^2 + damping s + stiffness)   (thesis 4.4, 5.1)
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tilt {
    /// Angular acceleration per commanded angle, 1/s^2.
    pub gain: Quantity,
    /// Angular deceleration per rate, 1/s.
    pub damping: Quantity,
    /// Angular deceleration per angle, 1/s^2; `gain / stiffness` is the static gain.
    pub stiffness: Quantity,
}

/// yaw / commanded yaw rate
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "snake_case", deny_unknown_fields)]
pub enum Yaw {
    /// gain / s   (thesis 5.2)
    Integrator {
        /// Yaw rate per commanded yaw rate, pure number; -1 in the thesis.
        gain: Quantity,
    },
    /// gain * bandwidth / (s (s + bandwidth)): a first-order loop on the yaw rate
    Rate {
        /// Static yaw rate per commanded yaw rate, pure number.
        gain: Quantity,
        /// Inverse time constant of the rate loop, 1/s.
        bandwidth: Quantity,
    },
    /// gain / (s^2 + damping s + stiffness)   (thesis 4.15)
    SecondOrder {
        /// Angular acceleration per commanded yaw rate, 1/s.
        gain: Quantity,
        /// Angular deceleration per rate, 1/s.
        damping: Quantity,
        /// Angular deceleration per angle, 1/s^2.
        stiffness: Quantity,
    },
}

/// velocity / angle = gravity / (s + drag)   (thesis 4.10; drag is k1/m of 4.15)
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lateral {
    /// Horizontal acceleration per tilt angle in radians, m/s^2.
    pub gravity: Quantity,
    /// Horizontal deceleration per velocity, 1/s; 0 in the thesis.
    pub drag: Quantity,
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
}

/// The height inputs that the model has; at least one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Verticals {
    /// The form that is driven unless another is asked for: where the vehicle was identified. The first that
    /// the model has, unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<VerticalInput>,
    /// Form with the commanded height in metres for its input (thesis 5.3).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<Vertical>,
    /// Form of first or second order with the thrust PWM for its input (thesis 5.4).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pwm: Option<Vertical>,
    /// Form in which the thrust PWM accelerates the vehicle; a flight log can be fitted to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thrust: Option<Vertical>,
}

/// What the command interface accepts: the range that an action of -1..1 is mapped to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandLimits {
    /// Largest roll and pitch angle, deg.
    pub tilt_max: Quantity,
    /// Largest yaw rate to either side, deg/s.
    pub yaw_rate_max: Quantity,
    /// Largest commanded height, m; the smallest is 0.
    pub height_max: Quantity,
    /// Largest thrust PWM, counts; the smallest is 0.
    pub pwm_max: Quantity,
}

/// Constants of the airframe that effects need.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Airframe {
    /// Mass as flown, kg, camera and casing included.
    pub mass: Quantity,
    /// Radius of one propeller, m.
    pub rotor_radius: Quantity,
    /// Distance from the centre to a motor, m.
    pub arm: Quantity,
    /// Charge of the full battery, C.
    pub battery_capacity: Quantity,
    /// Battery current of a hover, A.
    pub hover_current: Quantity,
    /// Voltage at which the model's thrust holds; that of a full cell, 4.2 V, unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub battery_reference: Option<Quantity>,
    /// The vehicle with which the forms were identified; this one unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identified: Option<IdentifiedVehicle>,
}

/// The clocks of the rig, which are part of the model: 30 Hz frames do not fall on 50 Hz ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Rate of commands and of the controller, Hz.
    pub control: Quantity,
    /// Rate of the inertial sensors, Hz.
    pub imu: Quantity,
    /// Rate of camera frames, Hz.
    pub camera: Quantity,
}

/// A quadrotor as identified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// Version of the file format; 1 is the only one.
    pub schema: u32,
    /// Title of the vehicle in reports and errors.
    pub name: String,
    /// Free text for users.
    #[serde(default)]
    pub description: String,
    /// Attitude dynamics about the body x axis.
    pub roll: Tilt,
    /// Attitude dynamics about the body y axis.
    pub pitch: Tilt,
    /// Heading dynamics.
    pub yaw: Yaw,
    /// Horizontal motion that a tilt causes.
    pub lateral: Lateral,
    /// Height dynamics, one form for each input.
    pub vertical: Verticals,
    /// Ranges of the commands.
    pub command: CommandLimits,
    /// Mass, lengths and battery.
    pub vehicle: Airframe,
    /// Rates of control and sensors.
    pub rig: Rig,
    /// Effects that belong to this vehicle and are on unless the configuration says otherwise.
    #[serde(
        default,
        skip_serializing_if = "BTreeMap::is_empty",
        deserialize_with = "crate::config::effect_table"
    )]
    pub effects: EffectTable,
}

/// Which of the model's height inputs is commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VerticalInput {
    /// The height, in metres (thesis 5.3).
    Height,
    /// The thrust PWM, on the first-order form (thesis 5.4).
    Pwm,
    /// The thrust PWM, on the acceleration form.
    Thrust,
}

impl VerticalInput {
    /// As model files spell it.
    pub fn name(self) -> &'static str {
        match self {
            VerticalInput::Height => "height",
            VerticalInput::Pwm => "pwm",
            VerticalInput::Thrust => "thrust",
        }
    }

    /// Every input.
    pub const ALL: [VerticalInput; 3] = [VerticalInput::Height, VerticalInput::Pwm, VerticalInput::Thrust];

    /// The input of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|input| input.name() == name);
        found.ok_or_else(|| unknown("vertical form", name, Self::ALL.map(Self::name)))
    }

    /// Whether the command is a thrust PWM (counts) rather than a height (metres).
    pub fn is_pwm(self) -> bool {
        self != VerticalInput::Height
    }
}

/// One axis as z'' or z' = ... in the two states (x, w): x' = a_xx x + a_xw w + b_x u + e_x push, likewise w;
/// rate = x'.
#[derive(Debug, Clone, Copy)]
pub struct AxisForm {
    /// Coefficients of x and w: the rows `[a_xx, a_xw]` and `[a_wx, a_ww]`.
    pub a: [[f64; 2]; 2],
    /// Coefficients of the input above its offset: `[b_x, b_w]`.
    pub u: [f64; 2],
    /// Coefficients of the push, an acceleration: `[e_x, e_w]`.
    pub push: [f64; 2],
    /// Amount taken off the input first, in the unit of the input.
    pub offset: f64,
}

impl AxisForm {
    /// x'' = gain (u - offset) - damping x' - stiffness x + push
    fn second_order(gain: f64, damping: f64, stiffness: f64, offset: f64) -> Self {
        AxisForm { a: [[0.0, 1.0], [-stiffness, -damping]], u: [0.0, gain], push: [0.0, 1.0], offset }
    }
    /// x' = gain (u - offset) - pole x + w, w' = push - push_damping w
    fn first_order(gain: f64, pole: f64, offset: f64, push_damping: f64) -> Self {
        AxisForm { a: [[-pole, 1.0], [0.0, -push_damping]], u: [gain, 0.0], push: [0.0, 1.0], offset }
    }
    pub(crate) fn lags_push(&self) -> bool {
        self.a[0] != [0.0, 1.0] || self.u[0] != 0.0
    }
}

/// Push damping of the yaw integrator (thesis 5.2): a torque acts through the rate loop that the integrator
/// idealises; 25 1/s is the bandwidth of the Crazyflie's yaw-rate loop used by the declared models of the
/// simulated flights.
const YAW_PUSH_DAMPING: f64 = 25.0;

fn or_zero(q: &Option<Quantity>) -> f64 {
    q.as_ref().map_or(0.0, |q| q.value)
}

impl Yaw {
    /// Returns the differential equation of the yaw angle; a push is an angular acceleration.
    pub fn form(&self) -> AxisForm {
        match self {
            Yaw::Integrator { gain } => AxisForm::first_order(gain.value, 0.0, 0.0, YAW_PUSH_DAMPING),
            Yaw::Rate { gain, bandwidth } => {
                AxisForm::second_order(gain.value * bandwidth.value, bandwidth.value, 0.0, 0.0)
            }
            Yaw::SecondOrder { gain, damping, stiffness } => {
                AxisForm::second_order(gain.value, damping.value, stiffness.value, 0.0)
            }
        }
    }
    /// +1 or -1: the sign with which a commanded yaw rate turns the vehicle in the right-handed frame.
    pub fn sign(&self) -> f64 {
        let (Yaw::Integrator { gain } | Yaw::Rate { gain, .. } | Yaw::SecondOrder { gain, .. }) = self;
        if gain.value < 0.0 { -1.0 } else { 1.0 }
    }
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
        }
    }
    /// The PWM that carries the weight; infinite where the command is a height.
    pub fn hover_pwm(&self) -> Option<f64> {
        match self {
            Vertical::FirstOrder { hover, .. } | Vertical::SecondOrder { hover, .. } => {
                hover.as_ref().map(|q| q.value)
            }
            Vertical::Thrust { hover, .. } => Some(hover.value),
        }
    }
}

impl Model {
    /// The thesis's model.
    pub fn thesis() -> Model {
        // the built-in text is covered by a test
        Model::parse(THESIS_TOML).unwrap_or_else(|error| unreachable!("built-in model: {error}"))
    }

    /// Read a model from TOML or JSON (told apart by the first character).
    ///
    /// # Errors
    /// [`Error::Model`] with line and column for a syntax error, or naming the quantity whose unit or value
    /// is wrong.
    pub fn parse(text: &str) -> Result<Model> {
        let bad = |problem: String| Error::Model { name: "text".into(), problem };
        let model: Model = if text.trim_start().starts_with('{') {
            serde_json::from_str(text).map_err(|e| bad(e.to_string()))?
        } else {
            toml::from_str(text).map_err(|e| bad(e.to_string()))?
        };
        model.check()?;
        model.scale_to_vehicle()
    }

    /// As TOML.
    ///
    /// # Errors
    /// [`Error::Model`] if a value cannot be written.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| self.problem(e.to_string()))
    }

    fn problem(&self, problem: String) -> Error {
        Error::Model { name: self.name.clone(), problem }
    }

    /// Every quantity with its path, the unit it must have and the interval it must lie in.
    fn quantities(&self) -> Vec<(String, &Quantity, &'static str, [f64; 2])> {
        const POSITIVE: [f64; 2] = [f64::MIN_POSITIVE, 1e6];
        const NOT_NEGATIVE: [f64; 2] = [0.0, 1e6];
        const ANY: [f64; 2] = [-1e6, 1e6];
        let mut all = Vec::new();
        for (name, tilt) in [("roll", &self.roll), ("pitch", &self.pitch)] {
            all.push((format!("{name}.gain"), &tilt.gain, "1/s^2", POSITIVE));
            all.push((format!("{name}.damping"), &tilt.damping, "1/s", NOT_NEGATIVE));
            all.push((format!("{name}.stiffness"), &tilt.stiffness, "1/s^2", NOT_NEGATIVE));
        }
        match &self.yaw {
            Yaw::Integrator { gain } => all.push(("yaw.gain".into(), gain, "1", ANY)),
            Yaw::Rate { gain, bandwidth } => {
                all.push(("yaw.gain".into(), gain, "1", ANY));
                all.push(("yaw.bandwidth".into(), bandwidth, "1/s", POSITIVE));
            }
            Yaw::SecondOrder { gain, damping, stiffness } => {
                all.push(("yaw.gain".into(), gain, "1/s", ANY));
                all.push(("yaw.damping".into(), damping, "1/s", NOT_NEGATIVE));
                all.push(("yaw.stiffness".into(), stiffness, "1/s^2", NOT_NEGATIVE));
            }
        }
        all.push(("lateral.gravity".into(), &self.lateral.gravity, "m/s^2", POSITIVE));
        all.push(("lateral.drag".into(), &self.lateral.drag, "1/s", NOT_NEGATIVE));
        let verticals = [
            ("height", &self.vertical.height, "1/s", "1/s^2", "m"),
            ("pwm", &self.vertical.pwm, "m/s", "m/s^2", "1"),
            ("thrust", &self.vertical.thrust, "", "", "1"),
        ];
        for (name, vertical, first, second, input) in verticals {
            let path = |field: &str| format!("vertical.{name}.{field}");
            match vertical {
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
            }
        }
        all.push(("command.tilt_max".into(), &self.command.tilt_max, "deg", [0.1, 80.0]));
        all.push(("command.yaw_rate_max".into(), &self.command.yaw_rate_max, "deg/s", [0.1, 2000.0]));
        all.push(("command.height_max".into(), &self.command.height_max, "m", [0.1, 1000.0]));
        all.push(("command.pwm_max".into(), &self.command.pwm_max, "1", [1.0, 65535.0]));
        all.push(("vehicle.mass".into(), &self.vehicle.mass, "kg", POSITIVE));
        all.push(("vehicle.rotor_radius".into(), &self.vehicle.rotor_radius, "m", POSITIVE));
        all.push(("vehicle.arm".into(), &self.vehicle.arm, "m", POSITIVE));
        all.push(("vehicle.battery_capacity".into(), &self.vehicle.battery_capacity, "C", POSITIVE));
        all.push(("vehicle.hover_current".into(), &self.vehicle.hover_current, "A", POSITIVE));
        all.extend(
            self.vehicle
                .battery_reference
                .iter()
                .map(|q| ("vehicle.battery_reference".into(), q, "V", [1.0, 100.0])),
        );
        for (name, q) in
            [("control", &self.rig.control), ("imu", &self.rig.imu), ("camera", &self.rig.camera)]
        {
            all.push((format!("rig.{name}"), q, "Hz", [1.0, 2000.0]));
        }
        all
    }

    /// Whether the second state of the vertical and of the yaw form is a lagged push, and not the rate
    /// itself: a state of its own, that no measured rate tells.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model lacks the vertical input.
    pub fn lags_push(&self, input: VerticalInput) -> Result<[bool; 2]> {
        let form = self.vertical(input)?.form(self.lateral.gravity.value);
        Ok([form, self.yaw.form()].map(|form| form.lags_push()))
    }

    /// The numbers of the model by path ("roll.gain", "vertical.thrust.hover"), each with value and unit.
    pub fn parameters(&self) -> Vec<(String, f64, &'static str)> {
        self.quantities().into_iter().map(|(path, q, unit, _)| (path, q.value, unit)).collect()
    }

    /// One of [`Model::parameters`].
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn parameter(&self, path: &str) -> Result<f64> {
        let all = self.quantities();
        let found = all.iter().find(|(name, ..)| name == path);
        found.map(|(_, q, ..)| q.value).ok_or_else(|| {
            unknown("parameter of the model", path, all.iter().map(|(name, ..)| name.as_str()))
        })
    }

    /// A copy with another value for one of [`Model::parameters`], whose forms then hold for its vehicle.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal; [`Error::Model`] for a value outside its interval.
    pub fn with_parameter(&self, path: &str, value: f64) -> Result<Model> {
        self.parameter(path)?;
        let bad = |e: serde_json::Error| self.problem(e.to_string());
        let mut tree = serde_json::to_value(self).map_err(bad)?;
        let pointer = format!("/{}/value", path.replace('.', "/"));
        if let Some(slot) = tree.pointer_mut(&pointer) {
            *slot = value.into();
        }
        let mut model: Model = serde_json::from_value(tree).map_err(bad)?;
        model.mark_identified();
        model.check()?;
        Ok(model)
    }

    fn check(&self) -> Result<()> {
        if self.schema != 1 {
            return Err(self.problem(format!("schema is {}, this program reads schema 1", self.schema)));
        }
        // those of the identified vehicle are no parameters: a flight does not depend on them
        let identified = self.vehicle.identified.iter().flat_map(IdentifiedVehicle::quantities);
        for (path, q, unit, [low, high]) in self.quantities().into_iter().chain(identified) {
            if q.unit != unit {
                return Err(self.problem(format!("{path} has the unit {:?}, expected {unit:?}", q.unit)));
            }
            if !(low..=high).contains(&q.value) {
                return Err(self.problem(format!("{path} is {}, expected {low} to {high}", q.value)));
            }
        }
        if matches!(self.vertical.height, Some(Vertical::Thrust { .. })) {
            return Err(self.problem(
                "vertical.height has the form \"thrust\", whose input is a PWM: name it vertical.thrust"
                    .into(),
            ));
        }
        for (name, vertical) in [("pwm", &self.vertical.pwm), ("thrust", &self.vertical.thrust)] {
            if vertical.as_ref().is_some_and(|v| v.hover_pwm().is_none()) {
                return Err(
                    self.problem(format!("vertical.{name} needs hover, the PWM that carries the weight"))
                );
            }
        }
        if self.inputs().is_empty() {
            return Err(self.problem("vertical has no form: give height, pwm or thrust".into()));
        }
        if let Some(default) = self.vertical.default.filter(|input| !self.inputs().contains(input)) {
            return Err(self
                .problem(format!("vertical.default is {:?}, a form that the model lacks", default.name())));
        }
        crate::schedule::Schedule::from_model(self)?;
        crate::config::check_effects(&self.effects)
    }

    /// The height input that is commanded: what is `asked` for, or the default.
    ///
    /// # Errors
    /// [`Error::Config`] if the model has none.
    pub fn input(&self, asked: Option<VerticalInput>) -> Result<VerticalInput> {
        // a checked model has at least one input
        asked
            .or(self.inputs().first().copied())
            .ok_or_else(|| Error::Config("the model has no vertical form".into()))
    }

    /// The height inputs that this model has, the default first.
    pub fn inputs(&self) -> Vec<VerticalInput> {
        let v = &self.vertical;
        let all = [
            (VerticalInput::Height, &v.height),
            (VerticalInput::Pwm, &v.pwm),
            (VerticalInput::Thrust, &v.thrust),
        ];
        let mut inputs: Vec<VerticalInput> =
            all.into_iter().filter_map(|(input, form)| form.as_ref().map(|_| input)).collect();
        inputs.sort_by_key(|input| Some(*input) != v.default);
        inputs
    }

    /// The vertical form for an input.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model has no such form.
    pub fn vertical(&self, input: VerticalInput) -> Result<&Vertical> {
        let v = &self.vertical;
        let (form, name) = match input {
            VerticalInput::Height => (&v.height, "height"),
            VerticalInput::Pwm => (&v.pwm, "pwm"),
            VerticalInput::Thrust => (&v.thrust, "thrust"),
        };
        let known = [("height", &v.height), ("pwm", &v.pwm), ("thrust", &v.thrust)];
        form.as_ref().ok_or_else(|| {
            unknown("vertical form of this model", name, known.iter().filter(|k| k.1.is_some()).map(|k| k.0))
        })
    }
}
