//! From the residual of a model to its cause.

pub mod candidates;
pub mod errors;
pub mod learn;
pub mod leftover;
pub mod noise;
mod place;
pub mod refine;
pub mod search;
pub mod shape;
pub mod verdict;

use std::time::Instant;

use crazyflie_env::effects::{Disturbance, Entry, Role, Trace, registry};
use crazyflie_env::model::Model;
use rayon::prelude::*;

use crate::fit::filter::{Belief, Disturbances, Filtered, Wander, filter};
use crate::fit::flight::Flight;
use crate::fit::hypothesis::{Hypothesis, Term};
use noise::Said;
use search::{Dissected, Judged, Score, Search};
use verdict::{Estimate, Explanation, Leftover, Named, Ranked, Step, Verdict};

/// Log-likelihood that an effect must be worth on the flights of the fit: three, and the logarithm of the number of candidates, and as much
/// again for what the noise model does not cover.
const WORTH_FIT: f64 = 15.0;
/// And on the test flights, where nothing was fitted.
const WORTH_TEST: f64 = 3.0;
/// An effect worth this much whose size is unclear leaves the question open.
const UNDECIDED: f64 = 25.0;
/// Hypotheses this close in log-likelihood cannot be told apart.
const ALIKE: f64 = 5.0;
/// A rival this much more likely takes the place of what was found first.
const MORE_LIKELY: f64 = 1.0;
/// A name with more rivals than this is no answer.
const MOST_RIVALS: usize = 2;
/// A torque that wanders by more than this (rad/s^2) may be commands that did not arrive.
const LOST_COMMANDS_RADPS2: f64 = 0.1;
/// A gust that lasts longer than this may be steady for all that a short flight says.
const SLOW_GUST_S: f64 = 3.0;
/// Effects that do not account for the structure are kept if they lower the 2 s errors of position or velocity on the test flights by this share.
const HELPS: f64 = 0.05;

/// Explains what a model lacks: fitted on `fit`, judged on `test`. `progress` is told what is being done.
///
/// Returns `None` if the declared model cannot be run on the flights.
pub fn explain(model: &Model, fit: &[Flight], test: &[Flight], progress: &dyn Fn(&str)) -> Option<Explanation> {
    let began = Instant::now();
    let (search, judge) = (Search::new(fit), Search::new(test));
    progress("disturbances of the declared model");
    let declared = search.declared(&Hypothesis::of(model))?;
    let (path, steps) = forward(&search, &search.roughly(&declared)?, progress);
    let settled = settle(&search, &judge, path, progress)?;
    progress("what is left");
    let (settled, left) = accounted(&search, &judge, settled, fit, test);
    let Left { blown, leftover, structured } = left;
    let last = &settled.dissected.judged;
    let mut effects = named(&judge, &settled)?;
    let mut disturbances = last.disturbances;
    if let Some(blown) = blown.filter(|_| !structured) {
        effects.extend(gust(&search, &judge, last, &blown));
        disturbances = blown.disturbances;
    }
    let many = |e: &Named| e.confusable_with.len() > MOST_RIVALS;
    let dropped = settled.dropped && effects.is_empty();
    let undecided = settled.dissected.unclear > UNDECIDED || effects.iter().any(many) || dropped;
    effects.retain(|e| !many(e));
    let mut completed = Completed::of(&declared, last, told_together(effects), disturbances, test);
    if structured {
        completed = completed.beside_structure(&declared, test);
        progress("a term learned from the residual");
        completed = completed.learned(&search, &judge, last, &declared, test);
    }
    let verdict = match (structured, completed.effects.is_empty(), undecided) {
        (true, ..) => Verdict::Unexplained,
        (false, false, _) => Verdict::Explained,
        (false, true, true) => Verdict::NotDecidable,
        (false, true, false) => Verdict::NothingMissing,
    };
    Some(Explanation {
        verdict,
        completed: completed.with_random(),
        effects: completed.effects,
        partial: completed.partial,
        learned: completed.learned,
        disturbances: [declared.disturbances, completed.disturbances],
        declared: declared.hypothesis,
        not_excited: not_excited(&steps),
        path: steps,
        leftover,
        errors: completed.errors,
        seconds: began.elapsed().as_secs_f64(),
    })
}

