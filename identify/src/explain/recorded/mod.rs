//! The search for effects on recorded flights. Something always shakes a real vehicle, and a filter that may
//! take everything for shaking finds no cause. So effects are fitted together with the numbers of the model
//! and with what differs from flight to flight, and are taken or left by predictions of flights, or stretches
//! of few flights, that the fit did not see. The flights of the test are looked at once, at the end.

mod bench;
mod gain;
mod selection;
mod swing;

use std::time::Instant;

use crazyflie_env::effects::{Entry, Geometry, Role, numbers, registry};
use crazyflie_env::model::{Model, VerticalInput};
use rayon::prelude::*;

use super::calibration::recorded::{
    CHANCE, FAIR_SHARE, FOREIGN_GAIN, LATE_GAIN, LEAST_GAIN, MATTERS, MOST_CAUSES, MOST_EFFECTS,
    MOST_OF_GAIN, SAME, STEPS,
};
use super::calibration::verdict::MOST_RIVALS;
use super::completion::worst_harm;
use super::conclusion::verdict;
use super::curves::curves_entry;
use super::errors::{Errors, PredictionSetup, compare_errors};
use super::finding::manoeuvre;
use super::residual;
use super::search::{FilteredHypothesis, Search};
use super::signals::{Evidence, SignalEvidence, SignalState, main_signal};
use super::verdict::{EffectParameterEstimate, Explanation, Finding, NumberEstimate};
use crate::axis_errors::AxisErrors;
use crate::fit::flight::{Flight, MEMORY_S};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::vehicle::{self, NuisanceParameters};
use crate::{Error, NamedLog, Result};
use bench::{Bench, FittedHypothesis, shared_range};
use gain::Gain;
use selection::{RecordedSelection, is_missed, shared_terms};
use swing::Load;

/// Explains what a model lacks on logs of real flights, driven by this vertical form. Also returns what each
/// flight has of its own.
///
/// # Errors
/// [`Error`]: logs that cannot be flown, contain one flight twice or do not go together.
pub fn explain_recorded(
    model: &Model,
    fit: &[NamedLog],
    test: &[NamedLog],
    input: VerticalInput,
    progress: &dyn Fn(&str),
) -> Result<(Explanation, Vec<NuisanceParameters>)> {
    let began = Instant::now();
    vehicle::refuse_duplicates(&fit.iter().chain(test).collect::<Vec<_>>())?;
    let flights = |logs: &[NamedLog]| vehicle::prepare(model, Some(input), logs);
    let (fitted_flights, tested) = (flights(fit)?, flights(test)?);
    progress("the numbers of the model");
    let mut bench = Bench::new(fitted_flights.clone());
    let mut base = Baseline::new(model, fit, input, &mut bench)?;
    let numbers_anew = completed_hypothesis(&base.fitted, &base, fit);
    if let Some(late_s) = base.commands_late_s(&bench) {
        let late = format!("{:.0} ms before the time at which the logs have them", 1e3 * late_s);
        let advice =
            "correct the times of the commands and try again, or name a model whose attitude follows faster";
        let obeyed = format!("the vehicle obeyed its commands about {late}, by the model {}", model.name);
        return Error::logs(format!("{obeyed}; {advice}"));
    }
    progress("a load that swings");
    let load = Load::new(model, fit, test);
    let mut selection = if let Some(causes) = base.causes_beside_declared_numbers(&bench, &load, progress) {
        base = Baseline { foreign: false, fitted: base.as_declared.clone(), ..base };
        causes
    } else {
        progress("effects beside new numbers");
        select(&bench, &base.fitted, Vec::new(), &load, MOST_EFFECTS, progress).ok_or_else(cannot_simulate)?
    };
    if load.swing().is_none() {
        selection.add_curves(progress);
    }
    progress("the test flights");
    let flights = [fitted_flights, tested];
    let before = ModelEvaluation::new(&Hypothesis::from_model(model), flights.clone())?;
    let judge = CompletionJudge { logs: fit, flights: &flights, before: &before, numbers_anew };
    let mut completion = judge.completion(&base, &selection)?;
    if completion.outcome == Outcome::Withdrawn && load.swing().is_some() {
        // new numbers do harm, of few flights mostly: the load is known without them
        base = Baseline { foreign: false, fitted: base.as_declared.clone(), ..base };
        selection = RecordedSelection::new(&bench, base.fitted.clone(), &load).ok_or_else(cannot_simulate)?;
        completion = judge.completion(&base, &selection)?;
    }
    let findings = base.findings(model, &selection, &flights[1]);
    // beside the declared model: effects that joined it may account for what flights share
    let trims = before.trims.clone();
    Ok((explanation(findings, &base, selection, before, completion, began), trims))
}

