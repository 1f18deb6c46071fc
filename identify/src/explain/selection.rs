//! Which effects are kept: forward by likelihood, then eliminated on the flights of the fit, beside rivals, and on the test flights.

use crazyflie_env::effects::{Geometry, registry};
use rayon::prelude::*;

use super::calibration::selection::{AMOUNT_SD, MORE_LIKELY};
use super::noise;
use super::refine;
use super::search::{self, Dissected, Judged, Score, Search};
use super::verdict::{Ranked, Step};
use super::{ALIKE, WORTH_FIT, WORTH_TEST};
use crate::fit::filter::Disturbances;
use crate::fit::hypothesis::Term;

/// A torque that wanders by more than this (rad/s^2) may be commands that did not arrive.
const LOST_COMMANDS_RADPS2: f64 = 0.1;

/// By effect, what these flights cannot tell from it.
pub type Rivals = Vec<(&'static str, Vec<&'static str>)>;

/// The effects that are kept, with what tells how well.
pub struct Selection {
    pub dissected: Dissected,
    pub rivals: Rivals,
    /// An effect was worth nothing on the test flights.
    pub dropped: bool,
}

/// The declared model, or its exact geometric form if that is likelier: one look, before effects are tried beside it.
pub fn model_form(search: &Search, declared: Judged) -> Judged {
    let absent = |name: &str| !declared.hypothesis.model.effects.contains_key(name);
    let wholes = registry().iter().filter(|e| e.geometry == Geometry::Whole && absent(e.name));
    let judged = wholes.filter_map(|entry| {
        let mut term = Term::off(entry);
        for i in term.free.clone() {
            term.values[i] = entry.params[i].far();
        }
        let sd = vec![AMOUNT_SD; term.free.len()];
        let first = search.judge(&declared.hypothesis.with(term), &sd, &declared.disturbances)?;
        search.tuned(&first)
    });
    let likelier = judged.filter(|j| declared.loss - j.loss > search::LEAST_GAIN).min_by(|a, b| a.loss.total_cmp(&b.loss));
    likelier.unwrap_or(declared)
}

/// Forward, one effect at a time, while the filter gains anything.
pub fn forward(search: &Search, from: &Judged, progress: &dyn Fn(&str)) -> (Judged, Vec<Step>) {
    let mut now = from.clone();
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

/// Takes out what did not earn its place: on the flights of the fit, beside rivals, on the test flights, and by the last word on the parameters.
pub fn eliminate(search: &Search, judge: &Search, path: Judged, progress: &dyn Fn(&str)) -> Option<Selection> {
    progress("backward");
    let mut rivals = Vec::new();
    let settled = settle_rivals(search, search.backward(path, WORTH_FIT), &mut rivals, progress);
    let exact = search.backward(search.exactly(&settled.judged)?, WORTH_FIT);
    progress("the test flights");
    validate(search, judge, Dissected { unclear: exact.unclear.max(settled.unclear), ..exact }, rivals)
}

/// Keeps what is worth its place on the test flights, at the most likely values of its parameters.
pub fn validate(search: &Search, judge: &Search, from: Dissected, rivals: Rivals) -> Option<Selection> {
    let (dissected, dropped) = gate(search, judge, from)?;
    Some(Selection { dissected: refined(search, dissected), rivals, dropped })
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

/// With the most likely parameters, and without the effects that these leave unclear.
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
pub fn worths(judge: &Search, dissected: &Dissected) -> Option<Vec<f64>> {
    let loss = |j: &Judged, air: fn(&Disturbances) -> Disturbances| judge.plug_in(&j.settled(), &air(&j.disturbances));
    let worth = |air: fn(&Disturbances) -> Disturbances| -> Option<Vec<f64>> {
        let full = loss(&dissected.judged, air)?;
        dissected.without.par_iter().map(|(_, less)| Some(loss(less, air)? - full)).collect()
    };
    let (usual, still) = rayon::join(|| worth(|d| *d), || worth(noise::still));
    Some(usual?.into_iter().zip(still?).map(|(a, b)| a.min(b)).collect())
}
