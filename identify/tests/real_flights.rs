//! Identification of a real vehicle, on cuts of two flights under motion capture.

use std::path::Path;

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_identify::FlightLog;
use crazyflie_identify::axis_errors::axis_changes;
use crazyflie_identify::estimate::IdentifyError;
use crazyflie_identify::vehicle::{FitOptions, ModelComparison, identify, ubiquitous_effects};
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

#[test]
fn one_flight_under_two_names_is_one_flight() {
    let (fast, slow) = (read(FAST), read(SLOW));
    let again = shortened(&fast, 400);
    assert!(
        fast.1.is_same_flight(&again.1) && again.1.is_same_flight(&fast.1) && !fast.1.is_same_flight(&slow.1)
    );
    assert_eq!(first_duplicate(&[&slow.1, &fast.1, &again.1]), Some([1, 2]));
    let refused = identify(&Model::thesis(), &[fast, again], &FitOptions::default(), &|| ());
    assert!(matches!(refused, Err(IdentifyError::Duplicate { .. })), "{refused:?}");
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
    let found = identify(&Model::thesis(), &fit, &plan, &|| ()).unwrap();
    assert!(found.converged);
    for p in &found.parameters {
        assert!(!p.at_bound && p.standard_error.is_finite(), "{p:?}");
    }
    let model = Model::parse(&found.model.to_toml().unwrap()).unwrap();
    assert_eq!(
        (&model.name[..], model.vehicle.mass.value, model.vertical.default),
        ("mine", 0.034, Some(VerticalInput::Thrust))
    );
    assert!(model.effects.contains_key("thrust_slope") && !model.effects.contains_key("imu_tilt"));
    // the hover PWM of each flight is its own, near the median command
    let (_, _, hover_pwm) = found.fit.trims[0].values.iter().find(|(name, ..)| name == "hover_pwm").unwrap();
    assert!((40_000.0..75_000.0).contains(hover_pwm), "{hover_pwm}");
    let (before, after) =
        (found.compare_with(&Model::thesis(), &test).unwrap(), found.compare_logs(&test).unwrap());
    assert!(error(&after, "sideways") < 0.25 && error(&after, "vertical") < 0.35, "{:?}", after.errors);
    assert!(
        error(&after, "velocity") < 0.3 * error(&before, "velocity"),
        "{:?} {:?}",
        before.errors,
        after.errors
    );
}
