//! Sizes of the disturbances of a flight: the sizes and correlation times that maximise the filter's likelihood.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use super::calibration::noise::{
    DAMPING, FIRST, LEAST, LOG_SIZE_PENALTY, MASKING, OUTLYING, QUIESCENCE, TAU_S, TIMES_FORCE,
    TIMES_FORCE_IN_STILL_AIR, TUNE_S, WORTH, WORTH_REPORT,
};
pub use super::calibration::noise::{FLOOR, GUST_S, LONGEST_S};
use super::signals::Signal;
use crate::fit::filter::{Disturbances, GaussMarkov, LinearisedSegment};
use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;

/// A force that wanders by more than this (m/s^2) is more than a draught; for longer than this (s), a gust.
pub const REPORTABLE_FORCE_MPS2: f64 = 0.1;
/// A lift that wanders by more than this (m/s^2) is no small error of the thrust if it is so many times the
/// force: air moves in all directions.
const REPORTABLE_LIFT_MPS2: f64 = 0.2;
/// In still air even a smaller one is none.
const LIFT_IN_STILL_AIR_MPS2: f64 = 0.045;
/// A turn that wanders by more than this (rad/s^2) is no small error of the yaw model.
const REPORTABLE_TURN_RADPS2: f64 = 0.08;
/// A torque that wanders by more than this (rad/s^2) is no small error of the attitude model.
const REPORTABLE_TORQUE_RADPS2: f64 = 0.25;

/// One change of one disturbance.
#[derive(Debug, Clone, Copy)]
enum Move {
    Sigma(usize, f64),
    Tau(usize, f64),
    /// Larger and slower, or smaller and faster: what shakes within a short time stays the same.
    Both(usize, f64),
    Off(usize),
}

fn apply_move(from: &Disturbances, change: Move) -> Option<Disturbances> {
    let mut to = *from;
    let (mut first, mut floor) = (FIRST, FLOOR);
    let (first, floor) = (first.processes_mut(), floor.processes_mut());
    let list = to.processes_mut();
    match change {
        Move::Off(i) if list[i].sigma > floor[i].sigma => *list[i] = *floor[i],
        Move::Sigma(i, by)
            if list[i].sigma > 0.0 && list[i].sigma * by >= (LEAST * first[i].sigma).max(floor[i].sigma) =>
        {
            list[i].sigma *= by
        }
        // a quiescent disturbance may return, up to its floor
        Move::Sigma(i, by) if list[i].sigma < floor[i].sigma && by > 1.0 => list[i].sigma = floor[i].sigma,
        // a disturbance that is off may return, small
        Move::Sigma(i, by) if list[i].sigma == 0.0 && by > 1.0 => list[i].sigma = 0.2 * first[i].sigma,
        Move::Tau(i, by)
            if list[i].sigma > floor[i].sigma && (TAU_S[0]..=TAU_S[1]).contains(&(list[i].tau_s * by)) =>
        {
            list[i].tau_s *= by
        }
        Move::Both(i, by) => {
            return apply_move(&apply_move(from, Move::Tau(i, by))?, Move::Sigma(i, by.sqrt()));
        }
        _ => return None,
    }
    Some(to)
}

/// Segments of a flight, linearised about one estimate: hundreds of likelihoods without a simulation.
struct Segments<'a> {
    flight: &'a Flight,
    linearised: Vec<LinearisedSegment>,
}

/// Disturbances with their loss, of each segment and summed up to each tick.
struct DisturbanceLoss {
    disturbances: Disturbances,
    losses: Vec<Vec<f64>>,
}

impl DisturbanceLoss {
    fn loss(&self) -> f64 {
        self.losses.iter().filter_map(|l| l.last()).sum::<f64>() + penalty(&self.disturbances)
    }
}

