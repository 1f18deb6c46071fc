//! The second solution of a flat marker.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct CameraFlip;

impl Effect<1, 0> for CameraFlip {
    const NAME: &'static str = "camera_flip";
    const ABOUT: &'static str = "Now and then the pose is taken for its mirror image about the marker's axis";
    const SOURCE: &'static str = "Planar pose ambiguity (Schweighofer and Pinz 2006): two poses of a flat target explain nearly the same image";
    const PARAMS: [Param; 1] = [param("probability", "1", 0.0, [0.0, 1.0]).about("per frame")];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Variance;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[probability] = cx.params;
        let flipped = cx.draw.uniform(Self::NOISE).lt(probability);
        for i in 0..2 {
            f.pos_m[i] = R::select(flipped, R::from_f64(2.0) * f.nearest_m[i] - f.pos_m[i], f.pos_m[i]);
        }
    }
}
