//! Least squares over many windows: every window has unknowns of its own (the state it starts from), all
//! share the parameters. The windows' unknowns are eliminated by a Schur complement, the step is Levenberg
//! and Marquardt's, the loss is Huber's, and parameters stay in bounds.

use std::collections::BTreeMap;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::huber::huber;

/// The fit has converged when the loss, a negative log-likelihood, falls by less.
pub const ENOUGH: f64 = 0.01;
const MOST_STEPS: usize = 40;

/// Normal equations of independent data: the loss, its gradient and its curvature (Gauss-Newton). Unknowns of a window
/// are its own, then the shared.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    /// Sum of Huber's loss over the residuals.
    pub loss: f64,
    /// Weighted sum of slopes times residuals, one entry per unknown: downhill.
    pub gradient: DVector<f64>,
    /// Weighted sum of products of two slopes; only the upper triangle until [`NormalEquations::symmetrise`].
    pub information: DMatrix<f64>,
}

impl NormalEquations {
    /// Makes the equations of no residuals in so many unknowns.
    pub fn new(unknowns: usize) -> Self {
        let (gradient, information) = (DVector::zeros(unknowns), DMatrix::zeros(unknowns, unknowns));
        NormalEquations { loss: 0.0, gradient, information }
    }

    /// Adds the equations of other data in the same unknowns.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        self.loss += other.loss;
        self.gradient += &other.gradient;
        self.information += &other.information;
        self
    }

    /// Add a residual in standard deviations and the slopes of the prediction, in the same unit.
    pub fn add(&mut self, residual: f64, slopes: &[f64]) {
        let (loss, weight) = huber(residual);
        self.loss += loss;
        let n = slopes.len();
        let information = self.information.as_mut_slice();
        for (j, slope) in slopes.iter().enumerate() {
            let by = weight * slope;
            if by == 0.0 {
                continue;
            }
            self.gradient[j] += by * residual;
            for (entry, other) in information[j * n..=j * n + j].iter_mut().zip(slopes) {
                *entry += by * other;
            }
        }
    }

    /// Only one triangle was added to.
    pub fn symmetrise(&mut self) {
        self.information.fill_lower_triangle_with_upper_triangle();
    }
}

/// Normal prior of one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Expected value.
    pub mean: f64,
    /// Standard deviation, above 0.
    pub sd: f64,
}

/// A least-squares problem of windows.
pub trait Problem: Sync {
    /// State that a thread prepares once for given shared parameters.
    type Worker;
    /// Returns the number of windows.
    fn windows(&self) -> usize;
    /// Unknowns of each window.
    fn own_unknowns(&self) -> usize;
    /// Lower and upper bound of each shared parameter.
    fn bounds(&self) -> Vec<[f64; 2]>;
    /// With fewer windows, preparing a worker costs more than a second thread brings.
    fn windows_per_worker(&self) -> usize {
        6
    }
    /// Prepares the state of a thread for these values of the shared parameters.
    fn worker(&self, shared: &[f64]) -> Self::Worker;
    /// Returns the number of shared parameters, the first ones, that are common to all windows. Others belong to
    /// groups of windows, such as those of one flight.
    fn common(&self) -> usize {
        self.bounds().len()
    }
    /// Returns the shared parameters that a window depends on, by their places among all; those of all windows are
    /// first.
    fn places(&self, _window: usize) -> Vec<usize> {
        (0..self.bounds().len()).collect()
    }
    /// The prior of each shared parameter; empty where nothing is known of any.
    fn priors(&self) -> Vec<Option<Prior>> {
        Vec::new()
    }
    /// The normal equations of a window. A state that is not finite has an infinite loss.
    fn normal_equations(&self, worker: &mut Self::Worker, window: usize, own: &[f64]) -> NormalEquations;
}

/// Values and equations at which the fit ended.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Fitted values of the shared parameters.
    pub shared: Vec<f64>,
    /// Fitted unknowns of each window.
    pub own: Vec<Vec<f64>>,
    /// Negative log-likelihood, up to a constant.
    pub loss: f64,
    /// Equations of each window in the parameters that all windows share, its own unknowns eliminated.
    pub reduced: Vec<NormalEquations>,
    /// Convergence: the fit ended because no step gained enough, not at the limit of steps.
    pub converged: bool,
}

