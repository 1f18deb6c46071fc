//! Named faults fitted to a change of the hover trim, with what the registry's effects would ask of the
//! motors.

use super::demand::{DEMAND, EffectDemand};

/// The effect of a payload, and of a worn motor or propeller.
const MASS: &str = "mass_change";
const MOTOR: &str = "weak_motor";
/// A payload sits within this many motor spacings of the centre: propeller guards reach so far. In hover a
/// payload over a motor moves the balance by as much as it adds thrust.
const REACH: f64 = 1.5;
/// A propeller whose diameter is a share d shorter loses 4 d of its thrust and 5 d of its torque at equal
/// speed; relieved, a brushed motor turns faster by some 1.2 d, which leaves a loss of about 1.5 d. At equal
/// thrust its torque stays d smaller, so yaw is asked for (1.5 + 1) / 1.5 times as much as the effect says,
/// which knows a motor whose torque goes with its thrust (1 times). How far a motor slows under load is known
/// to a factor of 1.5 at best.
const YAW_SHARE: f64 = 1.7;
const YAW_SHARE_LOG_SD: f64 = 0.4;
/// Range of the logarithm of that share, three standard deviations, and the points it is searched on.
const YAW_SHARE_POINTS: usize = 60;
/// Heavier or weaker than this, as a share of the hover thrust, a vehicle cannot fly.
const MOST: f64 = 0.5;
/// Sizes are searched on this many points, then refined.
const GRID: usize = 400;

/// A fault of some size.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// A payload: its mass, and how far it moves the balance to the left and to the front, in motor spacings.
    AddedWeight {
        /// Mass of the payload.
        mass_kg: f64,
        /// Shift of the balance to the left, in motor spacings; negative to the right.
        left: f64,
        /// Shift of the balance to the front, in motor spacings; negative to the back.
        front: f64,
    },
    /// A motor or propeller that gives less thrust for what it is asked.
    WeakMotor {
        /// Number of the motor: 1 front right, 2 back right, 3 back left, 4 front left.
        motor: usize,
        /// Share of its thrust that is lost, at most 0.5.
        loss: f64,
    },
}

/// A fault fitted to a change.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultFit {
    /// Kind of the fault, at its most likely size.
    pub fault: Fault,
    /// Of the mass or of the loss.
    pub stderr: f64,
    /// Squared standard deviations that are left.
    pub misfit: f64,
    /// Misfit with two for each number that was free (Akaike).
    pub criterion: f64,
}

/// A change of the relative trim and its variances.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TrimChange {
    pub by: [f64; 4],
    pub variances: [f64; 4],
}

/// Faults that the registry's effects describe, best first. A fault at no size is left out.
#[must_use]
pub(crate) fn fit_faults(change: &TrimChange, demands: &[EffectDemand]) -> Vec<FaultFit> {
    let weight = demands.iter().find(|d| d.effect == MASS).and_then(|d| fit_weight(change, d));
    let motors = demands.iter().filter(|d| d.effect == MOTOR).filter_map(|d| fit_motor(change, d));
    let mut fits: Vec<FaultFit> = weight.into_iter().chain(motors).collect();
    fits.sort_by(|a, b| a.criterion.total_cmp(&b.criterion));
    fits
}

/// Effects that ask the same of the motors as a payload, so that no hover tells them from it.
#[must_use]
pub fn look_alikes(demands: &[EffectDemand]) -> Vec<&'static str> {
    let asks_thrust_alone =
        |d: &&EffectDemand| d.per_unit[1..].iter().all(|x| x.abs() < 1e-3 * d.per_unit[0].abs());
    let mut names: Vec<&'static str> =
        demands.iter().filter(|d| d.effect != MASS).filter(asks_thrust_alone).map(|d| d.effect).collect();
    // an effect that a search begins at several values has a demand at each, one after the other
    names.dedup();
    names
}

