//! Rows of numbers, as callers have them, and lanes, as tiles have them.

use crate::lanes::LANES;
use crate::plant::State;
use crate::scalar::Scalar;
use crate::sim_scalar::BatchScalar;

/// Numbers per true state: position, velocity, attitude, rates.
pub const STATE: usize = 12;

/// Indices of a row of true state, by name: no other code counts them.
pub mod state_index {
    /// Position in the world frame, m: x, and y, z behind it.
    pub const POS: usize = 0;
    /// Height, m.
    pub const HEIGHT: usize = POS + 2;
    /// Velocity in the world frame, m/s: x, and y, z behind it.
    pub const VEL: usize = 3;
    /// Vertical velocity, m/s.
    pub const CLIMB: usize = VEL + 2;
    /// Roll, rad.
    pub const ROLL: usize = 6;
    /// Pitch, rad.
    pub const PITCH: usize = 7;
    /// Yaw, rad.
    pub const YAW: usize = 8;
    /// Rates of roll, pitch and yaw, rad/s.
    pub const RATE: usize = 9;
}

#[inline(always)]
pub(crate) fn state_row<R: Scalar>(x: &State<R>) -> [R; STATE] {
    let ([a, b, c], [d, e, f], [g, h, i], [j, k, l]) = (x.pos_m, x.vel_mps, x.att_rad, x.rate_radps);
    [a, b, c, d, e, f, g, h, i, j, k, l]
}

/// The first action that is not a number from -1 to 1.
#[inline(always)]
pub(crate) fn first_bad_action(actions: &[f32]) -> Option<usize> {
    // the larger of two sizes is the one of larger bits, and those of NaN are larger than any
    let mut largest = 0;
    for action in actions {
        largest = largest.max(action.to_bits() & 0x7fff_ffff);
    }
    if largest <= 1.0_f32.to_bits() { None } else { actions.iter().position(|a| !(-1.0..=1.0).contains(a)) }
}

/// Lanes as rows: as many as `rows` has room for.
#[inline(always)]
pub(crate) fn write<R: BatchScalar, const N: usize>(values: &[R; N], rows: &mut [f32]) {
    if rows.len() == LANES * N {
        return R::write(values, rows, N);
    }
    for (lane, row) in rows.chunks_exact_mut(N).enumerate() {
        write_lane(values, lane, row);
    }
}

/// One lane as a row.
#[inline(always)]
pub(crate) fn write_lane<R: BatchScalar, const N: usize>(values: &[R; N], lane: usize, row: &mut [f32]) {
    for (slot, value) in row.iter_mut().zip(values) {
        *slot = value.array()[lane];
    }
}

/// Bits as truth values; mostly there are none.
#[inline(always)]
pub(crate) fn flags(bits: u32, out: &mut [bool; LANES]) {
    *out = [false; LANES];
    if bits != 0 {
        for lane in lanes_of(bits) {
            out[lane] = true;
        }
    }
}

/// The lanes whose bit is set.
pub(crate) fn lanes_of(bits: u32) -> impl Iterator<Item = usize> {
    (0..LANES).filter(move |lane| bits >> lane & 1 == 1)
}
