//! Every effect of the registry: off means nothing, on means something, and what it means.

use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::effects::{Neighbour, registry};
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::noise::episode_key;
use crazyflie_env::plant::{Accelerations, Command, State};
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::world::{Around, GROUP, Settings, Tick, World};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

fn table(json: &str) -> EffectTable {
    Options::parse(&format!("{{\"effects\": {json}}}")).unwrap().effects
}

/// Flies with varied commands and returns every tick: true state, then reading.
fn fly<R: SimScalar>(effects: &EffectTable, physics_hz: Option<u32>, seconds: f64) -> Vec<Vec<f64>> {
    let settings = Settings { input: VerticalInput::Thrust, physics_hz };
    let mut world = World::<R>::new(&Model::thesis(), effects, settings, 1).unwrap();
    world.draw_lane(0, 0, episode_key(5, 0), &mut Pcg64Mcg::seed_from_u64(5));
    let mut x = State::<R>::rest();
    x.pos_m[2] = R::from_f64(0.3);
    world.start(0, !R::nothing(), &x, &Command::level(R::from_f64(39_342.5)));
    (0..(seconds * 50.0) as usize)
        .map(|tick| {
            let t = 0.02 * tick as f64;
            let u = Command {
                roll_rad: R::from_f64(0.10 * libm::sin(3.1 * t)),
                pitch_rad: R::from_f64(0.12 * libm::sin(2.3 * t)),
                yaw_rate_radps: R::from_f64(0.8 * libm::sin(0.9 * t)),
                lift: R::from_f64(39_500.0 + 1500.0 * libm::sin(1.7 * t)),
            };
            let y = step_below_another(&mut world, &u).reading;
            let x = world.state(0);
            let mut row: Vec<f64> =
                [x.pos_m, x.vel_mps, x.att_rad, x.rate_radps].iter().flatten().map(|v| v.lane(0)).collect();
            let m = &y.marker;
            let flat = [m.pos_m, y.att_rad, y.gyro_radps, y.acc_mps2];
            row.extend(
                flat.iter().flatten().chain([&m.yaw_rad, &m.t_s, &m.valid, &y.vbat_v]).map(|v| v.lane(0)),
            );
            row
        })
        .collect()
}

/// A step with another drone a quarter of a metre above, for the effects that feel one.
fn step_below_another<R: SimScalar>(world: &mut World<R>, u: &Command<R>) -> Tick<R> {
    let x = *world.state(0);
    let own = Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::from_f64(1.0) };
    let above = Neighbour { pos_m: [x.pos_m[0], x.pos_m[1], x.pos_m[2] + R::from_f64(0.25)], ..own };
    let drones = [own, above];
    let around = Around { neighbours: &drones, own: 0, push: Accelerations::none() };
    let mut tick = Tick::none();
    world.step_group(0, std::slice::from_ref(u), Some(&[around; GROUP]), std::slice::from_mut(&mut tick));
    tick
}

fn difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter().zip(b).flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// An effect with every parameter drawn from a choice of one: it runs although it is off.
fn forced(entry: &crazyflie_env::effects::Entry, value: impl Fn(usize) -> f64) -> String {
    let params: Vec<String> = entry
        .params
        .iter()
        .enumerate()
        .map(|(i, p)| format!("\"{}\": {{\"choice\": [{}]}}", p.name, value(i)))
        .collect();
    format!("\"{}\": {{{}}}", entry.name, params.join(", "))
}

#[test]
fn off_changes_nothing() {
    for entry in registry() {
        // a camera is there as soon as anything films: compare with the camera alone
        let base = if entry.hooks.frame { "\"camera\": 1".to_owned() } else { String::new() };
        let with = format!(
            "{{{}}}",
            [base.clone(), forced(entry, |i| entry.params[i].off)]
                .iter()
                .filter(|s| !s.is_empty())
                .cloned()
                .collect::<Vec<_>>()
                .join(", ")
        );
        let hz = Some(300);
        let with = if entry.name == "camera" { "{\"camera\": {\"choice\": [0]}}".to_owned() } else { with };
        let (off, none) =
            (fly::<f64>(&table(&with), hz, 3.0), fly::<f64>(&table(&format!("{{{base}}}")), hz, 3.0));
        let d = difference(&off, &none);
        // the battery shows its voltage also where it does not sag
        let battery = entry.name == "battery_sag";
        let rows = |f: &[Vec<f64>]| {
            f.iter().map(|r| r[..r.len() - usize::from(battery)].to_vec()).collect::<Vec<_>>()
        };
        let d = if battery { difference(&rows(&off), &rows(&none)) } else { d };
        assert!(d < 1e-12, "{} off changes something by {d:e}", entry.name);
    }
}

