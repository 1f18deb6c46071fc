//! The vehicles that are known by name, wherever a model is taken.

use std::path::Path;

use serde::Serialize;

use super::{Model, VerticalInput};
use crate::error::{Result, unknown};

/// A vehicle of the registry.
#[derive(Debug)]
pub struct Vehicle {
    /// Name that stands for its model.
    pub name: &'static str,
    /// Model file or data sheet.
    pub text: &'static str,
}

const fn vehicle(name: &'static str, text: &'static str) -> Vehicle {
    Vehicle { name, text }
}

/// Every vehicle, the default first.
pub const VEHICLES: [Vehicle; 6] = [
    vehicle("cf2-thesis", include_str!("../../models/cf2-thesis.toml")),
    vehicle("cf2-thesis-drag", include_str!("../../models/cf2-thesis-drag.toml")),
    vehicle("cf21", include_str!("../../models/cf21.toml")),
    vehicle("cf21-plus", include_str!("../../models/cf21-plus.toml")),
    vehicle("cf21-thrust-upgrade", include_str!("../../models/cf21-thrust-upgrade.toml")),
    vehicle("cf21-brushless", include_str!("../../models/cf21-brushless.toml")),
];

impl Vehicle {
    /// The vehicle of that name; "thesis" is short for the first.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] with a proposal.
    pub fn named(name: &str) -> Result<&'static Vehicle> {
        let vehicle =
            VEHICLES.iter().find(|each| each.name == name || (name == "thesis" && each.name == "cf2-thesis"));
        vehicle.ok_or_else(|| unknown("vehicle", name, VEHICLES.iter().map(|each| each.name)))
    }

    /// True for one word: it may be a vehicle's name, and is neither a model nor a file.
    pub fn is_name(text: &str) -> bool {
        let letter = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        !text.is_empty() && text.chars().all(letter)
    }

    /// The vehicle's name, where a path is one and no file.
    pub fn name_in(path: &Path) -> Option<&str> {
        path.to_str().filter(|name| Vehicle::is_name(name) && !path.exists())
    }

    /// Its model.
    pub fn model(&self) -> Model {
        // every built-in text is covered by a test
        Model::read(self.text).unwrap_or_else(|error| unreachable!("built-in {}: {error}", self.name))
    }
}

/// A vehicle as it is listed: how heavy it is, and which of its numbers were identified.
#[derive(Debug, Serialize)]
pub struct VehicleSummary {
    /// Name that stands for its model.
    pub name: String,
    /// Description with the source of the numbers.
    pub about: String,
    /// Mass as flown.
    pub mass_kg: f64,
    /// Distance from the centre to a motor.
    pub arm_m: f64,
    /// Vertical form that is commanded unless another is asked for.
    pub vertical: VerticalInput,
    /// Vertical forms that the model has.
    pub verticals: Vec<VerticalInput>,
    /// Parts of the model whose numbers were identified in flights.
    pub identified: Vec<String>,
    /// Parts whose numbers come from elsewhere: data sheets, a rig, a choice.
    pub stated: Vec<String>,
}

impl VehicleSummary {
    /// Summarises each of [`VEHICLES`].
    ///
    /// # Errors
    /// None for models that can be read.
    pub fn of_all() -> Result<Vec<Self>> {
        VEHICLES.iter().map(|vehicle| Self::new(&vehicle.model())).collect()
    }

    fn new(model: &Model) -> Result<Self> {
        let (mut identified, mut stated) = (Vec::new(), Vec::new());
        for (path, quantity, ..) in model.quantities() {
            let part = path.rsplit_once('.').map_or(path.as_str(), |(part, _)| part);
            let is_identified = ["identified", "fitted", "thesis 4", "thesis 5"]
                .iter()
                .any(|word| quantity.source.starts_with(word));
            let parts = if is_identified { &mut identified } else { &mut stated };
            if parts.last().is_none_or(|last| last != part) {
                parts.push(part.to_owned());
            }
        }
        Ok(VehicleSummary {
            name: model.name.clone(),
            about: model.description.clone(),
            mass_kg: model.vehicle.mass.value,
            arm_m: model.vehicle.arm.value,
            vertical: model.input(None)?,
            verticals: VerticalInput::ALL.into_iter().filter(|form| model.vertical(*form).is_ok()).collect(),
            identified,
            stated,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vehicle_has_its_name_and_is_found_by_it() {
        for vehicle in &VEHICLES {
            let model = Model::parse(vehicle.name).unwrap();
            assert_eq!(model.name, vehicle.name);
            assert_eq!(model, Model::parse(vehicle.text).unwrap());
            assert!(!model.description.is_empty());
        }
        assert_eq!(Model::parse("thesis").unwrap(), Model::thesis());
        let all = VehicleSummary::of_all().unwrap();
        let named = |name: &str| all.iter().find(|each| each.name == name).unwrap();
        assert!(named("cf2-thesis").identified.contains(&"roll".to_owned()));
        assert!(named("cf21-brushless").identified.is_empty() && named("cf21-brushless").mass_kg == 0.0434);
        let page = include_str!("../../../docs/tutorials/your_vehicle.md");
        for VehicleSummary { name, mass_kg, .. } in &all {
            let row = page.lines().find(|line| line.starts_with(&format!("| `{name}` |"))).unwrap();
            let is_thesis = name == "cf2-thesis-drag";
            assert!(is_thesis || row.contains(&format!("{:.1} g", 1e3 * mass_kg)), "{row}");
        }
        let rows = page.lines().filter(|line| line.starts_with("| `cf2")).count();
        assert_eq!(rows, VEHICLES.len(), "a vehicle of the page is none of the registry");
        let error = Model::parse("cf12").unwrap_err().to_string();
        assert!(error.contains("unknown vehicle \"cf12\"") && error.contains("cf21-brushless"), "{error}");
    }
}
