//! Flights at one height, under a thrust command that hardly changes.

use std::fmt::Write;

use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::vehicle::{FitOptions, identify, ubiquitous_effects};
use crazyflie_logs::Mapping;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

/// The command that carries the vehicle, as a share of full thrust.
const HOVER: f64 = 0.5;
const MAPPING: &str = "position = \"motion_capture\"\nattitude = \"motion_capture\"\n[time]\ncolumn = \"t\"\n\
    [channels]\nx = { column = \"x\" }\ny = { column = \"y\" }\nz = { column = \"z\" }\n\
    roll = { column = \"roll\" }\npitch = { column = \"pitch\" }\nyaw = { column = \"yaw\" }\n\
    cmd_roll = { column = \"u\" }\ncmd_pitch = { column = \"v\" }\n\
    cmd_thrust = { column = \"thrust\", unit = \"fraction\" }\n";

/// A figure eight of 20 s, whose height is held by a controller against pushes.
fn log(seed: u64) -> FlightLog {
    const STEP_S: f64 = 0.001;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    let (mut pos_m, mut vel_mps, mut tilt, mut rate) = ([0.0, 0.0, 1.0], [0.0; 3], [0.0; 2], [0.0; 2]);
    let (mut command, mut lift, mut sum) = ([0.0; 2], 1.0, 0.0);
    let mut text = String::from("t,x,y,z,roll,pitch,yaw,u,v,thrust\n");
    for step in 0..20_000 {
        let t = f64::from(step) * STEP_S;
        if step % 10 == 0 {
            let wanted = [(2.1 * t).sin() * 0.6 - pos_m[0], (4.2 * t).sin() * 0.4 - pos_m[1], 1.0 - pos_m[2]];
            let [ax, ay, az] = [0, 1, 2].map(|i| 4.0 * wanted[i] - 3.0 * vel_mps[i]);
            sum += 0.02 * wanted[2];
            command = [(-ay / 9.81_f64).clamp(-0.35, 0.35), (ax / 9.81).clamp(-0.35, 0.35)];
            lift = 1.0 + (az + sum) / 9.81;
            let [x, y, z] = pos_m.map(|m| m + 5e-4 * normal());
            let [a, b] = tilt.map(|rad| rad + 1e-3 * normal());
            let thrust = HOVER * lift;
            writeln!(text, "{t},{x},{y},{z},{a},{b},0.0,{},{},{thrust}", command[0], command[1]).unwrap();
        }
        for i in 0..2 {
            rate[i] += STEP_S * (120.0 * command[i] - 14.0 * rate[i] - 150.0 * tilt[i]);
            tilt[i] += STEP_S * rate[i];
        }
        let pull = [
            9.81 * tilt[1] - 0.4 * vel_mps[0],
            -9.81 * tilt[0] - 0.4 * vel_mps[1],
            9.81 * (lift * tilt[0].cos() * tilt[1].cos() - 1.0),
        ];
        for i in 0..3 {
            vel_mps[i] += STEP_S * (pull[i] + 0.05 * normal());
            pos_m[i] += STEP_S * vel_mps[i];
        }
    }
    FlightLog::from_mapped_bytes("flight.csv", text.as_bytes(), Mapping::parse("m.toml", MAPPING).unwrap())
        .unwrap()
}

/// The slope of the thrust took any value, and the hover PWM followed it 17 % away.
#[test]
fn an_effect_that_flights_do_not_show_is_left_out() {
    let logs: Vec<_> = (0..3).map(|seed| (format!("flight{seed}"), log(seed))).collect();
    let options = FitOptions { nuisance: true, effects: ubiquitous_effects(&logs), ..FitOptions::default() };
    let fitted = identify(&Model::thesis(), &logs, &options, &|| ()).unwrap();
    assert!(fitted.left_out.iter().any(|name| name == "thrust_slope"), "{:?}", fitted.left_out);
    let hover = fitted.model.parameter("vertical.thrust.hover").unwrap() / 65_535.0;
    assert!((hover / HOVER - 1.0).abs() < 0.01, "{hover}");
    let drag = fitted.model.parameter("lateral.drag").unwrap();
    assert!((drag - 0.4).abs() < 0.02, "{drag}");
}
