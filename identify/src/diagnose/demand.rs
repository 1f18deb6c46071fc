//! Motor demand of the effects: a controller with an integral compensates any fault of a vehicle, so an effect shows
//! in hover as the mixer's demand on the four motors that undoes it. The simulator computes that demand; there is no
//! second formula.

use crazyflie_env::effects::{self, Entry};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::motors::MOTORS;
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use nalgebra::{Matrix4, Vector4};

use crate::explain::candidates::candidates;
use crate::fit::hypothesis::{Hypothesis, Term};

/// Components of a motor demand: the mean of all motors, then a quarter of left less right, of front less
/// back, and of motors 1 and 3 less 2 and 4, which turn the other way.
pub const DEMAND: [&str; 4] = ["thrust", "roll", "pitch", "yaw"];
/// Height of the simulated flights that determine an effect's demand, far from the floor.
const HEIGHT_M: f64 = 10.0;
/// Slopes are differences over this share of a parameter's range.
const STEP: f64 = 1e-3;
/// Least demand of an effect over its whole range, as a share of the hover thrust; less counts as none.
const NOTHING: f64 = 1e-3;
/// The effect whose slopes give the thrust of each motor.
const MOTOR: &str = "weak_motor";

/// Returns the matrix that computes the four demands from those on the four motors.
pub(super) fn mix() -> Matrix4<f64> {
    Matrix4::from_columns(&MOTORS.map(|[front, left]| Vector4::new(1.0, left, front, -front * left))) / 4.0
}

/// Motor demand of one free parameter of an effect.
#[derive(Debug, Clone)]
pub struct EffectDemand {
    /// Registry name of the effect.
    pub effect: &'static str,
    /// The variant's number, such as which motor.
    pub variant: Option<usize>,
    /// Shares of the hover thrust per unit of the parameter, in the order of [`DEMAND`].
    pub per_unit: [f64; 4],
}

/// Motor demands of all effects of the registry that the motors can make up for.
///
/// # Errors
/// A model that cannot be flown by a thrust command.
pub fn effect_demands(model: &Model) -> crazyflie_env::Result<Vec<EffectDemand>> {
    let motors = effects::find(MOTOR)?.1;
    let all: Vec<Term> = candidates(&Hypothesis::from_model(model))
        .iter()
        // a wrong attitude shifts where a vehicle hovers, not what its motors do there
        .filter(|c| !c.entry.hooks.sense)
        .flat_map(|c| c.starts[..c.variants].to_vec())
        .collect();
    let none = after_a_tick(&Hypothesis::from_model(model))?;
    // each motor's share of the motion, from the motion that is lost with it
    let mut gives = Matrix4::zeros();
    for (motor, term) in all.iter().filter(|t| std::ptr::eq::<Entry>(t.entry, motors)).take(4).enumerate() {
        gives.set_column(motor, &-slope(model, term, *term.free.first().unwrap_or(&0), &none)?);
    }
    let Some(needed) = gives.try_inverse() else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for term in &all {
        let mut params = term.entry.params.iter().zip(&term.values);
        let choice = params.find(|(p, _)| p.role == effects::Role::Choice);
        let (effect, variant) = (term.entry.name, choice.map(|(_, value)| *value as usize));
        for i in &term.free {
            let p = &term.entry.params[*i];
            let demand: Vector4<f64> = mix() * needed * -slope(model, term, *i, &none)?;
            if demand.norm() * (p.high - p.low) > NOTHING {
                found.push(EffectDemand { effect, variant, per_unit: demand.into() });
            }
        }
    }
    Ok(found)
}

/// Change per unit of a parameter of the climb and to the turn rates, a tick after hover.
fn slope(model: &Model, term: &Term, i: usize, none: &Vector4<f64>) -> crazyflie_env::Result<Vector4<f64>> {
    let p = &term.entry.params[i];
    let step = STEP * (p.farthest_bound() - p.off);
    let moved = Hypothesis::from_model(model).with(term.with_value(i, p.off + step));
    Ok((after_a_tick(&moved)? - none) / step)
}

fn after_a_tick(hypothesis: &Hypothesis) -> crazyflie_env::Result<Vector4<f64>> {
    let model = hypothesis.to_model("hover");
    let settings = Settings { input: VerticalInput::Thrust, physics_hz: None };
    let mut world = World::<f64>::new(&model, &Default::default(), settings, 1)?;
    let mut start = State::rest();
    start.pos_m[2] = HEIGHT_M;
    let command = Command::level(model.parameter("vertical.thrust.hover")?);
    world.start(0, true, &start, &command);
    world.step(0, &command);
    let x = world.state(0);
    let [roll, pitch, yaw] = x.rate_radps;
    Ok(Vector4::new(x.vel_mps[2], roll, pitch, yaw))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn demands_are_those_of_newton_and_of_the_mixer() {
        let model = Model::thesis();
        let demands = effect_demands(&model).unwrap();
        let demand_of = |effect: &str, variant: Option<usize>| {
            demands.iter().find(|d| d.effect == effect && d.variant == variant).unwrap()
        };
        let mass_kg = model.parameter("vehicle.mass").unwrap();
        let heavier = demand_of("mass_change", None).per_unit;
        assert!((heavier[0] * mass_kg - 1.0).abs() < 2e-3, "{heavier:?}");
        assert!(heavier[1..].iter().all(|d| (d * mass_kg).abs() < 1e-6), "{heavier:?}");
        // back left: a quarter of what it lacks is thrust, and to the left, to the back, and against the turn
        // of 1 and 3
        for (demand, sign) in demand_of("weak_motor", Some(3)).per_unit.iter().zip([1.0, 1.0, -1.0, 1.0]) {
            assert!((demand / 0.25 - sign).abs() < 1e-6, "{demand}");
        }
        // a vehicle heavier on the right, which is positive roll, needs more thrust there
        assert!(demand_of("com_offset", None).per_unit[1] < 0.0);
        assert!(
            demands.iter().all(|d| !["drag_linear", "wind", "cmd_delay", "imu_tilt"].contains(&d.effect))
        );
    }
}
