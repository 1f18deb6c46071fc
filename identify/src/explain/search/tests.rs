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

#[test]
fn a_rival_takes_the_place_and_what_stands_beside_it_stays() {
    // with rotorpy's flight d0022 of seed 8484, what had settled without the effect put its rival far behind
    let with = |hypothesis: Hypothesis, effect: &str| hypothesis.with(Term::off(find(effect).unwrap().1));
    let declared = Hypothesis::from_model(&Model::thesis());
    let hypothesis = with(with(declared.clone(), "wind"), "drag_linear");
    let values = |hypothesis: &Hypothesis, effect: &str, first: f64| {
        let mut values = hypothesis.free_values();
        values[hypothesis.place(effect).start] = first;
        hypothesis.with_values(&values)
    };
    let settled = values(&values(&hypothesis, "wind", 0.7), "drag_linear", 0.4);
    let mean = settled.free_values();
    let sd: Vec<f64> = (1..=mean.len()).map(|i| 0.01 * i as f64).collect();
    let posterior = ParameterPrior::independent(mean, &sd);
    let judged =
        FilteredHypothesis { hypothesis, posterior, disturbances: FLOOR, loss: 0.0, losses: Vec::new() };
    let rival = values(&with(with(declared, "wind"), "drag_quadratic"), "drag_quadratic", 0.3);
    let proposal = Proposal { sd: vec![0.5; rival.free_values().len()], hypothesis: rival };

    let placed = proposal.in_place(&judged, "drag_linear").unwrap();
    assert!(!placed.hypothesis.has("drag_linear"));
    let value = |effect: &str| placed.hypothesis.free_values()[placed.hypothesis.place(effect).start];
    assert_eq!((value("wind"), value("drag_quadratic")), (0.7, 0.3));
    let deviation = |effect: &str| placed.sd[placed.hypothesis.place(effect).start];
    let wind_at = judged.hypothesis.place("wind").start;
    assert!((deviation("wind") - judged.posterior.sd(wind_at)).abs() < 1e-12);
    assert_eq!(deviation("drag_quadratic"), 0.5);
    assert_eq!(placed.sd.len(), placed.hypothesis.free_values().len());
}
