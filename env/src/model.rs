//! A model is data: transfer functions with units and provenance, read from one TOML or JSON text. The
//! thesis's is built in.

mod identified;
mod schedule;
mod state_space;
mod vehicles;
mod vertical;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::effect_table::EffectTable;
use crate::error::{Error, Result, unknown};
use crate::tree::{is_default, parse_table, read_tree};

use vertical::CheckedQuantity;

pub use identified::IdentifiedVehicle;
pub(crate) use schedule::Schedule;
pub use state_space::StateSpace;
pub use vehicles::{VEHICLES, Vehicle, VehicleSummary};
pub use vertical::FULL_PWM;
pub use vertical::{AttitudeLoop, Motors, PwmSource, Vertical, VerticalInput, Verticals};

/// The expected text or file where a model is taken, for errors.
pub const EXPECTED: &str = "expected a vehicle's name (see `crazyflie vehicles`), or a model file or a data sheet in TOML or \
                        JSON, as `crazyflie model --show` prints one";

/// The text of the model that the thesis identified.
pub const THESIS_TOML: &str = VEHICLES[0].text;

/// Intervals in which the numbers of a model must lie.
const POSITIVE: [f64; 2] = [f64::MIN_POSITIVE, 1e6];
const NOT_NEGATIVE: [f64; 2] = [0.0, 1e6];
const ANY: [f64; 2] = [-1e6, 1e6];

/// A number with its unit and source.
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

/// The quantity that roll and pitch commands set. A tilt form turns it into an angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TiltInput {
    /// The angles, as the thesis's vehicle has it.
    #[default]
    Angle,
    /// The body rates, as learned and model-predictive controllers have it.
    Rate,
    /// The moments about the body's axes, N m.
    Torque,
}

impl TiltInput {
    /// The unit of a tilt form's gain, and of the largest command.
    pub fn units(self) -> [&'static str; 2] {
        match self {
            Self::Angle => ["1/s^2", "deg"],
            Self::Rate => ["1/s", "deg/s"],
            Self::Torque => ["1/(kg m^2)", "N m"],
        }
    }

    /// The largest command in rad, rad/s or N m.
    pub fn limit_si(self, value: f64) -> f64 {
        if self == Self::Torque { value } else { value.to_radians() }
    }
}

/// angle / command = gain / (s^2 + damping s + stiffness)   (thesis 4.4, 5.1); of a commanded rate or moment,
/// the stiffness is 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tilt {
    /// Angular acceleration per command: 1/s^2 of an angle, see [`TiltInput::units`].
    pub gain: Quantity,
    /// Angular deceleration per rate, 1/s.
    pub damping: Quantity,
    /// Angular deceleration per angle, 1/s^2; `gain / stiffness` is the static gain of an angle.
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

/// Limits of the command interface: the range to which an action of -1..1 is mapped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandLimits {
    /// The quantity that roll and pitch commands set; angles unless given.
    #[serde(default, skip_serializing_if = "is_default")]
    pub tilt: TiltInput,
    /// Largest roll and pitch command: an angle in deg, see [`TiltInput::units`].
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
    /// Voltage at which the model's thrust is valid; that of a full cell, 4.2 V, unless given.
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
    /// Effects that belong to this vehicle and are on unless the configuration turns them off.
    #[serde(
        default,
        skip_serializing_if = "BTreeMap::is_empty",
        deserialize_with = "crate::effect_table::read"
    )]
    pub effects: EffectTable,
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
    pub(crate) fn second_order(gain: f64, damping: f64, stiffness: f64, offset: f64) -> Self {
        AxisForm { a: [[0.0, 1.0], [-stiffness, -damping]], u: [0.0, gain], push: [0.0, 1.0], offset }
    }
    /// x' = gain (u - offset) - pole x + w, w' = push - push_damping w
    pub(crate) fn first_order(gain: f64, pole: f64, offset: f64, push_damping: f64) -> Self {
        AxisForm { a: [[-pole, 1.0], [0.0, -push_damping]], u: [gain, 0.0], push: [0.0, 1.0], offset }
    }
    /// Returns the input above its offset that keeps an output, per output.
    pub fn input_per_output(&self) -> f64 {
        if self.u[0] == 0.0 { -self.a[1][0] / self.u[1] } else { -self.a[0][0] / self.u[0] }
    }
    pub(crate) fn lags_push(&self) -> bool {
        self.a[0] != [0.0, 1.0] || self.u[0] != 0.0
    }
}

