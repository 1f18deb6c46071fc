//! Start of a fit: the transfer function by linear least squares on filtered signals, so that nobody needs to guess.
//!
//! Input and output pass the filter 1 / L(s) of the denominator's degree; its states are their filtered derivatives,
//! and the transfer function becomes a linear equation between them. The unknown initial state adds the filter's own
//! free responses, an offset a constant. Then L is replaced by the denominator found, and again (Steiglitz and
//! McBride 1965). The simulation decides which L and delay were good.

use crazyflie_env::transfer_function::product;
use nalgebra::{Cholesky, DMatrix, DVector};

use super::channel::Record;
use super::structure::{Structure, roots};
use crate::replay::measurements::interpolate;

/// Poles of the first filter, 1/s: around those of a quadrotor's loops, from height to attitude.
const FILTERS_PS: [f64; 4] = [1.0, 4.0, 12.0, 35.0];
const DELAYS_S: [f64; 6] = [0.0, 0.02, 0.04, 0.07, 0.11, 0.16];
const ROUNDS: usize = 4;
/// Steps of the filters: finer than any log, so that what is held or interpolated between does not matter.
const STEP_S: f64 = 0.005;
/// Longer flights do not improve the start.
const LONGEST_S: f64 = 60.0;

/// Candidates for the numbers of [`Structure::function`].
pub(super) fn candidates(structure: &Structure, records: &[Record]) -> Vec<Vec<f64>> {
    let delays = if structure.delay { &DELAYS_S[..] } else { &DELAYS_S[..1] };
    let mut found = Vec::new();
    for delay_s in delays {
        let signals: Vec<GridSignals> = records.iter().map(|r| GridSignals::new(r, *delay_s)).collect();
        for filter_ps in FILTERS_PS {
            let n = structure.denominator + usize::from(records.first().is_some_and(|r| r.integrated));
            let mut filter = (0..n).fold(vec![1.0], |all, _| product(&all, &[1.0, filter_ps]));
            for _ in 0..ROUNDS {
                let Some((numbers, denominator)) = regress(structure, &signals, &filter, *delay_s) else {
                    break;
                };
                found.push(numbers);
                filter = stabilise(&denominator);
            }
        }
        // poles from a grid: where derivatives drown in noise, gains alone can still be found
        for (i, slow_ps) in FILTERS_PS.iter().enumerate() {
            for fast_ps in &FILTERS_PS[i..] {
                let poles = structure.denominator - usize::from(structure.integrator);
                let factor = |k: usize| [1.0, if k == 0 { *slow_ps } else { *fast_ps }];
                let denominator = (0..poles).fold(vec![1.0], |all, k| product(&all, &factor(k)));
                found.extend(gains(structure, &signals, records, &denominator, *delay_s));
            }
        }
    }
    found
}

/// The numerator and offsets that fit best with these poles.
fn gains(
    structure: &Structure,
    flights: &[GridSignals],
    records: &[Record],
    poles: &[f64],
    delay_s: f64,
) -> Option<Vec<f64>> {
    let zeros =
        usize::from(structure.integrator) + usize::from(records.first().is_some_and(|r| r.integrated));
    let whole: Vec<f64> = poles.iter().copied().chain(std::iter::repeat_n(0.0, zeros)).collect();
    let equation = Equation::solve(structure, flights, &whole, true)?;
    Some(equation.numbers(structure, poles, delay_s)).filter(|numbers| numbers.iter().all(|v| v.is_finite()))
}

/// Input and output on a fine grid, each the value at the middle of a step.
struct GridSignals {
    input: Vec<f64>,
    output: Vec<f64>,
}

impl GridSignals {
    fn new(record: &Record, delay_s: f64) -> Self {
        let [from_s, to_s] = record.span_s;
        let from_s = from_s.max(record.output_t_s[0]);
        let steps = ((to_s - from_s).min(LONGEST_S) / STEP_S) as usize;
        let middle = |k: usize| from_s + (k as f64 + 0.5) * STEP_S;
        let input = (0..steps).map(|k| record.input_at(middle(k) - delay_s)).collect();
        GridSignals {
            input,
            output: (0..steps).map(|k| interpolate(&record.output_t_s, &record.output, middle(k))).collect(),
        }
    }
}

