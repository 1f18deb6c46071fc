//! Output of `crazyflie explain-bench`: a row for each case, then rates.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::{Table, number};
use crate::explanation::{significant, with_error};
use crate::score::{
    Answer, CRITERIA, CaseRecord, EffectRow, Group, HiddenEffect, NamedEffect, Rate, Rates, Results, Stratum,
    ValueStatistics, WORST_RATIO,
};

pub(super) const LEGEND: &str = "\
named: what is hidden, by its name or in a group of at most three, and nothing that is not there; for null and unexcited flights no wrong name;
for what no effect describes, that structure is left, and no wrong name. 15 %: of what the parameter changes (of a scale of 0.9, of the missing tenth).
3 stderr: within three of the estimate's standard errors. n/a: named by a partner, or nothing to compare. In brackets: 95 % (Wilson).
Shown: a fit that is given the answer finds each hidden effect four standard errors from \"off\" (only with --oracle).";

/// Title of the table of [`sensitivity_table`].
pub(super) const SENSITIVITY: &str = "Thresholds: answers with other values";

/// Everything about a run, for a terminal.
pub(super) fn plain(results: &Results) -> String {
    let rates = Rates::from_records(&results.cases);
    let mut text = format!("{}\n", case_table(&results.cases).plain());
    for (title, table) in rate_tables(&rates) {
        text += &format!("{title}\n{}\n", table.plain());
    }
    if let Some(table) = sensitivity_table(results) {
        text += &format!("{SENSITIVITY}\n{}\n", table.plain());
    }
    text += &format!("{}\n{LEGEND}\n", summary(&rates).join("\n"));
    if has_oracle(&rates) {
        text += &format!(
            "oracle: largest error at 0.5 s and 2 s over that of a fit given the answer, at most {WORST_RATIO}.\n"
        );
    }
    text
}

/// Tables of rates with their titles.
pub(super) fn rate_tables(rates: &Rates) -> Vec<(&'static str, Table)> {
    vec![
        ("Groups", group_table(rates)),
        ("Verdicts", verdict_table(rates)),
        ("Effects: what was named", confusion_table(&rates.effects)),
        ("Values by effect", value_table(&rates.effects)),
        ("Tier, excitation, noise: right answers", stratum_table(&rates.strata)),
    ]
}

/// A case in a line, while the others are still being explained.
pub(super) fn line(record: &CaseRecord) -> String {
    if let Some(problem) = &record.failed {
        return format!("{}: {problem}", record.case);
    }
    let criteria = record.score.criteria;
    let marks = [Some(criteria.named), criteria.near, criteria.within].map(mark);
    let seconds = record.seconds.unwrap_or(f64::NAN);
    let [named, near, within] = marks;
    format!(
        "{}: {}, {} (name {named}, 15 % {near}, 3 stderr {within}, {seconds:.1} s)",
        record.case,
        record.verdict,
        named_effects_text(record)
    )
}

/// A row a case.
pub(super) fn case_table(records: &[CaseRecord]) -> Table {
    let mut table = Table::new(&[
        "case", "group", "tier", "truth", "verdict", "named", "name", "15 %", "3 stderr", "oracle", "s",
    ]);
    table = table.left(&[1, 2, 3, 4, 5, 6, 7, 8]);
    for record in records {
        let (score, criteria) = (&record.score, record.score.criteria);
        let mut cells =
            vec![record.case.clone(), score.group.name().to_owned(), score.tier.clone(), truth(&score.truth)];
        cells.extend([
            record.verdict.clone(),
            record.failed.clone().unwrap_or_else(|| named_effects_text(record)),
        ]);
        cells.extend([Some(criteria.named), criteria.near, criteria.within].map(|m| mark(m).to_owned()));
        cells.push(optional(score.told_ratio, 2));
        cells.push(optional(record.seconds, 0));
        table.row(cells);
    }
    table
}

fn optional(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "n/a".to_owned(), |value| number(value, decimals))
}

fn mark(mark: Option<bool>) -> &'static str {
    match mark {
        Some(true) => "ok",
        Some(false) => "MISS",
        None => "n/a",
    }
}

