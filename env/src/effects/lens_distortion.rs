//! A lens that bends the picture.

use super::{Call, Effect, Frame, Hooks, Param, param};
use crate::scalar::Scalar;

pub struct LensDistortion;

impl Effect<1, 0> for LensDistortion {
    const NAME: &'static str = "lens_distortion";
    const ABOUT: &'static str = "Marker positions sideways of the optical axis are scaled by 1 + k1 r^2, r the tangent of the angle off that axis";
    const SOURCE: &'static str = "Radial term of Brown 1966, as in OpenCV, left over from calibration; level at height z: x and y scale by 1 + k1 (x^2 + y^2) / z^2";
    const PARAMS: [Param; 1] =
        [param("k1", "1", 0.0, [-0.5, 0.5]).about("radial coefficient; negative for a barrel")];
    const HOOKS: Hooks = Hooks::FRAME;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], f: &mut Frame<R>) {
        let &[k1] = cx.params;
        let [roll, pitch, yaw] = cx.x.att_rad;
        let (sin, cos) = yaw.sin_cos();
        let (dx, dy) = (cx.x.pos_m[0] - f.nearest_m[0], cx.x.pos_m[1] - f.nearest_m[1]);
        // on the floor no lens sees a marker
        let height_m = cx.x.pos_m[2].max(R::from_f64(LEAST_HEIGHT_M));
        // mirrored place of the marker in the picture; with the nose down, the camera looks back
        let ahead = (cos * dx + sin * dy) / height_m - pitch;
        let aside = (cos * dy - sin * dx) / height_m + roll;
        let bent_m = k1 * height_m * (ahead * ahead + aside * aside).min(R::from_f64(WIDEST));
        f.pos_m[0] += bent_m * (cos * ahead - sin * aside);
        f.pos_m[1] += bent_m * (sin * ahead + cos * aside);
    }
}

const LEAST_HEIGHT_M: f64 = 0.05;
/// Squared tangent of the widest angle at which a lens shows a marker, 63 degrees; the law does not extend beyond it.
const WIDEST: f64 = 4.0;
