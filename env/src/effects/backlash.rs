//! Play between the command and what obeys it.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct Backlash;

impl Effect<1, 2> for Backlash {
    const NAME: &'static str = "backlash";
    const ABOUT: &'static str = "Play: the obeyed roll and pitch stay where they are until the command has crossed the play, then are dragged along half of it behind";
    const SOURCE: &'static str =
        "Play operator of hysteresis (Krasnosel'skii and Pokrovskii 1989); the backlash of control textbooks";
    const PARAMS: [Param; 1] = [param("play_deg", "deg", 0.0, [0.0, 10.0])
        .about("full width of the play")
        .starting_from(&[0.8, 2.0])];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn start<R: Scalar>(_: Call<R, 1>, u: &Command<R>) -> [R; 2] {
        [u.roll_rad, u.pitch_rad]
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, obeyed: &mut [R; 2], u: &mut Command<R>) {
        let &[play_deg] = cx.params;
        let half = play_deg * R::from_f64(0.5 * std::f64::consts::PI / 180.0);
        for (angle, obeyed) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().zip(obeyed) {
            *angle -= (*angle - *obeyed).clamp(-half, half);
            *obeyed = *angle;
        }
    }
}
