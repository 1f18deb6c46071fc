//! Frequency response of a loop, for Bode and Nyquist plots.

use std::f64::consts::TAU;

use super::FeedbackLoop;
use super::margins::below;

/// Loop gain over the frequency, dead time included.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct FrequencyResponse {
    /// Frequencies, in rad/s.
    pub omega_radps: Vec<f64>,
    /// Magnitude, in decibels.
    pub magnitude_db: Vec<f64>,
    /// Phase in degrees, without jumps of 360 degrees.
    pub phase_deg: Vec<f64>,
    /// Real part.
    pub real: Vec<f64>,
    /// Imaginary part.
    pub imaginary: Vec<f64>,
}

/// Frequencies evenly apart by their logarithm, rad/s.
pub fn decades(low_radps: f64, high_radps: f64, count: usize) -> Vec<f64> {
    let ratio = (high_radps / low_radps).ln() / count.saturating_sub(1).max(1) as f64;
    (0..count).map(|i| low_radps * (ratio * i as f64).exp()).collect()
}

impl FeedbackLoop {
    /// Loop gain at some frequencies in rad/s, from low to high.
    pub fn frequency_response(&self, omega_radps: &[f64]) -> FrequencyResponse {
        let open = self.open();
        let gains: Vec<_> =
            omega_radps.iter().map(|omega| open.response_at(nalgebra::Complex::new(0.0, *omega))).collect();
        // unwrapped without the dead time, whose phase may turn by more than a half between two frequencies
        let mut phase = None;
        let phase_deg = gains.iter().zip(omega_radps).map(|(gain, omega)| {
            let arg = gain.arg();
            let nearest = |last: f64| arg - TAU * ((arg - last) / TAU).round();
            let unwrapped = phase.map_or_else(|| below(arg), nearest);
            phase = Some(unwrapped);
            (unwrapped - omega * self.dead_time_s).to_degrees()
        });
        let phase_deg = phase_deg.collect();
        let late = omega_radps.iter().map(|omega| self.gain_at(*omega));
        let (real, imaginary) = late.map(|gain| (gain.re, gain.im)).unzip();
        FrequencyResponse {
            omega_radps: omega_radps.to_vec(),
            magnitude_db: gains.iter().map(|gain| 20.0 * gain.norm().log10()).collect(),
            phase_deg,
            real,
            imaginary,
        }
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::{Model, VerticalInput};

    use super::*;
    use crate::loop_analysis::LoopAxis;
    use crate::pid::Gains;

    #[test]
    fn at_the_crossover_the_magnitude_is_one_and_the_phase_is_the_margin() {
        let model = Model::thesis();
        for axis in LoopAxis::ALL {
            let own =
                FeedbackLoop::from_model(&model, VerticalInput::Pwm, axis, &Gains::THESIS, 0.077).unwrap();
            let margins = own.margins();
            let response = own.frequency_response(&decades(1e-2, margins.crossover_radps, 2000));
            assert!(response.magnitude_db.last().unwrap().abs() < 0.1, "{axis:?}");
            assert!((response.phase_deg.last().unwrap() + 180.0 - margins.phase_deg).abs() < 0.5, "{axis:?}");
            let radius = response.real.last().unwrap().hypot(*response.imaginary.last().unwrap());
            assert!((radius - 1.0).abs() < 0.01, "{axis:?}");
        }
    }
}
