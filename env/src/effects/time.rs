//! Effects over time: lags of first order and steps.

use super::HookContext;
use crate::scalar::Scalar;

/// Duration of a step. A fit needs a slope to find its time, and motors and air take about as long.
const RAMP_S: f64 = 0.2;

/// Returns two shares of the deviation that a first-order lag has at the start of a physics step: the share left at
/// its end, and the mean over the step.
#[inline(always)]
pub(super) fn lag_shares<R: Scalar>(lag_s: R, h_s: f64) -> [R; 2] {
    // no lag at all would divide by zero; a microsecond leaves nothing of the past
    let left = (R::from_f64(-h_s) / lag_s.max(R::from_f64(1e-6))).exp();
    [left, lag_s * R::from_f64(1.0 / h_s) * (R::from_f64(1.0) - left)]
}

/// Returns the share of a step at `t_s` that has happened by the middle of the physics step: a ramp from 0 to 1,
/// centred on that time.
#[inline(always)]
pub(super) fn step_share<R: Scalar>(t_s: R, cx: &HookContext<R>) -> R {
    let since_s = cx.t_s + R::from_f64(0.5 * cx.h_s) - t_s;
    (since_s * R::from_f64(1.0 / RAMP_S) + R::from_f64(0.5)).clamp(R::zero(), R::from_f64(1.0))
}

/// Returns the number of values, one per control tick, that reach back this far, with the newest.
pub(super) fn slots(longest_s: f64, tick_s: f64) -> usize {
    // a whole number of ticks may come out a little longer
    (longest_s / tick_s - 1e-9).ceil() as usize + 1
}
