//! Creates the model of a vehicle that nobody has identified, from its data sheet.

use serde_json::{Map, Value};

use crate::error::{Error, Result, out_of_range, unknown};
use crate::model::{
    Airframe, AttitudeLoop, CommandLimits, IdentifiedVehicle, Model, Motors, Quantity, Tilt, TiltInput,
    Vertical, VerticalInput, Verticals, Yaw,
};
use crate::tree::parse_tree;

/// A number of a data sheet.
#[derive(Debug, Clone, Copy)]
pub struct DatasheetField {
    /// Key, with its table before a dot and the unit as its suffix.
    pub name: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// The value unless given; nothing where it must be.
    pub default: Option<f64>,
}

const fn field(name: &'static str, range: [f64; 2], about: &'static str) -> DatasheetField {
    DatasheetField { name, about, range, default: None }
}

impl DatasheetField {
    const fn or(self, default: f64) -> Self {
        DatasheetField { default: Some(default), ..self }
    }
}

/// Every number of a data sheet.
pub const DATASHEET_FIELDS: [DatasheetField; 19] = [
    field("mass_kg", [1e-3, 100.0], "mass as flown"),
    field("arm_m", [1e-3, 10.0], "distance from the centre to a motor"),
    field("tilt_inertia_kgm2", [1e-9, 100.0], "moment of inertia about the roll and the pitch axis"),
    field("pitch_inertia_kgm2", [0.0, 100.0], "that about the pitch axis where it differs; 0 for the same")
        .or(0.0),
    field("yaw_inertia_kgm2", [1e-9, 100.0], "moment of inertia about the yaw axis"),
    field("drag_ps", [0.0, 10.0], "horizontal deceleration per velocity").or(0.0),
    field("heave_ps", [0.0, 20.0], "vertical deceleration per velocity; unless given, the built-in model's")
        .or(1.2),
    field("motor.thrust_max_n", [1e-4, 1e4], "thrust of one motor with its propeller at full PWM"),
    field(
        "motor.thrust_linear_share",
        [0.0, 1.0],
        "share of that thrust that grows with the PWM; the rest grows with its square",
    ),
    field("motor.lag_s", [1e-3, 1.0], "time constant of a motor"),
    field("motor.lag_falling_s", [0.0, 1.0], "that of a motor that slows down; 0 for the same").or(0.0),
    field("propeller.radius_m", [1e-3, 10.0], "radius of a propeller"),
    field("propeller.torque_per_thrust_m", [1e-6, 1.0], "torque about its axis per thrust"),
    field("battery.capacity_mah", [1.0, 1e6], "charge of the full battery"),
    field("battery.hover_current_a", [1e-3, 1e3], "current of a hover"),
    field("battery.voltage_v", [1.0, 100.0], "voltage at which the thrust was measured"),
    field("limits.tilt_max_deg", [0.1, 80.0], "largest commanded tilt").or(10.0),
    field("limits.yaw_rate_max_degps", [0.1, 2000.0], "largest commanded yaw rate").or(200.0),
    field("limits.height_max_m", [0.1, 1000.0], "largest commanded height").or(1.5),
];

const TEXTS: [&str; 3] = ["name", "description", "attitude_loop"];
/// The largest PWM that the firmware takes (`MAX_THRUST`).
const PWM_MAX: f64 = 60_000.0;
const GRAVITY_MPS2: f64 = 9.81;

/// The contents of a data sheet, read and checked.
struct Datasheet {
    name: String,
    description: String,
    attitude_loop: AttitudeLoop,
    numbers: [f64; DATASHEET_FIELDS.len()],
}

impl Model {
    /// Returns whether a text holds a value that data sheets have, and model files not.
    pub(crate) fn is_datasheet(tree: &toml::Value) -> bool {
        let part = |field: &DatasheetField| field.name.split('.').next().unwrap_or(field.name);
        let mut keys = DATASHEET_FIELDS.iter().map(part).chain(["attitude_loop"]);
        keys.any(|key| tree.get(key).is_some())
    }

    /// The model of a data sheet, TOML or JSON: [`DATASHEET_FIELDS`], a `name`, and the `attitude_loop`, an
    /// [`AttitudeLoop`] by name. It flies the motor-level form by default. Its roll, pitch, yaw and `vertical.thrust`
    /// are that vehicle at small angles near the hover.
    ///
    /// # Errors
    /// [`Error::Config`] naming the line of what cannot be read, and every value that is missing;
    /// [`Error::Unknown`] with a proposal for a strange name; [`Error::Range`] for a value outside its range;
    /// [`Error::Model`] for a vehicle that cannot fly.
    pub fn from_datasheet(text: &str) -> Result<Model> {
        Datasheet::parse(text)?.model()
    }
}

