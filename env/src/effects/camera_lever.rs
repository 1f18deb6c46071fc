//! A camera that is not where the vehicle is.

use super::{Call, Effect, Frame, Hooks, Param, param};
use crate::scalar::Scalar;

pub struct CameraLever;

impl Effect<3, 0> for CameraLever {
    const NAME: &'static str = "camera_lever";
    const ABOUT: &'static str = "The reported position is that of a point off the centre of mass";
    const SOURCE: &'static str = "Lever arm turned by heading and, to first order, by roll and pitch; the thesis's lens is 2 cm below the centre";
    const PARAMS: [Param; 3] = [
        param("x_m", "m", 0.0, [-0.3, 0.3]).about("forward of the centre"),
        param("y_m", "m", 0.0, [-0.3, 0.3]).about("left of the centre"),
        param("z_m", "m", 0.0, [-0.3, 0.3]).about("above the centre"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[lever_x, lever_y, lever_z] = cx.params;
        let [roll, pitch, yaw] = cx.x.att_rad;
        let (sin, cos) = yaw.sin_cos();
        let (front, left) = (lever_x + pitch * lever_z, lever_y - roll * lever_z);
        f.pos_m[0] += cos * front - sin * left;
        f.pos_m[1] += sin * front + cos * left;
        f.pos_m[2] += lever_z - pitch * lever_x + roll * lever_y;
    }
}
