//! The stepped model against closed formulas: each transfer function of the thesis, and the 12-state form.

use crazyflie_env::config::EffectTable;
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::world::{Settings, World};

/// Fly `seconds` with a held command from `x`; the state at every tick.
fn fly<R: SimScalar>(
    input: VerticalInput,
    x: &State<f64>,
    u: &Command<f64>,
    seconds: f64,
) -> Vec<State<f64>> {
    let settings = Settings { input, physics_hz: None };
    let mut world =
        World::<R>::new(&Model::thesis(), &EffectTable::new(), settings, 1).unwrap().without_floor();
    let of = |v: f64| R::from_f64(v);
    let u = Command {
        roll_rad: of(u.roll_rad),
        pitch_rad: of(u.pitch_rad),
        yaw_rate_radps: of(u.yaw_rate_radps),
        lift: of(u.lift),
    };
    let start = State {
        pos_m: x.pos_m.map(of),
        vel_mps: x.vel_mps.map(of),
        att_rad: x.att_rad.map(of),
        rate_radps: x.rate_radps.map(of),
        aux: x.aux.map(of),
    };
    world.start(0, !R::nothing(), &start, &u);
    let back = |v: R| v.lane(0);
    (0..(seconds / world.tick_s()).round() as usize)
        .map(|_| {
            world.step(0, &u);
            let x = world.state(0);
            State {
                pos_m: x.pos_m.map(back),
                vel_mps: x.vel_mps.map(back),
                att_rad: x.att_rad.map(back),
                rate_radps: x.rate_radps.map(back),
                aux: x.aux.map(back),
            }
        })
        .collect()
}

/// Compare one quantity at every tick with its formula: 1e-9 in f64, 1e-4 in f32.
fn check(
    name: &str,
    input: VerticalInput,
    x: &State<f64>,
    u: &Command<f64>,
    of: impl Fn(&State<f64>) -> f64,
    truth: impl Fn(f64) -> f64,
) {
    let worst = |flight: Vec<State<f64>>| {
        flight
            .iter()
            .enumerate()
            .map(|(i, x)| (of(x) - truth(0.02 * (i + 1) as f64)).abs())
            .fold(0.0, f64::max)
    };
    let (double, single) = (worst(fly::<f64>(input, x, u, 4.0)), worst(fly::<Lanes>(input, x, u, 4.0)));
    println!("{name}: {double:.1e} in f64, {single:.1e} in f32");
    assert!(double < 1e-9, "{name} in f64: {double:e}");
    assert!(single < 1e-4, "{name} in f32: {single:e}");
}

/// Step response of 123.2 / (s^2 + 31.86 s + 81.85) and its first two integrals, for a step of one.
fn tilt_step(t: f64) -> [f64; 3] {
    let (n, d1, d0) = (123.2, 31.86, 81.85_f64);
    let root = (d1 * d1 / 4.0 - d0).sqrt();
    let (p, q) = (-d1 / 2.0 + root, -d1 / 2.0 - root);
    // n / (s (s - p) (s - q)) = k / s + a / (s - p) + b / (s - q)
    let (k, a, b) = (n / (p * q), n / (p * (p - q)), n / (q * (q - p)));
    let (ep, eq) = ((p * t).exp(), (q * t).exp());
    let once = k * t + a * (ep - 1.0) / p + b * (eq - 1.0) / q;
    let twice = k * t * t / 2.0 + a * ((ep - 1.0) / p - t) / p + b * ((eq - 1.0) / q - t) / q;
    [k + a * ep + b * eq, once, twice]
}

fn at_70_cm() -> State<f64> {
    State { pos_m: [0.0, 0.0, 0.7], ..State::rest() }
}

const STEP_RAD: f64 = 7.5 * std::f64::consts::PI / 180.0;

#[test]
fn pitch_and_what_it_moves_follow_5_1_and_5_5() {
    let (x, u) = (at_70_cm(), Command { pitch_rad: STEP_RAD, ..Command::level(0.7) });
    let h = VerticalInput::Height;
    check("pitch", h, &x, &u, |x| x.att_rad[1], |t| STEP_RAD * tilt_step(t)[0]);
    check("vx", h, &x, &u, |x| x.vel_mps[0], |t| 9.81 * STEP_RAD * tilt_step(t)[1]);
    check("x", h, &x, &u, |x| x.pos_m[0] / 10.0, |t| 0.981 * STEP_RAD * tilt_step(t)[2]);
}

#[test]
fn roll_and_what_it_moves_follow_5_1_and_5_5_to_the_other_side() {
    let (x, u) = (at_70_cm(), Command { roll_rad: STEP_RAD, ..Command::level(0.7) });
    let h = VerticalInput::Height;
    check("roll", h, &x, &u, |x| x.att_rad[0], |t| STEP_RAD * tilt_step(t)[0]);
    check("vy", h, &x, &u, |x| x.vel_mps[1], |t| -9.81 * STEP_RAD * tilt_step(t)[1]);
}

#[test]
fn yaw_follows_5_2() {
    let rate = 36.0_f64.to_radians();
    let u = Command { yaw_rate_radps: rate, ..Command::level(0.7) };
    check("yaw", VerticalInput::Height, &at_70_cm(), &u, |x| x.att_rad[2], |t| -rate * t);
}

