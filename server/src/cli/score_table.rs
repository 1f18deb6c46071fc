//! What `crazyflie score` prints.

use std::io::Write;

use crazyflie_identify::explain::verdict::Finding;
use serde_json::{Map, Value, json};

use super::{Outcome, Table, number};
use crate::explained::{significant, verdict_name, with_error};
use crate::score::{Found, Marks, Scored, Truth, WORST_RATIO};

const LEGEND: &str = "\
named: what is hidden, by its name or in a group of at most three, and nothing that is not there; for null and unexcited flights no wrong name;
for what no effect describes, the verdict \"unexplained\". 15 %: of what the parameter changes (of a scale of 0.9, of the missing tenth).
3 stderr: within three of the estimate's standard errors. n/a: named by a partner, or nothing to compare.";

pub(super) fn print(all: &[Scored], markdown: bool, out: &mut dyn Write) -> Outcome {
    let told = all.iter().filter_map(marks).any(|m| m.told_ratio.is_some());
    let (cases, totals) = (cases(all, told), totals(all));
    if markdown {
        writeln!(out, "{}\n{}\n{LEGEND}", cases.markdown(), totals.markdown())?;
    } else {
        writeln!(out, "{}\n{}\n{LEGEND}", cases.plain(), totals.plain())?;
    }
    if told {
        writeln!(out, "told: largest error at 0.5 s and 2 s over that of a fit told the answer, at most {WORST_RATIO}.")?;
    }
    Ok(())
}

/// One case in a line, while the others are still being explained.
pub(super) fn line(scored: &Scored) -> String {
    match &scored.outcome {
        Err(problem) => format!("{}: {problem}", scored.id),
        Ok(found) => {
            let [.., said, named, name, near, within] = &row(found)[..] else { return scored.id.clone() };
            format!("{}: {said}, {named} (name {name}, 15 % {near}, 3 stderr {within}, {:.1} s)", scored.id, found.explanation.seconds)
        }
    }
}

fn marks(scored: &Scored) -> Option<&Marks> {
    scored.outcome.as_ref().ok()?.marks.as_ref()
}

fn cases(all: &[Scored], told: bool) -> Table {
    let mut header = vec!["case", "group", "tier", "truth", "verdict", "named", "name", "15 %", "3 stderr"];
    header.extend(told.then_some("told"));
    header.push("s");
    let mut table = Table::new(&header).left(&[1, 2, 3, 4, 5, 6, 7, 8]);
    for scored in all {
        let mut cells = vec![scored.id.clone()];
        match &scored.outcome {
            Err(problem) => cells.extend(["", "", "", "failed", problem, "MISS", "", ""].map(String::from)),
            Ok(found) => cells.extend(row(found)),
        }
        if told {
            cells.push(marks(scored).and_then(|m| m.told_ratio).map_or("n/a".into(), |r| number(r, 2)));
        }
        cells.push(scored.outcome.as_ref().map_or_else(|_| String::new(), |f| number(f.explanation.seconds, 0)));
        table.row(cells);
    }
    table
}

/// Group to the marks on the parameters.
fn row(found: &Found) -> Vec<String> {
    let explanation = &found.explanation;
    let named: Vec<String> = explanation.effects.iter().flat_map(Finding::all).map(brief).collect();
    let said = [verdict_name(explanation.verdict).to_owned(), if named.is_empty() { "-".into() } else { named.join("; ") }];
    match &found.marks {
        None => [vec![String::new(); 3], said.to_vec(), vec!["?".into(); 3]].concat(),
        Some(m) => {
            let about = [m.truth.group.name().to_owned(), m.truth.tier.clone(), truth(&m.truth)];
            let marks = [Some(m.named), m.near, m.within].map(|mark| word(mark).to_owned());
            [about.to_vec(), said.to_vec(), marks.to_vec()].concat()
        }
    }
}

