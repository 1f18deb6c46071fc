//! Slopes of the likelihood and predictions without slopes, on a committed flight.

mod common;

use common::flight_and_model;
use crazyflie_env::effects::{Role, find, registry};
use crazyflie_identify::explain::noise::FLOOR;
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::filter::{Disturbances, GaussMarkov};
use crazyflie_identify::fit::flight::{WINDOW_S, Window};
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::likelihood_slopes::likelihood_slopes;
use crazyflie_identify::fit::predict::{MeanSimulator, SensitivitySimulator};

/// With a free effect, at its first parameters' values.
fn with(hypothesis: &Hypothesis, effect: &str, value: f64) -> Hypothesis {
    let mut term = Term::off(find(effect).unwrap().1);
    term.values[0] = value;
    term.free = vec![0];
    hypothesis.with(term)
}

#[test]
fn slopes_are_those_of_the_likelihood() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let flights = [flight];
    let search = Search::new(&flights);
    let joint =
        with(&with(&with(&declared, "drag_linear", 0.3), "heave_damping", 0.1), "attitude_gain", 0.98);
    let values = joint.free_values();
    let slopes = likelihood_slopes(&flights[0], &joint, &FLOOR).unwrap();
    let loss = |at: &[f64]| search.plug_in(&joint.with_values(at), &FLOOR).unwrap();
    assert!((slopes.loss - loss(&values)).abs() < 1e-6 * slopes.loss.abs());
    for (i, value) in values.iter().enumerate() {
        let step = 0.003;
        let [high, low] = [step, -step].map(|by| {
            let mut moved = values.clone();
            moved[i] = value + by;
            loss(&moved)
        });
        let (slope, bend) = ((low - high) / (2.0 * step), (high + low - 2.0 * slopes.loss) / (step * step));
        println!(
            "{i}: {} by difference {slope}, {} by difference {bend}",
            slopes.gradient[i],
            slopes.information[(i, i)]
        );
        // the slope omits the parameter's part in the spread: a standard error or two
        let (off, sd) = ((slopes.gradient[i] - slope).abs(), slopes.information[(i, i)].sqrt());
        assert!(off < 0.03 * slope.abs() + 2.0 * sd, "{} against {slope}", slopes.gradient[i]);
        assert!(
            (slopes.information[(i, i)] / bend - 1.0).abs() < 0.2,
            "{} against {bend}",
            slopes.information[(i, i)]
        );
    }
    assert_eq!(slopes.information[(0, 2)], slopes.information[(2, 0)]);
}

#[test]
fn slopes_hold_under_any_disturbances() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let joint = with(&declared, "drag_linear", 0.3);
    let none = GaussMarkov { sigma: 0.0, tau_s: 1.0 };
    let calm = Disturbances { force: none, lift: none, torque: none, turn: none, marker: none };
    let calm = likelihood_slopes(&flight, &joint, &calm).unwrap();
    let mut gusty = FLOOR;
    gusty.force.sigma = 0.5;
    let shaken = likelihood_slopes(&flight, &joint, &gusty).unwrap();
    assert!(calm.information[(0, 0)] > 10.0 * shaken.information[(0, 0)], "a gust hides a drag");
}

#[test]
fn predictions_without_slopes_are_the_same_numbers() {
    let (flight, model) = flight_and_model("d01");
    let declared = Hypothesis::from_model(&model);
    let hypothesis = with(&with(&declared, "drag_linear", 0.4), "cmd_delay", 0.04);
    let mut mean = MeanSimulator::new(&hypothesis, &flight, false).unwrap();
    let mut dual = SensitivitySimulator::new(&hypothesis, &flight, false).unwrap();
    for window in flight.windows(0, WINDOW_S).iter().step_by(7) {
        let own = flight.measured_numbers(window.ticks.start);
        mean.predict(&flight, window, &own);
        dual.predict(&flight, window, &own);
        let values = |rows: &[crazyflie_identify::fit::predict::PredictedMeasurement]| {
            rows.iter().map(|r| r.predicted.to_bits()).collect::<Vec<_>>()
        };
        assert!(!mean.rows().is_empty() && mean.slopes().all(<[f64]>::is_empty));
        assert_eq!(values(mean.rows()), values(dual.rows()));
    }
}

