//! How large the disturbances of a flight are: the sizes and correlation times under which the filter's likelihood is highest.

use std::ops::Range;

use rayon::prelude::*;

use crate::fit::filter::{Disturbances, Track, Wander};
use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;

/// Sizes are tuned on a stretch at the start of a flight and one at its end.
const TUNE_S: f64 = 9.0;
/// Where a search begins.
const FIRST: Disturbances = Disturbances {
    force: Wander { sigma: 0.1, tau_s: 1.0 },
    lift: Wander { sigma: 0.05, tau_s: 1.0 },
    torque: Wander { sigma: 0.3, tau_s: 0.3 },
    turn: Wander { sigma: 0.2, tau_s: 1.0 },
    marker: Wander { sigma: 0.003, tau_s: 3.0 },
};
/// What no flight is without: the models' own small errors. A size does not shrink below it.
pub const FLOOR: Disturbances = Disturbances {
    force: Wander { sigma: 0.012, tau_s: 1.0 },
    lift: Wander { sigma: 0.008, tau_s: 1.0 },
    torque: Wander { sigma: 0.05, tau_s: 0.3 },
    turn: Wander { sigma: 0.02, tau_s: 1.0 },
    marker: Wander { sigma: 0.0, tau_s: 3.0 },
};
/// A size of a disturbance without a floor that shrinks below this share of the first is none.
const LEAST: f64 = 0.05;
/// Correlation times stay within these.
const TAU_S: [f64; 2] = [0.05, 10.0];
/// A move must gain this much likelihood.
const WORTH: f64 = 0.3;

/// One change of one disturbance.
#[derive(Debug, Clone, Copy)]
enum Move {
    Sigma(usize, f64),
    Tau(usize, f64),
    Off(usize),
}

fn moved(from: &Disturbances, change: Move) -> Option<Disturbances> {
    let mut to = *from;
    let (mut first, mut floor) = (FIRST, FLOOR);
    let (first, floor) = (first.list_mut(), floor.list_mut());
    let list = to.list_mut();
    match change {
        Move::Off(i) if list[i].sigma > floor[i].sigma => *list[i] = *floor[i],
        Move::Sigma(i, by) if list[i].sigma > 0.0 && list[i].sigma * by >= (LEAST * first[i].sigma).max(floor[i].sigma) => {
            list[i].sigma *= by
        }
        // what is off may come back, small
        Move::Sigma(i, by) if list[i].sigma == 0.0 && by > 1.0 => list[i].sigma = 0.2 * first[i].sigma,
        Move::Tau(i, by) if list[i].sigma > floor[i].sigma && (TAU_S[0]..=TAU_S[1]).contains(&(list[i].tau_s * by)) => list[i].tau_s *= by,
        _ => return None,
    }
    Some(to)
}

/// The disturbances of a flight under a hypothesis, searched from those given, or from scratch.
pub fn tune(flight: &Flight, hypothesis: &Hypothesis, from: Option<&Disturbances>) -> Disturbances {
    let ticks = ((TUNE_S / flight.tick_s) as usize).min(flight.ticks / 2);
    let stretches = [0..ticks, flight.ticks - ticks..flight.ticks];
    let mut best = from.copied().unwrap_or(FIRST);
    let (factors, sweeps): (&[f64], usize) = if from.is_some() { (&[2.0, 1.5], 2) } else { (&[4.0, 2.0, 1.5], 3) };
    for by in factors {
        // linear about what is best so far: hundreds of likelihoods without a simulation
        let tracks: Option<Vec<Track>> =
            stretches.par_iter().map(|ticks: &Range<usize>| Track::of(flight, ticks.clone(), hypothesis, &best)).collect();
        let Some(tracks) = tracks else { return best };
        let loss = |d: &Disturbances| -> f64 { tracks.iter().map(|track| track.loss(flight, d)).sum() };
        let mut least = loss(&best);
        for _ in 0..sweeps {
            let groups = 0..5;
            let moves = groups
                .flat_map(|i| [Move::Sigma(i, *by), Move::Sigma(i, 1.0 / by), Move::Tau(i, *by), Move::Tau(i, 1.0 / by), Move::Off(i)]);
            let moves: Vec<Move> = moves.collect();
            let tried: Vec<(Move, f64)> =
                moves.into_par_iter().filter_map(|m| Some((m, moved(&best, m)?))).map(|(m, d)| (m, loss(&d))).collect();
            let mut better: Vec<(Move, f64)> =
                tried.into_iter().filter(|(m, l)| *l < least - if matches!(m, Move::Off(_)) { -WORTH } else { WORTH }).collect();
            better.sort_by(|a, b| a.1.total_cmp(&b.1));
            let Some((first, alone)) = better.first().copied() else { break };
            // all improvements at once, each disturbance changed at most once, or the best alone
            let mut together = best;
            let mut seen = Vec::new();
            for (m, _) in &better {
                let (Move::Sigma(i, _) | Move::Tau(i, _) | Move::Off(i)) = *m;
                if !seen.contains(&i) {
                    seen.push(i);
                    together = moved(&together, *m).unwrap_or(together);
                }
            }
            let joint = if seen.len() > 1 { loss(&together) } else { f64::INFINITY };
            if joint < alone {
                (best, least) = (together, joint);
            } else if let Some(next) = moved(&best, first) {
                (best, least) = (next, alone);
            }
        }
    }
    best
}

/// The horizontal force finely: size and correlation time where the likelihood of whole flights is highest, each with its standard error from
/// the curvature there.
pub fn force(flights: &[Flight], hypothesis: &Hypothesis, from: &Disturbances) -> (Disturbances, [f64; 2]) {
    let tracks: Option<Vec<Track>> = flights.par_iter().map(|f| Track::of(f, f.all(), hypothesis, from)).collect();
    let Some(tracks) = tracks else { return (*from, [f64::INFINITY; 2]) };
    let loss = |log: [f64; 2]| -> f64 {
        let force = Wander { sigma: log[0].exp(), tau_s: log[1].exp().clamp(TAU_S[0], 2.0 * TAU_S[1]) };
        let d = Disturbances { force, ..*from };
        tracks.par_iter().zip(flights).map(|(track, flight)| track.loss(flight, &d)).sum()
    };
    let mut at = [from.force.sigma.ln(), from.force.tau_s.ln()];
    let mut sd = [f64::INFINITY; 2];
    for step in [0.5, 0.25, 0.15] {
        for axis in [1, 0] {
            let moved = |by: f64| {
                let mut to = at;
                to[axis] += by;
                to
            };
            // the vertex of a parabola through three points
            let (low, here, high) = (loss(moved(-step)), loss(at), loss(moved(step)));
            let curvature = (low - 2.0 * here + high) / (step * step);
            if curvature > 0.0 {
                let to = ((low - high) / (2.0 * step * curvature)).clamp(-2.0 * step, 2.0 * step);
                at[axis] += to;
                sd[axis] = at[axis].exp() / curvature.sqrt();
            } else {
                at[axis] += if high < low { step } else { -step };
            }
        }
    }
    (Disturbances { force: Wander { sigma: at[0].exp(), tau_s: at[1].exp() }, ..*from }, sd)
}
