//! The linear-quadratic regulator of a discrete model.

use nalgebra::{SMatrix, SVector};

use crazyflie_env::error::{Error, Result};

/// Doublings: each squares the distance to the solution, so that 30 reach 2^30 ticks.
const DOUBLINGS: usize = 30;

/// The gain K of u = -K x that minimises the sum of x' Q x + u' R u over x+ = A x + B u, with diagonal Q and
/// R.
///
/// By the structure-preserving doubling algorithm (Chu, Fan, Lin, Wang: Structure-preserving algorithms for
/// periodic discrete-time algebraic Riccati equations, Int. J. Control 77, 2004).
///
/// # Errors
/// [`Error::Config`] where no gain stabilises what costs.
pub fn regulator<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SVector<f64, N>,
    r: &SVector<f64, M>,
) -> Result<SMatrix<f64, M, N>> {
    let p = solve(a, b, q, r)?;
    let total = SMatrix::from_diagonal(r) + b.transpose() * p * b;
    let inverse = total.try_inverse().ok_or_else(unsolved)?;
    let gain = inverse * b.transpose() * p * a;
    if gain.iter().all(|k| k.is_finite()) { Ok(gain) } else { Err(unsolved()) }
}

/// P of the discrete algebraic Riccati equation: what is left to pay from x is x' P x.
///
/// # Errors
/// The errors of [`regulator`].
pub fn solve<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SVector<f64, N>,
    r: &SVector<f64, M>,
) -> Result<SMatrix<f64, N, N>> {
    let (mut a, mut h) = (*a, SMatrix::<f64, N, N>::from_diagonal(q));
    let mut g = b * SMatrix::from_diagonal(&r.map(|r| 1.0 / r)) * b.transpose();
    for _ in 0..DOUBLINGS {
        let w = (SMatrix::identity() + g * h).try_inverse().ok_or_else(unsolved)?;
        let (v, more) = (w * a, a.transpose() * h * w * a);
        g += a * w * g * a.transpose();
        h += more;
        a *= v;
        if more.amax() <= 1e-14 * h.amax() {
            break;
        }
    }
    // doubling keeps the symmetry but for roundings
    Ok((h + h.transpose()) * 0.5)
}

fn unsolved() -> Error {
    Error::Config("no gain stabilises this model: a mode that costs cannot be reached by any command".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_satisfies_the_equation() {
        let a = SMatrix::<f64, 3, 3>::new(1.0, 0.1, 0.005, 0.0, 1.0, 0.1, 0.0, 0.0, 0.9);
        let (b, q, r) =
            (SVector::from([0.0, 0.01, 0.3]), SVector::from([4.0, 1.0, 0.0]), SVector::from([0.5]));
        let p = solve(&a, &b, &q, &r).unwrap();
        let k = regulator(&a, &b, &q, &r).unwrap();
        let back = SMatrix::from_diagonal(&q) + a.transpose() * p * (a - b * k);
        assert!((back - p).amax() < 1e-9 * p.amax(), "{}", back - p);
        let mut x = SVector::from([1.0, 0.0, 0.0]);
        (0..400).for_each(|_| x = (a - b * k) * x);
        assert!(x.amax() < 1e-6, "{x}");
    }

    /// x+ = x + u with Q = R = 1: P is the golden ratio, K its inverse.
    #[test]
    fn of_an_integrator_the_golden_ratio_comes_out() {
        let one = SVector::from([1.0]);
        let k = regulator(&SMatrix::identity(), &one, &one, &one).unwrap();
        assert!((k[0] - 2.0 / (1.0 + 5.0_f64.sqrt())).abs() < 1e-12, "{k}");
    }
}