/// 1 / L(s) by exact steps of a held input: its states are the filtered signal and its derivatives, lowest
/// first.
struct StateVariableFilter {
    state: DMatrix<f64>,
    input: DVector<f64>,
    /// L without its leading one, lowest first.
    l: Vec<f64>,
}

impl StateVariableFilter {
    fn new(filter: &[f64]) -> Self {
        let n = filter.len() - 1;
        let l: Vec<f64> = filter[1..].iter().rev().copied().collect();
        let mut m = DMatrix::zeros(n + 1, n + 1);
        for i in 0..n {
            if i + 1 < n {
                m[(i, i + 1)] = STEP_S;
            }
            m[(n - 1, i)] -= l[i] * STEP_S;
        }
        m[(n - 1, n)] = STEP_S;
        let e = m.exp();
        let input = e.view((0, n), (n, 1)).column(0).into_owned();
        StateVariableFilter { state: e.view((0, 0), (n, n)).into_owned(), input, l }
    }

    /// Filtered derivatives 0 to n of a signal, a row per step.
    fn apply(&self, signal: impl Iterator<Item = f64>, start: DVector<f64>) -> Vec<Vec<f64>> {
        let mut x = start;
        let row = |value: f64| {
            x = &self.state * &x + &self.input * value;
            let highest = value - self.l.iter().zip(x.iter()).map(|(l, x)| l * x).sum::<f64>();
            x.iter().copied().chain([highest]).collect()
        };
        signal.map(row).collect()
    }
}

/// The numbers and the whole denominator that fit the filtered equation best.
fn regress(
    structure: &Structure,
    flights: &[GridSignals],
    filter: &[f64],
    delay_s: f64,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let equation = Equation::solve(structure, flights, filter, false)?;
    let denominator: Vec<f64> = std::iter::once(1.0).chain(equation.poles.iter().rev().copied()).collect();
    let zeros = filter.len() - denominator.len();
    let whole = denominator.iter().copied().chain(std::iter::repeat_n(0.0, zeros)).collect();
    let numbers = equation.numbers(structure, &denominator, delay_s);
    numbers.iter().all(|v| v.is_finite()).then_some((numbers, whole))
}

/// The filtered linear equation, solved; coefficients lowest first.
struct Equation {
    poles: Vec<f64>,
    gains: Vec<f64>,
    /// One per offset.
    constants: Vec<f64>,
}

impl Equation {
    fn solve(structure: &Structure, flights: &[GridSignals], filter: &[f64], known: bool) -> Option<Self> {
        let n = filter.len() - 1;
        if n < structure.denominator {
            // roots that are no numbers were lost on the way
            return None;
        }
        let filtering = StateVariableFilter::new(filter);
        // integrators within and behind the transfer function: the lowest coefficients are zero
        let zeros = n - structure.denominator + usize::from(structure.integrator);
        let (poles, gains) = (if known { 0 } else { n - zeros }, structure.numerator + 1);
        // an offset of the input is a constant in the equation
        let constants = structure.offsets(flights.len());
        let own = poles + gains + constants;
        let columns = own + n * flights.len();
        let (mut h, mut g) = (DMatrix::zeros(columns, columns), DVector::zeros(columns));
        for (flight, signals) in flights.iter().enumerate() {
            let at_rest = || DVector::zeros(n);
            let y = filtering.apply(signals.output.iter().copied(), at_rest());
            let u = filtering.apply(signals.input.iter().copied(), at_rest());
            let constant = filtering.apply(signals.input.iter().map(|_| 1.0), at_rest());
            let mut kick = at_rest();
            kick[n - 1] = 1.0;
            let free = filtering.apply(signals.input.iter().map(|_| 0.0), kick);
            for k in 0..y.len() {
                let mut row = vec![0.0; columns];
                (0..poles).for_each(|i| row[i] = -y[k][zeros + i]);
                (0..gains).for_each(|i| row[poles + i] = u[k][i]);
                if constants > 0 {
                    row[poles + gains + flight.min(constants - 1)] = constant[k][0];
                }
                // y starts anywhere: the filter's own responses
                (0..n).for_each(|i| row[own + n * flight + i] = free[k][i]);
                let target = if known { signals.output[k] } else { y[k][n] };
                accumulate(&mut h, &mut g, &row, target);
            }
        }
        let x = scaled_solve(h, &g)?;
        let part = |from: usize, count: usize| x.rows(from, count).iter().copied().collect();
        let constants = part(poles + gains, constants);
        Some(Equation { poles: part(0, poles), gains: part(poles, gains), constants })
    }

