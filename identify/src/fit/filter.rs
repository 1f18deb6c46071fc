//! An extended Kalman filter around the simulator: its innovations tell whether anything is left, and its likelihood compares hypotheses.
//! Besides the vehicle's state it follows slow disturbances, and parameters of the hypothesis as constants still to be learned.

use std::ops::Range;

use crazyflie_env::dual::Dual;
use crazyflie_env::plant::Command;
use crazyflie_env::sim_scalar::SimScalar;

use super::flight::{Flight, Window};
use super::held::{AXES, Held};
use super::hypothesis::Hypothesis;
use super::predict::{Compared, PUSH, START, Worker};
use super::solve::HUBER;

/// How far off the measured start may be, in metres, metres per second, radians and radians per second.
const START_SD: [f64; 4] = [0.05, 0.3, 0.05, 1.0];

/// So much log-likelihood is not caught up within a stretch.
const HOPELESS: f64 = 40.0;

/// A first-order Gauss-Markov process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wander {
    /// Standard deviation; 0 for none.
    pub sigma: f64,
    /// Correlation time.
    pub tau_s: f64,
}

/// What is random about a flight beyond white measurement noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbances {
    /// Horizontal acceleration, m/s^2.
    pub force: Wander,
    /// Vertical acceleration, m/s^2.
    pub lift: Wander,
    /// Angular acceleration of roll and pitch, rad/s^2.
    pub torque: Wander,
    /// Angular acceleration of yaw, rad/s^2.
    pub turn: Wander,
    /// Position of the marker, m.
    pub marker: Wander,
}

impl Disturbances {
    pub const NONE: Disturbances = Disturbances {
        force: Wander { sigma: 0.0, tau_s: 1.0 },
        lift: Wander { sigma: 0.0, tau_s: 1.0 },
        torque: Wander { sigma: 0.0, tau_s: 0.3 },
        turn: Wander { sigma: 0.0, tau_s: 1.0 },
        marker: Wander { sigma: 0.0, tau_s: 3.0 },
    };

    /// One per disturbed number: the push, then the marker.
    fn all(&self) -> [Wander; PUSH + 3] {
        let Disturbances { force, lift, torque, turn, marker } = *self;
        [force, force, lift, torque, torque, turn, marker, marker, marker]
    }

    pub fn list_mut(&mut self) -> [&mut Wander; 5] {
        [&mut self.force, &mut self.lift, &mut self.torque, &mut self.turn, &mut self.marker]
    }
}

/// What is believed of the free parameters before a flight.
#[derive(Debug, Clone)]
pub struct Belief {
    pub mean: Vec<f64>,
    /// Covariance, row by row.
    pub covariance: Vec<f64>,
}

impl Belief {
    /// Independent parameters.
    pub fn independent(mean: Vec<f64>, sd: &[f64]) -> Self {
        let n = mean.len();
        let mut covariance = vec![0.0; n * n];
        for i in 0..n {
            covariance[i * n + i] = sd[i] * sd[i];
        }
        Belief { mean, covariance }
    }

    pub fn sd(&self, i: usize) -> f64 {
        self.covariance[i * self.mean.len() + i].max(0.0).sqrt()
    }
}

/// A measured number less its prediction from all that came before, in standard deviations of that difference.
#[derive(Debug, Clone, Copy)]
pub struct Innovation {
    pub t_s: f64,
    /// See [`super::predict::Compared::channel`].
    pub channel: usize,
    pub normalised: f64,
    /// Logarithm of that standard deviation, over the measurement's own.
    pub spread: f64,
    /// Its share of the negative log-likelihood.
    pub loss: f64,
}

/// A flight filtered.
#[derive(Debug, Clone)]
pub struct Filtered {
    /// Negative log-likelihood of the measurements, robust as in the fits.
    pub loss: f64,
    pub innovations: Vec<Innovation>,
    /// After the flight.
    pub belief: Belief,
    /// What the vehicle has of its own at the start of each tick (see [`Worker`]), from all measurements before it.
    pub states: Vec<Vec<f64>>,
    /// Estimated disturbance after each tick: push, then marker.
    pub wandered: Vec<[f64; PUSH + 3]>,
}

