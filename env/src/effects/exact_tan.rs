//! Sideways acceleration at large angles.

use super::{Call, Effect, Geometry, Hooks, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct ExactTan;

impl Effect<1, 0> for ExactTan {
    const NAME: &'static str = "exact_tan";
    const ABOUT: &'static str = "Sideways acceleration g tan(angle) instead of g angle";
    const SOURCE: &'static str = "Thesis 4.8";
    const PARAMS: [Param; 1] = [param("amount", "1", 0.0, [0.0, 1.0]).about("1 for the exact tangent")];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const MODEL_FORM: Geometry = Geometry::Part;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[amount] = cx.params;
        let (front, right) = (excess(cx.x.att_rad[1]), excess(cx.x.att_rad[0]));
        let (sin, cos) = cx.x.att_rad[2].sin_cos();
        let strength = amount * cx.body.gravity_mps2;
        out.acc_mps2[0] += strength * (cos * front + sin * right);
        out.acc_mps2[1] += strength * (sin * front - cos * right);
    }
}

/// tan(a) - a, for angles on this side of 80 degrees.
#[inline(always)]
fn excess<R: Scalar>(angle: R) -> R {
    let angle = angle.clamp(R::from_f64(-1.4), R::from_f64(1.4));
    angle.tan() - angle
}
