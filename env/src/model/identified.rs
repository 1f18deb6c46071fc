//! A vehicle of another mass or arm than the one whose numbers were identified.

use serde::{Deserialize, Serialize};

use super::vertical::CheckedQuantity;
use super::{Airframe, Model, POSITIVE, Quantity, Vertical, VerticalInput};
use crate::error::{Error, Result};

/// The vehicle with which the numbers of a model were identified, so that a change of the vehicle is noticed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdentifiedVehicle {
    /// Mass at which the vertical and lateral forms are valid, kg.
    pub mass: Quantity,
    /// Distance from the centre to a motor at which the roll and pitch forms are valid, m.
    pub arm: Quantity,
    /// Charge of the full battery with which it flew, C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub battery_capacity: Option<Quantity>,
    /// Battery current of its hover, A.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hover_current: Option<Quantity>,
}

impl IdentifiedVehicle {
    /// Returns path, unit and interval of each number, in the form of the model's own.
    pub(crate) fn quantities(&self) -> impl Iterator<Item = CheckedQuantity<'_>> {
        let all = [
            ("mass", Some(&self.mass), "kg"),
            ("arm", Some(&self.arm), "m"),
            ("battery_capacity", self.battery_capacity.as_ref(), "C"),
            ("hover_current", self.hover_current.as_ref(), "A"),
        ];
        all.into_iter()
            .filter_map(|(name, q, unit)| Some((format!("vehicle.identified.{name}"), q?, unit, POSITIVE)))
    }
}

impl Model {
    /// Marks the forms as valid for the vehicle as it is.
    pub fn mark_identified(&mut self) {
        if let Some(identified) = &mut self.vehicle.identified {
            identified.mass.value = self.vehicle.mass.value;
            identified.arm.value = self.vehicle.arm.value;
            if let Some(capacity) = &mut identified.battery_capacity {
                capacity.value = self.vehicle.battery_capacity.value;
            }
            if let Some(current) = &mut identified.hover_current {
                current.value = self.vehicle.hover_current.value;
            }
        }
    }

    /// Checks that the numbers of the battery have an effect; `sags` is whether the battery's effect is on.
    ///
    /// # Errors
    /// [`Error::Model`] for a battery other than the identified one, which changes nothing without the effect.
    pub(crate) fn check_battery(&self, sags: bool) -> Result<()> {
        let Some(identified) = self.vehicle.identified.as_ref().filter(|_| !sags) else { return Ok(()) };
        let Airframe { battery_capacity, hover_current, .. } = &self.vehicle;
        for (name, now, then) in [
            ("battery_capacity", battery_capacity, &identified.battery_capacity),
            ("hover_current", hover_current, &identified.hover_current),
        ] {
            if let Some(then) = then.as_ref().filter(|then| then.value != now.value) {
                return Err(self.problem(format!(
                    "vehicle.{name} is {} {}, not {} {} as identified, and changes a flight only by the effect \
                     battery_sag: switch it on, or set vehicle.identified.{name}",
                    now.value, now.unit, then.value, then.unit
                )));
            }
        }
        Ok(())
    }