/// A state of the filter beyond the vehicle's.
struct Extra {
    /// Its column among the worker's slopes; a marker's error has none: it moves one measured axis.
    column: Option<usize>,
    axis: usize,
    /// What a unit of it is on that axis.
    unit: f64,
    keep: f64,
    /// Variance in the long run, and gained per tick.
    variance: f64,
    gain: f64,
}

/// The extra states: constants still to be learned, then those disturbances that are not nothing, then how far what is obeyed is off.
fn extras(flight: &Flight, own: usize, learned: usize, disturbances: &Disturbances, held: Option<&Held>) -> Vec<Extra> {
    let constant = |i: usize| Extra { column: Some(own + i), axis: 0, unit: 1.0, keep: 1.0, variance: 0.0, gain: 0.0 };
    let wandering = |(i, w): (usize, Wander)| {
        let (keep, variance) = ((-flight.tick_s / w.tau_s).exp(), w.sigma * w.sigma);
        let column = (i < PUSH).then_some(own + learned + i);
        Extra { column, axis: i, unit: 1.0, keep, variance, gain: variance * (1.0 - keep * keep) }
    };
    let disturbed = disturbances.all().into_iter().enumerate().filter(|(_, w)| w.sigma > 0.0);
    let obeyed = |held: &Held| {
        let Held { probability, push, variance, .. } = *held;
        let one = move |i: usize| {
            let column = Some(own + learned + AXES[i]);
            Extra { column, axis: AXES[i], unit: push[i], keep: probability, variance: variance[i], gain: 0.0 }
        };
        (0..AXES.len()).map(one)
    };
    (0..learned).map(constant).chain(disturbed.map(wandering)).chain(held.into_iter().flat_map(obeyed)).collect()
}

/// Estimate and covariance, with room to compute.
struct Kalman {
    own: usize,
    learned: usize,
    extras: Vec<Extra>,
    held: Option<Held>,
    x: Vec<f64>,
    p: Vec<f64>,
    h: Vec<f64>,
    ph: Vec<f64>,
    /// How far the measurements of a tick have moved the estimate.
    moved: Vec<f64>,
    room: Room,
}

impl Kalman {
    fn new(flight: &Flight, start: Vec<f64>, lags_sd: &[f64], belief: &Belief, disturbances: &Disturbances, held: Option<Held>) -> Self {
        let (own, learned) = (start.len(), belief.mean.len());
        let extras = extras(flight, own, learned, disturbances, held.as_ref());
        let n = own + extras.len();
        let (x, p) = begin(start, lags_sd, belief, &extras);
        Kalman { own, learned, extras, held, x, p, h: vec![0.0; n], ph: vec![0.0; n], moved: vec![0.0; n], room: Room::new(own, n) }
    }

    /// The disturbances as they are estimated: push, then marker.
    fn disturbed(&self) -> [f64; PUSH + 3] {
        let mut all = [0.0; PUSH + 3];
        for (extra, value) in self.extras[self.learned..].iter().zip(&self.x[self.own + self.learned..]) {
            all[extra.axis] += extra.unit * value;
        }
        all
    }

    /// A new command is on its way.
    fn command(&mut self, u: &Command<f64>) {
        let Some(held) = &mut self.held else { return };
        let first = self.extras.len() - AXES.len();
        for (extra, gain) in self.extras[first..].iter_mut().zip(held.next(u)) {
            extra.gain = gain;
        }
    }