/// How badly a model predicts flights as it is: the negative log-likelihood, with what is random about them. `None` if it cannot be run on them.
pub fn declared_loss(model: &Model, flights: &[Flight]) -> Option<f64> {
    Some(Search::new(flights).declared(&Hypothesis::of(model))?.loss)
}

/// By effect, what these flights cannot tell from it.
type Rivals = Vec<(&'static str, Vec<&'static str>)>;

/// What the search came to.
struct Settled {
    dissected: Dissected,
    rivals: Rivals,
    /// An effect was worth nothing on the test flights.
    dropped: bool,
}

/// Takes out what did not earn its place: on the flights of the fit, beside rivals, on the test flights, and by the last word on the parameters.
fn settle(search: &Search, judge: &Search, path: Judged, progress: &dyn Fn(&str)) -> Option<Settled> {
    progress("backward");
    let mut rivals = Vec::new();
    let settled = settle_rivals(search, search.backward(path, WORTH_FIT), &mut rivals, progress);
    let exact = search.backward(search.exactly(&settled.judged)?, WORTH_FIT);
    progress("the test flights");
    last_word(search, judge, Dissected { unclear: exact.unclear.max(settled.unclear), ..exact }, rivals)
}

fn last_word(search: &Search, judge: &Search, from: Dissected, rivals: Rivals) -> Option<Settled> {
    let (dissected, dropped) = gate(search, judge, from)?;
    Some(Settled { dissected: refined(search, dissected), rivals, dropped })
}

/// What is left when an explanation is taken for true.
struct Left {
    blown: Option<Blown>,
    leftover: Vec<Leftover>,
    structured: bool,
}

impl Left {
    fn of(fit: &[Flight], test: &[Flight], settled: &Settled) -> Self {
        let last = &settled.dissected.judged;
        let blown = blown(fit, last);
        let leftover = leftovers(fit, test, last, blown.as_ref());
        let structured = leftover.iter().any(Leftover::is_structure);
        Left { blown, leftover, structured }
    }
}

/// What nearly earned its place has earned it if it accounts for the structure that is left without.
fn accounted(search: &Search, judge: &Search, mut settled: Settled, fit: &[Flight], test: &[Flight]) -> (Settled, Left) {
    let left = Left::of(fit, test, &settled);
    let nearly = settled.dissected.nearly.take().filter(|_| left.structured);
    let other = nearly.and_then(|nearly| last_word(search, judge, search.dissect(nearly), settled.rivals.clone()));
    let other = other.map(|other| (Left::of(fit, test, &other), other)).filter(|(left, _)| !left.structured);
    other.map_or((settled, left), |(left, other)| (other, left))
}

/// The declared model with what was found, and what that is worth on the test flights.
struct Completed {
    effects: Vec<Named>,
    partial: Vec<Named>,
    learned: bool,
    hypothesis: Hypothesis,
    disturbances: Disturbances,
    errors: errors::Errors,
}

/// A hypothesis with its disturbances.
type Told<'a> = (&'a Hypothesis, &'a Disturbances);

impl Completed {
    fn of(declared: &Judged, last: &Judged, effects: Vec<Named>, disturbances: Disturbances, test: &[Flight]) -> Self {
        let mut hypothesis = last.settled();
        hypothesis.terms.retain(|t| effects.iter().flat_map(Named::all).any(|e| e.name == t.entry.name));
        let errors = errors::compare(told(declared), (&hypothesis, &disturbances), test);
        Completed { effects, partial: Vec::new(), learned: false, hypothesis, disturbances, errors }
    }

    /// Names that do not account for the structure are not the cause: at most they help.
    fn beside_structure(mut self, declared: &Judged, test: &[Flight]) -> Self {
        if self.effects.is_empty() {
            return self;
        }
        let effects = std::mem::take(&mut self.effects);
        if (0..2).any(|q| self.errors.after[q][3] < (1.0 - HELPS) * self.errors.before[q][3]) {
            return Completed { partial: effects, ..self };
        }
        self.hypothesis.terms.clear();
        self.errors = errors::compare(told(declared), (&self.hypothesis, &self.disturbances), test);
        self
    }

