//! Logs that are uploaded: each is replayed or refused in words, within its limits, and nothing of it stays.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use crate::net::{PATIENCE, Server, eventually, without_chunks};
use crazyflie_control::loop_analysis::LoopAxis;
use crazyflie_control::pid::Gains;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_logs::FlightLog;
use crazyflie_server::flight::{fly, log, sensor_rig, step_setup};
use crazyflie_server::serve::{Limits, Settings, Shares};
use serde_json::{Value, json};

const MIB: usize = 1 << 20;

/// A step along x of the simulated vehicle.
fn flown() -> FlightLog {
    let (effects, _) = sensor_rig("ideal").unwrap();
    let setup =
        step_setup(&Model::thesis(), VerticalInput::Thrust, effects, &Gains::THESIS, LoopAxis::X).unwrap();
    log(&fly(&setup, &[1]).unwrap()[0])
}

fn csv(log: &FlightLog) -> Vec<u8> {
    let mut bytes = Vec::new();
    log.write_csv(&mut bytes).unwrap();
    bytes
}

/// The head of an upload.
fn head(server: &Server, query: &str, more: &str) -> String {
    let address = server.address;
    format!("POST /api/v1/log-replay?{query} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n{more}\r\n")
}

/// Status and JSON of an answer.
fn answer(mut stream: TcpStream) -> (u16, Value) {
    let mut bytes = Vec::new();
    // an upload refused early may not be read to the end
    let _ = stream.read_to_end(&mut bytes);
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("an answer");
    let (head, body) = (String::from_utf8_lossy(&bytes[..end]).into_owned(), bytes.split_off(end + 4));
    let chunked = head.contains("transfer-encoding: chunked");
    let body = if chunked { without_chunks(&body) } else { body };
    (head[9..12].parse().unwrap(), serde_json::from_slice(&body).unwrap())
}

