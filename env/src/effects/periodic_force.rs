//! A periodic force.

use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct PeriodicForce;

impl Effect<5, 0> for PeriodicForce {
    const NAME: &'static str = "periodic_force";
    const ABOUT: &'static str = "A horizontal force per mass that swings at a frequency: sine and cosine parts since the flight began";
    const SOURCE: &'static str = "First harmonic of any periodic push, such as a fan that turns its head; linear in all but the frequency";
    const PARAMS: [Param; 5] = [
        param("frequency_hz", "Hz", 1.0, [0.02, 5.0]).about("of the swing"),
        param("x_sine_mps2", "m/s^2", 0.0, [-3.0, 3.0])
            .about("along world x, the part that starts at nothing"),
        param("x_cosine_mps2", "m/s^2", 0.0, [-3.0, 3.0])
            .about("along world x, the part that starts at its largest"),
        param("y_sine_mps2", "m/s^2", 0.0, [-3.0, 3.0])
            .about("along world y, the part that starts at nothing"),
        param("y_cosine_mps2", "m/s^2", 0.0, [-3.0, 3.0])
            .about("along world y, the part that starts at its largest"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    /// Held over a step of 10 ms, the fastest swing loses half a per cent.
    const PHYSICS_HZ: u32 = 100;
    const OBSERVABILITY: Observability = Observability::Located;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 5>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[frequency_hz, x_sine, x_cosine, y_sine, y_cosine] = cx.params;
        let turns = frequency_hz * (cx.t_s + R::from_f64(0.5 * cx.h_s));
        // whole turns are taken off first, where nothing is lost to rounding
        let (sin, cos) = (R::from_f64(std::f64::consts::TAU) * (turns - turns.round())).sin_cos();
        out.acc_mps2[0] += x_sine * sin + x_cosine * cos;
        out.acc_mps2[1] += y_sine * sin + y_cosine * cos;
    }
}
