//! Commands that may not have arrived. In the mean they are a delay, which other effects can represent; the pattern
//! of losses shows in how far the motion misses that mean. So probability and burst are sought on a grid, and only
//! the last fit estimates them.

use crazyflie_env::effects::{Entry, Observability};
use rayon::prelude::*;

use super::calibration::search::{BURST_STEP, BURSTS, LOSS_SD, PROBABILITIES, SHARE_STEP, TUNED};
use super::candidates::candidates;
use super::noise::FLOOR;
use super::search::{FilteredHypothesis, Proposal, Search};
use crate::fit::filter::Disturbances;
use crate::fit::hypothesis::{Hypothesis, Term};

/// An effect with its probability and burst.
type Losses = (&'static Entry, [f64; 2]);

/// Other probabilities and bursts, beside those of a hypothesis.
fn nearby_losses(judged: &FilteredHypothesis) -> Vec<Losses> {
    let Some(term) = judged.hypothesis.terms.iter().find(|t| is_lossy(t)) else { return Vec::new() };
    let &[p, burst] = term.values.as_slice() else { return Vec::new() };
    let bursts = [burst - BURST_STEP, burst, burst + BURST_STEP];
    let shares = [p / SHARE_STEP, p, (p * SHARE_STEP).min(0.95)];
    let grid = bursts.into_iter().flat_map(|burst| shares.map(|p| (term.entry, [p, burst])));
    grid.filter(|(_, near)| (0.0..0.95).contains(&near[1]) && *near != [p, burst]).collect()
}

/// Returns whether commands can be lost by this term.
pub fn is_lossy(term: &Term) -> bool {
    term.entry.observability == Observability::HeldCommand
}

/// The hypothesis with its lost commands fixed. Output error over windows sees only a delay in them and would
/// move them away from what the filter found; a newcomer is fitted beside them without that.
pub fn hold_losses(hypothesis: &Hypothesis) -> Hypothesis {
    let mut held = hypothesis.clone();
    held.terms.iter_mut().filter(|t| is_lossy(t)).for_each(|t| t.free.clear());
    held
}

/// A fitted hypothesis and its standard errors, with those lost commands free again that were free in `settled`.
pub fn release_losses(fitted: Proposal, settled: &Hypothesis) -> Proposal {
    settled.terms.iter().filter(|t| is_lossy(t)).fold(fitted, |fitted, term| {
        fitted.without(term.entry.name).with(term, &vec![LOSS_SD; term.free.len()])
    })
}

impl Search<'_> {
    /// The best hypothesis with commands that may not arrive, if there is such an effect that it does not have. The
    /// windows see only the expected part, a delay; the filter sees that the vehicle is shaken just when commands
    /// change, once its disturbances no longer cover it. `None` too if all fall hopelessly behind these losses, see
    /// [`FilteredHypothesis::losses`].
    pub fn best_with_lost_commands(
        &self,
        now: &FilteredHypothesis,
        least: &[f64],
    ) -> Option<FilteredHypothesis> {
        let unshaken = Disturbances { torque: FLOOR.torque, ..now.disturbances };
        let judge_losses = |(entry, values): Losses| {
            let mut term = Term::off(entry);
            term.values.copy_from_slice(&values);
            // lost one by one, the bursts are at their bound and have no estimate
            term.free = if values[1] > 0.0 { vec![0, 1] } else { vec![0] };
            let sd = vec![LOSS_SD; term.free.len()];
            self.judge_against(&now.settled().with(&term, &sd), &unshaken, least)
        };
        let absent = candidates(&now.at_posterior()).into_iter().map(|c| c.entry);
        let grid =
            |entry| PROBABILITIES.into_iter().flat_map(move |p| BURSTS.map(|burst| (entry, [p, burst])));
        let lossy = absent.filter(|e| e.observability == Observability::HeldCommand);
        let tried: Vec<Losses> = lossy.flat_map(grid).collect();
        let mut judged: Vec<FilteredHypothesis> = tried.into_par_iter().filter_map(judge_losses).collect();
        judged.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let neighbours = judged.first().map_or_else(Vec::new, nearby_losses);
        judged.extend(neighbours.into_par_iter().filter_map(judge_losses).collect::<Vec<_>>());
        judged.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        judged.par_iter().take(TUNED).filter_map(|j| self.retune(j)).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// Searches lost commands anew, if a hypothesis has them: another effect may have represented their pattern.
    pub(super) fn with_other_losses(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let settled = judged.at_posterior();
        let held = settled.terms.iter().find(|t| is_lossy(t))?.entry.name;
        let without = self.judge(&judged.settled().without(held), &judged.disturbances)?;
        self.best_with_lost_commands(&without, &judged.losses)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::effects::find;
    use crazyflie_env::model::Model;

    #[test]
    fn lost_commands_are_held_beside_a_newcomer_and_then_free_again() {
        let term = |name: &str, value: f64| {
            let mut term = Term::off(find(name).unwrap().1);
            term.values[0] = value;
            term
        };
        let settled = Hypothesis::from_model(&Model::thesis()).with(term("packet_loss", 0.4));
        let free = settled.free_values().len();
        let held = hold_losses(&settled).with(term("heave_damping", 0.5));
        assert_eq!(held.free_values(), [0.5]);
        let held = Proposal { hypothesis: held, sd: vec![0.1] };
        let Proposal { hypothesis: released, sd } = release_losses(held, &settled);
        assert_eq!(released.free_values().len(), free + 1);
        let losses = released.place("packet_loss");
        assert_eq!(released.free_values()[losses.start], 0.4);
        assert!(sd[losses].iter().all(|sd| *sd == LOSS_SD));
        assert_eq!(sd[released.place("heave_damping")], [0.1]);
    }
}
