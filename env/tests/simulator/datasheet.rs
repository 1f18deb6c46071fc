//! Models from data sheets.

use crate::flight::Flight;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::datasheet::DATASHEET_FIELDS;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::vector::{STATE, VectorEnv};

const SHEET: &str = include_str!("../../../examples/crazyflie_datasheet.toml");

fn model_with(from: &str, to: &str) -> Result<Model, String> {
    assert!(SHEET.contains(from), "{from}");
    Model::from_datasheet(&SHEET.replacen(from, to, 1)).map_err(|error| error.to_string())
}

/// Returns the state after so long with one constant action, from rest 70 cm over the marker.
fn flown(model: &Model, level: &str, set_point: [f64; ACTION], seconds: f64) -> [f32; STATE] {
    let options = format!(
        r#"{{"action": {level:?}, "autoreset": "disabled", "task_options": {{"start_radius_m": 0}}}}"#
    );
    let env = VectorEnv::new(std::slice::from_ref(model), &Options::parse(&options).unwrap(), 1).unwrap();
    let mut flight = Flight::begin(env);
    let action = flight.env.interfaces()[0].action_of(&set_point).map(|number| number as f32);
    for _ in 0..(seconds / flight.env.tick_s()).round() as usize {
        flight.step_with(&action).unwrap();
    }
    let mut x = [0.0; STATE];
    flight.env.states(&mut x).unwrap();
    x
}

#[test]
fn the_hover_follows_from_mass_and_thrust_curve() {
    let model = Model::from_datasheet(SHEET).unwrap();
    assert_eq!(model.input(None).unwrap(), VerticalInput::Motors);
    let share = model.parameter("vertical.motors.hover").unwrap() / 65535.0;
    let thrust_n = 4.0 * 0.1592 * share * (0.4252 + 0.5748 * share);
    assert!((thrust_n - 0.028 * 9.81).abs() < 1e-9, "{thrust_n}");
    let hover = model.parameter("vertical.motors.hover").unwrap();
    let x = flown(&model, "motors", [hover; ACTION], 1.0);
    assert!((x[2] - 0.7).abs() < 1e-3 && x[5].abs() < 1e-3, "{x:?}");
    // written and read again it is the same
    assert_eq!(Model::parse(&model.to_toml().unwrap()).unwrap(), model);
}

#[test]
fn another_mass_arm_or_inertia_flies_otherwise() {
    let own = Model::from_datasheet(SHEET).unwrap();
    let light = model_with("mass_kg = 0.028", "mass_kg = 0.0368").unwrap();
    let heavy = model_with("mass_kg = 0.028", "mass_kg = 0.05").unwrap();
    let hover = |model: &Model| model.parameter("vertical.motors.hover").unwrap();
    assert!(hover(&own) < hover(&light) && hover(&light) < hover(&heavy) && hover(&heavy) < 60_000.0);
    let climb = |model: &Model| f64::from(flown(model, "motors", [65_535.0; ACTION], 0.3)[5]);
    assert!(
        climb(&light) > 1.5 * climb(&heavy) && climb(&heavy) > 0.1,
        "{} {}",
        climb(&light),
        climb(&heavy)
    );
    // the light one's hover does not carry the heavy one
    assert!(flown(&heavy, "motors", [hover(&light); ACTION], 0.3)[5] < -0.3);
    let turn = |model: &Model| {
        let pwm = [-2e3, -2e3, 2e3, 2e3].map(|more| hover(model) + more);
        f64::from(flown(model, "motors", pwm, 0.1)[STATE - 3])
    };
    let long = model_with("arm_m = 0.046", "arm_m = 0.092").unwrap();
    let slow = model_with("tilt_inertia_kgm2 = 1.657e-5", "tilt_inertia_kgm2 = 3.314e-5").unwrap();
    assert!((turn(&long) / turn(&own) - 2.0).abs() < 0.05 && (turn(&slow) / turn(&own) - 0.5).abs() < 0.02);
    assert!(
        own.roll.damping.value < long.roll.damping.value && slow.roll.damping.value < own.roll.damping.value
    );
}

#[test]
fn a_motor_that_slows_down_has_a_lag_of_its_own() {
    let linear = SHEET.replacen("thrust_linear_share = 0.4252", "thrust_linear_share = 1.0", 1);
    let sheet = linear.replacen("lag_s = 0.0647", "lag_s = 0.05\nlag_falling_s = 0.1", 1);
    let model = Model::from_datasheet(&sheet.replacen("mass_kg", "heave_ps = 0.0\nmass_kg", 1)).unwrap();
    let hover = model.parameter("vertical.motors.hover").unwrap();
    // thrust in proportion to a PWM that goes to its new value with the lag
    let gained = |more: f64, lag_s: f64| 9.81 * more / hover * (0.2 - lag_s * (1.0 - (-0.2 / lag_s).exp()));
    for (more, lag_s) in [(3000.0, 0.05), (-3000.0, 0.1)] {
        let speed = f64::from(flown(&model, "motors", [hover + more; ACTION], 0.2)[5]);
        let expected = gained(more, lag_s);
        assert!((speed / expected - 1.0).abs() < 0.02, "{more}: {speed} m/s, expected {expected}");
    }
}

