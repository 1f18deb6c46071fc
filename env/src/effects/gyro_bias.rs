//! A gyro that drifts, and IMU noise.

use super::{Call, Effect, Hooks, Observability, Param, Reading, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct GyroBias;

impl Effect<4, 4> for GyroBias {
    const NAME: &'static str = "gyro_bias";
    const ABOUT: &'static str =
        "Gyro bias that wanders, white noise on rates and angles, a heading that integrates the bias";
    const SOURCE: &'static str = "Standard gyro error model (bias random walk and white noise); noise of the MPU-9250, 0.01 deg/s/sqrt(Hz)";
    const PARAMS: [Param; 4] = [
        param("bias_degps", "deg/s", 0.0, [0.0, 20.0]).about("standard deviation of the bias at the start"),
        param("walk_degps_sqrts", "deg/s/sqrt(s)", 0.0, [0.0, 5.0]).about("random walk of the bias"),
        param("rate_noise_degps", "deg/s", 0.0, [0.0, 20.0]).about("white noise of each rate"),
        param("angle_noise_deg", "deg", 0.0, [0.0, 5.0]).about("white noise of each angle"),
    ];
    const HOOKS: Hooks = Hooks::SENSE;
    const OBSERVABILITY: Observability = Observability::Variance;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 4>, _: &Command<R>) -> [R; 4] {
        let &[bias_degps, ..] = cx.params;
        let ([a, b], [c, _]) =
            (cx.draw.normals(Self::NOISE.wrapping_add(10)), cx.draw.normals(Self::NOISE.wrapping_add(11)));
        [bias_degps * a, bias_degps * b, bias_degps * c, R::zero()]
    }

    #[inline(always)]
    fn sense<R: Scalar>(cx: Call<R, 4>, s: &mut [R; 4], y: &mut Reading<R>) {
        let &[_, walk_degps_sqrts, rate_noise_degps, angle_noise_deg] = cx.params;
        let ([a, b], [c, d], [e, f]) = (
            cx.draw.normals(Self::NOISE),
            cx.draw.normals(Self::NOISE.wrapping_add(1)),
            cx.draw.normals(Self::NOISE.wrapping_add(2)),
        );
        let ([g, h], [i, _]) =
            (cx.draw.normals(Self::NOISE.wrapping_add(3)), cx.draw.normals(Self::NOISE.wrapping_add(4)));
        let per_deg = R::from_f64(std::f64::consts::PI / 180.0);
        let step = walk_degps_sqrts * R::from_f64(cx.h_s).sqrt();
        for (axis, (walk, white, angle)) in [(a, d, g), (b, e, h), (c, f, i)].into_iter().enumerate() {
            s[axis] += step * walk;
            y.gyro_radps[axis] += per_deg * (s[axis] + rate_noise_degps * white);
            y.att_rad[axis] += per_deg * angle_noise_deg * angle;
        }
        s[3] += s[2] * R::from_f64(cx.h_s);
        y.att_rad[2] += per_deg * s[3];
    }
}