impl Segments<'_> {
    /// `None` where the loss falls hopelessly behind that of `best`.
    fn evaluate(&self, under: Disturbances, best: Option<&DisturbanceLoss>) -> Option<DisturbanceLoss> {
        let least = |i: usize| best.map(|b| b.losses[i].as_slice());
        let segments = self.linearised.par_iter().enumerate();
        let losses = segments.map(|(i, segment)| segment.losses(self.flight, &under, least(i)));
        Some(DisturbanceLoss { disturbances: under, losses: losses.collect::<Option<_>>()? })
    }

    /// The best of all moves by one factor, or of those that gain anything taken together. `None` if none
    /// does.
    fn improve(&self, best: &DisturbanceLoss, by: f64) -> Option<DisturbanceLoss> {
        let moves_of = |i: usize| {
            let (down, changes) = (1.0 / by, [Move::Sigma, Move::Tau, Move::Both]);
            let both_ways = changes.map(|change: fn(usize, f64) -> Move| [change(i, by), change(i, down)]);
            both_ways.into_iter().flatten().chain([Move::Off(i)])
        };
        let moves: Vec<Move> = (0..5).flat_map(moves_of).collect();
        let evaluate = |m: Move| Some((m, self.evaluate(apply_move(&best.disturbances, m)?, Some(best))?));
        let gains = |m: Move| if matches!(m, Move::Off(_)) { -WORTH } else { WORTH };
        let tried = moves.into_par_iter().filter_map(evaluate);
        let mut better: Vec<_> = tried.filter(|(m, w)| w.loss() < best.loss() - gains(*m)).collect();
        better.sort_by(|a, b| a.1.loss().total_cmp(&b.1.loss()));
        // each disturbance changed at most once
        let (mut together, mut seen) = (best.disturbances, Vec::new());
        for (m, _) in &better {
            let (Move::Sigma(i, _) | Move::Tau(i, _) | Move::Both(i, _) | Move::Off(i)) = *m;
            if !seen.contains(&i) {
                seen.push(i);
                together = apply_move(&together, *m).unwrap_or(together);
            }
        }
        let joint = if seen.len() > 1 { self.evaluate(together, Some(best)) } else { None };
        let alone = better.into_iter().next().map(|(_, w)| w);
        joint.into_iter().chain(alone).min_by(|a, b| a.loss().total_cmp(&b.loss()))
    }
}

/// The signals whose disturbances are more than the small errors of a model, each with its size in units of the least
/// that is reported.
pub(crate) fn reportable(disturbances: &Disturbances) -> impl Iterator<Item = (Signal, f64)> {
    let Disturbances { force, lift, torque, turn, .. } = *disturbances;
    let beside = |times: f64, least: f64| (lift.sigma / least).min(lift.sigma / (times * force.sigma));
    let in_still_air = beside(TIMES_FORCE_IN_STILL_AIR, LIFT_IN_STILL_AIR_MPS2);
    let all = [
        (Signal::Sideways, force.sigma / REPORTABLE_FORCE_MPS2),
        (Signal::Vertical, beside(TIMES_FORCE, REPORTABLE_LIFT_MPS2).max(in_still_air)),
        (Signal::Tilt, torque.sigma / REPORTABLE_TORQUE_RADPS2),
        (Signal::Yaw, turn.sigma / REPORTABLE_TURN_RADPS2),
    ];
    all.into_iter().filter(|(_, size)| *size > 1.0)
}

/// Size of a wandering force that is reported, as [`reportable`] has it.
pub(crate) fn reportable_force(disturbances: &Disturbances) -> Option<f64> {
    reportable(disturbances).find(|(signal, _)| *signal == Signal::Sideways).map(|(_, size)| size)
}

/// Penalty of disturbances, in units of log-likelihood. Most flights are quiet, and a disturbance that is
/// reported must gain more than an effect.
pub fn penalty(disturbances: &Disturbances) -> f64 {
    let mut penalty = WORTH_REPORT.get() * reportable(disturbances).count() as f64;
    rescale(disturbances, |sigma, floor| {
        penalty += LOG_SIZE_PENALTY.get() * (sigma / floor).max(1.0).ln();
        sigma
    });
    penalty
}

/// The disturbances once for each that is large enough to hide something, with hardly any of that.
pub fn damped_in_turn(disturbances: &Disturbances) -> Vec<Disturbances> {
    let mut floor = FLOOR;
    let damped = |(i, floor): (usize, &mut GaussMarkov)| {
        let mut damped = *disturbances;
        let sigma = &mut damped.processes_mut()[i].sigma;
        let masks = floor.sigma > 0.0 && *sigma > MASKING.get() * floor.sigma;
        *sigma = (*sigma / DAMPING).max(floor.sigma);
        masks.then_some(damped)
    };
    floor.processes_mut().into_iter().enumerate().filter_map(damped).collect()
}

/// The disturbances, those at their floor reduced to all but nothing.
pub fn quiescent(disturbances: &Disturbances) -> Disturbances {
    rescale(disturbances, |sigma, floor| if sigma <= 1.01 * floor { floor / QUIESCENCE } else { sigma })
}

/// The quiescent ones, if the wandering force lies at its floor; the other disturbances may be of any size.
pub fn still_air(disturbances: &Disturbances) -> Option<Disturbances> {
    let still = quiescent(disturbances);
    (still.force.sigma < disturbances.force.sigma).then_some(still)
}

/// Other sizes for the disturbances that have a floor, by size and floor.
fn rescale(disturbances: &Disturbances, mut to: impl FnMut(f64, f64) -> f64) -> Disturbances {
    let (mut rescaled, mut floor) = (*disturbances, FLOOR);
    let processes = rescaled.processes_mut().into_iter().zip(floor.processes_mut());
    processes
        .filter(|(_, floor)| floor.sigma > 0.0)
        .for_each(|(process, floor)| process.sigma = to(process.sigma, floor.sigma));
    rescaled
}

