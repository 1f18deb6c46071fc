//! Named faults compared with a change of the hover trim: the demands of the registry's effects on the motors.
//!
//! The demand of a fault is its size times a range: a cut propeller's torque and a payload's place are known within
//! bounds only. The evidence of a fault is the density of the change, averaged over sizes and ranges. Numbers without
//! a source were set with `tests/diagnosis_rates.rs`, whose head names the draws.

use std::f64::consts::FRAC_PI_4;

use super::demand::EffectDemand;
use super::spread::Noise;

/// Places of motors 1 to 4.
const PLACES: [&str; 4] = ["front right", "back right", "back left", "front left"];
/// The effect of a payload, and of a worn motor or propeller.
const MASS: &str = "mass_change";
const MOTOR: &str = "weak_motor";
/// A payload sits within this many motor spacings of the centre: propeller guards reach so far. In hover a
/// payload over a motor moves the balance by as much as it adds thrust.
const REACH: f64 = 1.5;
/// Nearer to the centre it is in the middle, further out it may be under a propeller, in motor spacings.
const MIDDLE: f64 = 0.25;
const PROPELLER: f64 = 0.5;
/// A payload under a propeller costs that propeller up to 1.2 times its weight, hence yaw up to this share.
const PAYLOAD_YAW: f64 = 0.4;
/// Yaw over thrust of a weak motor's demand. A worn one: 1. A propeller whose diameter is a share d shorter loses
/// some 1.5 d of its thrust and, at equal thrust, d of its torque: 1.7, known to a factor of 1.5.
const MOTOR_YAW: [f64; 2] = [0.8, 2.5];
/// Sizes are equally likely on a logarithmic scale, as shares of the hover thrust or of a motor's.
const SIZES: [f64; 2] = [0.03, 0.5];
const SIZE_POINTS: usize = 40;
/// Losses of the less weak of two motors, over those of the weaker.
const RATIOS: [f64; 2] = [0.5, 1.0];
/// Chances before the flights are seen, of a change that is there: one weak motor, a payload, two weak motors,
/// something without a name.
const PRIORS: [f64; 4] = [0.5, 0.38, 0.07, 0.05];

/// A name goes before no name if its chance is at least this share of that of no name.
const UNNAMED_RANK: f64 = 0.3;

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
    /// Motors or propellers that give less thrust than commanded, the weakest first.
    WeakMotors(Vec<WeakMotor>),
    /// A change that matches no named fault.
    Unnamed,
}

/// A motor or propeller that gives less thrust than commanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeakMotor {
    /// Number of the motor: 1 front right, 2 back right, 3 back left, 4 front left.
    pub motor: usize,
    /// Share of its thrust that is lost, at most 0.5.
    pub loss: f64,
}

/// A fault compared with a change.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultFit {
    /// The fault at its mean size.
    pub fault: Fault,
    /// Standard error of the mass or of the largest loss.
    pub stderr: f64,
    /// Chance of this fault, given that one of the compared faults is there.
    pub chance: f64,
}

/// A change of the relative trim and its noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TrimChange {
    pub by: [f64; 4],
    pub noise: [Noise; 4],
}

/// Demands of a fault of size 1, each anywhere in its range.
type Ranges = [[f64; 2]; 4];

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    /// Mass of a payload that doubles the hover thrust.
    Weight {
        per_share_kg: f64,
    },
    /// Numbers of the motors, and the loss of each over that of the weakest.
    Motors(Vec<WeakMotor>),
    Unnamed,
}

/// The smallest faults that raise an alarm nine times in ten.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmallestFound {
    /// Share of its thrust that one motor loses.
    pub motor_loss: f64,
    /// Payload at one motor spacing to a side, as a share of the hover thrust.
    pub beside: f64,
    /// Payload in the middle, as a share of the hover thrust.
    pub middle: f64,
}

/// A fault of any size, before the flights are seen.
#[derive(Debug, Clone)]
struct Hypothesis {
    kind: Kind,
    prior: f64,
    ranges: Ranges,
}

/// A fault of one size, and its chance times what all chances have in common.
struct Point<'a> {
    kind: &'a Kind,
    size: f64,
    chance: f64,
}

/// All faults that the registry's effects describe.
#[derive(Debug, Clone)]
pub(crate) struct Faults {
    all: Vec<Hypothesis>,
}

fn sizes() -> impl Iterator<Item = f64> {
    let [low, high] = SIZES;
    (0..SIZE_POINTS).map(move |i| low * (high / low).powf(i as f64 / (SIZE_POINTS - 1) as f64))
}

