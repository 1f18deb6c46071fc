//! Sections of the page about single questions.

use std::fmt::Write;

use super::Story;
use super::ground::ROTORS_FROM_MARKER_M;
use super::pad::{Condition, Pad};
use crate::cli::{Table, number};
use crazyflie_identify::explain::verdict::Estimate;
use crazyflie_identify::hover::{ASKED, BALANCE, Change, Found};

/// Standard errors beyond which a difference is one.
const CLEAR: f64 = 3.0;

/// Which of the thesis's transfer functions hold for this vehicle.
pub(super) fn transfer(story: &Story, text: &mut String) {
    if story.parts.is_empty() {
        return;
    }
    let [a, _] = &story.errors;
    let mut table = Table::new(&["thesis model with", "attitude after 0.5 s (rad)", "velocity after 2 s (m/s)", "p against unchanged"]);
    let mut row = |what: &str, attitude: f64, velocity: f64, p: Option<f64>| {
        let p = p.map_or(String::new(), |p| if p < 0.001 { "< 0.001".into() } else { number(p, 3) });
        table.row(vec![what.into(), number(attitude, 4), number(velocity, 3), p]);
    };
    row("nothing changed", a.before[2][2], a.before[1][3], None);
    for part in &story.parts {
        row(part.what, part.attitude_rad, part.velocity_mps, Some(part.p_value));
    }
    row("all numbers fitted", a.after[2][2], a.after[1][3], Some(a.p_value[1][3]));
    let model = |of: &super::Hypothesis, path: &str| of.model.parameter(path).unwrap_or(f64::NAN);
    let gain = |of: &super::Hypothesis, axis: &str| model(of, &format!("{axis}.gain")) / model(of, &format!("{axis}.stiffness"));
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
        number(gain(&story.thesis, "roll"), 2),
        number(gain(&story.explained, "roll"), 2),
        number(gain(&story.explained, "pitch"), 2),
        number(model(&story.thesis, "vertical.thrust.hover"), 0),
        number(model(&story.explained, "vertical.thrust.hover"), 0),
    );
}

