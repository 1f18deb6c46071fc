//! Explanations of a small committed set, and what `score` makes of sets that are not whole.
//!
//! The set: all but d14 by the shared generator, d14 by `tests/population`; 17 to 60 s each. They were chosen as
//! cases that are answered rightly, so they hold what is reached and say nothing about rates.

use std::path::{Path, PathBuf};

use crate::common::{assert_fails, folder, json, run, stdout_of, text};
use serde_json::Value;

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/cases")
}

/// A copy of one case of the set, to be broken.
fn copy_case(test: &str, id: &str) -> PathBuf {
    let folder = folder(test);
    for end in [".json", ".answer.json", "_a.csv.gz", "_b.csv.gz"] {
        let name = format!("{id}{end}");
        std::fs::copy(committed().join(&name), folder.join(&name)).unwrap();
    }
    folder
}

#[test]
fn the_committed_cases_are_answered_as_the_readme_says() {
    let saved = folder("score_committed").join("results.json");
    let program = run(&["explain-bench", text(&committed()), "--oracle", "--json", text(&saved)]);
    assert_eq!(program.code, 0, "{}", program.err);
    let results: Value = serde_json::from_str(&std::fs::read_to_string(&saved).unwrap()).unwrap();
    let cases = results["cases"].as_array().unwrap();
    assert!(cases.len() >= 8, "the set is there");
    for case in cases {
        assert_eq!(case["score"]["criteria"]["named"], true, "{case:#}");
        let hidden = case["score"]["truth"].as_array().unwrap().len();
        let answers = case["score"]["answers"].as_array().unwrap();
        assert_eq!(answers.len(), hidden);
        match case["score"]["group"].as_str().unwrap() {
            "null" => assert!(
                case["effects"].as_array().unwrap().is_empty()
                    || !case["score"]["benign"].as_array().unwrap().is_empty()
            ),
            "single" | "compound" => assert!(answers.iter().all(|answer| answer != "missed"), "{case:#}"),
            // a load on a thread has a name here
            _ => assert!(
                case["verdict"] == "unexplained" || answers.iter().all(|answer| answer != "missed"),
                "{case:#}"
            ),
        }
    }
    let rates = &results["rates"];
    let known: usize = rates["groups"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|g| g["group"] != "all")
        .map(|g| g["criteria"][0]["of"].as_u64().unwrap() as usize)
        .sum();
    assert_eq!(known, cases.len());
    assert!(results["totals"]["all"]["named"]["ok"].as_u64().unwrap() as usize == cases.len());
    // the page of rates is made of what was saved, and the guide holds its table of groups
    let page = stdout_of(&["explain-bench", "--from", text(&saved), "--markdown"]);
    assert!(page.contains("## cases: ") && page.contains("A trial run"), "{page}");
    let guide =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/explain.md")).unwrap();
    for group in rates["groups"].as_array().unwrap() {
        let row = format!(
            "| {} | {} of {} |",
            group["group"].as_str().unwrap(),
            group["criteria"][0]["ok"],
            group["criteria"][0]["of"]
        );
        assert!(guide.contains(&row), "the table of the committed cases in docs/explain.md lacks {row:?}");
    }
}

#[test]
fn thresholds_are_varied_one_at_a_time() {
    let cases = copy_case("score_sensitivity", "d00");
    let saved = cases.join("results.json");
    let name = "noise.WORTH_REPORT";
    let args = ["explain-bench", text(&cases), &format!("--sensitivity={name}"), "--json", text(&saved)];
    let program = run(&args);
    assert_eq!(program.code, 0, "{}", program.err);
    let results: Value = serde_json::from_str(&std::fs::read_to_string(&saved).unwrap()).unwrap();
    let rows = results["sensitivity"].as_array().unwrap();
    let factors: Vec<f64> = rows.iter().map(|row| row["factor"].as_f64().unwrap()).collect();
    assert_eq!(factors, [0.7, 1.4]);
    assert!(rows.iter().all(|row| row["threshold"] == name && row["right"] == 1), "{rows:#?}");
    let page = stdout_of(&["explain-bench", "--from", text(&saved), "--markdown"]);
    assert!(page.contains("| noise.WORTH_REPORT | 12 | 1 of 1 | 0 | 0 | 1 of 1 | 0 | 0 |"), "{page}");
    assert_fails(
        2,
        &["explain-bench", text(&cases), "--sensitivity=verdict.WORTH"],
        &["verdict.WORTH", "verdict.WORTH_FIT"],
    );
}

