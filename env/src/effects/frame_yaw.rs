//! A marker frame turned against the world.

use super::{Call, Effect, Frame, Hooks, Param, param};
use crate::scalar::Scalar;

pub struct FrameYaw;

impl Effect<1, 0> for FrameYaw {
    const NAME: &'static str = "frame_yaw";
    const ABOUT: &'static str = "Marker positions and heading are reported in a frame turned about z";
    const SOURCE: &'static str = "A marker laid down by hand";
    const PARAMS: [Param; 1] = [param("angle_deg", "deg", 0.0, [-180.0, 180.0])
        .about("of the marker frame against the world, right-handed; what is reported turns the other way")];
    const HOOKS: Hooks = Hooks::FRAME;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[angle_deg] = cx.params;
        let angle = -angle_deg * R::from_f64(std::f64::consts::PI / 180.0);
        let (sin, cos) = angle.sin_cos();
        let [x, y, z] = f.pos_m;
        f.pos_m = [cos * x - sin * y, sin * x + cos * y, z];
        f.yaw_rad += angle;
    }
}
