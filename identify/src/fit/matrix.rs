//! Products of symmetric matrices in one slice, compiled for the machine's instructions.

use crazyflie_env::dual::Dual;
use crazyflie_env::sim_scalar::SimScalar;

/// `to += by * from`.
#[inline(always)]
pub(super) fn add_scaled(to: &mut [f64], by: f64, from: &[f64]) {
    let from = &from[..to.len()];
    for i in 0..to.len() {
        to[i] += by * from[i];
    }
}

/// A symmetric matrix times a vector: row by row, so that the compiler can take several numbers at once.
pub(super) fn symmetric_product(matrix: &[f64], by: &[f64], out: &mut [f64]) {
    Dual::run(
        #[inline(always)]
        || {
            let n = by.len();
            out.fill(0.0);
            for i in 0..n {
                if by[i] != 0.0 {
                    add_scaled(out, by[i], &matrix[i * n..(i + 1) * n]);
                }
            }
        },
    );
}

/// `matrix -= by * v v^T`.
pub(super) fn subtract_outer_product(matrix: &mut [f64], by: f64, v: &[f64]) {
    Dual::run(
        #[inline(always)]
        || {
            let n = v.len();
            for i in 0..n {
                add_scaled(&mut matrix[i * n..(i + 1) * n], -(by * v[i]), v);
            }
        },
    );
}