/// A window's equations with the factor of its own block.
struct WindowElimination {
    factor: Cholesky<f64, Dyn>,
    coupling: DMatrix<f64>,
    own_gradient: DVector<f64>,
    reduced: NormalEquations,
}

fn eliminate(normal: &NormalEquations, own: usize, damping: f64) -> Option<WindowElimination> {
    let shared = normal.gradient.len() - own;
    let mut block = normal.information.view((0, 0), (own, own)).into_owned();
    for i in 0..own {
        // an unknown that nothing depends on stays where it is
        block[(i, i)] += damping * block[(i, i)] + 1e-9 * (1.0 + block[(i, i)]);
    }
    let factor = Cholesky::new(block)?;
    let coupling = normal.information.view((0, own), (own, shared)).into_owned();
    let own_gradient = normal.gradient.rows(0, own).into_owned();
    let solved = factor.solve(&coupling);
    let information = normal.information.view((own, own), (shared, shared)) - solved.tr_mul(&coupling);
    let gradient = normal.gradient.rows(own, shared) - solved.tr_mul(&own_gradient);
    let reduced = NormalEquations { loss: normal.loss, gradient, information };
    Some(WindowElimination { factor, coupling, own_gradient, reduced })
}

/// Computes the step in the shared parameters, with those fixed at a bound that it would leave.
fn shared_step(sum: &NormalEquations, damping: f64, at: &[f64], bounds: &[[f64; 2]]) -> Option<DVector<f64>> {
    let NormalEquations { gradient, information, .. } = sum;
    let n = gradient.len();
    let mut held = vec![false; n];
    loop {
        let mut system = information.clone();
        let mut right = gradient.clone();
        for i in 0..n {
            system[(i, i)] += damping * information[(i, i)] + 1e-12 * (1.0 + information[(i, i)]);
            if held[i] {
                system.row_mut(i).fill(0.0);
                system.column_mut(i).fill(0.0);
                system[(i, i)] = 1.0;
                right[i] = 0.0;
            }
        }
        let step = Cholesky::new(system)?.solve(&right);
        let leaves =
            |i: usize| (at[i] <= bounds[i][0] && step[i] < 0.0) || (at[i] >= bounds[i][1] && step[i] > 0.0);
        match (0..n).find(|i| !held[*i] && leaves(*i)) {
            Some(i) => held[i] = true,
            None => return Some(step),
        }
    }
}

/// Gradient and information of all windows, each with the places of its parameters among all, and of the
/// priors.
fn sum_equations<'a>(
    windows: impl Iterator<Item = (&'a NormalEquations, &'a Vec<usize>)>,
    priors: &[Option<Prior>],
    shared: &[f64],
) -> NormalEquations {
    let mut sum = NormalEquations::new(shared.len());
    let NormalEquations { gradient, information, .. } = &mut sum;
    for (window, places) in windows {
        for (j, to) in places.iter().enumerate() {
            gradient[*to] += window.gradient[j];
            for (i, row) in places.iter().enumerate() {
                information[(*row, *to)] += window.information[(i, j)];
            }
        }
    }
    for (i, prior) in priors.iter().enumerate() {
        if let Some(Prior { mean, sd }) = prior {
            gradient[i] += (mean - shared[i]) / (sd * sd);
            information[(i, i)] += 1.0 / (sd * sd);
        }
    }
    sum
}

fn prior_loss(priors: &[Option<Prior>], shared: &[f64]) -> f64 {
    let losses = priors.iter().zip(shared);
    losses.filter_map(|(prior, value)| prior.map(|p| 0.5 * ((value - p.mean) / p.sd).powi(2))).sum()
}