    /// Returns the numbers that [`Structure::function`] takes.
    fn numbers(&self, structure: &Structure, denominator: &[f64], delay_s: f64) -> Vec<f64> {
        let mut numbers: Vec<f64> = self.gains.iter().rev().copied().collect();
        numbers.extend(structure.numbers_of(denominator));
        numbers.extend(structure.delay.then_some(delay_s));
        let least = self.gains[0];
        numbers.extend(self.constants.iter().map(|c| if least == 0.0 { 0.0 } else { -c / least }));
        numbers
    }
}

fn accumulate(h: &mut DMatrix<f64>, g: &mut DVector<f64>, row: &[f64], value: f64) {
    for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
        g[i] += a * value;
        for (j, b) in row.iter().enumerate() {
            h[(i, j)] += a * b;
        }
    }
}

/// Columns differ in size as derivatives do; what nothing depends on stays zero.
pub(super) fn scaled_solve(h: DMatrix<f64>, g: &DVector<f64>) -> Option<DVector<f64>> {
    let n = g.len();
    let size: Vec<f64> = (0..n).map(|i| h[(i, i)].sqrt()).map(|s| if s > 0.0 { s } else { 1.0 }).collect();
    let scaled =
        DMatrix::from_fn(n, n, |i, j| h[(i, j)] / (size[i] * size[j]) + if i == j { 1e-11 } else { 0.0 });
    let right = DVector::from_fn(n, |i, _| g[i] / size[i]);
    let x = Cholesky::new(scaled)?.solve(&right);
    Some(DVector::from_fn(n, |i, _| x[i] / size[i]))
}

/// A denominator fit to filter by: roots to the right are mirrored, those at zero moved a little to the left.
fn stabilise(denominator: &[f64]) -> Vec<f64> {
    let mut stable = vec![1.0];
    for root in roots(denominator) {
        // no faster than the grid resolves
        let (re, im) = ((-root.re.abs()).clamp(-150.0, -0.3), root.im.clamp(-150.0, 150.0));
        if im == 0.0 {
            stable = product(&stable, &[1.0, -re]);
        } else if im > 0.0 {
            stable = product(&stable, &[1.0, -2.0 * re, re * re + im * im]);
        }
    }
    stable
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_is_stepped_exactly() {
        // 1 / (s + 2) of a constant one, and its derivative
        let rows = StateVariableFilter::new(&[1.0, 2.0]).apply([1.0; 100].into_iter(), DVector::zeros(1));
        let t = 100.0 * STEP_S;
        assert!((rows[99][0] - 0.5 * (1.0 - (-2.0 * t).exp())).abs() < 1e-12);
        assert!((rows[99][1] - (-2.0 * t).exp()).abs() < 1e-12);
    }

    #[test]
    fn a_filter_is_stable_whatever_was_found() {
        let steady = stabilise(&product(&[1.0, -3.0], &[1.0, 0.0]));
        for root in roots(&steady) {
            assert!(root.re <= -0.29, "{root}");
        }
        assert_eq!(stabilise(&[1.0, 2.0, 5.0]).len(), 3);
    }
}
