//! Identification of a real vehicle, on cuts of two flights under motion capture.

use std::path::Path;

use crazyflie_env::model::{Model, PwmSource, VerticalInput};
use crazyflie_identify::Error;
use crazyflie_identify::FlightLog;
use crazyflie_identify::axis_errors::axis_changes;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::Hypothesis;
use crazyflie_identify::fit::output_error::OutputErrorProblem;
use crazyflie_identify::fit::solve::Problem;
use crazyflie_identify::motor::flight::MotorFlight;
use crazyflie_identify::vehicle::{
    FitOptions, ModelComparison, best_pwm_source, identify, ubiquitous_effects,
};
use crazyflie_logs::first_duplicate;

const FAST: &str = "B3_figure8_fast_rep1";
const SLOW: &str = "B3_figure8_slow_rep1";

fn read(name: &str) -> (String, FlightLog) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../tests/data/nanobench/{name}.csv.gz"));
    (name.to_owned(), FlightLog::read(&path).unwrap())
}

/// The flight without its last fixes, under another name.
fn shortened((_, log): &(String, FlightLog), fixes: usize) -> (String, FlightLog) {
    let mut cut = log.clone();
    let kept = cut.fixes.row.len() - fixes;
    cut.fixes.row.truncate(kept);
    cut.fixes.capture_t_s.truncate(kept);
    cut.fixes.pos_m.iter_mut().for_each(|axis| axis.truncate(kept));
    ("another name".to_owned(), cut)
}

fn error(judged: &ModelComparison, axis: &str) -> f64 {
    let changes = axis_changes(&judged.errors, &judged.errors);
    changes.iter().find(|c| c.axis == axis && c.horizon_s == 2.0).unwrap().after
}

#[test]
fn a_flight_is_airborne_above_where_it_stood() {
    let (_, log) = read(FAST);
    let z = &log.fixes.pos_m[2];
    let rest_m = z[..40].iter().sum::<f64>() / 40.0;
    assert!((0.05..0.08).contains(&rest_m), "{rest_m}");
    let first = log.airborne.start;
    assert!(z[first] > rest_m + 0.05 && z[first - 1] <= rest_m + 0.05, "{} {}", z[first], z[first - 1]);
}

/// A log that lacked one position of many was left out.
#[test]
fn a_repeated_position_is_no_missing_row() {
    let (name, mut log) = read(FAST);
    let all = MotorFlight::from_log(&name, &log).unwrap();
    let kept = |i: &usize| i % 3 != 1;
    let fixes = &mut log.fixes;
    fixes.row = (0..fixes.row.len()).filter(kept).map(|i| fixes.row[i]).collect();
    fixes.capture_t_s = (0..fixes.capture_t_s.len()).filter(kept).map(|i| fixes.capture_t_s[i]).collect();
    for axis in &mut fixes.pos_m {
        *axis = (0..axis.len()).filter(kept).map(|i| axis[i]).collect();
    }
    let fewer = MotorFlight::from_log(&name, &log).unwrap();
    let shared = all.motion.len().min(fewer.motion.len());
    assert!(all.motion.len() - shared < 3);
    for (a, b) in
        all.motion[all.motion.len() - shared..].iter().zip(&fewer.motion[fewer.motion.len() - shared..])
    {
        assert!((0..3).all(|i| (a[i] - b[i]).abs() < 2e-3), "{a:?} {b:?}");
    }
}

#[test]
fn one_flight_under_two_names_is_one_flight() {
    let (fast, slow) = (read(FAST), read(SLOW));
    let again = shortened(&fast, 400);
    assert!(
        fast.1.is_same_flight(&again.1) && again.1.is_same_flight(&fast.1) && !fast.1.is_same_flight(&slow.1)
    );
    assert_eq!(first_duplicate(&[&slow.1, &fast.1, &again.1]), Some([1, 2]));
    let refused = identify(&Model::thesis(), &[fast, again], &FitOptions::default(), &|| ());
    assert!(matches!(refused, Err(Error::Options(_))), "{refused:?}");
}