/// Judge of selections: by the flights of the fit and of the test, beside the declared model.
struct CompletionJudge<'a> {
    logs: &'a [NamedLog],
    flights: &'a [Vec<Flight>; 2],
    before: &'a ModelEvaluation,
    numbers_anew: Hypothesis,
}

impl CompletionJudge<'_> {
    /// The completed model of a selection, or the declared one where it stays.
    fn completion(&self, base: &Baseline, selection: &RecordedSelection) -> Result<RecordedCompletion> {
        let before = self.before;
        let evaluate = |hypothesis: &Hypothesis| ModelEvaluation::new(hypothesis, self.flights.clone());
        let unchanged = |outcome| {
            let refitted = evaluate(&self.numbers_anew).ok();
            let refitted = refitted.map(|evaluation| errors_between(before, &evaluation));
            let (errors, evaluation) = (errors_between(before, before), (*before).clone());
            RecordedCompletion { outcome, errors, refitted, evaluation }
        };
        if !base.is_surpassed_by(selection) {
            return Ok(unchanged(Outcome::AsDeclared));
        }
        let evaluation = evaluate(&completed_hypothesis(&selection.fitted, base, self.logs))?;
        let errors = errors_between(before, &evaluation);
        if worst_harm(&errors.axes, MATTERS) > 0.0 {
            return Ok(unchanged(Outcome::Withdrawn));
        }
        Ok(RecordedCompletion { outcome: Outcome::Completed, errors, refitted: None, evaluation })
    }
}

/// Effects, up to so many, that join a hypothesis and that predictions miss. Nothing is sought beside a load that swings:
/// no prediction knows how it swings at first, and others would describe that.
fn select<'a>(
    bench: &'a Bench,
    start: &FittedHypothesis,
    declared: Vec<Term>,
    load: &'a Load,
    most: usize,
    progress: &dyn Fn(&str),
) -> Option<RecordedSelection<'a>> {
    let mut selection = RecordedSelection::new(bench, start.clone(), load)?;
    selection.declared = declared;
    if load.swing().is_none() {
        selection.extend(most, progress);
    }
    progress("effects that predictions do not miss");
    selection.converge();
    selection.reduce();
    Some(selection)
}

/// The fate of the declared model.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Outcome {
    /// It stays: nothing joined it.
    AsDeclared,
    /// It stays: what joined it predicts flights of the fit better, and test flights worse on some axis.
    Withdrawn,
    Completed,
}

/// The model in the end, as it sees the flights, and its errors beside those of the declared one.
struct RecordedCompletion {
    outcome: Outcome,
    evaluation: ModelEvaluation,
    errors: Errors,
    /// Errors of the declared form with its numbers fitted anew, where the declared model stays.
    refitted: Option<Errors>,
}

fn errors_between(before: &ModelEvaluation, after: &ModelEvaluation) -> Errors {
    compare_errors(before.prediction_setup(), after.prediction_setup())
}

/// Returns whether an effect has a cause: a learned term describes the residual without a name.
fn is_cause(name: &&'static str) -> bool {
    curves_entry().is_none_or(|entry| entry.name != *name)
}

fn cannot_simulate() -> Error {
    Error::no_start("model")
}