/// More markers in view make less noise.
const NOISY_VIEW: &str = "\"camera_fov\": {\"diagonal_deg\": 120}, \"camera_noise\": {\"xy_m\": 0.01}";

#[test]
fn on_changes_something() {
    for entry in registry() {
        let base = if entry.hooks.frame && entry.name != "camera" { "\"camera\": 1" } else { "" };
        let on = |i: usize| {
            let p = &entry.params[i];
            match entry.name {
                // the one that must not be at the end of its range to be felt
                "cmd_limit" => [2.0, 10.0, 39_000.0, 40_000.0][i],
                // reaches from the floor to the flight
                "ground_effect_exp" => [0.3, 0.2, 0.02][i],
                // slower than the commands
                "cmd_rate_limit" => 10.0,
                // less than the commands ask
                "motor_saturation" => 1.01,
                // within the flight
                "thrust_step" => [0.9, 1.5][i],
                "wind_step" => [0.5, -0.5, 1.5][i],
                "camera_outliers" => [0.5, 0.1, 0.0, 5.0][i],
                "camera_fov" => [60.0, 0.02, 0.197, 5.0, 0.1][i],
                "markers" => [3.0, 3.0, 0.2][i],
                _ if p.high.is_finite() => {
                    p.off + 0.5 * (p.high - p.off) + if p.high == p.off { 0.5 * (p.low - p.off) } else { 0.0 }
                }
                _ => p.off + 1.0,
            }
        };
        let mut with = forced(entry, on);
        if entry.name == "markers" {
            with += &format!(", {NOISY_VIEW}");
        }
        let without = if entry.name == "markers" { NOISY_VIEW } else { base };
        let join =
            |a: &str, b: &str| format!("{{{a}{}{b}}}", if a.is_empty() || b.is_empty() { "" } else { ", " });
        let (changed, plain) = (
            fly::<f64>(&table(&join(base, &with)), None, 3.0),
            fly::<f64>(&table(&join(without, "")), None, 3.0),
        );
        assert!(
            changed.iter().flatten().all(|v| v.is_finite()),
            "{} gives a number that is none",
            entry.name
        );
        let d = difference(&changed, &plain);
        assert!(d > 1e-4, "{} on changes nothing ({d:e})", entry.name);
    }
}

#[test]
fn lanes_agree_with_the_double_precision_reference() {
    for entry in registry().iter().filter(|e| e.name != "camera_fov" && e.name != "cmd_deadband") {
        let middle = |i: usize| {
            let p = &entry.params[i];
            p.off + 0.2 * (p.high - p.off)
        };
        let effects = table(&format!("{{{}}}", forced(entry, middle)));
        let (double, single) = (fly::<f64>(&effects, None, 3.0), fly::<Lanes>(&effects, None, 3.0));
        let d = difference(&double, &single);
        assert!(d < 5e-3, "{}: f32 is off by {d:e}", entry.name);
    }
}

#[test]
fn held_pushes_converge_to_second_order() {
    let effects = table(
        r#"{"drag_linear": 0.8, "ground_effect": 8.0, "drag_quadratic": 0.5, "tilt_loss": 1, "exact_tan": 1}"#,
    );
    // the true state; the IMU's force is a mean over the last step, whose length differs
    let flown_at = |hz| {
        fly::<f64>(&effects, Some(hz), 4.0).into_iter().map(|row| row[..12].to_vec()).collect::<Vec<_>>()
    };
    let truth = flown_at(300);
    let (coarse, fine) = (difference(&flown_at(50), &truth), difference(&flown_at(100), &truth));
    println!("largest deviation from 300 Hz physics after 4 s: {coarse:.1e} at 50 Hz, {fine:.1e} at 100 Hz");
    assert!(coarse < 5e-3 && fine < coarse / 2.5, "{coarse:e} {fine:e}");
}

