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
    /// Name that its firmware gives the kind of vehicle.
    pub platform: &'static str,
    /// Model file or data sheet.
    pub text: &'static str,
}

const fn vehicle(name: &'static str, platform: &'static str, text: &'static str) -> Vehicle {
    Vehicle { name, platform, text }
}

/// Factor by which two lengths of the same frame may differ: those of `cf21` and `cf21-plus` differ by 1.044.
const SAME_FRAME: f64 = 1.03;

/// Every vehicle, the default first.
pub const VEHICLES: [Vehicle; 6] = [
    vehicle("cf2-thesis", "Crazyflie 2.0", include_str!("../../models/cf2-thesis.toml")),
    vehicle("cf2-thesis-drag", "Crazyflie 2.0", include_str!("../../models/cf2-thesis-drag.toml")),
    vehicle("cf21", "Crazyflie 2.1", include_str!("../../models/cf21.toml")),
    vehicle("cf21-plus", "Crazyflie 2.1", include_str!("../../models/cf21-plus.toml")),
    vehicle("cf21-thrust-upgrade", "Crazyflie 2.1", include_str!("../../models/cf21-thrust-upgrade.toml")),
    vehicle("cf21-brushless", "Crazyflie 2.1 Brushless", include_str!("../../models/cf21-brushless.toml")),
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

    /// Refuses a model that has the name of a vehicle and the arm or the propellers of another one. Identification
    /// changes neither; mass, motors and loops are the user's.
    ///
    /// # Errors
    /// [`crate::Error::Model`] naming the lengths, and the vehicles whose frame agrees.
    pub(crate) fn check_name(model: &Model) -> Result<()> {
        let Some(own) = VEHICLES.iter().find(|vehicle| vehicle.name == model.name) else { return Ok(()) };
        let lengths = |model: &Model| [model.vehicle.arm.value, model.vehicle.rotor_radius.value];
        let found = lengths(model);
        let agrees = |vehicle: &&Vehicle| {
            let both = found.into_iter().zip(lengths(&vehicle.model()));
            both.into_iter().all(|(a, b)| (a / b).ln().abs() < SAME_FRAME.ln())
        };
        if agrees(&own) {
            return Ok(());
        }
        let [mm, own_mm] = [found, lengths(&own.model())].map(|lengths| lengths.map(|m| 1e3 * m));
        let agreeing: Vec<&str> = VEHICLES.iter().filter(agrees).map(|vehicle| vehicle.name).collect();
        let hint =
            if agreeing.is_empty() { String::new() } else { format!("; these fit {}", agreeing.join(", ")) };
        Err(model.problem(format!(
            "name is that of a vehicle with {:.1} mm to a motor and propellers of {:.1} mm, and vehicle.arm and \
             vehicle.rotor_radius are {:.1} mm and {:.1} mm: expected a name of its own{hint}",
            own_mm[0], own_mm[1], mm[0], mm[1]
        )))
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
    /// Name that its firmware gives the kind of vehicle.
    pub platform: &'static str,
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
        VEHICLES.iter().map(Self::new).collect()
    }

    fn new(vehicle: &Vehicle) -> Result<Self> {
        let model = vehicle.model();
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
            platform: vehicle.platform,
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
        let renamed = |name: &str, as_name: &str| {
            let text = Vehicle::named(name).unwrap().text;
            Model::parse(&text.replacen(&format!("name = {name:?}"), &format!("name = {as_name:?}"), 1))
        };
        let error = renamed("cf21-brushless", "cf21").unwrap_err().to_string();
        assert!(error.contains("name is that of a vehicle with 46.0 mm"), "{error}");
        assert!(
            error.contains("are 50.0 mm and 27.5 mm") && error.ends_with("fit cf21-brushless"),
            "{error}"
        );
        assert!(renamed("cf21-plus", "cf21").is_err() && renamed("cf21-brushless", "mine").is_ok());
        let own = VEHICLES[2].text.replace("value = 0.0328", "value = 0.0351");
        assert_eq!(Model::parse(&own.replace("value = 0.046\n", "value = 0.0465\n")).unwrap().name, "cf21");
        let error = Model::parse("cf12").unwrap_err().to_string();
        assert!(error.contains("unknown vehicle \"cf12\"") && error.contains("cf21-brushless"), "{error}");
    }

    #[test]
    fn what_is_no_model_is_told_with_what_is_expected() {
        let sheet = include_str!("../../../examples/crazyflie_datasheet.toml");
        for (text, told) in [
            ("", "it is empty; expected a vehicle's name"),
            ("a,b\n1,2\n", "line 1"),
            ("hello this is no model", "; expected a vehicle's name"),
            ("{}", "missing field `schema`; expected a vehicle's name"),
            (&sheet.replacen("attitude_loop", "# ", 1), "data sheet: there is no attitude_loop"),
            (&sheet.replacen("attitude_loop", "atitude_loop", 1), "did you mean \"attitude_loop\""),
        ] {
            let error = Model::parse(text).unwrap_err().to_string();
            assert!(error.contains(told), "{text:?}: {error}");
        }
    }
}