/// The baseline of the selection: numbers fitted, the declared effects free.
struct Baseline {
    fitted: FittedHypothesis,
    /// The declared model; only what each flight has of its own is fitted.
    as_declared: FittedHypothesis,
    /// Its errors on held-out stretches.
    declared_errors: Vec<AxisErrors>,
    /// New numbers gain so much on what is left out that the declared ones are another vehicle's.
    foreign: bool,
    /// Gain of new numbers over the declared ones.
    numbers_gain: Gain,
    declared: Vec<(&'static Entry, Vec<f64>)>,
    numbers_before: Vec<f64>,
}

impl Baseline {
    fn new(model: &Model, logs: &[NamedLog], input: VerticalInput, bench: &mut Bench) -> Result<Self> {
        let free = vehicle::visible(model, logs, input);
        let sees_trims = bench.flights.iter().all(|f| f.sees_true_attitude);
        let own_hover = input == VerticalInput::Thrust && sees_trims;
        let free = if own_hover { vehicle::beside_hover(free) } else { free };
        let (open, declared) = open_effects(model, &free);
        let kept = vehicle::nuisance_hypothesis(&open, sees_trims.then_some(input));
        let kept = declared_terms(&declared).into_iter().fold(kept, |h, term| h.with(term));
        let says_effect = |path: &String| registry().iter().any(|e| e.model_number == Some(path.as_str()));
        let mut refitted =
            Hypothesis { free: free.into_iter().filter(|path| !says_effect(path)).collect(), ..kept.clone() };
        let windows = bench.windows.clone();
        let (solution, _) =
            vehicle::fit(&mut bench.flights, &windows, &mut refitted, &|| {}).ok_or_else(cannot_simulate)?;
        let refitted = bench.apply_solution(&refitted, solution);
        // the declared model with the values of its effects, and what each flight has of its own
        let mut as_declared = kept.clone();
        as_declared.terms.iter_mut().filter(|t| t.per_flight.is_none()).for_each(|t| t.free.clear());
        let as_declared = bench.fit(&as_declared, &refitted);
        let declared_errors = bench.held_out_errors(&as_declared).ok_or_else(cannot_simulate)?;
        let numbers_gain = bench.gain(&refitted, &declared_errors).ok_or_else(cannot_simulate)?;
        let numbers_before =
            refitted.hypothesis.free.iter().filter_map(|path| model.parameter(path).ok()).collect();
        let foreign = numbers_gain.mean() < -FOREIGN_GAIN;
        Ok(Baseline {
            foreign,
            numbers_gain,
            fitted: refitted,
            as_declared,
            declared_errors,
            declared,
            numbers_before,
        })
    }

    /// Returns by how much the commands are stamped later than the vehicle obeyed them, if they are. Then the declared
    /// model predicts the attitude loop better with earlier commands than with new numbers. A thrust that lags may
    /// compensate such stamps, so the vertical does not judge.
    fn commands_late_s(&self, bench: &Bench) -> Option<f64> {
        let tick_s = bench.flights[0].tick_s;
        let gain = |ticks: usize| {
            let flights = bench.flights.iter().map(|flight| flight.with_earlier_commands(ticks)).collect();
            let shifted = Bench::new(flights);
            let fitted = shifted.fit(&self.as_declared.hypothesis, &self.as_declared);
            shifted.gain(&fitted, &self.declared_errors)
        };
        let of_attitude = |gain: &Gain| {
            let [sideways, _, tilt] = gain.by_axis();
            0.5 * (sideways + tilt)
        };
        let (mut ticks, mut best) = (1, gain(1)?);
        while ((ticks + 1) as f64) * tick_s < MEMORY_S
            && let Some(next) = gain(ticks + 1).filter(|next| of_attitude(next) < of_attitude(&best))
        {
            (ticks, best) = (ticks + 1, next);
        }
        let least = MOST_OF_GAIN * of_attitude(&self.numbers_gain).min(0.0) - LATE_GAIN;
        // few stretches cannot tell chance: there it takes the gain that makes numbers another vehicle's
        let is_beyond_chance = best.p_value() < CHANCE || of_attitude(&best) < -FOREIGN_GAIN;
        (of_attitude(&best) < least && is_beyond_chance).then_some(ticks as f64 * tick_s)
    }