fn connect(server: &Server) -> TcpStream {
    let stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

fn upload(server: &Server, query: &str, body: &[u8]) -> (u16, Value) {
    let mut stream = connect(server);
    stream.write_all(head(server, query, &format!("content-length: {}\r\n", body.len())).as_bytes()).unwrap();
    let _ = stream.write_all(body);
    answer(stream)
}

fn held(server: &Server) -> f64 {
    server.metric("crazyflie_held{resource=\"RequestBytes\"}")
}

fn column(rows: &Value, at: usize) -> Vec<f64> {
    rows.as_array().unwrap().iter().map(|row| row[at].as_f64().unwrap()).collect()
}

#[test]
fn a_log_flies_beside_its_model() {
    let server = Server::start(Settings::default());
    let log = flown();
    let (status, told) = upload(&server, "file=step.csv&horizon_s=2", &csv(&log));
    assert_eq!((status, &told["vehicle"]), (200, &json!("cf2-thesis")), "{told}");
    // the same physics flew: what differs is noise and rounding
    for (name, summary) in told["replay"]["signals"].as_object().unwrap() {
        let worst = summary["max_error"].as_f64().unwrap();
        println!("{name}: {worst} {}", summary["unit"]);
        assert!(worst < 0.5, "{name}: {summary}");
    }
    assert_eq!(told["columns"], json!(["roll", "pitch", "yaw", "z", "vx", "vy", "x", "y"]));
    let (measured, model) = (column(&told["measured"], 6), column(&told["model"], 6));
    let moved = measured.iter().fold(f64::MIN, |most, x| most.max((x - measured[0]).abs()));
    assert!(measured.len() == model.len() && moved > 0.3, "{} rows, {moved} m", measured.len());
    // another vehicle flies elsewhere
    let (_, other) = upload(&server, "vehicle=cf2-thesis-drag", &csv(&log));
    assert_eq!(other["vehicle"], "cf2-thesis-drag");
    assert_ne!(column(&other["model"], 6), model);
    assert_eq!(column(&other["measured"], 6), measured);
    // cf21 was identified with the motors' PWM, which only a simulated log may lack
    let (status, told) = upload(&server, "vehicle=cf21", &csv(&log));
    assert_eq!((status, &told["vehicle"]), (200, &json!("cf21")));
    let measured_log = FlightLog { truth: None, ..log };
    let (status, told) = upload(&server, "vehicle=cf21", &csv(&measured_log));
    assert!(status == 422 && told["message"].as_str().unwrap().contains("motor PWM"), "{told}");
    eventually("nothing stays", || held(&server) == 0.0);
}

#[test]
fn a_log_with_grave_findings_is_refused_with_the_cure() {
    let server = Server::start(Settings::default());
    let mut log = flown();
    log.pitch_rad.iter_mut().for_each(|pitch| *pitch = -*pitch);
    let (status, told) = upload(&server, "file=turned.csv", &csv(&log));
    assert_eq!((status, &told["code"]), (422, &json!("grave_findings")), "{told}");
    let finding = &told["findings"][0];
    assert!(finding["cure"].as_str().unwrap().contains("pitch = -1"), "{told}");
    assert!(told["message"].as_str().unwrap().contains(finding["text"].as_str().unwrap()), "{told}");
    let (status, told) = upload(&server, "file=turned.csv&anyway=true", &csv(&log));
    assert_eq!((status, &told["findings"][0]["grade"]), (200, &json!("grave")));
}

#[test]
fn what_is_no_log_or_no_choice_is_said() {
    let server = Server::start(Settings::default());
    let log = csv(&flown());
    for (query, body, status, code, words) in [
        ("file=a.txt", &b"to whom it may concern\n"[..], 422, "bad_log", "a.txt"),
        ("", b"", 400, "bad_message", "found nothing"),
        ("vehicle=cf22", &log, 400, "bad_message", "cf22"),
        ("hover_pwm=1e9", &log, 400, "bad_message", "65535"),
        ("horizon_s=0", &log, 422, "bad_log", "0.01 s"),
        ("speed=3", &log, 400, "bad_message", "speed"),
        ("part=7", &log, 422, "bad_log", "--part"),
    ] {
        let (found, told) = upload(&server, query, body);
        assert_eq!((found, &told["code"]), (status, &json!(code)), "{query}: {told}");
        assert!(told["message"].as_str().unwrap().contains(words), "{query}: {told}");
    }
    let mut stream = connect(&server);
    stream.write_all(head(&server, "", "origin: http://evil.example\r\n").as_bytes()).unwrap();
    assert_eq!(answer(stream).1["code"], "origin");
    let mut stream = connect(&server);
    stream.write_all(head(&server, "", "").replacen("POST", "GET", 1).as_bytes()).unwrap();
    assert_eq!(answer(stream).1["code"], "bad_method");
}

#[test]
fn a_large_log_is_refused_packed_or_not() {
    let server = Server::start(Settings::default());
    // told before it is sent
    let mut stream = connect(&server);
    let length = format!("content-length: {}\r\n", 16 * MIB + 1);
    stream.write_all(head(&server, "", &length).as_bytes()).unwrap();
    let (status, told) = answer(stream);
    assert_eq!((status, &told["code"]), (413, &json!("too_large")), "{told}");
    assert!(told["message"].as_str().unwrap().contains("16 MiB"), "{told}");
    // and found while it comes
    let mut stream = connect(&server);
    stream.write_all(head(&server, "", "transfer-encoding: chunked\r\n").as_bytes()).unwrap();
    for _ in 0..17 {
        let chunk = [format!("{MIB:x}\r\n").into_bytes(), vec![b'1'; MIB], b"\r\n".into()].concat();
        if stream.write_all(&chunk).is_err() {
            break;
        }
    }
    assert_eq!(answer(stream).0, 413);
    for bomb in [packed(&vec![b'1'; 33 * MIB]), zipped(33 * MIB)] {
        assert!(bomb.len() < MIB, "{} bytes", bomb.len());
        let (status, told) = upload(&server, "file=bomb", &bomb);
        assert_eq!((status, &told["code"]), (422, &json!("bad_log")), "{told}");
        assert!(told["message"].as_str().unwrap().contains("32 MiB after decompression"), "{told}");
    }
}

#[test]
fn an_upload_counts_and_ends_with_its_client() {
    let limits = Limits {
        request_bytes: Shares::even(MIB),
        message_timeout: Duration::from_millis(300),
        ..Limits::default()
    };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let begin = |bytes: usize| {
        let mut stream = connect(&server);
        let length = format!("content-length: {}\r\n", 2 * bytes);
        stream.write_all(head(&server, "", &length).as_bytes()).unwrap();
        let _ = stream.write_all(&vec![b'1'; bytes]);
        stream
    };
    let (status, told) = answer(begin(MIB));
    assert_eq!((status, &told["code"]), (503, &json!("too_many")), "{told}");
    // the server does not wait for a client that stops sending
    assert_eq!(answer(begin(100)).0, 408);
    let gone = begin(400_000);
    eventually("the part is counted", || held(&server) > 400_000.0);
    drop(gone);
    eventually("given back", || held(&server) == 0.0);
}

#[test]
fn an_address_has_sixty_uploads_a_minute() {
    let server = Server::start(Settings::default());
    // a slow machine begins another minute on the way
    let refused = (0..10_000).find(|_| match upload(&server, "", b"no log") {
        (422, _) => false,
        (429, told) => told["message"].as_str().unwrap().contains("60 logs a minute"),
        other => panic!("{other:?}"),
    });
    assert!(refused.is_some_and(|number| number >= 60), "{refused:?}");
    assert!(server.metric("crazyflie_limits_reached_total{reason=\"too many logs\"}") > 0.0);
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// An archive of one file of so many zeros, which is packed a thousandfold.
fn zipped(bytes: usize) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    writer.start_file("log.csv", zip::write::SimpleFileOptions::default()).unwrap();
    writer.write_all(&vec![b'0'; bytes]).unwrap();
    writer.finish().unwrap().into_inner()
}
