//! Distance of a loop from instability.

use crazyflie_env::scalar::wrap;
use nalgebra::Complex;

use super::FeedbackLoop;

/// Margins of a loop before it is unstable.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Margins {
    /// At the worst crossing; negative where the loop is unstable.
    pub phase_deg: f64,
    /// The least that the gain can grow by; negative for an unstable loop that less gain would help, infinite
    /// where the phase never falls through -180 degrees.
    pub gain_db: f64,
    /// More dead time than there is.
    pub delay_ms: f64,
    /// Frequency at which the loop gain falls through 1.
    pub crossover_radps: f64,
}

/// Points per decade of the frequencies that are looked at, and the decades.
const PER_DECADE: usize = 400;
const DECADES: [i32; 2] = [-2, 3];

impl FeedbackLoop {
    /// Computes the margins of the loop gain (kp + ki / s + kd s) P(s) exp(-s dead time).
    ///
    /// A loop that begins above gain 1 with two integrations and falls below it once is stable if and only if
    /// its phase is above -180 degrees there (Nyquist); with more crossings the worst counts.
    pub fn margins(&self) -> Margins {
        let points = PER_DECADE * (DECADES[1] - DECADES[0]) as usize;
        let frequency = |i: usize| 10.0_f64.powf(f64::from(DECADES[0]) + i as f64 / PER_DECADE as f64);
        let open = self.open();
        let dead_time_s = self.dead_time_s;
        let gain = |omega: f64| open.response_at(Complex::new(0.0, omega));
        let mut least = Margins {
            phase_deg: f64::INFINITY,
            gain_db: f64::INFINITY,
            delay_ms: f64::INFINITY,
            crossover_radps: 0.0,
        };
        let mut before: Option<(f64, f64, f64)> = None;
        for omega in (0..=points).map(frequency) {
            let l = gain(omega);
            // phases are unwrapped along the way, the dead time added after
            let raw = before.map_or_else(|| below(l.arg()), |(_, last, _)| last + wrap(l.arg() - last));
            let (db, phase) = (20.0 * l.norm().log10(), raw - omega * dead_time_s);
            if let Some((db_before, _, phase_before)) = before {
                if (db_before > 0.0) != (db > 0.0) {
                    let phase_deg = 180.0 + phase.to_degrees();
                    if phase_deg < least.phase_deg {
                        least = Margins {
                            phase_deg,
                            delay_ms: 1e3 * phase_deg.to_radians() / omega,
                            crossover_radps: omega,
                            ..least
                        };
                    }
                }
                let pi = std::f64::consts::PI;
                if phase_before > -pi && phase <= -pi {
                    least.gain_db = least.gain_db.min(-db);
                }
            }
            before = Some((db, raw, phase));
        }
        least
    }
}

/// Wraps an angle below zero: at the lowest frequencies, integrations have only subtracted phase, each its share.
pub(super) fn below(angle: f64) -> f64 {
    if angle > 1e-6 { angle - std::f64::consts::TAU } else { angle }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::{Model, VerticalInput};
    use crazyflie_env::transfer_function::TransferFunction;

    use super::*;
    use crate::loop_analysis::LoopAxis;
    use crate::pid::{Gains, Loop};

    fn with_dead_time(gains: &Gains, dead_time_s: f64) -> Margins {
        let (model, input) = (Model::thesis(), VerticalInput::Pwm);
        FeedbackLoop::from_model(&model, input, LoopAxis::X, gains, dead_time_s).unwrap().margins()
    }

    /// The position loop of table 7.1 has 19 degrees without dead time and 9 with 77 ms; the stock gains have
    /// under 2 and none from 10 ms on.
    #[test]
    fn table_7_1_has_the_margin_that_it_should_and_the_stock_gains_have_none() {
        let (new, late) = (with_dead_time(&Gains::THESIS, 0.0), with_dead_time(&Gains::THESIS, 0.077));
        assert!((new.phase_deg - 19.0).abs() < 1.0 && (late.phase_deg - 9.0).abs() < 1.0, "{new:?} {late:?}");
        let (stock, late) =
            (with_dead_time(&Gains::CRAZYFLIE_ROS, 0.0), with_dead_time(&Gains::CRAZYFLIE_ROS, 0.01));
        assert!((0.0..2.0).contains(&stock.phase_deg) && late.phase_deg < 0.0, "{stock:?} {late:?}");
        assert!(late.gain_db < 0.0);
    }

    /// 1/s with gain k crosses at k with 90 degrees; a delay of pi / 2k takes them.
    #[test]
    fn an_integrator_is_as_in_the_book() {
        let gains = Loop { kp: 4.0, ki: 0.0, kd: 0.0, integral: [0.0; 2], output: [0.0; 2] };
        let plant = TransferFunction { numerator: vec![1.0], denominator: vec![1.0, 0.0] };
        let m = FeedbackLoop { plant, gains, dead_time_s: 0.0 }.margins();
        assert!(
            (m.phase_deg - 90.0).abs() < 0.1
                && (m.crossover_radps - 4.0).abs() < 0.03
                && m.gain_db.is_infinite(),
            "{m:?}"
        );
        assert!((m.delay_ms - 1e3 * std::f64::consts::FRAC_PI_2 / 4.0).abs() < 3.0, "{m:?}");
    }
}
