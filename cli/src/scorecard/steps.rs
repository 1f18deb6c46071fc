//! The identification flights of chapter 5: a step after 10 s of hovering at 70 cm, in open loop.

use crazyflie_control::ControllerSpec;
use crazyflie_env::Error;
use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::{EffectParams, EffectTable, Number};
use crazyflie_env::model::{Model, Vertical, VerticalInput};
use crazyflie_env::plant::Command;
use crazyflie_env::vector::state_index;
use crazyflie_identify::metrics::fit_percent;

use super::{Claim, Measurement, ScorecardRow, about, figure};
use crazyflie_server::flight::{FlightScenario, Setup, Trace, fly_open_loop, lab_rig};

type ExperimentFn = fn(&Model) -> Result<Vec<ScorecardRow>, Error>;

pub(super) const EXPERIMENTS: &[ExperimentFn] = &[tilts, yaw, height, pwm, angle_speed];

/// 5.1: "after 10 seconds".
const HOVER_S: f64 = 10.0;
const STEP_RAD: f64 = 7.5 * std::f64::consts::PI / 180.0;
const NEEDS_RECORDING: &str = "the fit is to the lab's recording; ours is the simulator against the equation";

/// Flies the open-loop command for the hover and `seconds` more; rows from the step on.
pub(super) fn fly(
    model: &Model,
    vertical: VerticalInput,
    effects: EffectTable,
    seconds: f64,
    command: &dyn Fn(f64) -> Command<f64>,
) -> Result<(Trace, usize), Error> {
    let setup = Setup {
        model: model.clone(),
        scenario: FlightScenario::find("hover-70cm")?,
        task_options: None,
        own: None,
        action: ActionLevel::Attitude,
        controller: ControllerSpec::named("thesis-pid")?,
        effects,
        vertical,
        seconds: HOVER_S + seconds,
    };
    // half a tick of margin for the clock's rounding
    let mut traces = fly_open_loop(&setup, &[0], &|t_s| command(t_s - HOVER_S + 1e-3))?;
    let trace = traces.swap_remove(0);
    let first = (HOVER_S / trace.tick_s).round() as usize;
    Ok((trace, first))
}

/// Level at 70 cm by the height input.
pub(super) fn level() -> Command<f64> {
    Command::level(0.7)
}

/// A height that an equation gives.
fn by(height_m: f64, equation: &str) -> Claim {
    about(100.0 * height_m, format!("{:.1} cm by {equation}", 100.0 * height_m))
}

/// The step response of gain / (s^2 + damping s + stiffness), overdamped as 5.1 is.
fn second_order_step(gain: f64, damping: f64, stiffness: f64, t_s: f64) -> f64 {
    let root = (0.25 * damping * damping - stiffness).sqrt();
    let (slow, fast) = (0.5 * damping - root, 0.5 * damping + root);
    gain / stiffness * (1.0 - (fast * (-slow * t_s).exp() - slow * (-fast * t_s).exp()) / (fast - slow))
}

/// 5.1.1: 7.5 degrees of pitch, then of roll.
fn tilts(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let mut lines = Vec::new();
    let fits = [
        ("5.1.1, fig. 5.2-5.4", "pitch step of 7.5 deg", Claim::Words("fit 69.33 %"), &model.pitch, 7),
        ("5.1.1, fig. 5.5", "roll step of 7.5 deg", Claim::Words("fit 65.36 %"), &model.roll, 6),
    ];
    for (place, experiment, claim, tilt, state) in fits {
        let command = |t: f64| match (t >= 0.0, state) {
            (false, _) => level(),
            (true, 7) => Command { pitch_rad: STEP_RAD, ..level() },
            (true, _) => Command { roll_rad: STEP_RAD, ..level() },
        };
        let (trace, first) = fly(model, VerticalInput::Height, EffectTable::new(), 1.2, &command)?;
        let exact = |t: f64| {
            STEP_RAD * second_order_step(tilt.gain.value, tilt.damping.value, tilt.stiffness.value, t)
        };
        let line = |quantity, claim, ideal, why| ScorecardRow {
            place,
            experiment,
            gains: "",
            quantity,
            claim,
            ideal,
            rig: None,
            why,
        };
        lines.push(line("fit of 5.1", claim, fit_to(&trace, first, state, &exact), NEEDS_RECORDING));
        let after = first + (1.0 / trace.tick_s).round() as usize;
        let angle = f64::from(trace.rows[after].state[state]).to_degrees();
        lines.push(line(
            "angle after 1 s",
            about(exact(1.0).to_degrees(), format!("{:.2} deg by 5.1", exact(1.0).to_degrees())),
            figure(angle, "deg", 2),
            "",
        ));
    }
    Ok(lines)
}

