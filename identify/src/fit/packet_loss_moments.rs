//! Mean and variance of the command that a vehicle obeys when each packet may be lost.

use crazyflie_env::config::numbers;
use crazyflie_env::effects::{Entry, Observability, find};
use crazyflie_env::model::Yaw;
use crazyflie_env::plant::Command;

use super::flight::Flight;
use super::hypothesis::Hypothesis;

/// Places of roll, pitch, yaw rate and lift among the numbers of a push.
pub const AXES: [usize; 4] = [3, 4, 5, 2];

/// The first two moments of the command that is obeyed when each is lost with a probability and the one
/// before holds on: tick by tick, exactly.
#[derive(Debug, Clone)]
pub struct PacketLossMoments {
    pub probability: f64,
    /// Acceleration per unit of each command.
    pub push_per_unit: [f64; AXES.len()],
    mean: [f64; AXES.len()],
    pub variance: [f64; AXES.len()],
}

fn loss_probability(hypothesis: &Hypothesis) -> Option<f64> {
    let holds = |entry: &Entry| entry.observability == Observability::HeldCommand;
    if let Some(term) = hypothesis.terms.iter().find(|t| holds(t.entry)) {
        return term.values.first().copied();
    }
    let declared =
        hypothesis.model.effects.iter().filter_map(|(name, given)| Some((find(name).ok()?.1, given)));
    declared
        .filter(|(entry, _)| holds(entry))
        .find_map(|(entry, given)| numbers(entry, given).first()?.fixed())
}

fn command_numbers(u: &Command<f64>) -> [f64; AXES.len()] {
    [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]
}

impl PacketLossMoments {
    /// The moments in a tick of a flight. `None` if the hypothesis loses nothing.
    pub fn at_tick(hypothesis: &Hypothesis, flight: &Flight, tick: usize) -> Option<Self> {
        let probability = loss_probability(hypothesis).filter(|p| *p > 0.0 && *p < 1.0)?;
        let model = &hypothesis.model;
        let hover = model.vertical(flight.input).ok()?.hover_pwm().filter(|_| flight.input.is_pwm());
        // a heading that is the command's integral (5.2) turns by no push
        let yaw = match &model.yaw {
            Yaw::Integrator { .. } => 0.0,
            Yaw::Rate { gain, bandwidth } => gain.value * bandwidth.value,
            Yaw::SecondOrder { gain, .. } => gain.value,
        };
        let lift = hover.map_or(0.0, |pwm| model.lateral.gravity.value / pwm);
        let push_per_unit = [model.roll.gain.value, model.pitch.gain.value, yaw, lift];
        let before = tick as isize - (MEMORY_TICKS as isize);
        let mut moments = PacketLossMoments {
            probability,
            push_per_unit,
            mean: command_numbers(flight.command(before)),
            variance: [0.0; AXES.len()],
        };
        for k in before + 1..=tick as isize {
            moments.advance(flight.command(k));
        }
        Some(moments)
    }

    /// Goes on to the tick of this command. Returns the variances that came in with it; of the deviation
    /// before, the share `probability` stays.
    pub fn advance(&mut self, u: &Command<f64>) -> [f64; AXES.len()] {
        let p = self.probability;
        std::array::from_fn(|i| {
            let change = command_numbers(u)[i] - self.mean[i];
            let new = p * (1.0 - p) * (self.variance[i] + change * change);
            self.mean[i] += (1.0 - p) * change;
            self.variance[i] = p * p * self.variance[i] + new;
            new
        })
    }
}

/// Commands older than this no longer count.
const MEMORY_TICKS: usize = 15;

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a count over 40 000 radios that lose each packet by chance.
    #[test]
    fn mean_and_variance_are_those_of_many_radios() {
        let probability = 0.35;
        let command_for =
            |angle: f64| Command { roll_rad: angle, yaw_rate_radps: angle, ..Command::level(0.0) };
        let mut moments = PacketLossMoments {
            probability,
            push_per_unit: [1.0; AXES.len()],
            mean: [0.0; AXES.len()],
            variance: [0.0; AXES.len()],
        };
        let mut radios = vec![0.0; 40_000];
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for k in 0..30 {
            let command = (0.7 * k as f64).sin();
            moments.advance(&command_for(command));
            for radio in &mut radios {
                if uniform() >= probability {
                    *radio = command;
                }
            }
            let n = radios.len() as f64;
            let mean = radios.iter().sum::<f64>() / n;
            let variance = radios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
            assert!((moments.mean[0] - mean).abs() < 0.02, "{k}: {} against {mean}", moments.mean[0]);
            assert!(
                (moments.variance[0] - variance).abs() < 0.02,
                "{k}: {} against {variance}",
                moments.variance[0]
            );
            assert_eq!(
                [moments.mean[0], moments.variance[0]],
                [moments.mean[2], moments.variance[2]],
                "a yaw rate is lost alike"
            );
        }
    }
}
