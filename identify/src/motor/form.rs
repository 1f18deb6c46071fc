//! The numbers of a model's motor-level form, from logs of motors, gyro and lift on any clock.
//!
//! Once the motors' lag is known, each equation is linear: the lift follows the thrust curve, the turn about an
//! axis follows the differences of the thrusts. Sums of products over blocks of two seconds hold all that is needed.
//! Each block has a level of its own, so that a battery that sags changes no slope. A delay is searched beside the
//! lag, since the firmware filters the gyro that it logs.

use std::ops::Range;

use crazyflie_env::model::{FULL_PWM, Model, Motors, Vertical};
use crazyflie_env::motors::SIDE_PER_ARM;
use nalgebra::Matrix3;

use super::regression::{jackknife, lagged, local_mean, mix};
use crate::estimate::ParameterEstimate;
use crate::fit::clock::usual_step;
use crate::vehicle::{unit_of, with_source};
use crate::{Error, FlightLog, Result};

/// Half of the time over which a slope is taken; at least two rows.
const HALF_S: f64 = 0.01;
const LEAST_HALF: usize = 2;
/// Length of a block, and the fewest of which standard errors can be made.
const BLOCK_S: f64 = 2.0;
const LEAST_BLOCKS: usize = 4;
/// Rows that are left out at the start, where the motors' state is unknown.
const UNKNOWN_S: f64 = 0.5;
/// Motor lags that are tried, and delays of the answer.
const LAG_STEP_S: f64 = 0.005;
const LAGS: usize = 30;
const DELAY_STEP_S: f64 = 0.002;
const DELAYS: usize = 11;
/// The vehicle flies while its motors together give more than this share of full PWM.
const FLIES: f64 = 0.15;
/// Take-off and landing, where nothing tells the height.
const ENDS_S: f64 = 1.0;
/// A block that feels more than this has hit something; one that turns faster leaves the gyro's range.
const MOST_FORCE_MPS2: f64 = 30.0;
const MOST_RATE_RADPS: f64 = 34.0;
/// An equation tells its numbers where it explains this share of the variance. Chosen after a look at two flights of
/// one laboratory: a calm one, of which it explains 0.7, gives another inertia than a lively one, of which it
/// explains 0.9.
const LEAST_EXPLAINED: f64 = 0.8;
/// An answer whose squares have a smaller sum does not move, in SI units.
const LEAST_SQUARES: f64 = 1e-6;
/// A number that is not known better than to this share of itself is not told.
const MOST_ERROR: f64 = 0.3;

/// The equations, in the order of [`MotorEstimate::explained`].
pub const EQUATIONS: [&str; 4] = ["roll", "pitch", "yaw", "lift"];
const LIFT: usize = 3;

/// The motors of a log and what they did, row by row.
#[derive(Debug, Clone)]
pub struct MotorRecord {
    step_s: f64,
    /// Shares of full PWM, at the battery's reference voltage where the log holds the voltage.
    share: [Vec<f64>; 4],
    rate_radps: [Vec<f64>; 3],
    /// Specific force along the body's z axis.
    lift_mps2: Vec<f64>,
}

impl MotorRecord {
    /// The part of a log that flies.
    ///
    /// # Errors
    /// [`Error`]: a signal is missing, or it hardly flies.
    pub fn from_log(name: &str, log: &FlightLog, model: &Model) -> Result<Self> {
        let missing = |missing| move || Error::about(name, format!("the log lacks {missing}"));
        let onboard = log.onboard.as_ref();
        let pwm =
            onboard.and_then(|o| o.motor_pwm.as_ref()).ok_or_else(missing("the PWM of the four motors"))?;
        let gyro = log.gyro_radps.as_ref().ok_or_else(missing("body rates"))?;
        let up = log.acc_mps2.as_ref().map(|acc| &acc[2]).or(onboard.and_then(|o| o.acc_z_mps2.as_ref()));
        let lift = up.ok_or_else(missing("the accelerometer's z axis"))?;
        let step_s = usual_step(&log.t_s).unwrap_or(f64::INFINITY);
        let reference_v = model.battery_reference_v();
        let scale: Option<Vec<f64>> =
            log.steady_voltage_v().map(|all| all.iter().map(|v| v / reference_v / FULL_PWM).collect());
        let share = |motor: usize, row: usize| {
            pwm[motor][row] * scale.as_ref().map_or(1.0 / FULL_PWM, |scale| scale[row])
        };
        let rows = flying_rows(log, step_s);
        if rows.len() as f64 * step_s < BLOCK_S {
            return Err(Error::about(name, format!("no {BLOCK_S} s of flight with the motors on")));
        }
        Ok(MotorRecord {
            step_s,
            share: std::array::from_fn(|motor| rows.clone().map(|row| share(motor, row)).collect()),
            rate_radps: gyro.each_ref().map(|axis| axis[rows.clone()].to_vec()),
            lift_mps2: lift[rows].to_vec(),
        })
    }

