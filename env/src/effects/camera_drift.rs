//! A slow error of the marker pose.

use super::{Call, Effect, Frame, GaussMarkovSignal, Hooks, Observability, Param, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct CameraDrift;

impl Effect<2, 3> for CameraDrift {
    const NAME: &'static str = "camera_drift";
    const ABOUT: &'static str = "An error of the marker position that comes and goes slowly";
    const SOURCE: &'static str = "First-order Gauss-Markov error per axis: lens calibration, light, marker edges (thesis 5.1.3 sees errors that one does not notice)";
    const PARAMS: [Param; 2] = [
        param("sigma_m", "m", 0.0, [0.0, 0.2]).about("standard deviation of each axis"),
        param("tau_s", "s", 2.0, [0.1, 60.0]).about("correlation time"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::GaussMarkov(GaussMarkovSignal::Marker);

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, _: &Command<R>) -> [R; 3] {
        let &[sigma_m, _] = cx.params;
        let ([a, b], [c, _]) =
            (cx.draw.normals(Self::NOISE.wrapping_add(10)), cx.draw.normals(Self::NOISE.wrapping_add(11)));
        [sigma_m * a, sigma_m * b, sigma_m * c]
    }

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 2>, error: &mut [R; 3], f: &mut Frame<R>) {
        let &[sigma_m, tau_s] = cx.params;
        let keep = (R::from_f64(-cx.h_s) / tau_s).exp();
        let spread = sigma_m * (R::from_f64(1.0) - keep * keep).sqrt();
        let ([a, b], [c, _]) = (cx.draw.normals(Self::NOISE), cx.draw.normals(Self::NOISE.wrapping_add(1)));
        for (i, n) in [a, b, c].into_iter().enumerate() {
            error[i] = R::select(f.captured, keep * error[i] + spread * n, error[i]);
            f.pos_m[i] += error[i];
        }
    }
}
