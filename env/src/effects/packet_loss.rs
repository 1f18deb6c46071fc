//! Radio packets that do not arrive.

use super::{Effect, HookContext, Hooks, Observability, Param, param};
use crate::plant::{Command, State};
use crate::scalar::Scalar;

pub struct PacketLoss;

impl Effect<1, 4> for PacketLoss {
    const NAME: &'static str = "packet_loss";
    const ABOUT: &'static str =
        "A command packet is lost with this probability; the vehicle keeps the last one that arrived";
    const SOURCE: &'static str =
        "Bernoulli losses per packet at the control rate; the firmware holds the last set-point";
    const PARAMS: [Param; 1] = [param("probability", "1", 0.0, [0.0, 1.0], "of losing one command")];
    const HOOKS: Hooks = Hooks::COMMAND;
    const OBSERVABILITY: Observability = Observability::HeldCommand;

    #[inline(always)]
    fn start<R: Scalar>(_: &[R; 1], _: &HookContext<R>, _: &State<R>, u: &Command<R>) -> [R; 4] {
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]
    }

    #[inline(always)]
    fn command<R: Scalar>(
        &[probability]: &[R; 1],
        held: &mut [R; 4],
        cx: &HookContext<R>,
        _: &State<R>,
        u: &mut Command<R>,
    ) {
        let fields = [&mut u.roll_rad, &mut u.pitch_rad, &mut u.yaw_rate_radps, &mut u.lift];
        if cx.first {
            let lost = cx.draw.uniform(Self::NOISE).lt(probability);
            for (held, new) in held.iter_mut().zip(&fields) {
                // what is expected of a command that may be lost lies between the old one and the new one
                *held = if R::MEAN {
                    **new + probability * (*held - **new)
                } else {
                    R::select(lost, *held, **new)
                };
            }
        }
        for (field, held) in fields.into_iter().zip(held) {
            *field = *held;
        }
    }
}
