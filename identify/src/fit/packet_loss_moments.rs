//! Mean and variance of the command that a vehicle obeys when each packet may be lost.

use crazyflie_env::config::Number;
use crazyflie_env::effects::{Entry, Observability, find, numbers};
use crazyflie_env::model::Yaw;
use crazyflie_env::plant::Command;

use super::flight::Flight;
use super::hypothesis::Hypothesis;

/// Places of roll, pitch, yaw rate and lift among the numbers of a push.
pub const AXES: [usize; 4] = [3, 4, 5, 2];

/// The first two moments of the applied command when each is lost with a probability, in bursts or not, and the one
/// before stays in force: tick by tick, exactly.
#[derive(Debug, Clone)]
pub struct PacketLossMoments {
    losses: Losses,
    /// Acceleration per unit of each command.
    pub push_per_unit: [f64; AXES.len()],
    moments: [Moments; AXES.len()],
}

/// Statistics of packet loss: the share of lost packets, and the correlation of a loss with the one before.
#[derive(Debug, Clone, Copy)]
struct Losses {
    probability: f64,
    burst: f64,
}

/// Moments of one number of the command: mean and mean square, and the parts of both due to lost packets.
#[derive(Debug, Clone, Copy)]
struct Moments {
    mean: f64,
    square: f64,
    lost_mean: f64,
    lost_square: f64,
}

/// The deviation of the applied command from its mean, propagated to the next tick: the share that stays, and the
/// variance that is added.
#[derive(Debug, Clone, Copy, Default)]
pub struct Deviation {
    pub stays: f64,
    pub gain: f64,
}

impl Moments {
    /// Returns the moments of a command that has long been in force.
    fn constant(u: f64, losses: Losses) -> Self {
        let p = losses.probability;
        Moments { mean: u, square: u * u, lost_mean: p * u, lost_square: p * u * u }
    }

    fn variance(&self) -> f64 {
        (self.square - self.mean * self.mean).max(0.0)
    }

    fn advance(&mut self, u: f64, Losses { probability: p, burst }: Losses) -> Deviation {
        let [after_loss, after_arrival] = [p + burst * (1.0 - p), p * (1.0 - burst)];
        let before = *self;
        self.lost_mean = before.lost_mean * after_loss + (before.mean - before.lost_mean) * after_arrival;
        self.lost_square =
            before.lost_square * after_loss + (before.square - before.lost_square) * after_arrival;
        self.mean = (1.0 - p) * u + self.lost_mean;
        self.square = (1.0 - p) * u * u + self.lost_square;
        // a lost packet keeps the last command; one that arrives replaces it
        let product = self.lost_square + u * (before.mean - self.lost_mean);
        let variance = before.variance();
        // below this share of the square, rounding is what is left
        let known = variance > 1e-9 * before.square;
        let stays = if known { (product - self.mean * before.mean) / variance } else { 0.0 };
        Deviation { stays, gain: (self.variance() - stays * stays * variance).max(0.0) }
    }
}

fn losses(hypothesis: &Hypothesis) -> Option<Losses> {
    let holds = |entry: &Entry| entry.observability == Observability::HeldCommand;
    let values: Vec<f64> = match hypothesis.terms.iter().find(|t| holds(t.entry)) {
        Some(term) => term.values.clone(),
        None => {
            let declared = hypothesis.model.effects.iter();
            let (entry, given) = declared
                .filter_map(|(name, given)| Some((find(name).ok()?.1, given)))
                .find(|(entry, _)| holds(entry))?;
            numbers(entry, given).iter().map(Number::fixed).collect::<Option<_>>()?
        }
    };
    let &[probability, burst] = values.as_slice() else { return None };
    (probability > 0.0 && probability < 1.0).then_some(Losses { probability, burst })
}

fn command_numbers(u: &Command<f64>) -> [f64; AXES.len()] {
    [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]
}

impl PacketLossMoments {
    /// The moments in a tick of a flight. `None` if the hypothesis loses nothing.
    pub fn at_tick(hypothesis: &Hypothesis, flight: &Flight, tick: usize) -> Option<Self> {
        let losses = losses(hypothesis)?;
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
            losses,
            push_per_unit,
            moments: command_numbers(flight.command(before)).map(|u| Moments::constant(u, losses)),
        };
        for k in before + 1..=tick as isize {
            moments.advance(flight.command(k));
        }
        Some(moments)
    }

    /// Variances of the obeyed command about its mean.
    pub fn variance(&self) -> [f64; AXES.len()] {
        self.moments.map(|m| m.variance())
    }

    /// Goes on to the tick of this command.
    pub fn advance(&mut self, u: &Command<f64>) -> [Deviation; AXES.len()] {
        let (u, losses) = (command_numbers(u), self.losses);
        std::array::from_fn(|i| self.moments[i].advance(u[i], losses))
    }
}

/// Commands older than this no longer count.
const MEMORY_TICKS: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    /// Against a count over 40 000 radios that lose packets by chance, one by one and in bursts.
    #[test]
    fn moments_are_those_of_many_radios() {
        for burst in [0.0, 0.6] {
            let losses = Losses { probability: 0.35, burst };
            let mut moments = Moments::constant(0.0, losses);
            let mut rng = Pcg64::seed_from_u64(1);
            let mut radios: Vec<(bool, f64)> =
                (0..40_000).map(|_| (rng.random::<f64>() < 0.35, 0.0)).collect();
            let mut before: Vec<f64> = vec![0.0; radios.len()];
            for k in 0..30 {
                let command = (0.7 * k as f64).sin();
                let (mean_before, variance_before) = (moments.mean, moments.variance());
                let deviation = moments.advance(command, losses);
                for (lost, radio) in &mut radios {
                    *lost =
                        rng.random::<f64>() < if *lost { 0.35 + burst * 0.65 } else { 0.35 * (1.0 - burst) };
                    *radio = if *lost { *radio } else { command };
                }
                let average =
                    |f: &dyn Fn(usize) -> f64| (0..radios.len()).map(f).sum::<f64>() / radios.len() as f64;
                let mean = average(&|i| radios[i].1);
                let variance = average(&|i| (radios[i].1 - mean).powi(2));
                let product = average(&|i| (radios[i].1 - mean) * (before[i] - mean_before));
                assert!((moments.mean - mean).abs() < 0.02, "{k}: {} against {mean}", moments.mean);
                assert!(
                    (moments.variance() - variance).abs() < 0.02,
                    "{k}: {} against {variance}",
                    moments.variance()
                );
                let stays = deviation.stays * variance_before;
                assert!((stays - product).abs() < 0.02, "{k}: {stays} against {product}");
                before = radios.iter().map(|(_, radio)| *radio).collect();
            }
        }
    }

    /// Lost one by one, the share of the deviation that stays is the probability.
    #[test]
    fn without_bursts_the_probability_stays() {
        let losses = Losses { probability: 0.3, burst: 0.0 };
        let mut moments = Moments::constant(0.0, losses);
        moments.advance(1.0, losses);
        let deviation = moments.advance(0.5, losses);
        assert!((deviation.stays - 0.3).abs() < 1e-12, "{deviation:?}");
    }
}
