//! The motor-level form: rigid body, four motors, mixer and the firmware's loops.

use std::sync::LazyLock;

use crate::actions::{alone, hold, wander};
use crate::flight::Flight;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::effects::Scope;
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::transfer_function::Channel;
use crazyflie_env::vector::{STATE, VectorEnv, state_index};
use crazyflie_env::world::{Settings, World};

/// Numbers of the built-in model's form.
fn value(name: &str) -> f64 {
    static MODEL: LazyLock<Model> = LazyLock::new(Model::thesis);
    MODEL.parameter(&format!("vertical.motors.{name}")).unwrap()
}

/// Thrust of one motor at a PWM, per mass of the vehicle: Foerster's curve, scaled to carry the weight at the hover.
fn motor_mps2(pwm: f64) -> f64 {
    let curve = |pwm: f64| {
        let (share, linear) = (pwm / 65535.0, value("linear_share"));
        share * (linear + (1.0 - linear) * share)
    };
    9.81 / 4.0 * curve(pwm) / curve(value("hover"))
}

/// PWM of a motor some time after its command jumped away from the hover.
fn lagging(asked: f64, t_s: f64) -> f64 {
    asked + (value("hover") - asked) * (-t_s / value("lag")).exp()
}

/// The integral from 0 to `end_s`, by the midpoint rule.
fn integral(end_s: f64, f: impl Fn(f64) -> f64) -> f64 {
    let steps = 500;
    let h = end_s / f64::from(steps);
    (0..steps).map(|i| h * f(h * (f64::from(i) + 0.5))).sum()
}

/// Attitude command from rest at 70 cm, held; the state after each tick.
fn fly<R: SimScalar>(u: [f64; 3], seconds: f64) -> Vec<[[f64; 3]; 3]> {
    let settings = Settings { input: VerticalInput::Motors, physics_hz: None };
    let mut world =
        World::<R>::new(&Model::thesis(), &EffectTable::new(), settings, 1).unwrap().without_floor();
    let [roll_rad, pitch_rad, yaw_rate_radps] = u.map(R::from_f64);
    let u = Command { roll_rad, pitch_rad, yaw_rate_radps, ..Command::level(R::from_f64(value("hover"))) };
    let zero = R::zero();
    let start = State { pos_m: [zero, zero, R::from_f64(0.7)], ..State::rest() };
    world.start(0, !R::nothing(), &start, &u);
    (0..(seconds / world.tick_s()).round() as usize)
        .map(|_| {
            world.step(0, &u);
            let x = world.state(0);
            [x.pos_m, x.vel_mps, x.att_rad].map(|row| row.map(|number| number.lane(0)))
        })
        .collect()
}

#[test]
fn lanes_agree_with_double_precision() {
    let u = [0.15, -0.1, 1.0];
    let (double, single) = (fly::<f64>(u, 3.0), fly::<Lanes>(u, 3.0));
    let off = double.iter().flatten().flatten().zip(single.iter().flatten().flatten());
    let worst = off.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    println!("{worst:.1e} after 3 s");
    assert!(worst < 2e-3, "{worst:e}");
}

#[test]
fn the_geometry_is_exact_at_any_tilt() {
    // a tilt that is held carries g tan(tilt) sideways where the height is held; here the thrust is the weight
    let flown = fly::<f64>([0.0, 0.15, 0.0], 4.0);
    let [before, last] = [&flown[flown.len() - 2], &flown[flown.len() - 1]];
    let pitch = last[2][1];
    let gained = [0, 2].map(|axis| (last[1][axis] - before[1][axis]) / 0.02);
    assert!((gained[0] - 9.81 * pitch.sin()).abs() < 0.02, "{gained:?} at {pitch}");
    let sinking = 9.81 * (pitch.cos() - 1.0) - value("heave") * last[1][2];
    assert!((gained[1] - sinking).abs() < 0.01, "{gained:?} at {pitch}");
}