    /// Take in a measurement whose prediction at the estimate, and its slopes in standard deviations, are known. `None` where the filter breaks
    /// down.
    fn measure(&mut self, row: &Compared, predicted: f64, marker: f64, slopes: &[f64]) -> Option<Innovation> {
        let own = self.own;
        self.h[..own].copy_from_slice(&slopes[..own]);
        for (slot, extra) in self.h[own..].iter_mut().zip(&self.extras) {
            let seen = || if extra.axis == PUSH + row.channel - 3 { 1.0 / row.sigma } else { 0.0 };
            *slot = extra.column.map_or_else(|| if row.channel < 3 { 0.0 } else { seen() }, |column| slopes[column] * extra.unit);
        }
        let already: f64 = self.h.iter().zip(&self.moved).map(|(h, m)| h * m).sum();
        // in standard deviations of the measurement, whose variance is then 1
        let error = (row.measured - predicted - marker) / row.sigma - already;
        times(&self.p, &self.h, &mut self.ph);
        let variance = 1.0 + self.h.iter().zip(&self.ph).map(|(h, p)| h * p).sum::<f64>();
        let z = error / variance.sqrt();
        if !z.is_finite() {
            return None;
        }
        let weight = if z.abs() > HUBER { HUBER / z.abs() } else { 1.0 };
        let spread = 0.5 * variance.ln();
        let loss = if weight < 1.0 { HUBER * (z.abs() - 0.5 * HUBER) } else { 0.5 * z * z } + spread;
        let gain = weight / variance;
        add(&mut self.moved, gain * error, &self.ph);
        less(&mut self.p, gain, &self.ph);
        Some(Innovation { t_s: row.t_s, channel: row.channel, normalised: z, spread, loss })
    }
}

/// The marker's error in what a row measures.
fn marker(row: &Compared, disturbed: &[f64; PUSH + 3]) -> f64 {
    if row.channel < 3 { 0.0 } else { disturbed[PUSH + row.channel - 3] }
}

/// Run the filter over some ticks of a flight. The parameters that `hypothesis` has free are learned, starting from `belief`. `None` if
/// the hypothesis cannot be simulated or the filter breaks down.
pub fn filter(
    flight: &Flight,
    ticks: Range<usize>,
    hypothesis: &Hypothesis,
    belief: &Belief,
    disturbances: &Disturbances,
) -> Option<Filtered> {
    run(flight, ticks, hypothesis, belief, disturbances, &mut |_, _, _| ())
}

/// Shown the worker after a tick, with the estimate and the disturbances from which it went on.
type See<'a> = dyn FnMut(&Worker, &[f64], &[f64; PUSH + 3]) + 'a;

/// As [`filter`], seen after each tick.
fn run(
    flight: &Flight,
    ticks: Range<usize>,
    hypothesis: &Hypothesis,
    belief: &Belief,
    disturbances: &Disturbances,
    see: &mut See<'_>,
) -> Option<Filtered> {
    let learned = belief.mean.len();
    let at = hypothesis.at(&belief.mean);
    let lags_sd = at.lags_sd(flight.input);
    let own = START + lags_sd.len();
    let mut worker = Worker::new(&at, flight, true, true).ok()?;
    let mut start = flight.start_numbers(ticks.start);
    let lags = worker.lags(flight, ticks.start, &start);
    start.extend(lags);
    let mut k = Kalman::new(flight, start, &lags_sd, belief, disturbances, Held::of(&at, flight, ticks.start));
    let mut out = Filtered { loss: 0.0, innovations: Vec::new(), belief: belief.clone(), states: Vec::new(), wandered: Vec::new() };
    for tick in ticks {
        worker.set_free(&k.x[own..own + learned]).ok()?;
        let disturbed = k.disturbed();
        out.wandered.push(disturbed);
        out.states.push(k.x[..own].to_vec());
        worker.set_push(std::array::from_fn(|i| disturbed[i]));
        worker.cut_from_start();
        worker.go_on(flight, &Window { flight: 0, ticks: tick..tick + 1 }, &k.x[..own]);
        see(&worker, &k.x[..own], &disturbed);
        k.moved.fill(0.0);
        for (row, slopes) in worker.rows().iter().zip(worker.slopes()) {
            let innovation = k.measure(row, row.predicted, marker(row, &disturbed), slopes)?;
            out.loss += innovation.loss;
            out.innovations.push(innovation);
        }
        k.command(flight.command(tick as isize + 1));
        let (end, slopes) = worker.end();
        propagate(end, slopes, &mut k);
    }
    let n = k.x.len();
    out.belief.mean.copy_from_slice(&k.x[own..own + learned]);
    for i in 0..learned {
        for j in 0..learned {
            out.belief.covariance[i * learned + j] = k.p[(own + i) * n + own + j];
        }
    }
    Some(out)
}

/// A tick of a filtered flight, linear about the estimate of then.
struct Linear {
    /// The vehicle's own numbers, then the push.
    about: Vec<f64>,
    rows: Vec<Compared>,
    slopes: Vec<f64>,
    end: Vec<f64>,
    end_slopes: Vec<f64>,
}

