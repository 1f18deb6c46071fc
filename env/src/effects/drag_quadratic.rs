//! Air drag in proportion to speed squared.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct DragQuadratic;

impl Effect<1, 0> for DragQuadratic {
    const NAME: &'static str = "drag_quadratic";
    const ABOUT: &'static str =
        "Drag in proportion to speed squared: acc = -coefficient |v| v, in all directions";
    const SOURCE: &'static str = "The second-order drag that thesis 4.2.3 neglects";
    const PARAMS: [Param; 1] =
        [param("coefficient_pm", "1/m", 0.0, [0.0, 3.0]).about("drag per mass and speed squared")];
    const HOOKS: Hooks = Hooks::PUSH;
    const FEELS_AIR: bool = true;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[coefficient_pm] = cx.params;
        // the small number keeps the derivative at rest finite
        let [vx, vy, vz] = cx.x.vel_mps;
        let speed = (vx * vx + vy * vy + vz * vz + R::from_f64(1e-12)).sqrt();
        for i in 0..3 {
            out.acc_mps2[i] -= coefficient_pm * speed * cx.x.vel_mps[i];
        }
    }
}