    /// With a term learned from the residual, if it lowers the 2 s errors on the test flights.
    fn learned(self, search: &Search, judge: &Search, last: &Judged, declared: &Judged, test: &[Flight]) -> Self {
        let described = search.refit(&self.hypothesis, &last.disturbances).and_then(|named| learn::learn(search, judge, &named));
        let Some(described) = described else { return self };
        let (hypothesis, disturbances) = (described.settled(), described.disturbances);
        let errors = errors::compare(told(declared), (&hypothesis, &disturbances), test);
        let better = errors.after[0][3] < (1.0 - HELPS) * self.errors.after[0][3] && errors.after[1][3] < self.errors.after[1][3];
        if better { Completed { learned: true, hypothesis, disturbances, errors, ..self } } else { self }
    }

    /// Effects that were named but are random, and so no part of what was fitted, belong to the model that is flown too.
    fn with_random(&self) -> Hypothesis {
        let mut all = self.hypothesis.clone();
        for effect in &self.effects {
            let Some(entry) = registry().iter().find(|e| e.name == effect.name && matches!(e.trace, Trace::Wander(_))) else { continue };
            let mut term = Term::off(entry);
            for (slot, estimate) in term.values.iter_mut().zip(&effect.params) {
                *slot = estimate.value;
            }
            term.free.clear();
            all = all.with(term);
        }
        all
    }
}

fn told(declared: &Judged) -> Told<'_> {
    (&declared.hypothesis, &declared.disturbances)
}

/// Disturbances too large for the small errors of a model; their size in units of what makes a finding.
fn shaken(disturbances: &Disturbances, blown: Option<&Blown>) -> Vec<Leftover> {
    let Disturbances { lift, torque, turn, .. } = *disturbances;
    let finding = |signal: &str, words: String, size: f64| Leftover::new(signal, words, leftover::FINDING * size);
    let shaken = |what: &str, by: Wander, unit: &str| {
        format!("{what} shaken by {:.2} {unit}, for {:.2} s at a time, whatever the commands", by.sigma, by.tau_s)
    };
    let of = |(said, size): (Said, f64)| {
        Some(match said {
            Said::Force => return None,
            Said::Lift => finding("lift", shaken("the thrust is", lift, "m/s^2"), size),
            Said::Torque => finding("torque", shaken("roll and pitch are", torque, "rad/s^2"), size),
            Said::Turn => finding("turn", shaken("the yaw is", turn, "rad/s^2"), size),
        })
    };
    let mut found: Vec<Leftover> = noise::said(disturbances).filter_map(of).collect();
    let endless = blown.map(|b| b.disturbances).filter(|d| d.force.tau_s >= noise::LONGEST_S);
    let endless = endless.and_then(|d| Some((d, noise::said(&d).find(|(said, _)| *said == Said::Force)?.1)));
    found.extend(
        endless.map(|(d, size)| finding("force", format!("wanders by {:.2} m/s^2, for longer than gusts do", d.force.sigma), size)),
    );
    found
}

/// Forward, one effect at a time, while the filter gains anything.
fn forward(search: &Search, declared: &Judged, progress: &dyn Fn(&str)) -> (Judged, Vec<Step>) {
    let mut now = declared.clone();
    let mut steps = Vec::new();
    let mut gain = 0.0;
    loop {
        let names: Vec<&'static str> = now.hypothesis.terms.iter().map(|t| t.entry.name).collect();
        progress(&format!("candidates besides {}", if names.is_empty() { "nothing".into() } else { names.join(", ") }));
        let (scores, next) = search.extend(&now);
        steps.push(Step { effects: names, gain, ranking: scores.iter().map(ranked).collect() });
        let gains = |next: &Judged| now.loss - next.loss > search::LEAST_GAIN && next.hypothesis.terms.len() <= search::MOST_EFFECTS;
        let shaken = now.disturbances.torque.sigma > LOST_COMMANDS_RADPS2;
        let Some(next) = next.filter(gains).or_else(|| if shaken { search.held(&now).filter(gains) } else { None }) else {
            return (now, steps);
        };
        gain = now.loss - next.loss;
        now = next;
    }
}

