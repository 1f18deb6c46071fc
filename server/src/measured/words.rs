//! Sections of the page about single questions.

use std::fmt::Write;

use super::Story;
use super::pad::{ASKED, CONDITIONS, Condition, Pad, mean, welch};
use crate::cli::{Table, number};

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

pub(super) fn ground(story: &Story, text: &mut String) {
    let Some(ground) = &story.ground else { return };
    let header = ["effect", "found", "log-likelihood gained, fit", "log-likelihood gained, test", "verdict"];
    let mut table = Table::new(&header).left(&[1, 4]);
    let mut best = ("nothing", 0.0);
    for r in &ground.rivals {
        let v = &r.values[0];
        let sizes = (v.value - if v.name.ends_with(".scale") { 1.0 } else { 0.0 }).abs() / v.stderr;
        let found = r.gain_test > 0.0 && sizes > CLEAR;
        if found && r.gain_test > best.1 {
            best = (r.effect, r.gain_test);
        }
        let at = if v.at_bound { ", at its bound" } else { "" };
        table.row(vec![
            format!("`{}`", r.effect),
            format!("{} +- {} {}{at}", number(v.value, 3), number(v.stderr, 3), if v.unit == "1" { "" } else { &v.unit }),
            number(r.gain_fit, 0),
            number(r.gain_test, 0),
            if found { "helps".into() } else { "not shown".into() },
        ]);
    }
    let said = match best.0 {
        "nothing" => {
            "Nothing is found that also holds on the test flights and lies three standard errors from nothing: so few seconds, at a thrust \
                      command that changes fast, do not show a ground effect."
                .to_owned()
        }
        name => format!("Best on the test flights is `{name}`."),
    };
    let _ = writeln!(
        text,
        "## Near the floor\n\nThe first and last seconds of each flight below 0.3 m: {} windows of 0.5 s to fit, {} to test, the explained model as it is with \
         its hover PWM free.\n\n{}\n{said}\n",
        ground.windows[0],
        ground.windows[1],
        table.markdown()
    );
}

pub(super) fn pad(story: &Story, text: &mut String) {
    let Some(pad) = &story.pad else { return };
    let header: Vec<&str> = ["condition", "flights"].into_iter().chain(ASKED).collect();
    let mut table = Table::new(&header);
    for c in &pad.conditions {
        let mut row = vec![format!("`{}`", c.name), c.flights.len().to_string()];
        row.extend((0..ASKED.len()).map(|i| {
            let (m, se) = mean(&c.flights, i);
            let by = if c.name == CONDITIONS[0] { String::new() } else { format!(" ({} se)", number(welch((m, se), normal(pad, i)), 1)) };
            format!("{} +- {}{by}", number(m, 0), number(se, 0))
        }));
        table.row(row);
    }
    let _ = writeln!(
        text,
        "## CrazyPAD: planted defects\n\nWhat hovering asks of the motors before battery compensation, in counts: the mean over a flight without take-off and landing, then\n\
         mean and standard error over the flights of one vehicle; in brackets the distance from the normal condition (Welch). The motors' columns are\n\
         differences from the mean of all four.\n\n{}",
        table.markdown()
    );
    for c in &pad.conditions[1..] {
        let _ = writeln!(text, "- `{}`: {}", c.name, verdict(c, pad));
    }
    let out: Vec<&str> = pad.conditions.iter().flat_map(|c| c.left_out.iter().map(String::as_str)).collect();
    let _ = writeln!(text, "\nLeft out (another vehicle, or no steady flight): {}.\n", out.join(", "));
}

fn normal(pad: &Pad, of: usize) -> (f64, f64) {
    mean(&pad.conditions[0].flights, of)
}

/// By the effects' own formulas at hover: thrust T carries m g, so added mass is m (T / T0 - 1); a motor that yields less is asked for more.
fn verdict(c: &Condition, pad: &Pad) -> String {
    let (thrust, se) = mean(&c.flights, 0);
    let (before, se0) = normal(pad, 0);
    let ratio = thrust / before;
    let ratio_se = ratio * (se / thrust).hypot(se0 / before);
    let heavier = (ratio - 1.0) / ratio_se;
    let motors: Vec<f64> = (1..5).map(|m| mean(&c.flights, m).0 - normal(pad, m).0).collect();
    let clear: Vec<f64> = (1..5).map(|m| welch(mean(&c.flights, m), normal(pad, m))).collect();
    let most = (0..4).max_by(|a, b| motors[*a].total_cmp(&motors[*b])).unwrap_or(0);
    let mass = format!("hover thrust {} +- {} % of normal", number(100.0 * ratio, 1), number(100.0 * ratio_se, 1));
    let asked = format!("motor {} is asked for {} counts more ({} se)", most + 1, number(motors[most], 0), number(clear[most], 1));
    let said = words(c.name, heavier, clear[most]);
    format!("{mass}; {asked}. {said}")
}

/// What the figures allow to be said, whatever the folder is called: the name only decides whether the library holds such an effect.
fn words(name: &str, heavier: f64, clearest: f64) -> String {
    if name.contains("string") {
        return "A weight that swings is no effect of the library: structure without a name.".into();
    }
    match (heavier > CLEAR, clearest > CLEAR) {
        (true, true) => "`mass_change` and `com_offset`: heavier, and out of balance.".into(),
        (true, false) => "`mass_change`; the balance is within the spread of the normal flights.".into(),
        (false, true) => {
            "`weak_motor`, or a `com_offset` of the same torque: out of balance at an unchanged weight; hovering cannot tell them apart."
                .into()
        }
        (false, false) => "Nothing beyond the spread of the normal flights.".into(),
    }
}
