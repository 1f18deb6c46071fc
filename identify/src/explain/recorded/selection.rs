//! Effects one at a time: proposed by the fit, taken or left by predictions of what was left out of it.

use std::collections::BTreeSet;

use crazyflie_env::effects::{CURVES, Curve, Entry, Observability};
use crazyflie_env::model::Model;
use crazyflie_statistics::mean;
use rayon::prelude::*;

use super::bench::{Bench, FittedHypothesis, shared_range};
use super::gain::{Gain, JUDGED};
use super::swing::Load;
use crate::axis_errors::AxisErrors;
use crate::estimate::at_bound;
use crate::explain::calibration::curves::MOST_CURVES;
use crate::explain::calibration::recorded::{
    CHANCE, CLEAR, FOREIGN_GAIN, LEAST_CURVE_GAIN, LEAST_GAIN, SHORTLIST, STARTS,
};
use crate::explain::candidates::{Candidate, candidates};
use crate::explain::curves::{curve_leftover, curves_entry, with_free_curve};
use crate::explain::selection::besides;
use crate::explain::signals::Signal;
use crate::explain::verdict::{Finding, Leftover, RankedCandidate, Step};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::vehicle::HOVER;

/// A hypothesis, the accuracy of its predictions of held-out data, and the steps that led to it.
pub struct RecordedSelection<'a> {
    /// Flights on which hypotheses are fitted and judged.
    pub bench: &'a Bench,
    pub fitted: FittedHypothesis,
    pub errors: Vec<AxisErrors>,
    pub steps: Vec<Step>,
    /// By effect, others that would have been taken in its place.
    alternatives: Vec<(&'static str, Vec<Term>)>,
    /// Free curves that were taken, and the gain of predictions by each.
    curves: Vec<(&'static Curve, f64)>,
    /// The load below the vehicle; where flights show forces, no such effect is proposed.
    pub load: &'a Load,
    /// Declared effects whose values are kept: each may take others.
    pub declared: Vec<Term>,
}

/// Trial of one more effect: its fit, and the gain of predictions.
struct Trial {
    entry: &'static Entry,
    fitted: FittedHypothesis,
    errors: Vec<AxisErrors>,
    gain: Gain,
}

impl Trial {
    fn new(entry: &'static Entry, hypothesis: &Hypothesis, now: &RecordedSelection) -> Option<Self> {
        let fitted = now.bench.fit(hypothesis, &now.fitted);
        let errors = now.bench.held_out_errors(&fitted)?;
        Some(Trial { entry, fitted, gain: Gain::new(&now.errors, &errors), errors })
    }

    /// Returns whether it helps beyond chance, given the number considered in a round, harms no axis, and has a known
    /// size.
    fn is_worth_its_place(&self, bench: &Bench) -> bool {
        self.gain.helps(LEAST_GAIN)
            && self.gain.p_value() < CHANCE / SHORTLIST as f64
            && clearance(bench, &self.fitted, self.entry.name) > CLEAR
            && !self.is_at_bound()
    }

    /// Returns whether predictions gain what a curve must be worth, given the number of curves.
    fn is_worth_a_curve(&self) -> bool {
        // few stretches cannot tell chance: there it takes the gain that makes numbers another vehicle's
        let is_beyond_chance = self.gain.p_value() < CHANCE / CURVES.len() as f64;
        self.gain.helps(LEAST_CURVE_GAIN) && (is_beyond_chance || self.gain.mean() < -FOREIGN_GAIN)
    }

    /// The fit would have gone on, but a parameter must not: something else is the cause.
    fn is_at_bound(&self) -> bool {
        let stopped = |term: &Term| {
            let at_end = |i: &usize| {
                let p = &term.entry.params[*i];
                term.values[*i] != p.off && at_bound(term.values[*i], [p.low, p.high])
            };
            term.free.iter().any(at_end)
        };
        self.fitted.hypothesis.term(self.entry.name).is_some_and(stopped)
    }
}

/// Standard errors between "off" and the clearest parameter of an effect.
fn clearance(bench: &Bench, fitted: &FittedHypothesis, effect: &str) -> f64 {
    let sd = bench.standard_errors(fitted);
    let Some(term) = fitted.hypothesis.term(effect) else { return 0.0 };
    let places = shared_range(&fitted.hypothesis, effect);
    let distance = |(i, at): (&usize, usize)| {
        sd.get(at).map_or(0.0, |sd| (term.values[*i] - term.entry.params[*i].off).abs() / sd)
    };
    term.free.iter().zip(places).map(distance).filter(|d| d.is_finite()).fold(0.0, f64::max)
}

impl<'a> RecordedSelection<'a> {
    /// Creates the selection of a hypothesis without effects to choose. A load that swings belongs to it: forces show it
    /// without a model.
    pub fn new(bench: &'a Bench, mut fitted: FittedHypothesis, load: &'a Load) -> Option<Self> {
        if let Some(swing) = load.swing().filter(|swing| !fitted.hypothesis.has(swing.effect())) {
            fitted.hypothesis = fitted.hypothesis.with(swing.term());
        }
        let errors = bench.held_out_errors(&fitted)?;
        Some(RecordedSelection {
            bench,
            fitted,
            errors,
            steps: Vec::new(),
            alternatives: Vec::new(),
            curves: Vec::new(),
            load,
            declared: Vec::new(),
        })
    }

    /// Returns whether an effect joined, or a declared one took other values.
    pub fn holds_more_than(&self, fitted: &FittedHypothesis) -> bool {
        let is_free = |name: &str| fitted.hypothesis.term(name).is_some_and(|term| !term.free.is_empty());
        self.names().iter().any(|name| !is_free(name))
    }

    /// Names of the effects that all flights share.
    pub fn names(&self) -> Vec<&'static str> {
        shared_terms(&self.fitted.hypothesis).map(|t| t.entry.name).collect()
    }

    /// Effects join, up to so many, while predictions of what was left out get better.
    pub fn extend(&mut self, most: usize, progress: &dyn Fn(&str)) {
        while self.names().len() < most {
            let names = self.names();
            progress(&besides(&names));
            let proposals = self.proposals();
            let ranking = proposals.iter().map(|(gain, term)| ranking_entry(*gain, term)).collect();
            self.steps.push(Step { effects: names, gain: 0.0, ranking });
            let tries: Vec<&Term> = proposals.iter().take(SHORTLIST).map(|(_, term)| term).collect();
            let names: Vec<&str> = tries.iter().map(|t| t.entry.name).collect();
            progress(&format!("predictions with {}", names.join(", ")));
            let trial = |term: &Term| Trial::new(term.entry, &self.joined(term), self);
            let trials = tries.into_par_iter().filter_map(trial);
            let mut worthy: Vec<_> = trials.filter(|trial| trial.is_worth_its_place(self.bench)).collect();
            worthy.sort_by(|a, b| a.gain.mean().total_cmp(&b.gain.mean()));
            if worthy.is_empty() {
                return;
            }
            let best = worthy.remove(0);
            let other = |trial: &Trial| trial.fitted.hypothesis.term(trial.entry.name).cloned();
            self.alternatives.push((best.entry.name, worthy.iter().filter_map(other).collect()));
            (self.fitted, self.errors) = (best.fitted, best.errors);
        }
    }

    /// The same effects at numbers of a fit that has converged. A frame that is turned begins far from every measured
    /// start, and an effect that joined on the way may have compensated it.
    pub fn converge(&mut self) {
        let fitted = self.bench.converge(&self.fitted);
        if let Some(errors) = self.bench.held_out_errors(&fitted) {
            (self.fitted, self.errors) = (fitted, errors);
        }
    }

    /// The hypothesis with one more effect, or with a declared one whose values are free.
    fn joined(&self, term: &Term) -> Hypothesis {
        self.fitted.hypothesis.without(term.entry.name).with(term.clone())
    }

    /// Candidates with what the fit gains by each, the most first.
    fn proposals(&self) -> Vec<(f64, Term)> {
        let now = &self.fitted;
        let is_closed =
            |term: &&Term| now.hypothesis.term(term.entry.name).is_some_and(|known| known.free.is_empty());
        let base = self.bench.propose(&now.hypothesis, now).solution.loss;
        let is_open = |c: &Candidate| {
            matches!(self.load, Load::Unseen) || c.entry.observability != Observability::Resonant
        };
        let starts: Vec<Term> = candidates(&now.hypothesis)
            .into_iter()
            .filter(is_open)
            .flat_map(|c| c.starts.into_iter().take(c.variants + STARTS))
            .map(Term::with_companions)
            .chain(self.declared.iter().filter(|term| is_closed(term)).cloned())
            .collect();
        let tried = starts.into_par_iter().map(|term| {
            let tried = self.bench.propose(&self.joined(&term), now);
            let fitted = tried.hypothesis.term(term.entry.name).cloned().unwrap_or(term);
            (base - tried.solution.loss, fitted)
        });
        let mut all: Vec<(f64, Term)> = tried.filter(|(gain, _)| gain.is_finite() && *gain > 0.0).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut seen = BTreeSet::new();
        all.retain(|(_, term)| seen.insert(term.entry.name));
        all
    }

    /// Without effects that predictions do not miss, one at a time.
    pub fn reduce(&mut self) {
        loop {
            let less = |name: &'static str| {
                let entry = self.fitted.hypothesis.term(name)?.entry;
                Trial::new(entry, &self.fitted.hypothesis.without(name), self)
            };
            let trials = self.names().into_par_iter().filter_map(less);
            // an effect is missed where predictions without it are worse, all in all or on one axis
            let idle = trials.filter(|trial| !is_missed(&trial.gain));
            let Some(least) = idle.min_by(|a, b| a.gain.mean().total_cmp(&b.gain.mean())) else { return };
            self.alternatives.retain(|(name, _)| *name != least.entry.name);
            (self.fitted, self.errors) = (least.fitted, least.errors);
        }
    }

    /// Free curves join, the one that predictions gain most by first, and effects that predictions do not miss beside
    /// it go: a law that no effect has otherwise gets the names of others.
    pub fn add_curves(&mut self, progress: &dyn Fn(&str)) {
        let Some(entry) = curves_entry() else { return };
        while self.curves.len() < MOST_CURVES {
            progress("free curves beside the effects");
            let trial = |curve: &'static Curve| {
                let trial = Trial::new(entry, &with_free_curve(&self.fitted.hypothesis, entry, curve), self)?;
                trial.is_worth_a_curve().then_some((curve, trial))
            };
            let absent = |curve: &&'static Curve| self.curves.iter().all(|(known, _)| known != curve);
            let worthy = CURVES.par_iter().filter(absent).filter_map(trial);
            let best = worthy.min_by(|(_, a), (_, b)| a.gain.mean().total_cmp(&b.gain.mean()));
            let Some((curve, best)) = best else { return };
            self.curves.push((curve, best.gain.mean()));
            (self.fitted, self.errors) = (best.fitted, best.errors);
            self.reduce();
        }
    }

    /// The curves that stayed, as structures that no effect accounts for.
    pub fn curve_leftovers(&self) -> Vec<Leftover> {
        let stayed = if self.describes() { &self.curves[..] } else { &[] };
        stayed.iter().map(|(curve, gain)| curve_leftover(curve, -gain / LEAST_CURVE_GAIN)).collect()
    }

    /// Returns whether a curve, which describes and names no cause, is among the terms.
    pub fn describes(&self) -> bool {
        shared_terms(&self.fitted.hypothesis).any(Term::is_description)
    }

    /// The load that swings, with what predictions lose without it.
    pub fn load_finding(&self, declared: &Model, is_foreign: bool) -> Option<Finding> {
        let swing = self.load.swing()?;
        let hover = |model: &Model| model.parameter(HOVER).ok();
        let thrusts = hover(&self.fitted.hypothesis.model).zip(hover(declared));
        // the hover thrust of another vehicle tells nothing of a load
        let is_beside = !is_foreign && thrusts.is_some_and(|(now, was)| swing.is_carried_beside(now / was));
        let params = swing.estimates(declared.parameter("vehicle.mass").ok()?, !is_beside);
        let without = self.fitted.hypothesis.without(swing.effect());
        let without = FittedHypothesis { hypothesis: without, ..self.fitted.clone() };
        let errors = |fitted| self.bench.errors_as_fitted(fitted);
        Some(swing.finding(params, Gain::new(&errors(&self.fitted)?, &errors(&without)?).by_axis()))
    }

    /// Effects that would do as well in the place of one.
    pub fn rivals(&self, name: &str) -> Vec<&'static str> {
        let others =
            self.alternatives.iter().find(|(known, _)| *known == name).map_or(&[][..], |(_, others)| others);
        let absent = |term: &&Term| !self.fitted.hypothesis.has(term.entry.name);
        let trials = others.par_iter().filter(absent).filter_map(|term| {
            Trial::new(term.entry, &self.fitted.hypothesis.without(name).with(term.clone()), self)
        });
        trials.filter(|trial| !is_missed(&trial.gain)).map(|trial| trial.entry.name).collect()
    }

    /// Returns whether an effect is the load that swings.
    pub fn is_swing(&self, finding: &Finding) -> bool {
        self.load.swing().is_some_and(|swing| swing.effect() == finding.name)
    }

    /// Returns whether an effect accounts for an error that matters, in some signal 2 s ahead. A smaller effect
    /// compensates numbers that are not known better, and is no cause.
    pub fn matters(&self, finding: &Finding) -> bool {
        if self.is_swing(finding) {
            return true;
        }
        let axis = |(signal, row): (Signal, usize)| {
            let squares: Vec<f64> = self.errors.iter().map(|e| e.rms[row][1].powi(2)).collect();
            let lost = finding.worth_by_signal[signal as usize];
            mean(&squares).unwrap_or(f64::NAN) * (2.0 * lost).exp_m1() > signal.negligible_size().powi(2)
        };
        [Signal::Sideways, Signal::Vertical, Signal::Tilt].into_iter().zip(JUDGED).any(axis)
    }

    /// The hypothesis without an effect, or with a declared one at its value, and what that does to predictions.
    pub fn without(&self, name: &'static str, declared: Option<Term>) -> Option<(FittedHypothesis, Gain)> {
        let known = &self.fitted.hypothesis;
        let less = declared.into_iter().fold(known.without(name), |h, term| h.with(term));
        let less = Trial::new(known.term(name)?.entry, &less, self)?;
        Some((less.fitted, less.gain))
    }
}

/// Returns whether predictions are worse without a removed effect: overall, or on one axis.
pub fn is_missed(without: &Gain) -> bool {
    (without.mean() > LEAST_GAIN && without.p_value() < CHANCE) || without.harms()
}

/// The effects that all flights share.
pub fn shared_terms(hypothesis: &Hypothesis) -> impl Iterator<Item = &Term> {
    hypothesis.terms.iter().filter(|t| t.per_flight.is_none() && !t.free.is_empty())
}

fn ranking_entry(gain: f64, term: &Term) -> RankedCandidate {
    RankedCandidate { name: term.entry.name, gain, stderr: Vec::new() }
}