fn ranked(score: &Score) -> Ranked {
    Ranked { name: score.start.entry.name, gain: score.gain, stderr: score.sd.clone() }
}

/// Looks for rivals of each effect. One that is likelier takes its place, and one that lets another effect go: what a mass does, a thrust scale and a
/// damping do together.
fn settle_rivals(search: &Search, from: Dissected, rivals: &mut Rivals, progress: &dyn Fn(&str)) -> Dissected {
    let price = |d: &Dissected| d.judged.loss + WORTH_FIT * d.without.len() as f64;
    let mut now = from;
    let mut swaps = 0;
    'again: loop {
        rivals.clear();
        let names: Vec<&str> = now.without.iter().map(|(name, _)| *name).collect();
        progress(&format!("rivals of {}", names.join(", ")));
        let all: Vec<_> = now.without.par_iter().map(|(name, less)| (*name, search.rivals(&now.judged, name, less, ALIKE))).collect();
        let found = all.iter().flat_map(|(_, found)| found).map(|(_, judged)| judged);
        let likelier = found.filter(|judged| swaps < 2 && judged.loss < now.judged.loss - MORE_LIKELY);
        if let Some(best) = likelier.min_by(|a, b| a.loss.total_cmp(&b.loss)) {
            now = search.backward(best.clone(), WORTH_FIT);
            swaps += 1;
            continue;
        }
        for (name, found) in all {
            if now.without.len() > 1 && swaps < 2 {
                for (_, judged) in &found {
                    let simpler = search.backward(judged.clone(), WORTH_FIT);
                    if price(&simpler) < price(&now) - 0.5 * WORTH_FIT {
                        now = simpler;
                        swaps += 1;
                        continue 'again;
                    }
                }
            }
            rivals.push((name, found.into_iter().map(|(name, _)| name).collect()));
        }
        return now;
    }
}

/// Takes out what does not help on the test flights, one at a time, and says whether there was any.
fn gate(search: &Search, judge: &Search, from: Dissected) -> Option<(Dissected, bool)> {
    let (mut now, mut dropped) = (from, false);
    loop {
        let worths = worths(judge, &now)?;
        match worths.into_iter().enumerate().min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((least, worth)) if worth < WORTH_TEST => {
                dropped = true;
                now = search.dissect(now.without.swap_remove(least).1);
            }
            _ => return Some((now, dropped)),
        }
    }
}

/// With the last word on the parameters, and without the effects that it leaves unclear.
fn refined(search: &Search, from: Dissected) -> Dissected {
    let mut now = from;
    while let Some(belief) = refine::refine(search.flights, &now.judged) {
        now.judged.belief = belief;
        let clearances = now.without.iter().map(|(name, _)| now.judged.clearance(name)).enumerate();
        match clearances.min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((least, clearance)) if clearance < search::CLEAR => now = search.dissect(now.without.swap_remove(least).1),
            _ => break,
        }
    }
    now
}

/// Log-likelihood of the test flights that each effect is worth. Where nothing shakes a vehicle as much as the floor of the disturbances has it, a
/// damping is worth something for that alone: an effect must be worth it in still air too.
fn worths(judge: &Search, of: &Dissected) -> Option<Vec<f64>> {
    let loss = |j: &Judged, air: fn(&Disturbances) -> Disturbances| judge.plug_in(&j.settled(), &air(&j.disturbances));
    let worth = |air: fn(&Disturbances) -> Disturbances| -> Option<Vec<f64>> {
        let full = loss(&of.judged, air)?;
        of.without.par_iter().map(|(_, less)| Some(loss(less, air)? - full)).collect()
    };
    let (usual, still) = rayon::join(|| worth(|d| *d), || worth(noise::still));
    Some(usual?.into_iter().zip(still?).map(|(a, b)| a.min(b)).collect())
}

