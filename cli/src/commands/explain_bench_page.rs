//! The page of rates that `crazyflie explain-bench --markdown` writes.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::Table;
use super::explain_bench_table::{
    LEGEND, SENSITIVITY, fault, rate_tables, sensitivity_table, share, summary,
};
use crate::score::{CaseRecord, Group, Rates, Results};

/// Below so many cases a rate of 97 % cannot be told from one of 90 %: Wilson's interval around it is wider
/// than that.
const FEW_CASES: usize = 100;

/// A page with a section a run.
pub(super) fn page(runs: &[Results]) -> String {
    let mut text = String::from(
        "# How often explanations are right\n\n\
         Made by `crazyflie explain-bench --from RESULTS... --markdown docs/rates.md` from saved results; nobody edits it.\n\
         Each section is a run over cases of one simulator, none of which shares code with this one:\n\
         `hidden_flights.py population FOLDER --cases N --seed S` (a rigid body of its own) and\n\
         `python tests/population FOLDER --cases N --seed S` (rotorpy's Crazyflie under a firmware-like cascade, whose rotor drag,\n\
         motor lag and exact geometry are missing from every declared model: naming them is right, but not asked for).\n\n",
    );
    let _ = writeln!(text, "{}\n", LEGEND.replace('\n', " "));
    if runs.len() > 1 {
        let _ =
            writeln!(text, "## Runs\n\nRight answers by what is hidden.\n\n{}", run_table(runs).markdown());
    }
    for results in runs {
        write_section(&mut text, results);
    }
    text.truncate(text.trim_end().len());
    text.push('\n');
    text
}

/// A row a run: right answers of each group that any run has, and of all.
fn run_table(runs: &[Results]) -> Table {
    let records = runs.iter().flat_map(|results| &results.cases);
    let groups: BTreeSet<Group> = records.map(|record| record.score.group).collect();
    let groups: Vec<&str> = groups.into_iter().map(Group::name).chain(["all"]).collect();
    let mut table = Table::new(&[&["run", "date"], &groups[..]].concat()).left(&[1]);
    for results in runs {
        let rates = Rates::from_records(&results.cases);
        let right = |group: &&str| {
            let row = rates.groups.iter().find(|row| row.group == *group);
            row.map_or_else(|| "-".to_owned(), |row| share(row.criteria[0]))
        };
        let about = [results.folders().join(", "), results.run.date.clone()];
        table.row(about.into_iter().chain(groups.iter().map(right)).collect());
    }
    table
}

fn write_section(text: &mut String, results: &Results) {
    let rates = Rates::from_records(&results.cases);
    let run = &results.run;
    let _ = writeln!(text, "## {}: {} cases\n", results.folders().join(", "), rates.cases);
    if rates.cases < FEW_CASES {
        let _ = writeln!(text, "**A trial run: {} cases are too few to judge rates by.**\n", rates.cases);
    }
    let _ = writeln!(
        text,
        "`{}`, version {}, {}, {}; {} jobs of {} threads; {}.\n",
        run.command,
        run.version,
        run.date,
        run.machine,
        run.jobs,
        run.threads,
        seeds(&results.cases)
    );
    for (title, table) in rate_tables(&rates) {
        let _ = writeln!(text, "### {title}\n\n{}", table.markdown());
    }
    let _ = writeln!(text, "{}\n", summary(&rates).join(" "));
    if let Some(table) = sensitivity_table(results) {
        let right = rates.groups.last().map_or(0, |all| all.criteria[0].ok);
        let _ = writeln!(
            text,
            "### {SENSITIVITY}\n\nWith the declared values {right} of {} are right. Every case is explained anew.\n\n{}",
            rates.cases,
            table.markdown()
        );
    }
    let wrong = wrong_table(&results.cases);
    if let Some(table) = wrong {
        let _ = writeln!(text, "### Wrong answers\n\n{}", table.markdown());
    }
}

/// "seed 7" or "seeds 7, 8".
fn seeds(records: &[CaseRecord]) -> String {
    let all: BTreeSet<u64> = records.iter().filter_map(|record| record.score.seed).collect();
    let names: Vec<String> = all.iter().map(u64::to_string).collect();
    match names.len() {
        0 => "seeds unknown".into(),
        1 => format!("seed {}", names[0]),
        _ => format!("seeds {}", names.join(", ")),
    }
}

/// Cases that are answered wrongly, with their circumstances; `None` where there is none.
fn wrong_table(records: &[CaseRecord]) -> Option<Table> {
    let mut table =
        Table::new(&["case", "group", "tier", "excitation", "noise", "truth", "verdict", "fault"])
            .left(&[1, 2, 3, 4, 5, 6, 7]);
    let mut wrong = 0;
    for record in records {
        let Some(fault) = fault(record) else { continue };
        let score = &record.score;
        let truth: Vec<&str> = score.truth.iter().map(|effect| effect.name.as_str()).collect();
        let about = [
            record.case.as_str(),
            score.group.name(),
            &score.tier,
            &score.excitation,
            &score.noise,
            &truth.join(", "),
            &record.verdict,
        ];
        table.row(about.map(str::to_owned).into_iter().chain([fault]).collect());
        wrong += 1;
    }
    (wrong > 0).then_some(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn results(cases: usize) -> Results {
        let case = |at: usize| {
            serde_json::json!({"case": format!("d{at}"), "folder": "pop", "verdict": "explained", "seconds": 2.0,
            "score": {"group": "single", "tier": "linear", "excitation": "mix", "noise": "mid", "seed": 5, "extra": if at == 0 { vec!["gust"] } else { vec![] },
            "truth": [{"name": "wind", "params": {}}], "answers": [if at == 0 { "missed" } else { "by_name" }],
            "criteria": {"named": at > 0, "15 %": null, "3 stderr": null, "held-out error": null}}})
        };
        let cases: Vec<_> = (0..cases).map(case).collect();
        serde_json::from_value(serde_json::json!({"cases": cases})).unwrap()
    }

    #[test]
    fn a_page_says_what_is_wrong_and_whether_it_is_only_a_trial() {
        let page = page(&[results(4), results(100)]);
        assert!(
            page.contains("## pop: 4 cases") && page.contains("| single | 3 of 4, 75 % (30-95) |"),
            "{page}"
        );
        assert!(
            page.contains("| wind | 4 | 3 of 4, 75 % (30-95) | 3 |  | gust 1 |  | explained 1 |"),
            "{page}"
        );
        assert!(
            page.contains(
                "| d0 | single | linear | mix | mid | wind | explained | misses wind; wrongly names gust |"
            ),
            "{page}"
        );
        assert_eq!(page.matches("A trial run").count(), 1);
        assert!(
            page.contains("| run | date | single | all |") && page.contains("| pop |  | 99 of 100"),
            "{page}"
        );
        assert!(page.contains("seed 5") && page.contains("99 of 100, 99 % (95-100)"), "{page}");
    }
}
