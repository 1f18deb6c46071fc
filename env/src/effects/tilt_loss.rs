//! Thrust lost to tilt.

use super::{Call, Effect, Geometry, Hooks, Param, Scope, Ubiquity, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct TiltLoss;

impl Effect<2, 0> for TiltLoss {
    const NAME: &'static str = "tilt_loss";
    const ABOUT: &'static str = "A tilted vehicle lifts less: thrust times cos(roll) cos(pitch)";
    const SOURCE: &'static str = "Thesis 4.5";
    const PARAMS: [Param; 2] = [
        param("amount", "1", 0.0, [0.0, 1.0]).about("1 for the exact cosine"),
        param("sideways", "1", 0.0, [0.0, 1.0])
            .about("1 pushes sideways too by the thrust of the moment times the sine, not by g times the angle; exact_tan then counts twice")
            .choice(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const UBIQUITY: Ubiquity = Ubiquity::All;
    const MODEL_FORM: Geometry = Geometry::Part;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[amount, sideways] = cx.params;
        let [(sin_roll, cos_roll), (sin_pitch, cos_pitch)] = [0, 1].map(|i| cx.x.att_rad[i].sin_cos());
        let thrust = cx.body.thrust_mps2(u, out);
        out.acc_mps2[2] += amount * thrust * (cos_roll * cos_pitch - R::from_f64(1.0));
        let (sin, cos) = cx.x.att_rad[2].sin_cos();
        let front = thrust * cos_roll * sin_pitch - cx.body.gravity_mps2 * cx.x.att_rad[1];
        let right = thrust * sin_roll - cx.body.gravity_mps2 * cx.x.att_rad[0];
        let strength = amount * sideways;
        out.acc_mps2[0] += strength * (cos * front + sin * right);
        out.acc_mps2[1] += strength * (sin * front - cos * right);
    }
}