/// A filtered stretch of a flight, linear about what was estimated: under other disturbances it is filtered again without the simulator, exactly to
/// first order in how far the estimates then differ.
pub struct Track {
    start: Vec<f64>,
    lags_sd: Vec<f64>,
    first: isize,
    held: Option<Held>,
    ticks: Vec<Linear>,
}

impl Track {
    /// Filters a stretch and keeps it. Nothing is learned.
    pub fn of(flight: &Flight, ticks: Range<usize>, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<Self> {
        let nothing = Belief::independent(Vec::new(), &[]);
        let mut kept = Vec::with_capacity(ticks.len());
        let (first, held) = (ticks.start as isize, Held::of(hypothesis, flight, ticks.start));
        let mut keep = |worker: &Worker, x: &[f64], disturbed: &[f64; PUSH + 3]| {
            let (end, end_slopes) = worker.end();
            kept.push(Linear {
                about: [x, &disturbed[..PUSH]].concat(),
                rows: worker.rows().to_vec(),
                slopes: worker.slopes().flatten().copied().collect(),
                end: end.to_vec(),
                end_slopes: end_slopes.to_vec(),
            });
        };
        let filtered = run(flight, ticks, &hypothesis.fixed(), &nothing, disturbances, &mut keep)?;
        Some(Track { start: filtered.states.into_iter().next()?, lags_sd: hypothesis.lags_sd(flight.input), first, held, ticks: kept })
    }

    /// Negative log-likelihood under other disturbances, summed up to each tick. Ends early where it has fallen hopelessly behind `least`.
    pub fn losses(&self, flight: &Flight, disturbances: &Disturbances, least: Option<&[f64]>) -> Option<Vec<f64>> {
        let nothing = Belief::independent(Vec::new(), &[]);
        let mut k = Kalman::new(flight, self.start.clone(), &self.lags_sd, &nothing, disturbances, self.held.clone());
        let (own, mut loss) = (k.own, 0.0);
        let (mut off, mut end) = (vec![0.0; own + PUSH], vec![0.0; own]);
        let mut losses = Vec::with_capacity(self.ticks.len());
        for (at, tick) in self.ticks.iter().enumerate() {
            let disturbed = k.disturbed();
            for (i, off) in off.iter_mut().enumerate() {
                *off = if i < own { k.x[i] } else { disturbed[i - own] } - tick.about[i];
            }
            let by = |slopes: &[f64]| slopes.iter().zip(&off).map(|(s, o)| s * o).sum::<f64>();
            k.moved.fill(0.0);
            for (row, slopes) in tick.rows.iter().zip(tick.slopes.chunks_exact(own + PUSH)) {
                let predicted = row.predicted + row.sigma * by(slopes);
                loss += k.measure(row, predicted, marker(row, &disturbed), slopes)?.loss;
            }
            k.command(flight.command(self.first + at as isize + 1));
            losses.push(loss);
            if least.is_some_and(|least| loss > least[at] + HOPELESS) {
                return None;
            }
            for ((end, at), slopes) in end.iter_mut().zip(&tick.end).zip(tick.end_slopes.chunks_exact(own + PUSH)) {
                *end = at + by(slopes);
            }
            propagate(&end, &tick.end_slopes, &mut k);
        }
        Some(losses)
    }

    /// Negative log-likelihood of the whole stretch.
    pub fn loss(&self, flight: &Flight, disturbances: &Disturbances) -> f64 {
        self.losses(flight, disturbances, None).and_then(|losses| losses.last().copied()).unwrap_or(f64::INFINITY)
    }
}

/// The filter's state and covariance before the first measurement.
fn begin(start: Vec<f64>, lags_sd: &[f64], belief: &Belief, extras: &[Extra]) -> (Vec<f64>, Vec<f64>) {
    let (own, learned) = (start.len(), belief.mean.len());
    let n = own + extras.len();
    let mut x = start;
    x.extend(&belief.mean);
    x.resize(n, 0.0);
    let mut p = vec![0.0; n * n];
    for i in 0..own {
        let sd = if i < START { START_SD[i / 3] } else { lags_sd[i - START] };
        p[i * n + i] = sd * sd;
    }
    for i in 0..learned {
        for j in 0..learned {
            p[(own + i) * n + own + j] = belief.covariance[i * learned + j];
        }
    }
    for (i, extra) in (own..n).zip(extras).skip(learned) {
        p[i * n + i] = extra.variance;
    }
    (x, p)
}

/// `to += by * from`.
#[inline(always)]
fn add(to: &mut [f64], by: f64, from: &[f64]) {
    let from = &from[..to.len()];
    for i in 0..to.len() {
        to[i] += by * from[i];
    }
}

/// A symmetric matrix times a vector: row by row, so that the compiler can take several numbers at once.
fn times(matrix: &[f64], by: &[f64], out: &mut [f64]) {
    Dual::run(
        #[inline(always)]
        || {
            let n = by.len();
            out.fill(0.0);
            for i in 0..n {
                if by[i] != 0.0 {
                    add(out, by[i], &matrix[i * n..(i + 1) * n]);
                }
            }
        },
    );
}

/// `matrix -= by * v v^T`.
fn less(matrix: &mut [f64], by: f64, v: &[f64]) {
    Dual::run(
        #[inline(always)]
        || {
            let n = v.len();
            for i in 0..n {
                add(&mut matrix[i * n..(i + 1) * n], -(by * v[i]), v);
            }
        },
    );
}

/// Matrices of [`propagate`].
struct Room {
    /// The vehicle's rows of the transition, and their transpose.
    f: Vec<f64>,
    ft: Vec<f64>,
    fp: Vec<f64>,
}

impl Room {
    fn new(own: usize, n: usize) -> Self {
        Room { f: vec![0.0; own * n], ft: vec![0.0; own * n], fp: vec![0.0; own * n] }
    }
}

/// State and covariance one tick on.
fn propagate(end: &[f64], slopes: &[f64], k: &mut Kalman) {
    let Kalman { own, extras, x, p, moved, room: Room { f, ft, fp }, .. } = k;
    let (own, n) = (*own, x.len());
    let unknowns = slopes.len() / own;
    for i in 0..own {
        let row = &slopes[i * unknowns..(i + 1) * unknowns];
        f[i * n..i * n + own].copy_from_slice(&row[..own]);
        for (j, extra) in extras.iter().enumerate() {
            f[i * n + own + j] = extra.column.map_or(0.0, |column| row[column] * extra.unit);
        }
        x[i] = end[i] + f[i * n..(i + 1) * n].iter().zip(&*moved).map(|(f, m)| f * m).sum::<f64>();
        for k in 0..n {
            ft[k * own + i] = f[i * n + k];
        }
    }
    for (j, extra) in extras.iter().enumerate() {
        x[own + j] = extra.keep * (x[own + j] + moved[own + j]);
    }
    Dual::run(
        #[inline(always)]
        || {
            // the vehicle's rows of F P; those of the extras only shrink
            fp.fill(0.0);
            for i in 0..own {
                for k in 0..n {
                    if f[i * n + k] != 0.0 {
                        add(&mut fp[i * n..(i + 1) * n], f[i * n + k], &p[k * n..(k + 1) * n]);
                    }
                }
            }
            // and that times the transpose of F, above the diagonal
            for i in 0..own {
                let (row, out) = (&fp[i * n..(i + 1) * n], &mut p[i * n..(i + 1) * n]);
                out[..own].fill(0.0);
                for k in 0..n {
                    add(&mut out[..own], row[k], &ft[k * own..(k + 1) * own]);
                }
                for (j, extra) in extras.iter().enumerate() {
                    out[own + j] = row[own + j] * extra.keep;
                }
            }
            for (i, extra) in extras.iter().enumerate() {
                let row = &mut p[(own + i) * n + own..(own + i + 1) * n];
                for (out, other) in row.iter_mut().zip(extras.iter()) {
                    *out *= extra.keep * other.keep;
                }
            }
        },
    );
    // symmetric but for rounding
    for i in 0..n {
        for j in 0..i {
            p[i * n + j] = p[j * n + i];
        }
    }
    for (j, extra) in extras.iter().enumerate() {
        p[(own + j) * n + own + j] += extra.gain;
    }
}
