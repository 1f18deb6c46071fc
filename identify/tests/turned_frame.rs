//! Positions of a motion-capture frame that is turned about z: predictions start from the state that is reported as
//! measured, so that a hypothesis with the turn does not get the wrong start.

use std::fmt::Write;

use crazyflie_env::config::EffectTable;
use crazyflie_env::effects::find;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use crazyflie_identify::FlightLog;
use crazyflie_identify::axis_errors::axis_errors;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::output_error::OutputErrorProblem;
use crazyflie_identify::fit::solve::solve;
use crazyflie_logs::Mapping;

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
    let found = solve(&problem, problem.measured_starts(), problem.shared()).shared[0];
    assert!((found.abs() - 8.0).abs() < 0.1, "{found} degrees");
    // predictions, from the measured states
    term.values[0] = found;
    let sideways = |hypothesis: &Hypothesis, flight: &Flight| {
        axis_errors(&hypothesis.without_free(), flight, 0.0, None).unwrap().rms[0][1]
    };
    let with_turn = sideways(&straight.with(term), &turned);
    let [without, usual] = [&turned, &flight(&model, 0.0)].map(|flight| sideways(&straight, flight));
    assert!(with_turn < 1.2 * usual + 0.005 && without > 5.0 * with_turn, "{with_turn} {without} {usual}");
}
