//! One motor that pulls less.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::motors::mixer::{Demand, THRUST_TO_WEIGHT, YAW_LEVER_M, weaken};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct WeakMotor;

impl Effect<4, 0> for WeakMotor {
    const NAME: &'static str = "weak_motor";
    const ABOUT: &'static str = "One motor (1 front right, 2 back right, 3 back left, 4 front left) loses a share of its thrust, and of the torques that come with it";
    const SOURCE: &'static str = "X configuration of thesis 4.1; inertia 1.657e-5 and 2.926e-5 kg m^2, torque per thrust 5.96 mm: Foerster 2015";
    const PARAMS: [Param; 4] = [
        param("motor", "1", 1.0, [1.0, 4.0]).about("which; front is where +pitch leads").choice(),
        param("loss", "1", 0.0, [0.0, 1.0]).about("share of its thrust that is lost").at_least(0.005),
        param("yaw_m", "m", YAW_LEVER_M, [0.0, 0.03])
            .about("torque about the vertical per thrust; a cut propeller loses them in another ratio than a slow one"),
        param("tilt_share", "1", 1.0, [0.0, 2.0])
            .about("of the roll and pitch torque: a loop with a gain on the angular acceleration leaves less than 1")
            .companion(&[1.0]),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 4>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[motor, loss, yaw_m, tilt_share] = cx.params;
        let body = cx.body;
        let one = R::from_f64(1.0);
        let front = R::select(motor.lt(R::from_f64(1.5)) | motor.gt(R::from_f64(3.5)), one, -one);
        let left = R::select(motor.gt(R::from_f64(2.5)), one, -one);
        // a share of all that the mixer asks of the motor is lost: of the thrust and of the torques
        let [roll, pitch] = body.tilt_torque_radps2(cx.x, u);
        let torque_radps2 = [roll, pitch, body.yaw_torque_radps2(cx.x, u)];
        let asked_mps2 = Demand::new(body, R::from_f64(0.25) * body.thrust_mps2(u, out), torque_radps2)
            .thrust_mps2([front, left]);
        let given_mps2 =
            asked_mps2.clamp(R::zero(), R::from_f64(0.25 * THRUST_TO_WEIGHT) * body.gravity_mps2);
        let levers = [tilt_share, yaw_m / R::from_f64(YAW_LEVER_M)];
        weaken(body, [front, left], loss * given_mps2, levers, out);
    }
}
