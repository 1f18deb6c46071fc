//! A field of markers instead of one.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::scalar::Scalar;

pub struct Markers;

impl Effect<3, 0> for Markers {
    const NAME: &'static str = "markers";
    const ABOUT: &'static str =
        "Columns and rows of markers centred on the origin, for the field of view and the noise";
    const SOURCE: &'static str = "Thesis chapter 8, future work 1: combined markers";
    const PARAMS: [Param; 3] = [
        param("columns", "1", 1.0, [1.0, 9.0]).about("along x").counting(),
        param("rows", "1", 1.0, [1.0, 9.0]).about("along y").counting(),
        param("pitch_m", "m", 0.5, [0.2, 5.0]).about("from centre to centre"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Visibility;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], f: &mut Frame<R>) {
        let field = cx.params;
        f.field = *field;
    }
}