#[test]
fn pitch_has_an_inertia_of_its_own() {
    let sheet = SHEET.replacen("yaw_inertia", "pitch_inertia_kgm2 = 3.314e-5\nyaw_inertia", 1);
    let model = Model::from_datasheet(&sheet).unwrap();
    let hover = model.parameter("vertical.motors.hover").unwrap();
    let rate = |signs: [f64; ACTION], axis: usize| {
        let pwm = signs.map(|sign| hover + 2e3 * sign);
        f64::from(flown(&model, "motors", pwm, 0.1)[STATE - 3 + axis])
    };
    let [roll, pitch] = [rate([-1.0, -1.0, 1.0, 1.0], 0), rate([-1.0, 1.0, 1.0, -1.0], 1)];
    assert!((roll / pitch - 2.0).abs() < 0.02, "{roll} and {pitch} rad/s");
}

#[test]
fn every_value_that_is_missing_or_wrong_is_named() {
    for field in DATASHEET_FIELDS.iter().filter(|field| field.default.is_none()) {
        let key = field.name.rsplit('.').next().unwrap();
        let lines = SHEET.lines().filter(|line| !line.starts_with(&format!("{key} =")));
        let error = Model::from_datasheet(&lines.collect::<Vec<_>>().join("\n")).unwrap_err().to_string();
        assert!(error.contains(&format!("there is no {} (", field.name)), "{}: {error}", field.name);
    }
    for (from, to, words) in [
        ("attitude_loop = \"crazyflie-firmware\"", "", "there is no attitude_loop"),
        (
            "\"crazyflie-firmware\"",
            "\"betaflight\"",
            "unknown attitude loop \"betaflight\"; known: crazyflie-firmware, crazyflie-firmware-brushless",
        ),
        ("name = \"my-crazyflie\"", "", "there is no name"),
        ("lag_s = 0.0647", "lags = 0.0647", "did you mean \"motor.lag_s\""),
        ("lag_s = 0.0647", "lag_s = 64.7", "motor.lag_s is 64.7, expected 0.001 to 1"),
        ("lag_s = 0.0647", "lag_s = \"fast\"", "motor.lag_s is \"fast\", expected a number"),
        ("mass_kg = 0.028", "mass_kg = 0.08", "carry 0.0"),
        ("yaw_inertia_kgm2 = 2.926e-5", "yaw_inertia_kgm2 = 2.926e-4", "no body has more than the sum"),
        ("mass_kg = 0.028", "mass_kg = ", "line 6"),
    ] {
        let error = model_with(from, to).unwrap_err();
        assert!(error.contains(words), "{words}: {error}");
    }
}

#[test]
fn a_changed_battery_acts_with_its_effect_or_is_refused() {
    let text = Model::from_datasheet(SHEET).unwrap().to_toml().unwrap();
    let (before, after) = text.split_once("[vehicle.battery_capacity]").unwrap();
    let smaller =
        format!("{before}[vehicle.battery_capacity]{}", after.replacen("value = 864.0", "value = 400.0", 1));
    let model = Model::parse(&smaller).unwrap();
    assert_eq!(model.vehicle.battery_capacity.value, 400.0);
    let fly = |effects: &str| {
        let options = Options::parse(&format!(r#"{{"effects": {effects}}}"#)).unwrap();
        VectorEnv::new(std::slice::from_ref(&model), &options, 1)
            .map(|_| ())
            .map_err(|error| error.to_string())
    };
    let error = fly("{}").unwrap_err();
    for words in ["vehicle.battery_capacity is 400 C", "864 C", "battery_sag"] {
        assert!(error.contains(words), "{error}");
    }
    fly(r#"{"battery_sag": {"exponent": 1}}"#).unwrap();
}

#[test]
fn the_page_says_every_value() {
    let page = include_str!("../../../docs/motors.md");
    for field in DATASHEET_FIELDS {
        let [low, high] = field.range;
        let default = field.default.map_or("required".into(), |value| value.to_string());
        let line = format!("| `{}` | {low} | {high} | {default} | {} |", field.name, field.about);
        assert!(page.contains(&line), "docs/motors.md should say: {line}");
    }
}
