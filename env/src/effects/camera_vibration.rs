//! A camera that shakes.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct CameraVibration;

impl Effect<1, 0> for CameraVibration {
    const NAME: &'static str = "camera_vibration";
    const ABOUT: &'static str =
        "The camera's angle shakes from frame to frame, which moves the position seen from above";
    const SOURCE: &'static str =
        "Thesis chapter 8, future work 2; far above the frame rate, so white from frame to frame";
    const PARAMS: [Param; 1] =
        [param("angle_deg", "deg", 0.0, [0.0, 5.0]).about("standard deviation of the angle about each axis")];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Variance;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[angle_deg] = cx.params;
        let reach = cx.x.pos_m[2] * angle_deg * R::from_f64(std::f64::consts::PI / 180.0);
        for (i, n) in cx.draw.normals(Self::NOISE).into_iter().enumerate() {
            f.pos_m[i] += reach * n;
        }
    }
}
