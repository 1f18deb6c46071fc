//! Search of gains by CMA-ES (Hansen 2016, "The CMA Evolution Strategy: A Tutorial") over their logarithms.
//!
//! It requests the costs of a generation at a time, so that a caller flies its candidates on threads or on a cluster.

use cmaes::{CMAESOptions, DVector};
use crazyflie_env::Error;

/// Logarithm of the largest factor between gains and their start, up or down.
const SPAN: f64 = 2.5;

/// A search that begins with some gains. The same costs lead to the same gains.
#[derive(Debug, Clone)]
pub struct GainSearch {
    start: Vec<f64>,
    step: f64,
    population: usize,
    seed: u64,
    /// Costs of all candidates so far, generation by generation.
    costs: Vec<f64>,
    /// Candidates whose costs are not known yet.
    asked: Vec<Vec<f64>>,
    best: Option<(f64, Vec<f64>)>,
}

impl GainSearch {
    /// `step` is the distance of the first candidates from the start: standard deviation of a gain's
    /// logarithm. A gain of 0 stays 0.
    ///
    /// # Errors
    /// [`Error::Config`] without gains, for a step that is not positive, and for a population of less than 2.
    pub fn new(start: &[f64], step: f64, population: usize, seed: u64) -> Result<GainSearch, Error> {
        let (start, costs, asked) = (start.to_vec(), Vec::new(), Vec::new());
        let search = GainSearch { start, step, population, seed, costs, asked, best: None };
        let built = search.options().build(|_: &DVector<f64>| 0.0);
        built.map(drop).map_err(|e| Error::Config(format!("the search cannot begin: {e:?}")))?;
        Ok(search)
    }

    fn options(&self) -> CMAESOptions {
        CMAESOptions::new(vec![0.0; self.start.len()], self.step / SPAN)
            .population_size(self.population)
            .seed(self.seed)
    }

    /// Gains of the next generation; none if the search has converged.
    pub fn ask(&mut self) -> Option<&[Vec<f64>]> {
        let mut points = Vec::new();
        // the crate wants each cost at once: what it was told is told again, up to the generation that is new
        let known = |point: &DVector<f64>| {
            points.push(point.clone());
            self.costs.get(points.len() - 1).copied().unwrap_or(0.0)
        };
        let mut search = self.options().build(known).ok()?;
        for _ in 0..self.costs.len() / self.population {
            if search.next().is_some() {
                return None;
            }
        }
        // it stops or goes on by costs that are not known yet
        let _ = search.next();
        drop(search);
        let gains_at = |point: &DVector<f64>| {
            self.start.iter().zip(point.iter()).map(|(gain, p)| gain * (SPAN * p.tanh()).exp()).collect()
        };
        self.asked = points[self.costs.len()..].iter().map(gains_at).collect();
        Some(&self.asked)
    }

    /// Receives the costs of the requested generation, in its order.
    ///
    /// # Errors
    /// [`Error::Config`] for another number of costs, and for a cost that is not a number.
    pub fn tell(&mut self, costs: &[f64]) -> Result<(), Error> {
        if costs.len() != self.asked.len() || costs.iter().any(|cost| cost.is_nan()) {
            return Err(Error::Config(format!(
                "costs: expected {} numbers, got {costs:?}",
                self.asked.len()
            )));
        }
        self.costs.extend(costs);
        for (cost, gains) in costs.iter().zip(self.asked.drain(..)) {
            if self.best.as_ref().is_none_or(|(least, _)| cost < least) {
                self.best = Some((*cost, gains));
            }
        }
        Ok(())
    }

    /// Gains that cost least so far.
    pub fn best(&self) -> Option<&[f64]> {
        self.best.as_ref().map(|(_, gains)| gains.as_slice())
    }

    /// Candidates so far.
    pub fn tried(&self) -> usize {
        self.costs.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squared distance of the logarithms from those of a target.
    fn cost(gains: &[f64], target: &[f64]) -> f64 {
        gains.iter().zip(target).map(|(a, b)| (a / b).ln().powi(2)).sum()
    }

    #[test]
    fn a_search_told_generation_by_generation_is_the_search_of_the_crate() {
        let (start, target) = ([2.0, 0.5, 8.0], [3.0, 0.1, 5.0]);
        let gains_at = |point: &DVector<f64>| -> Vec<f64> {
            start.iter().zip(point.iter()).map(|(gain, p)| gain * (SPAN * p.tanh()).exp()).collect()
        };
        let mut whole = CMAESOptions::new(vec![0.0; 3], 0.35)
            .population_size(10)
            .seed(71)
            .max_generations(40)
            .build(|point: &DVector<f64>| cost(&gains_at(point), &target))
            .unwrap();
        let expected = gains_at(&whole.run().overall_best.unwrap().point);
        let mut search = GainSearch::new(&start, 0.875, 10, 71).unwrap();
        for _ in 0..40 {
            let costs: Vec<f64> = search.ask().unwrap().iter().map(|gains| cost(gains, &target)).collect();
            search.tell(&costs).unwrap();
        }
        assert_eq!(search.best().unwrap(), expected);
        assert_eq!(search.tried(), whole.function_evals());
        assert!(cost(&expected, &target) < 1e-4, "{expected:?}");
    }

    #[test]
    fn a_search_ends_where_all_cost_the_same_and_refuses_what_is_no_cost() {
        let mut search = GainSearch::new(&[1.0, 0.0], 0.3, 4, 0).unwrap();
        assert!(search.ask().unwrap().iter().all(|gains| gains[0] != 1.0 && gains[1] == 0.0));
        assert!(search.tell(&[0.0; 3]).is_err() && search.tell(&[0.0, f64::NAN, 0.0, 0.0]).is_err());
        let mut generations = 0;
        while search.ask().is_some() && generations < 1000 {
            search.tell(&[1.0; 4]).unwrap();
            generations += 1;
        }
        assert!(generations < 1000 && search.ask().is_none());
        for (start, step, population) in
            [(&[][..], 0.3, 4), (&[1.0], 0.3, 1), (&[1.0], 0.0, 4), (&[1.0], f64::NAN, 4)]
        {
            assert!(GainSearch::new(start, step, population, 0).is_err(), "{start:?} {step} {population}");
        }
    }
}