/// Returns the last row of a flight with a constant level command after `seconds`.
fn hover(effects: &str, input: VerticalInput, lift: f64, z: f64, seconds: f64) -> State<f64> {
    let mut world =
        World::<f64>::new(&Model::thesis(), &table(effects), Settings { input, physics_hz: Some(300) }, 1)
            .unwrap();
    let mut x = State::rest();
    x.pos_m[2] = z;
    let u = Command::level(lift);
    world.start(0, true, &x, &u);
    for _ in 0..(seconds * 50.0) as usize {
        world.step(0, &u);
    }
    *world.state(0)
}

#[test]
fn forces_have_the_size_that_their_formula_says() {
    let thrust = |effects: &str| hover(effects, VerticalInput::Thrust, 39_342.5, 1.0, 0.1).vel_mps[2] / 0.1;
    // over a tenth of a second heave damping takes about 6 % of a speed
    let mean = (1.0 - (-0.12_f64).exp()) / 0.12;
    for (effects, acc) in [
        (r#"{"mass_change": 0.0046}"#, 9.81 * (0.0368 / 0.0414 - 1.0)),
        (r#"{"thrust_scale": 0.9}"#, -0.981),
        (r#"{"wind": {"z_mps2": 0.4}}"#, 0.4),
        // changes of the thrust multiply, and wind is no thrust
        (
            r#"{"mass_change": 0.0046, "thrust_scale": 0.9, "wind": {"z_mps2": 0.4}}"#,
            9.81 * (0.9 * 0.0368 / 0.0414 - 1.0) + 0.4,
        ),
    ] {
        let got = thrust(effects);
        assert!(
            (got - acc * mean).abs() < 0.01 * acc.abs() + 2e-3,
            "{effects}: {got} instead of {}",
            acc * mean
        );
    }
    // a weak motor loses its share of the thrust, and soon of what the attitude loop asks of it besides: a
    // tenth more within a tenth of a second
    for (effects, scale) in [("", 1.0), (r#""thrust_scale": 0.9, "#, 0.9)] {
        let with = thrust(&format!(r#"{{{effects}"weak_motor": {{"motor": 2, "loss": 0.2}}}}"#));
        let lost = 9.81 * (scale - 1.0) * mean - with;
        let share = 9.81 * scale * 0.05 * mean;
        assert!((1.05 * share..1.2 * share).contains(&lost), "{lost} is lost, {share} of the thrust");
    }
    // drag: exponential decay
    let mut world = World::<f64>::new(
        &Model::thesis(),
        &table(r#"{"drag_linear": 0.5}"#),
        Settings { input: VerticalInput::Height, physics_hz: None },
        1,
    )
    .unwrap();
    let mut x = State::rest();
    (x.pos_m[2], x.vel_mps[0]) = (0.7, 1.0);
    world.start(0, true, &x, &Command::level(0.7));
    for _ in 0..100 {
        world.step(0, &Command::level(0.7));
    }
    assert!((world.state(0).vel_mps[0] - (-1.0_f64).exp()).abs() < 1e-4);
}

/// A vehicle whose estimator takes drag for tilt settles where drag balances a lean of `kappa v` more than it
/// thinks, whichever way it faces.
#[test]
fn an_estimator_that_takes_drag_for_tilt_lets_the_vehicle_lean_farther() {
    let (kappa, drag_ps, yaw_rad) = (0.03, 0.8, 0.6);
    let effects = table(&format!(r#"{{"estimator_tilt": {kappa}, "drag_linear": {drag_ps}}}"#));
    let model = Model::thesis();
    let settings = Settings { input: VerticalInput::Height, physics_hz: None };
    let mut world = World::<f64>::new(&model, &effects, settings, 1).unwrap().without_floor();
    let mut x = State::rest();
    (x.pos_m[2], x.att_rad[2]) = (0.7, yaw_rad);
    let u = Command { roll_rad: -0.02, pitch_rad: 0.05, ..Command::level(0.7) };
    world.start(0, true, &x, &u);
    let mut reading = [0.0; 3];
    for _ in 0..1500 {
        reading = world.step(0, &u).reading.att_rad;
    }
    let x = world.state(0);
    let front = yaw_rad.cos() * x.vel_mps[0] + yaw_rad.sin() * x.vel_mps[1];
    let right = yaw_rad.sin() * x.vel_mps[0] - yaw_rad.cos() * x.vel_mps[1];
    for (axis, (tilt, command, speed)) in
        [(&model.roll, u.roll_rad, right), (&model.pitch, u.pitch_rad, front)].into_iter().enumerate()
    {
        // the estimate obeys the command as the angle does in 5.1, and is what the vehicle reports
        let estimated = command * tilt.gain.value / tilt.stiffness.value;
        assert!((reading[axis] - estimated).abs() < 1e-4, "axis {axis}: {} {estimated}", reading[axis]);
        assert!(
            (x.att_rad[axis] - estimated - kappa * speed).abs() < 1e-4,
            "axis {axis}: {} {estimated} {speed}",
            x.att_rad[axis]
        );
        let settled = 9.81 * estimated / (drag_ps + model.lateral.drag.value - 9.81 * kappa);
        assert!((speed / settled - 1.0).abs() < 0.01, "axis {axis}: {speed} {settled}");
    }
}

/// External pulls on a vehicle, by a rope or a filter's disturbance, are not scaled with its thrust.
#[test]
fn what_pulls_from_outside_is_no_thrust() {
    let settings = Settings { input: VerticalInput::Thrust, physics_hz: Some(300) };
    let mut world =
        World::<f64>::new(&Model::thesis(), &table(r#"{"thrust_scale": 0.9}"#), settings, 1).unwrap();
    let u = Command::level(39_342.5);
    world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], ..State::rest() }, &u);
    let push = Accelerations { acc_mps2: [0.0, 0.0, -2.0], ..Accelerations::none() };
    let around = Around { neighbours: &[], own: 0, push };
    world.step_group(0, &[u], Some(&[around; GROUP]), &mut [Tick::none()]);
    let got = world.state(0).vel_mps[2] / 0.02;
    assert!((got + 2.981).abs() < 0.05, "{got}");
}

/// Sideways too, whatever the thrust of the moment: at a constant attitude, the vehicle accelerates along its own
/// axis and falls.
#[test]
fn thrust_points_along_the_vehicles_axis() {
    let model = Model::thesis();
    let effects = table(r#"{"tilt_loss": {"amount": 1, "sideways": 1}, "thrust_scale": 1.2}"#);
    let settings = Settings { input: VerticalInput::Thrust, physics_hz: Some(300) };
    let mut world = World::<f64>::new(&model, &effects, settings, 1).unwrap();
    let att_rad = [0.2, -0.3, 0.7];
    let held = |tilt: &crazyflie_env::model::Tilt, angle: f64| angle * tilt.stiffness.value / tilt.gain.value;
    let (roll_rad, pitch_rad) = (held(&model.roll, att_rad[0]), held(&model.pitch, att_rad[1]));
    let u = Command { roll_rad, pitch_rad, ..Command::level(39_342.5) };
    world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], att_rad, ..State::rest() }, &u);
    world.step(0, &u);
    let [roll, pitch, yaw] = att_rad;
    let thrust = nalgebra::Rotation3::from_euler_angles(roll, pitch, yaw)
        * nalgebra::Vector3::new(0.0, 0.0, 1.2 * 9.81);
    for (i, truth) in [thrust.x, thrust.y, thrust.z - 9.81].into_iter().enumerate() {
        let got = world.state(0).vel_mps[i] / 0.02;
        // a hundredth for heave damping
        assert!((got - truth).abs() < 0.015 * truth.abs(), "axis {i}: {got} instead of {truth}");
    }
}

#[test]
fn ground_effect_carries_more_near_the_floor() {
    let climb =
        |effects: &str, z: f64| hover(effects, VerticalInput::Thrust, 39_342.5, z, 0.02).vel_mps[2] / 0.02;
    for z in [0.05, 0.1, 0.2] {
        for (rotors_m, effects) in [
            (0.0, r#"{"ground_effect": 8.0}"#),
            (0.03, r#"{"ground_effect": {"coefficient": 8.0, "rotor_height_m": 0.03}}"#),
        ] {
            let near: f64 = 0.0225 / (4.0 * (z + rotors_m));
            let expected = 9.81 * (1.0 / (1.0 - 8.0 * near * near) - 1.0);
            let got = climb(effects, z);
            assert!((got / expected - 1.0).abs() < 0.03, "at {z} m: {got} instead of {expected}");
        }
        let expected = 9.81 * (1.0 / (1.0 - 0.2 * (-0.5 * z / 0.0225_f64).exp()) - 1.0);
        let got = climb(r#"{"ground_effect_exp": 0.2}"#, z);
        assert!((got / expected - 1.0).abs() < 0.03, "at {z} m: {got} instead of {expected}");
    }
}

#[test]
fn a_delayed_command_is_the_same_command_later() {
    let response = |delay: f64| {
        let mut world = World::<f64>::new(
            &Model::thesis(),
            &table(&format!("{{\"cmd_delay\": {delay}}}")),
            Settings { input: VerticalInput::Height, physics_hz: Some(300) },
            1,
        )
        .unwrap();
        let mut x = State::rest();
        x.pos_m[2] = 0.7;
        world.start(0, true, &x, &Command::level(0.7));
        let u = Command { pitch_rad: 0.1, ..Command::level(0.7) };
        (0..50)
            .map(|_| {
                world.step(0, &u);
                world.state(0).att_rad[1]
            })
            .collect::<Vec<_>>()
    };
    let (now, later, between) = (response(0.0), response(0.06), response(0.05));
    for i in 3..50 {
        assert!((now[i - 3] - later[i]).abs() < 1e-9, "tick {i}: {} then {}", now[i - 3], later[i]);
        assert!(between[i] > later[i] && between[i] < now[i - 2]);
    }
    assert!(later[..3].iter().all(|a| a.abs() < 1e-12));
}

/// Age and validity of the marker at every tick of a hover.
fn marker(effects: &str, pitch: f64, seconds: f64) -> Vec<(f64, f64, [f64; 3])> {
    let mut world = World::<f64>::new(
        &Model::thesis(),
        &table(effects),
        Settings { input: VerticalInput::Height, physics_hz: None },
        1,
    )
    .unwrap();
    world.draw_lane(0, 0, 77, &mut Pcg64Mcg::seed_from_u64(1));
    let mut x = State::rest();
    x.pos_m[2] = 0.7;
    world.start(0, true, &x, &Command::level(0.7));
    let u = Command { pitch_rad: pitch, ..Command::level(0.7 * 1.592 / 1.615) };
    (0..(50.0 * seconds) as usize)
        .map(|tick| {
            let m = world.step(0, &u).reading.marker;
            let now = 0.02 * (tick + 1) as f64;
            (now - m.t_s, m.valid, m.pos_m)
        })
        .collect()
}

#[test]
fn frames_come_at_30_hz_between_ticks_and_late() {
    let ages: Vec<i64> =
        marker(r#"{"camera": 1}"#, 0.0, 0.2).iter().map(|m| (m.0 * 300.0).round() as i64).collect();
    // frames at 0, 10, 20, 30 ... counts of 300 Hz, ticks at 6, 12, 18 ...
    assert_eq!(ages, [6, 2, 8, 4, 0, 6, 2, 8, 4, 0]);
    let late: Vec<i64> = marker(r#"{"camera_latency": 0.05}"#, 0.0, 0.4)
        .iter()
        .map(|m| (m.0 * 300.0).round() as i64)
        .collect();
    // 15 counts later: the newest frame that is at least 15 counts old
    let expected: Vec<i64> = (1..=20).map(|tick| 6 * tick - (6 * tick - 15).max(0) / 10 * 10).collect();
    assert_eq!(late, expected);
}

#[test]
fn a_frame_shows_where_the_vehicle_was_when_it_was_taken() {
    // 5.5 for a step of 0.1 rad, evaluated where the frames fall
    let truth = |t: f64| {
        let space = Model::thesis().state_space(VerticalInput::Height).unwrap();
        let u = nalgebra::SVector::<f64, 4>::new(0.0, 0.1, 0.0, 0.7);
        space.advance(&nalgebra::SVector::<f64, 12>::zeros(), &u, t)[0]
    };
    for (i, (age, _, pos)) in marker(r#"{"camera": 1}"#, 0.1, 1.0).iter().enumerate() {
        let taken = 0.02 * (i + 1) as f64 - age;
        assert!(
            (pos[0] - truth(taken)).abs() < 5e-6,
            "frame of {taken}: {} instead of {}",
            pos[0],
            truth(taken)
        );
    }
}

#[test]
fn the_marker_is_lost_at_the_edge_of_the_view_and_kept_in_mind() {
    let seen = marker(r#"{"camera_fov": {"diagonal_deg": 120}}"#, 7.5_f64.to_radians(), 3.0);
    let lost = seen.iter().position(|m| m.1 < 0.5).expect("flying away loses the marker");
    let x = seen[lost - 1].2[0];
    // Nose down by 11.3 degrees the camera looks back: the far corners leave 55.2 + 11.3 degrees behind, seen
    // from 0.68 m.
    let expected = 0.68 * (55.2_f64 + 11.3).to_radians().tan() - 0.0985;
    assert!((x - expected).abs() < 0.06, "lost at {x} m, expected about {expected}");
    assert!(seen[lost..].iter().all(|m| m.1 < 0.5 && (m.2[0] - x).abs() < 1e-12), "the last pose is kept");
    let age = seen.last().unwrap().0;
    assert!(age > 1.0, "its age grows: {age}");
    let field = marker(
        r#"{"camera_fov": {"diagonal_deg": 120}, "markers": {"columns": 9, "pitch_m": 0.5}}"#,
        7.5_f64.to_radians(),
        2.0,
    );
    assert!(field.iter().all(|m| m.1 > 0.5), "a field of markers carries farther");
}

#[test]
fn noise_has_its_size_and_grows_with_distance() {
    let spread = |effects: &str| {
        let fixes: Vec<f64> = marker(effects, 0.0, 60.0).iter().map(|m| m.2[2]).collect();
        let mean = fixes.iter().sum::<f64>() / fixes.len() as f64;
        (fixes.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / fixes.len() as f64).sqrt()
    };
    let sigma = spread(r#"{"camera_noise": {"z_m": 0.01}}"#);
    assert!((sigma / 0.01 - 1.0).abs() < 0.06, "{sigma}");
    let vertical: Vec<f64> = marker(r#"{"camera_outliers": {"probability": 0.1}}"#, 0.0, 60.0)
        .iter()
        .map(|m| ((m.2[0]).powi(2) + m.2[1].powi(2) + (m.2[2] - 0.7).powi(2)).sqrt())
        .collect();
    let hits = vertical.iter().filter(|d| **d > 0.05).count() as f64 / vertical.len() as f64;
    assert!(
        (hits - 0.1).abs() < 0.03 && vertical.iter().all(|d| *d < 0.01 || (d - 0.1).abs() < 0.01),
        "{hits}"
    );
}

#[test]
fn a_parameter_reaches_as_far_as_it_changes_something() {
    let reach = |effect: &str, name: &str, value: f64| {
        let entry = crazyflie_env::effects::find(effect).unwrap().1;
        entry.params.iter().find(|p| p.name == name).unwrap().reach(value)
    };
    // the missing part of a scale; a limit or a length itself
    let all = [
        (reach("thrust_scale", "scale", 0.9), 0.1),
        (reach("cmd_limit", "tilt_deg", 5.5), 5.5),
        (reach("frame_yaw", "angle_deg", -7.5), 7.5),
        (reach("gust", "tau_s", 0.9), 0.9),
        (reach("slung_load", "mass_ratio", 0.1), 0.1),
    ];
    assert!(all.iter().all(|(a, b)| (a - b).abs() < 1e-12), "{all:?}");
}

#[test]
fn every_parameter_says_what_it_is() {
    let units = [
        "N",
        "1",
        "s",
        "Hz",
        "deg",
        "deg/s",
        "1/s",
        "1/m",
        "m",
        "m/s^2",
        "kg",
        "ohm",
        "rad/(m s)",
        "deg/s/sqrt(s)",
        "m/s^2/rad",
        "m/s^2/rad^2",
        "1/s^2",
        "rad s/m",
    ];
    for entry in registry() {
        assert!(
            !entry.about.is_empty() && entry.source.len() > 5 && !entry.params.is_empty(),
            "{}",
            entry.name
        );
        for p in entry.params {
            assert!(
                p.low <= p.off && p.off <= p.high && p.low < p.high,
                "{}.{}: {} not in {}..{}",
                entry.name,
                p.name,
                p.off,
                p.low,
                p.high
            );
            assert!(units.contains(&p.unit), "{}.{} has the unit {:?}", entry.name, p.name, p.unit);
            assert!(!p.about.is_empty());
        }
    }
}

/// The exact kinematics of a turning rigid body whose rates obey 5.1 and 5.2, by Runge-Kutta: roll, pitch and
/// yaw under the commands of [`fly`]. The inertia is so many times the declared one.
fn exact_attitude(seconds: f64, inertia: f64) -> [f64; 3] {
    let (model, h) = (Model::thesis(), 0.0005);
    let of = |path: &str| model.parameter(path).unwrap();
    let tilt =
        ["roll", "pitch"].map(|axis| ["gain", "damping", "stiffness"].map(|n| of(&format!("{axis}.{n}"))));
    let mut x = [0.0; 5];
    for step in 0..(seconds / h) as usize {
        let t = 0.02 * ((step as f64 * h + 1e-9) / 0.02).floor();
        let (u, r) = ([0.10 * libm::sin(3.1 * t), 0.12 * libm::sin(2.3 * t)], -0.8 * libm::sin(0.9 * t));
        let slope = |[roll, pitch, _, p, q]: [f64; 5]| {
            let turned = q * roll.sin() + r * roll.cos();
            let torque = |i: usize, angle: f64, rate: f64| {
                (tilt[i][0] * u[i] - tilt[i][1] * rate - tilt[i][2] * angle) / inertia
            };
            [
                p + pitch.tan() * turned,
                q * roll.cos() - r * roll.sin(),
                turned / pitch.cos(),
                torque(0, roll, p),
                torque(1, pitch, q),
            ]
        };
        let moved = |k: [f64; 5], by: f64| std::array::from_fn(|i| x[i] + by * k[i]);
        let a = slope(x);
        let b = slope(moved(a, 0.5 * h));
        let c = slope(moved(b, 0.5 * h));
        let d = slope(moved(c, h));
        x = std::array::from_fn(|i| x[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
    }
    [x[0], x[1], x[2]]
}

/// Roll, pitch and yaw after a flight of [`fly`].
fn attitude(effects: &str, seconds: f64) -> Vec<f64> {
    fly::<f64>(&table(effects), Some(300), seconds).last().unwrap()[6..9].to_vec()
}

#[test]
fn euler_kinematics_are_those_of_a_rigid_body() {
    for seconds in [1.0, 2.5, 4.0] {
        let exact = exact_attitude(seconds, 1.0);
        let off = |effects: &str| {
            attitude(effects, seconds).iter().zip(exact).map(|(a, e)| (a - e).abs()).collect::<Vec<f64>>()
        };
        let (small, turned) = (off("{}"), off(r#"{"euler_kinematics": 1}"#));
        for axis in 0..3 {
            assert!(turned[axis] < 0.2 * small[axis] + 2e-4, "{seconds} s: {turned:?} against {small:?}");
        }
        let kept = attitude(r#"{"euler_kinematics": {"amount": 1, "heading_kept": 1}}"#, seconds);
        assert!((kept[2] - attitude("{}", seconds)[2]).abs() < 1e-12);
    }
}

#[test]
fn a_larger_inertia_turns_a_rigid_body_as_slowly_about_its_own_axes() {
    // torques that depend on the rates of the angles instead were 3 rad/s^2 off in a turn
    for seconds in [1.0, 2.5, 4.0] {
        let exact = exact_attitude(seconds, 1.6);
        let rigid = attitude(r#"{"inertia_scale": 1.6, "rigid_body": 1}"#, seconds);
        for axis in 0..2 {
            // the reference has neither gyroscopic torques nor a lag of the yaw rate; before, 0.01 were off
            let off_rad = (rigid[axis] - exact[axis]).abs();
            assert!(off_rad < 0.003, "{seconds} s, axis {axis}: {off_rad} rad");
        }
    }
}