/// Returns whether a hypothesis predicts a part of the flight far worse than the rest of it.
pub fn is_outlying(flight: &Flight, losses: &[f64]) -> bool {
    outlying_segment(flight, losses, tuning_ticks(flight)).is_some()
}

/// Ticks of a segment that disturbances are tuned on.
fn tuning_ticks(flight: &Flight) -> usize {
    ((TUNE_S / flight.tick_s) as usize).min(flight.ticks / 2)
}

/// The segment of so many ticks that a hypothesis predicts far worse than the rest of the flight, if there is one.
/// `losses` are those up to each tick, of the flight and perhaps of others behind it.
fn outlying_segment(flight: &Flight, losses: &[f64], ticks: usize) -> Option<Range<usize>> {
    let losses = &losses[..flight.ticks.min(losses.len())];
    let starts = (0..losses.len().saturating_sub(ticks)).step_by((ticks / 4).max(1));
    let mut all: Vec<_> = starts.map(|start| (losses[start + ticks] - losses[start], start)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (usual, (most, start)) = (all.get(all.len() / 2)?.0, *all.last()?);
    (most - usual > OUTLYING.get()).then(|| start..start + ticks)
}

/// The disturbances of a flight under a hypothesis, searched from those given, or from scratch. Tuned at the
/// beginning and the end of the flight, and on a segment that is outlying by its loss under `losses`, if these are
/// known: the filter is sure of itself under small disturbances, and loses track if a model fails for a moment.
pub fn tune_disturbances(
    flight: &Flight,
    hypothesis: &Hypothesis,
    from: Option<&Disturbances>,
    losses: &[f64],
) -> Disturbances {
    let ticks = tuning_ticks(flight);
    let ends = [0..ticks, flight.ticks - ticks..flight.ticks];
    let outlying = outlying_segment(flight, losses, ticks);
    let is_near = from.is_some() && outlying.is_none();
    let tuned_on: Vec<Range<usize>> = ends.into_iter().chain(outlying).collect();
    let mut found = from.copied().unwrap_or(FIRST);
    let (factors, sweeps): (&[f64], usize) = if is_near { (&[2.0, 1.5], 2) } else { (&[4.0, 2.0, 1.5], 3) };
    for by in factors {
        let segment =
            |ticks: &Range<usize>| LinearisedSegment::new(flight, ticks.clone(), hypothesis, &found);
        let Some(linearised) = tuned_on.par_iter().map(segment).collect() else { return found };
        let segments = Segments { flight, linearised };
        let Some(mut best) = segments.evaluate(found, None) else { return found };
        for _ in 0..sweeps {
            let Some(better) = segments.improve(&best, *by) else { break };
            best = better;
        }
        found = best.disturbances;
    }
    found
}

/// The same in still air: with the force that no flight is without.
pub fn calm(disturbances: &Disturbances) -> Disturbances {
    let force = GaussMarkov { sigma: FLOOR.force.sigma, ..disturbances.force };
    Disturbances { force, ..*disturbances }
}

/// The horizontal force finely: size and correlation time where the likelihood of whole flights is highest,
/// each with its standard error from the curvature there, the other unknown too.
pub fn tune_force(
    flights: &[Flight],
    hypothesis: &Hypothesis,
    from: &Disturbances,
) -> (Disturbances, [f64; 2]) {
    let linearised: Option<Vec<LinearisedSegment>> =
        flights.par_iter().map(|f| LinearisedSegment::new(f, f.all_ticks(), hypothesis, from)).collect();
    let Some(linearised) = linearised else { return (*from, [f64::INFINITY; 2]) };
    let with_force = |log: [f64; 2]| {
        let force = GaussMarkov { sigma: log[0].exp(), tau_s: log[1].exp().clamp(TAU_S[0], LONGEST_S) };
        Disturbances { force, ..*from }
    };
    let loss = |log: [f64; 2]| -> f64 {
        linearised.iter().zip(flights).map(|(segment, flight)| segment.loss(flight, &with_force(log))).sum()
    };
    let mut log_force = [from.force.sigma.ln(), from.force.tau_s.ln()];
    let mut sd = [f64::INFINITY; 2];
    for step in [0.5, 0.25, 0.15, 0.15] {
        // nine points around, and the vertex of the paraboloid through them
        let grid_point = |i: usize| {
            [log_force[0] + step * (i / 3) as f64 - step, log_force[1] + step * (i % 3) as f64 - step]
        };
        let near: Vec<f64> = (0..9).into_par_iter().map(|i| loss(grid_point(i))).collect();
        let gradient = Vector2::new(near[7] - near[1], near[5] - near[3]) / (2.0 * step);
        let across = (near[8] - near[6] - near[2] + near[0]) / (4.0 * step * step);
        let along = [near[7] + near[1], near[5] + near[3]].map(|sum| (sum - 2.0 * near[4]) / (step * step));
        if let Some(factor) = Matrix2::new(along[0], across, across, along[1]).cholesky() {
            let to = factor.solve(&gradient);
            let covariance = factor.inverse();
            log_force = std::array::from_fn(|i| log_force[i] - to[i].clamp(-2.0 * step, 2.0 * step));
            sd = std::array::from_fn(|i| log_force[i].exp() * covariance[(i, i)].sqrt());
        } else if let Some(lowest) = (0..9).min_by(|a, b| near[*a].total_cmp(&near[*b])) {
            log_force = grid_point(lowest);
        }
    }
    (with_force(log_force), sd)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(disturbances: &Disturbances) -> Vec<Signal> {
        reportable(disturbances).map(|(kind, _)| kind).collect()
    }

    #[test]
    fn air_moves_in_all_directions_and_a_thrust_alone_does_not() {
        let kinds_of = |force: f64, lift: f64| {
            let process = |sigma: f64| GaussMarkov { sigma, tau_s: 0.2 };
            kinds(&Disturbances { force: process(force), lift: process(lift), ..FLOOR })
        };
        assert_eq!(kinds_of(0.012, 0.03), []);
        assert_eq!(kinds_of(0.012, 0.06), [Signal::Vertical]);
        assert_eq!(kinds_of(0.05, 0.06), []);
        assert_eq!(kinds_of(0.2, 0.25), [Signal::Sideways]);
        assert_eq!(kinds_of(0.1, 0.25), [Signal::Vertical]);
    }

    #[test]
    fn larger_and_slower_shakes_as_much_within_a_short_time() {
        let from = Disturbances { lift: GaussMarkov { sigma: 0.2, tau_s: 4.0 }, ..FLOOR };
        let to = apply_move(&from, Move::Both(1, 0.25)).unwrap().lift;
        assert_eq!((to.sigma, to.tau_s), (0.1, 1.0));
        let rate = |w: GaussMarkov| w.sigma * w.sigma / w.tau_s;
        assert!((rate(to) - rate(from.lift)).abs() < 1e-12);
        assert!(apply_move(&from, Move::Both(1, 4.0)).is_none(), "slower than all");
    }

    #[test]
    fn air_is_still_where_no_force_lies_beyond_its_floor() {
        let still = still_air(&FLOOR).unwrap();
        assert_eq!(still.force.sigma, FLOOR.force.sigma / QUIESCENCE);
        assert!(still_air(&still).is_none(), "it is already");
        let pushed = Disturbances { force: GaussMarkov { sigma: 0.03, tau_s: 1.0 }, ..FLOOR };
        assert!(still_air(&pushed).is_none());
        // a wrong guess of stillness can be taken back, to the floor and no farther
        let back = apply_move(&still, Move::Sigma(0, 1.5)).unwrap();
        assert_eq!(back.force, FLOOR.force);
        assert!(apply_move(&still, Move::Sigma(0, 1.0 / 1.5)).is_none());
        assert!(apply_move(&still, Move::Off(0)).is_none());
    }

    #[test]
    fn each_disturbance_that_may_hide_something_is_damped_alone() {
        assert!(damped_in_turn(&FLOOR).is_empty());
        let process = |sigma: f64| GaussMarkov { sigma, tau_s: 2.0 };
        let shaken = Disturbances { force: process(0.3), lift: process(0.03), ..FLOOR };
        let damped = damped_in_turn(&shaken);
        assert_eq!(damped.len(), 2);
        assert_eq!(damped[0], Disturbances { force: process(0.03), ..shaken });
        assert_eq!(damped[1], Disturbances { lift: process(FLOOR.lift.sigma), ..shaken });
    }

    #[test]
    fn a_reported_disturbance_costs_as_much_as_an_effect() {
        // however long it lasts: or a gust would be fitted just short of one
        for tau_s in [0.1, 1.0, 10.0] {
            let gust = |sigma: f64| Disturbances { force: GaussMarkov { sigma, tau_s }, ..FLOOR };
            assert_eq!((kinds(&gust(0.1)), kinds(&gust(0.11))), (vec![], vec![Signal::Sideways]));
            assert!(
                (penalty(&gust(0.11))
                    - penalty(&gust(0.1))
                    - LOG_SIZE_PENALTY.get() * 1.1_f64.ln()
                    - WORTH_REPORT.get())
                .abs()
                    < 1e-9
            );
        }
        let strong = Disturbances {
            torque: GaussMarkov { sigma: 0.3, tau_s: 0.3 },
            turn: GaussMarkov { sigma: 0.2, tau_s: 4.0 },
            ..FLOOR
        };
        assert_eq!(kinds(&strong), [Signal::Tilt, Signal::Yaw]);
    }
}
