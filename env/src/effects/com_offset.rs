//! Centre of mass off centre, or bad trim.

use super::{Call, Effect, FlightSpread, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct ComOffset;

impl Effect<2, 0> for ComOffset {
    const NAME: &'static str = "com_offset";
    const ABOUT: &'static str =
        "A torque in proportion to the thrust, given as the roll and pitch that balance it in hover";
    const SOURCE: &'static str =
        "Lever arm of the thrust about the centre of mass; held against by trim in crazyflie_ros";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-10.0, 10.0])
            .about("roll at which the vehicle settles in hover under a level command"),
        param("pitch_deg", "deg", 0.0, [-10.0, 10.0])
            .about("pitch at which the vehicle settles in hover under a level command"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;
    // trims differ by about a degree: with room to spare
    const FLIGHT_SPREAD: FlightSpread = FlightSpread::Lean(3.0);

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &mut Command<R>) {
        let per_deg = R::from_f64(std::f64::consts::PI / 180.0) * cx.body.thrust_ratio(u);
        for (i, angle) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().enumerate() {
            *angle += cx.body.command_for_tilt_rad(i, cx.params[i] * per_deg);
        }
    }
}
