//! Everything that is drawn of a loop, as data.

use serde::Serialize;

use super::frequency::{FrequencyResponse, decades};
use super::{FeedbackLoop, Margins, StepResponse};
use crate::pid::Loop;

/// Frequencies of the plots, rad/s, and how many.
const RANGE_RADPS: [f64; 2] = [0.03, 300.0];
const FREQUENCIES: usize = 400;
/// Multiples of the gains along a root locus, and how many.
const FACTORS: [f64; 2] = [0.01, 100.0];
const POLES: usize = 241;
/// Length of a step response.
const SECONDS: f64 = 10.0;

/// A loop as its plots show it.
#[derive(Debug, Clone, Serialize)]
pub struct LoopReport {
    /// x, y, z or yaw.
    #[serde(rename = "loop")]
    pub name: &'static str,
    /// Gains of the PID.
    pub gains: Loop,
    /// From sensing to the command in force.
    pub dead_time_s: f64,
    /// Distance from instability.
    pub margins: Margins,
    /// Answer to a step of the set-point.
    pub step: StepResponse,
    /// Loop gain over the frequency.
    pub frequency: FrequencyResponse,
    /// Poles of the closed loop, 1/s.
    pub root_locus: RootLocus,
}

/// Poles of the closed loop for multiples of the gains.
#[derive(Debug, Clone, Serialize)]
pub struct RootLocus {
    /// Multiples of the gains.
    pub factors: Vec<f64>,
    /// Real parts, one row for each multiple.
    pub real: Vec<Vec<f64>>,
    /// Imaginary parts, likewise.
    pub imaginary: Vec<Vec<f64>>,
    /// Real and imaginary parts at the gains themselves.
    pub poles: Vec<[f64; 2]>,
}

impl FeedbackLoop {
    /// All plots of the loop, flown at `tick_s`.
    pub fn report(&self, name: &'static str, tick_s: f64) -> LoopReport {
        let factors = decades(FACTORS[0], FACTORS[1], POLES);
        let locus = self.root_locus(&factors);
        let part = |of: &dyn Fn(&nalgebra::Complex<f64>) -> f64| -> Vec<Vec<f64>> {
            locus.iter().map(|poles| poles.iter().map(of).collect()).collect()
        };
        let own = self.root_locus(&[1.0]).into_iter().flatten();
        LoopReport {
            name,
            gains: self.gains,
            dead_time_s: self.dead_time_s,
            margins: self.margins(),
            step: self.step_response(tick_s, SECONDS),
            frequency: self.frequency_response(&decades(RANGE_RADPS[0], RANGE_RADPS[1], FREQUENCIES)),
            root_locus: RootLocus {
                real: part(&|pole| pole.re),
                imaginary: part(&|pole| pole.im),
                poles: own.map(|pole| [pole.re, pole.im]).collect(),
                factors,
            },
        }
    }
}
