//! Free curves beside a selection: how much an acceleration of any shape of one input would gain. A law of the right
//! shape leaves such a curve nothing.

use crazyflie_env::effects::{CURVES, Curve, Entry, Observability, registry};
use rayon::prelude::*;

use super::calibration::curves::{MOST_CURVES, WORTH_TEST};
use super::calibration::verdict::WORTH_BOTH;
use super::leftover::FINDING;
use super::search::{FilteredHypothesis, Search, SearchPair};
use super::selection::{Selection, eliminate};
use super::signals::Signal;
use super::verdict::{Leftover, Structure};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::solve::NormalEquations;

/// A free curve beside a hypothesis.
#[derive(Debug, Clone, Copy)]
pub struct CurveGain {
    pub curve: &'static Curve,
    /// Log-likelihood that it gains on the test flights, at the values that fit the flights of the fit, the other
    /// parameters following.
    pub test: f64,
}

impl CurveGain {
    /// The curve as a structure that no effect accounts for.
    pub fn leftover(&self) -> Leftover {
        curve_leftover(self.curve, (self.test / WORTH_TEST).sqrt())
    }
}

/// A curve as a structure that no effect accounts for, so many times as strong as one must be.
pub fn curve_leftover(curve: &Curve, strength: f64) -> Leftover {
    let (part, force) =
        if curve.is_vertical { (Signal::Vertical, "lift") } else { (Signal::Sideways, "force") };
    let finding = format!("goes with {} by another law than that of any effect", curve.input);
    Leftover::new(Structure::State, part, force, finding, FINDING.get() * strength)
}

/// Returns the effect of the curves.
pub fn curves_entry() -> Option<&'static Entry> {
    registry().iter().find(|e| e.observability == Observability::Surrogate)
}

/// Compares a selection with free curves. If one gains, two effects are tried in its place first; otherwise it joins
/// the hypothesis, and effects without worth beside it are removed. [`Selection::curves`] lists it either way.
pub fn hold_against_curves(searches: &SearchPair, from: Selection) -> Selection {
    let SearchPair { search, judge, progress } = searches;
    let mut now = from;
    let strongest = |now: &Selection| {
        let absent = |gain: &CurveGain| now.curves.iter().all(|known| known.curve != gain.curve);
        let slopes = CurveSlopes::new(search, judge, &now.ablation.full)?;
        let clear = slopes.gains().filter(|gain| gain.test > WORTH_TEST && absent(gain));
        let gain = clear.max_by(|a, b| a.test.total_cmp(&b.test))?;
        Some((slopes, gain))
    };
    while let Some((slopes, gain)) = strongest(&now).filter(|_| now.curves.len() < MOST_CURVES) {
        progress(&format!("a free curve of {}", gain.curve.input));
        let pair = (now.curves.is_empty()).then(|| pair_in_place(search, &now)).flatten();
        let pair = pair.and_then(|path| eliminate(searches, path));
        if let Some(pair) = pair.filter(|pair| strongest(pair).is_none()) {
            return pair;
        }
        let more = with_curve(search, &now.ablation.full, gain.curve, &slopes);
        let more = more.and_then(|path| eliminate(searches, path));
        // a curve that is worth too little on the flights of the fit is left beside the names
        let mut next = more.filter(has_curve).unwrap_or_else(|| now.clone());
        next.curves = [now.curves, vec![gain]].concat();
        now = next;
    }
    now
}

fn has_curve(selection: &Selection) -> bool {
    selection.ablation.full.hypothesis.terms.iter().any(Term::is_description)
}

/// Slopes of the likelihood with all curves beside a hypothesis.
struct CurveSlopes {
    joint: Hypothesis,
    fit: NormalEquations,
    test: NormalEquations,
    /// Places of what the hypothesis has already, and of constants.
    known: Vec<usize>,
    /// Place of the first number of the curves.
    first: usize,
}

impl CurveSlopes {
    fn new(search: &Search, judge: &Search, now: &FilteredHypothesis) -> Option<Self> {
        let (entry, settled) = (curves_entry()?, now.at_posterior());
        let mut term = settled.term(entry.name).cloned().unwrap_or_else(|| Term::without_free(entry));
        let has = std::mem::replace(&mut term.free, (0..entry.params.len()).collect());
        let joint = settled.without(entry.name).with(term);
        let place = joint.place(entry.name);
        let is_known = |at: &usize| {
            let Some(i) = at.checked_sub(place.start).filter(|_| place.contains(at)) else { return true };
            has.contains(&i) || CURVES.iter().any(|curve| curve.constants.contains(&i))
        };
        let known = (0..joint.free_values().len()).filter(is_known).collect();
        let fit = search.likelihood_slopes(&joint, &now.disturbances)?;
        let test = judge.likelihood_slopes(&joint, &now.disturbances)?;
        Some(CurveSlopes { first: place.start, joint, fit, test, known })
    }

    /// Places of the known numbers and of a curve.
    fn with(&self, curve: &Curve) -> Vec<usize> {
        let added = curve.params.iter().map(|i| self.first + i).filter(|at| !self.known.contains(at));
        self.known.iter().copied().chain(added).collect()
    }

    fn gains(&self) -> impl Iterator<Item = CurveGain> {
        let without = self.fit.joint_step(&self.known);
        CURVES.iter().map(move |curve| {
            let both = self.with(curve);
            let step = self.fit.joint_step(&both);
            let test = self.test.gain(&both, &step) - self.test.gain(&self.known, &without);
            CurveGain { curve, test }
        })
    }

