//! Frames of motion capture: positions turned about z, where predictions start from the state that is reported as
//! measured, and trims of single flights beside random pushes.

use std::fmt::Write;

use crazyflie_env::config::EffectTable;
use crazyflie_env::effects::find;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use crazyflie_identify::FlightLog;
use crazyflie_identify::axis_errors::axis_errors;
use crazyflie_identify::explain::recorded::explain_recorded;
use crazyflie_identify::explain::signals::Signal;
use crazyflie_identify::explain::verdict::{Leftover, Verdict};
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::output_error::OutputErrorProblem;
use crazyflie_identify::fit::solve::solve;
use crazyflie_identify::vehicle::settle_flights;
use crazyflie_logs::Mapping;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

const TICK_S: f64 = 0.02;

/// A figure eight of 30 s in a frame that is turned by this angle against the world.
fn log(model: &Model, turn_deg: f64) -> FlightLog {
    let settings = Settings { input: VerticalInput::Height, physics_hz: None };
    let mut world = World::<f64>::new(model, &EffectTable::new(), settings, 1).unwrap().without_floor();
    let mut start = State::<f64>::rest();
    start.pos_m[2] = 0.8;
    let command = |roll_rad, pitch_rad| Command { roll_rad, pitch_rad, yaw_rate_radps: 0.0, lift: 0.8 };
    world.start(0, true, &start, &command(0.0, 0.0));
    let mut text = String::from("t,x,y,z,roll,pitch,yaw,u,v,h\n");
    let (sine, cosine) = turn_deg.to_radians().sin_cos();
    for tick in 0..1500 {
        let (t, s) = (tick as f64 * TICK_S, *world.state(0));
        let wanted = [(1.3 * t).sin() - s.pos_m[0], 0.7 * (2.6 * t).sin() - s.pos_m[1]];
        let [ax, ay] = [0, 1].map(|axis| 4.0 * wanted[axis] - 2.0 * s.vel_mps[axis]);
        let (roll, pitch) = ((-ay / 9.81).clamp(-0.3, 0.3), (ax / 9.81).clamp(-0.3, 0.3));
        let [x, y] = [cosine * s.pos_m[0] - sine * s.pos_m[1], sine * s.pos_m[0] + cosine * s.pos_m[1]];
        let [a, b, c] = s.att_rad;
        writeln!(text, "{t},{x},{y},{},{a},{b},{c},{roll},{pitch},0.8", s.pos_m[2]).unwrap();
        world.step(0, &command(roll, pitch));
    }
    read(&text)
}

fn read(text: &str) -> FlightLog {
    let mapping = "position = \"motion_capture\"\nattitude = \"motion_capture\"\n[time]\ncolumn = \"t\"\n[channels]\n\
        x = { column = \"x\" }\ny = { column = \"y\" }\nz = { column = \"z\" }\nroll = { column = \"roll\" }\n\
        pitch = { column = \"pitch\" }\nyaw = { column = \"yaw\" }\ncmd_roll = { column = \"u\" }\n\
        cmd_pitch = { column = \"v\" }\ncmd_height = { column = \"h\" }\n";
    let mapping = Mapping::parse("m.toml", mapping).unwrap();
    FlightLog::from_mapped_bytes("flight.csv", text.as_bytes(), mapping).unwrap()
}

fn flight(model: &Model, turn_deg: f64) -> Flight {
    Flight::from_log("flight", &log(model, turn_deg), model, None).unwrap()
}

#[test]
fn a_turned_frame_is_found_and_predicted_as_a_straight_one() {
    let model = Model::thesis();
    let straight = Hypothesis { estimates_lagged_push: false, ..Hypothesis::from_model(&model) };
    let mut term = Term::off(find("frame_yaw").unwrap().1);
    let turned = flight(&model, 8.0);
    // the fit, from no turn at all
    let free = straight.with(term.clone());
    let flights = [turned.clone()];
    let windows = turned.windows(0, 2.0);
    let problem =
        OutputErrorProblem { flights: &flights, windows: &windows, hypothesis: &free, inflation: 1.0 };
    let yaw_deg = solve(&problem, problem.measured_starts(), problem.shared()).shared[0];
    assert!((yaw_deg.abs() - 8.0).abs() < 0.1, "{yaw_deg} degrees");
    // predictions, from the measured states
    term.values[0] = yaw_deg;
    let sideways = |hypothesis: &Hypothesis, flight: &Flight| {
        axis_errors(&hypothesis.without_free(), flight, 0.0).unwrap().rms[0][1]
    };
    let with_turn = sideways(&straight.with(term), &turned);
    let [without, usual] = [&turned, &flight(&model, 0.0)].map(|flight| sideways(&straight, flight));
    assert!(with_turn < 1.2 * usual + 0.005 && without > 5.0 * with_turn, "{with_turn} {without} {usual}");
}

