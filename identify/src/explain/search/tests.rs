//! Tests of the criteria for a finding.

use std::f64::consts::TAU;

use crazyflie_env::effects::find;
use crazyflie_env::model::Model;

use super::*;
use crate::explain::noise::FLOOR;
use crate::explain::tests::CommittedCase;
use crate::fit::filter::GaussMarkov;

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
fn a_companion_moves_if_it_lies_clear_of_where_it_was_held() {
    let held = Hypothesis::from_model(&Model::thesis()).with(Term::off(find("weak_motor").unwrap().1));
    let share_of = |tilt_share: f64| {
        let term = Term::off(find("weak_motor").unwrap().1).with_companions();
        let at = term.free.len() - 1;
        let hypothesis = Hypothesis::from_model(&Model::thesis()).with(term);
        let mut mean = hypothesis.free_values();
        assert_eq!(mean[at], 1.0, "the share of the torque is the last");
        mean[at] = tilt_share;
        let posterior = ParameterPrior::independent(mean.clone(), &vec![0.03; mean.len()]);
        FilteredHypothesis { hypothesis, posterior, disturbances: FLOOR, loss: 0.0, losses: Vec::new() }
    };
    assert!(share_of(0.27).moves_companions(&held));
    assert!(!share_of(0.95).moves_companions(&held));
    assert!(!share_of(0.27).moves_companions(&share_of(1.0).hypothesis), "it was free already");
}

#[test]
fn each_newcomer_is_spoken_for_by_its_likeliest_fits() {
    let beside = Hypothesis::from_model(&Model::thesis()).with(Term::off(find("wind").unwrap().1));
    let fit = |effect: &str, loss: f64| {
        let hypothesis = beside.with(Term::off(find(effect).unwrap().1));
        FilteredHypothesis { loss, hypothesis, ..filtered_hypothesis(effect, 0.0) }
    };
    let tried = [("slung_load", 9.0), ("drag_linear", 50.0), ("slung_load", 7.0), ("slung_load", 8.0)];
    let all: Vec<FilteredHypothesis> = tried.iter().map(|(effect, loss)| fit(effect, *loss)).collect();
    let losses = |most: usize| -> Vec<f64> {
        likeliest_by_newcomer(all.clone(), &beside, most).iter().map(|j| j.loss).collect()
    };
    assert_eq!(losses(2), [50.0, 7.0, 8.0], "sorted by name");
    assert_eq!(losses(1), [50.0, 7.0]);
    assert_eq!(fit("drag_linear", 0.0).newcomer(&beside), Some("drag_linear"));
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

/// Returns the flight of a committed case of one minute, with a yaw motion in its middle that no model has, for 1.5 s
/// and by so much.
fn flight_with_odd_yaw(amplitude_rad: f64) -> ([Flight; 1], Hypothesis) {
    let case = CommittedCase::read("stages/d10");
    let mut log = case.fit.clone();
    let begin_s = log.t_s[0] + 30.0;
    for (yaw_rad, t_s) in log.yaw_rad.iter_mut().zip(&log.t_s) {
        let share = (t_s - begin_s) / 1.5;
        if (0.0..1.0).contains(&share) {
            *yaw_rad += amplitude_rad * (0.5 - 0.5 * (TAU * share).cos());
        }
    }
    (case.flights(&log), case.declared)
}

#[test]
fn where_a_model_fails_for_a_moment_the_disturbances_grow() {
    // rotorpy's flight d0009 of seed 7373 overshoots once, at a large step of the yaw rate: that cost 4000, and
    // commands that are lost, which shake a vehicle, took the place of a delay. Here it cost 37000.
    let loss_and_turn = |amplitude_rad: f64| {
        let (flights, declared) = flight_with_odd_yaw(amplitude_rad);
        let judged = Search::new(&flights).judge_declared(&declared).unwrap();
        (judged.loss, judged.disturbances.turn.sigma)
    };
    let (usual, calm) = loss_and_turn(0.0);
    let (odd, shaken) = loss_and_turn(0.3);
    assert_eq!(calm, FLOOR.turn.sigma);
    assert!(shaken > 5.0 * calm, "{shaken} rad/s^2");
    assert!(odd - usual < 2000.0, "{odd} against {usual}");
}

#[test]
fn what_begins_anew_takes_back_what_a_disturbance_stood_for() {
    // In rotorpy's flight d0112 of seed 9393 a thrust lag was not found at first. A slope, a damping and a shaken
    // thrust stood for it, and beside so much noise the lag was no likelier.
    let case = CommittedCase::read("stages/d08");
    let flights = case.flights(&case.fit);
    let search = Search::new(&flights);
    let torque_alone = Term { free: vec![1], ..Term::off(find("motor_lag").unwrap().1) };
    let beside = ["heave_damping", "drag_linear"].map(|effect| Term::off(find(effect).unwrap().1));
    let hypothesis = beside.into_iter().fold(case.declared.with(torque_alone), |h, term| h.with(term));
    let shaken = Disturbances { lift: GaussMarkov { sigma: 0.19, tau_s: 0.5 }, ..FLOOR };
    let sd = vec![0.1; hypothesis.free_values().len()];
    let judged = search.judge(&Proposal { hypothesis: search.rough(&hypothesis), sd }, &shaken).unwrap();
    let anew = search.restart(&judged).unwrap();
    let gain = judged.loss - anew.loss;
    assert!(anew.disturbances.lift.sigma < 0.1, "{:?}, gain {gain}", anew.disturbances.lift);
    assert!(gain > 100.0, "{gain}");
}
