//! Products of matrices in slices, compiled for the machine's instructions. Rows are padded with zeros to whole
//! registers: most matrices of a filter have some twenty-five columns, and a tail of single numbers would take as
//! long as the rest.

use crazyflie_env::dual::Dual;
use crazyflie_env::sim_scalar::SimScalar;

/// Numbers of a register.
const LANES: usize = 4;

/// Length of a row with its padding.
pub(super) fn padded(length: usize) -> usize {
    length.next_multiple_of(LANES)
}

/// `to += by * from`.
#[inline(always)]
pub(super) fn add_scaled(to: &mut [f64], by: f64, from: &[f64]) {
    let from = &from[..to.len()];
    let (to, to_rest) = to.as_chunks_mut::<LANES>();
    let (from, from_rest) = from.as_chunks::<LANES>();
    for (to, from) in to.iter_mut().zip(from) {
        for i in 0..LANES {
            to[i] += by * from[i];
        }
    }
    for (to, from) in to_rest.iter_mut().zip(from_rest) {
        *to += by * from;
    }
}

/// The sum of rows, each by its factor, which may be fewer than the rows. `out` is as long as a padded row.
#[inline(always)]
pub(super) fn combine_rows(out: &mut [f64], by: &[f64], rows: &[f64]) {
    let mut from = 0;
    while from < out.len() {
        from += match (out.len() - from) / LANES {
            1 => combine_columns::<LANES>(out, by, rows, from),
            2 => combine_columns::<{ 2 * LANES }>(out, by, rows, from),
            3 => combine_columns::<{ 3 * LANES }>(out, by, rows, from),
            4 => combine_columns::<{ 4 * LANES }>(out, by, rows, from),
            5 => combine_columns::<{ 5 * LANES }>(out, by, rows, from),
            6 => combine_columns::<{ 6 * LANES }>(out, by, rows, from),
            7 => combine_columns::<{ 7 * LANES }>(out, by, rows, from),
            _ => combine_columns::<{ 8 * LANES }>(out, by, rows, from),
        }
    }
}

/// Some columns of [`combine_rows`], and how many. They stay in registers: each sum waits for the one
/// before, and the more of them go on side by side, the better.
#[inline(always)]
fn combine_columns<const N: usize>(out: &mut [f64], by: &[f64], rows: &[f64], from: usize) -> usize {
    let stride = out.len();
    let mut sum = [0.0; N];
    for (by, row) in by.iter().zip(rows.chunks_exact(stride)) {
        if *by != 0.0 {
            let row = &row[from..from + N];
            for i in 0..N {
                sum[i] += by * row[i];
            }
        }
    }
    out[from..from + N].copy_from_slice(&sum);
    N
}

/// A symmetric matrix of padded rows times a vector.
pub(super) fn symmetric_product(matrix: &[f64], by: &[f64], out: &mut [f64]) {
    Dual::run(
        #[inline(always)]
        || combine_rows(out, by, matrix),
    );
}

/// `matrix -= by * v v^T`, of padded rows.
pub(super) fn subtract_outer_product(matrix: &mut [f64], by: f64, v: &[f64]) {
    Dual::run(
        #[inline(always)]
        || {
            for (row, at) in matrix.chunks_exact_mut(v.len()).zip(v) {
                add_scaled(row, -(by * at), v);
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_any_length_are_combined() {
        for columns in [1, 4, 7, 12, 15, 18, 21, 25, 28, 32, 34, 85] {
            let (stride, rows) = (padded(columns), 9);
            let number = |i: usize, j: usize| ((i * 31 + j * 17) % 23) as f64 - 11.0;
            let matrix: Vec<f64> = (0..rows)
                .flat_map(|i| (0..stride).map(move |j| if j < columns { number(i, j) } else { 0.0 }))
                .collect();
            let by: Vec<f64> = (0..rows).map(|i| if i == 4 { 0.0 } else { i as f64 - 3.0 }).collect();
            let mut out = vec![f64::NAN; stride];
            combine_rows(&mut out, &by, &matrix);
            for (j, sum) in out.iter().enumerate() {
                let expected: f64 = (0..rows).map(|i| by[i] * matrix[i * stride + j]).sum();
                assert_eq!(*sum, expected, "column {j} of {columns}");
            }
        }
    }
}