#[test]
fn height_follows_5_3() {
    let end = 1.615 * 0.8 / 1.592;
    check(
        "height",
        VerticalInput::Height,
        &at_70_cm(),
        &Command::level(0.8),
        |x| x.pos_m[2],
        |t| end + (0.7 - end) * (-1.592 * t).exp(),
    );
}

#[test]
fn height_from_pwm_follows_5_4() {
    let end = 9.87e-5 * 5000.0 / 0.6123;
    check(
        "height by PWM",
        VerticalInput::Pwm,
        &at_70_cm(),
        &Command::level(40_000.0),
        |x| x.pos_m[2],
        |t| end + (0.7 - end) * (-0.6123 * t).exp(),
    );
}

#[test]
fn height_from_thrust_follows_its_equation() {
    let (a, heave) = (9.81 * (40_000.0 / 39_342.5 - 1.0), 1.2_f64);
    let truth = |t: f64| 0.7 + a / heave * (t - (1.0 - (-heave * t).exp()) / heave);
    check(
        "height by thrust",
        VerticalInput::Thrust,
        &at_70_cm(),
        &Command::level(40_000.0),
        |x| x.pos_m[2],
        truth,
    );
}

#[test]
fn the_twelve_state_form_4_15_is_the_same_model() {
    for input in Model::thesis().inputs() {
        let space = Model::thesis().state_space(input).unwrap();
        let offset = if input == VerticalInput::Pwm {
            35_000.0
        } else if input == VerticalInput::Thrust {
            39_342.5
        } else {
            0.0
        };
        let lift = if input.is_pwm() { 40_000.0 } else { 0.8 };
        let u = Command { roll_rad: 0.05, pitch_rad: -0.08, yaw_rate_radps: 0.0, lift };
        let flight = fly::<f64>(input, &at_70_cm(), &u, 2.0);
        let mut x = nalgebra::SVector::<f64, 12>::zeros();
        x[2] = 0.7;
        let held = nalgebra::SVector::<f64, 4>::new(u.roll_rad, u.pitch_rad, u.yaw_rate_radps, lift - offset);
        let end = space.advance(&x, &held, 2.0);
        let last = flight.last().unwrap();
        for i in 0..3 {
            for (name, ours, theirs) in [
                ("position", last.pos_m[i], end[i]),
                ("angle", last.att_rad[i], end[3 + i]),
                ("rate", last.rate_radps[i], end[9 + i]),
            ] {
                assert!((ours - theirs).abs() < 1e-9, "{input:?} {name} {i}: {ours} against {theirs}");
            }
        }
        let velocity = space.c.fixed_rows::<3>(4) * end;
        for i in 0..2 {
            assert!((last.vel_mps[i] - velocity[i]).abs() < 1e-9);
        }
    }
}

#[test]
fn a_turned_vehicle_flies_where_it_points() {
    let mut x = at_70_cm();
    x.att_rad[2] = std::f64::consts::FRAC_PI_2;
    let flight =
        fly::<f64>(VerticalInput::Height, &x, &Command { pitch_rad: 0.05, ..Command::level(0.7) }, 1.0);
    let last = flight.last().unwrap();
    assert!(last.pos_m[1] > 0.1 && last.pos_m[0].abs() < 1e-9, "{:?}", last.pos_m);
}

#[test]
fn broken_models_are_refused_with_their_place() {
    let good = crazyflie_env::model::THESIS_TOML;
    let cases = [
        (good.replace("schema = 1", "schema = 2"), "schema is 2"),
        (
            good.replace("value = 31.86, unit = \"1/s\"", "value = -31.86, unit = \"1/s\""),
            "roll.damping is -31.86",
        ),
        (good.replace("value = 31.86, unit = \"1/s\"", "value = nan, unit = \"1/s\""), "roll.damping is NaN"),
        (good.replace("unit = \"1/s^2\"", "unit = \"1/s\""), "roll.gain has the unit \"1/s\""),
        (
            good.replace("damping =", "dampening ="),
            "pitch.dampening: unknown field `dampening`, expected one of",
        ),
        (good.replace("form = \"integrator\"", "form = \"integrat0r\""), "integrat0r"),
        (good.split_once(", unit").unwrap().0.to_owned(), "unclosed inline table"),
        (
            good.replace("value = 100.0, unit = \"Hz\"", "value = 75.0, unit = \"Hz\""),
            "multiple of rig.control",
        ),
        ("{\"schema\": 1,".to_owned(), "line 1"),
        (format!("{good}\n[effects.drag_lineer]\nrate_ps = 0.3\n"), "did you mean \"drag_linear\""),
    ];
    for (text, words) in cases {
        let error = Model::parse(&text).unwrap_err().to_string();
        assert!(error.contains(words), "expected {words:?} in: {error}");
    }
}

#[test]
fn a_model_survives_toml_and_json() {
    let model = Model::thesis();
    assert_eq!(Model::parse(&model.to_toml().unwrap()).unwrap(), model);
    assert_eq!(Model::parse(&serde_json::to_string(&model).unwrap()).unwrap(), model);
}
