//! `crazyflie report recorded` on a few of the recorded flights.

use crate::common::{json, recordings};

/// Two flights are fitted, one is predicted: the 2 s velocity error falls at least seven times.
#[test]
fn the_velocity_error_falls_seven_times() {
    let Some(folder) = recordings("the_velocity_error_falls_seven_times", "nanobench") else { return };
    let data = folder.parent().unwrap().display().to_string();
    let story = json(&["report", "recorded", &data, "--quick", "--json"]);
    assert_eq!(story["test"].as_array().unwrap().len(), 1, "{story}");
    for model in ["reidentified", "explained"] {
        let factor = story["velocity_2s_factor"][model].as_f64().unwrap();
        assert!(factor > 7.0, "{model}: {factor}");
    }
    let force = |of: &str| story["specific_force_mps2"][of].as_f64().unwrap();
    assert!(force("explained") < 0.75 * force("thesis"), "{story}");
    // flown by the controller of the recordings along their set-points
    let distance = |of: &str| story["closed_loop"]["firmware"][of]["predicted_m"].as_f64().unwrap();
    let (before, after) = (distance("thesis"), distance("explained"));
    println!(
        "closed loop: {before:.3} m from the measured flight on the thesis model, {after:.3} m explained"
    );
    assert!(after < 0.5 * before, "{before} {after}");
    if recordings("the_velocity_error_falls_seven_times", "crazypad").is_some() {
        let verdict = |i: usize| story["planted"][i]["diagnosis"]["verdict"].as_str().unwrap();
        assert_eq!(
            [verdict(0), verdict(1), verdict(2)],
            ["added_weight", "weak_motor", "nothing"],
            "{}",
            story["planted"]
        );
    }
}