/// Reduced equations of each window in the `common` parameters, those of its group eliminated. The prior of a
/// group's parameter counts with the first window of the group.
fn eliminate_groups(
    windows: Vec<NormalEquations>,
    places: &[Vec<usize>],
    priors: &[Option<Prior>],
    shared: &[f64],
    common: usize,
) -> Vec<NormalEquations> {
    let groups = shared.len() - common;
    if groups == 0 {
        return windows;
    }
    let information = sum_equations(windows.iter().zip(places), priors, shared).information;
    let of_groups = information.view((common, common), (groups, groups)).into_owned();
    let Some(inverse) = pseudo_inverse(&of_groups) else { return Vec::new() };
    let inverse = inverse.map(|v| if v.is_finite() { v } else { 0.0 });
    let taken = information.view((0, common), (common, groups)) * inverse;
    let eliminate = |(window, places): (NormalEquations, &Vec<usize>)| {
        let onto = DMatrix::from_fn(common, places.len(), |i, j| match places[j].checked_sub(common) {
            Some(group) => -taken[(i, group)],
            None => f64::from(u8::from(places[j] == i)),
        });
        NormalEquations {
            gradient: &onto * &window.gradient,
            information: &onto * &window.information * onto.transpose(),
            ..window
        }
    };
    let mut eliminated: Vec<NormalEquations> = windows.into_iter().zip(places).map(eliminate).collect();
    for (i, prior) in priors.iter().enumerate().skip(common) {
        let first = places.iter().position(|places| places.contains(&i));
        if let (Some(Prior { mean, sd }), Some(first)) = (prior, first) {
            let onto = -taken.column(i - common);
            eliminated[first].gradient.axpy((mean - shared[i]) / (sd * sd), &onto, 1.0);
            eliminated[first].information.ger(1.0 / (sd * sd), &onto, &onto, 1.0);
        }
    }
    eliminated
}

/// Minimise from a start: `own` per window, `shared` for all.
pub fn solve(problem: &impl Problem, own: Vec<Vec<f64>>, shared: Vec<f64>) -> Solution {
    solve_within(problem, own, shared, MOST_STEPS, ENOUGH)
}

/// Solves like [`solve`], stopping after so many steps, converged or not, or when one gains less than `enough`.
pub fn solve_within(
    problem: &impl Problem,
    mut own: Vec<Vec<f64>>,
    mut shared: Vec<f64>,
    most_steps: usize,
    enough: f64,
) -> Solution {
    let (n, bounds, priors) = (problem.own_unknowns(), problem.bounds(), problem.priors());
    let places: Vec<Vec<usize>> = (0..problem.windows()).map(|w| problem.places(w)).collect();
    let evaluate = |own: &[Vec<f64>], shared: &[f64]| -> Vec<NormalEquations> {
        let windows = (0..problem.windows()).into_par_iter().with_min_len(problem.windows_per_worker());
        windows
            .map_init(|| problem.worker(shared), |worker, w| problem.normal_equations(worker, w, &own[w]))
            .collect()
    };
    let loss_of = |normals: &[NormalEquations], shared: &[f64]| {
        normals.iter().map(|n| n.loss).sum::<f64>() + prior_loss(&priors, shared)
    };
    let mut normals = evaluate(&own, &shared);
    let (mut loss, mut damping, mut steps, mut converged) = (loss_of(&normals, &shared), 1e-4, 0, false);
    while steps < most_steps && !converged && damping < 1e9 {
        steps += 1;
        let eliminated: Option<Vec<WindowElimination>> =
            normals.iter().map(|normal| eliminate(normal, n, damping)).collect();
        let stepped = eliminated.and_then(|all| {
            let sum = sum_equations(all.iter().map(|e| &e.reduced).zip(&places), &priors, &shared);
            let step = shared_step(&sum, damping, &shared, &bounds)?;
            let next: Vec<f64> =
                (0..shared.len()).map(|i| (shared[i] + step[i]).clamp(bounds[i][0], bounds[i][1])).collect();
            let follow = |((e, at), places): ((&WindowElimination, &Vec<f64>), &Vec<usize>)| {
                let moved = places.iter().map(|i| next[*i] - shared[*i]);
                let moved = DVector::from_iterator(places.len(), moved);
                let step = e.factor.solve(&(&e.own_gradient - &e.coupling * &moved));
                at.iter().zip(step.iter()).map(|(a, s)| a + s).collect()
            };
            let next_own: Vec<Vec<f64>> = all.iter().zip(&own).zip(&places).map(follow).collect();
            Some((next_own, next))
        });
        let Some((next_own, next)) = stepped else {
            damping *= 10.0;
            continue;
        };
        let trial = evaluate(&next_own, &next);
        let trial_loss = loss_of(&trial, &next);
        if trial_loss < loss {
            converged = loss - trial_loss < enough;
            (own, shared, normals, loss) = (next_own, next, trial, trial_loss);
            damping = (damping * 0.1).max(1e-10);
        } else {
            converged = trial_loss - loss < 1e-9 * loss.abs() && damping <= 1e-4;
            damping *= 10.0;
        }
    }
    let eliminated = normals
        .iter()
        .zip(places)
        .filter_map(|(normal, places)| Some((eliminate(normal, n, 0.0)?.reduced, places)));
    let (reduced, places): (Vec<NormalEquations>, Vec<Vec<usize>>) = eliminated.unzip();
    let reduced = eliminate_groups(reduced, &places, &priors, &shared, problem.common());
    Solution { shared, own, loss, reduced, converged: converged || damping >= 1e9 }
}

