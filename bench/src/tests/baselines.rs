//! The scenarios are worth flying: the baselines have the expected results, and none is at the end of the scale.

use super::super::baselines::evaluate;
use super::*;

#[test]
fn the_thesis_pid_is_best_everywhere_and_leaves_room() {
    for scenario in open("baselines").scenarios().iter().filter(|scenario| scenario.plan.team.is_none()) {
        // The same in every run. Attempts draw theirs anew, and by chance a hover scored more than the PID.
        let seeds: Vec<u64> = (0..2 * scenario.episodes() as u64).collect();
        let [thesis, others @ ..] = ["thesis-pid", "stock-pid", "hover", "random"].map(|name| {
            let score =
                evaluate(scenario, &ControllerSpec::named(name).unwrap().into(), &seeds).unwrap().0.score;
            println!(
                "{}: {name} {:.1} ({:.1} to {:.1}, {} failed)",
                scenario.id(),
                score.score,
                score.low,
                score.high,
                score.failed
            );
            score
        });
        assert!((10.0..80.0).contains(&thesis.score), "{}: {thesis:?}", scenario.id());
        assert!(others.iter().all(|other| other.score < thesis.low), "{}: {others:?}", scenario.id());
    }
}
