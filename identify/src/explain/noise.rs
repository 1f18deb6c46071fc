//! How large the disturbances of a flight are: the sizes and correlation times under which the filter's likelihood is highest.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use super::calibration::noise::{CALM, DEAR, FIRST, LEAST, LOUD, STILL, TAU_S, TIMES_FORCE, TIMES_FORCE_IN_STILL_AIR, TUNE_S, WORTH};
pub use super::calibration::noise::{FLOOR, GUST_S, LONGEST_S};
use crate::fit::filter::{Disturbances, Track, Wander};
use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;

/// A force that wanders by more than this (m/s^2) is more than a draught; for longer than this (s), a gust.
pub const SHAKEN_FORCE_MPS2: f64 = 0.1;
/// A lift that wanders by more than this (m/s^2) is no small error of the thrust if it is so many times the force: air moves in all directions.
const SHAKEN_LIFT_MPS2: f64 = 0.2;
/// In still air even a smaller one is none.
const LIFT_IN_STILL_AIR_MPS2: f64 = 0.045;
/// A turn that wanders by more than this (rad/s^2) is no small error of the yaw model.
const SHAKEN_TURN_RADPS2: f64 = 0.08;
/// A torque that wanders by more than this (rad/s^2) is no small error of the attitude model.
const SHAKEN_TORQUE_RADPS2: f64 = 0.25;

/// One change of one disturbance.
#[derive(Debug, Clone, Copy)]
enum Move {
    Sigma(usize, f64),
    Tau(usize, f64),
    /// Larger and slower, or smaller and faster: what shakes within a short time stays the same.
    Both(usize, f64),
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
        Move::Both(i, by) => return moved(&moved(from, Move::Tau(i, by))?, Move::Sigma(i, by.sqrt())),
        _ => return None,
    }
    Some(to)
}

/// Stretches of a flight, linear about one estimate: hundreds of likelihoods without a simulation.
struct Stretches<'a> {
    flight: &'a Flight,
    tracks: Vec<Track>,
}

/// Disturbances with their loss, of each stretch and summed up to each tick.
struct Weighed {
    disturbances: Disturbances,
    losses: Vec<Vec<f64>>,
}

impl Weighed {
    fn loss(&self) -> f64 {
        self.losses.iter().filter_map(|l| l.last()).sum::<f64>() + price(&self.disturbances)
    }
}

impl Stretches<'_> {
    /// `None` where the loss falls hopelessly behind that of `best`.
    fn weigh(&self, disturbances: Disturbances, best: Option<&Weighed>) -> Option<Weighed> {
        let least = |i: usize| best.map(|b| b.losses[i].as_slice());
        let losses = self.tracks.iter().enumerate().map(|(i, track)| track.losses(self.flight, &disturbances, least(i)));
        Some(Weighed { disturbances, losses: losses.collect::<Option<_>>()? })
    }

    /// The best of all moves by one factor, or of those that gain anything taken together. `None` if none does.
    fn improve(&self, best: &Weighed, by: f64) -> Option<Weighed> {
        let both_ways = |change: fn(usize, f64) -> Move, i: usize| [change(i, by), change(i, 1.0 / by)];
        let of = |i| [Move::Sigma, Move::Tau, Move::Both].into_iter().flat_map(move |change| both_ways(change, i)).chain([Move::Off(i)]);
        let moves: Vec<Move> = (0..5).flat_map(of).collect();
        let weigh = |m: Move| Some((m, self.weigh(moved(&best.disturbances, m)?, Some(best))?));
        let gains = |m: Move| if matches!(m, Move::Off(_)) { -WORTH } else { WORTH };
        let tried = moves.into_par_iter().filter_map(weigh).filter(|(m, w)| w.loss() < best.loss() - gains(*m));
        let mut better: Vec<(Move, Weighed)> = tried.collect();
        better.sort_by(|a, b| a.1.loss().total_cmp(&b.1.loss()));
        // each disturbance changed at most once
        let (mut together, mut seen) = (best.disturbances, Vec::new());
        for (m, _) in &better {
            let (Move::Sigma(i, _) | Move::Tau(i, _) | Move::Both(i, _) | Move::Off(i)) = *m;
            if !seen.contains(&i) {
                seen.push(i);
                together = moved(&together, *m).unwrap_or(together);
            }
        }
        let joint = if seen.len() > 1 { self.weigh(together, Some(best)) } else { None };
        let alone = better.into_iter().next().map(|(_, w)| w);
        joint.into_iter().chain(alone).min_by(|a, b| a.loss().total_cmp(&b.loss()))
    }
}