impl Faults {
    pub(crate) fn new(demands: &[EffectDemand]) -> Self {
        let motor = |d: &EffectDemand| {
            let [thrust, roll, pitch, yaw] = d.per_unit;
            Some((d.variant?, [[thrust; 2], [roll; 2], [pitch; 2], MOTOR_YAW.map(|share| share * yaw)]))
        };
        let motors: Vec<_> = demands.iter().filter(|d| d.effect == MOTOR).filter_map(motor).collect();
        let count = motors.len() as f64;
        // any one number, or all of them
        let one = |axis: usize| std::array::from_fn(|i| if i == axis { [-1.0, 1.0] } else { [0.0; 2] });
        let odd = (0..4).map(one).chain([[[-1.0, 1.0]; 4]]);
        let mut all: Vec<Hypothesis> =
            odd.map(|ranges| Hypothesis { kind: Kind::Unnamed, prior: PRIORS[3] / 5.0, ranges }).collect();
        if let Some(mass) = demands.iter().find(|d| d.effect == MASS) {
            let kind = Kind::Weight { per_share_kg: 1.0 / mass.per_unit[0] };
            let near = [-MIDDLE, MIDDLE];
            let mut places = vec![(1.0, [[1.0; 2], near, near, [0.0; 2]])];
            for (_, [_, roll, pitch, yaw]) in &motors {
                let towards = |range: &[f64; 2], reach: [f64; 2]| reach.map(|r| r * range[0].signum());
                let at = |reach: [f64; 2], yaw| [[1.0; 2], towards(roll, reach), towards(pitch, reach), yaw];
                places.push((1.0 / count, at([0.0, REACH], [0.0; 2])));
                places.push((1.0 / count, at([PROPELLER, REACH], towards(yaw, [0.0, PAYLOAD_YAW]))));
            }
            // in the middle, anywhere, under a propeller
            all.extend(places.into_iter().map(|(share, ranges)| Hypothesis {
                kind: kind.clone(),
                prior: PRIORS[1] * share / 3.0,
                ranges,
            }));
        }
        for (motor, ranges) in &motors {
            let weakest = WeakMotor { motor: *motor, loss: 1.0 };
            let kind = Kind::Motors(vec![weakest]);
            all.push(Hypothesis { kind, prior: PRIORS[0] / count, ranges: *ranges });
            for (second, other) in motors.iter().filter(|(second, _)| second != motor) {
                all.extend(RATIOS.map(|loss| Hypothesis {
                    kind: Kind::Motors(vec![weakest, WeakMotor { motor: *second, loss }]),
                    prior: PRIORS[2] / (count * (count - 1.0) * RATIOS.len() as f64),
                    ranges: std::array::from_fn(|i| [0, 1].map(|end| ranges[i][end] + loss * other[i][end])),
                }));
            }
        }
        Self { all }
    }

    /// Likelihood of the change with a fault over that without.
    pub(crate) fn odds(&self, change: &TrimChange) -> f64 {
        let all: f64 = self.all.iter().map(|h| h.prior * h.densities(change).sum::<f64>()).sum();
        all / SIZE_POINTS as f64 / density(change, &[[0.0; 2]; 4], 0.0)
    }

    /// The smallest faults that reach such odds nine times in ten, at most 1.
    pub(crate) fn smallest(&self, noise: [Noise; 4], odds: f64) -> SmallestFound {
        /// Standard normal quantile of nine in ten.
        const NINE_IN_TEN: f64 = 1.28;
        let size = |direction: [f64; 4]| {
            let is_found =
                |size: f64| self.odds(&TrimChange { by: direction.map(|d| d * size), noise }) >= odds;
            let (mut low, mut high) = (0.0, SIZES[1]);
            if !is_found(high) {
                return 1.0;
            }
            for _ in 0..9 {
                let middle = 0.5 * (low + high);
                if is_found(middle) { high = middle } else { low = middle }
            }
            let deviations = (0..4).map(|i| (direction[i] / noise[i].sd).powi(2)).sum::<f64>().sqrt();
            (high + NINE_IN_TEN / deviations).min(1.0)
        };
        // all motors ask for as much
        let motor = self.all.iter().find(|h| matches!(&h.kind, Kind::Motors(m) if m.len() == 1));
        let motor_loss = motor.map_or(1.0, |h| size(h.ranges.map(|[low, high]| 0.5 * (low + high))));
        SmallestFound { motor_loss, beside: size([1.0, 1.0, 0.0, 0.0]), middle: size([1.0, 0.0, 0.0, 0.0]) }
    }

