//! The response of a transfer function to a held input, exact at any time, with derivatives by every number.
//!
//! Times are counted in clock ticks of 10 us, so that the few distances between inputs and samples that a log
//! has are found again and their matrix exponentials computed once. The delay is not rounded: it moves all
//! inputs against all samples.

use std::collections::HashMap;

use crazyflie_env::dual::{DIRECTIONS, Dual};
use crazyflie_env::scalar::Scalar;

use super::channel::Record;
use super::structure::{DELAY_MAX_S, Structure};

/// Finer than any log's clock.
const CLOCK_S: f64 = 1e-5;
/// With the matrix halved below 1/2, the remainder is below 1e-15.
const TAYLOR: usize = 13;

/// A segment of a record: the inputs that reach it, and the samples after its start up to its end.
#[derive(Debug, Clone)]
pub(super) struct Segment {
    pub flight: usize,
    start: i64,
    inputs: Vec<(i64, f64)>,
    samples: Vec<(i64, f64)>,
}

impl Segment {
    /// Cuts a record into segments of about a length; `None` for one segment.
    pub fn cut(flight: usize, record: &Record, length_s: Option<f64>) -> Vec<Segment> {
        let [from_s, to_s] = record.span_s;
        let count = length_s.map_or(1.0, |length_s| ((to_s - from_s) / length_s).floor()).max(1.0);
        let edge = |i: f64| from_s + (to_s - from_s) * i / count;
        let segment = |i: usize| Segment::between(flight, record, edge(i as f64), edge(i as f64 + 1.0));
        let each = (0..count as usize).map(segment);
        each.filter(|s| !s.samples.is_empty()).collect()
    }

    fn between(flight: usize, record: &Record, from_s: f64, to_s: f64) -> Segment {
        let clock = |t_s: f64| ((t_s - record.span_s[0]) / CLOCK_S).round() as i64;
        let (start, end) = (clock(from_s), clock(to_s));
        // the last input that the longest delay brings here, and all after it
        let first = record.input_t_s.partition_point(|t| *t <= from_s - DELAY_MAX_S).saturating_sub(1);
        let last = record.input_t_s.partition_point(|t| *t < to_s);
        let inputs =
            (first..last.max(first + 1)).map(|i| (clock(record.input_t_s[i]), record.input[i])).collect();
        let samples = record.output_t_s.iter().zip(&record.output).map(|(t, y)| (clock(*t), *y));
        let samples = samples.filter(|(t, _)| (start + 1..=end).contains(t)).collect();
        Segment { flight, start, inputs, samples }
    }

    pub fn samples(&self) -> impl Iterator<Item = f64> + '_ {
        self.samples.iter().map(|(_, y)| *y)
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }
}

/// An instant: a number of clock ticks, delayed or not.
#[derive(Clone, Copy)]
struct Instant {
    clock: i64,
    delayed: bool,
}

/// x -> state x + input u over some duration.
struct Transition {
    state: Vec<Dual>,
    input: Vec<Dual>,
}

/// The transfer function in observer form: y = x0, x0' = -a_(n-1) x0 + x1 + b_(n-1) u, and so on. Directions
/// of the duals: states, then [`Structure::dynamic`], then the offset.
pub(super) struct Simulator {
    states: usize,
    output: usize,
    a: Vec<Dual>,
    b: Vec<Dual>,
    delay: Dual,
    /// The delay in clock ticks.
    late: f64,
    offset_direction: usize,
    transitions: HashMap<(i64, bool, bool), Transition>,
}

impl Simulator {
    pub fn new(structure: &Structure, integrated: bool, numbers: &[f64]) -> Self {
        let n = structure.denominator;
        let states = n + usize::from(integrated);
        let dynamic = numbers[..structure.dynamic()].iter().enumerate();
        let dynamic: Vec<Dual> = dynamic.map(|(i, v)| Dual::variable(*v, states + i)).collect();
        let factors = structure.factors(&dynamic, Dual::from_f64(1.0), Dual::from_f64(0.0));
        let denominator = factors.iter().fold(vec![Dual::from_f64(1.0)], |product, factor| {
            let mut next = vec![Dual::from_f64(0.0); product.len() + factor.len() - 1];
            for (i, x) in product.iter().enumerate() {
                for (j, y) in factor.iter().enumerate() {
                    next[i + j] += *x * *y;
                }
            }
            next
        });
        let (mut a, mut b) = (vec![Dual::from_f64(0.0); states * states], vec![Dual::from_f64(0.0); states]);
        for i in 0..n {
            a[i * states] = -denominator[i + 1];
            if i + 1 < n {
                a[i * states + i + 1] = Dual::from_f64(1.0);
            }
        }
        b[n - 1 - structure.numerator..n].copy_from_slice(&dynamic[..=structure.numerator]);
        if integrated {
            a[n * states] = Dual::from_f64(1.0);
        }
        let delay = if structure.delay { dynamic[structure.dynamic() - 1] } else { Dual::from_f64(0.0) };
        let (output, late) = (if integrated { n } else { 0 }, delay.value / CLOCK_S);
        let (offset_direction, transitions) = (states + structure.dynamic(), HashMap::new());
        Simulator { states, output, a, b, delay, late, offset_direction, transitions }
    }

