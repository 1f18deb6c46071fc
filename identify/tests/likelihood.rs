//! Slopes of the likelihood and predictions without slopes, on a committed flight.

mod common;

use common::flight_and_model;
use crazyflie_env::effects::find;
use crazyflie_identify::explain::noise::FLOOR;
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::filter::Disturbances;
use crazyflie_identify::fit::flight::WINDOW_S;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::likelihood_slopes::LikelihoodSlopes;
use crazyflie_identify::fit::predict::{MeanSimulator, SensitivitySimulator};

/// With a free effect, at its first parameters' values.
fn with(hypothesis: &Hypothesis, effect: &str, value: f64) -> Hypothesis {
    let mut term = Term::off(find(effect).unwrap().1);
    term.values[0] = value;
    term.free = vec![0];
    hypothesis.with(term)
}

#[test]
fn slopes_are_those_of_the_likelihood() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let flights = [flight];
    let search = Search::new(&flights);
    let joint =
        with(&with(&with(&declared, "drag_linear", 0.3), "heave_damping", 0.1), "attitude_gain", 0.98);
    let values = joint.free_values();
    let mut slopes = LikelihoodSlopes::none(values.len());
    slopes.add(&flights[0], &joint, &FLOOR).unwrap();
    let loss = |at: &[f64]| search.plug_in(&joint.with_values(at), &FLOOR).unwrap();
    assert!((slopes.loss - loss(&values)).abs() < 1e-6 * slopes.loss.abs());
    for (i, value) in values.iter().enumerate() {
        let step = 0.003;
        let [high, low] = [step, -step].map(|by| {
            let mut moved = values.clone();
            moved[i] = value + by;
            loss(&moved)
        });
        let (slope, bend) = ((low - high) / (2.0 * step), (high + low - 2.0 * slopes.loss) / (step * step));
        println!(
            "{i}: {} by difference {slope}, {} by difference {bend}",
            slopes.gradient[i],
            slopes.information[(i, i)]
        );
        // what a parameter does to the spread is left out: a standard error or two of it
        let (off, sd) = ((slopes.gradient[i] - slope).abs(), slopes.information[(i, i)].sqrt());
        assert!(off < 0.03 * slope.abs() + 2.0 * sd, "{} against {slope}", slopes.gradient[i]);
        assert!(
            (slopes.information[(i, i)] / bend - 1.0).abs() < 0.2,
            "{} against {bend}",
            slopes.information[(i, i)]
        );
    }
    assert_eq!(slopes.information[(0, 2)], slopes.information[(2, 0)]);
}

#[test]
fn slopes_hold_under_any_disturbances() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let joint = with(&declared, "drag_linear", 0.3);
    let mut calm = LikelihoodSlopes::none(1);
    calm.add(&flight, &joint, &Disturbances::NONE).unwrap();
    let mut shaken = LikelihoodSlopes::none(1);
    let mut gusty = FLOOR;
    gusty.force.sigma = 0.5;
    shaken.add(&flight, &joint, &gusty).unwrap();
    assert!(calm.information[(0, 0)] > 10.0 * shaken.information[(0, 0)], "a gust hides a drag");
}

#[test]
fn predictions_without_slopes_are_the_same_numbers() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let hypothesis = with(&with(&declared, "drag_linear", 0.4), "cmd_delay", 0.04);
    let mut mean = MeanSimulator::new(&hypothesis, &flight, false).unwrap();
    let mut dual = SensitivitySimulator::new(&hypothesis, &flight, false).unwrap();
    for window in flight.windows(0, WINDOW_S).iter().step_by(7) {
        let own = flight.measured_numbers(window.ticks.start);
        mean.predict(&flight, window, &own);
        dual.predict(&flight, window, &own);
        let values = |rows: &[crazyflie_identify::fit::predict::PredictedMeasurement]| {
            rows.iter().map(|r| r.predicted.to_bits()).collect::<Vec<_>>()
        };
        assert!(!mean.rows().is_empty() && mean.slopes().all(<[f64]>::is_empty));
        assert_eq!(values(mean.rows()), values(dual.rows()));
    }
}