#[test]
fn a_real_vehicle_is_identified_and_predicts_a_flight_that_was_not_fitted() {
    let (fit, test) = ([read(FAST)], [read(SLOW)]);
    let plan = FitOptions {
        nuisance: true,
        // ten seconds do not tell what the battery does
        effects: ubiquitous_effects(&fit).into_iter().filter(|name| name != "battery_sag").collect(),
        name: Some("mine".into()),
        mass_kg: Some(0.034),
        vertical: Some(VerticalInput::Thrust),
        ..FitOptions::default()
    };
    let fitted = identify(&Model::thesis(), &fit, &plan, &|| ()).unwrap();
    assert!(fitted.converged);
    for p in &fitted.parameters {
        assert!(!p.at_bound && p.standard_error.is_finite(), "{p:?}");
    }
    let model = Model::parse(&fitted.model.to_toml().unwrap()).unwrap();
    assert_eq!(
        (&model.name[..], model.vehicle.mass.value, model.vertical.default),
        ("mine", 0.034, Some(VerticalInput::Thrust))
    );
    assert!(model.effects.contains_key("thrust_slope") && !model.effects.contains_key("imu_tilt"));
    // the hover PWM of each flight is its own, near the median command
    let (_, _, hover_pwm) = fitted.fit.trims[0].values.iter().find(|(name, ..)| name == "hover_pwm").unwrap();
    assert!((40_000.0..75_000.0).contains(hover_pwm), "{hover_pwm}");
    let (before, after) =
        (fitted.compare_with(&Model::thesis(), &test).unwrap(), fitted.compare_logs(&test).unwrap());
    assert!(error(&after, "sideways") < 0.25 && error(&after, "vertical") < 0.35, "{:?}", after.errors);
    assert!(
        error(&after, "velocity") < 0.3 * error(&before, "velocity"),
        "{:?} {:?}",
        before.errors,
        after.errors
    );
}

#[test]
fn one_flight_does_not_tell_how_motors_warm_up() {
    let mut all = [FAST, SLOW, FAST, SLOW].map(read);
    let tells =
        |logs: &[(String, FlightLog)]| ubiquitous_effects(logs).iter().any(|name| name == "motor_warming");
    assert!(tells(&all) && !tells(&all[..3]));
    all[2].1.vbat_v = None;
    assert!(!tells(&all));
}

#[test]
fn motors_drive_a_model_that_was_identified_with_them() {
    let (fit, test) = ([read(FAST)], [read(SLOW)]);
    assert_eq!(best_pwm_source(&fit), PwmSource::Motors);
    let plan = FitOptions {
        nuisance: true,
        effects: vec!["thrust_slope".to_owned()],
        vertical: Some(VerticalInput::Thrust),
        pwm_source: Some(PwmSource::Motors),
        ..FitOptions::default()
    };
    let fitted = identify(&Model::thesis(), &fit, &plan, &|| ()).unwrap();
    let model = Model::parse(&fitted.model.to_toml().unwrap()).unwrap();
    assert_eq!(model.vertical.pwm_source, PwmSource::Motors);
    // on another scale than the command: 56 000 there, at 4.2 V here
    let hover = model.parameter("vertical.thrust.hover").unwrap();
    let pwm = fit[0].1.motor_pwm_at(4.2).unwrap();
    let flown = pwm[fit[0].1.airborne.clone()].iter().sum::<f64>() / fit[0].1.airborne.len() as f64;
    assert!((hover / flown - 1.0).abs() < 0.1 && hover < 50_000.0, "{hover} {flown}");
    assert!(error(&fitted.compare_logs(&test).unwrap(), "vertical") < 0.35);
    let mut blind = test[0].1.clone();
    blind.vbat_v = None;
    assert_eq!(best_pwm_source(&[("blind".to_owned(), blind.clone())]), PwmSource::Command);
    let refused = Flight::from_log("blind", &blind, &model, None).unwrap_err();
    assert!(matches!(refused, Error::Logs(_)), "{refused}");
    assert!(refused.to_string().contains("motor PWM with battery voltage"), "{refused}");
}

/// It once left the slopes as they were, so that a step was a share of what it should have been.
#[test]
fn standard_deviations_taken_larger_change_the_gradient_with_the_loss() {
    let model = Model::thesis();
    let (name, log) = read(SLOW);
    let flights = [Flight::from_log(&name, &log, &model, Some(VerticalInput::Thrust)).unwrap()];
    let windows = flights[0].windows(0, 2.0);
    let hypothesis = Hypothesis::from_model(&model);
    for inflation in [1.0, 25.0] {
        let problem = OutputErrorProblem {
            flights: &flights,
            windows: &windows[1..2],
            hypothesis: &hypothesis,
            inflation,
        };
        let equations = |own: &[f64]| {
            let mut worker = problem.worker(&problem.shared());
            problem.normal_equations(&mut worker, 0, own)
        };
        let own = &problem.measured_starts()[0];
        for number in 0..6 {
            let step = 1e-5;
            let moved = |sign: f64| {
                let mut own = own.clone();
                own[number] += sign * step;
                equations(&own).loss
            };
            let expected = (moved(-1.0) - moved(1.0)) / (2.0 * step);
            let gradient = equations(own).gradient[number];
            assert!(
                (gradient - expected).abs() < 1e-3 * expected.abs().max(1.0),
                "{inflation}, {number}: {gradient} for {expected}"
            );
        }
    }
}
