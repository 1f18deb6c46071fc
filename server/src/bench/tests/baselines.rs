//! The scenarios are worth flying: the baselines come out as they should, and none is at the end of the
//! scale.

use super::*;

#[test]
fn the_thesis_pid_is_best_everywhere_and_leaves_room() {
    let bench = open("baselines");
    let all = ["thesis-pid", "stock-pid", "hover", "random"];
    for scenario in bench.scenarios().iter().filter(|scenario| scenario.plan.team.is_none()) {
        all.into_iter().for_each(|baseline| drop(submit(&bench, &scenario.id(), baseline)));
        let board = bench.leaderboard(scenario).unwrap();
        let line = |row: &super::super::LeaderboardRow| {
            let s = &row.score;
            format!("{} {:.1} ({:.1} to {:.1}, {} failed)", row.controller, s.score, s.low, s.high, s.failed)
        };
        println!("{}: {}", scenario.id(), board.iter().map(line).collect::<Vec<_>>().join(", "));
        let (best, rest) = board.split_first().unwrap();
        assert_eq!(best.controller, "thesis-pid", "{}", scenario.id());
        assert!((10.0..80.0).contains(&best.score.score), "{}: {:?}", scenario.id(), best.score);
        // by more than chance
        assert!(
            rest.len() == 3 && rest.iter().all(|row| row.score.score < best.score.low),
            "{}",
            scenario.id()
        );
    }
}