#[test]
fn the_form_for_small_angles_is_that_of_small_steps() {
    let model = Model::thesis();
    for (axis, channel) in [(0, Channel::Roll), (1, Channel::Pitch)] {
        let mut u = [0.0; 3];
        u[axis] = 0.01;
        let flown = fly::<f64>(u, 0.6);
        let linear = model.transfer_function(channel, VerticalInput::Motors).unwrap();
        let [gain, damping, stiffness] = [linear.numerator[0], linear.denominator[1], linear.denominator[2]];
        // the step of the second-order form, by its two real poles
        let root = (damping * damping / 4.0 - stiffness).sqrt();
        let (p, q) = (-damping / 2.0 + root, -damping / 2.0 - root);
        let step = |t: f64| {
            gain / (p * q) + gain / (p * (p - q)) * (p * t).exp() + gain / (q * (q - p)) * (q * t).exp()
        };
        for (i, x) in flown.iter().enumerate() {
            let off = x[2][axis] / 0.01 - step(0.02 * (i + 1) as f64);
            // without the motors' lag and the integrals
            assert!(off.abs() < 0.15, "{channel:?} {i}: {off}");
        }
    }
    let turned = fly::<f64>([0.0, 0.0, 0.5], 3.0);
    let late = 0.5 * 3.0 - model.yaw.sign() * turned[149][2][2];
    let bandwidth = model.yaw_form(VerticalInput::Motors).a[1][1];
    assert!((late + 0.5 / bandwidth).abs() < 0.08, "behind by {late} rad, bandwidth {bandwidth}");
}

#[test]
fn a_motor_that_would_pass_its_limit_takes_thrust_from_all() {
    let mut flight = alone("body_rates", "motors", "");
    let x = *hold(&mut flight, [6.0, 0.0, 0.0, 60_000.0], 0.02).last().unwrap();
    // the output of the rate loop is a number of 16 bits, half of it for each side; 76383 counts are too many
    let (left, right) = (65_535.0, 65_535.0 - 32_767.0);
    let model = Model::thesis();
    let side_m = model.vehicle.arm.value * std::f64::consts::FRAC_1_SQRT_2;
    let per_tilt = model.vehicle.mass.value * side_m / value("tilt_inertia");
    let difference = |t: f64| motor_mps2(lagging(left, t)) - motor_mps2(lagging(right, t));
    let sum = |t: f64| motor_mps2(lagging(left, t)) + motor_mps2(lagging(right, t));
    let roll_rate = integral(0.02, |t| 2.0 * per_tilt * difference(t));
    let climb = integral(0.02, |t| 2.0 * sum(t) - 9.81);
    let [rate, speed] = [x[STATE - 3], x[state_index::VEL + 2]].map(f64::from);
    // steps of 2 ms: the first command acts a step earlier
    assert!((rate / roll_rate - 1.0).abs() < 0.12, "{rate} rad/s, expected {roll_rate}");
    assert!((speed / climb - 1.0).abs() < 0.15, "{speed} m/s, expected {climb}");
    // had the other side kept its thrust, the climb would be faster by far
    let unlimited = integral(0.02, |t| {
        2.0 * (motor_mps2(lagging(left, t)) + motor_mps2(lagging(60_000.0 - 16_383.5, t))) - 9.81
    });
    assert!(unlimited > 1.4 * speed, "{unlimited} against {speed}");
}

#[test]
fn a_step_of_all_motors_climbs_by_lag_and_curve() {
    let mut flight = alone("motors", "motors", "");
    let asked = value("hover") + 5000.0;
    let x = *hold(&mut flight, [asked; ACTION], 0.2).last().unwrap();
    // decay of the speed gained at t
    let kept = |t: f64| (-value("heave") * (0.2 - t)).exp();
    let expected = integral(0.2, |t| kept(t) * (4.0 * motor_mps2(lagging(asked, t)) - 9.81));
    let speed = f64::from(x[state_index::VEL + 2]);
    assert!((speed / expected - 1.0).abs() < 0.02, "{speed} m/s, expected {expected}");
}

#[test]
fn four_motors_turn_the_vehicle_the_way_they_stand() {
    let turned = |pwm: [f64; ACTION]| {
        let mut flight = alone("motors", "motors", "");
        let hover = flight.env.interfaces()[0].hover_lift;
        *hold(&mut flight, pwm.map(|more| hover + more), 0.1).last().unwrap()
    };
    let still = turned([0.0; ACTION]);
    assert!(
        still[STATE - 3..].iter().all(|rate| rate.abs() < 1e-3) && (still[2] - 0.7).abs() < 1e-3,
        "{still:?}"
    );
    // left: to the right; back: nose down; 2 and 4: counter-clockwise
    for (axis, pwm) in [(0, [-2e3, -2e3, 2e3, 2e3]), (1, [-2e3, 2e3, 2e3, -2e3]), (2, [-2e3, 2e3, -2e3, 2e3])]
    {
        let x = turned(pwm);
        for i in 0..3 {
            let rate = x[STATE - 3 + i];
            assert!(if i == axis { rate > 0.1 } else { rate.abs() < 0.02 }, "axis {axis}: {x:?}");
        }
    }
}