    /// Blocks in which nothing was hit.
    fn blocks(&self, half: usize) -> Vec<Range<usize>> {
        let (rows, length) = (self.lift_mps2.len(), (BLOCK_S / self.step_s) as usize);
        let calm = |rows: &Range<usize>| {
            let turns = self.rate_radps.iter().flat_map(|axis| &axis[rows.clone()]);
            self.lift_mps2[rows.clone()].iter().all(|f| f.abs() < MOST_FORCE_MPS2)
                && turns.into_iter().all(|rate| rate.abs() < MOST_RATE_RADPS)
        };
        let first = half.max((UNKNOWN_S / self.step_s) as usize);
        let block = |k: usize| first + k * length..first + (k + 1) * length;
        (0..rows.saturating_sub(first + half) / length.max(1)).map(block).filter(calm).collect()
    }

    /// Sums over each block, with the motors behind a lag and the answer after a delay.
    fn sums(&self, [lag_s, delay_s]: [f64; 2]) -> Vec<Sums> {
        let half = ((HALF_S / self.step_s).round() as usize).max(LEAST_HALF);
        let delay = (delay_s / self.step_s).round() as usize;
        let lagged = self.share.each_ref().map(|commanded| lagged(commanded, self.step_s / lag_s));
        let combined = |signs: [f64; 4], power: i32| -> Vec<f64> {
            let sum = |row: usize| (0..4).map(|m| signs[m] * lagged[m][row].powi(power)).sum();
            (0..self.lift_mps2.len()).map(|row| sum(row.saturating_sub(delay))).collect()
        };
        let inputs = signs().map(|signs| [1, 2].map(|power| combined(signs, power)));
        let span_s = 2.0 * half as f64 * self.step_s;
        let signals = |equation: usize, row: usize| {
            let [line, square] = inputs[equation].each_ref().map(|u| local_mean(u, row, half));
            let answer = match self.rate_radps.get(equation) {
                Some(rate) => (rate[row + half] - rate[row - half]) / span_s,
                None => local_mean(&self.lift_mps2, row, half),
            };
            [answer, line, square]
        };
        let of_block = |rows: Range<usize>| {
            let all = |equation: usize| -> Vec<[f64; 3]> {
                rows.clone().step_by(half).map(|row| signals(equation, row)).collect()
            };
            let lift = all(LIFT);
            let level = std::array::from_fn(|i| lift.iter().map(|s| s[i]).sum());
            Sums { products: std::array::from_fn(|equation| products(&all(equation))), level }
        };
        self.blocks(half).into_iter().map(of_block).collect()
    }
}

/// The rows in flight, by the log or else by its motors.
fn flying_rows(log: &FlightLog, step_s: f64) -> Range<usize> {
    if !log.airborne.is_empty() {
        return log.airborne.clone();
    }
    let driven = log.interval_driven(FLIES);
    let ends = (ENDS_S / step_s) as usize;
    driven.start + ends..driven.end.saturating_sub(ends).max(driven.start + ends)
}

/// Sign of each motor in each equation.
fn signs() -> [[f64; 4]; 4] {
    let [roll, pitch, yaw] = mix();
    [roll, pitch, yaw, [1.0; 4]]
}

/// Sums of products of the signals of an equation less their means: answer, PWM and PWM squared of the motors.
fn products(all: &[[f64; 3]]) -> Matrix3<f64> {
    let count = all.len().max(1) as f64;
    let mean: [f64; 3] = std::array::from_fn(|i| all.iter().map(|s| s[i]).sum::<f64>() / count);
    let product = |i: usize, j: usize| all.iter().map(|s| (s[i] - mean[i]) * (s[j] - mean[j])).sum();
    Matrix3::from_fn(product)
}

