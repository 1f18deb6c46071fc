//! Marker poses that are plainly wrong.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct CameraOutliers;

impl Effect<4, 0> for CameraOutliers {
    const NAME: &'static str = "camera_outliers";
    const ABOUT: &'static str = "Now and then a pose is off by about 10 cm in a random direction";
    const SOURCE: &'static str = "Thesis 5.1.3 and 5.1.4: errors of 10 cm and more at 0.6 to 1 m";
    const PARAMS: [Param; 4] = [
        param("probability", "1", 0.0, [0.0, 1.0]).about("per frame"),
        param("size_m", "m", 0.1, [0.0, 1.0]).about("how far off"),
        param("near_m", "m", 0.6, [0.0, 10.0]).about("nearest distance at which they occur"),
        param("far_m", "m", 1.0, [0.0, 10.0]).about("farthest distance at which they occur"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Variance;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 4>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[probability, size_m, near_m, far_m] = cx.params;
        let [dx, dy] = [cx.x.pos_m[0] - f.nearest_m[0], cx.x.pos_m[1] - f.nearest_m[1]];
        let distance = (dx * dx + dy * dy + cx.x.pos_m[2] * cx.x.pos_m[2]).sqrt();
        let hit = cx.draw.uniform(Self::NOISE).lt(probability) & near_m.le(distance) & distance.le(far_m);
        let ([a, b], [c, _]) =
            (cx.draw.normals(Self::NOISE.wrapping_add(1)), cx.draw.normals(Self::NOISE.wrapping_add(2)));
        let length = (a * a + b * b + c * c + R::from_f64(1e-12)).sqrt();
        let reach = R::select(hit, size_m / length, R::zero());
        for (i, n) in [a, b, c].into_iter().enumerate() {
            f.pos_m[i] += reach * n;
        }
    }
}