    /// Returns the effects beside the declared numbers if they predict as well as new numbers do, or these do not help: a
    /// delay of the command may hide in the numbers of a slower attitude loop.
    fn causes_beside_declared_numbers<'a>(
        &self,
        bench: &'a Bench,
        load: &'a Load,
        progress: &dyn Fn(&str),
    ) -> Option<RecordedSelection<'a>> {
        progress("effects beside the declared numbers");
        let by_numbers = self.numbers_gain.mean();
        let numbers_help = by_numbers < -LEAST_GAIN;
        let most = if numbers_help { MOST_CAUSES } else { MOST_EFFECTS };
        let declared = declared_terms(&self.declared);
        let causes = select(bench, &self.as_declared, declared, load, most, progress)?;
        let gain = Gain::new(&self.declared_errors, &causes.errors).mean();
        (!numbers_help || gain < MOST_OF_GAIN * by_numbers).then_some(causes)
    }

    /// The effects of a selection as findings, those that these flights confirm, and a load that swings.
    fn findings(&self, model: &Model, selection: &RecordedSelection, test: &[Flight]) -> Vec<Finding> {
        let finding = |name| self.finding(selection, test, name);
        let mut findings: Vec<_> =
            selection.names().into_iter().filter(is_cause).filter_map(finding).collect();
        findings.extend(self.confirmed_findings(selection, test));
        findings.extend(selection.load_finding(model, self.foreign));
        findings
    }

    /// The declared effects that a selection keeps at their values, where these flights confirm them.
    fn confirmed_findings(&self, selection: &RecordedSelection, test: &[Flight]) -> Vec<Finding> {
        let bench = selection.bench;
        let is_kept = |term: &Term| {
            selection.fitted.hypothesis.term(term.entry.name).is_some_and(|known| known.free.is_empty())
        };
        let kept: Vec<Term> = declared_terms(&self.declared).into_iter().filter(is_kept).collect();
        if kept.is_empty() {
            return Vec::new();
        }
        let names: Vec<&'static str> = kept.iter().map(|term| term.entry.name).collect();
        let closed = selection.fitted.hypothesis.clone();
        let open = kept.into_iter().fold(closed, |h, term| h.without(term.entry.name).with(term));
        let Some(open) = RecordedSelection::new(bench, bench.fit(&open, &selection.fitted), selection.load)
        else {
            return Vec::new();
        };
        let found = names.into_iter().filter_map(|name| self.finding(&open, test, name));
        found.filter(|finding| self.confirms(finding)).collect()
    }

    /// An effect with its values and what is lost without it, if predictions would miss it.
    fn finding(&self, selection: &RecordedSelection, test: &[Flight], name: &'static str) -> Option<Finding> {
        let hypothesis = &selection.fitted.hypothesis;
        let term = shared_terms(hypothesis).find(|t| t.entry.name == name)?;
        let sd = selection.bench.standard_errors(&selection.fitted);
        let declared = self.declared_values(term.entry);
        let params = term.free.iter().zip(shared_range(hypothesis, name)).map(|(i, at)| {
            let p = &term.entry.params[*i];
            let stderr = sd.get(at).copied().unwrap_or(f64::NAN);
            let estimate = EffectParameterEstimate::new(p, term.values[*i], stderr);
            EffectParameterEstimate { declared: declared[*i], ..estimate }
        });
        let params: Vec<EffectParameterEstimate> = params.collect();
        // a declared effect with another value is a changed one
        let is_changed = self.declares(name) && !agrees_with_declared(&params);
        let kept = is_changed.then(|| Term { values: declared.clone(), free: Vec::new(), ..term.clone() });
        let (less, lost) = selection.without(name, kept).filter(|(_, lost)| is_missed(lost))?;
        let [sideways, vertical, tilt] = lost.by_axis();
        let rivals = selection.rivals(name);
        Some(Finding {
            name,
            params,
            manoeuvre: manoeuvre(term.entry, &rivals),
            confusable_with: rivals,
            worth_fit: less.solution.loss - selection.fitted.solution.loss,
            worth_test: loss_on_unseen(&less.hypothesis, test) - loss_on_unseen(hypothesis, test),
            worth_by_signal: [sideways, vertical, tilt, 0.0],
            with: Vec::new(),
        })
    }

    /// Returns whether the model already has an effect, at a value that these flights do not contradict.
    fn confirms(&self, finding: &Finding) -> bool {
        self.declares(finding.name) && agrees_with_declared(&finding.params)
    }

    /// Returns whether a selection replaces the declared model: an effect joined, which predictions with new numbers
    /// confirm, or the declared numbers belong to another vehicle. Otherwise new numbers would only follow the
    /// flights of the fit.
    fn is_surpassed_by(&self, selection: &RecordedSelection) -> bool {
        self.foreign
            || selection.describes()
            || selection.load.swing().is_some()
            || selection.holds_more_than(&self.fitted)
    }

    fn declares(&self, effect: &str) -> bool {
        let is_on = |(entry, values): &(&'static Entry, Vec<f64>)| {
            entry.params.iter().zip(values).any(|(p, v)| *v != p.off)
        };
        self.declared.iter().filter(|known| is_on(known)).any(|(entry, _)| entry.name == effect)
    }

    /// The values that the model declares of an effect; those of "off" if it declares none.
    fn declared_values(&self, entry: &Entry) -> Vec<f64> {
        let known = self.declared.iter().find(|(e, _)| e.name == entry.name);
        known.map_or_else(|| entry.params.iter().map(|p| p.off).collect(), |(_, values)| values.clone())
    }
}

