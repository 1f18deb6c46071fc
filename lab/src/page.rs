//! The page of rates, in Markdown.

use std::collections::BTreeSet;

use crazyflie_picture::Table;

use crate::rates::{Counts, EffectRow, Rate, Rates};
use crate::results::Results;

/// Below so many cases a rate of 97 % is indistinguishable from one of 90 %: Wilson's interval around it is wider
/// than that.
const FEW_CASES: usize = 100;

const HEAD: &str = include_str!("../templates/rates.md");

/// A page about runs.
pub fn page(runs: &[Results]) -> String {
    let mut parts = vec![HEAD.to_owned(), format!("## Runs\n\n{}", run_table(runs))];
    parts.extend(runs.iter().map(section));
    parts.join("\n")
}

fn run_table(runs: &[Results]) -> String {
    Table::from_rows(runs)
        .words("run", title)
        .words("command", |r| format!("`{}`", r.run.command))
        .words("date", |r| format!("{}, version {}", r.run.date, r.run.version))
        .words("machine", |r| format!("{}; {} jobs of {} threads", r.run.machine, r.run.jobs, r.run.threads))
        .words("time of a case: median", |r| {
            format!("{} s, worst {} s", decimals(r.rates.median_s, 1), decimals(r.rates.worst_s, 1))
        })
        .markdown()
}

/// "hidden_flights_seed_9191, 399 cases".
fn title(results: &Results) -> String {
    format!("{}, {} cases", results.folders.join(", "), results.rates.cases)
}

fn section(results: &Results) -> String {
    let rates = &results.rates;
    let criteria = ["right", "right where shown", "15 %", "3 stderr", "error"].into_iter().enumerate();
    let groups = criteria
        .fold(Table::from_rows(&rates.groups).words("hidden", |row| &row.group), |table, (i, header)| {
            table.words(header, |row| share(row.criteria[i]))
        })
        .words("verdicts", |row| tally(&row.verdicts))
        .markdown();
    let mut parts = vec![format!("## {}\n\n{groups}", title(results))];
    if rates.cases < FEW_CASES {
        parts.push(format!("{} cases are too few to judge effects by.\n", rates.cases));
    } else {
        parts.extend([effect_table(&rates.effects), circumstances(rates)]);
    }
    parts.extend((!results.sensitivity.is_empty()).then(|| sensitivity(results)));
    parts.join("\n")
}

fn effect_table(effects: &[EffectRow]) -> String {
    Table::from_rows(effects)
        .words("effect", |row| &row.effect)
        .words("right", |row| share(row.criteria[0]))
        .words("right where shown", |row| share(row.criteria[1]))
        .words("by name", |row| row.by_name)
        .words("in the group of", |row| tally(&row.in_group))
        .words("missed for", |row| tally(&row.instead))
        .words("wrong beside it", |row| tally(&row.besides))
        .words("values: 15 %", |row| share(row.values.near))
        .words("3 stderr", |row| share(row.values.within))
        .words("mean z", |row| decimals(row.values.z_mean, 2))
        .words("deviation of z", |row| decimals(row.values.z_deviation, 2))
        .words("error", |row| share(row.criteria[4]))
        .markdown()
}

/// Lines about all values, and about the rates by tier, excitation and noise.
fn circumstances(rates: &Rates) -> String {
    let values = &rates.values;
    let mut text = format!(
        "- all values: 15 % {}; 3 stderr {}; mean z {}, deviation of z {}\n",
        share(values.near),
        share(values.within),
        decimals(values.z_mean, 2),
        decimals(values.z_deviation, 2)
    );
    for (name, rows) in [("tier", &rates.tiers), ("excitation", &rates.excitations), ("noise", &rates.noises)]
    {
        let right: Vec<String> =
            rows.iter().map(|(value, right)| format!("{value} {}", share(*right))).collect();
        text += &format!("- right by {name}: {}\n", right.join("; "));
    }
    text
}

/// The thresholds that change an answer.
fn sensitivity(results: &Results) -> String {
    let rows = &results.sensitivity;
    let thresholds: BTreeSet<&str> = rows.iter().map(|row| row.threshold.as_str()).collect();
    let factors: BTreeSet<String> = rows.iter().map(|row| row.factor.to_string()).collect();
    let changing = Table::from_rows(rows.iter().filter(|row| !row.changed.is_empty()))
        .words("threshold", |row| &row.threshold)
        .words("value", |row| row.declared)
        .words("factor", |row| row.factor)
        .words("right", |row| share(Rate { ok: row.right, of: results.rates.cases }))
        .words("wrong names", |row| row.wrong_names)
        .words("other answers", |row| row.changed.join(", "));
    format!(
        "Each case is explained anew with each of {} thresholds of the search at {} of its value. \
         These change an answer:\n\n{}",
        thresholds.len(),
        factors.into_iter().collect::<Vec<_>>().join(" and "),
        changing.markdown()
    )
}

/// "42 of 54, 78 % (65-87)", or "-".
fn share(rate: Rate) -> String {
    if rate.of == 0 {
        return "-".into();
    }
    let [low, high] = rate.interval();
    let [percent, low, high] = [rate.ok as f64 / rate.of as f64, low, high].map(|share| 100.0 * share);
    format!("{} of {}, {percent:.0} % ({low:.0}-{high:.0})", rate.ok, rate.of)
}

fn decimals(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// "gust 2, wind 1".
fn tally(counts: &Counts) -> String {
    let all: Vec<String> = counts.iter().map(|(name, count)| format!("{name} {count}")).collect();
    all.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::tests::record;
    use crate::results::Provenance;

    #[test]
    fn a_page_says_what_is_wrong_and_whether_effects_can_be_judged() {
        let results = |count: usize| {
            let mut cases = vec![record("single", &["wind"], true); count];
            cases[0] = record("single", &["wind"], false);
            cases[0].score.extra = vec!["gust".into()];
            Results::new(Provenance::now(1, 1), cases, Vec::new())
        };
        let page = page(&[results(4), results(100)]);
        assert!(
            page.contains("## x, 4 cases") && page.contains("| single | 3 of 4, 75 % (30-95) |"),
            "{page}"
        );
        assert_eq!(page.matches("too few to judge").count(), 1);
        assert!(page.contains("| wind | 99 of 100, 99 % (95-100) | - | 99 |  | gust 1 |  | - |"), "{page}");
        assert!(page.contains("- right by noise: mid 99 of 100, 99 % (95-100)"), "{page}");
    }
}