/// The models flown in closed loop along the set-points.
pub(super) fn closed_loop(story: &Story, folder: &str, text: &mut String) {
    let header = ["flown by", "on", "distance from the measured flight (m)", "predicted tracking error (m)"];
    let mut table = Table::new(&header).left(&[1]);
    for (controller, flown) in ["thesis PID", "firmware's controller"].into_iter().zip(&story.closed_loop) {
        for (model, c) in ["thesis model", "re-identified", "explained"].into_iter().zip(flown) {
            table.row(vec![
                controller.into(),
                model.into(),
                number(c.distances.predicted_m, 3),
                number(c.distances.predicted_tracking_m, 3),
            ]);
        }
    }
    let [one, _] = &story.closed_loop;
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

pub(super) fn ground(story: &Story, text: &mut String) {
    let Some(ground) = &story.ground else { return };
    let header = ["effect", "found", "misfit less by, fit (%)", "misfit less by, test (%)", "verdict"];
    let mut table = Table::new(&header).left(&[1, 4]);
    for r in &ground.rivals {
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

pub(super) fn pad(story: &Story, text: &mut String) {
    let Some(pad) = &story.pad else { return };
    let header: Vec<&str> = ["condition", "flights"].into_iter().chain(ASKED).chain(["left unexplained (p)"]).collect();
    let mut table = Table::new(&header);
    for c in &pad.conditions {
        let mut row = vec![format!("`{}`", c.name), c.flights.len().to_string()];
        row.extend((0..ASKED.len()).map(|i| match &c.change {
            None => format!("{} +- {}", number(pad.normal.mean[i], 0), number(pad.normal.spread[(i, i)].sqrt(), 0)),
            Some(change) => format!("{} ({} sd)", signed(change.by[i], 0), signed(change.z[i], 1)),
        }));
        row.push(c.change.as_ref().map_or(String::new(), |change| p_value(change.left_p_value)));
        table.row(row);
    }
    let _ = writeln!(
        text,
        "## CrazyPAD: planted defects\n\nA controller with an integral makes up for what is wrong with a vehicle, so the mean of what it asks of the motors says what that\n\
         is. In counts before battery compensation, over a flight without take-off and landing: thrust is the mean of the motors, roll a quarter of left\n\
         less right, pitch of front less back, yaw of motors 1 and 3 less 2 and 4. First the normal vehicle, with the standard deviation of one flight;\n\
         then how far each condition lies from it. The flights of a condition are one set-up (one battery put in, one trim), so their mean\n\
         counts as one flight and not as six. Every effect of the library says through the simulator what it would ask of the motors; they are\n\
         fitted to the difference and added while chance would do as well in less than 1 of 20 (Hotelling, times the number of effects). The\n\
         balance (`com_offset`) is left open beside all others: it differs between set-ups anyway. Masses are for a vehicle of {} g.\n\n{}",
        number(1e3 * story.thesis.model.parameter("vehicle.mass").unwrap_or(f64::NAN), 0),
        table.markdown()
    );
    for c in &pad.conditions {
        if let Some(change) = &c.change {
            let _ = writeln!(text, "- `{}`: {}. {}", c.name, verdict(pad, change), truth(c));
        }
    }
    let _ = writeln!(text, "\n{}", alarms(pad));
    let out: Vec<&str> = pad.conditions.iter().flat_map(|c| c.left_out.iter().map(String::as_str)).collect();
    let _ = writeln!(text, "\nLeft out (another vehicle, or no steady flight): {}.\n", out.join(", "));
}

fn signed(value: f64, decimals: usize) -> String {
    let sign = if value < 0.0 { "" } else { "+" };
    format!("{sign}{}", number(value, decimals))
}

fn p_value(p: f64) -> String {
    if p < 0.001 { "< 0.001".into() } else { number(p, 3) }
}

fn verdict(pad: &Pad, change: &Change) -> String {
    if change.found.is_empty() {
        return "nothing beyond what set-ups differ by".into();
    }
    let name = |f: &Found| {
        let choice: Vec<String> = f.choice.iter().map(|c| format!(" {} {}", c.name, c.value)).collect();
        let unit = |unit: &str| if unit == "1" { String::new() } else { format!(" {unit}") };
        let of = |e: &Estimate| format!("{} {} +- {}{}", e.name, number(e.value, 4), number(e.stderr, 4), unit(e.unit));
        // degrees of a loop without an integral say nothing here
        let params = if f.name == BALANCE { vec![off_centre(pad, f)] } else { f.params.iter().map(of).collect() };
        let alike = if f.confusable_with.is_empty() { String::new() } else { format!(", or as well {}", f.confusable_with.join(", ")) };
        format!("`{}`{}: {} (p {}){alike}", f.name, choice.concat(), params.join(", "), p_value(f.p_value))
    };
    change.found.iter().map(name).collect::<Vec<_>>().join("; ")
}

fn off_centre(pad: &Pad, f: &Found) -> String {
    let [left, front] = pad.normal.off_centre_m(&f.asks).map(|m| 1e3 * m);
    let to = |mm: f64, sides: [&str; 2]| format!("{} mm to the {}", number(mm.abs(), 1), sides[usize::from(mm < 0.0)]);
    format!("the centre of mass {}, {}", to(left, ["left", "right"]), to(front, ["front", "back"]))
}

/// What is known to have been planted, told after the figures have spoken.
fn truth(c: &Condition) -> &'static str {
    match c.name {
        "add_weight_W1_near_M3_M4" => "Planted: a weight near motors 3 and 4, on the left.",
        "cut_propeller_M3_2mm" => "Planted: propeller 3 cut by 2 mm.",
        _ => "Planted: a weight on a string near motor 3. The library has no swinging load.",
    }
}

fn alarms(pad: &Pad) -> String {
    let flights = pad.conditions.first().map_or(0, |c| c.flights.len());
    let count = pad.false_alarms.len();
    let names: Vec<String> = pad.false_alarms.iter().map(|f| format!("`{}`, p {}", f.name, p_value(f.p_value))).collect();
    let which = if count == 0 { String::new() } else { format!(": {}", names.join("; ")) };
    let worth = if count == 0 { "" } else { " What a normal flight is named too is no evidence of a fault." };
    format!("Each normal flight taken as a condition, against the others: {count} of {flights} get a name{which}.{worth}")
}
