//! Several drones in one world: what they feel of each other, what they know, how they end.

use crate::fleet::{Fleet, fleet_options};
use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController};
use crazyflie_env::Error;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::coupling::load::{self, Load, Ropes};
use crazyflie_env::effects::Neighbour;
use crazyflie_env::isa::Level;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::plant::{Accelerations, Command, State};
use crazyflie_env::task;
use crazyflie_env::vector::{METRICS, VectorEnv};
use crazyflie_env::world::{Around, Settings, Tick, World};

/// The thesis PID for every drone.
fn crowd(fleet: &Fleet, avoid: Option<CollisionAvoidance>) -> MultiController {
    let (env, model) = (&fleet.env, Model::thesis());
    let one = |j: usize| {
        let site = ControllerContext {
            model: &model,
            interface: env.interfaces()[j],
            tick_s: env.tick_s(),
            envs: env.num_envs(),
            mode: Mode::Automatic,
        };
        ControllerSpec::named("thesis-pid").unwrap().build(&site).unwrap()
    };
    MultiController::new((0..env.num_drones()).map(one).collect(), env.num_envs(), avoid, env.tick_s())
        .unwrap()
}

/// The metrics of every world's first episode.
fn fly(fleet: &mut Fleet, avoid: Option<CollisionAvoidance>) -> Vec<Vec<f32>> {
    let (worlds, n) = (fleet.env.num_envs(), fleet.env.num_drones());
    let mut crowd = crowd(fleet, avoid);
    let (mut actions, mut first) = (fleet.level(), vec![Vec::new(); worlds]);
    while first.iter().any(Vec::is_empty) {
        crowd.act(&fleet.observations, &mut actions).unwrap();
        fleet.step(&actions).unwrap();
        for world in (0..worlds).filter(|w| !fleet.flying[w * n..(w + 1) * n].contains(&true)) {
            if first[world].is_empty() {
                first[world] = fleet.metrics[world * METRICS.len()..(world + 1) * METRICS.len()].to_vec();
            }
            crowd.reset(&|w| w == world);
        }
    }
    first
}

fn sum(metrics: &[Vec<f32>], name: &str) -> f32 {
    let column = METRICS.iter().position(|m| m.0 == name).unwrap();
    metrics.iter().map(|m| m[column]).sum()
}