fn fit_weight(change: &TrimChange, demand: &EffectDemand) -> Option<FaultFit> {
    let TrimChange { by, variances } = change;
    let per_kg = demand.per_unit[0];
    let off = |i: usize, share: f64| (by[i].abs() - REACH * share).max(0.0).powi(2) / variances[i];
    let misfit = |share: f64| {
        (by[0] - share).powi(2) / variances[0] + off(1, share) + off(2, share) + by[3].powi(2) / variances[3]
    };
    let share = least(misfit, MOST.min(demand.range[1] * per_kg));
    let place = |i: usize| (by[i] / share).clamp(-REACH, REACH);
    let fault = Fault::AddedWeight { mass_kg: share / per_kg, left: place(1), front: place(2) };
    // the mass and the place
    (share > 0.0).then(|| FaultFit {
        fault,
        stderr: variances[0].sqrt() / per_kg,
        misfit: misfit(share),
        criterion: misfit(share) + 6.0,
    })
}

fn fit_motor(change: &TrimChange, demand: &EffectDemand) -> Option<FaultFit> {
    let TrimChange { by, variances } = change;
    let unit = demand.per_unit;
    let off = |i: usize, asked: f64| (by[i] - asked).powi(2) / variances[i];
    // at the share of yaw that does best, its own uncertainty counted
    let yaw = |loss: f64| {
        let at = |point: usize| {
            let sds = 6.0 * (point as f64 / YAW_SHARE_POINTS as f64 - 0.5);
            off(3, unit[3] * loss * YAW_SHARE * (YAW_SHARE_LOG_SD * sds).exp()) + sds * sds
        };
        (0..=YAW_SHARE_POINTS).map(at).fold(f64::INFINITY, f64::min)
    };
    let misfit = |loss: f64| (0..DEMAND.len() - 1).map(|i| off(i, unit[i] * loss)).sum::<f64>() + yaw(loss);
    let loss = least(misfit, MOST.min(demand.range[1]));
    let fault = Fault::WeakMotor { motor: demand.variant?, loss };
    // the loss and the share of yaw
    (loss > 0.0).then(|| FaultFit {
        fault,
        stderr: width(misfit, loss),
        misfit: misfit(loss),
        criterion: misfit(loss) + 4.0,
    })
}

/// Standard error by likelihood: how far from the best size the misfit has grown by one.
fn width(misfit: impl Fn(f64) -> f64, best: f64) -> f64 {
    let bound = misfit(best) + 1.0;
    let (mut low, mut high) = (best, best + MOST);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if misfit(middle) < bound { low = middle } else { high = middle }
    }
    high - best
}

/// The place between 0 and `high` where a function of one valley, or flat on a part of it, is least.
fn least(value: impl Fn(f64) -> f64, high: f64) -> f64 {
    let step = high / GRID as f64;
    let best =
        (0..=GRID).min_by(|a, b| value(*a as f64 * step).total_cmp(&value(*b as f64 * step))).unwrap_or(0);
    let (mut low, mut top) = ((best as f64 - 1.0).max(0.0) * step, ((best + 1) as f64 * step).min(high));
    for _ in 0..40 {
        let (a, b) = (low + (top - low) / 3.0, top - (top - low) / 3.0);
        if value(a) <= value(b) { top = b } else { low = a }
    }
    if best == 0 && value(0.0) <= value(0.5 * (low + top)) { 0.0 } else { 0.5 * (low + top) }
}

impl Fault {
    /// Words for a table, with the size's standard error.
    #[must_use]
    pub fn description(&self, stderr: f64) -> String {
        match self {
            Self::AddedWeight { mass_kg, left, front } => {
                let side = side_of(*left, *front).map_or(String::new(), |side| format!(", {side}"));
                format!("weight added: {:.2} +- {:.2} g{side}", 1e3 * mass_kg, 1e3 * stderr)
            }
            Self::WeakMotor { motor, loss } => {
                format!(
                    "weak motor {motor} ({}): {:.1} +- {:.1} % of its thrust lost",
                    place_of(*motor),
                    100.0 * loss,
                    100.0 * stderr
                )
            }
        }
    }
}

