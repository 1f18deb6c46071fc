//! `crazyflie bench submit --server`: the program as a client of another one, over real sockets, in the clear
//! and over TLS.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::common::{BINARY, folder, json, stdout_of, text};
use crate::contest::settings;
use crate::net::Server;
use crazyflie_server::serve::{self, Settings};
use serde_json::Value;

struct TestSetup {
    folder: PathBuf,
    data: PathBuf,
    token: String,
}

fn setup(test: &str) -> TestSetup {
    let folder = folder(test);
    let data = folder.join("bench.sqlite");
    let token = json(&["bench", "token", "create", "team-a", "--data", text(&data), "--json"])["token"]
        .as_str()
        .unwrap()
        .to_owned();
    std::fs::write(folder.join("token.txt"), format!("{token}\n")).unwrap();
    TestSetup { folder, data, token }
}

impl TestSetup {
    fn serve(&self) -> Server {
        Server::start(settings(&self.data))
    }

    fn token_file(&self) -> PathBuf {
        self.folder.join("token.txt")
    }

    /// Runs `submit --server`; its output must never contain the token.
    fn submit(&self, url: &str, args: &[&str], env: &[(&str, &Path)]) -> (Option<i32>, String) {
        let mut command = Command::new(BINARY);
        command
            .args(["bench", "submit", "--server", url])
            .args(args)
            .env_remove("CRAZYFLIE_TOKEN")
            .envs(env.iter().copied());
        let Output { status, stdout, stderr } = command.output().unwrap();
        let output = String::from_utf8([stdout, stderr].concat()).unwrap();
        assert!(
            !output.contains(&self.token) && !output.contains(&self.token[4..]),
            "the token is told: {output}"
        );
        (status.code(), output)
    }
}

#[test]
fn a_built_in_controller_competes_over_the_network() {
    let setup = setup("afar");
    let server = setup.serve();
    let url = format!("ws://{}", server.address);
    let file = setup.token_file();
    let (code, output) = setup.submit(
        &url,
        &["--controller", "thesis-pid", "--scenario", "takeoff", "--token-file", text(&file), "--json"],
        &[],
    );
    assert_eq!(code, Some(0), "{output}");
    let document: Value = serde_json::from_str(&output).unwrap();
    assert_eq!((&document["team"], &document["controller"]), (&"team-a".into(), &"thesis-pid".into()));
    let id = document["id"].as_str().unwrap();
    let board: Value = serde_json::from_str(&server.get("/api/v1/leaderboard?scenario=takeoff")).unwrap();
    assert_eq!((&board[0]["attempt"], &board[0]["team"]), (&id.into(), &"team-a".into()), "{board}");
    assert!(stdout_of(&["bench", "verify", id, "--data", text(&setup.data)]).contains("confirmed"));
    // the seeds differ, the controller does not: it was told when to take off, and scores as it does beside
    // the database
    let beside = folder("afar-beside").join("bench.sqlite");
    let here: Value = json(&[
        "bench",
        "submit",
        "--controller",
        "thesis-pid",
        "--scenario",
        "takeoff",
        "--data",
        text(&beside),
        "--json",
    ]);
    let score = |document: &Value| document["result"]["score"]["score"].as_f64().unwrap();
    println!(
        "thesis-pid at takeoff: {:.2} over the network, {:.2} beside the database",
        score(&document),
        score(&here)
    );
    assert!(score(&here) > 1.0 && (score(&document) / score(&here) - 1.0).abs() < 0.1);
    // the same by the environment and by the command line, at every scenario that the server has
    let token = Path::new(&setup.token);
    let (code, output) =
        setup.submit(&url, &["--controller", "hover", "--new-entry"], &[("CRAZYFLIE_TOKEN", token)]);
    assert!(
        code == Some(0) && output.lines().filter(|line| line.contains("@1.0.0")).count() == 15,
        "{output}"
    );
    // a team, whose drones keep out of each other's way
    let (code, output) = setup.submit(
        &url,
        &[
            "--controller",
            "lqr",
            "--collision-avoidance",
            "--new-entry",
            "--scenario",
            "swap-eight",
            "--token-file",
            text(&file),
            "--json",
        ],
        &[],
    );
    assert_eq!(code, Some(0), "{output}");
    let team: Value = serde_json::from_str(&output).unwrap();
    // 192 drones fly on seeds that are secret and new each time; without the layer most of them collide
    let collisions = team["result"]["metrics"]["collisions"].as_u64().unwrap();
    assert!(team["controller"] == "avoid+lqr" && collisions <= 8, "{collisions}");
    let (code, output) = setup.submit(
        &url,
        &["--controller", "random", "--new-entry", "--scenario", "wind@1.0.0", "--token", &setup.token],
        &[],
    );
    assert!(code == Some(0) && output.contains("wind@1.0.0"), "{output}");
    let confirmed = stdout_of(&["bench", "verify", "--data", text(&setup.data)]).matches("confirmed").count();
    println!("{confirmed} attempts from afar confirmed");
    assert_eq!(confirmed, 18);
    server.stop();
}