/// The effects that were named, with values and rivals.
fn named_effects_text(record: &CaseRecord) -> String {
    let named: Vec<String> = record.effects.iter().flat_map(NamedEffect::all).map(brief).collect();
    if named.is_empty() { "-".into() } else { named.join("; ") }
}

fn brief(effect: &NamedEffect) -> String {
    let value = |v: Option<f64>| v.unwrap_or(f64::NAN);
    let values: Vec<String> =
        effect.params.iter().map(|p| with_error(value(p.value), value(p.stderr))).collect();
    let rivals = if effect.confusable_with.is_empty() {
        String::new()
    } else {
        format!(" [{}]", effect.confusable_with.join(", "))
    };
    format!("{} {}{rivals}", effect.name, values.join(", "))
}

fn truth(effects: &[HiddenEffect]) -> String {
    let all: Vec<String> = effects
        .iter()
        .map(|effect| {
            let values: Vec<String> = effect.params.values().map(|v| significant(*v, 3)).collect();
            format!("{} {}", effect.name, values.join(", "))
        })
        .collect();
    if all.is_empty() { "-".into() } else { all.join("; ") }
}

fn has_oracle(rates: &Rates) -> bool {
    rates.groups.iter().any(|row| row.criteria.last().is_some_and(|held_out| held_out.of > 0))
}

/// "42 of 54, 78 % (65-87)", or "n/a".
pub(super) fn share(rate: Rate) -> String {
    if rate.of == 0 {
        return "n/a".into();
    }
    let percent = |share: f64| number(100.0 * share, 0);
    format!(
        "{} of {}, {} % ({}-{})",
        rate.ok,
        rate.of,
        percent(rate.ok as f64 / rate.of as f64),
        percent(rate.low),
        percent(rate.high)
    )
}

fn group_table(rates: &Rates) -> Table {
    let mut table = Table::new(&[
        "group",
        "right",
        "right where the flights show it",
        "all values within 15 %",
        "within 3 stderr",
        "error at most 1.1 of the oracle's",
    ]);
    for row in &rates.groups {
        table.row(std::iter::once(row.group.to_owned()).chain(row.criteria.map(share)).collect());
    }
    table
}

fn verdict_table(rates: &Rates) -> Table {
    let verdicts: Vec<&String> = rates.groups.last().iter().flat_map(|all| all.verdicts.keys()).collect();
    let mut header = vec!["group"];
    header.extend(verdicts.iter().map(|verdict| verdict.as_str()));
    let mut table = Table::new(&header);
    for row in &rates.groups {
        let cells = verdicts
            .iter()
            .map(|verdict| row.verdicts.get(*verdict).map_or_else(|| "-".to_owned(), usize::to_string));
        table.row(std::iter::once(row.group.to_owned()).chain(cells).collect());
    }
    table
}

/// The confusion matrix, a row a hidden effect; of its columns only those that are not empty.
fn confusion_table(rows: &[EffectRow]) -> Table {
    let header = [
        "hidden",
        "cases",
        "right as a whole",
        "by name",
        "in the group of",
        "missed for",
        "wrong beside it",
        "verdicts of the wrong",
    ];
    let mut table = Table::new(&header).left(&[2, 4, 5, 6, 7]);
    for row in rows {
        let mut cells =
            vec![row.effect.clone(), row.cases.to_string(), share(row.right), row.by_name.to_string()];
        cells.extend([&row.in_group, &row.instead, &row.besides, &row.wrong_verdicts].map(tally));
        table.row(cells);
    }
    table
}

/// "gust 2, wind 1".
fn tally(counts: &BTreeMap<String, usize>) -> String {
    let all: Vec<String> = counts
        .iter()
        .map(|(name, count)| format!("{} {count}", if name == "-" { "no name" } else { name }))
        .collect();
    all.join(", ")
}

fn value_table(rows: &[EffectRow]) -> Table {
    let mut table =
        Table::new(&["effect", "values within 15 %", "within 3 stderr", "mean z", "deviation of z"]);
    for row in rows.iter().filter(|row| row.values.near.of > 0) {
        let ValueStatistics { near, within, z_mean, z_deviation } = &row.values;
        table.row(vec![
            row.effect.clone(),
            share(*near),
            share(*within),
            optional(*z_mean, 2),
            optional(*z_deviation, 2),
        ]);
    }
    table
}

