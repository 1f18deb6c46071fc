//! A wrong marker size or focal length.

use super::{Call, Effect, Frame, Hooks, Param, param};
use crate::scalar::{Scalar, each};

pub struct CameraScale;

impl Effect<1, 0> for CameraScale {
    const NAME: &'static str = "camera_scale";
    const ABOUT: &'static str = "Reported positions are scaled";
    const SOURCE: &'static str = "A marker of another size than declared scales every distance";
    const PARAMS: [Param; 1] = [param("scale", "1", 1.0, [0.5, 2.0])
        .about("reported over true; markers are measured to a per cent")
        .at_least(0.02)];
    const HOOKS: Hooks = Hooks::FRAME;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[scale] = cx.params;
        f.pos_m = each(
            f.pos_m,
            #[inline(always)]
            |p| scale * p,
        );
    }
}
