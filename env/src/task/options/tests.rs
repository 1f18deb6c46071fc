//! Options of a trial task, and those of every task.

use rand::SeedableRng;
use serde_json::json;

use super::*;
use crate::task::registry;

options! {
    drawn radius_m: f64 = 0.5, "m", [0.1, 2.0], "radius of a disc";
    drawn place_m: [f64; 3] = [0.0, 0.0, 1.0], "m", [[-2.0, 2.0], [-2.0, 2.0], [0.0, 2.0]], "a place";
    drawn gates: usize = 3, "1", [1.0, 8.0], "how many";
    fixed length_m: f64 = 1.0, "m", [0.0, 4.0], "a length";
}

fn read(given: Value) -> Result<Chosen<Options>> {
    Chosen::read("trial", &given)
}

fn drawn(given: Value) -> Vec<Options> {
    let chosen = read(given).unwrap();
    (0..500).map(|seed| chosen.draw(&mut Pcg64Mcg::seed_from_u64(seed))).collect()
}

#[test]
fn every_distribution_is_drawn_within_its_range() {
    let quantiles = |given: Value| {
        let mut radii: Vec<f64> = drawn(json!({ "radius_m": given })).iter().map(|o| o.radius_m).collect();
        radii.sort_by(f64::total_cmp);
        [0, 250, 499].map(|i| radii[i])
    };
    let near = |found: f64, want: f64| assert!((found - want).abs() < 0.1, "{found} is not {want}");
    let [low, middle, high] = quantiles(json!({"uniform": [0.5, 1.5]}));
    near(low, 0.5);
    near(middle, 1.0);
    near(high, 1.5);
    let [low, middle, high] = quantiles(json!({"log_uniform": [0.1, 1.6]}));
    near(low, 0.1);
    near(middle, 0.4);
    near(high, 1.6);
    // cut off at the range, below, and at four deviations, above
    let [low, middle, high] = quantiles(json!({"normal": [0.5, 0.3]}));
    assert!(low == 0.1 && high < 0.5 + 4.0 * 0.3, "{low} {high}");
    near(middle, 0.5);
    let [low, _, high] = quantiles(json!({"choice": [0.2, 0.4]}));
    assert_eq!([low, high], [0.2, 0.4]);
}

#[test]
fn the_coordinates_of_a_chosen_point_stay_together() {
    let points = [[1.0, 1.0, 1.0], [-1.0, 0.0, 0.5]];
    let all = drawn(json!({"place_m": {"choice": points}}));
    assert!(all.iter().all(|o| points.contains(&o.place_m)));
    assert!(points.iter().all(|point| all.iter().any(|o| o.place_m == *point)));
    let apart = drawn(json!({"place_m": [{"uniform": [-1, 1]}, 0.5, {"choice": [0, 2]}]}));
    assert!(apart.iter().all(|o| o.place_m[1] == 0.5 && [0.0, 2.0].contains(&o.place_m[2])));
    assert!(apart.iter().any(|o| o.place_m[0] < -0.8) && apart.iter().any(|o| o.place_m[0] > 0.8));
    let counts = drawn(json!({"gates": {"choice": [2, 5]}}));
    assert!(counts.iter().all(|o| o.gates == 2 || o.gates == 5));
}

#[test]
fn what_is_not_drawn_takes_nothing_from_the_noise() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    read(json!({"radius_m": 1.0})).unwrap().draw(&mut rng);
    assert_eq!(rng, Pcg64Mcg::seed_from_u64(3));
}

#[test]
fn corners_are_all_ends_together() {
    let chosen = read(json!({"radius_m": {"uniform": [0.5, 1.5]}, "gates": {"choice": [2, 5, 3]}})).unwrap();
    let corners: Vec<(f64, usize)> = chosen.corners().map(|o| (o.radius_m, o.gates)).collect();
    assert_eq!(corners, [(0.5, 2), (1.5, 2), (0.5, 5), (1.5, 5)]);
}

#[test]
fn mistakes_are_named() {
    for (given, words) in [
        (json!({"radus_m": 1}), vec!["unknown option", "trial.radus_m", "did you mean \"trial.radius_m\""]),
        (json!({"radius_m": 3}), vec!["radius_m is 3", "0.1 to 2 m"]),
        (json!({"radius_m": "wide"}), vec!["task trial", "radius_m is \"wide\"", "expected a number"]),
        (json!({"radius_m": {"uniform": [1, 3]}}), vec!["radius_m is 3", "0.1 to 2 m"]),
        (json!({"radius_m": {"uniform": [1]}}), vec!["radius_m is {\"uniform\":[1]}", "distribution"]),
        (json!({"radius_m": {"value": 1, "unit": "cm"}}), vec!["radius_m has the unit \"cm\"", "\"m\""]),
        (json!({"length_m": {"uniform": [1, 2]}}), vec!["length_m is", "it is not drawn"]),
        (json!({"place_m": [1, 2]}), vec!["place_m is [1,2]", "three numbers"]),
        (json!({"place_m": [1, 2, 3]}), vec!["place_m[2] is 3", "0 to 2 m"]),
        (json!({"place_m": {"choice": []}}), vec!["place_m[0]", "at least one"]),
        (json!({"gates": 2.5}), vec!["gates is 2.5", "a whole number"]),
        (json!({"gates": {"uniform": [1, 2]}}), vec!["gates is", "a whole number"]),
        (json!([1]), vec!["task_options is [1]", "object"]),
    ] {
        let error = read(given.clone()).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{given} gave: {error}");
    }
}

#[test]
fn every_option_of_every_task_is_whole() {
    let units = [("_mps", "m/s"), ("_kg", "kg"), ("_deg", "deg"), ("_rad", "rad"), ("_m", "m"), ("_s", "s")];
    for task in registry() {
        let options = task.options();
        assert!(options.len() <= MOST, "{}", task.name);
        for option in options {
            let name = format!("{}.{}", task.name, option.name);
            assert!(!option.about.is_empty() && !option.about.ends_with('.'), "{name}");
            let unit = units.iter().find(|(suffix, _)| option.name.ends_with(suffix));
            let bare = ["", "1"].contains(&option.unit);
            assert!(unit.map_or(bare, |(_, unit)| *unit == option.unit), "{name} in {:?}", option.unit);
            for ((value, low), high) in option.default.iter().zip(option.low()).zip(option.high()) {
                assert!(low < high && (value.is_nan() || (low..=high).contains(value)), "{name}");
            }
        }
    }
}