    /// The output at every sample of a segment that starts from a state, the input counting from its offset.
    pub fn run(&mut self, segment: &Segment, start: &[f64], offset: f64, mut each: impl FnMut(f64, Dual)) {
        let mut x: Vec<Dual> = start.iter().enumerate().map(|(i, v)| Dual::variable(*v, i)).collect();
        let offset = if self.offset_direction < DIRECTIONS {
            Dual::variable(offset, self.offset_direction)
        } else {
            Dual::from_f64(offset)
        };
        let late = self.late;
        let mut next =
            segment.inputs.partition_point(|(t, _)| *t as f64 + late <= segment.start as f64).max(1);
        let mut u = Dual::from_f64(segment.inputs[next - 1].1) - offset;
        let mut now = Instant { clock: segment.start, delayed: false };
        for (clock, measured) in &segment.samples {
            while next < segment.inputs.len() && segment.inputs[next].0 as f64 + late < *clock as f64 {
                let then = Instant { clock: segment.inputs[next].0, delayed: true };
                x = self.transition(now, then).propagate(&x, u);
                u = Dual::from_f64(segment.inputs[next].1) - offset;
                (now, next) = (then, next + 1);
            }
            let then = Instant { clock: *clock, delayed: false };
            x = self.transition(now, then).propagate(&x, u);
            now = then;
            each(*measured, x[self.output]);
        }
    }

    fn transition(&mut self, from: Instant, to: Instant) -> &Transition {
        let key = (to.clock - from.clock, from.delayed, to.delayed);
        if !self.transitions.contains_key(&key) {
            let mut duration = Dual::from_f64(key.0 as f64 * CLOCK_S);
            match (from.delayed, to.delayed) {
                (false, true) => duration += self.delay,
                (true, false) => duration -= self.delay,
                _ => {}
            }
            let transition = self.discretise(duration);
            self.transitions.insert(key, transition);
        }
        &self.transitions[&key]
    }

    /// exp of the system and its held input.
    fn discretise(&self, duration: Dual) -> Transition {
        let (n, k) = (self.states, self.states + 1);
        let mut m = vec![Dual::from_f64(0.0); k * k];
        for i in 0..n {
            for j in 0..n {
                m[i * k + j] = self.a[i * n + j] * duration;
            }
            m[i * k + n] = self.b[i] * duration;
        }
        let e = exponential(m, k);
        let state = (0..n * n).map(|i| e[i / n * k + i % n]).collect();
        Transition { state, input: (0..n).map(|i| e[i * k + n]).collect() }
    }
}

impl Transition {
    fn propagate(&self, x: &[Dual], u: Dual) -> Vec<Dual> {
        let n = x.len();
        let row = |i: usize| {
            let state = self.state[i * n..].iter().zip(x);
            state.fold(self.input[i] * u, |sum, (entry, x)| sum + *entry * *x)
        };
        (0..n).map(row).collect()
    }
}

/// By scaling, the Taylor polynomial and squaring.
fn exponential(mut m: Vec<Dual>, k: usize) -> Vec<Dual> {
    // columns are as different in size as units: what counts are the eigenvalues, and the last column is of
    // no power
    let norm = (0..k).map(|i| (0..k - 1).map(|j| m[i * k + j].value.abs()).sum::<f64>()).fold(0.0, f64::max);
    let halvings = if norm.is_finite() { (norm / 0.5).log2().ceil().clamp(0.0, 60.0) as i32 } else { 0 };
    let scale = Dual::from_f64(0.5_f64.powi(halvings));
    for entry in &mut m {
        *entry = *entry * scale;
    }
    let add_one = |mut p: Vec<Dual>| {
        (0..k).for_each(|i| p[i * k + i] += Dual::from_f64(1.0));
        p
    };
    let mut power = add_one(vec![Dual::from_f64(0.0); k * k]);
    for term in (1..=TAYLOR).rev() {
        let by = Dual::from_f64(1.0 / term as f64);
        power = add_one(product(&m, &power, k).into_iter().map(|v| v * by).collect());
    }
    (0..halvings).fold(power, |p, _| product(&p, &p, k))
}