/// Sums over a block, or over several, at a lag and a delay.
#[derive(Debug, Clone, Copy)]
struct Sums {
    products: [Matrix3<f64>; 4],
    /// Sums of lift, PWM and squared PWM.
    level: [f64; 3],
}

impl Sums {
    fn sum<'a>(all: impl IntoIterator<Item = &'a Sums>) -> Sums {
        let none = Sums { products: [Matrix3::zeros(); 4], level: [0.0; 3] };
        all.into_iter().fold(none, |sum, block| sum.plus(block, 1.0))
    }

    fn plus(&self, other: &Sums, sign: f64) -> Sums {
        Sums {
            products: std::array::from_fn(|i| self.products[i] + sign * other.products[i]),
            level: std::array::from_fn(|i| self.level[i] + sign * other.level[i]),
        }
    }

    /// Sums of answer squared, answer times thrust, and thrust squared, for a curve of that linear share.
    fn of_curve(&self, equation: usize, linear: f64) -> [f64; 3] {
        let (p, square) = (&self.products[equation], 1.0 - linear);
        let by = |i: usize| linear * p[(1, i)] + square * p[(2, i)];
        [p[(0, 0)], by(0), linear * by(1) + square * by(2)]
    }

    /// Thrust over the lift, for a curve of that linear share.
    fn thrust_per_lift(&self, linear: f64) -> f64 {
        (linear * self.level[1] + (1.0 - linear) * self.level[2]) / self.level[0]
    }

    /// The linear share, from 0 to 1, of the curve through zero whose slope and level agree.
    fn linear_share(&self) -> f64 {
        let steeper = |linear: f64| self.slope(LIFT, linear) * self.thrust_per_lift(linear) > 1.0;
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            if steeper(middle) { high = middle } else { low = middle }
        }
        0.5 * (low + high)
    }

    /// Growth of the answer with the thrust.
    fn slope(&self, equation: usize, linear: f64) -> f64 {
        let [_, along, thrust] = self.of_curve(equation, linear);
        along / thrust
    }

    /// Share of the variance of the answer that a slope explains.
    fn explained(&self, equation: usize, linear: f64, slope: f64) -> f64 {
        let [answer, along, thrust] = self.of_curve(equation, linear);
        if answer > LEAST_SQUARES { slope * (2.0 * along - slope * thrust) / answer } else { 0.0 }
    }
}

/// All that is found at a time.
#[derive(Debug, Clone, Copy)]
struct Numbers {
    lag_s: f64,
    linear: f64,
    /// Lift per motor at full PWM over the mass.
    most_mps2: f64,
    /// Growth of each answer with the thrust.
    slopes: [f64; 4],
}

/// The sums of all blocks at every lag and delay.
struct Blocks {
    each: Vec<Vec<Sums>>,
    total: Vec<Sums>,
}

/// Lag and delay of a place in [`Blocks`]: the lags of one delay follow one another.
fn lag_and_delay_s(place: usize) -> [f64; 2] {
    [(place % LAGS + 1) as f64 * LAG_STEP_S, (place / LAGS) as f64 * DELAY_STEP_S]
}

impl Blocks {
    fn new(records: &[MotorRecord]) -> Self {
        let at = |place| records.iter().flat_map(|r| r.sums(lag_and_delay_s(place))).collect();
        let each: Vec<Vec<Sums>> = (0..LAGS * DELAYS).map(at).collect();
        let total = each.iter().map(Sums::sum).collect();
        Blocks { each, total }
    }

    fn count(&self) -> usize {
        self.each[0].len()
    }