/// An effect's memory continues from tick to tick, and so does the velocity that pushes expect.
#[test]
fn every_effect_acts_tick_by_tick_as_in_a_long_window() {
    let (flight, model) = flight_and_model("d01");
    let window = Window { flight: 0, ticks: 500..700 };
    for entry in registry().iter().filter(|entry| entry.observability.is_expected()) {
        let mut term = Term::off(entry);
        for (value, p) in term.values.iter_mut().zip(entry.params) {
            *value = if p.role == Role::Choice { p.high } else { p.off + 0.1 * (p.farthest_bound() - p.off) };
        }
        term.free.clear();
        let hypothesis = Hypothesis::from_model(&model).with(term);
        let simulator = || MeanSimulator::new(&hypothesis, &flight, false).unwrap();
        let (mut long, mut short) = (simulator(), simulator());
        let mut own = flight.measured_numbers(window.ticks.start);
        let lags = long.initial_lags(&flight, window.ticks.start, &own);
        short.warm_up(&flight, window.ticks.start, &own);
        own.extend(lags);
        long.predict_from(&flight, &window, &own);
        for tick in window.ticks.clone() {
            short.predict_from(&flight, &Window { flight: 0, ticks: tick..tick + 1 }, &own);
            short.remember_tick(flight.tick_s);
            own = short.end().0.to_vec();
        }
        let off = long.end().0.iter().zip(&own).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-5, "{}: {off:.1e}", entry.name);
    }
}

#[test]
fn a_late_frame_shows_the_same_place_tick_by_tick_as_in_a_long_window() {
    let (flight, model) = flight_and_model("d01");
    let mut late = Term::off(find("camera_latency").unwrap().1);
    (late.values[1], late.free) = (0.095, Vec::new());
    let hypothesis = Hypothesis::from_model(&model).with(late);
    let simulator = || MeanSimulator::new(&hypothesis, &flight, false).unwrap();
    let (mut long, mut short, mut without_past) = (simulator(), simulator(), simulator());
    let (mut worst_m, mut worst_without_m) = (0.0_f64, 0.0_f64);
    for window in flight.windows(0, WINDOW_S) {
        let places = |simulator: &MeanSimulator| -> Vec<f64> {
            simulator.rows().iter().filter(|row| row.channel >= 3).map(|row| row.predicted).collect()
        };
        let mut own = flight.measured_numbers(window.ticks.start);
        long.predict(&flight, &window, &own);
        short.warm_up(&flight, window.ticks.start, &own);
        without_past.warm_up(&flight, window.ticks.start, &own);
        let (mut seen, mut seen_without) = (Vec::new(), Vec::new());
        for tick in window.ticks.clone() {
            let one = Window { flight: 0, ticks: tick..tick + 1 };
            short.predict_from(&flight, &one, &own);
            without_past.predict_from(&flight, &one, &own);
            seen.extend(places(&short));
            seen_without.extend(places(&without_past));
            short.remember_tick(flight.tick_s);
            own = short.end().0.to_vec();
        }
        // frames of the first 0.1 s show what was before the window
        let first = 3 * 4;
        for (i, place) in places(&long).iter().enumerate().skip(first) {
            worst_m = worst_m.max((place - seen[i]).abs());
            worst_without_m = worst_without_m.max((place - seen_without[i]).abs());
        }
    }
    println!("at most {worst_m:.1e} m, {worst_without_m:.1e} m without the ticks before");
    assert!(worst_m < 5e-5 && worst_without_m > 10.0 * worst_m, "{worst_m} m, {worst_without_m} m");
}
