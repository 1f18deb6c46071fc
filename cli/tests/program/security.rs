//! Access: TLS off loopback, origins, handshakes; and that secrets stay secret.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use crate::common;
use crate::net::{PATIENCE, Server, eventually, le, request};
use crate::process::Process;
use crazyflie_server::serve::{self, Limits, ServeError, Settings};
use serde_json::{Value, json};
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::client::IntoClientRequest;

#[test]
fn off_this_machine_only_with_tls() {
    let words = ["0.0.0.0:8765", "--tls-cert", "127.0.0.1"];
    crate::common::assert_fails(2, &["serve", "--listen", "0.0.0.0:8765"], &words);
    crate::common::assert_fails(2, &["serve", "--listen", "[::]:8765"], &["--tls-cert"]);
    crate::common::assert_fails(2, &["serve", "--tls-cert", "cert.pem"], &["--tls-key"]);
    crate::common::assert_fails(1, &["serve", "--tls-cert", "no.pem", "--tls-key", "no.pem"], &["no.pem"]);
    crate::common::assert_fails(2, &["serve", "--allow-origin", "*"], &["origin", "https://example.org"]);
    let anywhere: SocketAddr = "192.0.2.1:1".parse().unwrap();
    assert!(matches!(Settings::default().check(anywhere), Err(ServeError::TlsRequired(_))));
    assert!(Settings::default().check("[::1]:1".parse().unwrap()).is_ok());
}

/// A certificate for `localhost`, signed by itself, and the settings with it.
fn with_tls(limits: Limits) -> (Settings, CertificateDer<'static>) {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let folder = crate::common::folder("tls");
    let (cert, key) = (folder.join("cert.pem"), folder.join("key.pem"));
    std::fs::write(&cert, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    crate::common::assert_fails(
        1,
        &["serve", "--tls-cert", crate::common::text(&key), "--tls-key", crate::common::text(&cert)],
        &["PEM"],
    );
    (
        Settings { tls: Some(serve::tls(&cert, &key).unwrap()), limits, ..Settings::default() },
        made.cert.der().clone(),
    )
}

#[test]
fn over_tls_it_is_the_same_protocol() {
    let (settings, cert) = with_tls(Limits::default());
    assert!(settings.check("192.0.2.1:1".parse().unwrap()).is_ok());
    let server = Server::start(settings);
    let mut roots = RootCertStore::empty();
    roots.add(cert).unwrap();
    let provider = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let config = Arc::new(config.with_root_certificates(roots).with_no_client_auth());
    let connection = ClientConnection::new(config, "localhost".try_into().unwrap()).unwrap();
    let stream = StreamOwned::new(connection, TcpStream::connect(server.address).unwrap());
    let mut asked = format!("wss://localhost:{}/ws", server.address.port()).into_client_request().unwrap();
    asked.headers_mut().insert("sec-websocket-protocol", "crazyflie.v1".parse().unwrap());
    let (mut ws, _) = tungstenite::client(asked, stream).unwrap();
    ws.send(tungstenite::Message::text(json!({"id": 1, "type": "make", "num_envs": 512}).to_string()))
        .unwrap();
    assert!(ws.read().unwrap().to_text().unwrap().contains("made"));
    ws.send(tungstenite::Message::binary(request(2, 1, 0, 0, 512, &[]))).unwrap();
    assert_eq!(ws.read().unwrap().len(), 32 + 512 * 96);
    ws.send(tungstenite::Message::binary(request(3, 2, 0, 1, 512, &le(&[0.0; 2048])))).unwrap();
    assert_eq!(ws.read().unwrap().len(), 32 + 512 * 102);
    // in the clear there is nothing to hear, and nobody may wait for ever
    let server = Server::start(
        with_tls(Limits { handshake_timeout: Duration::from_millis(500), ..Limits::default() }).0,
    );
    let (mut plain, mut silent) =
        (TcpStream::connect(server.address).unwrap(), TcpStream::connect(server.address).unwrap());
    plain.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
    for stream in [&mut plain, &mut silent] {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut output = vec![];
        let ended = stream.read_to_end(&mut output);
        assert!(!ended.is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock), "it waits for ever");
        assert!(!String::from_utf8_lossy(&output).contains("HTTP"));
    }
}

