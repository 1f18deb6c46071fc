//! Free curves: accelerations by functions of state and command, fitted to what no named effect explains.

use super::{Call, Effect, Hooks, Observability, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

/// A free curve: how an acceleration depends on one input, by some parameters of the effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Curve {
    /// The input, in words.
    pub input: &'static str,
    /// The acceleration is along the world's z axis; else it is sideways.
    pub is_vertical: bool,
    /// Places of its parameters.
    pub params: &'static [usize],
    /// Places of the constants beside it, which belong to several curves.
    pub constants: &'static [usize],
}

/// Constants forward and to the left.
const BODY: &[usize] = &[0, 5];
/// Constant up.
const UP: &[usize] = &[10];
/// Constants along x and y.
const WORLD: &[usize] = &[26, 27];

/// Every curve of the effect `learned`.
pub const CURVES: [Curve; 9] = [
    Curve { input: "the speed sideways", is_vertical: false, params: &[1, 2, 6, 7], constants: BODY },
    Curve { input: "the tilt", is_vertical: false, params: &[3, 8], constants: BODY },
    Curve { input: "the commands of roll and pitch", is_vertical: false, params: &[4, 9], constants: BODY },
    Curve { input: "the place", is_vertical: false, params: &[20, 21, 23, 24], constants: WORLD },
    Curve { input: "the height", is_vertical: false, params: &[22, 25], constants: WORLD },
    Curve {
        input: "the speed of climbing and sinking",
        is_vertical: true,
        params: &[11, 14, 15],
        constants: UP,
    },
    Curve { input: "the thrust command", is_vertical: true, params: &[12, 16], constants: UP },
    Curve { input: "the height", is_vertical: true, params: &[17, 18], constants: UP },
    Curve { input: "the tilt or the speed sideways", is_vertical: true, params: &[13, 19], constants: UP },
];

/// Height scale of what acts near a floor only.
const NEAR_FLOOR_M: f64 = 0.1;

pub struct Learned;

impl Effect<28, 0> for Learned {
    const NAME: &'static str = "learned";
    const ABOUT: &'static str = "Accelerations linear in functions of state and command, fitted to a residual that no other effect explains";
    const SOURCE: &'static str = "Sparse regression on a library of functions (Brunton, Proctor, Kutz 2016); a description, not a cause";
    const PARAMS: [Param; 28] = [
        param("front_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("forward, constant"),
        param("front_speed_ps", "1/s", 0.0, [-5.0, 0.5]).about("forward, per forward speed"),
        param("front_drag_pm", "1/m", 0.0, [-5.0, 0.0]).about("forward, per forward speed times speed"),
        param("front_pitch_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0]).about("forward, per pitch"),
        param("front_command_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0]).about("forward, per pitch command"),
        param("left_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("to the left, constant"),
        param("left_speed_ps", "1/s", 0.0, [-5.0, 0.5]).about("to the left, per speed to the left"),
        param("left_drag_pm", "1/m", 0.0, [-5.0, 0.0])
            .about("to the left, per speed to the left times speed"),
        param("left_roll_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0]).about("to the left, per roll"),
        param("left_command_mps2", "m/s^2/rad", 0.0, [-20.0, 20.0]).about("to the left, per roll command"),
        param("up_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("up, constant"),
        param("up_speed_ps", "1/s", 0.0, [-5.0, 0.5]).about("up, per climb"),
        param("up_thrust_mps2", "m/s^2", 0.0, [-20.0, 20.0]).about("up, per thrust over weight beyond one"),
        param("up_sideways_pm", "1/m", 0.0, [-1.0, 1.0]).about("up, per horizontal speed squared"),
        param("up_drag_pm", "1/m", 0.0, [-5.0, 0.0]).about("up, per climb times its size"),
        param("up_sinking_ps", "1/s", 0.0, [-5.0, 2.0]).about("up, per climb where that is below zero"),
        param("up_thrust_square_mps2", "m/s^2", 0.0, [-50.0, 50.0])
            .about("up, per thrust over weight beyond one, times its size"),
        param("up_height_ps2", "1/s^2", 0.0, [-5.0, 0.5]).about("up, per height"),
        param("up_floor_mps2", "m/s^2", 0.0, [-20.0, 20.0])
            .about("up, falling to a third within each 0.1 m of height"),
        param("up_tilt_mps2", "m/s^2/rad^2", 0.0, [-50.0, 50.0]).about("up, per square of the tilt"),
        param("x_per_x_ps2", "1/s^2", 0.0, [-5.0, 0.5]).about("along x, per x"),
        param("x_per_y_ps2", "1/s^2", 0.0, [-1.0, 1.0]).about("along x, per y"),
        param("x_per_z_ps2", "1/s^2", 0.0, [-5.0, 5.0]).about("along x, per height"),
        param("y_per_x_ps2", "1/s^2", 0.0, [-1.0, 1.0]).about("along y, per x"),
        param("y_per_y_ps2", "1/s^2", 0.0, [-5.0, 0.5]).about("along y, per y"),
        param("y_per_z_ps2", "1/s^2", 0.0, [-5.0, 5.0]).about("along y, per height"),
        param("x_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along x, constant"),
        param("y_bias_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along y, constant"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const OBSERVABILITY: Observability = Observability::Surrogate;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 28>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let p = cx.params;
        let x = cx.x;
        let (sin, cos) = x.att_rad[2].sin_cos();
        let ([px, py, pz], [vx, vy, vz]) = (x.pos_m, x.vel_mps);
        let (front, left) = (cos * vx + sin * vy, cos * vy - sin * vx);
        let square = front * front + left * left;
        let size = |v: R| (v * v + R::from_f64(1e-12)).sqrt();
        let speed = (square + R::from_f64(1e-12)).sqrt();
        let ahead = p[0] + p[1] * front + p[2] * speed * front + p[3] * x.att_rad[1] + p[4] * u.pitch_rad;
        let aside = p[5] + p[6] * left + p[7] * speed * left + p[8] * x.att_rad[0] + p[9] * u.roll_rad;
        out.acc_mps2[0] += cos * ahead - sin * aside + p[26] + p[20] * px + p[21] * py + p[22] * pz;
        out.acc_mps2[1] += sin * ahead + cos * aside + p[27] + p[23] * px + p[24] * py + p[25] * pz;
        let more = cx.body.thrust_ratio(u) - R::from_f64(1.0);
        let climb = p[11] * vz + p[14] * size(vz) * vz + p[15] * R::from_f64(0.5) * (vz - size(vz));
        let thrust = p[12] * more + p[16] * size(more) * more;
        let floor = p[18] * (pz * R::from_f64(-1.0 / NEAR_FLOOR_M)).exp();
        let tilt = p[19] * (x.att_rad[0] * x.att_rad[0] + x.att_rad[1] * x.att_rad[1]);
        out.acc_mps2[2] += p[10] + climb + thrust + p[13] * square + p[17] * pz + floor + tilt;
    }
}