fn stratum_table(strata: &[Stratum]) -> Table {
    let mut groups: Vec<Group> = strata.iter().flat_map(|s| s.groups.keys().copied()).collect();
    groups.sort();
    groups.dedup();
    let mut header = vec!["of", ""];
    header.extend(groups.iter().map(|group| group.name()));
    header.push("all");
    let mut table = Table::new(&header).left(&[1]);
    for stratum in strata {
        let mut cells = vec![stratum.kind.to_owned(), stratum.value.clone()];
        cells.extend(
            groups
                .iter()
                .map(|group| stratum.groups.get(group).map_or_else(|| "-".to_owned(), |rate| share(*rate))),
        );
        cells.push(share(stratum.all));
        table.row(cells);
    }
    table
}

/// A row a threshold, with what each factor changes. `None` where no other value was tried.
pub(super) fn sensitivity_table(results: &Results) -> Option<Table> {
    let rows = &results.sensitivity;
    let mut factors: Vec<f64> = rows.iter().map(|row| row.factor).collect();
    factors.sort_by(f64::total_cmp);
    factors.dedup();
    let columns = factors.iter().flat_map(|factor| {
        ["right", "wrong names", "other answers"].map(|column| format!("x{factor}: {column}"))
    });
    let columns: Vec<String> = columns.collect();
    let header = ["threshold", "value"].into_iter().chain(columns.iter().map(String::as_str));
    let mut table = Table::new(&header.collect::<Vec<_>>());
    for (at, first) in rows.iter().enumerate() {
        if rows[..at].iter().any(|row| row.threshold == first.threshold) {
            continue;
        }
        let mut cells = vec![first.threshold.clone(), first.declared.to_string()];
        for factor in &factors {
            let row = rows.iter().find(|row| row.threshold == first.threshold && row.factor == *factor);
            cells.extend(match row {
                Some(row) => [
                    format!("{} of {}", row.right, results.cases.len()),
                    row.wrong_names.to_string(),
                    row.changed.len().to_string(),
                ],
                None => std::array::from_fn(|_| "n/a".to_owned()),
            });
        }
        table.row(cells);
    }
    (!rows.is_empty()).then_some(table)
}

/// Lines about all values and about time.
pub(super) fn summary(rates: &Rates) -> Vec<String> {
    let values = &rates.values;
    vec![
        format!(
            "Values: within 15 % {}; within three standard errors {}; z-scores: mean {}, standard deviation {}.",
            share(values.near),
            share(values.within),
            optional(values.z_mean, 2),
            optional(values.z_deviation, 2)
        ),
        format!(
            "Time of a case: median {} s, worst {} s.",
            optional(rates.median_s, 1),
            optional(rates.worst_s, 1)
        ),
    ]
}

/// Criteria by group: how often each is kept, how often it applies, and the interval.
pub(super) fn totals_json(rates: &Rates) -> Value {
    let criteria = |row: &[Rate; CRITERIA.len()]| {
        CRITERIA.iter().zip(row).map(|(name, rate)| ((*name).to_owned(), json!(rate))).collect::<Map<_, _>>()
    };
    rates
        .groups
        .iter()
        .map(|row| (row.group.to_owned(), Value::Object(criteria(&row.criteria))))
        .collect::<Map<_, _>>()
        .into()
}

/// Error of a case, for a page.
pub(super) fn fault(record: &CaseRecord) -> Option<String> {
    if record.score.criteria.named {
        return None;
    }
    let score = &record.score;
    let missed = score.truth.iter().zip(&score.answers).filter(|(_, answer)| **answer == Answer::Missed);
    let missed: Vec<&str> = missed.map(|(effect, _)| effect.name.as_str()).collect();
    let mut parts = Vec::new();
    parts.extend((!missed.is_empty()).then(|| format!("misses {}", missed.join(", "))));
    parts.extend((!score.extra.is_empty()).then(|| format!("wrongly names {}", score.extra.join(", "))));
    Some(parts.join("; "))
}