fn place_of(motor: usize) -> &'static str {
    match motor {
        1 => "front right",
        2 => "back right",
        3 => "back left",
        _ => "front left",
    }
}

/// Direction of a place by the motors it lies towards. `None` near the middle, a quarter of the way to a
/// motor.
#[must_use]
pub fn side_of(left: f64, front: f64) -> Option<&'static str> {
    const MIDDLE: f64 = 0.25;
    /// Tangent of 22.5 degrees: between a side and a corner.
    const CORNER: f64 = 0.414;
    if left.hypot(front) < MIDDLE {
        return None;
    }
    let is_left = left > 0.0;
    let is_front = front > 0.0;
    Some(if front.abs() < CORNER * left.abs() {
        if is_left { "towards M3 and M4 (left)" } else { "towards M1 and M2 (right)" }
    } else if left.abs() < CORNER * front.abs() {
        if is_front { "towards M1 and M4 (front)" } else { "towards M2 and M3 (back)" }
    } else {
        match (is_left, is_front) {
            (false, true) => "towards M1 (front right)",
            (false, false) => "towards M2 (back right)",
            (true, false) => "towards M3 (back left)",
            (true, true) => "towards M4 (front left)",
        }
    })
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::Model;

    use super::super::demand::effect_demands;
    use super::*;

    const VARIANCES: [f64; 4] = [1e-4, 2.25e-4, 2.25e-4, 1e-4];

    fn best(by: [f64; 4]) -> FaultFit {
        let demands = effect_demands(&Model::thesis()).unwrap();
        fit_faults(&TrimChange { by, variances: VARIANCES }, &demands).remove(0)
    }

    #[test]
    fn a_weight_asks_no_yaw_and_a_weak_motor_does() {
        let model = Model::thesis();
        let mass_kg = model.parameter("vehicle.mass").unwrap();
        let found = best([0.06, 0.06, -0.06, 0.0]);
        let Fault::AddedWeight { mass_kg: added, left, front } = found.fault else { panic!("{found:?}") };
        assert!(
            (added - 0.06 * mass_kg).abs() < 2e-3 * mass_kg
                && side_of(left, front) == Some("towards M3 (back left)"),
            "{found:?}"
        );
        for (motor, signs) in
            [(1, [-1.0, 1.0, 1.0]), (2, [-1.0, -1.0, -1.0]), (3, [1.0, -1.0, 1.0]), (4, [1.0, 1.0, -1.0])]
        {
            // a cut propeller asks for more yaw than thrust
            let found = best([0.05, 0.05 * signs[0], 0.05 * signs[1], 0.08 * signs[2]]);
            let Fault::WeakMotor { motor: named, loss } = found.fault else { panic!("{found:?}") };
            assert!(named == motor && (loss - 0.2).abs() < 0.01, "{found:?}");
            assert!(found.misfit < 0.1 && (0.01..0.04).contains(&found.stderr), "{found:?}");
        }
    }

    #[test]
    fn the_same_thrust_from_a_stronger_battery_is_said_to_look_alike() {
        // and so does a load that hangs still
        let alike = look_alikes(&effect_demands(&Model::thesis()).unwrap());
        let count = |name: &str| alike.iter().filter(|other| **other == name).count();
        assert_eq!(["thrust_scale", "slung_load"].map(count), [1, 1], "{alike:?}");
    }

    #[test]
    fn sides_are_told_by_motors() {
        assert_eq!(side_of(1.0, 0.1), Some("towards M3 and M4 (left)"));
        assert_eq!(side_of(-0.1, -1.0), Some("towards M2 and M3 (back)"));
        assert_eq!(side_of(0.1, 0.1), None);
    }
}
