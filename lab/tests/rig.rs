//! Explanations of a small committed set, what the rig makes of sets that are not whole, and the page of rates.
//!
//! The set: all but d14 by the shared generator, d14 by `tests/population`; 17 to 60 s each. They were chosen as
//! cases that are answered rightly, so they show what is reached but no rates.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn committed() -> PathBuf {
    root().join("tests/data/cases")
}

/// Runs the rig to its end: exit code, standard output and standard error.
fn run<T: AsRef<std::ffi::OsStr>>(args: &[T]) -> (i32, String, String) {
    let program = Command::new(env!("CARGO_BIN_EXE_lab")).args(args).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (program.status.code().expect("no signal"), text(program.stdout), text(program.stderr))
}

fn stdout_of<T: AsRef<std::ffi::OsStr>>(args: &[T]) -> String {
    let (code, out, err) = run(args);
    assert_eq!(code, 0, "{err}");
    out
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&stdout_of(args)).unwrap()
}

/// Checks that the rig ends with this code and prints all of these words.
fn assert_fails(code: i32, args: &[&str], words: &[&str]) {
    let (ended, _, err) = run(args);
    assert!(ended == code && !err.contains("panicked"), "{args:?}: {ended}: {err}");
    for word in words {
        assert!(err.contains(word), "{args:?} does not say {word:?}:\n{err}");
    }
}

/// A folder of this test's own, empty.
fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
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

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn the_page_of_rates_is_what_the_rig_writes_from_the_saved_rates() {
    let page = stdout_of(&[Path::new("--from"), &root().join("docs/rates/rates.json")]);
    let written = std::fs::read_to_string(root().join("docs/rates.md")).unwrap();
    assert!(page == written, "docs/rates.md is stale: its head says how it is made");
}

#[test]
fn the_committed_cases_are_answered_as_the_readme_says() {
    let saved = folder("committed").join("results.json");
    stdout_of(&[text(&committed()), "--oracle", "--json", text(&saved)]);
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
    // the page is made of what was saved, and the guide holds its table of groups
    let page = stdout_of(&["--from", text(&saved)]);
    assert!(page.contains(&format!("## cases, {} cases", cases.len())) && page.contains("too few"), "{page}");
    let guide = std::fs::read_to_string(root().join("docs/explain.md")).unwrap();
    let groups = results["rates"]["groups"].as_array().unwrap();
    assert_eq!(groups.last().unwrap()["criteria"][0]["ok"], cases.len());
    for group in groups {
        let (right, name) = (&group["criteria"][0], group["group"].as_str().unwrap());
        let row = format!("| {name} | {} of {} |", right["ok"], right["of"]);
        assert!(guide.contains(&row), "the table of the committed cases in docs/explain.md lacks {row:?}");
    }
}

#[test]
fn thresholds_are_varied_one_at_a_time() {
    let cases = copy_case("sensitivity", "d00");
    let saved = cases.join("results.json");
    let name = "noise.WORTH_REPORT";
    stdout_of(&[text(&cases), &format!("--sensitivity={name}"), "--json", text(&saved)]);
    let results: Value = serde_json::from_str(&std::fs::read_to_string(&saved).unwrap()).unwrap();
    let rows = results["sensitivity"].as_array().unwrap();
    let factors: Vec<f64> = rows.iter().map(|row| row["factor"].as_f64().unwrap()).collect();
    assert_eq!(factors, [0.7, 1.4]);
    assert!(rows.iter().all(|row| row["threshold"] == name && row["right"] == 1), "{rows:#?}");
    let page = stdout_of(&["--from", text(&saved)]);
    assert!(page.contains("each of 1 thresholds of the search at 0.7 and 1.4 of its value"), "{page}");
    assert_fails(1, &[text(&cases), "--sensitivity=verdict.WORTH"], &["verdict.WORTH", "verdict.WORTH_FIT"]);
}