/// MATLAB's fit of an equation to the simulator's true state.
fn fit_to(trace: &Trace, first: usize, state: usize, exact: &dyn Fn(f64) -> f64) -> Option<Measurement> {
    let measured: Vec<f64> = trace.rows[first..].iter().map(|r| f64::from(r.state[state])).collect();
    let model: Vec<f64> = (0..measured.len()).map(|i| exact(trace.t_s(i))).collect();
    fit_percent(&measured, &model).ok().flatten().and_then(|fit| figure(fit, "%", 2))
}

/// 5.1.2: 36 deg/s.
fn yaw(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let rate = 36_f64.to_radians();
    let command = |t: f64| if t >= 0.0 { Command { yaw_rate_radps: rate, ..level() } } else { level() };
    let (trace, first) = fly(model, VerticalInput::Height, EffectTable::new(), 10.0, &command)?;
    let turned = f64::from(trace.rows[trace.rows.len() - 1].state[state_index::YAW]).to_degrees();
    let place = "5.1.2, fig. 5.8";
    let line = |quantity, claim, ideal, why| ScorecardRow {
        place,
        experiment: "yaw at 36 deg/s",
        gains: "",
        quantity,
        claim,
        ideal,
        rig: None,
        why,
    };
    Ok(vec![
        line(
            "fit of 5.2",
            Claim::Words("by hand; automatic 20 %"),
            fit_to(&trace, first, 8, &|t| -rate * t),
            NEEDS_RECORDING,
        ),
        line("turned in 10 s", about(-360.0, "-360 deg by 5.2"), figure(turned, "deg", 2), ""),
    ])
}

/// The fit of an equation for the height to the marker's readings through the lab's camera, and the largest
/// difference.
fn fit_to_marker(trace: &Trace, first: usize, exact: &dyn Fn(f64) -> f64) -> (f64, f64) {
    let log = crazyflie_server::flight::log(trace);
    let start_s = trace.t_s(first);
    let fixes = log.fixes.capture_t_s.iter().zip(&log.fixes.pos_m[2]).filter(|(t, _)| **t >= start_s);
    let (model, measured): (Vec<f64>, Vec<f64>) = fixes.map(|(t, z)| (exact(t - start_s), *z)).unzip();
    let largest = model.iter().zip(&measured).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    (fit_percent(&measured, &model).ok().flatten().unwrap_or(f64::NAN), largest)
}

/// 5.1.3: the height command from 70 to 80 cm.
fn height(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let Vertical::FirstOrder { gain, pole, .. } = model.vertical(VerticalInput::Height)? else {
        return Ok(Vec::new());
    };
    let (gain, pole) = (gain.value, pole.value);
    let command = |t: f64| Command::level(if t >= 0.0 { 0.8 } else { 0.7 });
    let (trace, first) = fly(model, VerticalInput::Height, EffectTable::new(), 6.0, &command)?;
    let (seen, _) = fly(model, VerticalInput::Height, lab_rig(), 6.0, &command)?;
    let (before, after) = (0.7 * gain / pole, 0.8 * gain / pole);
    let exact = |t: f64| after - (after - before) * (-pole * t).exp();
    let (fit, largest) = fit_to_marker(&seen, first, &exact);
    let end = f64::from(trace.rows[trace.rows.len() - 1].state[state_index::HEIGHT]);
    let (place, experiment) = ("5.1.3, fig. 5.12", "height 70 to 80 cm");
    let line = |quantity, claim, ideal, rig, why| ScorecardRow {
        place,
        experiment,
        gains: "",
        quantity,
        claim,
        ideal,
        rig,
        why,
    };
    let record = "a fit needs the lab's recording: it grows with the span of the record, and ours is the 10 cm step alone";
    let noise = "our marker noise is white, 10 mm, without the lab's outliers of 10 cm";
    Ok(vec![
        line("fit of 5.3 to the marker's height", about(77.76, "77.76 %"), None, figure(fit, "%", 2), record),
        line(
            "largest error of 5.3",
            about(10.0, "about 10 cm"),
            None,
            figure(100.0 * largest, "cm", 1),
            noise,
        ),
        line("height 6 s later", by(exact(6.0), "5.3"), figure(100.0 * end, "cm", 1), None, ""),
    ])
}