impl Datasheet {
    fn parse(text: &str) -> Result<Self> {
        let bad = |problem: String| Error::Config(format!("data sheet: {problem}"));
        let tree = parse_tree(text).map_err(bad)?;
        let Value::Object(tree) = tree else { return Err(bad("expected a table".into())) };
        let mut values = flat(tree);
        let mut take_text = |key: &str| match values.remove(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(bad(format!("{key} is {other}, expected a text"))),
        };
        let [name, description, attitude_loop] =
            [take_text("name")?, take_text("description")?, take_text("attitude_loop")?];
        let known = || DATASHEET_FIELDS.iter().map(|field| field.name).chain(TEXTS);
        if let Some(key) = values.keys().find(|key| !known().any(|name| name == *key)) {
            return Err(unknown("value of a data sheet", key, known()));
        }
        let mut missing: Vec<String> = Vec::new();
        if name.is_none() {
            missing.push("name (a text)".into());
        }
        if attitude_loop.is_none() {
            missing.push(format!(
                "attitude_loop (the controller on board: {})",
                AttitudeLoop::ALL.map(AttitudeLoop::name).join(", ")
            ));
        }
        let mut numbers = [0.0; DATASHEET_FIELDS.len()];
        for (number, field) in numbers.iter_mut().zip(DATASHEET_FIELDS) {
            let DatasheetField { name, about, range: [low, high], default } = field;
            *number = match values.get(name) {
                Some(value) => {
                    value.as_f64().ok_or_else(|| bad(format!("{name} is {value}, expected a number")))?
                }
                None => default.unwrap_or_else(|| {
                    missing.push(format!("{name} ({about})"));
                    low
                }),
            };
            if !(low..=high).contains(number) {
                let name = format!("data sheet: {name}");
                return Err(out_of_range(name, *number, format!("{low} to {high}: {about}")));
            }
        }
        let (Some(name), Some(attitude_loop), true) = (name, attitude_loop, missing.is_empty()) else {
            return Err(bad(format!("there is no {}", missing.join(", no "))));
        };
        let attitude_loop = AttitudeLoop::named(&attitude_loop)?;
        Ok(Datasheet { name, description: description.unwrap_or_default(), attitude_loop, numbers })
    }

    /// One of [`DATASHEET_FIELDS`], with its unit as model files have it.
    fn quantity(&self, name: &str, unit: &str) -> Quantity {
        let place = DATASHEET_FIELDS.iter().position(|field| field.name == name);
        let value = place.map_or(f64::NAN, |place| self.numbers[place]);
        quantity(value, unit, &format!("data sheet, {name}"))
    }

    /// Returns [`Datasheet::quantity`] if the sheet gives a value other than 0.
    fn quantity_if_given(&self, name: &str, unit: &str) -> Option<Quantity> {
        Some(self.quantity(name, unit)).filter(|quantity| quantity.value > 0.0)
    }

    fn number(&self, name: &str) -> f64 {
        self.quantity(name, "").value
    }

    /// The motors, with the PWM that carries the weight.
    fn motors(&self) -> Result<Motors> {
        let form = Motors {
            hover: quantity(
                PWM_MAX,
                "1",
                "mass_kg on the curve of motor.thrust_max_n and motor.thrust_linear_share",
            ),
            linear_share: self.quantity("motor.thrust_linear_share", "1"),
            attitude_loop: self.attitude_loop,
            lag: self.quantity("motor.lag_s", "s"),
            lag_falling: self.quantity_if_given("motor.lag_falling_s", "s"),
            tilt_inertia: self.quantity("tilt_inertia_kgm2", "kg m^2"),
            pitch_inertia: self.quantity_if_given("pitch_inertia_kgm2", "kg m^2"),
            yaw_inertia: self.quantity("yaw_inertia_kgm2", "kg m^2"),
            torque_per_thrust: self.quantity("propeller.torque_per_thrust_m", "m"),
            heave: self.quantity("heave_ps", "1/s"),
        };
        let refuse = |problem: String| Err(Error::Model { name: self.name.clone(), problem });
        let [roll, pitch, yaw] = form.inertias_kgm2();
        if yaw > roll + pitch {
            return refuse(format!(
                "yaw_inertia_kgm2 is {yaw}, and no body has more than the sum of the two others, {roll} and {pitch}"
            ));
        }
        let full_n = 4.0 * self.number("motor.thrust_max_n");
        let mass_kg = self.number("mass_kg");
        let share = mass_kg * GRAVITY_MPS2 / full_n;
        let most = form.curve(PWM_MAX);
        if share >= most {
            return refuse(format!(
                "mass_kg is {mass_kg}, and four motors of motor.thrust_max_n carry {:.4} kg at the largest PWM, \
                 {PWM_MAX}",
                most * full_n / GRAVITY_MPS2
            ));
        }
        let hover = Quantity { value: form.pwm_of(share), ..form.hover };
        Ok(Motors { hover, ..form })
    }

