//! The scorecard, and the page that holds it.

use std::path::Path;

use crate::common::{folder, json, stdout_of};

#[test]
fn the_page_holds_what_the_program_prints() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/thesis.md");
    let marker = "<!-- scorecard -->";
    let page = std::fs::read_to_string(&path).unwrap_or_default();
    let block = page.split(marker).nth(1).unwrap_or_else(|| {
        panic!(
            "docs/thesis.md lacks the scorecard. Put into it a line {marker:?}, then the output of `crazyflie reproduce thesis --markdown`, then {marker:?}."
        )
    });
    let printed = stdout_of(&["reproduce", "thesis", "--markdown"]);
    assert_eq!(
        block.trim(),
        printed.trim(),
        "the scorecard in docs/thesis.md is not what the program prints: replace it by the output of `crazyflie reproduce thesis --markdown`"
    );
}

#[test]
fn what_the_equations_fix_agrees_exactly() {
    let lines = json(&["reproduce", "thesis", "--json"]);
    let lines = lines.as_array().unwrap();
    let mut exact = 0;
    for line in lines.iter().filter(|line| line["thesis"].as_str().unwrap().contains(" by 5.")) {
        let (value, off) =
            (line["ideal"]["value"].as_f64().unwrap(), line["ideal"]["deviation"].as_f64().unwrap());
        assert!(off.abs() < 1e-4 * value.abs(), "{line}");
        exact += 1;
    }
    assert_eq!(exact, 6);
    for line in lines {
        let (mark, why) = (line["mark"].as_str().unwrap(), line["why"].as_str().unwrap());
        assert!(!mark.contains("differs") || !why.is_empty(), "a deviation without a reason: {line}");
    }
}

#[test]
fn pictures_are_drawn() {
    let folder = folder("scorecard");
    stdout_of(&["reproduce", "thesis", "--picture", crate::common::text(&folder)]);
    for name in ["fly-80cm", "takeoff", "takeoff-thrust", "hover"] {
        let svg = std::fs::read_to_string(folder.join(format!("{name}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("new gains"), "{name}");
    }
}
