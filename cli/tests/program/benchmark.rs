//! The benchmark on the command line: submit, rank, look at, verify; files that are not ours.

use crate::common::{assert_fails, folder, json, stdout_of, text};
use rusqlite::Connection;
use serde_json::Value;

#[test]
fn from_a_submission_to_a_log_that_replays() {
    let folder = folder("submission");
    let (data, log) = (folder.join("bench.sqlite"), folder.join("flight.csv"));
    let data = text(&data);
    let table = stdout_of(&[
        "bench",
        "submit",
        "--controller",
        "thesis-pid",
        "--scenario",
        "hover-aruco",
        "--data",
        data,
    ]);
    assert!(table.contains("hover-aruco@1.0.0") && table.contains("0 of 24"), "{table}");
    stdout_of(&[
        "bench",
        "submit",
        "--controller",
        "hover",
        "--scenario",
        "hover-aruco@1.0.0",
        "--data",
        data,
    ]);
    let board = json(&["bench", "leaderboard", "--data", data, "--json"]);
    let rows = board["hover-aruco@1.0.0"].as_array().unwrap();
    assert_eq!((rows.len(), &rows[0]["controller"], &rows[1]["rank"]), (2, &"thesis-pid".into(), &2.into()));
    assert!(
        stdout_of(&["bench", "leaderboard", "--data", data, "--scenario", "wind"])
            .contains("no attempts yet")
    );
    let id = rows[0]["attempt"].as_str().unwrap();
    assert_eq!(
        json(&["bench", "attempts", id, "--data", data])["result"]["episodes"].as_array().unwrap().len(),
        24
    );
    assert!(stdout_of(&["bench", "attempts", "--data", data]).contains(id));
    stdout_of(&["bench", "attempts", id, "--data", data, "--episode", "7", "--csv", text(&log)]);
    let back = json(&["replay", text(&log), "--json"]);
    let fit = back["logs"][0]["runs"][0]["signals"]["vx"]["fit_percent"].as_f64().unwrap();
    assert!(fit > 99.0, "the log of a flight without disturbances fits the model that flew it: {fit} %");
    assert!(stdout_of(&["bench", "verify", "--data", data]).matches("confirmed").count() == 2);
    assert_eq!(
        json(&["bench", "verify", id, "--data", data, "--json"])["attempts"][0]["verdict"],
        "confirmed"
    );
    assert_fails(
        2,
        &["bench", "submit", "--controller", "hover", "--scenario", "hoover", "--data", data],
        &["hoover", "hover-aruco@1.0.0"],
    );
    assert_fails(2, &["bench", "verify", "0", "--data", data], &["no attempt \"0\""]);
    let nowhere = folder.join("nowhere.sqlite");
    for command in [
        &["bench", "leaderboard"][..],
        &["bench", "attempts"],
        &["bench", "verify"],
        &["bench", "token", "list"],
    ] {
        assert_fails(
            1,
            &[command, &["--data", text(&nowhere)]].concat(),
            &["nowhere.sqlite", "no such file", "crazyflie bench submit"],
        );
    }
    assert!(!nowhere.exists());
    assert_fails(
        1,
        &["bench", "attempts", id, "--data", data, "--episode", "24", "--csv", text(&log)],
        &["episodes 0 to 23"],
    );
}

