//! The rigid body with four motors behind a mixer: what small angles leave out, all at once.

use super::{Cx, Effect, Geometry, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct RigidBody;

/// Moments of inertia about the body axes in kg m^2 (Foerster 2015).
const INERTIA_KGM2: [f64; 3] = [1.657e-5, 1.657e-5, 2.926e-5];
/// Torque about the rotor axis per thrust (Foerster 2015).
const TORQUE_PER_THRUST_M: f64 = 5.96e-3;
/// Signs of front, left and of the torque on the frame, motors 1 to 4 (thesis 4.1): 1 front right and 3 back left push it clockwise.
const MOTORS: [[f64; 3]; 4] = [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]];

/// Rates about the body axes, and what the declared loops ask of them.
struct Rotation<R> {
    rate_radps: [R; 3],
    demand_radps2: [R; 3],
}

impl<R: Real> Rotation<R> {
    /// The declared loops (5.1, 5.2) read as laws of the body rates.
    #[inline(always)]
    fn from_state(cx: &Cx<R>, x: &State<R>, u: &Command<R>, sin_cos: &[(R, R); 2]) -> Self {
        let [(sin_roll, cos_roll), (sin_pitch, cos_pitch)] = *sin_cos;
        let [roll_rate, pitch_rate, yaw_rate] = x.rate_radps;
        let rate_radps = [
            roll_rate - yaw_rate * sin_pitch,
            pitch_rate * cos_roll + yaw_rate * cos_pitch * sin_roll,
            yaw_rate * cos_pitch * cos_roll - pitch_rate * sin_roll,
        ];
        let [roll, pitch] = cx.body.tilt_torque_radps2(&State { rate_radps, ..*x }, u);
        let turn = cx.body.yaw_damping_ps * (cx.body.yaw_sign * u.yaw_rate_radps - rate_radps[2]);
        Rotation { rate_radps, demand_radps2: [roll, pitch, turn] }
    }

    /// Thrust and angular accelerations that the motors cannot give, both as what is added to the demand.
    #[inline(always)]
    fn shortfall(&self, cx: &Cx<R>, thrust_n: R, motor_limit_n: R) -> (R, [R; 3]) {
        let side_m = cx.body.arm_m * R::of(std::f64::consts::FRAC_1_SQRT_2);
        let per_side = R::of(0.25) / side_m;
        let [tx, ty, tz] = [0, 1, 2].map(|i| self.demand_radps2[i] * R::of(INERTIA_KGM2[i]));
        let mut added = [R::zero(); 4];
        for [front, left, turn] in MOTORS {
            let asked = R::of(0.25) * thrust_n
                + per_side * (R::of(left) * tx - R::of(front) * ty)
                + R::of(0.25 * turn / TORQUE_PER_THRUST_M) * tz;
            let more = asked.clamp(R::zero(), motor_limit_n) - asked;
            added[0] += R::of(left) * side_m * more;
            added[1] -= R::of(front) * side_m * more;
            added[2] += R::of(turn * TORQUE_PER_THRUST_M) * more;
            added[3] += more;
        }
        (added[3], [0, 1, 2].map(|i| added[i] * R::of(1.0 / INERTIA_KGM2[i])))
    }
}

impl Effect<2, 0> for RigidBody {
    const NAME: &'static str = "rigid_body";
    const ABOUT: &'static str = "The exact rigid body: thrust along the tilted axis, Euler angle kinematics, gyroscopic torque, and four motors with limits behind a mixer";
    const SOURCE: &'static str = "Newton and Euler (thesis 4.1 to 4.9) with the declared loops as laws of the body rates; inertia and torque per thrust: Foerster 2015";
    const PARAMS: [Param; 2] = [
        param("amount", "1", 0.0, [0.0, 1.0], "1 for the exact body; then tilt_loss, exact_tan and euler_kinematics count twice"),
        param("thrust_to_weight", "1", 1.96, [1.1, 5.0], "all four motors at their limit, over the weight: a motor gives 0.16 N at most").constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const PHYSICS_HZ: u32 = 300;
    const GEOMETRY: Geometry = Geometry::Whole;

    #[inline(always)]
    fn push<R: Real>(
        &[amount, thrust_to_weight]: &[R; 2],
        _: &mut [R; 0],
        cx: &Cx<R>,
        x: &State<R>,
        u: &Command<R>,
        out: &mut Push<R>,
    ) {
        let body = cx.body;
        let angles = [0, 1].map(|i| x.att_rad[i].sin_cos());
        let [(sin_roll, cos_roll), (sin_pitch, cos_pitch)] = angles;
        let rotation = Rotation::from_state(cx, x, u, &angles);
        let weight_n = body.mass_kg * body.gravity_mps2;
        let (lost_n, short) = rotation.shortfall(cx, weight_n * body.thrust_ratio(u), R::of(0.25) * thrust_to_weight * weight_n);

        // force: thrust along the tilted axis, less what the small-angle model has of it
        let declared = body.thrust_mps2(u, out);
        let thrust = declared + lost_n / body.mass_kg;
        let (sin_yaw, cos_yaw) = x.att_rad[2].sin_cos();
        let front = thrust * sin_pitch * cos_roll - body.gravity_mps2 * x.att_rad[1];
        let right = thrust * sin_roll - body.gravity_mps2 * x.att_rad[0];
        out.acc_mps2[0] += amount * (cos_yaw * front + sin_yaw * right);
        out.acc_mps2[1] += amount * (sin_yaw * front - cos_yaw * right);
        out.acc_mps2[2] += amount * (thrust * cos_roll * cos_pitch - declared);

        // rotation: angular acceleration of the body, then of the angles, less what 5.1 and 5.2 make of it
        let [p, q, r] = rotation.rate_radps;
        let gyroscopic = R::of((INERTIA_KGM2[1] - INERTIA_KGM2[2]) / INERTIA_KGM2[0]);
        let [_, ask_q, ask_r] = rotation.demand_radps2;
        let q_dot = ask_q + short[1] - gyroscopic * p * r;
        let r_dot = ask_r + short[2];
        let [roll_rate, pitch_rate, yaw_rate] = x.rate_radps;
        let per_cos_pitch = R::of(1.0) / cos_pitch;
        let pitch_acc = cos_roll * q_dot - sin_roll * r_dot - roll_rate * yaw_rate * cos_pitch;
        let yaw_acc = (sin_roll * q_dot + cos_roll * r_dot + roll_rate * pitch_rate + yaw_rate * pitch_rate * sin_pitch) * per_cos_pitch;
        let roll_more = short[0] + gyroscopic * q * r + yaw_acc * sin_pitch + yaw_rate * pitch_rate * cos_pitch;
        out.ang_radps2[0] += amount * (roll_more + body.tilt_damping_ps[0] * (roll_rate - p));
        out.ang_radps2[1] += amount * (pitch_acc - ask_q + body.tilt_damping_ps[1] * (pitch_rate - q));
        out.ang_radps2[2] += amount * (yaw_acc - ask_r + body.yaw_damping_ps * (yaw_rate - r));
    }
}