#[test]
fn full_thrust_climbs_as_the_curve_says_and_none_falls() {
    let mut flight = alone("motors", "motors", "");
    let ratio = 4.0 * motor_mps2(65535.0) / 9.81;
    let flown = hold(&mut flight, [65535.0; ACTION], 0.4);
    // the air through the propellers takes its share
    let undamped = |before: f32, after: f32| {
        f64::from(after - before) / 0.02 + 0.5 * value("heave") * f64::from(before + after)
    };
    let gained = undamped(flown[18][5], flown[19][5]);
    assert!((gained - 9.81 * (ratio - 1.0)).abs() < 0.2, "{gained} m/s^2, thrust over weight {ratio}");
    let flown = hold(&mut alone("motors", "motors", ""), [0.0; ACTION], 0.3);
    let lost = undamped(flown[13][5], flown[14][5]);
    assert!((-9.82..-9.5).contains(&lost), "{lost} m/s^2");
}

#[test]
fn a_vehicle_that_tumbles_loses_no_number() {
    let mut flight = alone("body_rates", "motors", "");
    let hover = flight.env.interfaces()[0].hover_lift;
    for rates in [[6.0, 0.0, 0.0], [0.0, 6.0, 0.0], [4.0, 5.0, 3.0]] {
        let mut flight = alone("body_rates", "motors", r#", "effects": {"gust": 0.5}"#);
        let action =
            flight.env.interfaces()[0].action_of(&[rates[0], rates[1], rates[2], hover]).map(|a| a as f32);
        for _ in 0..60 {
            if flight.terminated[0] {
                break;
            }
            flight.step_with(&action).unwrap();
            assert!(flight.observations.iter().all(|number| number.is_finite()), "{rates:?}");
        }
    }
    // asked for and given
    let x = *hold(&mut flight, [2.0, 0.0, 0.0, hover], 0.3).last().unwrap();
    assert!((x[STATE - 3] - 2.0).abs() < 0.3, "{x:?}");
}

#[test]
fn every_effect_fits_the_motor_form_or_is_refused() {
    for entry in crazyflie_env::effects::registry() {
        let param = entry.params[0];
        let toward = if param.high > param.off { param.high } else { param.low };
        let value = param.off + 0.2 * (toward - param.off);
        for level in ["attitude", "body_rates", "motors"] {
            let text = format!(
                r#"{{"action": {level:?}, "vertical": "motors", "effects": {{{:?}: {value}}}}}"#,
                entry.name
            );
            match VectorEnv::new(&[Model::thesis()], &Options::parse(&text).unwrap(), 2) {
                Err(error) => {
                    assert!(entry.scope != Scope::Any, "{}: {error}", entry.name);
                    assert!(error.to_string().contains(entry.name), "{error}");
                }
                Ok(_) => {
                    assert!(entry.scope != Scope::IdentifiedLoops, "{}", entry.name);
                    let text = &text[1..text.len() - 1];
                    let mut flight = Flight::new(2, text);
                    for _ in 0..20 {
                        wander(&mut flight);
                        assert!(
                            flight.observations.iter().all(|number| number.is_finite()),
                            "{}",
                            entry.name
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn levels_below_the_attitude_want_the_motor_form() {
    let error = |options: &str, model: &Model| {
        VectorEnv::new(std::slice::from_ref(model), &Options::parse(options).unwrap(), 1)
            .err()
            .unwrap()
            .to_string()
    };
    let told = error(r#"{"action": "motors", "vertical": "height"}"#, &Model::thesis());
    assert!(told.contains("\"motors\"") && told.contains("\"height\""), "{told}");
    let mut bare = Model::thesis();
    bare.vertical.motors = None;
    let told = error(r#"{"action": "body_rates"}"#, &bare);
    assert!(told.contains("vertical form of this model") && told.contains("motors"), "{told}");
}