#[test]
fn a_row_that_was_changed_is_wrong_and_loses_its_rank() {
    let folder = folder("changed");
    let data = folder.join("bench.sqlite");
    let submit = |controller: &str| {
        stdout_of(&[
            "bench",
            "submit",
            "--controller",
            controller,
            "--scenario",
            "wind",
            "--data",
            text(&data),
            "--json",
        ])
    };
    let (honest, cheat) = (submit("thesis-pid"), submit("hover"));
    let id = |line: &str| {
        serde_json::from_str::<serde_json::Value>(line).unwrap()["id"].as_str().unwrap().to_owned()
    };
    let db = Connection::open(&data).unwrap();
    let better = cheat.trim().replacen("\"score\":0.0", "\"score\":99.0", 1);
    assert_ne!(better, cheat.trim());
    db.execute("UPDATE attempts SET document = ?2 WHERE id = ?1", [&id(&cheat), &better]).unwrap();
    assert_fails(1, &["bench", "verify", "--data", text(&data)], &["1 of 2 attempts are wrong or missing"]);
    let board = stdout_of(&["bench", "leaderboard", "--scenario", "wind", "--data", text(&data)]);
    assert!(board.contains(&id(&honest)) && !board.contains(&id(&cheat)), "{board}");
    assert!(stdout_of(&["bench", "attempts", "--data", text(&data)]).contains("damaged"));
    db.execute("DELETE FROM attempts WHERE id = ?1", [&id(&honest)]).unwrap();
    assert_fails(1, &["bench", "verify", "--data", text(&data)], &["2 of 2 attempts are wrong or missing"]);
}

#[test]
fn other_files_are_refused_and_left_alone() {
    let folder = folder("other_files");
    let open = |name: &str| {
        ["bench".to_owned(), "scenarios".into(), "--data".into(), text(&folder.join(name)).into()]
    };
    let refused = |name: &str, words: &[&str]| {
        let args = open(name);
        assert_fails(1, &args.each_ref().map(String::as_str), words);
    };
    stdout_of(&open("bench.sqlite").each_ref().map(String::as_str));
    let db = Connection::open(folder.join("bench.sqlite")).unwrap();
    db.pragma_update(None, "user_version", 99).unwrap();
    refused("bench.sqlite", &["bench.sqlite", "schema 99 is newer than this program's (2)"]);
    db.pragma_update(None, "user_version", 2).unwrap();
    stdout_of(&open("bench.sqlite").each_ref().map(String::as_str));

    let foreign = Connection::open(folder.join("foreign.sqlite")).unwrap();
    foreign.execute_batch("CREATE TABLE mine (x); INSERT INTO mine VALUES (1)").unwrap();
    std::fs::write(
        folder.join("text.sqlite"),
        "this is no database at all, but a text that is long enough".repeat(40),
    )
    .unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |name: &str, mode| {
            std::fs::set_permissions(folder.join(name), std::fs::Permissions::from_mode(mode)).unwrap()
        };
        assert_eq!(
            std::fs::metadata(folder.join("bench.sqlite")).unwrap().permissions().mode() & 0o777,
            0o600
        );
        mode("bench.sqlite", 0o644);
        refused("bench.sqlite", &["signing key", "mode 644", "chmod 600"]);
        ["foreign.sqlite", "text.sqlite"].iter().for_each(|name| mode(name, 0o600));
    }
    let before = std::fs::read(folder.join("text.sqlite")).unwrap();
    refused("foreign.sqlite", &["foreign.sqlite is a database of another program"]);
    refused("text.sqlite", &["text.sqlite is a database of another program"]);
    assert_eq!(std::fs::read(folder.join("text.sqlite")).unwrap(), before);
    assert_eq!(
        foreign.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0)).unwrap(),
        1
    );
    refused("no/such/folder.sqlite", &["no/such/folder.sqlite", "No such file"]);
}

#[test]
fn several_processes_submit_at_once() {
    let folder = folder("at_once");
    let data = folder.join("bench.sqlite");
    let args = [
        "bench",
        "submit",
        "--controller",
        "hover",
        "--scenario",
        "ground-landing",
        "--repeat",
        "15",
        "--json",
        "--data",
        text(&data),
    ];
    let spawn = |_| {
        std::process::Command::new(crate::common::BINARY)
            .args(args)
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap()
    };
    let all: Vec<_> = (0..4).map(spawn).collect();
    let lines: usize = all
        .into_iter()
        .map(|child| {
            let done = child.wait_with_output().unwrap();
            assert!(done.status.success());
            String::from_utf8(done.stdout).unwrap().lines().count()
        })
        .sum();
    assert_eq!(lines, 60);
    let verified = json(&["bench", "verify", "--data", text(&data), "--json"]);
    let confirmed =
        verified["attempts"].as_array().unwrap().iter().filter(|v| v["verdict"] == "confirmed").count();
    assert_eq!((confirmed, verified["missing"].as_array().unwrap().len()), (60, 0));
}

