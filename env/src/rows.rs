//! Between rows, one per environment as callers want them, and lanes, sixteen environments at a time.

use crate::real::{LANES, Lanes, Real};

/// Up to sixteen rows of `N` numbers as lanes; missing rows are zero.
#[inline(always)]
pub(crate) fn read<const N: usize>(rows: &[f32]) -> [Lanes; N] {
    let mut out = [Lanes::zero(); N];
    if rows.len() == LANES * N {
        for lane in 0..LANES {
            for i in 0..N {
                out[i].0[lane] = rows[lane * N + i];
            }
        }
        return out;
    }
    for (lane, row) in rows.chunks_exact(N).enumerate() {
        for i in 0..N {
            out[i].0[lane] = row[i];
        }
    }
    out
}

/// Lanes as rows: as many as `rows` has room for.
#[inline(always)]
pub(crate) fn write<const N: usize>(values: &[Lanes; N], rows: &mut [f32]) {
    if rows.len() == LANES * N {
        for lane in 0..LANES {
            for i in 0..N {
                rows[lane * N + i] = values[i].0[lane];
            }
        }
        return;
    }
    for (lane, row) in rows.chunks_exact_mut(N).enumerate() {
        write_lane(values, lane, row);
    }
}

/// One lane as a row.
pub(crate) fn write_lane<const N: usize>(values: &[Lanes; N], lane: usize, row: &mut [f32]) {
    for (slot, value) in row.iter_mut().zip(values) {
        *slot = value.0[lane];
    }
}