/// The model without effects that can be estimated anew, and these with their values. A number to fit that has the
/// same meaning as an effect is one of these, also at zero: numbers are fitted, and drag and an estimator that takes
/// drag for tilt only show together.
fn open_effects(model: &Model, free: &[String]) -> (Model, Vec<(&'static Entry, Vec<f64>)>) {
    let (mut open, mut declared) = (model.clone(), Vec::new());
    for entry in registry().iter().filter(|e| e.observability.is_expected() && e.geometry == Geometry::None) {
        let given = model
            .effects
            .get(entry.name)
            .map(|given| numbers(entry, given).iter().map(|n| n.fixed()).collect::<Option<Vec<f64>>>());
        let fitted = entry.model_number.filter(|path| free.iter().any(|known| known == path));
        let number = fitted.and_then(|path| Some((path, model.parameter(path).ok()?)));
        let mut values: Vec<f64> = match given {
            // a distribution is no value to start from
            Some(None) => continue,
            Some(Some(values)) => values,
            None if number.is_some() => entry.params.iter().map(|p| p.off).collect(),
            None => continue,
        };
        if let Some((path, value)) = number {
            let Ok(without) = open.with_parameter(path, 0.0) else { continue };
            open = without;
            values[0] += value;
        }
        open.effects.remove(entry.name);
        declared.push((entry, values));
    }
    (open, declared)
}

fn declared_terms(declared: &[(&'static Entry, Vec<f64>)]) -> Vec<Term> {
    let term = |(entry, values): &(&'static Entry, Vec<f64>)| {
        // a parameter that is off may belong to a variant that nobody asked for
        let free = (0..values.len()).filter(|i| {
            matches!(entry.params[*i].role, Role::Free | Role::Companion)
                && (*i == 0 || values[*i] != entry.params[*i].off)
        });
        Term { free: free.collect(), values: values.clone(), ..Term::off(entry) }
    };
    declared.iter().map(term).collect()
}

/// Returns the hypothesis that all flights share, nothing free: fitted numbers name their source.
fn completed_hypothesis(fitted: &FittedHypothesis, base: &Baseline, logs: &[NamedLog]) -> Hypothesis {
    let mut whole = fitted.hypothesis.clone();
    whole.terms.retain(|term| term.per_flight.is_none());
    let names: Vec<&str> = logs.iter().map(|(name, _)| name.as_str()).collect();
    let source = format!("estimated beside the effects on {}", names.join(", "));
    let moved: Vec<&String> = whole
        .free
        .iter()
        .zip(&base.numbers_before)
        .filter(|(p, was)| whole.model.parameter(p).ok() != Some(**was))
        .map(|(p, _)| p)
        .collect();
    let mut model = whole.model.clone();
    for path in moved {
        model = vehicle::with_source(&model, path, &source);
    }
    Hypothesis { model, estimates_lagged_push: true, ..whole }.without_free()
}

/// A model judged on flights, these without what each has of its own.
#[derive(Clone)]
struct ModelEvaluation {
    fit: Vec<Flight>,
    test: Vec<Flight>,
    trims: Vec<NuisanceParameters>,
    judged: FilteredHypothesis,
}

impl ModelEvaluation {
    fn new(hypothesis: &Hypothesis, [mut fit, mut test]: [Vec<Flight>; 2]) -> Result<Self> {
        let trims = vehicle::settle_flights(&hypothesis.to_model("for its trims"), &mut fit, &mut test);
        let judged = Search::new(&fit).judge_declared(hypothesis).ok_or_else(cannot_simulate)?;
        Ok(ModelEvaluation { fit, test, trims, judged })
    }

    fn prediction_setup(&self) -> PredictionSetup<'_> {
        (&self.judged.hypothesis, &self.judged.disturbances, &self.test)
    }
}

/// Negative log-likelihood of flights that were not fitted, what each has of its own found from its start.
fn loss_on_unseen(hypothesis: &Hypothesis, flights: &[Flight]) -> f64 {
    let open = vehicle::open_per_flight(hypothesis);
    let loss = |flight: &Flight| {
        let own = vehicle::fit_on_start(&open, flight);
        Search::new(std::slice::from_ref(flight)).fit(&own, None, STEPS).loss
    };
    flights.par_iter().map(loss).sum()
}

fn agrees_with_declared(params: &[EffectParameterEstimate]) -> bool {
    let agrees = |p: &EffectParameterEstimate| {
        (p.value - p.declared).abs() < SAME * p.stderr.max(0.02 * p.value.abs())
    };
    params.iter().all(agrees)
}

fn explanation(
    findings: Vec<Finding>,
    base: &Baseline,
    selection: RecordedSelection,
    before: ModelEvaluation,
    RecordedCompletion { outcome, evaluation: after, errors, refitted }: RecordedCompletion,
    began: Instant,
) -> Explanation {
    let keeps = outcome == Outcome::Completed;
    let (confirmed, named): (Vec<_>, Vec<_>) = findings.into_iter().partition(|f| base.confirms(f));
    let (corrections, named): (Vec<_>, Vec<_>) =
        named.into_iter().filter(|_| keeps).partition(|f| !selection.matters(f));
    let (mut partial, named): (Vec<_>, Vec<_>) =
        named.into_iter().partition(|f| f.confusable_with.len() > MOST_RIVALS);
    let curves = selection.curve_leftovers();
    let leftover =
        [curves.clone(), residual::leftovers(&after.fit, &after.test, &after.judged, None)].concat();
    let evidence = SignalEvidence {
        kind: Evidence::HeldOut,
        errors: &errors,
        refitted: refitted.as_ref(),
        disturbances: &after.judged.disturbances,
        leftover: &leftover,
    };
    let verdicts = |effects: &[Finding]| {
        evidence.verdicts(
            // predictions are worse without the effects
            |signal| effects.iter().any(|e| e.worth_by_signal[signal as usize] > LEAST_GAIN),
            |signal| curves.iter().any(|curve| curve.part == signal),
        )
    };
    let before_names = verdicts(&named);
    let stands = |effect: &Finding| {
        let signal = main_signal(effect);
        let is_left = before_names[signal as usize].state == SignalState::PartlyExplained;
        let share = effect.worth_by_signal[signal as usize];
        !is_left || share > FAIR_SHARE || selection.is_swing(effect)
    };
    let (effects, small): (Vec<_>, Vec<_>) = named.into_iter().partition(stands);
    partial.extend(small);
    let signals = verdicts(&effects);
    let is_open = !partial.is_empty() || base.foreign || outcome == Outcome::Withdrawn;
    let explanation = Explanation {
        verdict: verdict(&signals, &effects, is_open),
        signals,
        effects,
        confirmed,
        needless: if keeps { needless_effects(base, &after.judged.hypothesis) } else { Vec::new() },
        withdrawn: if outcome == Outcome::Withdrawn { joined_effects(base, &selection) } else { Vec::new() },
        partial,
        corrections,
        numbers: if keeps { number_estimates(base, &selection) } else { Vec::new() },
        foreign: base.foreign,
        learned: keeps && !curves.is_empty(),
        disturbances: [before.judged.disturbances, after.judged.disturbances],
        declared: before.judged.hypothesis,
        leftover,
        completed: after.judged.hypothesis,
        not_excited: Vec::new(),
        path: selection.steps,
        errors,
        seconds: began.elapsed().as_secs_f64(),
    };
    explanation.into_reported()
}

/// Effects that joined the declared model.
fn joined_effects(base: &Baseline, selection: &RecordedSelection) -> Vec<&'static str> {
    selection.names().into_iter().filter(|name| !base.declares(name)).collect()
}

/// Effects that the model declares and the completed one is without.
fn needless_effects(base: &Baseline, completed: &Hypothesis) -> Vec<&'static str> {
    base.declared
        .iter()
        .map(|(entry, _)| entry.name)
        .filter(|name| base.declares(name) && !completed.has(name))
        .collect()
}

/// The numbers of the model, fitted beside the effects.
fn number_estimates(base: &Baseline, selection: &RecordedSelection) -> Vec<NumberEstimate> {
    let hypothesis = &selection.fitted.hypothesis;
    let paths = hypothesis.free.iter().zip(&base.numbers_before);
    let estimate = |(path, declared): (&String, &f64)| {
        Some(NumberEstimate {
            path: path.clone(),
            declared: *declared,
            value: hypothesis.model.parameter(path).ok()?,
            unit: vehicle::unit_of(&hypothesis.model, path),
        })
    };
    paths.filter_map(estimate).collect()
}
