//! Axes turned against each other.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct AllocCross;

impl Effect<1, 0> for AllocCross {
    const NAME: &'static str = "alloc_cross";
    const ABOUT: &'static str = "Roll and pitch commands act about axes turned by this angle";
    const SOURCE: &'static str = "A flight controller mounted askew: motor allocation in a frame turned about z";
    const PARAMS: [Param; 1] = [
        param("angle_deg", "deg", 0.0, [-45.0, 45.0], "right-handed about z"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;

    #[inline(always)]
    fn command<R: Real>(&[angle_deg]: &[R; 1], _: &mut [R; 0], _: &Cx<R>, _: &State<R>, u: &mut Command<R>) {
        let (sin, cos) = (angle_deg * R::of(std::f64::consts::PI / 180.0)).sin_cos();
        let (roll, pitch) = (u.roll_rad, u.pitch_rad);
        u.roll_rad = cos * roll - sin * pitch;
        u.pitch_rad = sin * roll + cos * pitch;
    }
}
