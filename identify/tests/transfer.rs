//! Transfer functions are recovered from records that an independent integration made.

use crazyflie_identify::Error;
use crazyflie_identify::estimate::{Clusters, ResidualTests};
use crazyflie_identify::transfer::{
    Channel, Offset, Record, Structure, TransferFunctionEstimate, WindowLength, identify,
};

/// Normal numbers of a linear congruential generator.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

struct Plant {
    /// b / (s^2 + a1 s + a0), behind a delay
    b: f64,
    a1: f64,
    a0: f64,
    delay_s: f64,
    offset: f64,
}

const ROLL: Plant = Plant { b: 123.2, a1: 31.86, a0: 81.85, delay_s: 0.0, offset: 0.0 };

/// A record of `seconds`: steps of random height and length, integrated in steps of 0.1 ms by the midpoint
/// rule.
fn record(plant: &Plant, seed: u64, seconds: f64, sigma: f64) -> Record {
    let mut noise = Noise(seed);
    let (tick_s, fine) = (0.01, 100);
    let (mut input, mut held) = (Vec::new(), 0.0);
    for _ in 0..(seconds / tick_s) as usize {
        if noise.uniform() < 0.03 {
            held = 0.3 * (noise.uniform() - 0.5);
        }
        input.push(held);
    }
    let (mut y, mut v) = (0.0, 0.0);
    let (mut output, mut output_t_s) = (Vec::new(), Vec::new());
    for k in 0..input.len() {
        for i in 0..fine {
            let h = tick_s / f64::from(fine);
            let t = k as f64 * tick_s + f64::from(i) * h - plant.delay_s + 0.5 * h;
            let u = input[(t / tick_s).max(0.0) as usize] - plant.offset;
            let acc = |y: f64, v: f64| plant.b * u - plant.a1 * v - plant.a0 * y;
            let (my, mv) = (y + 0.5 * h * v, v + 0.5 * h * acc(y, v));
            (y, v) = (y + h * mv, v + h * acc(my, mv));
        }
        output.push(y + sigma * noise.normal());
        output_t_s.push((k + 1) as f64 * tick_s);
    }
    let input_t_s = (0..input.len()).map(|k| k as f64 * tick_s).collect();
    Record {
        name: format!("r{seed}"),
        input_t_s,
        input,
        output_t_s,
        output,
        span_s: [0.0, seconds],
        integrated: false,
    }
}

fn order(numerator: usize, denominator: usize) -> Structure {
    Structure { numerator, denominator, integrator: false, delay: false, offset: Offset::None, stable: true }
}

fn assert_near(found: &TransferFunctionEstimate, truth: &[f64], share: f64) {
    for (p, truth) in found.parameters.iter().zip(truth) {
        let off = (p.value - truth).abs();
        assert!(
            off < share * truth.abs() && off < 4.5 * p.standard_error,
            "{} {} +- {}, truly {truth}",
            p.name,
            p.value,
            p.standard_error
        );
    }
}

#[test]
fn a_second_order_comes_back_without_a_guess() {
    let records = [record(&ROLL, 1, 20.0, 0.005), record(&ROLL, 2, 20.0, 0.005)];
    let fitted = identify(&records, Channel::Roll, order(0, 2), WindowLength::OfChannel).unwrap();
    assert!(fitted.converged && fitted.clusters == Clusters::Windows(8), "{}", fitted.clusters);
    assert_near(&fitted, &[123.2, 31.86, 81.85], 0.06);
    assert!((fitted.noise - 0.005).abs() < 2e-4, "{}", fitted.noise);
    let all: Vec<_> = fitted.fit.iter().collect();
    let residuals = ResidualTests::new(&all, 3);
    assert!(residuals.whiteness.unwrap().p_value > 0.001 && residuals.independence.unwrap().is_independent());
    let test = fitted.compare(&[record(&ROLL, 3, 10.0, 0.0)]).unwrap();
    assert!(test[0].whole.unwrap().fit_percent.unwrap() > 98.0, "{:?}", test[0].whole);
}

#[test]
fn a_delay_of_any_fraction_of_a_sample_is_found() {
    let late = Plant { delay_s: 0.0373, ..ROLL };
    let records = [record(&late, 5, 30.0, 0.003)];
    let fitted =
        identify(&records, Channel::Roll, Structure { delay: true, ..order(0, 2) }, WindowLength::OfChannel)
            .unwrap();
    assert_near(&fitted, &[123.2, 31.86, 81.85, 0.0373], 0.08);
    assert!((fitted.function.delay_s - 0.0373).abs() < 0.002);
    // without a delay, residuals still depend on the input
    let without = identify(&records, Channel::Roll, order(0, 2), WindowLength::OfChannel).unwrap();
    let all: Vec<_> = without.fit.iter().collect();
    assert!(!ResidualTests::new(&all, 3).independence.unwrap().is_independent());
    assert!(without.criteria.bic > fitted.criteria.bic + 10.0);
}

#[test]
fn the_order_that_made_the_data_has_the_best_criterion() {
    let records = [record(&ROLL, 7, 30.0, 0.003)];
    let bic =
        |n, d| identify(&records, Channel::Roll, order(n, d), WindowLength::OfChannel).unwrap().criteria.bic;
    let right = bic(0, 2);
    assert!(right < bic(0, 1) - 10.0 && right < bic(1, 2) && right < bic(0, 3));
}

#[test]
fn offsets_per_flight() {
    let flights = [0.05, -0.08].map(|offset| Plant { offset, ..ROLL });
    let records = [record(&flights[0], 11, 20.0, 0.003), record(&flights[1], 12, 20.0, 0.003)];
    let fitted = identify(
        &records,
        Channel::Roll,
        Structure { offset: Offset::PerFlight, ..order(0, 2) },
        WindowLength::OfChannel,
    )
    .unwrap();
    assert_near(&fitted, &[123.2, 31.86, 81.85, 0.05, -0.08], 0.08);
    assert_eq!(fitted.parameters[4].name, "offset r12");
}

#[test]
fn an_integrator_seen_as_a_position() {
    // velocity = 9.81 / s of the angle, position measured
    let plant = Plant { b: 9.81, a1: 0.0, a0: 0.0, ..ROLL };
    let records = [Record { integrated: true, ..record(&plant, 21, 20.0, 0.005) }];
    let fitted = identify(&records, Channel::Vx, Channel::Vx.structure(), WindowLength::OfChannel).unwrap();
    assert_near(&fitted, &[9.81], 0.02);
    assert_eq!(fitted.fit[0].signal, "x");
}

#[test]
fn what_the_data_does_not_tell_is_said() {
    let still = Record { input: vec![0.1; 2000], ..record(&ROLL, 1, 20.0, 0.005) };
    let refused = |records: &[Record], structure| {
        identify(records, Channel::Roll, structure, WindowLength::OfChannel).unwrap_err()
    };
    let message = refused(std::slice::from_ref(&still), order(0, 2)).to_string();
    assert!(message.contains("roll command does not move"), "{message}");
    assert_eq!(refused(&[], order(0, 2)).to_string(), "there is no log to identify from");
    assert!(refused(&[still], order(3, 2)).to_string().contains("of order 3,2 is not supported"));
    let short =
        identify(&[record(&ROLL, 1, 20.0, 0.005)], Channel::Roll, order(0, 2), WindowLength::Seconds(0.1))
            .unwrap_err();
    assert!(matches!(short, Error::Options(_)));
}