/// Newtons that a Crazyflie loses at `below` another and `beside` it.
fn lost_n(below: f64, beside: f64) -> f64 {
    let model = Model::thesis();
    let effects = Options::parse(r#"{"effects": {"downwash": 0.118}}"#).unwrap().effects;
    let settings = Settings { input: VerticalInput::Thrust, physics_hz: Some(300) };
    let world = || World::<f64>::new(&model, &effects, settings, 1).unwrap().without_floor();
    let u = Command::level(39_342.5);
    let neighbour = |x, z, here| Neighbour { pos_m: [x, 0.0, z], vel_mps: [0.0; 3], here };
    let mut climbs = [0.0; 2];
    for (climb, here) in climbs.iter_mut().zip([1.0, 0.0]) {
        let mut world = world();
        world.start(0, true, &State::rest(), &u);
        let both = [neighbour(0.0, 0.0, 1.0), neighbour(beside, below, here)];
        let around = Around { neighbours: &both, own: 0, push: Accelerations::none() };
        let mut tick = Tick::none();
        world.step_group(0, &[u], Some(&[around, around]), std::slice::from_mut(&mut tick));
        *climb = world.state(0).vel_mps[2] / world.tick_s();
    }
    (climbs[1] - climbs[0]) * model.vehicle.mass.value
}

#[test]
fn downwash_is_as_strong_as_was_measured() {
    const GRAM: f64 = 9.81e-3;
    let grams = |below, beside| lost_n(below, beside) / GRAM;
    println!(
        "lost lift in grams: 25 cm below {:.2}, 30 cm {:.2}, 15 cm beside {:.2}",
        grams(0.25, 0.0),
        grams(0.30, 0.0),
        grams(0.25, 0.15)
    );
    assert!((grams(0.25, 0.0) - 12.0).abs() < 0.3, "{}", grams(0.25, 0.0));
    assert!((grams(0.30, 0.0) - 9.0).abs() < 0.3, "{}", grams(0.30, 0.0));
    assert!(grams(0.25, 0.15) < 0.05 * 12.0);
    assert!(grams(-0.25, 0.0).abs() < 1e-9, "who is above feels nothing");
    assert!(grams(0.02, 0.0) < grams(0.16, 0.0), "the jet is not formed at once");
    assert!(grams(1.0, 0.0) > 0.5 && grams(2.0, 0.0) < 0.5);
}

#[test]
fn a_load_hangs_with_its_weight_on_the_ropes() {
    let load = Load { mass_kg: 0.01, rope_m: 0.6 };
    let places = [[0.3, 0.0, 1.0], [-0.15, 0.26, 1.0], [-0.15, -0.26, 1.0]];
    let drones = places.map(|pos_m| Neighbour { pos_m, vel_mps: [0.0; 3], here: 1.0 });
    let mut state = load::State { pos_m: load.hangs(places.into_iter()), vel_mps: [0.0; 3] };
    let (mut moving, mut pulls) = (drones, [[0.0; 3]; 3]);
    let kg = [0.027; 3];
    // drones that hold still: what they would do without a rope is what undoes its pull
    let mut free = [[0.0; 3]; 3];
    for _ in 0..500 {
        load.step(
            &mut state,
            &drones,
            &free,
            Ropes { moving: &mut moving, pulls_mps2: &mut pulls, drone_kg: &kg },
            [0.02, 9.81],
        );
        free = pulls.map(|pull| pull.map(|p: f64| -p));
    }
    let weight: f64 = pulls.iter().map(|pull| -0.027 * pull[2]).sum();
    println!("weight on the ropes {weight:.5} N of {:.5}", 0.01 * 9.81);
    assert!((weight - 0.0981).abs() < 1e-4, "{weight}");
    assert!(state.pos_m[0].abs() < 1e-3 && state.vel_mps[2].abs() < 1e-4);
    assert!(pulls[0][0] < 0.0, "ropes pull inwards");
}

/// Every number of a lively flight, for worlds `first..first + worlds`.
fn rows(options: &str, worlds: usize, first: u64) -> Vec<Vec<u32>> {
    let mut fleet = Fleet::new(worlds, options);
    fleet.reset(first);
    let (n, width) = (fleet.env.num_drones(), fleet.env.width());
    let mut crowd = crowd(&fleet, None);
    let mut actions = fleet.level();
    let mut out = vec![Vec::new(); worlds];
    for _ in 0..120 {
        crowd.act(&fleet.observations, &mut actions).unwrap();
        fleet.step(&actions).unwrap();
        for (world, row) in out.iter_mut().enumerate() {
            let all = |values: &[f32], per: usize| {
                values[world * per..(world + 1) * per].iter().map(|v| v.to_bits()).collect::<Vec<_>>()
            };
            row.extend(all(&fleet.observations, n * width));
            row.extend(all(&fleet.rewards, n));
            row.extend(all(&fleet.metrics, METRICS.len()));
            row.extend(fleet.flying[world * n..(world + 1) * n].iter().map(|f| u32::from(*f)));
        }
    }
    out
}

const LIVELY: &str = r#""drones": 5, "max_episode_steps": 70, "neighbours": {"by": "radio", "delay_s": 0.06, "loss": 0.2},
    "effects": {"camera_noise": {"xy_m": 0.01}, "drag_linear": 0.3, "cmd_delay": 0.03, "gust": {"sigma_mps2": 0.3}}"#;

#[test]
fn the_same_bits_for_any_batch_thread_and_instruction_set() {
    for entry in task::registry().iter().filter(|entry| entry.drones > 1) {
        let options = |more: &str| format!("{{\"task\": \"{}\", {LIVELY}{more}}}", entry.name);
        let reference = rows(&options(""), 20, 0);
        for level in Level::available() {
            let other = rows(&options(&format!(", \"isa\": \"{}\"", level.name())), 20, 0);
            assert!(reference == other, "{} differs on {}", entry.name, level.name());
        }
        assert!(reference[7..10] == rows(&options(""), 3, 7), "{} differs with the batch", entry.name);
        assert!(
            reference[..] == rows(&options(", \"threads\": 2"), 35, 0)[..20],
            "{} differs with threads",
            entry.name
        );
    }
}

#[test]
fn eight_swap_without_a_collision_if_they_avoid_each_other() {
    let seeds = 100;
    let run = |avoid| {
        let mut fleet = Fleet::new(seeds, r#"{"task": "swap", "drones": 8, "max_episode_steps": 1000}"#);
        fleet.reset(1000);
        let metrics = fly(&mut fleet, avoid);
        let mut settled: Vec<f32> = metrics.iter().map(|m| m[3]).collect();
        settled.sort_by(f32::total_cmp);
        let least = metrics.iter().map(|m| m[2]).fold(f32::MAX, f32::min);
        (
            sum(&metrics, "collisions"),
            sum(&metrics, "crashes"),
            sum(&metrics, "done"),
            least,
            settled[seeds / 2],
        )
    };
    let (with, without) = (run(Some(CollisionAvoidance::default())), run(None));
    println!("swap of 8, {seeds} seeds: collided, crashed, arrived, least separation (m), median time (s)");
    println!("with avoidance {with:?}\nwithout        {without:?}");
    assert_eq!((with.0, with.1, with.2), (0.0, 0.0, 800.0));
    assert!(without.0 > 400.0, "without it they should collide");
}

#[test]
fn every_task_can_be_flown_by_the_thesis_pid() {
    for entry in task::registry().iter().filter(|entry| entry.drones > 1) {
        let options =
            format!("{{\"task\": \"{}\", \"max_episode_steps\": {}}}", entry.name, entry.max_episode_steps);
        let mut fleet = Fleet::new(32, &options);
        fleet.reset(0);
        let metrics = fly(&mut fleet, Some(CollisionAvoidance::default()));
        let mean = |name: &str| sum(&metrics, name) / 32.0;
        let figures: Vec<String> = METRICS.iter().map(|m| format!("{} {:.3}", m.0, mean(m.0))).collect();
        println!("{:13} {}", entry.name, figures.join(", "));
        assert!(
            mean("collisions") == 0.0 && mean("crashes") == 0.0,
            "{}: {}",
            entry.name,
            figures.join(", ")
        );
        let all = mean("done") == entry.drones as f32;
        let ends = ["swap", "cover", "land_in_turn"].contains(&entry.name);
        assert!(all || !ends && mean("rms_error_m") < 0.7, "{}: {}", entry.name, figures.join(", "));
    }
}

#[test]
fn who_collides_is_gone_and_the_others_fly_on() {
    let options = r#"{"task": "formation", "drones": 3, "task_options": {"roam_m": 0}, "radius_m": 0.1, "autoreset": "disabled", "max_episode_steps": 300}"#;
    let mut fleet = Fleet::new(2, options);
    fleet.reset(0);
    let width = fleet.env.width();
    let mut crowd = crowd(&fleet, None);
    let mut actions = fleet.level();
    let mut when = None;
    for tick in 0..300 {
        crowd.act(&fleet.observations, &mut actions).unwrap();
        // in world 0 the first drone flies at the second
        let at = OBSERVATION;
        if fleet.flying[0] {
            let (x, y) = (fleet.observations[at], fleet.observations[at + 1]);
            (actions[0], actions[1]) = ((-y).clamp(-1.0, 1.0), x.clamp(-1.0, 1.0));
        }
        fleet.step(&actions).unwrap();
        if fleet.terminated[0] {
            assert!(fleet.terminated[1] && !fleet.terminated[2] && !fleet.terminated[3..].contains(&true));
            assert!(fleet.rewards[0] < -8.0 && fleet.rewards[1] < -8.0);
            assert!(fleet.observations[..width].iter().any(|v| *v != 0.0), "its last observation is its own");
            when = Some(tick);
        } else if when.is_some() {
            assert!(
                fleet.observations[..2 * width].iter().all(|v| *v == 0.0) && fleet.rewards[..2] == [0.0, 0.0]
            );
            // the third sees them no more
            assert_eq!(fleet.observations[2 * width + OBSERVATION + 7], 0.0);
            if tick < 299 {
                assert_eq!(fleet.flying, [false, false, true, true, true, true]);
            }
        }
    }
    let tick = when.expect("they meet");
    println!("met after {:.2} s", 0.02 * tick as f64);
    assert_eq!(fleet.truncated, [false, false, true, true, true, true]);
    assert_eq!((fleet.metric(0, "collisions"), fleet.metric(1, "collisions")), (2.0, 0.0));
    assert_eq!(fleet.step(&actions), Err(Error::Ended { env: 0 }));
}

#[test]
fn radio_is_late_and_lossy_and_range_is_short() {
    let ages = |neighbours: &str| {
        let mut fleet = Fleet::new(4, &format!("{{\"drones\": 3, \"neighbours\": {neighbours}}}"));
        fleet.reset(3);
        let actions = fleet.level();
        let width = fleet.env.width();
        let (mut age, mut valid, mut count) = (0.0, 0.0, 0.0);
        for tick in 0..100 {
            fleet.step(&actions).unwrap();
            for row in fleet.observations.chunks(width).filter(|_| tick > 20) {
                for other in row[OBSERVATION..].chunks(NEIGHBOUR) {
                    (age, valid, count) =
                        (age + f64::from(other[6]), valid + f64::from(other[7]), count + 1.0);
                }
            }
        }
        (age / count, valid / count)
    };
    assert_eq!(ages(r#"{"by": "ideal"}"#), (0.0, 1.0));
    assert_eq!(ages(r#"{"by": "range", "range_m": 0.1}"#), (0.0, 0.0));
    let late = ages(r#"{"by": "radio", "delay_s": 0.1}"#);
    assert!((late.0 - 0.1).abs() < 1e-5 && late.1 == 1.0, "{late:?}");
    // every second message is lost: a message is on average one tick older
    let lossy = ages(r#"{"by": "radio", "delay_s": 0.1, "loss": 0.5}"#);
    assert!((lossy.0 - 0.12).abs() < 0.003, "{lossy:?}");
}

#[test]
fn drones_may_differ() {
    let options = r#"{"task": "formation", "drones": 2, "each": [{}, {"effects": {"mass_change": 0.01}}], "vertical": "pwm", "effects": {"downwash": 0}}"#;
    let mut fleet = Fleet::new(1, options);
    fleet.reset(0);
    let interface = fleet.env.interfaces()[0];
    let hover = (2.0 * interface.hover_lift / interface.lift_max - 1.0) as f32;
    for _ in 0..20 {
        fleet.step(&[0.0, 0.0, 0.0, hover, 0.0, 0.0, 0.0, hover]).unwrap();
    }
    let mut states = vec![0.0; 24];
    fleet.env.states(&mut states).unwrap();
    assert!(states[14] < states[2] - 0.05, "who carries 10 g more sinks: {} and {}", states[14], states[2]);
}

#[test]
fn mistakes_are_named() {
    let made = |options: &str| {
        let options = fleet_options(options)?;
        VectorEnv::new(&[Model::thesis()], &options, 1).map(|_| ())
    };
    for (options, words) in [
        (r#"{"task": "swop"}"#, vec!["task", "swop", "did you mean \"swap\""]),
        (r#"{"task": "hover", "drones": 2}"#, vec!["drones is 2", "hover is for one drone"]),
        (r#"{"drones": 65}"#, vec!["drones is 65", "1 to 64"]),
        (r#"{"drones": 3, "each": [{}]}"#, vec!["each is 1", "0 or 3"]),
        (r#"{"each": [{"effects": {"drag": 1}}]}"#, vec!["drag"]),
        (r#"{"neighbours": {"by": "radio", "delay_s": 9}}"#, vec!["neighbours.delay_s is 9"]),
        (r#"{"neighbours": {"by": "smell"}}"#, vec!["smell", "ideal"]),
        (r#"{"task": "swap", "task_options": {"radius": 1}}"#, vec!["swap", "radius"]),
        (
            r#"{"task": "swap", "drones": 64, "task_options": {"radius_m": 0.5}}"#,
            vec!["radius_m is 0.5", "64 drones"],
        ),
        (r#"{"radius_m": -1}"#, vec!["radius_m is -1"]),
    ] {
        let error = made(options).unwrap_err().to_string();
        assert!(words.iter().all(|w| error.contains(w)), "{options} gave: {error}");
    }
    let mut fleet = Fleet::new(2, r#"{"drones": 3}"#);
    let mut actions = fleet.level();
    assert_eq!(fleet.step(&actions), Err(Error::NotReset));
    fleet.reset(0);
    actions[(3 + 1) * ACTION + 2] = f32::NAN;
    let error = fleet.step(&actions).unwrap_err();
    assert!(matches!(error, Error::DroneAction { world: 1, drone: 1, axis: 2, .. }), "{error}");
    assert!(matches!(fleet.step(&actions[1..]), Err(Error::Shape { .. })));
}