    fn model(&self) -> Result<Model> {
        let form = self.motors()?;
        let (hover, heave) = (form.hover.clone(), form.heave.clone());
        let (mass, arm) = (self.quantity("mass_kg", "kg"), self.quantity("arm_m", "m"));
        let capacity =
            quantity(3.6 * self.number("battery.capacity_mah"), "C", "data sheet, battery.capacity_mah");
        let current = self.quantity("battery.hover_current_a", "A");
        let thesis = Model::thesis();
        let mut model = Model {
            name: self.name.clone(),
            description: format!(
                "{}{}from a data sheet, with the attitude loop of the Crazyflie's firmware",
                self.description,
                if self.description.is_empty() { "" } else { "; " }
            ),
            vertical: Verticals {
                default: Some(VerticalInput::Motors),
                thrust: Some(Vertical::Thrust { hover, heave }),
                motors: Some(Vertical::Motors(Box::new(form))),
                ..Verticals::default()
            },
            vehicle: Airframe {
                identified: Some(IdentifiedVehicle {
                    mass: mass.clone(),
                    arm: arm.clone(),
                    battery_capacity: Some(capacity.clone()),
                    hover_current: Some(current.clone()),
                }),
                mass,
                arm,
                rotor_radius: self.quantity("propeller.radius_m", "m"),
                battery_capacity: capacity,
                hover_current: current,
                battery_reference: Some(self.quantity("battery.voltage_v", "V")),
            },
            command: CommandLimits {
                tilt: TiltInput::Angle,
                tilt_max: self.quantity("limits.tilt_max_deg", "deg"),
                yaw_rate_max: self.quantity("limits.yaw_rate_max_degps", "deg/s"),
                height_max: self.quantity("limits.height_max_m", "m"),
                pwm_max: quantity(PWM_MAX, "1", "Crazyflie firmware, MAX_THRUST"),
            },
            ..thesis
        };
        model.lateral.gravity = quantity(GRAVITY_MPS2, "m/s^2", "standard gravity, rounded");
        model.lateral.drag = self.quantity("drag_ps", "1/s");
        model.close_loops();
        // reading its own text checks it like a file
        Model::read(&model.to_toml()?)
    }
}

impl Model {
    /// Take roll, pitch and yaw from the motor-level form and its loops.
    fn close_loops(&mut self) {
        const SOURCE: &str =
            "Crazyflie firmware's loops around the data sheet's motors: small angles, no motor lag";
        let tilts = self.tilt_forms(VerticalInput::Motors);
        for (tilt, form) in [&mut self.roll, &mut self.pitch].into_iter().zip(tilts) {
            *tilt = Tilt {
                gain: quantity(form.u[1], "1/s^2", SOURCE),
                damping: quantity(-form.a[1][1], "1/s", SOURCE),
                stiffness: quantity(-form.a[1][0], "1/s^2", SOURCE),
            };
        }
        let yaw = self.yaw_form(VerticalInput::Motors);
        self.yaw = Yaw::Rate {
            gain: quantity(self.yaw.sign(), "1", "Crazyflie firmware's sign, as thesis 5.2"),
            bandwidth: quantity(-yaw.a[1][1], "1/s", SOURCE),
        };
    }
}

fn quantity(value: f64, unit: &str, source: &str) -> Quantity {
    Quantity { value, unit: unit.into(), source: source.into() }
}

/// Members of tables by their path.
fn flat(tree: Map<String, Value>) -> Map<String, Value> {
    let mut all = Map::new();
    for (key, value) in tree {
        match value {
            Value::Object(table) => {
                all.extend(flat(table).into_iter().map(|(name, value)| (format!("{key}.{name}"), value)));
            }
            value => {
                all.insert(key, value);
            }
        }
    }
    all
}
