//! What counts as found.

use crazyflie_env::effects::find;
use crazyflie_env::model::Model;

use super::*;
use crate::explain::noise::FLOOR;

fn filtered_hypothesis(effect: &str, strength: f64) -> FilteredHypothesis {
    let hypothesis = Hypothesis::from_model(&Model::thesis()).with(Term::off(find(effect).unwrap().1));
    let mut mean = hypothesis.free_values();
    mean[0] = strength;
    let posterior = ParameterPrior::independent(mean.clone(), &vec![0.01; mean.len()]);
    FilteredHypothesis { hypothesis, posterior, disturbances: FLOOR, loss: 0.0, losses: Vec::new() }
}

#[test]
fn a_strength_at_its_bound_is_no_cause_but_the_whole_geometry_is() {
    assert!(filtered_hypothesis("camera_scale", 2.3).is_at_bound("camera_scale"));
    assert!(!filtered_hypothesis("camera_scale", 0.9).is_at_bound("camera_scale"));
    // "off" lies at the lower bound of a drag
    assert!(!filtered_hypothesis("drag_linear", 0.0).is_at_bound("drag_linear"));
    assert!(!filtered_hypothesis("rigid_body", 1.0).is_at_bound("rigid_body"));
}

#[test]
fn a_clear_burst_of_no_losses_is_no_evidence() {
    let mut judged = filtered_hypothesis("packet_loss", 0.03);
    judged.hypothesis.terms[0].free = vec![0, 1];
    // probability and burst as rotorpy's flight d0001 of seed 2020 had them
    judged.posterior = ParameterPrior::independent(vec![0.03, 0.82], &[0.039, 0.089]);
    assert!((judged.clearance("packet_loss") - 0.03 / 0.039).abs() < 1e-12);
}

#[test]
fn a_start_below_the_floor_is_not_believed() {
    let measured = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];
    assert!(is_near(&[0.01, 0.0, 0.11, 0.1, 0.0, 0.2], &measured));
    assert!(!is_near(&[0.0, 0.0, -0.17, 0.0, 0.0, 0.2], &measured));
    assert!(!is_near(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.9], &measured));
}
