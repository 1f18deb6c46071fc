//! Lost rows, stamps that jitter, a gap and a take-off leave the answer about a committed case as it is: a camera
//! whose latency nobody declared, d05.

use std::path::{Path, PathBuf};

use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
use crazyflie_identify::explain::explain;
use crazyflie_identify::explain::verdict::Verdict;
use crazyflie_identify::fit::flight::Flight;

/// Noise by a counter, 0 to 1 (splitmix64).
fn noise(i: usize) -> f64 {
    let mixed = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

/// A table as its header, and its rows as fields.
struct Rows {
    header: String,
    rows: Vec<Vec<String>>,
}

impl Rows {
    fn read(path: &Path) -> Self {
        let mut text = String::new();
        let file = std::fs::File::open(path).unwrap();
        std::io::Read::read_to_string(&mut flate2::read::GzDecoder::new(file), &mut text).unwrap();
        let (header, body) = text.split_once('\n').unwrap();
        let rows = body.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        Rows { header: header.to_owned(), rows }
    }

    fn place(&self, column: &str) -> usize {
        self.header.split(',').position(|name| name == column).unwrap()
    }

    fn log(&self) -> FlightLog {
        let lines: Vec<String> = self.rows.iter().map(|row| row.join(",")).collect();
        FlightLog::from_bytes("made.csv", format!("{}\n{}\n", self.header, lines.join("\n")).as_bytes())
            .unwrap()
    }

    /// All stamps later.
    fn shift(&mut self, by: impl Fn(usize) -> f64, camera_s: f64) {
        let (t, t_cam) = (self.place("t"), self.place("t_cam"));
        for (i, row) in self.rows.iter_mut().enumerate() {
            row[t] = format!("{:.4}", row[t].parse::<f64>().unwrap() + by(i));
            if let Ok(captured) = row[t_cam].parse::<f64>() {
                row[t_cam] = format!("{:.4}", captured + camera_s);
            }
        }
    }

    /// 2.5 s on the floor while the PWM rises, and a climb within 1.5 s that obeys no command.
    fn begin_on_the_floor(&mut self) {
        let places = ["x", "y", "z", "t_cam", "t", "cmd_thrust_pwm"].map(|name| self.place(name));
        let level = ["roll", "pitch", "cmd_roll", "cmd_pitch", "cmd_yawrate"].map(|name| self.place(name));
        let fix = self.rows.iter().find(|row| !row[places[2]].is_empty()).unwrap().clone();
        let height_m: f64 = fix[places[2]].parse().unwrap();
        let row = |i: usize| {
            let mut row = self.rows[0].clone();
            let share = (i.saturating_sub(250) as f64) / 150.0;
            let z = 0.03 + share * share * (3.0 - 2.0 * share) * (height_m - 0.03);
            let pwm = if i < 250 {
                39_342.0 * i as f64 / 250.0
            } else {
                39_342.0 + 2e3 * (1.0 - 2.0 * share).signum()
            };
            let seen = [
                fix[places[0]].clone(),
                fix[places[1]].clone(),
                z.to_string(),
                (i as f64 / 100.0).to_string(),
            ];
            for (place, value) in places.iter().zip(seen) {
                row[*place] = if i.is_multiple_of(3) { value } else { String::new() };
            }
            (row[places[4]], row[places[5]]) = ((i as f64 / 100.0).to_string(), pwm.round().to_string());
            level.iter().for_each(|place| row[*place] = "0".into());
            row
        };
        let before: Vec<Vec<String>> = (0..400).map(row).collect();
        self.shift(|_| 4.0, 4.0);
        self.rows.splice(0..0, before);
    }
}

/// Faults of a log in transit.
type Fault = fn(&mut Rows);

#[test]
fn faults_of_a_log_leave_the_answer_as_it_is() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/cases"));
    let case = Case::read(&folder.join("d05.json")).unwrap();
    let model = case.model().unwrap();
    let faults: [(&str, Fault); 6] = [
        ("none", |_| ()),
        ("a lost row", |log| drop(log.rows.remove(1001))),
        ("the first row lost", |log| drop(log.rows.remove(0))),
        ("jitter of 4 ms", |log| log.shift(|i| 0.008 * noise(i) - 0.004, 0.0)),
        ("a gap of 2 s", |log| drop(log.rows.drain(300..500))),
        ("a take-off", Rows::begin_on_the_floor),
    ];
    for (fault, apply) in faults {
        let flight = |path: &Path| {
            let mut rows = Rows::read(path);
            apply(&mut rows);
            Flight::from_log("made", &rows.log(), &model, None).unwrap()
        };
        let [fit, test] = [flight(&case.identify_on), flight(&case.held_out)];
        assert!((fit.tick_s - 0.02).abs() < 1e-5, "{fault}: a tick of {} s", fit.tick_s);
        let explanation = explain(&model, &[fit], &[test], &|_| ()).unwrap();
        let names: Vec<&str> = explanation.effects.iter().map(|effect| effect.name).collect();
        assert_eq!(
            (explanation.verdict, &names[..]),
            (Verdict::Explained, &["camera_latency"][..]),
            "{fault}"
        );
        let latency = &explanation.effects[0].params[0];
        assert!((latency.value - 0.071).abs() < 3.0 * latency.stderr, "{fault}: {latency:?}");
    }
}
