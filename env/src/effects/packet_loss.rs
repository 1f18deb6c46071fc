//! Radio packets that do not arrive.

use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::Command;
use crate::scalar::{Scalar, tabulate};

pub struct PacketLoss;

/// Numbers of a command.
const COMMAND: usize = 4;

/// The memory contains the command in force, and behind it: in flight, whether the last packet was lost, at the start
/// how likely; for expectations, the part of each number's mean due to a lost packet.
impl Effect<2, { 2 * COMMAND }> for PacketLoss {
    const NAME: &'static str = "packet_loss";
    const ABOUT: &'static str =
        "A command packet is lost with this probability; the vehicle keeps the last one that arrived";
    const SOURCE: &'static str = "losses per packet at the control rate, in bursts as of Gilbert (1960), \"Capacity of a burst-noise channel\"; the firmware holds the last set-point";
    const PARAMS: [Param; 2] = [
        param("probability", "1", 0.0, [0.0, 1.0])
            .about("share of the commands that are lost")
            .at_least(0.05),
        param("burst", "1", 0.0, [0.0, 0.95])
            .about("correlation of a loss with the one before: 1 / ((1 - probability) (1 - burst)) packets are lost at a time")
            .constant(),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;
    const DELAYS: bool = true;
    const OBSERVABILITY: Observability = Observability::HeldCommand;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, u: &Command<R>) -> [R; 2 * COMMAND] {
        let &[probability, _] = cx.params;
        let u = [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift];
        let behind = |i: usize| if R::MEAN { probability * u[i] } else { probability };
        tabulate(
            #[inline(always)]
            |i| if i < COMMAND { u[i] } else { behind(i - COMMAND) },
        )
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, memory: &mut [R; 2 * COMMAND], u: &mut Command<R>) {
        let &[probability, burst] = cx.params;
        let fields = [&mut u.roll_rad, &mut u.pitch_rad, &mut u.yaw_rate_radps, &mut u.lift];
        let (held, behind) = memory.split_at_mut(COMMAND);
        if cx.first {
            let arrives = R::from_f64(1.0) - probability;
            let [after_loss, after_arrival] =
                [probability + burst * arrives, probability * (R::from_f64(1.0) - burst)];
            if R::MEAN {
                for ((held, by_loss), new) in held.iter_mut().zip(behind).zip(&fields) {
                    *by_loss = *by_loss * after_loss + (*held - *by_loss) * after_arrival;
                    *held = arrives * **new + *by_loss;
                }
            } else {
                let likely = after_arrival + behind[0] * (after_loss - after_arrival);
                let lost = cx.draw.uniform(Self::NOISE).lt(likely);
                behind[0] = R::select(lost, R::from_f64(1.0), R::zero());
                for (held, new) in held.iter_mut().zip(&fields) {
                    *held = R::select(lost, *held, **new);
                }
            }
        }
        for (field, held) in fields.into_iter().zip(held) {
            *field = *held;
        }
    }
}