impl Solution {
    /// Covariance of the shared parameters, clustered by `cluster` (one number per window): windows of one
    /// flight, and neighbours under one gust, are not independent.
    pub fn covariance(&self, cluster: &[usize]) -> Option<DMatrix<f64>> {
        let n = self.reduced.first()?.gradient.len();
        let mut clusters = BTreeMap::new();
        for (window, cluster) in self.reduced.iter().zip(cluster) {
            let sum = clusters.remove(cluster).unwrap_or_else(|| NormalEquations::new(n));
            clusters.insert(*cluster, sum.plus(window));
        }
        cluster_robust_covariance(&clusters.into_values().collect::<Vec<_>>())
    }

    /// The information of all windows about what they share.
    pub fn information(&self) -> DMatrix<f64> {
        let n = self.reduced.first().map_or(self.shared.len(), |window| window.gradient.len());
        self.reduced.iter().fold(DMatrix::zeros(n, n), |sum, window| sum + &window.information)
    }
}

/// Cluster-robust covariance of fitted parameters: a sandwich over clusters, as if each had been left out in
/// turn (CR3; Bell and McCaffrey 2002, Survey Methodology 28). A cluster that decides a parameter nearly
/// alone pulls the fit to itself and hides its own error.
pub(crate) fn cluster_robust_covariance(clusters: &[NormalEquations]) -> Option<DMatrix<f64>> {
    let n = clusters.first()?.gradient.len();
    let information = clusters.iter().fold(DMatrix::zeros(n, n), |sum, c| sum + &c.information);
    let bread = pseudo_inverse(&information)?;
    let count = clusters.len() as f64;
    let mut sum = DMatrix::zeros(n, n);
    for cluster in clusters {
        let others =
            pseudo_inverse(&(&information - &cluster.information)).map(|inverse| inverse * &cluster.gradient);
        // a number that one cluster alone determines has no spread between clusters
        let moved =
            others.filter(|m| m.iter().all(|v| v.is_finite())).unwrap_or_else(|| &bread * &cluster.gradient);
        sum.ger((count - 1.0).max(1.0) / count, &moved, &moved, 1.0);
    }
    // by chance it may come out too small: never below what white noise would give
    Some(DMatrix::from_fn(n, n, |i, j| if i == j { sum[(i, j)].max(bread[(i, j)]) } else { sum[(i, j)] }))
}