#[test]
fn what_goes_wrong_is_said() {
    let setup = setup("afar-wrong");
    let server = setup.serve();
    let url = format!("ws://{}", server.address);
    let token = [("CRAZYFLIE_TOKEN", Path::new(&setup.token))];
    let hover = ["--controller", "hover", "--scenario", "wind"];
    let says = |args: &[&str], env: &[(&str, &Path)], url: &str, want: (i32, &[&str])| {
        let (code, output) = setup.submit(url, args, env);
        assert!(
            code == Some(want.0)
                && want.1.iter().all(|word| output.contains(word))
                && !output.contains("panicked"),
            "{code:?} {output}"
        );
    };
    says(&hover, &[], &url, (2, &["--token-file", "CRAZYFLIE_TOKEN"]));
    says(&hover, &[("CRAZYFLIE_TOKEN", Path::new("cft_00"))], &url, (1, &["not valid"]));
    says(&[&hover[..], &["--token-file", "no-such-file"]].concat(), &[], &url, (1, &["no-such-file"]));
    says(&["--controller", "hover", "--scenario", "wnd"], &token, &url, (2, &["wnd", "wind@1.0.0"]));
    says(&[&hover[..], &["--data", "x.sqlite"]].concat(), &token, &url, (2, &["--data"]));
    says(&hover, &token, "http://127.0.0.1:1", (2, &["expected ws://"]));
    says(&hover, &token, "ws://me:secret@127.0.0.1:1", (2, &["without a user"]));
    says(&hover, &token, "ws://127.0.0.1:1", (1, &["127.0.0.1:1", "refused"]));
    says(&hover, &token, &format!("ws://{}/live", server.address), (1, &["/live"]));
    let plain = Server::start(Settings::default());
    says(&hover, &token, &format!("ws://{}", plain.address), (1, &["no benchmark"]));
    plain.stop();
    server.stop();
}

#[test]
fn over_tls_it_is_the_same() {
    let setup = setup("afar-tls");
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let (cert, key) = (setup.folder.join("cert.pem"), setup.folder.join("key.pem"));
    std::fs::write(&cert, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let tls = Some(serve::tls(&cert, &key).unwrap());
    let server = Server::start(Settings { tls, ..settings(&setup.data) });
    let url = format!("wss://localhost:{}", server.address.port());
    let file = setup.token_file();
    let args = ["--controller", "hover", "--scenario", "wind", "--token-file", text(&file)];
    let (code, output) = setup.submit(&url, &args, &[("SSL_CERT_FILE", &cert)]);
    assert!(code == Some(0) && output.contains("wind@1.0.0"), "{output}");
    // a client that does not trust the certificate does not send its token
    let (code, output) = setup.submit(&url, &args, &[]);
    assert!(code == Some(1) && output.to_lowercase().contains("certificate"), "{output}");
    assert_eq!(stdout_of(&["bench", "verify", "--data", text(&setup.data)]).matches("confirmed").count(), 1);
    server.stop();
}
