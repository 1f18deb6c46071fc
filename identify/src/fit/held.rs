//! Commands that may not have arrived: what the vehicle obeys lies off its expectation by as much as commands change.

use crazyflie_env::config::numbers;
use crazyflie_env::effects::{Entry, Observability, find};
use crazyflie_env::model::Yaw;
use crazyflie_env::plant::Command;

use super::flight::Flight;
use super::hypothesis::Hypothesis;

/// Places of roll, pitch, yaw rate and lift among the numbers of a push.
pub const AXES: [usize; 4] = [3, 4, 5, 2];

/// The first two moments of the command that is obeyed when each is lost with a probability and the one before holds on: tick by tick, exactly.
#[derive(Debug, Clone)]
pub struct Held {
    pub probability: f64,
    /// What a unit of each command pushes.
    pub push: [f64; AXES.len()],
    mean: [f64; AXES.len()],
    pub variance: [f64; AXES.len()],
}

fn probability(hypothesis: &Hypothesis) -> Option<f64> {
    let holds = |entry: &Entry| entry.observability == Observability::HeldCommand;
    if let Some(term) = hypothesis.terms.iter().find(|t| holds(t.entry)) {
        return term.values.first().copied();
    }
    let declared = hypothesis.model.effects.iter().filter_map(|(name, given)| Some((find(name).ok()?.1, given)));
    declared.filter(|(entry, _)| holds(entry)).find_map(|(entry, given)| numbers(entry, given).first()?.fixed())
}

fn listed(u: &Command<f64>) -> [f64; AXES.len()] {
    [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]
}

impl Held {
    /// As it stands in a tick of a flight. `None` if the hypothesis loses nothing.
    pub fn of(hypothesis: &Hypothesis, flight: &Flight, tick: usize) -> Option<Self> {
        let probability = probability(hypothesis).filter(|p| *p > 0.0 && *p < 1.0)?;
        let model = &hypothesis.model;
        let hover = model.vertical(flight.input).ok()?.hover_pwm().filter(|_| flight.input.is_pwm());
        // a heading that is the command's integral (5.2) turns by no push
        let turn = match &model.yaw {
            Yaw::Integrator { .. } => 0.0,
            Yaw::Rate { gain, bandwidth } => gain.value * bandwidth.value,
            Yaw::SecondOrder { gain, .. } => gain.value,
        };
        let lift = hover.map_or(0.0, |pwm| model.lateral.gravity.value / pwm);
        let push = [model.roll.gain.value, model.pitch.gain.value, turn, lift];
        let before = tick as isize - (MEMORY_TICKS as isize);
        let mut held = Held { probability, push, mean: listed(flight.command(before)), variance: [0.0; AXES.len()] };
        for k in before + 1..=tick as isize {
            held.next(flight.command(k));
        }
        Some(held)
    }

    /// Goes on to the tick of this command. Returns the variances that came in with it; of the deviation before, the share `probability` stays.
    pub fn next(&mut self, u: &Command<f64>) -> [f64; AXES.len()] {
        let p = self.probability;
        std::array::from_fn(|i| {
            let change = listed(u)[i] - self.mean[i];
            let new = p * (1.0 - p) * (self.variance[i] + change * change);
            self.mean[i] += (1.0 - p) * change;
            self.variance[i] = p * p * self.variance[i] + new;
            new
        })
    }
}

/// What was lost longer ago is forgotten.
const MEMORY_TICKS: usize = 15;

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a count over 40 000 radios that lose each packet by chance.
    #[test]
    fn mean_and_variance_are_those_of_many_radios() {
        let probability = 0.35;
        let of = |angle: f64| Command { roll_rad: angle, yaw_rate_radps: angle, ..Command::level(0.0) };
        let mut held = Held { probability, push: [1.0; AXES.len()], mean: [0.0; AXES.len()], variance: [0.0; AXES.len()] };
        let mut radios = vec![0.0; 40_000];
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for k in 0..30 {
            let command = (0.7 * k as f64).sin();
            held.next(&of(command));
            for radio in &mut radios {
                if uniform() >= probability {
                    *radio = command;
                }
            }
            let n = radios.len() as f64;
            let mean = radios.iter().sum::<f64>() / n;
            let variance = radios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
            assert!((held.mean[0] - mean).abs() < 0.02, "{k}: {} against {mean}", held.mean[0]);
            assert!((held.variance[0] - variance).abs() < 0.02, "{k}: {} against {variance}", held.variance[0]);
            assert_eq!([held.mean[0], held.variance[0]], [held.mean[2], held.variance[2]], "a yaw rate is lost alike");
        }
    }
}
