//! Output error with multiple shooting: the numbers that bring the simulation from free initial states closest to the
//! measurement.

use crate::estimate::robust_sd;
use crate::fit::solve::{NormalEquations, Problem, Solution, solve};

use super::channel::Record;
use super::response::{Segment, Simulator};
use super::standard_deviation;
use super::start::scaled_solve;
use super::structure::{Offset, Structure};

/// Fits are started from so many of the best candidates.
const STARTS: usize = 3;
/// The noise level is found beside the numbers.
const ROUNDS: usize = 8;

/// Stretches of records, and the numbers of a structure.
pub(super) struct MultipleShooting<'a> {
    pub(super) structure: &'a Structure,
    pub(super) segments: &'a [Segment],
    pub(super) flights: usize,
    pub(super) integrated: bool,
    /// Standard deviation of the measurement.
    pub(super) sigma: f64,
}

impl MultipleShooting<'_> {
    fn states(&self) -> usize {
        self.structure.denominator + usize::from(self.integrated)
    }

    /// Returns the index of a flight's offset among the shared numbers.
    fn offset(&self, flight: usize) -> Option<usize> {
        let first = self.structure.dynamic();
        match self.structure.offset {
            Offset::None => None,
            Offset::Shared => Some(first),
            Offset::PerFlight => Some(first + flight),
        }
    }

    /// The initial states that fit best with these numbers, and the loss: the output is linear in them.
    pub(super) fn settle(&self, numbers: &[f64]) -> Option<(Vec<Vec<f64>>, f64)> {
        let mut worker = self.worker(numbers);
        let n = self.states();
        let (mut all, mut loss) = (Vec::new(), 0.0);
        for w in 0..self.segments.len() {
            let mut own = vec![0.0; n];
            // outliers weigh less once the rest is in place
            for _ in 0..3 {
                let normal = self.normal_equations(&mut worker, w, &own);
                if !normal.loss.is_finite() {
                    return None;
                }
                let block = normal.information.view((0, 0), (n, n)).into_owned();
                // a state that leaves no trace in a short segment stays where it is
                let step = scaled_solve(block, &normal.gradient.rows(0, n).into_owned())?;
                own.iter_mut().zip(&step).for_each(|(x, by)| *x += by);
            }
            loss += self.normal_equations(&mut worker, w, &own).loss;
            all.push(own);
        }
        loss.is_finite().then_some((all, loss))
    }

    /// Predictions of every sample of every segment.
    pub(super) fn predict(&self, numbers: &[f64], own: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (mut simulator, _) = self.worker(numbers);
        let mut predict_segment = |(segment, own): (&Segment, &Vec<f64>)| {
            let mut all = Vec::with_capacity(segment.len());
            let offset = self.offset(segment.flight).map_or(0.0, |i| numbers[i]);
            simulator.run(segment, own, offset, |_, y| all.push(y.value));
            all
        };
        self.segments.iter().zip(own).map(&mut predict_segment).collect()
    }

    fn residuals(&self, numbers: &[f64], own: &[Vec<f64>]) -> Vec<f64> {
        let predicted = self.predict(numbers, own);
        let segment_residuals =
            |(s, p): (&Segment, Vec<f64>)| s.samples().zip(p).map(|(y, p)| y - p).collect::<Vec<_>>();
        self.segments.iter().zip(predicted).flat_map(segment_residuals).collect()
    }
}

impl Problem for MultipleShooting<'_> {
    type Worker = (Simulator, Vec<f64>);

    fn windows(&self) -> usize {
        self.segments.len()
    }
    fn own_unknowns(&self) -> usize {
        self.states()
    }
    fn bounds(&self) -> Vec<[f64; 2]> {
        self.structure.bounds(self.flights)
    }
    fn worker(&self, shared: &[f64]) -> Self::Worker {
        (Simulator::new(self.structure, self.integrated, shared), shared.to_vec())
    }
    fn normal_equations(&self, worker: &mut Self::Worker, window: usize, own: &[f64]) -> NormalEquations {
        let (simulator, shared) = worker;
        let segment = &self.segments[window];
        let (states, dynamic) = (self.states(), self.structure.dynamic());
        let place = self.offset(segment.flight);
        let mut normal = NormalEquations::new(states + shared.len());
        let mut slopes = vec![0.0; states + shared.len()];
        let mut finite = true;
        simulator.run(segment, own, place.map_or(0.0, |i| shared[i]), |measured, y| {
            let common = states + dynamic;
            for (to, from) in slopes[..common].iter_mut().zip(&y.slope) {
                *to = f64::from(*from) / self.sigma;
            }
            if let Some(place) = place {
                slopes[states + place] = f64::from(y.slope[common]) / self.sigma;
            }
            finite &= y.value.is_finite();
            normal.add((measured - y.value) / self.sigma, &slopes);
        });
        normal.symmetrise();
        if !finite || !normal.loss.is_finite() {
            normal.loss = f64::INFINITY;
        }
        normal
    }
}

/// The best fit from the best candidates, and the noise level that goes with it. `None` without a candidate
/// that can be simulated.
pub(super) fn fit_best(
    records: &[Record],
    structure: &Structure,
    segments: &[Segment],
    candidates: &[Vec<f64>],
) -> Option<(Solution, f64)> {
    let samples: Vec<f64> = segments.iter().flat_map(Segment::samples).collect();
    let spread = standard_deviation(&samples).max(1e-12);
    let integrated = records.first().is_some_and(|r| r.integrated);
    let mut shooting =
        MultipleShooting { structure, segments, flights: records.len(), integrated, sigma: 0.1 * spread };
    let mut starts: Vec<(f64, Vec<f64>, Vec<Vec<f64>>)> = Vec::new();
    for candidate in candidates {
        let mut numbers = candidate.clone();
        for (number, [low, high]) in numbers.iter_mut().zip(shooting.bounds()) {
            *number = number.clamp(low, high);
        }
        starts.extend(shooting.settle(&numbers).map(|(own, loss)| (loss, numbers, own)));
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    starts.truncate(STARTS);
    let fitted = starts.into_iter().map(|(_, numbers, own)| solve(&shooting, own, numbers));
    let fitted = fitted.filter(|fitted| fitted.loss.is_finite());
    let mut found = fitted.min_by(|a, b| a.loss.total_cmp(&b.loss))?;
    for _ in 0..ROUNDS {
        let sigma = robust_sd(shooting.residuals(&found.shared, &found.own).into_iter()).max(1e-9 * spread);
        let same = (sigma / shooting.sigma - 1.0).abs() < 0.02;
        shooting.sigma = sigma;
        found = solve(&shooting, found.own, found.shared);
        if same {
            break;
        }
    }
    Some((found, shooting.sigma))
}
