//! Sections of the page about single questions.

use std::fmt::Write;

use super::RecordedReport;
use super::ground::ROTORS_FROM_MARKER_M;
use crate::diagnosis::{changes_table, verdict_text};
use crate::text::{Table, number};

/// Standard errors beyond which a difference is one.
const CLEAR: f64 = 3.0;

/// Which of the thesis's transfer functions hold for this vehicle.
pub(super) fn transfer(report: &RecordedReport, text: &mut String) {
    if report.parts.is_empty() {
        return;
    }
    let [a, _] = &report.errors;
    let mut table = Table::new(&[
        "thesis model with",
        "attitude after 0.5 s (rad)",
        "velocity after 2 s (m/s)",
        "p against unchanged",
    ]);
    let mut row = |what: &str, attitude: f64, velocity: f64, p: Option<f64>| {
        let p = p.map_or(String::new(), |p| if p < 0.001 { "< 0.001".into() } else { number(p, 3) });
        table.row(vec![what.into(), number(attitude, 4), number(velocity, 3), p]);
    };
    row("nothing changed", a.before[2][2], a.before[1][3], None);
    for part in &report.parts {
        row(part.what, part.attitude_rad, part.velocity_mps, Some(part.p_value));
    }
    row("all numbers fitted", a.after[2][2], a.after[1][3], Some(a.p_value[1][3]));
    let model =
        |hypothesis: &super::Hypothesis, path: &str| hypothesis.model.parameter(path).unwrap_or(f64::NAN);
    let gain = |hypothesis: &super::Hypothesis, axis: &str| {
        model(hypothesis, &format!("{axis}.gain")) / model(hypothesis, &format!("{axis}.stiffness"))
    };
    let _ = writeln!(
        text,
        "### Which of the thesis's transfer functions transfer\n\n{}\n\
         - 5.1 (roll, pitch): the static gain, angle over commanded angle, is {} in the thesis; here it is {} (roll) and {} (pitch). The second\n  \
         order structure holds, its numbers do not transfer.\n\
         - 5.2 (yaw): these files hold no yaw-rate command, so nothing can be said of it.\n\
         - Vertical: the hover PWM is {} in the thesis and {} here. It belongs to one vehicle with one load and one battery.\n\
         - 5.3 and 5.4 need a height command, or rest at one height for one PWM; these flights hold a thrust command of a closed height loop, so\n  \
         only the thrust form is driven.\n\
         - Onboard and motion-capture clocks are skewed by tens of milliseconds, differently in each flight. No delay is tried or named here: on\n  \
         these files it would be the clocks'. A lever of the marker is a property of the markers (their origin is about 2 cm above the centre\n  \
         of mass), not of the vehicle.\n",
        table.markdown(),
        number(gain(&report.thesis, "roll"), 2),
        number(gain(&report.explained, "roll"), 2),
        number(gain(&report.explained, "pitch"), 2),
        number(model(&report.thesis, "vertical.thrust.hover"), 0),
        number(model(&report.explained, "vertical.thrust.hover"), 0),
    );
}

/// The models flown in closed loop along the set-points.
pub(super) fn closed_loop(report: &RecordedReport, folder: &str, text: &mut String) {
    let header = ["flown by", "on", "distance from the measured flight (m)", "predicted tracking error (m)"];
    let mut table = Table::new(&header).left(&[1]);
    for (controller, flown) in ["thesis PID", "firmware's controller"].into_iter().zip(&report.closed_loop) {
        for (model, c) in ["thesis model", "re-identified", "explained"].into_iter().zip(flown) {
            table.row(vec![
                controller.into(),
                model.into(),
                number(c.distances.predicted_m, 3),
                number(c.distances.predicted_tracking_m, 3),
            ]);
        }
    }
    let [one, _] = &report.closed_loop;
    let measured = one[0].distances.measured_tracking_m;
    table.row(vec!["nobody".into(), "the set-points themselves".into(), number(measured, 3), String::new()]);
    let _ = writeln!(
        text,
        "### Closed loop\n\nEach model is flown along the logged set-points of the {} test flights, from the state in which the flight begins to its end: by the\n\
         thesis PID (table 7.1, new gains; the height loop in parts of the PWM that carries the vehicle), and by the controller that flew these\n\
         flights: the firmware's cascade of position and velocity with its default gains, which the logged commands confirm. RMS over all\n\
         positions; the vehicle's own tracking error was {} m.\n\n{}\n\
         ![One test flight in closed loop]({folder}/closed_loop.svg)\n",
        one[0].flights.len(),
        number(measured, 3),
        table.markdown()
    );
}

pub(super) fn ground(report: &RecordedReport, text: &mut String) {
    let Some(ground) = &report.ground else { return };
    let header = ["effect", "found", "misfit less by, fit (%)", "misfit less by, test (%)", "verdict"];
    let mut table = Table::new(&header).left(&[1, 4]);
    for r in &ground.candidates {
        let v = &r.value;
        let clear = (v.value - r.off).abs() > CLEAR * v.stderr;
        let verdict = match (r.gain_test > 0.0 && clear, v.at_bound) {
            (true, false) => "helps",
            (true, true) => "helps, but its size runs away",
            (false, _) => "not shown",
        };
        let at = if v.at_bound { ", at its bound" } else { "" };
        let unit = if v.unit == "1" { String::new() } else { format!(" {}", v.unit) };
        table.row(vec![
            format!("`{}`", r.effect),
            format!("{} +- {}{unit}{at}", number(v.value, 3), number(v.stderr, 3)),
            number(100.0 * r.gain_fit, 1),
            number(100.0 * r.gain_test, 1),
            verdict.into(),
        ]);
    }
    let _ = writeln!(
        text,
        "## Near the floor\n\nThe first and last seconds of each flight below 0.3 m: {} windows of 0.5 s to fit, {} to test. Beside each effect the hover PWM, the\n\
         damping and the slope of the thrust are free: low flight is also where the thrust command changes fastest. The misfit is the robust\n\
         sum of squares of position and attitude. `ground_effect` is told that the rotors are {} mm below the marker, whose height is measured.\n\n{}\n\
         An effect counts if it lies three standard errors from none and helps on the test flights; one whose size runs to its bound stands for\n\
         more than a floor. Fits on small quadrotors give 4 to 14 for `ground_effect`; none is taken into the model, which flies above 0.3 m.\n",
        ground.windows[0],
        ground.windows[1],
        number(-1e3 * ROTORS_FROM_MARKER_M, 0),
        table.markdown()
    );
}

pub(super) fn pad(report: &RecordedReport, text: &mut String) {
    let Some(pad) = &report.pad else { return };
    text.push_str(
        "## CrazyPAD: planted defects\n\nWhat `crazyflie diagnose` says of each condition against the normal flights. A controller with an integral makes up for what is\n\
         wrong with a vehicle, so the mean of what it asks of the motors says what that is. The folder's name is the truth.\n\n",
    );
    for condition in &pad.conditions {
        let diagnosis = &condition.diagnosis;
        let _ = writeln!(
            text,
            "### `{}`\n\n**{}**\n\n{}",
            condition.name,
            verdict_text(diagnosis, &pad.demands),
            changes_table(diagnosis).markdown()
        );
        for line in &diagnosis.left_out {
            let _ = writeln!(text, "- left out: {line}");
        }
        text.push('\n');
    }
    if let Some([alarms, tried]) = pad.conditions.first().and_then(|c| c.diagnosis.normal_alarms) {
        let _ =
            writeln!(text, "Each normal set-up against the others: {alarms} of {tried} raise an alarm.\n");
    }
}