/// Push damping of the yaw integrator (thesis 5.2): a torque acts through the rate loop that the integrator
/// idealises; 25 1/s is the bandwidth of the Crazyflie's yaw-rate loop used by the declared models of the
/// simulated flights.
const YAW_PUSH_DAMPING: f64 = 25.0;

pub(crate) fn or_zero(q: &Option<Quantity>) -> f64 {
    q.as_ref().map_or(0.0, |q| q.value)
}

impl Tilt {
    /// Returns the differential equation of the angle; a push is an angular acceleration.
    pub fn form(&self) -> AxisForm {
        AxisForm::second_order(self.gain.value, self.damping.value, self.stiffness.value, 0.0)
    }
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

/// Half the side, and the height, of the thesis's room (2.1): beyond it a flight is over.
pub const ROOM_M: [f64; 2] = [2.5, 2.8];

/// Radius of the vehicle over the tips of its propellers: 46 mm to a motor, and a propeller of 23 mm (thesis 3.1).
pub const VEHICLE_RADIUS_M: f64 = 0.069;

/// Voltage of a full lithium-polymer cell.
const FULL_CELL_V: f64 = 4.2;

impl Model {
    /// Returns the voltage at which the model's thrust is valid.
    pub fn battery_reference_v(&self) -> f64 {
        self.vehicle.battery_reference.as_ref().map_or(FULL_CELL_V, |quantity| quantity.value)
    }

    /// The thesis's model.
    pub fn thesis() -> Model {
        VEHICLES[0].model()
    }

    /// Reads a model from TOML or JSON (distinguished by the first character), whatever its effects; a value of
    /// [`crate::datasheet::DATASHEET_FIELDS`] or the `attitude_loop` identifies a data sheet.
    ///
    /// # Errors
    /// [`Error::Model`] with line and column for a syntax error, or naming the path of what is wrong.
    pub(crate) fn read(text: &str) -> Result<Model> {
        let bad = |problem: String| Error::Model { name: "text".into(), problem };
        let strange = |problem: &str| bad(format!("{}; {EXPECTED}", problem.trim_end()));
        if text.trim().is_empty() {
            return Err(strange("it is empty"));
        }
        let tree = parse_table(text).map_err(|problem| strange(&problem))?;
        if Model::is_datasheet(&tree) {
            return Model::from_datasheet(text);
        }
        let is_model = tree.get("schema").is_some();
        let read = read_tree::<Model>(tree);
        let model = read.map_err(|problem| if is_model { bad(problem) } else { strange(&problem) })?;
        model.check()?;
        model.scale_to_vehicle()
    }

    /// Returns the model as TOML.
    ///
    /// # Errors
    /// [`Error::Model`] if a value cannot be written.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| self.problem(e.to_string()))
    }

    pub(crate) fn problem(&self, problem: String) -> Error {
        Error::Model { name: self.name.clone(), problem }
    }

