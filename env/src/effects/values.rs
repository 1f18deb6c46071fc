//! Values that a model file or a configuration gives to effects, checked against the registry.

use rand_pcg::Pcg64Mcg;

use super::{Entry, Param, find};
use crate::effect_table::{EffectParams, EffectTable};
use crate::error::{Result, unknown};
use crate::model::{Model, Vehicle};
use crate::number::{Bounds, Number};

/// A number with the parameter that it is for.
#[derive(Debug, Clone)]
pub(crate) struct BoundedNumber {
    pub number: Number,
    pub param: &'static Param,
}

impl BoundedNumber {
    /// A value for one episode, within the parameter's range.
    pub fn draw(&self, rng: &mut Pcg64Mcg) -> f64 {
        self.number.draw(rng).clamp(self.param.low, self.param.high)
    }
}

/// The parameters of an effect in the order of its registry entry, defaults filled in.
pub fn numbers(entry: &Entry, given: &EffectParams) -> Vec<Number> {
    entry
        .params
        .iter()
        .enumerate()
        .map(|(i, p)| match given {
            EffectParams::First(number) if i == 0 => number.clone(),
            EffectParams::First(_) => Number::Fixed(p.off),
            EffectParams::Named(map) => map.get(p.name).cloned().unwrap_or(Number::Fixed(p.off)),
        })
        .collect()
}

/// Check names, units and ranges against the registry.
///
/// # Errors
/// [`crate::Error::Unknown`] with a proposal, [`crate::Error::Range`], [`crate::Error::Config`].
pub fn check_effects(table: &EffectTable) -> Result<()> {
    for (name, given) in table {
        let (_, entry) = find(name)?;
        if let EffectParams::Named(map) = given {
            for param in map.keys() {
                if !entry.params.iter().any(|p| p.name == param) {
                    let known: Vec<String> =
                        entry.params.iter().map(|p| format!("{name}.{}", p.name)).collect();
                    return Err(unknown(
                        "parameter of this effect",
                        &format!("{name}.{param}"),
                        known.iter().map(String::as_str),
                    ));
                }
            }
        }
        for (number, param) in numbers(entry, given).iter().zip(entry.params) {
            let (name, unit) = (format!("{name}.{}", param.name), param.unit);
            number.check(&Bounds { name, unit, low: param.low, high: param.high })?;
        }
    }
    Ok(())
}

/// Lift that one Crazyflie loses a quarter of a metre below another (see the effect `downwash`): drones that
/// share the air feel each other.
const DOWNWASH_N: f64 = 0.118;

/// Turns the effect `downwash` on as it was measured, unless the table sets it.
pub fn add_downwash(effects: &mut EffectTable) {
    effects.entry("downwash".into()).or_insert(EffectParams::First(Number::Fixed(DOWNWASH_N)));
}

impl Model {
    /// Reads a model and looks up its effects: the name of a vehicle of [`crate::model::VEHICLES`], or the text of a
    /// model file or of a data sheet, TOML or JSON (distinguished by the first character).
    ///
    /// # Errors
    /// [`crate::Error::Model`] with line and column for a syntax error, or naming the quantity whose unit or value
    /// is wrong; for effects as [`check_effects`].
    pub fn parse(text: &str) -> Result<Model> {
        if Vehicle::is_name(text) {
            return Vehicle::named(text).map(Vehicle::model);
        }
        let model = Model::read(text)?;
        Vehicle::check_name(&model)?;
        check_effects(&model.effects)?;
        Ok(model)
    }
}
