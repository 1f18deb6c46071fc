//! What is left when no named effect accounts for it: a small linear term, learned from data.

use super::{Effect, HookContext, Hooks, Observability, Param, Scope, param};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;

pub struct Learned;

impl Effect<14, 0> for Learned {
    const NAME: &'static str = "learned";
    const ABOUT: &'static str = "Accelerations linear in functions of state and command, fitted to a residual that no other effect explains";
    const SOURCE: &'static str = "Sparse regression on a library of functions (Brunton, Proctor, Kutz 2016); a description, not a cause";
    const PARAMS: [Param; 14] = [
        param("front_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0], "forward, constant"),
        param("front_speed_ps", "1/s", 0.0, [-5.0, 0.5], "forward, per forward speed"),
        param("front_drag_pm", "1/m", 0.0, [-5.0, 0.0], "forward, per forward speed times speed"),
        param("front_pitch_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0], "forward, per pitch"),
        param("front_command_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0], "forward, per pitch command"),
        param("left_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0], "to the left, constant"),
        param("left_speed_ps", "1/s", 0.0, [-5.0, 0.5], "to the left, per speed to the left"),
        param("left_drag_pm", "1/m", 0.0, [-5.0, 0.0], "to the left, per speed to the left times speed"),
        param("left_roll_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0], "to the left, per roll"),
        param("left_command_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0], "to the left, per roll command"),
        param("up_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0], "up, constant"),
        param("up_speed_ps", "1/s", 0.0, [-5.0, 0.5], "up, per climb"),
        param("up_thrust_mps2", "m/s^2", 0.0, [-20.0, 20.0], "up, per thrust over weight beyond one"),
        param("up_sideways_pm", "1/m", 0.0, [-1.0, 1.0], "up, per horizontal speed squared"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const OBSERVABILITY: Observability = Observability::Surrogate;

    #[inline(always)]
    fn push<R: Scalar>(
        p: &[R; 14],
        _: &mut [R; 0],
        cx: &HookContext<R>,
        x: &State<R>,
        u: &Command<R>,
        out: &mut Accelerations<R>,
    ) {
        let (sin, cos) = x.att_rad[2].sin_cos();
        let [vx, vy, vz] = x.vel_mps;
        let (front, left) = (cos * vx + sin * vy, cos * vy - sin * vx);
        let square = front * front + left * left;
        let speed = (square + R::from_f64(1e-12)).sqrt();
        let ahead = p[0] + p[1] * front + p[2] * speed * front + p[3] * x.att_rad[1] + p[4] * u.pitch_rad;
        let aside = p[5] + p[6] * left + p[7] * speed * left + p[8] * x.att_rad[0] + p[9] * u.roll_rad;
        out.acc_mps2[0] += cos * ahead - sin * aside;
        out.acc_mps2[1] += sin * ahead + cos * aside;
        out.acc_mps2[2] +=
            p[10] + p[11] * vz + p[12] * (cx.body.thrust_ratio(u) - R::from_f64(1.0)) + p[13] * square;
    }
}
