//! The camera instead of an ideal localisation.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct Camera;

impl Effect<1, 0> for Camera {
    const NAME: &'static str = "camera";
    const ABOUT: &'static str = "Positions come from camera frames at the rig's 30 Hz instead of at every control tick; any other camera effect implies it";
    const SOURCE: &'static str =
        "Thesis 3.1.2: 30 frames per second; frames do not fall on the 50 Hz control ticks";
    const PARAMS: [Param; 1] = [param("on", "1", 0.0, [0.0, 1.0]).about("1 to fly by camera")];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Visibility;

    // frames flow as soon as any effect has the frame hook: nothing is left to do
    #[inline(always)]
    fn frame<R: Scalar>(_: Call<R, 1>, _: &mut [R; 0], _: &mut Frame<R>) {}
}