    /// The best place and the numbers there, of all blocks but one; `linear` where the flights do not tell the
    /// curve.
    fn numbers(&self, without: Option<usize>, linear: Option<f64>) -> (usize, Numbers) {
        let sums = |place: usize| match without {
            Some(block) => self.total[place].plus(&self.each[place][block], -1.0),
            None => self.total[place],
        };
        let curve = |sums: &Sums| linear.unwrap_or_else(|| sums.linear_share());
        let left = |place: usize| -> f64 {
            let sums = sums(place);
            let linear = curve(&sums);
            let explained = |e: usize| sums.explained(e, linear, sums.slope(e, linear));
            [0, 1, LIFT].into_iter().map(|e| (1.0 - explained(e)).ln()).sum()
        };
        let all: Vec<f64> = (0..LAGS * DELAYS).map(left).collect();
        let best = (0..all.len()).min_by(|a, b| all[*a].total_cmp(&all[*b])).unwrap_or(0);
        let (sums, of_delay) = (sums(best), best / LAGS * LAGS);
        let linear = curve(&sums);
        let between = LAG_STEP_S * vertex(&all[of_delay..of_delay + LAGS], best % LAGS);
        let numbers = Numbers {
            lag_s: lag_and_delay_s(best)[0] + between,
            linear,
            most_mps2: 1.0 / sums.thrust_per_lift(linear),
            slopes: std::array::from_fn(|e| sums.slope(e, linear)),
        };
        (best, numbers)
    }
}

/// Minimum of the parabola through a least value and its neighbours, in steps from it.
fn vertex(all: &[f64], at: usize) -> f64 {
    if at == 0 || at + 1 == all.len() {
        return 0.0;
    }
    let [before, least, after] = [all[at - 1], all[at], all[at + 1]];
    0.5 * (before - after) / (before - 2.0 * least + after)
}

/// The motor-level form of a vehicle, from its flights.
#[derive(Debug, Clone)]
pub struct MotorEstimate {
    /// The model, with what these flights tell of the form.
    pub model: Model,
    /// Numbers that the flights tell.
    pub parameters: Vec<ParameterEstimate>,
    /// Numbers that they do not tell, which stay those of the model before.
    pub not_told: Vec<&'static str>,
    /// Share of the variance that the form explains in the flights of the fit, in the order of [`EQUATIONS`].
    pub explained: [f64; 4],
    /// Delay of gyro and accelerometer beyond the motors' lag. The form has no such delay.
    pub delay_s: f64,
    /// Blocks of two seconds that were fitted.
    pub blocks: usize,
    place: usize,
    numbers: Numbers,
}

impl MotorEstimate {
    /// Share of the variance that the form explains in other flights, in the order of [`EQUATIONS`].
    #[must_use]
    pub fn explained_in(&self, records: &[MotorRecord]) -> [f64; 4] {
        let at = lag_and_delay_s(self.place);
        let sums = Sums::sum(&records.iter().flat_map(|r| r.sums(at)).collect::<Vec<_>>());
        std::array::from_fn(|e| sums.explained(e, self.numbers.linear, self.numbers.slopes[e]))
    }
}