fn named(judge: &Search, Settled { dissected: of, rivals, .. }: &Settled) -> Option<Vec<Named>> {
    let settled = of.judged.settled();
    let worths = worths(judge, of)?;
    let one = |((name, less), worth_test): (&(&'static str, Judged), f64)| {
        let term = settled.terms.iter().find(|t| t.entry.name == *name)?;
        let params = term.free.iter().zip(settled.place(name)).map(|(i, at)| {
            let p = &term.entry.params[*i];
            Estimate { name: p.name, value: term.values[*i], stderr: of.judged.belief.sd(at), unit: p.unit }
        });
        let params: Vec<Estimate> = params.collect();
        let confusable_with = rivals.iter().find(|(other, _)| other == name).map_or_else(Vec::new, |(_, r)| r.clone());
        let manoeuvre = if confusable_with.is_empty() { String::new() } else { manoeuvre(term.entry, &confusable_with) };
        let worth_fit = less.loss - of.judged.loss;
        Some(Named { name, params, confusable_with, manoeuvre, worth_fit, worth_test, with: Vec::new() })
    };
    of.without.iter().zip(worths).map(one).collect()
}

/// What the declared model leaves out by its form is one finding.
fn told_together(effects: Vec<Named>) -> Vec<Named> {
    let is_geometry = |e: &Named| registry().iter().any(|entry| entry.name == e.name && entry.geometry);
    let (mut geometry, mut others): (Vec<Named>, Vec<Named>) = effects.into_iter().partition(is_geometry);
    if !geometry.is_empty() {
        let with = geometry.split_off(1);
        others.extend(geometry.pop().map(|first| Named { with, ..first }));
    }
    others
}

/// What to fly so that effects part: where they enter decides what has to change.
fn manoeuvre(effect: &Entry, others: &[&'static str]) -> String {
    let lookup = |name: &&str| registry().iter().find(|e| e.name == *name);
    let all: Vec<&Entry> = others.iter().filter_map(lookup).chain([effect]).collect();
    if matches!(effect.trace, Trace::Wander(_)) {
        return "fly for more than twenty times as long as the gusts last, with one full turn in yaw".into();
    }
    if all.iter().all(|e| e.hooks.push) {
        return "climb and descend fast between 0.1 m and 1.5 m, then fly on until the battery is low, with one full turn in yaw".into();
    }
    if all.iter().any(|e| e.hooks.frame) {
        return "turn slowly through 360 degrees while translating at two heights".into();
    }
    "doublets of two sizes (2 and 8 degrees) on roll and pitch at two rates of change".into()
}

/// A wandering force, as it may be a gust: disturbances with its size and correlation time finely, and the standard errors of these.
struct Blown {
    disturbances: Disturbances,
    sd: [f64; 2],
}

fn blown(fit: &[Flight], last: &Judged) -> Option<Blown> {
    noise::said(&last.disturbances).find(|(said, _)| *said == Said::Force && last.disturbances.force.tau_s > noise::GUST_S)?;
    let (disturbances, sd) = noise::force(fit, &last.settled(), &last.disturbances);
    Some(Blown { disturbances, sd })
}

/// What else may be there for good where a force that wanders slowly is taken for a gust: it is as likely, and no gust is left beside it.
fn steady(search: &Search, last: &Judged, blown: &Blown) -> Option<&'static str> {
    (blown.disturbances.force.tau_s > SLOW_GUST_S).then_some(())?;
    let other = search.extend(last).1.filter(|other| other.loss < last.loss + ALIKE)?;
    noise::said(&other.disturbances).all(|(said, _)| said != Said::Force).then_some(())?;
    other.hypothesis.terms.iter().map(|t| t.entry.name).find(|name| !last.hypothesis.has(name))
}

/// The wandering force as the effect of the registry that is one.
fn gust(search: &Search, judge: &Search, last: &Judged, blown: &Blown) -> Option<Named> {
    let entry = registry().iter().find(|e| e.trace == Trace::Wander(Disturbance::Force))?;
    let force = blown.disturbances.force;
    let calm = Disturbances { force: Wander { sigma: noise::FLOOR.force.sigma, ..force }, ..blown.disturbances };
    let at = last.settled();
    let worth_test = judge.plug_in(&at, &calm)? - judge.plug_in(&at, &blown.disturbances)?;
    let estimates = entry.params.iter().zip([force.sigma, force.tau_s]).zip(blown.sd);
    let params = estimates.map(|((p, value), stderr)| Estimate { name: p.name, value, stderr, unit: p.unit }).collect();
    let confusable_with: Vec<&'static str> = steady(search, last, blown).into_iter().collect();
    let manoeuvre = if confusable_with.is_empty() { String::new() } else { manoeuvre(entry, &confusable_with) };
    (worth_test > WORTH_TEST).then_some(Named {
        name: entry.name,
        params,
        confusable_with,
        manoeuvre,
        worth_fit: worth_test,
        worth_test,
        with: Vec::new(),
    })
}

/// The strongest findings in the innovations of the test flights, and in the forces of all.
fn leftovers(fit: &[Flight], test: &[Flight], last: &Judged, blown: Option<&Blown>) -> Vec<Leftover> {
    let (at, disturbances, nothing) = (last.settled().fixed(), &last.disturbances, Belief::independent(Vec::new(), &[]));
    let filtered = |f: &Flight| filter(f, f.all(), &at, &nothing, disturbances);
    let known: Vec<_> = fit.par_iter().filter_map(|f| Some((f, filtered(f)?))).collect();
    let tested: Vec<_> = test.par_iter().filter_map(|f| Some((f, filtered(f)?))).collect();
    let of = |(flight, filtered): &(&Flight, Filtered)| {
        [leftover::leftover(flight, filtered), shape::shapes(flight, filtered, disturbances)].concat()
    };
    let mut all: Vec<Leftover> = tested.iter().flat_map(of).collect();
    all.extend(place::belongs(known.iter().chain(&tested).map(|(flight, filtered)| (*flight, filtered)), disturbances));
    all.sort_by(|a, b| b.size.abs().total_cmp(&a.size.abs()));
    all.truncate(12);
    [shaken(disturbances, blown), all].concat()
}

/// Effects of which a tenth of the range of every free parameter would not have shown at four standard errors.
fn not_excited(steps: &[Step]) -> Vec<(&'static str, f64)> {
    let first = steps.first().map_or(&[][..], |s| &s.ranking);
    let hidden = |r: &Ranked| {
        let entry = registry().iter().find(|e| e.name == r.name)?;
        let free = entry.params.iter().filter(|p| p.role == Role::Free).zip(&r.stderr);
        let shows = free.clone().any(|(p, sd)| 4.0 * sd <= 0.1 * (p.high - p.low));
        let (_, sd) = free.into_iter().next()?;
        (!shows).then_some((r.name, *sd))
    };
    first.iter().filter_map(hidden).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &'static str) -> Named {
        let (params, confusable_with, manoeuvre) = (Vec::new(), Vec::new(), String::new());
        Named { name, params, confusable_with, manoeuvre, worth_fit: 20.0, worth_test: 20.0, with: Vec::new() }
    }

    #[test]
    fn exact_geometry_is_one_finding() {
        let told = told_together(["wind", "tilt_loss", "euler_kinematics"].map(named).to_vec());
        assert_eq!(told.iter().map(|e| e.name).collect::<Vec<_>>(), ["wind", "tilt_loss"]);
        assert_eq!(told[1].all().map(|e| e.name).collect::<Vec<_>>(), ["tilt_loss", "euler_kinematics"]);
        assert_eq!(told_together(vec![named("euler_kinematics")])[0].name, "euler_kinematics");
        assert!(told_together(Vec::new()).is_empty());
    }

    #[test]
    fn a_force_that_wanders_on_and_on_is_structure() {
        let of = |tau_s: f64| {
            let disturbances = Disturbances { force: Wander { sigma: 0.4, tau_s }, ..Disturbances::NONE };
            shaken(&disturbances, Some(&Blown { disturbances, sd: [0.1; 2] }))
        };
        assert!(of(3.0).is_empty());
        assert!(of(noise::LONGEST_S).iter().all(Leftover::is_structure) && of(noise::LONGEST_S).len() == 1);
    }
}
