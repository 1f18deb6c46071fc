//! The simulator on numbers with derivatives: the values of `f64`, and slopes that differences confirm, for
//! every effect that changes what is expected.

use crazyflie_env::dual::Dual;
use crazyflie_env::effects::{Entry, Observability, Role, registry};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::scalar::Scalar;
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::world::{Settings, World};

const SETTINGS: Settings = Settings { input: VerticalInput::Thrust, physics_hz: None };
const TICKS: usize = 40;

fn model() -> Model {
    let mut model = Model::thesis();
    model.rig.camera.value = 1.0;
    model
}

/// A lively flight: position, velocity, attitude reading, position in a frame with its stamp.
fn fly<R: SimScalar>(entry: &'static Entry, params: &[R], start: [R; 12]) -> Vec<R> {
    fly_keyed(entry, params, start, 0)
}

/// The same with noise of its own.
fn fly_keyed<R: SimScalar>(entry: &'static Entry, params: &[R], start: [R; 12], key: u64) -> Vec<R> {
    let mut world = World::<R>::for_fitting(&model(), &[entry], SETTINGS).unwrap();
    world.draw_lane(0, 0, key, &mut rand_pcg::Pcg64Mcg::new(1));
    world.set_params(entry.name, params).unwrap();
    let three = |i: usize| [start[i], start[i + 1], start[i + 2]];
    let x = State {
        pos_m: three(0),
        vel_mps: three(3),
        att_rad: three(6),
        rate_radps: three(9),
        aux: [start[5], R::zero()],
    };
    let command = |k: usize| {
        let wave = |hz: f64, phase: f64| (k as f64 * 0.02 * hz * std::f64::consts::TAU + phase).sin();
        Command {
            roll_rad: R::from_f64(0.15 * wave(1.1, 0.3)),
            pitch_rad: R::from_f64(0.2 * wave(0.7, 1.0)),
            yaw_rate_radps: R::from_f64(0.8 * wave(0.5, 0.1)),
            lift: R::from_f64(39_342.0 * (1.0 + 0.1 * wave(0.9, 0.5))),
        }
    };
    world.start(0, R::zero().le(R::zero()), &x, &command(0));
    world.set_voltage(Some(R::from_f64(3.8)));
    let mut attitude = [R::zero(); 3];
    for k in 0..TICKS {
        let reading = world.step(0, &command(k)).reading;
        attitude = reading.att_rad;
    }
    let x = *world.state(0);
    let frame = world.film(&x, R::from_f64(1.0));
    [x.pos_m.as_slice(), &x.vel_mps, &attitude, &frame.pos_m, &[frame.t_s]].concat()
}

fn start() -> [f64; 12] {
    [0.1, -0.2, 0.25, 0.6, -0.4, 0.3, 0.05, -0.08, 0.4, 0.2, -0.1, 0.3]
}

/// Away from "off", where limits, dead bands and lags have slopes.
fn lively(entry: &Entry) -> Vec<f64> {
    let value = |p: &crazyflie_env::effects::Param| match p.role {
        Role::Choice => 2.0_f64.min(p.high),
        _ if p.name == "tilt_deg" && p.off == 90.0 => 6.0,
        // limits that the commands meet, a time within the flight
        _ if p.name == "ratio" => 1.02,
        _ if p.name == "tilt_degps" => 30.0,
        _ if p.name == "t_s" => 0.4,
        _ => p.off + 0.13 * if p.high > p.off { p.high - p.off } else { p.low - p.off },
    };
    entry.params.iter().map(value).collect()
}

#[test]
fn values_are_those_of_f64_and_slopes_those_of_differences() {
    for entry in registry()
        .iter()
        .filter(|e| e.observability.shapes_mean() || e.observability == Observability::Surrogate)
    {
        let at = lively(entry);
        // numbers with derivatives carry the expectation of a random effect
        let random = fly_keyed(entry, &at, start(), 1) != fly_keyed(entry, &at, start(), 2);
        let values = |at: &[f64]| -> Vec<f64> {
            if !random {
                return fly(entry, at, start());
            }
            let dual: Vec<Dual> = at.iter().map(|v| Dual::from_f64(*v)).collect();
            fly(entry, &dual, start().map(Dual::from_f64)).iter().map(|d| d.value).collect()
        };
        let plain = values(&at);
        for (i, param) in entry.params.iter().enumerate().filter(|(_, p)| p.role == Role::Free) {
            let mut params: Vec<Dual> = at.iter().map(|v| Dual::from_f64(*v)).collect();
            params[i] = Dual::variable(at[i], 5);
            let dual = fly(entry, &params, start().map(Dual::from_f64));
            let h = 1e-6 * (param.high - param.low);
            let moved = |by: f64| {
                let mut to = at.clone();
                to[i] += by;
                values(&to)
            };
            let (up, down) = (moved(h), moved(-h));
            for (k, number) in dual.iter().enumerate() {
                assert_eq!(number.value, plain[k], "{} output {k}", entry.name);
                let difference = (up[k] - down[k]) / (2.0 * h);
                let scale = 1e-3 / (param.high - param.low) + difference.abs();
                assert!(
                    (f64::from(number.slope[5]) - difference).abs() < 2e-3 * scale,
                    "{}.{} output {k}: {} against {difference}",
                    entry.name,
                    param.name,
                    number.slope[5]
                );
            }
        }
    }
}

