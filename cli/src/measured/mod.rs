//! Study of the model on recorded flights: fitted on some, predicted on others.

mod data;
mod force;
mod ground;
mod ladder;
mod pad;
mod page;
mod picture;
mod words;

use crazyflie_statistics::quantile;
use std::path::Path;
use std::time::Instant;

use crazyflie_env::model::Model;
use crazyflie_identify::closed_loop::{Controller, Distances, Tracking, follow};
use crazyflie_identify::explain::errors::{self, Errors};
use crazyflie_identify::explain::noise;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::Hypothesis;

use data::FlightSet;
use ladder::{EffectTrial, FitProblem, FittedValue};

pub(crate) use page::{as_json, page};
pub(crate) use picture::pictures;

/// Largest number of calls of `progress`.
pub(crate) const STAGES: u64 = 15;

/// Windows of the fits. Hover PWM differ from flight to flight, and over 5 s that is seen as damping rather
/// than as a force; with the hover PWM of each flight known, 2 s tell the force.
const LONG_S: f64 = 5.0;
const SHORT_S: f64 = 2.0;
/// Start of a fit without a better value.
const THESIS_PWM: f64 = 39_342.5;

/// The thesis model with some of its numbers fitted, on the test flights.
pub(crate) struct SubsetFit {
    what: &'static str,
    /// Root mean square: attitude after 0.5 s (rad), velocity after 2 s (m/s).
    attitude_rad: f64,
    velocity_mps: f64,
    /// Velocity against the thesis model unchanged.
    p_value: f64,
}

/// A controller on one model.
pub(crate) struct ClosedLoop {
    distances: Distances,
    /// Per test flight with set-points.
    flights: Vec<(String, Tracking)>,
}

impl ClosedLoop {
    fn follow_setpoints(model: &Model, test: &FlightSet, controller: Controller) -> Self {
        let fly = |r: &data::RecordedFlight| {
            Some((r.flight.name.clone(), follow(model, &r.log, &r.flight, controller).ok()??))
        };
        let flights: Vec<(String, Tracking)> = test.recorded.iter().filter_map(fly).collect();
        let all: Vec<Tracking> = flights.iter().map(|(_, t)| t.clone()).collect();
        ClosedLoop { distances: Distances::new(&all), flights }
    }
}

/// Results that the page shows.
pub(crate) struct RecordedReport {
    fit: FlightSet,
    test: FlightSet,
    thesis: Hypothesis,
    /// The median thrust command of each flight, of both sides.
    hovers_pwm: [Vec<f64>; 2],
    /// Test flights with thrust in parts of their hover PWM.
    judged_trim: Vec<Flight>,
    again: Hypothesis,
    explained: Hypothesis,
    again_values: Vec<FittedValue>,
    values: Vec<FittedValue>,
    effect_trials: Vec<EffectTrial>,
    /// Thesis against re-identified; re-identified with the hover PWM of each flight against explained.
    errors: [Errors; 2],
    /// Thesis, re-identified, re-identified with the hover PWM of each flight, explained.
    force_mps2: [f64; 4],
    /// Of the constant g.
    still_mps2: f64,
    /// The thesis PID and the firmware's controller along the set-points of the test flights: on the thesis
    /// model, re-identified, explained.
    closed_loop: [[ClosedLoop; 3]; 2],
    parts: Vec<SubsetFit>,
    ground: Option<ground::GroundStudy>,
    pad: Option<pad::DefectStudy>,
    seconds: f64,
}

impl RecordedReport {
    /// Factors by which the 2 s velocity error is smaller: re-identified, and explained.
    fn factors(&self) -> [f64; 2] {
        let thesis = self.errors[0].before[1][3];
        [thesis / self.errors[0].after[1][3], thesis / self.errors[1].after[1][3]]
    }
}