    /// Faults by their chance, the likeliest first. One kind of fault is one name.
    pub(crate) fn fits(&self, change: &TrimChange) -> Vec<FaultFit> {
        // each name's hypotheses, with the chance of each size
        let mut names: Vec<(Vec<usize>, Vec<Point<'_>>)> = Vec::new();
        for hypothesis in &self.all {
            let Hypothesis { kind, prior, .. } = hypothesis;
            let densities = hypothesis.densities(change).zip(sizes());
            let points = densities.map(|(density, size)| Point { kind, size, chance: prior * density });
            match names.iter_mut().find(|(name, _)| *name == kind.name()) {
                Some((_, all)) => all.extend(points),
                None => names.push((kind.name(), points.collect())),
            }
        }
        let all: f64 = names.iter().flat_map(|(_, points)| points).map(|p| p.chance).sum();
        let mut fits: Vec<FaultFit> =
            names.iter().map(|(_, points)| fit_of_points(points, &change.by, all)).collect();
        let rank = |f: &FaultFit| f.chance * if f.fault == Fault::Unnamed { UNNAMED_RANK } else { 1.0 };
        fits.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
        fits
    }
}

impl Kind {
    /// Motors in order of their numbers; none for a payload, and 0 for what has no name.
    fn name(&self) -> Vec<usize> {
        let mut name: Vec<usize> = match self {
            Self::Weight { .. } => Vec::new(),
            Self::Motors(motors) => motors.iter().map(|m| m.motor).collect(),
            Self::Unnamed => vec![0],
        };
        name.sort_unstable();
        name
    }
}

impl Hypothesis {
    /// Density of a change by size.
    fn densities<'a>(&'a self, change: &'a TrimChange) -> impl Iterator<Item = f64> + 'a {
        sizes().map(|size| density(change, &self.ranges, size))
    }
}

fn density(change: &TrimChange, ranges: &Ranges, size: f64) -> f64 {
    (0..4).map(|i| change.noise[i].density(change.by[i], ranges[i].map(|end| end * size))).product()
}

/// The fault at its mean size, from the chances of sizes and of the motors' order.
fn fit_of_points(points: &[Point<'_>], by: &[f64; 4], all: f64) -> FaultFit {
    let chance: f64 = points.iter().map(|p| p.chance).sum();
    let mean = |value: &dyn Fn(&Kind, f64) -> f64| {
        points.iter().map(|p| p.chance * value(p.kind, p.size)).sum::<f64>() / chance
    };
    let size = mean(&|_, size| size);
    let spread = mean(&|_, other| (other - size).powi(2)).sqrt();
    let (fault, unit) = match points[0].kind {
        Kind::Weight { per_share_kg } => {
            let place = |i: usize| (by[i] / size).clamp(-REACH, REACH);
            let fault = Fault::AddedWeight { mass_kg: size * per_share_kg, left: place(1), front: place(2) };
            (fault, *per_share_kg)
        }
        Kind::Motors(motors) => {
            let loss_of = |motor: usize| {
                mean(&|kind, size| match kind {
                    Kind::Motors(all) => all.iter().filter(|m| m.motor == motor).map(|m| m.loss * size).sum(),
                    _ => 0.0,
                })
            };
            let mut weak: Vec<WeakMotor> =
                motors.iter().map(|m| WeakMotor { motor: m.motor, loss: loss_of(m.motor) }).collect();
            weak.sort_by(|a, b| b.loss.total_cmp(&a.loss));
            (Fault::WeakMotors(weak), 1.0)
        }
        Kind::Unnamed => (Fault::Unnamed, 1.0),
    };
    FaultFit { fault, stderr: spread * unit, chance: chance / all }
}

/// Returns the effects with the same demand on the motors as a payload, so that no hover distinguishes them.
#[must_use]
pub fn look_alikes(demands: &[EffectDemand]) -> Vec<&'static str> {
    let is_thrust_alone =
        |d: &&EffectDemand| d.per_unit[1..].iter().all(|x| x.abs() < 1e-3 * d.per_unit[0].abs());
    let alike = demands.iter().filter(|d| d.effect != MASS).filter(is_thrust_alone);
    let mut names: Vec<&'static str> = alike.map(|d| d.effect).collect();
    // an effect that a search begins at several values has a demand at each, one after the other
    names.dedup();
    names
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
            Self::WeakMotors(motors) => {
                let words = |m: &WeakMotor| {
                    let (motor, place) = (m.motor, PLACES[(m.motor - 1) % 4]);
                    let [loss, error] = [m.loss, stderr].map(|share| 100.0 * share);
                    format!("weak motor {motor} ({place}): {loss:.0} +- {error:.0} % of its thrust lost")
                };
                motors.iter().map(words).collect::<Vec<_>>().join(", and ")
            }
            Self::Unnamed => "something that cannot be named".into(),
        }
    }
}