/// The inverse, after scaling to a unit diagonal; a parameter without any information gets an infinite
/// variance.
pub(crate) fn pseudo_inverse(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = information.nrows();
    let scale: Vec<f64> = (0..n).map(|i| information[(i, i)].max(0.0).sqrt()).collect();
    let known: Vec<usize> = (0..n).filter(|i| scale[*i] > 0.0).collect();
    let scaled = DMatrix::from_fn(known.len(), known.len(), |i, j| {
        let (a, b) = (known[i], known[j]);
        information[(a, b)] / (scale[a] * scale[b]) + if i == j { 1e-10 } else { 0.0 }
    });
    let inverse = Cholesky::new(scaled)?.inverse();
    let mut all = DMatrix::from_diagonal_element(n, n, f64::INFINITY);
    for (i, a) in known.iter().enumerate() {
        for (j, b) in known.iter().enumerate() {
            all[(*a, *b)] = inverse[(i, j)] / (scale[*a] * scale[*b]);
        }
    }
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = offset_w + slope x + curve x^2 with an outlier in each window.
    struct Lines {
        data: Vec<Vec<(f64, f64)>>,
    }

    impl Problem for Lines {
        type Worker = Vec<f64>;
        fn worker(&self, shared: &[f64]) -> Vec<f64> {
            shared.to_vec()
        }
        fn windows(&self) -> usize {
            self.data.len()
        }
        fn own_unknowns(&self) -> usize {
            1
        }
        fn bounds(&self) -> Vec<[f64; 2]> {
            vec![[-10.0, 10.0], [-10.0, 0.2]]
        }
        fn normal_equations(&self, shared: &mut Vec<f64>, window: usize, own: &[f64]) -> NormalEquations {
            let mut normal = NormalEquations::new(3);
            for (x, y) in &self.data[window] {
                // exponential in the slope, so that one Gauss-Newton step does not do it
                let (e, bent) = ((shared[0] * x).exp(), shared[1] * x * x);
                normal.add((y - own[0] - e - bent) / 0.01, &[1.0 / 0.01, x * e / 0.01, x * x / 0.01]);
            }
            normal.symmetrise();
            normal
        }
    }

    fn lines(curve: f64) -> Lines {
        let window = |w: usize| {
            let point = |i: usize| {
                let x = i as f64 / 20.0;
                let noise = 0.01 * ((w * 31 + i * 17) as f64 * 1.7).sin();
                let outlier = if i == (w * 7) % 20 { 0.3 } else { 0.0 };
                (x, w as f64 + (0.8 * x).exp() + curve * x * x + noise + outlier)
            };
            (0..20).map(point).collect()
        };
        Lines { data: (0..10).map(window).collect() }
    }

    #[test]
    fn shared_parameters_are_found_beside_the_windows_own() {
        let found = solve(&lines(0.1), vec![vec![0.0]; 10], vec![0.1, 0.0]);
        assert!(found.converged);
        assert!(
            (found.shared[0] - 0.8).abs() < 0.02 && (found.shared[1] - 0.1).abs() < 0.03,
            "{:?}",
            found.shared
        );
        assert!((found.own[4][0] - 4.0).abs() < 0.02, "{:?}", found.own[4]);
        let sd = found.covariance(&(0..10).collect::<Vec<_>>()).unwrap();
        // the inverse of the information that 20 points, one of them an outlier of weight 0.1, give in each
        // of 10 windows
        assert!((sd[(0, 0)].sqrt() / 0.0128 - 1.0).abs() < 0.1, "{sd}");
    }

    /// The same lines in pairs of windows, each pair with an offset of its own beside the windows' own
    /// slopes: x enters as `own x`.
    struct Pairs(Lines);

    impl Problem for Pairs {
        type Worker = Vec<f64>;
        fn worker(&self, shared: &[f64]) -> Vec<f64> {
            shared.to_vec()
        }
        fn windows(&self) -> usize {
            self.0.data.len()
        }
        fn own_unknowns(&self) -> usize {
            1
        }
        fn bounds(&self) -> Vec<[f64; 2]> {
            vec![[-10.0, 10.0]; 1 + self.windows() / 2]
        }
        fn common(&self) -> usize {
            1
        }
        fn places(&self, window: usize) -> Vec<usize> {
            vec![0, 1 + window / 2]
        }
        fn priors(&self) -> Vec<Option<Prior>> {
            let offset = Some(Prior { mean: 0.0, sd: 100.0 });
            std::iter::once(None).chain(std::iter::repeat_n(offset, self.windows() / 2)).collect()
        }
        fn normal_equations(&self, shared: &mut Vec<f64>, window: usize, own: &[f64]) -> NormalEquations {
            let mut normal = NormalEquations::new(3);
            for (x, y) in &self.0.data[window] {
                let predicted = own[0] * x + shared[0] * x * x + shared[1 + window / 2];
                normal.add((y - predicted) / 0.01, &[x / 0.01, x * x / 0.01, 1.0 / 0.01]);
            }
            normal.symmetrise();
            normal
        }
    }

    #[test]
    fn parameters_of_groups_are_found_and_their_uncertainty_passes_to_the_common_ones() {
        let point = |w: usize, i: usize| {
            let x = i as f64 / 20.0;
            (
                x,
                (w / 2) as f64
                    + 0.3 * w as f64 * x
                    + 0.7 * x * x
                    + 0.01 * ((w * 31 + i * 17) as f64 * 1.7).sin(),
            )
        };
        let pairs = Pairs(Lines { data: (0..10).map(|w| (0..20).map(|i| point(w, i)).collect()).collect() });
        let found = solve(&pairs, vec![vec![0.0]; 10], vec![0.0; 6]);
        assert!(
            (found.shared[0] - 0.7).abs() < 0.02 && (found.shared[4] - 3.0).abs() < 0.01,
            "{:?}",
            found.shared
        );
        // the textbook's covariance: the inverse of the whole design with all offsets and slopes in it
        let columns = 1 + 5 + 10;
        let mut whole = DMatrix::zeros(columns, columns);
        for w in 0..10 {
            for (x, _) in &pairs.0.data[w] {
                let mut row = DVector::zeros(columns);
                (row[0], row[1 + w / 2], row[6 + w]) = (x * x / 0.01, 100.0, x / 0.01);
                whole += &row * row.transpose();
            }
        }
        let textbook = Cholesky::new(whole).unwrap().inverse()[(0, 0)];
        let variance = 1.0 / found.information()[(0, 0)];
        assert!((variance / textbook - 1.0).abs() < 1e-3, "{variance} {textbook}");
        // five clusters tell a variance to within a small factor
        let clustered = found.covariance(&[0, 0, 1, 1, 2, 2, 3, 3, 4, 4]).unwrap()[(0, 0)];
        assert!((0.02..50.0).contains(&(clustered / variance)), "{clustered} {variance}");
    }

    #[test]
    fn a_prior_holds_what_the_data_do_not_say() {
        let mut pairs = Pairs(lines(0.0));
        pairs.0.data[8].clear();
        pairs.0.data[9].clear();
        let found = solve(&pairs, vec![vec![0.0]; 10], vec![0.0, 0.0, 0.0, 0.0, 0.0, 5.0]);
        assert!(found.shared[5].abs() < 1e-6, "{:?}", found.shared);
    }

    #[test]
    fn bounds_hold() {
        let found = solve(&lines(0.5), vec![vec![0.0]; 10], vec![0.1, 0.0]);
        assert_eq!(found.shared[1], 0.2);
        assert!(found.converged);
    }

    #[test]
    fn of_a_mean_the_clustered_error_is_the_textbooks() {
        let values = [2.0, 3.5, 1.0, 4.0, 2.5, 9.0];
        let mean = values.iter().sum::<f64>() / 6.0;
        // each is known to a tenth, far less than their scatter
        let known = 100.0;
        let cluster = |v: f64| NormalEquations {
            loss: 0.0,
            gradient: DVector::from_element(1, known * (v - mean)),
            information: DMatrix::from_element(1, 1, known),
        };
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (6.0 * 5.0);
        let found = cluster_robust_covariance(&values.map(cluster)).unwrap()[(0, 0)];
        assert!((found / variance - 1.0).abs() < 1e-6, "{found} {variance}");
    }

    #[test]
    fn a_parameter_without_information_has_an_infinite_variance() {
        let inverse = pseudo_inverse(&DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 0.0])).unwrap();
        assert!((inverse[(0, 0)] - 0.25).abs() < 1e-9 && inverse[(1, 1)].is_infinite());
    }
}
