//! Vehicles that are commanded by body rates or by moments: their logs are identified without a start.

use std::fmt::Write;

use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, TiltInput, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use crazyflie_identify::FlightLog;
use crazyflie_identify::replay::{ReplayOptions, replay};
use crazyflie_identify::vehicle::{FitOptions, identify};
use crazyflie_logs::Mapping;

const TICK_S: f64 = 0.02;
const TICKS: usize = 2500;

/// Noise without a generator, -1 to 1.
fn noise(i: usize) -> f64 {
    2.0 * ((i as f64 * 0.754_877_666).fract() - 0.5)
}

/// Returns a log of a flight about a point, kept there by this command of an angle's error and the rate.
fn flight(model: &Model, command: impl Fn(f64, f64) -> f64, channel: &str) -> FlightLog {
    let settings = Settings { input: VerticalInput::Height, physics_hz: None };
    let mut world = World::<f64>::new(model, &EffectTable::new(), settings, 1).unwrap().without_floor();
    let lift = |t: f64| 0.8 + 0.1 * (0.9 * t).sin();
    let mut start = State::<f64>::rest();
    start.pos_m[2] = 0.8;
    let level = Command { roll_rad: 0.0, pitch_rad: 0.0, yaw_rate_radps: 0.0, lift: lift(0.0) };
    world.start(0, true, &start, &level);
    let mut text = String::from("t,x,y,z,roll,pitch,yaw,p,q,r,h\n");
    for tick in 0..TICKS {
        let (t, s) = (tick as f64 * TICK_S, *world.state(0));
        let wave = |phase: f64| 0.08 * (1.7 * t + phase).sin() + 0.06 * (4.1 * t + 2.0 * phase).sin();
        let wanted = [
            wave(0.0) + 0.1 * s.pos_m[1] + 0.1 * s.vel_mps[1],
            wave(1.3) - 0.1 * s.pos_m[0] - 0.1 * s.vel_mps[0],
        ];
        let [p, q] = [0, 1].map(|axis| command(wanted[axis] - s.att_rad[axis], s.rate_radps[axis]));
        let seen = |value: f64, sigma: f64, which: usize| value + sigma * noise(7 * tick + which);
        let [x, y, z] = [0, 1, 2].map(|axis| seen(s.pos_m[axis], 1e-3, axis));
        let [roll, pitch, yaw] = [0, 1, 2].map(|axis| seen(s.att_rad[axis], 5e-4, 3 + axis));
        writeln!(text, "{t},{x},{y},{z},{roll},{pitch},{yaw},{p},{q},0,{}", lift(t)).unwrap();
        let command = Command { roll_rad: p, pitch_rad: q, yaw_rate_radps: 0.0, lift: lift(t) };
        world.step(0, &command);
    }
    let same =
        ["x", "y", "z", "roll", "pitch", "yaw"].map(|name| format!("{name} = {{ column = \"{name}\" }}\n"));
    let mapping = format!(
        "[time]\ncolumn = \"t\"\n[channels]\n{}{channel}_x = {{ column = \"p\" }}\n{channel}_y = {{ column = \"q\" }}\n\
         {channel}_z = {{ column = \"r\" }}\ncmd_height = {{ column = \"h\" }}\n",
        same.concat()
    );
    let mapping = Mapping::parse("m.toml", &mapping).unwrap();
    FlightLog::from_mapped_bytes("flight.csv", text.as_bytes(), mapping).unwrap()
}

#[test]
fn body_rates_and_moments_drive_a_model_that_is_found_without_a_start() {
    for (input, numbers, kp, kd, channel) in [
        (TiltInput::Rate, [("gain", 30.0), ("damping", 28.0)], 6.0, 0.0, "cmd_rate"),
        // a vehicle of 20e-6 kg m^2
        (TiltInput::Torque, [("gain", 5e4), ("damping", 2.0)], 100.0 / 5e4, 12.0 / 5e4, "cmd_torque"),
    ] {
        let mut truth = Model::thesis().with_tilt_input(input).with_parameter("lateral.drag", 0.3).unwrap();
        for (axis, (name, value)) in ["roll", "pitch"].iter().flat_map(|axis| numbers.map(|n| (axis, n))) {
            truth = truth.with_parameter(&format!("{axis}.{name}"), value).unwrap();
        }
        let log = flight(&truth, |error, rate| kp * error - kd * rate, channel);
        let logs = [("flight".to_owned(), log)];
        let fitted = identify(&Model::thesis(), &logs, &FitOptions::default(), &|| ()).unwrap();
        assert_eq!(fitted.model.command.tilt, input);
        for (axis, (name, value)) in ["roll", "pitch"].iter().flat_map(|axis| numbers.map(|n| (axis, n))) {
            let path = format!("{axis}.{name}");
            let estimate = fitted.model.parameter(&path).unwrap();
            let allowed = if name == "damping" { 0.15 * value + 1.0 } else { 0.1 * value };
            assert!((estimate - value).abs() < allowed, "{input:?} {path}: {estimate} for {value}");
            assert_eq!(fitted.model.parameter(&format!("{axis}.stiffness")).unwrap(), 0.0);
        }
        let drag = fitted.model.parameter("lateral.drag").unwrap();
        assert!((drag - 0.3).abs() < 0.06, "{input:?}: drag {drag}");
        let flown = replay(
            &fitted.model,
            &logs[0].1,
            &ReplayOptions { horizon_s: Some(0.5), ..ReplayOptions::default() },
        );
        assert!(flown.is_ok());
        // a model of angles cannot be driven by it
        let refused =
            replay(&Model::thesis(), &logs[0].1, &ReplayOptions::default()).unwrap_err().to_string();
        assert!(refused.contains("roll and pitch commands as angles, but body rates"), "{refused}");
        // the gain is measured against the old model
        assert!(fitted.compare_with(&Model::thesis(), &logs).is_ok());
        // the fitted model survives writing and reading
        let again = Model::parse(&fitted.model.to_toml().unwrap()).unwrap();
        assert_eq!(again.command.tilt, input);
    }
}
