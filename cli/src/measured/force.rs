//! The vertical specific force: what an accelerometer held upright would read, predicted and measured.

use crazyflie_env::model::Model;
use crazyflie_identify::fit::flight::{Flight, Window};
use crazyflie_identify::fit::hypothesis::Hypothesis;
use crazyflie_identify::fit::predict::MeanSimulator;
use crazyflie_statistics::rms;

const GRAVITY_MPS2: f64 = 9.81;
/// Velocities differ over this time, predictions are averaged over it.
const SMOOTH_S: f64 = 0.1;
/// Lower, the floor pushes.
const LOWEST_M: f64 = 0.3;

/// Of one flight, at the ticks that count.
pub(super) struct SpecificForce {
    pub(super) t_s: Vec<f64>,
    pub(super) measured_mps2: Vec<f64>,
    pub(super) predicted_mps2: Vec<f64>,
}

/// From the measured state at every tick, one tick ahead by the command.
pub(super) fn force(flight: &Flight, at: &Hypothesis) -> Option<SpecificForce> {
    let fixed = at.without_free();
    let mut worker = MeanSimulator::new(&fixed, flight, false).ok()?;
    let mut ahead = |tick: usize| {
        let mut own = flight.measured_numbers(tick);
        let climb_mps = own[5];
        let lags = worker.initial_lags(flight, tick, &own);
        own.extend(lags);
        worker.predict(flight, &Window { flight: 0, ticks: tick..tick + 1 }, &own);
        (worker.end().0[5] - climb_mps) / flight.tick_s + GRAVITY_MPS2
    };
    let all: Vec<f64> = (0..flight.ticks).map(&mut ahead).collect();
    let half = ((0.5 * SMOOTH_S / flight.tick_s).round() as usize).max(1);
    let mut out = SpecificForce { t_s: Vec::new(), measured_mps2: Vec::new(), predicted_mps2: Vec::new() };
    for tick in half..flight.ticks.saturating_sub(half) {
        if flight.measured_state(tick).pos_m[2] < LOWEST_M {
            continue;
        }
        let climb = |tick: usize| flight.measured_state(tick).vel_mps[2];
        let span_s = 2.0 * half as f64 * flight.tick_s;
        out.t_s.push(tick as f64 * flight.tick_s);
        out.measured_mps2.push((climb(tick + half) - climb(tick - half)) / span_s + GRAVITY_MPS2);
        out.predicted_mps2.push(all[tick - half..tick + half].iter().sum::<f64>() / (2 * half) as f64);
    }
    Some(out)
}

/// Root mean square error over flights.
pub(super) fn error(flights: &[Flight], at: &Hypothesis) -> f64 {
    let errors =
        |f: SpecificForce| f.measured_mps2.into_iter().zip(f.predicted_mps2).map(|(m, p)| m - p).collect();
    rms(&flights.iter().filter_map(|f| force(f, at)).flat_map::<Vec<f64>, _>(errors).collect::<Vec<_>>())
        .unwrap_or(f64::NAN)
}

/// The same of a prediction that the vehicle always carries its weight.
pub(super) fn constant_gravity_error(flights: &[Flight]) -> f64 {
    let at = |f: &Flight| force(f, &Hypothesis::from_model(&Model::thesis()));
    rms(&flights
        .iter()
        .filter_map(at)
        .flat_map(|f| f.measured_mps2)
        .map(|m| m - GRAVITY_MPS2)
        .collect::<Vec<_>>())
    .unwrap_or(f64::NAN)
}
