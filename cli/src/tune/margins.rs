//! Distance of a loop from instability: gain, phase and delay margins of the PID around the identified model
//! with the loop's dead time.

use crazyflie_control::pid::Loop;
use crazyflie_env::model::{Model, Vertical, VerticalInput, Yaw};
use nalgebra::Complex;

/// A loop of the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LoopAxis {
    X,
    Y,
    Z,
    Yaw,
}

/// The order in which they are tuned: each with those before it as they came out.
pub(crate) const AXES: [LoopAxis; 4] = [LoopAxis::Yaw, LoopAxis::Z, LoopAxis::X, LoopAxis::Y];

impl LoopAxis {
    pub(crate) fn name(self) -> &'static str {
        match self {
            LoopAxis::X => "x",
            LoopAxis::Y => "y",
            LoopAxis::Z => "z",
            LoopAxis::Yaw => "yaw",
        }
    }
}

/// Numerator and denominator of a transfer function, highest power of s first.
#[derive(Debug, Clone)]
pub(crate) struct Plant {
    numerator: f64,
    denominator: Vec<f64>,
}

impl Plant {
    /// From the controller's output (degrees, PWM counts or deg/s) to what its loop measures (metres or
    /// radians).
    ///
    /// # Errors
    /// For a model that lacks the vertical form.
    pub(crate) fn from_model(
        model: &Model,
        input: VerticalInput,
        axis: LoopAxis,
    ) -> crazyflie_env::Result<Plant> {
        let (g, drag, deg) = (model.lateral.gravity.value, model.lateral.drag.value, 1.0_f64.to_radians());
        let sideways = |t: &crazyflie_env::model::Tilt| Plant {
            // 5.1 times g / (s (s + drag)), 5.5 with the position
            numerator: deg * g * t.gain.value,
            denominator: product(&[1.0, t.damping.value, t.stiffness.value], &[1.0, drag, 0.0]),
        };
        Ok(match axis {
            LoopAxis::X => sideways(&model.pitch),
            LoopAxis::Y => sideways(&model.roll),
            LoopAxis::Yaw => match &model.yaw {
                Yaw::Integrator { gain } => {
                    Plant { numerator: deg * gain.value.abs(), denominator: vec![1.0, 0.0] }
                }
                Yaw::Rate { gain, bandwidth } => Plant {
                    numerator: deg * gain.value.abs() * bandwidth.value,
                    denominator: vec![1.0, bandwidth.value, 0.0],
                },
                Yaw::SecondOrder { gain, damping, stiffness } => Plant {
                    numerator: deg * gain.value.abs(),
                    denominator: vec![1.0, damping.value, stiffness.value],
                },
            },
            LoopAxis::Z => match model.vertical(input)? {
                Vertical::FirstOrder { gain, pole, .. } => {
                    Plant { numerator: gain.value, denominator: vec![1.0, pole.value] }
                }
                Vertical::SecondOrder { gain, damping, stiffness, .. } => {
                    Plant { numerator: gain.value, denominator: vec![1.0, damping.value, stiffness.value] }
                }
                Vertical::Motors(form) => {
                    let AxisForm { u, .. } = Vertical::Motors(form.clone()).form(g);
                    Plant { numerator: u[1], denominator: vec![1.0, 0.0, 0.0] }
                }
                Vertical::Thrust { hover, heave } => {
                    Plant { numerator: g / hover.value, denominator: vec![1.0, heave.value, 0.0] }
                }
            },
        })
    }

    fn response_at(&self, s: Complex<f64>) -> Complex<f64> {
        let denominator = self.denominator.iter().fold(Complex::new(0.0, 0.0), |sum, c| sum * s + c);
        Complex::new(self.numerator, 0.0) / denominator
    }
}

fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut all = vec![0.0; a.len() + b.len() - 1];
    for (i, a) in a.iter().enumerate() {
        b.iter().enumerate().for_each(|(j, b)| all[i + j] += a * b);
    }
    all
}

/// Margins of a loop before it is unstable.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Margins {
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

/// Of the loop gain (kp + ki / s + kd s) P(s) exp(-s dead time).
///
/// A loop that begins above gain 1 with two integrations and falls below it once is stable if and only if its
/// phase is above -180 degrees there (Nyquist); with more crossings the worst counts.
pub(crate) fn margins(plant: &Plant, gains: &Loop, dead_time_s: f64) -> Margins {
    let points = PER_DECADE * (DECADES[1] - DECADES[0]) as usize;
    let frequency = |i: usize| 10.0_f64.powf(f64::from(DECADES[0]) + i as f64 / PER_DECADE as f64);
    let gain = |omega: f64| {
        let s = Complex::new(0.0, omega);
        (Complex::new(gains.kp, 0.0) + Complex::new(gains.ki, 0.0) / s + s * gains.kd) * plant.response_at(s)
    };
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

/// Where the frequencies begin, integrations have only taken phase, as many as there are.
fn below(angle: f64) -> f64 {
    if angle > 1e-6 { angle - std::f64::consts::TAU } else { angle }
}

fn wrap(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_control::pid::Gains;

    fn with_dead_time(gains: &Loop, dead_time_s: f64) -> Margins {
        margins(
            &Plant::from_model(&Model::thesis(), VerticalInput::Pwm, LoopAxis::X).unwrap(),
            gains,
            dead_time_s,
        )
    }

    /// The position loop of table 7.1 has 19 degrees without dead time and 9 with 77 ms; the stock gains have
    /// under 2 and none from 10 ms on.
    #[test]
    fn table_7_1_has_the_margin_that_it_should_and_the_stock_gains_have_none() {
        let (new, late) = (with_dead_time(&Gains::THESIS.x, 0.0), with_dead_time(&Gains::THESIS.x, 0.077));
        println!("table 7.1: {new:?}, with 77 ms {late:?}");
        assert!((new.phase_deg - 19.0).abs() < 1.0 && (late.phase_deg - 9.0).abs() < 1.0, "{new:?} {late:?}");
        let (stock, late) =
            (with_dead_time(&Gains::CRAZYFLIE_ROS.x, 0.0), with_dead_time(&Gains::CRAZYFLIE_ROS.x, 0.01));
        println!("stock: {stock:?}, with 10 ms {late:?}");
        assert!((0.0..2.0).contains(&stock.phase_deg) && late.phase_deg < 0.0, "{stock:?} {late:?}");
        assert!(late.gain_db < 0.0);
    }

    /// 1/s with gain k crosses at k with 90 degrees; a delay of pi / 2k takes them.
    #[test]
    fn an_integrator_is_as_in_the_book() {
        let l = Loop { kp: 4.0, ki: 0.0, kd: 0.0, integral: [0.0; 2], output: [0.0; 2] };
        let m = margins(&Plant { numerator: 1.0, denominator: vec![1.0, 0.0] }, &l, 0.0);
        assert!(
            (m.phase_deg - 90.0).abs() < 0.1
                && (m.crossover_radps - 4.0).abs() < 0.03
                && m.gain_db.is_infinite(),
            "{m:?}"
        );
        assert!((m.delay_ms - 1e3 * std::f64::consts::FRAC_PI_2 / 4.0).abs() < 3.0, "{m:?}");
    }
}