/// A certificate as `openssl req -x509` makes it: of an authority.
#[test]
fn a_certificate_of_an_authority_is_refused_with_what_to_do() {
    let folder = common::folder("authority");
    let mut params = rcgen::CertificateParams::new(vec!["localhost".into()]).unwrap();
    params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let key = rcgen::KeyPair::generate().unwrap();
    let cert = params.self_signed(&key).unwrap();
    let (cert_file, key_file) = (folder.join("cert.pem"), folder.join("key.pem"));
    std::fs::write(&cert_file, cert.pem()).unwrap();
    std::fs::write(&key_file, key.serialize_pem()).unwrap();
    let tls = Some(serve::tls(&cert_file, &key_file).unwrap());
    let server = Server::start(Settings { tls, ..Settings::default() });
    let url = format!("wss://localhost:{}", server.address.port());
    let join = |trusted: Option<&std::path::Path>| {
        let mut command = std::process::Command::new(common::BINARY);
        command.args(["world", "join", "--server", &url, "--world", "x"]).env_remove("SSL_CERT_FILE");
        trusted.map(|file| command.env("SSL_CERT_FILE", file));
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    for trusted in [None, Some(&*cert_file)] {
        let words = join(trusted);
        assert!(words.contains("basicConstraints=critical,CA:FALSE"), "{words}");
    }
}

/// The options of OpenSSL in `serve --help`, word for word.
#[test]
fn the_recipe_for_a_certificate_works() {
    let folder = common::folder("recipe");
    let help = common::stdout_of(&["serve", "--help"]);
    let recipe = help.split_once("openssl req").expect("a recipe").1.split("\nClients").next().unwrap();
    let recipe = format!("openssl req{recipe}").replace("lab.example", "localhost").replace("\\\n", " ");
    let made = std::process::Command::new("sh").args(["-c", &recipe]).current_dir(&folder).output();
    let Ok(made) = made else { return println!("the recipe is not checked: this machine has no openssl") };
    assert!(made.status.success(), "{recipe}: {}", String::from_utf8_lossy(&made.stderr));
    let process = Process::start(&[
        "--tls-cert",
        common::text(&folder.join("cert.pem")),
        "--tls-key",
        common::text(&folder.join("key.pem")),
    ]);
    let output = std::process::Command::new(common::BINARY)
        .args([
            "world",
            "join",
            "--server",
            &format!("wss://localhost:{}", process.address.port()),
            "--world",
            "x",
        ])
        .env("SSL_CERT_FILE", folder.join("cert.pem"))
        .output()
        .unwrap();
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(words.contains("there is no world"), "the server must be reached: {words}");
}

#[test]
fn a_host_may_be_named_and_is_named_back() {
    let mut serve = std::process::Command::new(common::BINARY);
    serve.args(["serve", "--listen", "localhost:0", "--log", "error"]);
    #[cfg(feature = "bench")]
    serve.arg("--data").arg(common::folder("named").join("bench.sqlite"));
    let mut child = serve.stdout(std::process::Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    std::io::BufRead::read_line(&mut io::BufReader::new(child.stdout.take().unwrap()), &mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(line.starts_with("listening on 127.0.0.1:") || line.starts_with("listening on [::1]:"), "{line}");
    common::assert_fails(2, &["serve", "--listen", "nowhere"], &["nowhere", "a host and a port"]);
}

/// A page whose name leads here (DNS rebinding) is no page of ours.
#[test]
fn requests_for_other_hosts_are_turned_away() {
    let server = Server::start(Settings::default());
    for (host, want) in [("evil.example", "421"), ("localhost:1", "200"), ("127.0.0.1", "200")] {
        let mut stream = TcpStream::connect(server.address).unwrap();
        write!(stream, "GET /api/v1/sessions HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with(&format!("HTTP/1.1 {want}")), "{host}: {answer}");
    }
}

/// The status of the answer to a handshake with these header lines.
fn status(server: &Server, path: &str, lines: &str) -> u16 {
    ask_status(server, path, lines).unwrap()
}

/// Requests like [`status`]. A server that closes before it has read all resets the connection, and its answer may be
/// lost with it.
fn ask_status(server: &Server, path: &str, lines: &str) -> io::Result<u16> {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{lines}\r\n", server.address);
    stream.write_all(request.as_bytes())?;
    let mut head = [0; 12];
    stream.read_exact(&mut head)?;
    Ok(std::str::from_utf8(&head[9..]).unwrap().parse().unwrap())
}

#[test]
fn strange_pages_and_broken_handshakes_are_turned_away() {
    let server =
        Server::start(Settings { origins: vec!["https://lab.example".into()], ..Settings::default() });
    let good = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let own = format!("Origin: http://{}\r\n", server.address);
    let local = format!("Origin: http://localhost:{}\r\n", server.address.port());
    for path in ["/ws", "/live"] {
        for origin in ["", &own, &local, "Origin: https://lab.example\r\n"] {
            assert_eq!(status(&server, path, &format!("{good}{origin}")), 101, "{path} {origin}");
        }
        for origin in [
            "https://evil.example",
            "null",
            "http://localhost:1",
            "https://lab.example.evil.example",
            "http://127.0.0.1",
        ] {
            assert_eq!(status(&server, path, &format!("{good}Origin: {origin}\r\n")), 403, "{path} {origin}");
        }
    }
    for (lines, why) in [
        (good.replace("Connection: Upgrade\r\n", ""), "no Connection"),
        (good.replace("Upgrade: websocket\r\n", ""), "no Upgrade"),
        (good.replace("13", "8"), "an old version"),
        (good.replace("Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n", ""), "no key"),
        (format!("{good}Sec-WebSocket-Protocol: chess, crazyflie.v9\r\n"), "a protocol that is not spoken"),
        (String::new(), "no handshake at all"),
    ] {
        assert_eq!(status(&server, "/ws", &lines), 400, "{why}");
    }
    assert_eq!(
        status(&server, "/ws", &format!("{good}Sec-WebSocket-Protocol: chess, crazyflie.v1\r\n")),
        101
    );
    assert_eq!(status(&server, "/nothing", ""), 404);
    let long = format!("X-Long: {}\r\n", "x".repeat(20_000));
    let answered = (0..20).find_map(|_| ask_status(&server, "/healthz", &long).ok());
    assert_eq!(answered, Some(431));
    assert_eq!(server.metric("crazyflie_connections_refused_total{reason=\"origin\"}"), 10.0);
}

#[test]
fn the_log_is_json_says_how_sessions_end_and_no_secrets() {
    let path = crate::common::folder("log").join("log.jsonl");
    let process =
        Process::start_logging(&["--log", "trace", "--log-json"], File::create(&path).unwrap().into());
    let mut client = process.client();
    let secret = "team-token-that-nobody-may-read";
    client.ask(&json!({"id": 1, "type": "hello", "token": secret, "client": "a test"}));
    let made = client.ask(&json!({"id": 2, "type": "make"}));
    let mut other = process.client();
    other.ask(&json!({"id": 1, "type": "resume", "session": made["session"], "token": "a-wrong-guess"}));
    other.ask(&json!({"id": 1, "type": "resume", "session": made["session"], "token": made["token"]}));
    other.ask(&json!({"id": 2, "type": "nonsense"}));
    other.ask(&json!({"id": 3, "type": "close"}));
    process.terminate();
    let log = std::fs::read_to_string(&path).unwrap();
    for secret in [secret, made["token"].as_str().unwrap(), "a-wrong-guess"] {
        assert!(!log.contains(secret), "a secret in the log");
    }
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    let messages: Vec<&str> = lines.iter().filter_map(|line| line["fields"]["message"].as_str()).collect();
    for message in [
        "listening",
        "connected",
        "hello",
        "session began",
        "session resumed",
        "session ended",
        "stopping",
        "stopped",
    ] {
        assert!(messages.contains(&message), "the log does not say {message:?}:\n{log}");
    }
    let ended = lines.iter().find(|line| line["fields"]["message"] == "session ended").unwrap();
    assert_eq!((&ended["fields"]["end"], &ended["fields"]["session"]), (&json!("Closed"), &json!(1)));
}

#[test]
fn metrics_count_what_happened() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    client.ask(&json!({"id": 1, "type": "make", "num_envs": 7}));
    client.ask_binary(request(2, 1, 0, 0, 7, &[]));
    let step = request(3, 2, 0, 5, 7, &le(&[0.0; 140]));
    client.ask_binary(step.clone());
    client.ask_binary(step);
    client.ask(&json!({"id": 4, "type": "jump"}));
    for (name, want) in [
        ("crazyflie_sessions", 1.0),
        ("crazyflie_sessions_begun_total", 1.0),
        ("crazyflie_env_steps_total", 35.0),
        ("crazyflie_requests_total", 5.0),
        ("crazyflie_requests_refused_total", 1.0),
        ("crazyflie_request_seconds_count", 5.0),
    ] {
        assert_eq!(server.metric(name), want, "{name}");
    }
    assert!(server.get("/metrics").ends_with("# EOF\n"));
    assert_eq!(server.get("/healthz"), "ok\n");
    client.ask(&json!({"id": 5, "type": "close"}));
    eventually("it is counted", || server.metric("crazyflie_sessions_ended_total{end=\"Closed\"}") == 1.0);
}
