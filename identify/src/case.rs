//! A case file: the vehicle, sensors and controller that a user declares, with the flights of it.

use std::path::{Path, PathBuf};

use crazyflie_env::model::{Model, Quantity, Vertical, Verticals, Yaw};
use serde::Deserialize;

use crate::{Error, Result};

/// The declared vehicle, from `dNN.json` of the simulated flights with hidden effects.
#[derive(Debug, Clone, Deserialize)]
pub struct Case {
    /// Identifier of the case, by which the declared model is called.
    pub id: String,
    /// The flight to work on, and the one to judge with; paths beside the case file.
    pub identify_on: PathBuf,
    /// Log to judge with, which no fit may see.
    pub held_out: PathBuf,
    declared_model: Declaration,
    mass_kg: f64,
    vbat_ref: Option<f64>,
}

#[derive(Debug, Clone, Deserialize)]
struct Declaration {
    attitude: Attitude,
    height: Height,
    yaw: YawLoop,
}

#[derive(Debug, Clone, Deserialize)]
struct Attitude {
    n0: f64,
    d1: f64,
    d0: f64,
}

#[derive(Debug, Clone, Deserialize)]
struct Height {
    hover_pwm: f64,
    heave: f64,
}

#[derive(Debug, Clone, Deserialize)]
struct YawLoop {
    k: f64,
}

impl Case {
    /// Reads a case file; the paths of its flights are made relative to it.
    ///
    /// # Errors
    /// [`Error`] names the file, and line and column of what is malformed.
    pub fn read(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|why| Error::Logs(format!("{file}: cannot be read: {why}")))?;
        let mut case: Case = serde_json::from_str(&text).map_err(|why| {
            let place = format!("{file}, line {}, column {}", why.line(), why.column());
            Error::Logs(format!("{place}: not a case file: {why}"))
        })?;
        let beside = path.parent().unwrap_or(Path::new(""));
        (case.identify_on, case.held_out) = (beside.join(&case.identify_on), beside.join(&case.held_out));
        Ok(case)
    }

    /// Returns whether a text is a case file rather than a model file.
    pub fn is_case(text: &str) -> bool {
        serde_json::from_str::<serde_json::Value>(text).is_ok_and(|v| v.get("declared_model").is_some())
    }

    /// The declared model; what a case does not declare (airframe, limits) is the thesis's.
    ///
    /// # Errors
    /// [`Error::Logs`] for values that a model cannot have.
    pub fn model(&self) -> Result<Model> {
        let Declaration { attitude, height, yaw } = &self.declared_model;
        let quantity = |value: f64, unit: &str| Quantity {
            value,
            unit: unit.into(),
            source: format!("declared in case {}", self.id),
        };
        let mut model = Model::thesis();
        model.name = format!("{}-declared", self.id);
        model.description = format!("As declared in case {}", self.id);
        for tilt in [&mut model.roll, &mut model.pitch] {
            tilt.gain = quantity(attitude.n0, "1/s^2");
            tilt.damping = quantity(attitude.d1, "1/s");
            tilt.stiffness = quantity(attitude.d0, "1/s^2");
        }
        model.yaw = Yaw::Rate { gain: quantity(-1.0, "1"), bandwidth: quantity(yaw.k, "1/s") };
        model.lateral.drag = quantity(0.0, "1/s");
        let thrust =
            Vertical::Thrust { hover: quantity(height.hover_pwm, "1"), heave: quantity(height.heave, "1/s") };
        model.vertical = Verticals { thrust: Some(thrust), ..Verticals::default() };
        model.vehicle.mass = quantity(self.mass_kg, "kg");
        model.mark_identified();
        model.vehicle.battery_reference = self.vbat_ref.map(|v| quantity(v, "V"));
        let written = model.to_toml().and_then(|text| Model::parse(&text));
        written.map_err(|why| Error::Logs(format!("{}: the declared model is not one: {why}", self.id)))
    }
}