/// Fits and predicts. `data` holds the folders of the recordings.
///
/// # Errors
/// Recordings that are missing or cannot be read, in words.
pub(crate) fn study_recordings(
    data: &Path,
    quick: bool,
    progress: &dyn Fn(&str),
) -> Result<RecordedReport, String> {
    let began = Instant::now();
    let model = Model::thesis();
    progress("reading");
    let [fit, test] = data::sides(&data.join("nanobench"), &model, quick)?;
    let (fitted, judged) = (fit.flights(), test.flights());
    progress("the numbers again");
    let thesis = Hypothesis::from_model(&model);
    let first = FitProblem::new(&fitted, LONG_S).reidentify(&model, THESIS_PWM);
    let again = Hypothesis::from_model(&first.hypothesis.model);
    progress("what is random");
    let d = noise::tune_disturbances(&fitted[0], &again, None, &[]);
    progress("the hover PWM of each flight");
    let common_pwm = quantile(&fit.hovers_pwm(), 0.5).unwrap_or(f64::NAN);
    let (fitted_trim, judged_trim) =
        (fit.flights_with_own_hover(&model, common_pwm), test.flights_with_own_hover(&model, common_pwm));
    let all = FitProblem::new(&fitted_trim, SHORT_S);
    let trim = all.reidentify(&model, common_pwm);
    let trimmed = Hypothesis::from_model(&trim.hypothesis.model);
    let (last, effect_trials) = all.try_effects(trim, &judged_trim, &d, progress);
    let explained = last.hypothesis.without_free();
    progress("the test flights");
    let dx = noise::tune_disturbances(&fitted_trim[0], &explained, Some(&d), &[]);
    let errors = [
        errors::compare_errors((&thesis, &d, &judged), (&again, &d, &judged)),
        errors::compare_errors((&trimmed, &d, &judged_trim), (&explained, &dx, &judged_trim)),
    ];
    let force_mps2 = [
        force::error(&judged, &thesis),
        force::error(&judged, &again),
        force::error(&judged_trim, &trimmed),
        force::error(&judged_trim, &explained),
    ];
    let still_mps2 = force::constant_gravity_error(&judged);
    progress("closed loop");
    let models = [&thesis, &again, &explained].map(|h| h.to_model("fitted"));
    let closed_loop = [Controller::Thesis, Controller::Firmware]
        .map(|c| models.each_ref().map(|m| ClosedLoop::follow_setpoints(m, &test, c)));
    let parts = if quick { Vec::new() } else { parts(&thesis, &again, &d, &judged) };
    progress("near the floor");
    let ground = if quick { None } else { ground::ground(&explained, &fitted_trim, &judged_trim) };
    progress("planted defects");
    let pad = pad::pad(&model, &data.join("crazypad"));
    let seconds = began.elapsed().as_secs_f64();
    let (values, again_values) = (last.values, first.values);
    let hovers_pwm = [fit.hovers_pwm(), test.hovers_pwm()];
    Ok(RecordedReport {
        hovers_pwm,
        judged_trim,
        fit,
        test,
        thesis,
        again,
        explained,
        again_values,
        values,
        effect_trials,
        errors,
        force_mps2,
        still_mps2,
        closed_loop,
        parts,
        ground,
        pad,
        seconds,
    })
}

/// Fits of the thesis model with the numbers of one of its equations taken from the fit.
fn parts(
    thesis: &Hypothesis,
    again: &Hypothesis,
    d: &crazyflie_identify::fit::filter::Disturbances,
    test: &[Flight],
) -> Vec<SubsetFit> {
    let with = |prefixes: &[&str]| {
        let mut model = thesis.model.clone();
        for (path, value, _) in again.model.parameters() {
            if prefixes.iter().any(|p| path.starts_with(p)) {
                model = model.with_parameter(&path, value).unwrap_or(model);
            }
        }
        Hypothesis::from_model(&model)
    };
    let which: [(&'static str, &[&str]); 4] = [
        ("5.1, roll and pitch fitted", &["roll.", "pitch."]),
        ("vertical: hover PWM fitted", &["vertical.thrust.hover"]),
        ("vertical: hover PWM and heave fitted", &["vertical.thrust."]),
        ("all but 5.1 fitted", &["vertical.thrust.", "lateral.drag"]),
    ];
    let part = |(what, prefixes): (&'static str, &[&str])| {
        let e = errors::compare_errors((thesis, d, test), (&with(prefixes), d, test));
        SubsetFit { what, attitude_rad: e.after[2][2], velocity_mps: e.after[1][3], p_value: e.p_value[1][3] }
    };
    which.into_iter().map(part).collect()
}