fn product(a: &[Dual], b: &[Dual], k: usize) -> Vec<Dual> {
    let mut c = vec![Dual::from_f64(0.0); k * k];
    for i in 0..k {
        for l in 0..k {
            for j in 0..k {
                c[i * k + j] += a[i * k + l] * b[l * k + j];
            }
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::super::structure::Offset;
    use super::*;

    fn record(integrated: bool) -> Record {
        let input_t_s: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.02).collect();
        // one step, at 1 s
        let input = input_t_s.iter().map(|t| f64::from(u8::from(*t > 0.99))).collect();
        let output_t_s: Vec<f64> = (1..115).map(|i| f64::from(i) * 0.0333).collect();
        let output = vec![0.0; output_t_s.len()];
        Record { name: "step".into(), input_t_s, input, output_t_s, output, span_s: [0.0, 3.98], integrated }
    }

    fn simulate(structure: &Structure, integrated: bool, numbers: &[f64], offset: f64) -> Vec<Dual> {
        let segment = &Segment::cut(0, &record(integrated), None)[0];
        let mut simulator = Simulator::new(structure, integrated, numbers);
        let start = vec![0.0; structure.denominator + usize::from(integrated)];
        let mut all = Vec::new();
        simulator.run(segment, &start, offset, |_, y| all.push(y));
        all
    }

    #[test]
    fn a_delayed_step_is_answered_in_closed_form() {
        // (s + 3) / ((s + 2)(s + 5)) after 37.31 ms, which fall on no tick
        let form = Structure {
            numerator: 1,
            denominator: 2,
            integrator: false,
            delay: true,
            offset: Offset::Shared,
            stable: true,
        };
        let all = simulate(&form, false, &[1.0, 3.0, 7.0, 10.0, 0.03731], 0.0);
        for (i, y) in all.iter().enumerate() {
            let t = (i + 1) as f64 * 0.0333 - 1.03731;
            // partial fractions: 3/10 - e^(-2t)/6 - 2 e^(-5t)/15
            let exact =
                if t > 0.0 { 0.3 - (-2.0 * t).exp() / 6.0 - 2.0 * (-5.0 * t).exp() / 15.0 } else { 0.0 };
            assert!((y.value - exact).abs() < 1e-12, "{i}: {} {exact}", y.value);
        }
    }

    #[test]
    fn slopes_are_the_derivatives() {
        let form = Structure {
            numerator: 1,
            denominator: 3,
            integrator: true,
            delay: true,
            offset: Offset::Shared,
            stable: true,
        };
        let numbers = [2.0, 30.0, 9.0, 25.0, 0.0213];
        for integrated in [false, true] {
            let outputs = |numbers: &[f64], offset| simulate(&form, integrated, numbers, offset);
            let here = outputs(&numbers, 0.2);
            let states = 3 + usize::from(integrated);
            for p in 0..=numbers.len() {
                let mut moved = numbers.to_vec();
                let h = 1e-6;
                let offset = if p < numbers.len() { 0.2 } else { 0.2 + h };
                if let Some(number) = moved.get_mut(p) {
                    *number += h;
                }
                for (i, (after, before)) in outputs(&moved, offset).iter().zip(&here).enumerate() {
                    let (slope, difference) =
                        (f64::from(before.slope[states + p]), (after.value - before.value) / h);
                    assert!(
                        (slope - difference).abs() < 2e-5 * (1.0 + difference.abs()),
                        "{p} {i}: {slope} {difference}"
                    );
                }
            }
        }
    }

    #[test]
    fn segments_share_no_sample_and_lose_none_but_the_first() {
        let all: usize = Segment::cut(0, &record(false), Some(0.9)).iter().map(Segment::len).sum();
        assert_eq!(Segment::cut(0, &record(false), Some(0.9)).len(), 4);
        assert_eq!(all, 114);
    }
}