    /// Every quantity with its path, the unit it must have and the interval it must lie in.
    fn quantities(&self) -> Vec<CheckedQuantity<'_>> {
        let mut all = Vec::new();
        let input = self.command.tilt;
        let [gain_unit, limit_unit] = input.units();
        // data sheets and fits of a gain in 1/(kg m^2) are large
        let gains = if input == TiltInput::Torque { [f64::MIN_POSITIVE, 1e9] } else { POSITIVE };
        let limits = if input == TiltInput::Angle { [0.1, 80.0] } else { [1e-6, 1e5] };
        for (name, tilt) in [("roll", &self.roll), ("pitch", &self.pitch)] {
            all.push((format!("{name}.gain"), &tilt.gain, gain_unit, gains));
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
        all.extend(self.vertical.quantities());
        all.push(("command.tilt_max".into(), &self.command.tilt_max, limit_unit, limits));
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

    /// Returns whether the second state of the vertical and of the yaw form is a lagged push, and not the rate
    /// itself. No measured rate determines such a state.
    ///
    /// # Errors
    /// [`Error::Unknown`] if the model lacks the vertical input.
    pub fn lags_push(&self, input: VerticalInput) -> Result<[bool; 2]> {
        let form = self.vertical(input)?.form(self.lateral.gravity.value);
        Ok([form, self.yaw_form(input)].map(|form| form.lags_push()))
    }

    /// The numbers of the model by path ("roll.gain", "vertical.thrust.hover"), each with value and unit.
    pub fn parameters(&self) -> Vec<(String, f64, &'static str)> {
        self.quantities().into_iter().map(|(path, q, unit, _)| (path, q.value, unit)).collect()
    }

    /// The same vehicle with another rate of commands; the inertial sensors are read once a tick at least.
    pub fn with_control_hz(mut self, control_hz: f64) -> Model {
        self.rig.control.value = control_hz;
        self.rig.imu.value = (self.rig.imu.value / control_hz).ceil().max(1.0) * control_hz;
        self
    }

    /// Returns a copy whose roll and pitch commands set another quantity: a start for a fit, since no number of the
    /// old forms applies to the new ones. A vehicle of this size follows a body rate in 50 ms.
    pub fn with_tilt_input(&self, input: TiltInput) -> Model {
        let source = "a start for a fit";
        let [gain_unit, limit_unit] = input.units();
        let (gain, damping, limit) = match input {
            TiltInput::Angle => return self.clone(),
            TiltInput::Rate => (20.0, 20.0, 300.0),
            // the inverse of the Crazyflie's 1.66e-5 kg m^2
            TiltInput::Torque => (6e4, 1.0, 0.01),
        };
        let quantity = |value: f64, unit: &str| Quantity { value, unit: unit.into(), source: source.into() };
        let tilt = Tilt {
            gain: quantity(gain, gain_unit),
            damping: quantity(damping, "1/s"),
            stiffness: quantity(0.0, "1/s^2"),
        };
        let command =
            CommandLimits { tilt: input, tilt_max: quantity(limit, limit_unit), ..self.command.clone() };
        Model { roll: tilt.clone(), pitch: tilt, command, ..self.clone() }
    }

    /// One of [`Model::parameters`].
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal.
    pub fn parameter(&self, path: &str) -> Result<f64> {
        let all = self.quantities();
        let parameter = all.iter().find(|(name, ..)| name == path);
        parameter.map(|(_, q, ..)| q.value).ok_or_else(|| {
            unknown("parameter of the model", path, all.iter().map(|(name, ..)| name.as_str()))
        })
    }

    /// Returns a copy with another value for one of [`Model::parameters`]; its forms then apply to its vehicle.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal; [`Error::Model`] for a value outside its interval.
    pub fn with_parameter(&self, path: &str, value: f64) -> Result<Model> {
        self.parameter(path)?;
        let mut tree = toml::Value::try_from(self).map_err(|error| self.problem(error.to_string()))?;
        let slot = path.split('.').chain(["value"]).try_fold(&mut tree, |tree, key| tree.get_mut(key));
        if let Some(slot) = slot {
            *slot = value.into();
        }
        let mut model: Model = read_tree(tree).map_err(|problem| self.problem(problem))?;
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
        self.check_verticals()?;
        Schedule::from_model(self).map(drop)
    }
}
