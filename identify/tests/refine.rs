//! Parameters settled on a committed flight whose hidden effect is known.

mod common;

use common::flight_and_model;
use crazyflie_env::effects::find;
use crazyflie_identify::explain::noise::FLOOR;
use crazyflie_identify::explain::refine::refine;
use crazyflie_identify::explain::search::{Proposal, Search};
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};

#[test]
fn values_settle_where_the_likelihood_is_highest() {
    // a drag of 0.5 1/s, on a rigid body of which the declared model has the small angles
    let (flight, model) = flight_and_model("d01");
    let flights = [flight];
    let mut body = Term::off(find("rigid_body").unwrap().1);
    (body.values[0], body.free) = (1.0, Vec::new());
    let hypothesis =
        Hypothesis::from_model(&model).with(body).with(Term::off(find("drag_linear").unwrap().1));
    let search = Search::new(&flights);
    let proposal = Proposal { hypothesis: hypothesis.clone(), sd: vec![0.05] };
    let mut judged = search.judge(&proposal, &FLOOR).unwrap();
    judged.posterior.mean = vec![0.44];
    let belief = refine(&flights, &judged).unwrap();
    let (value, stderr) = (belief.mean[0], belief.sd(0));
    println!("drag_linear {value:.4} +- {stderr:.4}, from 0.44");
    assert!((value - 0.5).abs() < 3.0 * stderr && stderr < 0.02, "{value} +- {stderr}");
    let loss = |value: f64| search.plug_in(&hypothesis.with_values(&[value]), &FLOOR).unwrap();
    let here = loss(value);
    for side in [-1.0, 1.0] {
        let gain = loss(value + side * stderr) - here;
        assert!(gain > 0.1, "a standard error to the side {side} costs {gain}");
    }
}