/// Identifies the motor-level form of a model that has one already, of the mass and the arm of that model.
///
/// # Errors
/// [`Error`]: the model has no motor form, or the flights tell none of its numbers.
pub fn identify_motors(model: &Model, records: &[MotorRecord]) -> Result<MotorEstimate> {
    let Some(Vertical::Motors(before)) = &model.vertical.motors else {
        let needed = "no motor-level form to start from, as cf21 and the other vehicles by name have";
        return Error::logs(format!("the model {} has {needed}", model.name));
    };
    let blocks = Blocks::new(records);
    if blocks.count() < LEAST_BLOCKS {
        let found = format!("{} blocks of 2 s of flight without a hit", blocks.count());
        return Error::logs(format!("the logs hold {found}, expected at least {LEAST_BLOCKS}"));
    }
    // the curve needs climbs; where they are too few it stays
    let explained = |(place, numbers): &(usize, Numbers)| -> [f64; 4] {
        std::array::from_fn(|e| blocks.total[*place].explained(e, numbers.linear, numbers.slopes[e]))
    };
    let tells_curve = explained(&blocks.numbers(None, None))[LIFT] >= LEAST_EXPLAINED;
    let given = (!tells_curve).then_some(before.linear_share.value);
    let found = blocks.numbers(None, given);
    let (explained, (place, numbers)) = (explained(&found), found);
    let without: Vec<_> = (0..blocks.count()).map(|block| blocks.numbers(Some(block), given).1).collect();
    let at_end = place % LAGS == LAGS - 1 || place / LAGS == DELAYS - 1;
    let flights = format!("{} flight{}", records.len(), if records.len() == 1 { "" } else { "s" });
    let mut found = with_pitch_inertia(model, before);
    let (mut parameters, mut not_told) = (Vec::new(), Vec::new());
    for (name, equation, number) in NUMBERS {
        let value = number(&numbers, model, before);
        let of_blocks: Vec<f64> = without.iter().map(|numbers| number(numbers, model, before)).collect();
        let (error, path) = (jackknife(&of_blocks), format!("vertical.motors.{name}"));
        // a share of zero has no relative error
        let size = if unit_of(&found, &path) == "1" && value < 1.0 { 1.0 } else { value };
        let is_searched = equation != &LIFT;
        let told = !(is_searched && at_end)
            && explained[*equation] >= LEAST_EXPLAINED
            && value >= 0.0
            && error < MOST_ERROR * size;
        if !told {
            not_told.push(*name);
            continue;
        }
        let how = format!("standard error {error:.3e}, leaving out blocks of {BLOCK_S} s");
        let source = format!("identified from {flights}: {how}");
        found = with_source(&found.with_parameter(&path, value)?, &path, &source);
        let unit = unit_of(&found, &path);
        let at_bound = equation == &LIFT && !(1e-6..1.0 - 1e-6).contains(&numbers.linear);
        parameters.push(ParameterEstimate { name: path, unit, value, standard_error: error, at_bound });
    }
    if parameters.is_empty() {
        let shares = explained.map(|share| format!("{:.0} %", 100.0 * share)).join(", ");
        return Error::logs(format!(
            "the motors in these logs do not determine the motor-level form: of roll, pitch, yaw and lift it explains {shares}; record motors, gyro and accelerometer at 250 Hz or more"
        ));
    }
    let delay_s = lag_and_delay_s(place)[1];
    let blocks = blocks.count();
    Ok(MotorEstimate { model: found, parameters, not_told, explained, delay_s, blocks, place, numbers })
}

/// The model with an inertia of pitch of its own.
fn with_pitch_inertia(model: &Model, form: &Motors) -> Model {
    let pitch_inertia = form.pitch_inertia.clone().or_else(|| Some(form.tilt_inertia.clone()));
    let mut model = model.clone();
    model.vertical.motors = Some(Vertical::Motors(Box::new(Motors { pitch_inertia, ..form.clone() })));
    model
}

type Number = fn(&Numbers, &Model, &Motors) -> f64;

/// Numbers of the form, the equation that tells each, and its value.
const NUMBERS: &[(&str, usize, Number)] = &[
    ("linear_share", LIFT, |n, _, _| n.linear),
    ("hover", LIFT, |n, model, before| {
        let mut form = before.clone();
        form.linear_share.value = n.linear;
        form.pwm_of(0.25 * model.lateral.gravity.value / n.most_mps2)
    }),
    ("lag", 0, |n, _, _| n.lag_s),
    ("tilt_inertia", 0, |n, model, _| inertia_kgm2(n, model, 0)),
    ("pitch_inertia", 1, |n, model, _| inertia_kgm2(n, model, 1)),
    ("torque_per_thrust", 2, |n, model, before| {
        n.slopes[2] * before.yaw_inertia.value / (model.vehicle.mass.value * n.most_mps2)
    }),
];