#[test]
fn a_set_that_is_not_whole_is_refused_before_anything_runs() {
    let without_answer = copy_case("no_answer", "d00");
    std::fs::remove_file(without_answer.join("d00.answer.json")).unwrap();
    assert_fails(1, &[text(&without_answer)], &["d00.answer.json", "cannot be read", "needs its answer"]);

    let cut = copy_case("cut", "d00");
    let flight = cut.join("d00_b.csv.gz");
    let bytes = std::fs::read(&flight).unwrap();
    std::fs::write(&flight, &bytes[..bytes.len() / 2]).unwrap();
    let unreadable = "the flight of d00 cannot be read";
    assert_fails(1, &[text(&cut)], &["d00_b.csv.gz", unreadable]);
    std::fs::write(&flight, "").unwrap();
    assert_fails(1, &[text(&cut)], &["d00_b.csv.gz", unreadable]);

    let without_flight = copy_case("no_flight", "d00");
    std::fs::remove_file(without_flight.join("d00_a.csv.gz")).unwrap();
    assert_fails(1, &[text(&without_flight)], &["d00_a.csv.gz", unreadable]);

    let odd = copy_case("odd", "d00");
    let answer = r#"{"group": "single", "tier": "t", "effects": [], "benign": []}"#;
    std::fs::write(odd.join("d00.answer.json"), answer).unwrap();
    assert_fails(1, &[text(&odd)], &["d00.answer.json", "a single case hides one effect, not 0"]);
}

#[test]
fn folders_without_cases_and_cases_that_are_none_are_refused() {
    let folder = folder("bad");
    assert_fails(1, &[text(&folder)], &["holds no case files"]);
    assert_fails(1, &["no/such"], &["no/such"]);
    std::fs::write(folder.join("d07.json"), "{}").unwrap();
    assert_fails(1, &[text(&folder), "--only", "d70"], &["unknown case \"d70\"", "did you mean \"d07\""]);
    assert_fails(1, &[text(&folder)], &["d07.json", "not a case file"]);
}

#[test]
fn folders_add_up_and_jobs_change_no_answer() {
    let folder = copy_case("twice", "d00");
    let twice = json(&[text(&folder), text(&committed()), "--only", "d00", "--jobs", "2", "--json"]);
    let cases = twice["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 2);
    let answer = |case: &Value| (case["verdict"].clone(), case["effects"].clone(), case["score"].clone());
    assert_eq!(answer(&cases[0]), answer(&cases[1]));
    assert_eq!(twice["folders"], serde_json::json!(["twice", "cases"]));
    assert_eq!((&twice["run"]["jobs"], &twice["rates"]["cases"]), (&Value::from(2), &Value::from(2)));
}

#[test]
fn a_run_that_was_cut_off_goes_on_with_its_rows() {
    let folder = copy_case("rows", "d00");
    let rows = folder.join("rows.jsonl");
    let bench = [text(&folder), "--rows", text(&rows), "--json"];
    let first = json(&bench);
    // the run is cut off in the middle of the next row
    let whole = std::fs::read_to_string(&rows).unwrap();
    std::fs::write(&rows, format!("{whole}{{\"case\": \"d")).unwrap();
    let second = json(&bench);
    assert_eq!(first["cases"], second["cases"], "with the seconds of the first run");
    assert_eq!(std::fs::read_to_string(&rows).unwrap(), whole);
    assert_fails(
        1,
        &[text(&folder), "--rows", text(&rows), "--oracle"],
        &["rows.jsonl", "choice of --oracle", "name a new file"],
    );
}

#[test]
fn saved_results_must_be_results() {
    let file = folder("from").join("r.json");
    std::fs::write(&file, "{\"cases\": [\n3]}").unwrap();
    assert_fails(1, &["--from", text(&file)], &["r.json: not the results", "missing field"]);
    assert_fails(1, &["--from", "no/such.json"], &["no/such.json"]);
    assert_fails(2, &[], &["<FOLDER>"]);
    assert_fails(2, &["x", "--from", text(&file)], &["cannot be used with"]);
    assert_fails(2, &["x", "--jobs", "0"], &["1..=1024"]);
}
