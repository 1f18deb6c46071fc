//! Declared attitude dynamics of the second order that approximate a loop of a higher order.

use super::{Call, Effect, Hooks, Observability, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct AttitudeOrder;

/// Physics steps whose commands are remembered: the longest delay, up to 500 Hz.
const STEPS: usize = 16;
/// Numbers of a command: roll, pitch, yaw rate.
const AXES: usize = 3;
const LONGEST_S: f64 = 0.03;
/// Least share of the inertia that is left.
const LEAST_INERTIA: f64 = 0.3;

impl Effect<1, { AXES * STEPS }> for AttitudeOrder {
    const NAME: &'static str = "attitude_order";
    const ABOUT: &'static str =
        "Attitude loops of higher order than declared: they answer later at first, then faster";
    const SOURCE: &'static str = "At the natural frequency w a delay t costs the phase w t, and an inertia less by d1 t gives it back; seen in rotorpy's physics";
    const PARAMS: [Param; 1] = [param("delay_s", "s", 0.0, [0.0, LONGEST_S])
        .about("delay that the declared second order stands for; above 500 Hz physics at most 15 steps")
        .starting_from(&[0.01])];
    const HOOKS: Hooks = Hooks::COMMAND_AND_PUSH;
    const DELAYS: bool = true;
    const OBSERVABILITY: Observability = Observability::HigherOrder;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn start<R: Scalar>(_: Call<R, 1>, u: &Command<R>) -> [R; AXES * STEPS] {
        std::array::from_fn(|i| attitude_command(u)[i % AXES])
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, past: &mut [R; AXES * STEPS], u: &mut Command<R>) {
        let &[delay_s] = cx.params;
        past.copy_within(..AXES * (STEPS - 1), AXES);
        past[..AXES].copy_from_slice(&attitude_command(u));
        // in steps: step k (0 is this one) lasted from -k to -k + 1, and what arrives is from [begin, begin + 1)
        let one = R::from_f64(1.0);
        let begin = -(delay_s * R::from_f64(1.0 / cx.h_s)).min(R::from_f64((STEPS - 1) as f64));
        let mut sum = [R::zero(); AXES];
        for k in 0..STEPS {
            let from = R::from_f64(-(k as f64));
            let share = ((begin + one).min(from + one) - begin.max(from)).max(R::zero());
            for (sum, past) in sum.iter_mut().zip(&past[AXES * k..]) {
                *sum += share * *past;
            }
            if R::all(from.le(begin)) {
                break;
            }
        }
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps] = sum;
    }

    #[inline(always)]
    fn push<R: Scalar>(
        cx: Call<R, 1>,
        _: &mut [R; AXES * STEPS],
        u: &Command<R>,
        out: &mut Accelerations<R>,
    ) {
        let &[delay_s] = cx.params;
        let (one, least) = (R::from_f64(1.0), R::from_f64(LEAST_INERTIA));
        let more = |damping_ps: R| one / (one - damping_ps * delay_s).max(least) - one;
        let [roll, pitch] = cx.body.tilt_damping_ps.map(more);
        cx.body.add_torques([roll, pitch, more(cx.body.yaw_damping_ps)], cx.h_s, cx.x, u, out);
    }
}

#[inline(always)]
fn attitude_command<R: Scalar>(u: &Command<R>) -> [R; AXES] {
    [u.roll_rad, u.pitch_rad, u.yaw_rate_radps]
}