/// 5.1.3: the same step by PWM.
fn pwm(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let Vertical::FirstOrder { gain, pole, offset: Some(offset), .. } = model.vertical(VerticalInput::Pwm)?
    else {
        return Ok(Vec::new());
    };
    let (gain, pole, offset) = (gain.value, pole.value, offset.value);
    let holds = |z: f64| offset + pole * z / gain;
    let command = |t: f64| Command::level(holds(if t >= 0.0 { 0.8 } else { 0.7 }));
    let (trace, first) = fly(model, VerticalInput::Pwm, EffectTable::new(), 6.0, &command)?;
    let (seen, _) = fly(model, VerticalInput::Pwm, lab_rig(), 6.0, &command)?;
    let exact = |t: f64| 0.8 - 0.1 * (-pole * t).exp();
    let (fit, _) = fit_to_marker(&seen, first, &exact);
    let (place, experiment) = ("5.1.3, fig. 5.15", "height 70 to 80 cm by PWM");
    let line = |quantity, claim, ideal, rig, why| ScorecardRow {
        place,
        experiment,
        gains: "",
        quantity,
        claim,
        ideal,
        rig,
        why,
    };
    let end = 100.0 * f64::from(trace.rows[trace.rows.len() - 1].state[state_index::HEIGHT]);
    Ok(vec![
        line(
            "fit of 5.4 to the marker's height",
            Claim::Words("not given, \"not as accurate\""),
            None,
            figure(fit, "%", 2),
            NEEDS_RECORDING,
        ),
        line("height 6 s later", by(exact(6.0), "5.4"), figure(end, "cm", 1), None, ""),
    ])
}

/// The camera's field of view.
pub(super) fn field_of_view() -> EffectTable {
    let on = EffectParams::Named([("diagonal_deg".to_owned(), Number::Fixed(120.0))].into());
    EffectTable::from([("camera_fov".to_owned(), on)])
}

/// 5.1.4: 7.5 degrees until the marker is lost.
fn angle_speed(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let command = |t: f64| if t >= 0.0 { Command { pitch_rad: STEP_RAD, ..level() } } else { level() };
    let (trace, first) = fly(model, VerticalInput::Height, field_of_view(), 2.0, &command)?;
    let lost = (first..trace.rows.len()).find(|&row| !trace.rows[row].sees_marker());
    let (t, g) = (&model.pitch, model.lateral.gravity.value);
    let speed =
        |t_s: f64| g * STEP_RAD * integral_of_step(t.gain.value, t.damping.value, t.stiffness.value, t_s);
    let at = lost.unwrap_or(trace.rows.len() - 1);
    let (since_s, row) = (trace.t_s(at - first), &trace.rows[at]);
    let rig = lab_rig().into_iter().chain(field_of_view()).collect();
    let (seen, _) = fly(model, VerticalInput::Height, rig, since_s, &command)?;
    let (place, experiment) = ("5.1.4, fig. 5.17", "pitch 7.5 deg until the marker is lost");
    let line = |quantity, claim, ideal, rig, why| ScorecardRow {
        place,
        experiment,
        gains: "",
        quantity,
        claim,
        ideal,
        rig,
        why,
    };
    let not_given = || Claim::Words("not given");
    let fit = fit_of_speed(&seen, first, &speed);
    Ok(vec![
        line(
            "marker lost after",
            not_given(),
            lost.and_then(|_| figure(since_s, "s", 2)),
            None,
            "field of view of 120 degrees over the diagonal",
        ),
        line(
            "way until then",
            not_given(),
            figure(100.0 * f64::from(row.state[state_index::POS]), "cm", 1),
            None,
            "",
        ),
        line(
            "speed then",
            about(speed(since_s), format!("{:.3} m/s by 5.5", speed(since_s))),
            figure(f64::from(row.state[state_index::VEL]), "m/s", 3),
            None,
            "",
        ),
        line(
            "fit of 5.5 to the marker's derivative",
            Claim::Words("not given, \"not as good as wanted\""),
            None,
            figure(fit, "%", 2),
            "poor there and here for the same reason: the derivative of a noisy position",
        ),
    ])
}

/// Integral of the step response, in closed form.
fn integral_of_step(gain: f64, damping: f64, stiffness: f64, t_s: f64) -> f64 {
    let root = (0.25 * damping * damping - stiffness).sqrt();
    let (slow, fast) = (0.5 * damping - root, 0.5 * damping + root);
    let part = |pole: f64| (1.0 - (-pole * t_s).exp()) / pole;
    gain / stiffness * (t_s - (fast * part(slow) - slow * part(fast)) / (fast - slow))
}

/// The fit of a speed to the difference quotients of the marker's x.
fn fit_of_speed(trace: &Trace, first: usize, speed: &dyn Fn(f64) -> f64) -> f64 {
    let log = crazyflie_server::flight::log(trace);
    let (t, x, start_s) = (&log.fixes.capture_t_s, &log.fixes.pos_m[0], trace.t_s(first));
    let pairs = (1..t.len()).filter(|&i| t[i - 1] >= start_s);
    let (model, measured): (Vec<f64>, Vec<f64>) = pairs
        .map(|i| (speed(0.5 * (t[i] + t[i - 1]) - start_s), (x[i] - x[i - 1]) / (t[i] - t[i - 1])))
        .unzip();
    fit_percent(&measured, &model).ok().flatten().unwrap_or(f64::NAN)
}
