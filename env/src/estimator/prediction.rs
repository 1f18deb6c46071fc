//! Prediction of one axis under a constant acceleration: mean and covariance.

use crate::scalar::Scalar;

/// Position, velocity, and the acceleration that nothing explains.
pub(super) type Axis<R> = [R; 3];

/// Their covariance, upper triangle: pp, pv, pb, vv, vb, bb.
pub(super) type Covariance<R> = [R; 6];

/// Variances before anything was seen: 20 cm, 30 cm/s, 0.3 m/s^2.
pub(super) const START: Covariance<f64> = [0.04, 0.0, 0.0, 0.09, 0.0, 0.09];

/// Returns the part of tick `j` (which began j + 1 ticks of `h_s` ago) that lies between the ages `from` and `to`.
#[inline(always)]
pub(super) fn overlap<R: Scalar>(from: R, to: R, j: usize, h_s: f64) -> R {
    (from.min(R::from_f64(h_s * (j + 1) as f64)) - to.max(R::from_f64(h_s * j as f64))).max(R::zero())
}

/// Predicts an axis `dt_s` later under a constant acceleration.
#[inline(always)]
pub(super) fn predict_mean<R: Scalar>(&[p, v, b]: &Axis<R>, acc: R, dt_s: R, carry: f64) -> Axis<R> {
    let gained = (acc + b) * dt_s;
    [p + (v + R::from_f64(carry) * gained) * dt_s, v + gained, b]
}

/// The covariance `dt_s` later, with white noise and a wandering bias of so much variance per second: F P F'
/// + Q.
#[inline(always)]
pub(super) fn predict_covariance<R: Scalar>(
    &[pp, pv, pb, vv, vb, bb]: &Covariance<R>,
    dt_s: R,
    white: f64,
    bias: f64,
) -> Covariance<R> {
    let half = R::from_f64(0.5) * dt_s * dt_s;
    // F P, then (F P) F', with F = [1 dt dt^2/2; 0 1 dt; 0 0 1]
    let (a, b, c) = (pp + dt_s * pv + half * pb, pv + dt_s * vv + half * vb, pb + dt_s * vb + half * bb);
    let (d, e) = (vv + dt_s * vb, vb + dt_s * bb);
    [
        a + dt_s * b + half * c,
        b + dt_s * c,
        c,
        d + dt_s * e + R::from_f64(white) * dt_s,
        e,
        bb + R::from_f64(bias) * dt_s,
    ]
}