#[test]
fn tokens_are_shown_once() {
    let folder = folder("tokens");
    let data = folder.join("bench.sqlite");
    let token = |args: &[&str]| stdout_of(&[&["bench", "token"], args, &["--data", text(&data)]].concat());
    let made = token(&["create", "blue"]);
    assert!(made.starts_with("cft_") && made.trim().len() == 68, "{made}");
    assert_ne!(made, token(&["create", "blue"]));
    let list = token(&["list"]);
    assert!(list.matches("blue").count() == 2 && !list.contains(&made.trim()[4..]), "{list}");
    assert_eq!(token(&["revoke", "blue"]), "2 tokens of blue revoked\n");
    let listed = json(&["bench", "token", "list", "--json", "--data", text(&data)]);
    assert!(listed[0]["revoked_ms"].is_i64() && listed[0].get("hash").is_none(), "{listed}");
    assert_fails(1, &["bench", "token", "revoke", "blue", "--data", text(&data)], &["no tokens in force"]);
    assert_fails(2, &["bench", "token", "create", "a b", "--data", text(&data)], &["\"a b\"", "letters"]);
}

#[test]
fn a_controller_behind_the_filter_is_submitted_under_its_name() {
    let data = folder("filtered").join("bench.sqlite");
    // The seeds of an attempt are drawn anew and are nobody's to choose: scores of one attempt differ by 3 or so.
    let mean_score = |name: &str| {
        let lines = stdout_of(&[
            "bench",
            "submit",
            "--controller",
            name,
            "--scenario",
            "hover-aruco",
            "--repeat",
            "5",
            "--data",
            text(&data),
            "--json",
        ]);
        let attempts: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(attempts.len(), 5);
        assert!(attempts.iter().all(|attempt| attempt["controller"] == name));
        attempts.iter().map(|attempt| attempt["result"]["score"]["score"].as_f64().unwrap()).sum::<f64>()
            / 5.0
    };
    let (plain, filtered, lqr) =
        (mean_score("thesis-pid"), mean_score("kalman+thesis-pid"), mean_score("lqr"));
    println!("hover-aruco: thesis-pid {plain:.1}, kalman+thesis-pid {filtered:.1}, lqr {lqr:.1}");
    assert!(filtered > plain + 5.0 && lqr > plain + 5.0);
}

#[test]
fn robustness_flies_everything_under_every_condition() {
    let picture = folder("robustness").join("robustness.svg");
    let args = [
        "robustness",
        "--controllers",
        "thesis-pid,lqr",
        "--scenarios",
        "hover-aruco",
        "--seeds",
        "20",
        "--json",
        "--picture",
        text(&picture),
    ];
    let lines = json(&args);
    let lines = lines.as_array().unwrap();
    assert_eq!(lines.len(), 6);
    for line in lines {
        println!("{line}");
        let (low, score, high) =
            (line["low"].as_f64().unwrap(), line["score"].as_f64().unwrap(), line["high"].as_f64().unwrap());
        assert!(low <= score && score <= high && line["flights"] == 20);
    }
    let of = |name: &str, condition: &str| {
        lines.iter().find(|l| l["controller"] == name && l["condition"] == condition).unwrap()["score"]
            .as_f64()
    };
    assert!(
        of("thesis-pid", "nominal") > of("thesis-pid", "undeclared"),
        "what nobody was told of costs something"
    );
    assert!(of("lqr", "undeclared") > of("thesis-pid", "undeclared"));
    assert_eq!(json(&args), Value::Array(lines.clone()), "the same seeds, the same figures");
    assert_fails(2, &["bench", "robustness", "--scenarios", "mystery"], &["unknown scenario", "hover-aruco"]);
    assert_fails(2, &["bench", "submit", "--controller", "pid:nowhere.json"], &["nowhere.json"]);
}
