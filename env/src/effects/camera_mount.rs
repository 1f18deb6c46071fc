//! A camera that does not look straight down.

use super::{Call, Effect, Frame, Hooks, Param, param};
use crate::scalar::Scalar;

pub struct CameraMount;

impl Effect<2, 0> for CameraMount {
    const NAME: &'static str = "camera_mount";
    const ABOUT: &'static str = "A constant tilt of the camera, which moves the position seen from above";
    const SOURCE: &'static str =
        "Rotation of the lens against the frame, to first order in the angle: height times tangent";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-20.0, 20.0]).about("about body x"),
        param("pitch_deg", "deg", 0.0, [-20.0, 20.0]).about("about body y"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[roll_deg, pitch_deg] = cx.params;
        let per_deg = R::from_f64(std::f64::consts::PI / 180.0);
        let (front, left) =
            (cx.x.pos_m[2] * (pitch_deg * per_deg).tan(), -cx.x.pos_m[2] * (roll_deg * per_deg).tan());
        let (sin, cos) = cx.x.att_rad[2].sin_cos();
        f.pos_m[0] += cos * front - sin * left;
        f.pos_m[1] += sin * front + cos * left;
    }
}