/// A figure eight of the linear model with this drag and a pull towards half a metre ahead and to the left, without any
/// trim, under pushes of 0.08 m/s^2 for half a second at a time; noise of 1 mrad and half a millimetre.
fn pushed(model: &Model, drag_ps: f64, pull_ps2: f64, seed: u64) -> FlightLog {
    const STEP_S: f64 = 0.001;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    let (mut pos_m, mut vel_mps, mut tilt, mut rate, mut push) =
        ([0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2]);
    let mut text = String::from("t,x,y,z,roll,pitch,yaw,u,v,h\n");
    let mut command = [0.0; 2];
    for step in 0..30_000 {
        let t = f64::from(step) * STEP_S;
        if step % 20 == 0 {
            let wanted: [f64; 2] = [(1.3 * t).sin() - pos_m[0], 0.7 * (2.6 * t).sin() - pos_m[1]];
            let [ax, ay] = [0, 1].map(|axis| 4.0 * wanted[axis] - 2.0 * vel_mps[axis]);
            command = [(-ay / 9.81_f64).clamp(-0.3, 0.3), (ax / 9.81).clamp(-0.3, 0.3)];
            let [x, y, z] = [pos_m[0], pos_m[1], 0.8].map(|m| m + 5e-4 * normal());
            let [a, b, c] = [tilt[0], tilt[1], 0.0].map(|rad| rad + 1e-3 * normal());
            writeln!(text, "{t},{x},{y},{z},{a},{b},{c},{},{},0.8", command[0], command[1]).unwrap();
        }
        for (i, axis) in [&model.roll, &model.pitch].into_iter().enumerate() {
            let (gain, damping, stiffness) = (axis.gain.value, axis.damping.value, axis.stiffness.value);
            rate[i] += STEP_S * (gain * command[i] - damping * rate[i] - stiffness * tilt[i]);
            tilt[i] += STEP_S * rate[i];
            push[i] += STEP_S / 0.5 * -push[i] + 0.08 * (2.0 * STEP_S / 0.5).sqrt() * normal();
        }
        for (i, lean) in [tilt[1], -tilt[0]].into_iter().enumerate() {
            vel_mps[i] +=
                STEP_S * (9.81 * lean + push[i] - drag_ps * vel_mps[i] - pull_ps2 * (pos_m[i] - 0.5));
            pos_m[i] += STEP_S * vel_mps[i];
        }
    }
    read(&text)
}

#[test]
fn random_pushes_are_not_taken_for_trims_of_a_flight() {
    let model = Model::thesis();
    let flight = |seed| Flight::from_log("flight", &pushed(&model, 0.0, 0.0, seed), &model, None).unwrap();
    let (mut fit, mut test) =
        ((0..3).map(flight).collect::<Vec<_>>(), (3..9).map(flight).collect::<Vec<_>>());
    for trims in settle_flights(&model, &mut fit, &mut test) {
        let worst = trims.values.iter().filter(|v| v.1 == "deg").map(|v| v.2.abs()).fold(0.0, f64::max);
        assert!(worst < 0.4, "{trims:?}");
    }
}

#[test]
fn a_declared_drag_may_turn_out_to_be_larger() {
    let model = Model::thesis().with_parameter("lateral.drag", 0.2).unwrap();
    let log = |seed: u64| (format!("flight{seed}"), pushed(&model, 0.6, 0.0, seed));
    let (fit, test) = ([log(0), log(1)], [log(2), log(3)]);
    let (found, _) = explain_recorded(&model, &fit, &test, VerticalInput::Height, &|_| ()).unwrap();
    let drag = found.effects.iter().chain(&found.partial).find(|effect| effect.name == "drag_linear");
    let rate = &drag.unwrap_or_else(|| panic!("{found:?}")).params[0];
    assert!((rate.value - 0.6).abs() < 0.05 && rate.declared == 0.2, "{rate:?}");
}

#[test]
fn a_pull_towards_a_place_is_described_and_gets_no_name() {
    let model = Model::thesis();
    let log = |seed: u64| (format!("flight{seed}"), pushed(&model, 0.0, 0.8, seed));
    let (fit, test) = ([log(0), log(1)], [log(2), log(3)]);
    let (found, _) = explain_recorded(&model, &fit, &test, VerticalInput::Height, &|_| ()).unwrap();
    assert!(found.effects.is_empty() && found.learned, "{found:?}");
    let is_place =
        |left: &Leftover| left.part == Signal::Sideways && left.finding.contains("goes with the place");
    assert!(found.leftover.iter().any(is_place), "{:?}", found.leftover);
    let [now, later] = found.signals[0].explained_share;
    assert!(found.verdict == Verdict::Unexplained && now > 0.4 && later > 0.6, "{:?}", found.signals[0]);
}