#[test]
fn a_set_that_is_not_whole_is_refused_before_anything_runs() {
    let without_answer = copy_case("score_no_answer", "d00");
    std::fs::remove_file(without_answer.join("d00.answer.json")).unwrap();
    assert_fails(
        1,
        &["explain-bench", text(&without_answer)],
        &["d00.answer.json", "cannot be read", "needs its answer"],
    );

    let cut = copy_case("score_cut", "d00");
    let flight = cut.join("d00_b.csv.gz");
    let bytes = std::fs::read(&flight).unwrap();
    std::fs::write(&flight, &bytes[..bytes.len() / 2]).unwrap();
    assert_fails(1, &["explain-bench", text(&cut)], &["d00_b.csv.gz", "d00 is cut short"]);

    let without_flight = copy_case("score_no_flight", "d00");
    std::fs::remove_file(without_flight.join("d00_a.csv.gz")).unwrap();
    assert_fails(
        1,
        &["explain-bench", text(&without_flight)],
        &["d00_a.csv.gz", "the flight of d00 cannot be read"],
    );

    let odd = copy_case("score_odd", "d00");
    std::fs::write(
        odd.join("d00.answer.json"),
        "{\"group\": \"single\", \"tier\": \"t\", \"effects\": [], \"benign\": []}",
    )
    .unwrap();
    assert_fails(
        1,
        &["explain-bench", text(&odd)],
        &["d00.answer.json", "a single case hides one effect, not 0"],
    );
}

#[test]
fn folders_add_up_and_jobs_change_no_answer() {
    let folder = copy_case("score_twice", "d00");
    let twice =
        json(&["explain-bench", text(&folder), text(&committed()), "--only", "d00", "--jobs", "2", "--json"]);
    let cases = twice["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 2);
    let answer = |case: &Value| (case["verdict"].clone(), case["effects"].clone(), case["score"].clone());
    assert_eq!(answer(&cases[0]), answer(&cases[1]));
    assert_ne!(cases[0]["folder"], cases[1]["folder"]);
    assert_eq!(
        (&twice["run"]["jobs"], &twice["totals"]["null"]["named"]["of"]),
        (&Value::from(2), &Value::from(2))
    );
}

#[test]
fn a_run_that_was_cut_off_goes_on_with_its_rows() {
    let folder = copy_case("score_rows", "d00");
    let rows = folder.join("rows.jsonl");
    let bench = ["explain-bench", text(&folder), "--rows", text(&rows), "--json"];
    let first = json(&bench);
    // as if it was cut off while the next row was being written
    let whole = std::fs::read_to_string(&rows).unwrap();
    std::fs::write(&rows, format!("{whole}{{\"case\": {{\"ca")).unwrap();
    let second = json(&bench);
    assert_eq!(first["cases"], second["cases"], "with the seconds of the first run");
    let kept = std::fs::read_to_string(&rows).unwrap();
    assert!(kept.starts_with(&whole) && kept.lines().count() == 3, "two runs and a case: {kept}");
    assert_fails(
        1,
        &["explain-bench", text(&folder), "--rows", text(&rows), "--oracle"],
        &["rows.jsonl", "another choice of --oracle", "name a new file"],
    );
}

#[test]
fn saved_results_must_be_results() {
    let folder = folder("score_from");
    let file = folder.join("r.json");
    std::fs::write(&file, "{\"cases\": [\n3]}").unwrap();
    assert_fails(1, &["explain-bench", "--from", text(&file)], &["r.json, line 2", "not the results"]);
    assert_fails(1, &["explain-bench", "--from", "no/such.json"], &["no/such.json", "cannot be read"]);
    assert_fails(2, &["explain-bench"], &["<FOLDER>"]);
    assert_fails(2, &["explain-bench", "x", "--from", text(&file)], &["cannot be used with"]);
    assert_fails(2, &["explain-bench", "x", "--json", "--markdown"], &["name a file"]);
    assert_fails(2, &["explain-bench", "x", "--jobs", "0"], &["1..=1024"]);
}
