//! Parameters settled on a recorded flight whose hidden effect is known.

mod common;

use common::data;
use crazyflie_env::effects::find;
use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
use crazyflie_identify::explain::noise::FLOOR;
use crazyflie_identify::explain::refine::refine;
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};

#[test]
fn values_settle_where_the_likelihood_is_highest() {
    let Some(folder) = data("values_settle_where_the_likelihood_is_highest", "hidden_effects") else {
        return;
    };
    // a quadratic drag of 0.465 1/m
    let case = Case::read(&folder.join("d06.json")).unwrap();
    let model = case.model().unwrap();
    let flights =
        [Flight::from_log("d06_a", &FlightLog::read(&case.identify_on).unwrap(), &model, None).unwrap()];
    let hypothesis = Hypothesis::from_model(&model).with(Term::off(find("drag_quadratic").unwrap().1));
    let search = Search::new(&flights);
    let mut judged = search.judge(&hypothesis, &[0.05], &FLOOR).unwrap();
    judged.posterior.mean = vec![0.44];
    let belief = refine(&flights, &judged).unwrap();
    let (value, stderr) = (belief.mean[0], belief.sd(0));
    println!("drag_quadratic {value:.4} +- {stderr:.4}, from 0.44");
    assert!((value - 0.465).abs() < 3.0 * stderr && stderr < 0.01, "{value} +- {stderr}");
    let loss = |value: f64| search.plug_in(&hypothesis.with_values(&[value]), &FLOOR).unwrap();
    let here = loss(value);
    for side in [-1.0, 1.0] {
        let gain = loss(value + side * stderr) - here;
        assert!(gain > 0.1, "a standard error to the side {side} costs {gain}");
    }
}