/// Disturbances that are more than the small errors of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotableDisturbance {
    Force,
    Lift,
    Torque,
    Turn,
}

/// What is to be said of disturbances, each with its size in units of the least that is said.
pub fn said(disturbances: &Disturbances) -> impl Iterator<Item = (NotableDisturbance, f64)> {
    let Disturbances { force, lift, torque, turn, .. } = *disturbances;
    let beside = |times: f64, least: f64| (lift.sigma / least).min(lift.sigma / (times * force.sigma));
    let all = [
        (NotableDisturbance::Force, force.sigma / SHAKEN_FORCE_MPS2),
        (NotableDisturbance::Lift, beside(TIMES_FORCE, SHAKEN_LIFT_MPS2).max(beside(TIMES_FORCE_IN_STILL_AIR, LIFT_IN_STILL_AIR_MPS2))),
        (NotableDisturbance::Torque, torque.sigma / SHAKEN_TORQUE_RADPS2),
        (NotableDisturbance::Turn, turn.sigma / SHAKEN_TURN_RADPS2),
    ];
    all.into_iter().filter(|(_, size)| *size > 1.0)
}

/// What disturbances cost beforehand, in units of log-likelihood: most flights are quiet, and what is to be said of disturbances must be worth what an
/// effect must be.
pub fn price(disturbances: &Disturbances) -> f64 {
    let mut price = super::WORTH_FIT * said(disturbances).count() as f64;
    resized(disturbances, |sigma, floor| {
        price += DEAR * (sigma / floor).max(1.0).ln();
        sigma
    });
    price
}

/// Whether a disturbance is large enough to hide something.
pub fn loud(disturbances: &Disturbances) -> bool {
    let mut loud = false;
    resized(disturbances, |sigma, floor| {
        loud |= sigma > LOUD * floor;
        sigma
    });
    loud
}

/// The same with hardly any force and torque.
pub fn calm(disturbances: &Disturbances) -> Disturbances {
    resized(disturbances, |sigma, floor| (sigma / CALM).max(floor))
}

/// The same, but what stands at its floor is all but nothing.
pub fn still(disturbances: &Disturbances) -> Disturbances {
    resized(disturbances, |sigma, floor| if sigma <= 1.01 * floor { floor / STILL } else { sigma })
}

/// Other sizes for the disturbances that have a floor, by size and floor.
fn resized(disturbances: &Disturbances, mut to: impl FnMut(f64, f64) -> f64) -> Disturbances {
    let (mut resized, mut floor) = (*disturbances, FLOOR);
    for (wander, floor) in resized.list_mut().into_iter().zip(floor.list_mut()).filter(|(_, floor)| floor.sigma > 0.0) {
        wander.sigma = to(wander.sigma, floor.sigma);
    }
    resized
}

/// The disturbances of a flight under a hypothesis, searched from those given, or from scratch.
pub fn tune(flight: &Flight, hypothesis: &Hypothesis, from: Option<&Disturbances>) -> Disturbances {
    let ticks = ((TUNE_S / flight.tick_s) as usize).min(flight.ticks / 2);
    let ends = [0..ticks, flight.ticks - ticks..flight.ticks];
    let mut found = from.copied().unwrap_or(FIRST);
    let (factors, sweeps): (&[f64], usize) = if from.is_some() { (&[2.0, 1.5], 2) } else { (&[4.0, 2.0, 1.5], 3) };
    for by in factors {
        let track = |ticks: &Range<usize>| Track::of(flight, ticks.clone(), hypothesis, &found);
        let Some(tracks) = ends.par_iter().map(track).collect() else { return found };
        let stretches = Stretches { flight, tracks };
        let Some(mut best) = stretches.weigh(found, None) else { return found };
        for _ in 0..sweeps {
            let Some(better) = stretches.improve(&best, *by) else { break };
            best = better;
        }
        found = best.disturbances;
    }
    found
}

