//! Centre of mass off centre, or bad trim.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct ComOffset;

impl Effect<2, 0> for ComOffset {
    const NAME: &'static str = "com_offset";
    const ABOUT: &'static str = "A constant torque, said as the roll and pitch command that it equals";
    const SOURCE: &'static str = "Lever arm of the weight about the thrust centre: a constant angular acceleration, held against by trim in crazyflie_ros";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-10.0, 10.0], "roll command that the torque equals"),
        param("pitch_deg", "deg", 0.0, [-10.0, 10.0], "pitch command that the torque equals"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;

    #[inline(always)]
    fn command<R: Real>(&[roll_deg, pitch_deg]: &[R; 2], _: &mut [R; 0], _: &Cx<R>, _: &State<R>, u: &mut Command<R>) {
        let per_deg = R::of(std::f64::consts::PI / 180.0);
        u.roll_rad += roll_deg * per_deg;
        u.pitch_rad += pitch_deg * per_deg;
    }
}
