//! Noise of the marker pose.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct CameraNoise;

impl Effect<3, 0> for CameraNoise {
    const NAME: &'static str = "camera_noise";
    const ABOUT: &'static str = "White noise of the marker pose, growing with distance and view angle, shrinking with the number of markers";
    const SOURCE: &'static str = "Pixel noise through the pinhole: sideways as distance, along the line of sight as distance squared, both over cos(view angle); given at 70 cm straight above";
    const PARAMS: [Param; 3] = [
        param("xy_m", "m", 0.0, [0.0, 0.2]).about("standard deviation of x and y at 70 cm"),
        param("z_m", "m", 0.0, [0.0, 0.2]).about("standard deviation of z at 70 cm"),
        param("yaw_deg", "deg", 0.0, [0.0, 20.0]).about("standard deviation of the heading at 70 cm"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Variance;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[xy_m, z_m, yaw_deg] = cx.params;
        let [dx, dy] = [cx.x.pos_m[0] - f.nearest_m[0], cx.x.pos_m[1] - f.nearest_m[1]];
        let height = cx.x.pos_m[2].max(R::from_f64(0.02));
        let distance = (dx * dx + dy * dy + height * height).sqrt();
        // grazing views are lost, not infinitely noisy
        let slant = (distance / height).min(R::from_f64(5.0));
        let far = distance * R::from_f64(1.0 / 0.7);
        let sideways = far * slant / f.markers.max(R::from_f64(1.0)).sqrt();
        let ([a, b], [c, d]) = (cx.draw.normals(Self::NOISE), cx.draw.normals(Self::NOISE.wrapping_add(1)));
        f.pos_m[0] += sideways * xy_m * a;
        f.pos_m[1] += sideways * xy_m * b;
        f.pos_m[2] += sideways * far * z_m * c;
        f.yaw_rad += sideways * yaw_deg * R::from_f64(std::f64::consts::PI / 180.0) * d;
    }
}
