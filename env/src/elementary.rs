//! Elementary functions from the operations of a [`Scalar`] alone: one formula for every number type, with the
//! same bits on every machine.

use crate::scalar::Scalar;

/// See [`Scalar::sin_cos`].
#[inline(always)]
pub(crate) fn sin_cos<R: Scalar>(angle: R) -> (R, R) {
    let quarter = (angle * R::from_f64(std::f64::consts::FRAC_2_PI)).round();
    // pi/2 in three parts that are exact in f32: the products with a small integer lose nothing.
    let r = angle
        - quarter * R::from_f64(1.570_312_5)
        - quarter * R::from_f64(4.837_512_969_970_703e-4)
        - quarter * R::from_f64(7.549_789_948_768_648e-8);
    let r2 = r * r;
    let sin = r + r
        * r2
        * poly(r2, 4, &[-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0]);
    let cos = R::from_f64(1.0)
        + r2 * poly(
            r2,
            4,
            &[-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0, 1.0 / 479_001_600.0],
        );
    R::turned(quarter, sin, cos)
}

/// See [`Scalar::sin_cos_quarter`].
#[inline(always)]
pub(crate) fn sin_cos_quarter<R: Scalar>(angle: R) -> (R, R) {
    let x2 = angle * angle;
    let (s3, s5, s7, s9, s11) =
        (-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0);
    let sin = angle + angle * x2 * poly(x2, 5, &[s3, s5, s7, s9, s11, 1.0 / 6_227_020_800.0]);
    let (c4, c6, c8, c10, c12) =
        (1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0, 1.0 / 479_001_600.0);
    let cos = R::from_f64(1.0) + x2 * poly(x2, 6, &[-0.5, c4, c6, c8, c10, c12, -1.0 / 87_178_291_200.0]);
    (sin, cos)
}

/// See [`Scalar::exp`].
#[inline(always)]
pub(crate) fn exp<R: Scalar>(exponent: R) -> R {
    let x = exponent.clamp(R::from_f64(-80.0), R::from_f64(80.0));
    let n = (x * R::from_f64(std::f64::consts::LOG2_E)).round();
    // ln 2 in two parts, the first exact in f32
    let r = x - n * R::from_f64(0.693_359_375) - n * R::from_f64(-2.121_944_400_546_905_8e-4);
    let e = R::from_f64(1.0)
        + r * poly(
            r,
            7,
            &[
                1.0,
                0.5,
                1.0 / 6.0,
                1.0 / 24.0,
                1.0 / 120.0,
                1.0 / 720.0,
                1.0 / 5040.0,
                1.0 / 40_320.0,
                1.0 / 362_880.0,
                1.0 / 3_628_800.0,
            ],
        );
    e.scale_exponent(n)
}

/// See [`Scalar::ln`].
#[inline(always)]
pub(crate) fn ln<R: Scalar>(number: R) -> R {
    let (m, n) = number.split_exponent();
    // ln m = 2 atanh(t), t = (m-1)/(m+1), |t| < 0.172
    let t = (m - R::from_f64(1.0)) / (m + R::from_f64(1.0));
    let t2 = t * t;
    n * R::from_f64(std::f64::consts::LN_2)
        + t * poly(t2, 4, &[2.0, 2.0 / 3.0, 2.0 / 5.0, 2.0 / 7.0, 2.0 / 9.0, 2.0 / 11.0])
}

/// Evaluates a polynomial, lowest coefficient first, by Horner's scheme. Single precision, which cannot resolve the
/// coefficients beyond the first few, uses Estrin's, whose chains of dependent operations are half as long.
#[inline(always)]
fn poly<R: Scalar, const N: usize>(x: R, single: usize, coefficients: &[f64; N]) -> R {
    let c = |i: usize| R::from_f64(coefficients[i]);
    if R::SINGLE && (4..=7).contains(&single) {
        let x2 = x * x;
        let low = (c(0) + c(1) * x) + x2 * (c(2) + c(3) * x);
        return match single {
            4 => low,
            5 => low + x2 * x2 * c(4),
            6 => low + x2 * x2 * (c(4) + c(5) * x),
            _ => low + x2 * x2 * (c(4) + c(5) * x + x2 * c(6)),
        };
    }
    let mut sum = c(N - 1);
    for i in (0..N - 1).rev() {
        sum = sum * x + c(i);
    }
    sum
}