/// The horizontal force finely: size and correlation time where the likelihood of whole flights is highest, each with its standard error from
/// the curvature there, the other unknown too.
pub fn force(flights: &[Flight], hypothesis: &Hypothesis, from: &Disturbances) -> (Disturbances, [f64; 2]) {
    let tracks: Option<Vec<Track>> = flights.par_iter().map(|f| Track::of(f, f.all(), hypothesis, from)).collect();
    let Some(tracks) = tracks else { return (*from, [f64::INFINITY; 2]) };
    let with = |log: [f64; 2]| {
        let force = Wander { sigma: log[0].exp(), tau_s: log[1].exp().clamp(TAU_S[0], LONGEST_S) };
        Disturbances { force, ..*from }
    };
    let loss = |log: [f64; 2]| -> f64 { tracks.iter().zip(flights).map(|(track, flight)| track.loss(flight, &with(log))).sum() };
    let mut at = [from.force.sigma.ln(), from.force.tau_s.ln()];
    let mut sd = [f64::INFINITY; 2];
    for step in [0.5, 0.25, 0.15, 0.15] {
        // nine points around, and the vertex of the paraboloid through them
        let place = |i: usize| [at[0] + step * (i / 3) as f64 - step, at[1] + step * (i % 3) as f64 - step];
        let near: Vec<f64> = (0..9).into_par_iter().map(|i| loss(place(i))).collect();
        let gradient = Vector2::new(near[7] - near[1], near[5] - near[3]) / (2.0 * step);
        let across = (near[8] - near[6] - near[2] + near[0]) / (4.0 * step * step);
        let along = [near[7] + near[1], near[5] + near[3]].map(|sum| (sum - 2.0 * near[4]) / (step * step));
        if let Some(factor) = Matrix2::new(along[0], across, across, along[1]).cholesky() {
            let to = factor.solve(&gradient);
            let covariance = factor.inverse();
            at = std::array::from_fn(|i| at[i] - to[i].clamp(-2.0 * step, 2.0 * step));
            sd = std::array::from_fn(|i| at[i].exp() * covariance[(i, i)].sqrt());
        } else if let Some(lowest) = (0..9).min_by(|a, b| near[*a].total_cmp(&near[*b])) {
            at = place(lowest);
        }
    }
    (with(at), sd)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(disturbances: &Disturbances) -> Vec<NotableDisturbance> {
        said(disturbances).map(|(said, _)| said).collect()
    }

    #[test]
    fn air_moves_in_all_directions_and_a_thrust_alone_does_not() {
        let of = |force: f64, lift: f64| {
            let wander = |sigma: f64| Wander { sigma, tau_s: 0.2 };
            kinds(&Disturbances { force: wander(force), lift: wander(lift), ..FLOOR })
        };
        assert_eq!(of(0.012, 0.03), []);
        assert_eq!(of(0.012, 0.06), [NotableDisturbance::Lift]);
        assert_eq!(of(0.05, 0.06), []);
        assert_eq!(of(0.2, 0.25), [NotableDisturbance::Force]);
        assert_eq!(of(0.1, 0.25), [NotableDisturbance::Lift]);
    }

    #[test]
    fn larger_and_slower_shakes_as_much_within_a_short_time() {
        let from = Disturbances { lift: Wander { sigma: 0.2, tau_s: 8.0 }, ..FLOOR };
        let to = moved(&from, Move::Both(1, 0.25)).unwrap().lift;
        assert_eq!((to.sigma, to.tau_s), (0.1, 2.0));
        let rate = |w: Wander| w.sigma * w.sigma / w.tau_s;
        assert!((rate(to) - rate(from.lift)).abs() < 1e-12);
        assert!(moved(&from, Move::Both(1, 4.0)).is_none(), "slower than all");
    }

    #[test]
    fn what_is_said_costs_what_an_effect_does() {
        // however long it lasts: or a gust would be fitted just short of one
        for tau_s in [0.1, 1.0, 10.0] {
            let of = |sigma: f64| Disturbances { force: Wander { sigma, tau_s }, ..FLOOR };
            assert_eq!((kinds(&of(0.1)), kinds(&of(0.11))), (vec![], vec![NotableDisturbance::Force]));
            assert!((price(&of(0.11)) - price(&of(0.1)) - DEAR * 1.1_f64.ln() - super::super::WORTH_FIT).abs() < 1e-9);
        }
        let loudly = Disturbances { torque: Wander { sigma: 0.3, tau_s: 0.3 }, turn: Wander { sigma: 0.2, tau_s: 4.0 }, ..FLOOR };
        assert_eq!(kinds(&loudly), [NotableDisturbance::Torque, NotableDisturbance::Turn]);
    }
}