    /// Derives the model of the vehicle as it is from the forms of the identified one. The thrust of a PWM and the
    /// force of drag are as they were, so the PWM of a hover grows with the mass, and what is damped per mass
    /// shrinks.
    ///
    /// # Errors
    /// [`Error::Model`] for another arm, for a form that does not scale with the mass, and for a mass that the motors
    /// cannot carry.
    pub(crate) fn scale_to_vehicle(mut self) -> Result<Model> {
        let Some(identified) = self.vehicle.identified.clone() else { return Ok(self) };
        let refuse = |problem: String| Err(Error::Model { name: self.name.clone(), problem });
        let (mass, arm) = (self.vehicle.mass.value, self.vehicle.arm.value);
        if arm != identified.arm.value {
            return refuse(format!(
                "vehicle.arm is {arm} m, but roll and pitch were identified with {} m, and another arm turns \
                 the vehicle otherwise: identify it again, or set vehicle.identified.arm if their numbers hold",
                identified.arm.value
            ));
        }
        let ratio = mass / identified.mass.value;
        if ratio == 1.0 {
            return Ok(self);
        }
        let verticals = &self.vertical;
        let massless: Vec<&str> = [("vertical.height", &verticals.height), ("vertical.pwm", &verticals.pwm)]
            .into_iter()
            .filter_map(|(name, form)| form.as_ref().map(|_| name))
            .collect();
        if !massless.is_empty() {
            return refuse(format!(
                "vehicle.mass is {mass} kg, but the numbers of {} were identified with {} kg and say nothing of \
                 another mass: remove them (vertical.thrust is scaled), or set vehicle.identified.mass if they \
                 hold",
                massless.join(" and "),
                identified.mass.value
            ));
        }
        let Some(Vertical::Thrust { hover, heave }) = &mut self.vertical.thrust else {
            return refuse("the model has no vertical.thrust, the form that is scaled to a mass".into());
        };
        // a data sheet has a thrust curve; what was identified is in proportion to the PWM
        let curve =
            self.vertical.motors.as_ref().filter(|_| self.vertical.default == Some(VerticalInput::Motors));
        let grown = match curve {
            Some(Vertical::Motors(form)) => form.pwm_of(ratio * form.curve(hover.value)) / hover.value,
            _ => ratio,
        };
        scale(hover, grown, identified.mass.value);
        scale(heave, 1.0 / ratio, identified.mass.value);
        scale(&mut self.lateral.drag, 1.0 / ratio, identified.mass.value);
        if let Some(Vertical::Motors(form)) = &mut self.vertical.motors {
            let grown = form.pwm_of(ratio * form.curve(form.hover.value)) / form.hover.value;
            scale(&mut form.hover, grown, identified.mass.value);
            scale(&mut form.heave, 1.0 / ratio, identified.mass.value);
        }
        let (hover, most) = (hover.value, self.command.pwm_max.value);
        if hover >= most {
            return Err(Error::Model {
                name: self.name,
                problem: format!(
                    "vehicle.mass is {mass} kg, which hovers at a PWM of {hover:.0}, and command.pwm_max is {most}"
                ),
            });
        }
        self.mark_identified();
        Ok(self)
    }
}

fn scale(q: &mut Quantity, factor: f64, identified_kg: f64) {
    q.value *= factor;
    q.source = format!("{}; scaled from {identified_kg} kg", q.source);
}

#[cfg(test)]
mod tests {
    use crate::model::{Model, THESIS_TOML, VerticalInput};

    /// The thesis's model with only its thrust form, and a text replaced.
    fn edited(from: &str, to: &str) -> Result<Model, String> {
        let (head, rest) = THESIS_TOML.split_once("# height / commanded height").unwrap();
        let (_, tail) = rest.split_once("# acceleration = gravity").unwrap();
        let text = format!("{head}# acceleration = gravity{tail}");
        assert!(text.contains(from), "{from}");
        Model::parse(&text.replacen(from, to, 1)).map_err(|error| error.to_string())
    }

    #[test]
    fn a_heavier_vehicle_hovers_at_more_thrust_and_is_damped_less() {
        let model = edited("mass = { value = 0.0368", "mass = { value = 0.046").unwrap();
        let light = Model::thesis();
        let ratio = |path: &str| model.parameter(path).unwrap() / light.parameter(path).unwrap();
        assert!((ratio("vertical.thrust.hover") - 1.25).abs() < 1e-12);
        assert!((ratio("vertical.thrust.heave") - 0.8).abs() < 1e-12);
        // written and read again it is the same, not scaled once more
        assert_eq!(Model::parse(&model.to_toml().unwrap()).unwrap(), model);
        assert_eq!(model.inputs(), [VerticalInput::Thrust]);
    }

    #[test]
    fn what_the_numbers_say_nothing_of_is_refused() {
        for (from, to, words) in [
            ("arm = { value = 0.046", "arm = { value = 0.06", "vehicle.arm is 0.06 m"),
            ("mass = { value = 0.0368", "mass = { value = 0.06", "hovers at a PWM of 64145"),
        ] {
            let error = edited(from, to).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        let heavier = THESIS_TOML.replacen("mass = { value = 0.0368", "mass = { value = 0.05", 1);
        let error = Model::parse(&heavier).unwrap_err().to_string();
        assert!(error.contains("vertical.height and vertical.pwm were identified with 0.0368 kg"), "{error}");
    }
}