fn word(mark: Option<bool>) -> &'static str {
    match mark {
        Some(true) => "ok",
        Some(false) => "MISS",
        None => "n/a",
    }
}

/// An effect with its values, and its rivals in brackets.
fn brief(effect: &Finding) -> String {
    let values: Vec<String> = effect.params.iter().map(|p| with_error(p.value, p.stderr)).collect();
    let rivals = if effect.confusable_with.is_empty() { String::new() } else { format!(" [{}]", effect.confusable_with.join(", ")) };
    format!("{} {}{rivals}", effect.name, values.join(", "))
}

fn truth(truth: &Truth) -> String {
    let one = |e: &crate::score::HiddenEffect| {
        let values: Vec<String> = e.params.values().map(|v| significant(*v, 3)).collect();
        format!("{} {}", e.name, values.join(", "))
    };
    let all: Vec<String> = truth.effects.iter().map(one).collect();
    if all.is_empty() { "-".into() } else { all.join("; ") }
}

/// A criterion: its name, how often it is kept, and how often it applies.
type Count = (&'static str, usize, usize);

/// Criteria per group of cases, and over all.
fn counts(all: &[Scored]) -> Vec<(String, Vec<Count>)> {
    let mut groups: Vec<String> = Vec::new();
    for m in all.iter().filter_map(marks) {
        let name = m.truth.group.name().to_owned();
        if !groups.contains(&name) {
            groups.push(name);
        }
    }
    groups.push("all".into());
    let of = |group: &String| {
        let of_group: Vec<&Marks> = all.iter().filter_map(marks).filter(|m| group == "all" || m.truth.group.name() == group).collect();
        let criteria = of_group.first().map(|m| m.criteria().map(|(name, _)| name)).unwrap_or_default();
        let count = |(at, name): (usize, &'static str)| {
            let given: Vec<bool> = of_group.iter().filter_map(|m| m.criteria()[at].1).collect();
            (name, given.iter().filter(|ok| **ok).count(), given.len())
        };
        (group.clone(), criteria.into_iter().enumerate().map(count).collect())
    };
    groups.iter().map(of).collect()
}

fn totals(all: &[Scored]) -> Table {
    let counts = counts(all);
    let mut header = vec!["group"];
    header.extend(counts.last().iter().flat_map(|(_, c)| c.iter().map(|(name, ..)| *name)));
    let mut table = Table::new(&header);
    for (group, criteria) in &counts {
        let cell = |(_, ok, of): &Count| if *of == 0 { "n/a".into() } else { format!("{ok} of {of}") };
        table.row(std::iter::once(group.clone()).chain(criteria.iter().map(cell)).collect());
    }
    table
}

pub(super) fn totals_json(all: &[Scored]) -> Value {
    let of = |criteria: Vec<Count>| {
        criteria.into_iter().map(|(name, ok, of)| (name.to_owned(), json!({"ok": ok, "of": of}))).collect::<Map<_, _>>()
    };
    counts(all).into_iter().map(|(group, criteria)| (group, Value::Object(of(criteria)))).collect::<Map<_, _>>().into()
}

pub(super) fn as_json(scored: &Scored) -> Value {
    let found = match &scored.outcome {
        Err(problem) => return json!({"case": scored.id, "failed": problem}),
        Ok(found) => found,
    };
    let explanation = &found.explanation;
    let marks = found.marks.as_ref().map(|m| {
        let truth: Vec<Value> = m.truth.effects.iter().map(|e| json!({"name": e.name, "params": e.params})).collect();
        let criteria = m.criteria().into_iter().map(|(name, mark)| (name.to_owned(), json!(mark))).collect::<Map<_, _>>();
        json!({"group": m.truth.group.name(), "tier": m.truth.tier, "truth": truth, "criteria": criteria, "told_ratio": m.told_ratio})
    });
    json!({"case": scored.id, "verdict": verdict_name(explanation.verdict), "effects": explanation.effects, "score": marks,
        "seconds": explanation.seconds})
}
