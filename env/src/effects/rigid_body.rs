//! The rigid body with four motors behind a mixer: what small angles leave out, all at once.

use super::{Call, Effect, Geometry, Hooks, Param, Scope, param};
use crate::motors::mixer::{Demand, THRUST_TO_WEIGHT, TILT_INERTIA_KGM2, YAW_INERTIA_KGM2};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;

pub struct RigidBody;

/// Sine and cosine of roll and pitch.
#[derive(Clone, Copy)]
struct Tilt<R> {
    roll: (R, R),
    pitch: (R, R),
}

impl<R: Scalar> Tilt<R> {
    #[inline(always)]
    fn from_state(x: &State<R>) -> Self {
        Tilt { roll: x.att_rad[0].sin_cos(), pitch: x.att_rad[1].sin_cos() }
    }

    /// Rates about the body axes of a vehicle whose angles have these rates.
    #[inline(always)]
    fn body_rates(&self, [roll_rate, pitch_rate, yaw_rate]: [R; 3]) -> [R; 3] {
        let Tilt { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = *self;
        [
            roll_rate - yaw_rate * sin_pitch,
            pitch_rate * cos_roll + yaw_rate * cos_pitch * sin_roll,
            yaw_rate * cos_pitch * cos_roll - pitch_rate * sin_roll,
        ]
    }

    /// The rates of the angles from rates of which the share `amount` is about the body axes.
    #[inline(always)]
    fn angle_rates(&self, amount: R, [p, q, r]: [R; 3]) -> [R; 3] {
        let Tilt { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = *self;
        let rest = R::from_f64(1.0) - amount;
        let (by_pitch, by_yaw) = (rest + amount * cos_roll, rest + amount * cos_pitch * cos_roll);
        let per_determinant =
            R::from_f64(1.0) / (by_pitch * by_yaw + amount * amount * sin_roll * sin_roll * cos_pitch);
        let pitch_rate = (by_yaw * q - amount * cos_pitch * sin_roll * r) * per_determinant;
        let yaw_rate = (by_pitch * r + amount * sin_roll * q) * per_determinant;
        [p + amount * sin_pitch * yaw_rate, pitch_rate, yaw_rate]
    }
}

impl Effect<2, 0> for RigidBody {
    const NAME: &'static str = "rigid_body";
    const ABOUT: &'static str = "The exact rigid body: thrust along the tilted axis, Euler angle kinematics, gyroscopic torque, and four motors with limits behind a mixer";
    const SOURCE: &'static str = "Newton and Euler (thesis 4.1 to 4.9) with the declared loops as laws of the body rates; inertia and torque per thrust: Foerster 2015";
    const PARAMS: [Param; 2] = [
        param("amount", "1", 0.0, [0.0, 1.0])
            .about("1 for the exact body; then tilt_loss, exact_tan and euler_kinematics count twice"),
        param("thrust_to_weight", "1", THRUST_TO_WEIGHT, [1.1, 5.0])
            .about("all four motors at their limit, over the weight: a motor gives 0.16 N at most")
            .constant(),
    ];
    const HOOKS: Hooks = Hooks::RATES_AND_PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;
    const MODEL_FORM: Geometry = Geometry::Whole;

    #[inline(always)]
    fn body_rates<R: Scalar>(&[amount, _]: &[R; 2], x: &State<R>) -> [R; 3] {
        let body = Tilt::from_state(x).body_rates(x.rate_radps);
        std::array::from_fn(
            #[inline(always)]
            |i| x.rate_radps[i] + amount * (body[i] - x.rate_radps[i]),
        )
    }

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[amount, thrust_to_weight] = cx.params;
        let x = cx.x;
        let body = cx.body;
        let tilt = Tilt::from_state(x);
        let Tilt { roll: (sin_roll, cos_roll), pitch: (sin_pitch, cos_pitch) } = tilt;
        let angle_rates = tilt.angle_rates(amount, x.rate_radps);
        let body_rates = tilt.body_rates(angle_rates);
        // the declared loops (5.1, 5.2) read as laws of the body rates
        let turning = State { rate_radps: body_rates, ..*x };
        let [asked_roll, asked_pitch] = body.tilt_torque_radps2(&turning, u);
        let asked_radps2 = [asked_roll, asked_pitch, body.yaw_torque_radps2(&turning, u)];
        let quarter_mps2 = R::from_f64(0.25) * body.gravity_mps2;
        let level_mps2 = quarter_mps2 * body.thrust_ratio(u);
        let demand = Demand::new(body, level_mps2, asked_radps2);
        let lost = demand.push_beyond_limits(body, quarter_mps2 * thrust_to_weight);

        // force: thrust along the tilted axis, less what the small-angle model has of it
        let declared = body.thrust_mps2(u, out);
        let thrust = declared + lost.acc_mps2[2];
        let (sin_yaw, cos_yaw) = x.att_rad[2].sin_cos();
        let front = thrust * sin_pitch * cos_roll - body.gravity_mps2 * x.att_rad[1];
        let right = thrust * sin_roll - body.gravity_mps2 * x.att_rad[0];
        out.acc_mps2[0] += amount * (cos_yaw * front + sin_yaw * right);
        out.acc_mps2[1] += amount * (sin_yaw * front - cos_yaw * right);
        out.acc_mps2[2] += amount * (thrust * cos_roll * cos_pitch - declared);

        // rotation: angular acceleration of the body by motors and effects, then of the angles, less what 5.1
        // and 5.2 make of it
        let [p, q, r] = body_rates;
        let gyroscopic = R::from_f64((TILT_INERTIA_KGM2 - YAW_INERTIA_KGM2) / TILT_INERTIA_KGM2);
        let [_, asked_q, asked_r] = asked_radps2;
        let [_, pushed_q, pushed_r] = out.ang_radps2;
        let q_dot = asked_q + pushed_q + lost.ang_radps2[1] - gyroscopic * p * r;
        let r_dot = asked_r + pushed_r + lost.ang_radps2[2];
        let [roll_rate, pitch_rate, yaw_rate] = angle_rates;
        let per_cos_pitch = R::from_f64(1.0) / cos_pitch;
        let pitch_acc = cos_roll * q_dot - sin_roll * r_dot - roll_rate * yaw_rate * cos_pitch;
        let yaw_acc = (sin_roll * q_dot
            + cos_roll * r_dot
            + roll_rate * pitch_rate
            + yaw_rate * pitch_rate * sin_pitch)
            * per_cos_pitch;
        let roll_more =
            lost.ang_radps2[0] + gyroscopic * q * r + yaw_acc * sin_pitch + yaw_rate * pitch_rate * cos_pitch;
        out.ang_radps2[0] += amount * (roll_more + body.tilt_damping_ps[0] * (roll_rate - p));
        out.ang_radps2[1] +=
            amount * (pitch_acc - asked_q - pushed_q + body.tilt_damping_ps[1] * (pitch_rate - q));
        out.ang_radps2[2] += amount * (yaw_acc - asked_r - pushed_r + body.yaw_damping_ps * (yaw_rate - r));
    }
}
