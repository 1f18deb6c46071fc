//! Output of `crazyflie identify --form motors`.

use std::collections::BTreeMap;
use std::io::Write;

use crazyflie_env::model::Model;
use crazyflie_identify::estimate::ParameterEstimate;
use crazyflie_identify::motor::form::{EQUATIONS, MotorEstimate, MotorRecord};
use serde_json::{Value, json};

use super::identify_table::estimates;
use super::{Outcome, number, percent};

/// A motor-level form, and the flights that judge it.
pub(super) struct MotorIdentification<'a> {
    pub before: &'a Model,
    pub found: &'a MotorEstimate,
    pub flights: usize,
    pub test: &'a [MotorRecord],
}

impl MotorIdentification<'_> {
    /// Share that is explained, in the flights of the fit and in others.
    fn explained(&self) -> Vec<(&'static str, [f64; 4])> {
        let fit = [("fit", self.found.explained)];
        let test = (!self.test.is_empty()).then(|| ("test", self.found.explained_in(self.test)));
        fit.into_iter().chain(test).collect()
    }

    fn rows(&self) -> Vec<(&ParameterEstimate, Option<f64>)> {
        self.found.parameters.iter().map(|p| (p, self.before.parameter(&p.name).ok())).collect()
    }
}

pub(super) fn write(shown: &MotorIdentification<'_>, out: &mut dyn Write) -> Outcome {
    let MotorIdentification { before, found, flights, .. } = shown;
    let (mass_g, arm_mm) = (1e3 * before.vehicle.mass.value, 1e3 * before.vehicle.arm.value);
    let declared = format!("{} g, {} mm to a motor", number(mass_g, 1), number(arm_mm, 0));
    let blocks = found.blocks;
    writeln!(out, "motor-level form, logs: {flights}, blocks of 2 s: {blocks}; declared: {declared}\n")?;
    writeln!(out, "{}", estimates("number", &shown.rows()))?;
    writeln!(out, "standard errors leave out one block after the other; inertias go with mass and arm\n")?;
    for (part, shares) in shown.explained() {
        let share = |(name, share): (&&str, &f64)| format!("{name} {}", percent(Some(100.0 * share), 0));
        let each: Vec<String> = EQUATIONS.iter().zip(&shares).map(share).collect();
        writeln!(out, "variance explained in the flights of the {part}: {}", each.join(", "))?;
    }
    let delay_ms = number(1e3 * found.delay_s, 0);
    writeln!(
        out,
        "gyro and accelerometer answer {delay_ms} ms later than by the motors' lag (their filters)"
    )?;
    if !found.not_told.is_empty() {
        writeln!(out, "not told by these flights, and left as they were: {}", found.not_told.join(", "))?;
    }
    Ok(())
}

pub(super) fn as_json(shown: &MotorIdentification<'_>) -> Value {
    let explained = shown.explained().into_iter();
    let shares: BTreeMap<_, BTreeMap<_, _>> =
        explained.map(|(part, shares)| (part, EQUATIONS.iter().zip(shares).collect())).collect();
    json!({
        "parameters": shown.found.parameters,
        "not_told": shown.found.not_told,
        "explained": shares,
        "delay_s": shown.found.delay_s,
        "blocks": shown.found.blocks,
    })
}