fn inertia_kgm2(n: &Numbers, model: &Model, axis: usize) -> f64 {
    let side_m = SIDE_PER_ARM * model.vehicle.arm.value;
    model.vehicle.mass.value * n.most_mps2 * side_m / n.slopes[axis]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::motors::{Attitude, Motion, RigidBody};
    use crazyflie_env::plant::Accelerations;

    const STEP_S: f64 = 0.002;

    /// A vehicle held level by a rate loop that stirs, recorded at 500 Hz.
    fn record(model: &Model, seconds: f64, stir: f64) -> MotorRecord {
        let Some(Vertical::Motors(form)) = &model.vertical.motors else { panic!("no motors") };
        let [mass_kg, arm_m] = [model.vehicle.mass.value, model.vehicle.arm.value];
        let [roll, pitch, yaw] = form.inertias_kgm2();
        let most_mps2 = 0.25 * 9.81 / form.curve(form.hover.value);
        let turn = |inertia: f64| mass_kg * SIDE_PER_ARM * arm_m / inertia;
        let body = RigidBody {
            step_s: STEP_S,
            gravity_mps2: 9.81,
            drag_ps: 0.0,
            heave_ps: 0.0,
            follow: [1.0 - (-STEP_S / form.lag.value).exp(); 2],
            linear_share: form.linear_share.value,
            most_mps2,
            turn_per_thrust: [turn(roll), turn(pitch), mass_kg * form.torque_per_thrust.value / yaw],
            gyroscopic: [(pitch - yaw) / roll, (yaw - roll) / pitch, (roll - pitch) / yaw],
        };
        let mut motion = Motion {
            pos_m: [0.0; 3],
            vel_mps: [0.0; 3],
            attitude: Attitude::new([0.0; 3]),
            rate_radps: [0.0; 3],
        };
        let mut pwm = [form.hover.value; 4];
        let mut record = MotorRecord {
            step_s: STEP_S,
            share: Default::default(),
            rate_radps: Default::default(),
            lift_mps2: Vec::new(),
        };
        for step in 0..(seconds / STEP_S) as usize {
            let t_s = step as f64 * STEP_S;
            let tilt = motion.attitude.angles_rad();
            let wanted = [
                0.2 * stir * (5.0 * t_s).sin(),
                0.2 * stir * (7.0 * t_s).cos(),
                0.2 * stir * (3.0 * t_s).sin(),
            ];
            let moment: [f64; 3] = std::array::from_fn(|i| {
                6e3 * (4.0 * (wanted[i] - tilt[i]) - motion.rate_radps[i]) * if i == 2 { 0.3 } else { 1.0 }
            });
            let lift = form.hover.value * (1.0 + 0.15 * stir * (4.0 * t_s).sin());
            let commanded: [f64; 4] = std::array::from_fn(|motor| {
                (lift + (0..3).map(|i| signs()[i][motor] * moment[i]).sum::<f64>()).clamp(0.0, FULL_PWM)
            });
            for motor in 0..4 {
                record.share[motor].push(commanded[motor] / FULL_PWM);
            }
            for axis in 0..3 {
                record.rate_radps[axis].push(motion.rate_radps[axis]);
            }
            record.lift_mps2.push(body.thrust_mps2(&pwm));
            body.step(&mut motion, &mut pwm, commanded, &Accelerations::none());
        }
        record
    }

    #[test]
    fn numbers_of_a_made_flight_are_found() {
        let truth = Model::parse("cf21-brushless")
            .unwrap()
            .with_parameter("vertical.motors.linear_share", 0.4)
            .unwrap();
        let truth = truth.with_parameter("vertical.motors.lag_falling", 0.0571).unwrap();
        let start = Model::parse("cf21").unwrap();
        let start = ["vehicle.mass", "vehicle.arm", "vertical.motors.yaw_inertia"]
            .into_iter()
            .fold(start, |start, path| start.with_parameter(path, truth.parameter(path).unwrap()).unwrap());
        let found = identify_motors(&start, &[record(&truth, 24.0, 1.0)]).unwrap();
        for (name, most) in [
            ("hover", 0.01),
            ("lag", 0.05),
            ("tilt_inertia", 0.05),
            ("pitch_inertia", 0.05),
            ("torque_per_thrust", 0.1),
            ("linear_share", 0.2),
        ] {
            let path = format!("vertical.motors.{name}");
            let [value, expected] = [&found.model, &truth].map(|model| model.parameter(&path).unwrap());
            assert!(
                (value / expected - 1.0).abs() < most,
                "{name}: {value} for {expected}, explained {:?}",
                found.explained
            );
        }
        assert!(found.explained_in(&[record(&truth, 10.0, 0.7)])[..2].iter().all(|share| *share > 0.9));
    }

    #[test]
    fn a_flight_that_stands_still_tells_nothing() {
        let model = Model::parse("cf21").unwrap();
        let error = identify_motors(&model, &[record(&model, 24.0, 0.0)]).unwrap_err();
        assert!(error.to_string().contains("do not determine the motor-level form"), "{error}");
        let short = identify_motors(&model, &[record(&model, 5.0, 1.0)]).unwrap_err();
        assert!(short.to_string().contains("the logs hold 2 blocks"), "{short}");
    }
}
