//! `crazyflie measured` on a few of the recorded flights.

mod common;

use common::{json, shared};

/// Two flights are fitted, one is predicted: the 2 s velocity error falls at least seven times.
#[test]
fn the_velocity_error_falls_seven_times() {
    let Some(folder) = shared("the_velocity_error_falls_seven_times", "nanobench") else { return };
    let data = folder.parent().unwrap().display().to_string();
    let story = json(&["measured", &data, "--quick", "--json"]);
    assert_eq!(story["test"].as_array().unwrap().len(), 1, "{story}");
    for model in ["reidentified", "explained"] {
        let factor = story["velocity_2s_factor"][model].as_f64().unwrap();
        assert!(factor > 7.0, "{model}: {factor}");
    }
    let force = |of: &str| story["specific_force_mps2"][of].as_f64().unwrap();
    assert!(force("explained") < 0.75 * force("thesis"), "{story}");
}
