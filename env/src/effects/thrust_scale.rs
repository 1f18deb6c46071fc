//! Propellers that pull more or less than thought.

use super::{Call, Effect, FlightSpread, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct ThrustScale;

impl Effect<2, 0> for ThrustScale {
    const NAME: &'static str = "thrust_scale";
    const ABOUT: &'static str = "Thrust scaled by a constant";
    const SOURCE: &'static str = "Propeller and motor spread; offset of 5.1.3 is hard to measure";
    const PARAMS: [Param; 2] = [
        param("scale", "1", 1.0, [0.5, 1.5]).about("thrust over declared thrust").at_least(0.01),
        param("torque_share", "1", 0.0, [0.0, 1.0])
            .about("how much of it the torques share: 0 where the attitude loop makes up for it, 1 where 5.1 and 5.2 lose as the thrust"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    // hover PWM of one vehicle spread by 3 % over flights: with room to spare
    const FLIGHT_SPREAD: FlightSpread = FlightSpread::Thrust(0.1);

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[scale, torque_share] = cx.params;
        let more = scale - R::from_f64(1.0);
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * more;
        cx.body.add_torque(torque_share * more, cx.h_s, cx.x, u, out);
    }
}