    /// The settled hypothesis without causes that are worth too little beside a curve.
    fn without_needless(&self, curve: &Curve, settled: &Hypothesis) -> Hypothesis {
        let (mut kept, mut all) = (settled.clone(), self.with(curve));
        loop {
            let step = self.fit.joint_step(&all);
            let worth = |term: &Term| {
                let place: Vec<usize> = self.joint.place(term.entry.name).collect();
                let by = |at: &usize| all.iter().position(|other| other == at).map_or(0.0, |k| step[k]);
                let off = term.free.iter().map(|i| term.values[*i] - term.entry.params[*i].off);
                let away: Vec<f64> = off.zip(&place).map(|(away, at)| away + by(at)).collect();
                let others: Vec<usize> = all.iter().copied().filter(|at| !place.contains(at)).collect();
                self.fit.worth(&place, &away, &others)
            };
            let causes = kept.terms.iter().filter(|term| kept.is_cause(term.entry.name));
            let worths = causes.map(|term| (term.entry.name, worth(term)));
            let Some((name, _)) =
                worths.filter(|(_, w)| *w < WORTH_BOTH.get()).min_by(|a, b| a.1.total_cmp(&b.1))
            else {
                return kept;
            };
            let gone = self.joint.place(name);
            all.retain(|at| !gone.contains(at));
            kept = kept.without(name);
        }
    }
}

/// The hypothesis with one more curve free, and the constants that it needs.
pub fn with_free_curve(hypothesis: &Hypothesis, entry: &'static Entry, curve: &Curve) -> Hypothesis {
    let known = hypothesis.term(entry.name).cloned();
    let mut term = known.unwrap_or_else(|| Term::without_free(entry));
    term.free.extend(curve.params.iter().chain(curve.constants));
    term.free.sort_unstable();
    term.free.dedup();
    hypothesis.without(entry.name).with(term)
}

/// The hypothesis with a curve in the place of what is needless beside it, fitted.
fn with_curve(
    search: &Search,
    now: &FilteredHypothesis,
    curve: &Curve,
    slopes: &CurveSlopes,
) -> Option<FilteredHypothesis> {
    let (entry, settled) = (curves_entry()?, slopes.without_needless(curve, &now.at_posterior()));
    let hypothesis = with_free_curve(&settled, entry, curve);
    search.refit(&search.rough(&Hypothesis { max_physics_hz: None, ..hypothesis }), &now.disturbances)
}

/// The likeliest hypothesis with two effects in the place of one, or beside all, if it is worth them.
fn pair_in_place(search: &Search, selection: &Selection) -> Option<FilteredHypothesis> {
    let full = search.judge_roughly(&selection.ablation.full)?;
    let penalised =
        |judged: &FilteredHypothesis| judged.loss + WORTH_BOTH.get() * judged.hypothesis.terms.len() as f64;
    let settled = full.at_posterior();
    let replaced = selection.ablation.without.iter().filter(|(name, _)| settled.is_cause(name));
    let replaced = replaced.filter_map(|(name, less)| Some((vec![*name], search.judge_roughly(less)?)));
    let begun: Vec<(Vec<&str>, FilteredHypothesis)> = replaced.chain([(Vec::new(), full.clone())]).collect();
    let extended = |(taken_out, from): (Vec<&str>, FilteredHypothesis)| {
        let first = search.extend(&from, &taken_out).1?;
        let second = search.extend(&first, &[]).1;
        second.into_iter().chain([first]).min_by(|a, b| penalised(a).total_cmp(&penalised(b)))
    };
    let all = begun.into_par_iter().filter_map(extended);
    let best = all.min_by(|a, b| penalised(a).total_cmp(&penalised(b)))?;
    (penalised(&best) < penalised(&full)).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explain::tests::CommittedCase;
    use crazyflie_env::effects::find;

    /// The curve that gains most on the test flight of a case beside the declared model and these effects.
    fn strongest_beside(case: &str, effects: &[(&str, f64)]) -> CurveGain {
        let case = CommittedCase::read(case);
        let (fit, test) = (case.flights(&case.fit), case.flights(&case.test));
        let (search, judge) = (Search::new(&fit), Search::new(&test));
        let declared = search.judge_declared(&case.declared).unwrap();
        let term = |(name, value): &(&str, f64)| {
            let mut term = Term::off(find(name).unwrap().1);
            term.values[0] = *value;
            term
        };
        let hypothesis = effects.iter().fold(case.declared.clone(), |h, effect| h.with(term(effect)));
        let judged = search.refit(&hypothesis, &declared.disturbances).unwrap();
        let gains = CurveSlopes::new(&search, &judge, &judged).unwrap();
        gains.gains().max_by(|a, b| a.test.total_cmp(&b.test)).unwrap()
    }

    /// It was explained by a gust, a lag and a drag.
    #[test]
    fn a_pull_towards_a_place_is_a_curve_of_the_place() {
        let vehicle = [("motor_lag", 0.05), ("rigid_body", 1.0), ("drag_linear", 0.24)];
        let gain = strongest_beside("stages/d15", &vehicle);
        assert!(gain.curve.input == "the place" && gain.test > WORTH_TEST, "{gain:?}");
    }

    /// Even if no flight of the fit contains it.
    #[test]
    fn a_curve_that_gains_is_structure_in_its_signal() {
        let gain = CurveGain { curve: &CURVES[5], test: 1.1 * WORTH_TEST };
        let left = gain.leftover();
        assert!(left.is_structure() && left.part == Signal::Vertical && left.finding.contains("climbing"));
    }

    #[test]
    fn a_law_of_the_right_shape_leaves_no_curve() {
        let gain = strongest_beside("d01", &[("rigid_body", 1.0), ("drag_linear", 0.5)]);
        assert!(gain.test < 0.5 * WORTH_TEST, "{gain:?}");
    }
}