/// Direction of a place by the motors it lies towards. `None` in the middle.
#[must_use]
pub fn side_of(left: f64, front: f64) -> Option<&'static str> {
    /// From the front to the left, an eighth of a turn each.
    const SIDES: [&str; 8] = [
        "towards M1 and M4 (front)",
        "towards M4 (front left)",
        "towards M3 and M4 (left)",
        "towards M3 (back left)",
        "towards M2 and M3 (back)",
        "towards M2 (back right)",
        "towards M1 and M2 (right)",
        "towards M1 (front right)",
    ];
    let eighths = (left.atan2(front) / FRAC_PI_4).round().rem_euclid(8.0);
    (left.hypot(front) >= MIDDLE).then(|| SIDES[eighths as usize])
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::Model;

    use super::super::demand::effect_demands;
    use super::*;

    fn fits(by: [f64; 4]) -> Vec<FaultFit> {
        let faults = Faults::new(&effect_demands(&Model::thesis()).unwrap());
        let noise = [0.01, 0.015, 0.015, 0.01].map(|sd| Noise { sd, freedom: 10.0 });
        faults.fits(&TrimChange { by, noise })
    }

    #[test]
    fn a_weight_asks_no_yaw_and_a_weak_motor_does() {
        let mass_kg = Model::thesis().parameter("vehicle.mass").unwrap();
        let found = fits([0.06, 0.06, -0.06, 0.0]).remove(0);
        let Fault::AddedWeight { mass_kg: added, left, front } = found.fault else { panic!("{found:?}") };
        assert!((added - 0.06 * mass_kg).abs() < found.stderr && found.stderr < 0.02 * mass_kg, "{found:?}");
        assert_eq!(side_of(left, front), Some("towards M3 (back left)"));
        for (motor, signs) in
            [(1, [-1.0, 1.0, 1.0]), (2, [-1.0, -1.0, -1.0]), (3, [1.0, -1.0, 1.0]), (4, [1.0, 1.0, -1.0])]
        {
            // a cut propeller may ask for more yaw than thrust; a battery that is fuller hides thrust
            for (thrust, yaw) in [(0.05, 0.08), (0.05, 0.05), (0.025, 0.05)] {
                let found = fits([thrust, 0.05 * signs[0], 0.05 * signs[1], yaw * signs[2]]).remove(0);
                let Fault::WeakMotors(weak) = &found.fault else { panic!("{found:?}") };
                assert!(weak.len() == 1 && weak[0].motor == motor, "{found:?}");
                assert!((weak[0].loss - 0.2).abs() < 0.08 && found.stderr < 0.05, "{found:?}");
            }
        }
    }

    #[test]
    fn thrust_that_a_battery_hides_does_not_refuse_a_motor() {
        // a cut propeller 3 of a second vehicle: equal shares, and half of the thrust
        let found = fits([0.038, 0.079, -0.078, 0.074]).remove(0);
        let Fault::WeakMotors(weak) = &found.fault else { panic!("{found:?}") };
        assert!(weak.len() == 1 && weak[0].motor == 3 && found.chance > 0.7, "{found:?}");
    }

    #[test]
    fn a_weight_under_a_propeller_stands_beside_that_motor() {
        let found = fits([0.05, 0.06, -0.06, 0.03]);
        let chance = |is: &dyn Fn(&Fault) -> bool| found.iter().find(|f| is(&f.fault)).unwrap().chance;
        let weight = chance(&|f| matches!(f, Fault::AddedWeight { .. }));
        let motor = chance(&|f| matches!(f, Fault::WeakMotors(m) if m.len() == 1 && m[0].motor == 3));
        assert!(weight > 0.1 && motor > 0.1 && weight + motor > 0.7, "{found:?}");
    }

    #[test]
    fn two_cut_propellers_are_named() {
        let found = fits([0.09, 0.0, 0.0, 0.12]).remove(0);
        let Fault::WeakMotors(weak) = &found.fault else { panic!("{found:?}") };
        let mut motors: Vec<usize> = weak.iter().map(|m| m.motor).collect();
        motors.sort_unstable();
        assert_eq!(motors, [1, 3], "{found:?}");
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
