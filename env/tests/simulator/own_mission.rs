//! A mission of one's own, and the fields of a drone among others.

use crate::flight::Flight;
use crazyflie_env::config::Options;
use crazyflie_env::expression::expression_fields;
use crazyflie_env::model::Model;
use crazyflie_env::observation::SETPOINT;
use crazyflie_env::vector::{METRICS, STATE, VectorEnv};

/// Numbers that are kept of the last step, a row for each drone.
fn watched(flight: &Flight) -> Vec<Vec<f32>> {
    let width = flight.env.watched_width();
    let mut rows = vec![0.0; flight.rewards.len() * width];
    flight.env.watched(&mut rows).unwrap();
    rows.chunks_exact(width).map(<[f32]>::to_vec).collect()
}

fn places(flight: &Flight) -> Vec<[f64; 3]> {
    let mut states = vec![0.0; flight.rewards.len() * STATE];
    flight.env.states(&mut states).unwrap();
    states.chunks_exact(STATE).map(|row| [0, 1, 2].map(|i| f64::from(row[i]))).collect()
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn fields_among_others_are_what_the_places_say() {
    let options = r#""task": "carry", "drones": 4, "task_options": {"load_kg": 0.005}, "autoreset": "disabled", "radius_m": 0.16,
        "watch": ["nearest_m", "min_separation_m", "others_mean_m", "load_pos_m"], "cost": "min(nearest_m, 7) - load_pos_m[2]",
        "reward": "nearest_m + 2*min_separation_m - norm(others_mean_m) if time_s > 0.1 else load_pos_m[2]""#;
    let mut flight = Flight::new(20, options);
    let (mut least_m, mut gone, separation) =
        (vec![10.0_f64; 20], 0, METRICS.iter().position(|metric| metric.0 == "min_separation_m").unwrap());
    while flight.step < 120 && flight.flying.iter().filter(|flies| **flies).count() > 20 {
        let flew = flight.flying.clone();
        if (0..20).any(|world| !flew[4 * world..4 * world + 4].contains(&true)) {
            break;
        }
        flight.step();
        let (rows, places) = (watched(&flight), places(&flight));
        for (row, numbers) in rows.iter().enumerate().filter(|(row, _)| flew[*row]) {
            let world = row / 4;
            let others: Vec<usize> = (4 * world..4 * world + 4).filter(|j| *j != row && flew[*j]).collect();
            let nearest_m = others.iter().map(|j| distance(&places[row], &places[*j])).fold(10.0, f64::min);
            least_m[world] = least_m[world].min(nearest_m);
            let mean_m: [f64; 3] = std::array::from_fn(|i| {
                let sum: f64 = others.iter().map(|j| places[*j][i]).sum();
                if others.is_empty() { places[row][i] } else { sum / others.len() as f64 }
            });
            let want = [nearest_m, mean_m[0], mean_m[1], mean_m[2]];
            for (got, want) in [0, 2, 3, 4].map(|i| f64::from(numbers[i])).into_iter().zip(want) {
                assert!((got - want).abs() < 1e-5, "step {} row {row}: {numbers:?} {want}", flight.step);
            }
            gone += 3 - others.len();
            let length_m = distance(&mean_m, &[0.0; 3]) as f32;
            let early = flight.step <= 5;
            let reward = if early { numbers[7] } else { numbers[0] + 2.0 * numbers[1] - length_m };
            assert!((flight.rewards[row] - reward).abs() < 1e-5, "{} {reward}", flight.rewards[row]);
            assert!((numbers[8] - (numbers[0].min(7.0) - numbers[7])).abs() < 1e-6);
            let load_m = [5, 6, 7].map(|i| f64::from(numbers[i]));
            assert!(distance(&load_m, &places[row]) < 0.65 || others.len() < 3, "{load_m:?}");
        }
        for row in (0..80).filter(|row| flew[*row]) {
            let (world, got) = (row / 4, rows[row][1]);
            assert!((f64::from(got) - least_m[world]).abs() < 1e-5, "{got} {}", least_m[world]);
            assert_eq!(got, flight.metrics[world * METRICS.len() + separation]);
        }
    }
    assert!(flight.step > 20 && gone > 0, "{} {gone}", flight.step);
}

#[test]
fn fields_that_a_world_lacks_are_refused() {
    for (task, field, words) in [
        ("hover", "nearest_m", "needs other drones, and one flies in this task hover"),
        ("hover", "load_pos_m", "needs a load, and none hangs in this task hover"),
        ("swap", "load_pos_m", "needs a load"),
        ("own", "load_pos_m", "needs a load"),
    ] {
        let number = expression_fields()
            .find(|f| f.name == field)
            .map_or("", |f| ["", "[0]"][usize::from(f.length > 1)]);
        for text in [
            format!("\"reward\": \"{field}{number}\""),
            format!("\"termination\": \"{field}{number} > 1\""),
            format!("\"cost\": \"{field}{number}\""),
            format!("\"watch\": [\"{field}\"]"),
        ] {
            let options = Options::parse(&format!("{{\"task\": \"{task}\", {text}}}")).unwrap();
            let error = VectorEnv::new(&[Model::thesis()], &options, 1).err().unwrap().to_string();
            assert!(error.contains(words), "{text} gave: {error}");
        }
    }
    let alone = Options::parse(r#"{"task": "swap", "drones": 1, "reward": "nearest_m"}"#).unwrap();
    assert!(VectorEnv::new(&[Model::thesis()], &alone, 1).is_err());
}

/// Set-point of a row.
fn setpoint(flight: &Flight, row: usize) -> Vec<f32> {
    flight.row(row)[SETPOINT.range()].to_vec()
}

#[test]
fn gates_are_those_of_the_race() {
    let seen = r#""observation": ["setpoint", "gate_pos_m", "pos_m"]"#;
    let mut race = Flight::new(20, &format!(r#""task": "race", "task_options": {{"level": 2}}, {seen}"#));
    let mut own = Flight::new(
        20,
        &format!(
            r#""task": "own", "drones": 1, "task_options": {{"roles": [{{"race": {{"level": 2}}}}]}}, {seen}"#
        ),
    );
    for step in 0..120 {
        race.step();
        own.step();
        for (a, b) in race.observations.iter().zip(&own.observations) {
            assert!((a - b).abs() < 1e-4, "step {step}: {a} {b}");
        }
        for (a, b) in race.rewards.iter().zip(&own.rewards) {
            assert!((a - b).abs() < 1e-3, "step {step}: {a} {b}");
        }
    }
}

#[test]
fn a_drone_stays_beside_where_another_truly_is() {
    let roles = r#"[{"beside": 1, "offset_m": [0, 0.5, 0.25]}, {"track": {"shape": "circle"}},
        {"beside": 0, "offset_m": [0, 0.5, 0], "start_m": [{"uniform": [-1, 0]}, 2, 1]}]"#;
    let mut flight = Flight::new(20, &format!(r#""task": "own", "task_options": {{"roles": {roles}}}"#));
    let first = places(&flight);
    assert!(
        first.iter().skip(2).step_by(3).all(|[x, y, z]| (-1.0..0.0).contains(x) && (*y, *z) == (2.0, 1.0))
    );
    assert!(first[2][0] != first[5][0], "drawn anew in each world");
    assert!(distance(&first[0], &[0.5, 0.5, f64::from(0.95_f32)]) < 1e-6, "{:?}", first[0]);
    for _ in 0..60 {
        flight.step();
        let places = places(&flight);
        for world in
            (0..20).filter(|world| flight.flying[3 * world..3 * world + 3].iter().all(|flies| *flies))
        {
            for (own, leader, offset_m) in [(0, 1, [0.0, 0.5, 0.25]), (2, 0, [0.0, 0.5, 0.0])] {
                let want: [f64; 3] = std::array::from_fn(|i| places[3 * world + leader][i] + offset_m[i]);
                let got = setpoint(&flight, 3 * world + own);
                assert!(distance(&want, &[0, 1, 2].map(|i| f64::from(got[i]))) < 1e-5, "{want:?} {got:?}");
            }
        }
    }
}

#[test]
fn a_load_moves_as_in_carry() {
    let watch = r#""watch": ["load_pos_m"]"#;
    let still = r#""task_options": {"size_m": 0}"#;
    let mut carry = Flight::new(1, &format!(r#""task": "carry", {still}, {watch}"#));
    let start: Vec<String> = places(&carry)
        .iter()
        .map(|place| format!(r#"{{"track": {{"points": [[0, 0, 0, 1]]}}, "start_m": {place:?}}}"#))
        .collect();
    let options = format!(r#""task_options": {{"roles": [{}], "load_kg": 0.01}}"#, start.join(", "));
    let mut own = Flight::new(1, &format!(r#""task": "own", {options}, {watch}"#));
    let mut lowest_m = 1.0_f32;
    // until a collision or a crash, after which carry draws another start
    while carry.step < 60 && !carry.flying.contains(&false) {
        carry.step();
        own.step();
        for (a, b) in watched(&carry).iter().zip(&watched(&own)) {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4), "{a:?} {b:?}");
            lowest_m = lowest_m.min(a[2]);
        }
    }
    assert!(lowest_m < 0.2, "{lowest_m}");
}