#[test]
fn what_is_expected_of_lost_packets_is_their_mean() {
    const FLIGHTS: u64 = 4000;
    for burst in [0.0, 0.6] {
        check(burst);
    }

    fn check(burst: f64) {
        let entry = registry().iter().find(|e| e.name == "packet_loss").unwrap();
        let expected = fly(entry, &[0.4, burst].map(Dual::from_f64), start().map(Dual::from_f64));
        let flights: Vec<Vec<f64>> =
            (0..FLIGHTS).map(|key| fly_keyed(entry, &[0.4, burst], start(), key)).collect();
        for (k, number) in expected.iter().enumerate() {
            let mean = flights.iter().map(|f| f[k]).sum::<f64>() / FLIGHTS as f64;
            let variance = flights.iter().map(|f| (f[k] - mean).powi(2)).sum::<f64>() / FLIGHTS as f64;
            // the frame's stamp is not random; the path bends a little, so the mean is not quite that of the mean
            // command
            let within = 4.0 * (variance / FLIGHTS as f64).sqrt() + 0.02 * variance.sqrt() + 1e-12;
            assert!(
                (number.value - mean).abs() < within,
                "burst {burst}, output {k}: {} against {mean} +- {within}",
                number.value
            );
        }
    }
}

#[test]
fn the_start_has_slopes_too() {
    let entry = registry().iter().find(|e| e.name == "drag_quadratic").unwrap();
    for direction in 0..12 {
        let mut x = start().map(Dual::from_f64);
        x[direction] = Dual::variable(x[direction].value, direction);
        let dual = fly(entry, &[Dual::from_f64(0.4)], x);
        let moved = |by: f64| {
            let mut x = start();
            x[direction] += by;
            fly(entry, &[0.4], x)
        };
        let (up, down) = (moved(1e-6), moved(-1e-6));
        for (k, number) in dual.iter().enumerate() {
            let difference = (up[k] - down[k]) / 2e-6;
            assert!(
                (f64::from(number.slope[direction]) - difference).abs() < 1e-5,
                "start {direction} output {k}: {} against {difference}",
                number.slope[direction]
            );
        }
    }
}

#[test]
fn an_offset_of_the_centre_of_mass_settles_at_its_angle() {
    let entry = registry().iter().find(|e| e.name == "com_offset").unwrap();
    let mut world = World::<f64>::for_fitting(&model(), &[entry], SETTINGS).unwrap();
    world.set_params("com_offset", &[2.0, -1.0]).unwrap();
    // the arm is the same under more thrust, the torque is not
    for ratio in [1.0, 1.2] {
        let command = Command::level(ratio * 39_342.5);
        world.start(0, true, &State::rest(), &command);
        for _ in 0..500 {
            world.step(0, &command);
        }
        let angles = world.state(0).att_rad.map(f64::to_degrees);
        assert!((angles[0] - 2.0 * ratio).abs() < 1e-6 && (angles[1] + ratio).abs() < 1e-6, "{angles:?}");
    }
}

#[test]
fn a_drifting_heading_is_read_and_not_flown() {
    let entry = registry().iter().find(|e| e.name == "yaw_drift").unwrap();
    let mut world = World::<f64>::for_fitting(&model(), &[entry], SETTINGS).unwrap();
    world.set_params("yaw_drift", &[3.0]).unwrap();
    world.start(0, true, &State::rest(), &Command::level(39_342.0));
    let mut read = 0.0;
    for _ in 0..50 {
        let reading = world.step(0, &Command::level(39_342.0)).reading;
        read = reading.att_rad[2].to_degrees();
    }
    assert!((read - 3.0).abs() < 1e-9 && world.state(0).att_rad[2] == 0.0, "{read}");
}

#[test]
fn a_late_stamp_and_a_turned_marker_frame_show_in_the_frame() {
    let entries: Vec<&'static Entry> =
        registry().iter().filter(|e| e.name == "frame_yaw" || e.name == "camera_latency").collect();
    let mut world = World::<f64>::for_fitting(&model(), &entries, SETTINGS).unwrap();
    world.set_params("frame_yaw", &[90.0]).unwrap();
    world.set_params("camera_latency", &[0.0, 0.04]).unwrap();
    let x = State { pos_m: [1.0, 0.0, 0.5], ..State::rest() };
    let frame = world.film(&x, 2.0);
    // seen from a frame turned to the left, what lies ahead lies to the right
    assert!((frame.pos_m[0]).abs() < 1e-9 && (frame.pos_m[1] + 1.0).abs() < 1e-9, "{:?}", frame.pos_m);
    assert!((frame.t_s - 2.04).abs() < 1e-12 && (frame.yaw_rad + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
}
