//! Windows of flights predicted by the simulator itself, on numbers with derivatives.

use std::collections::VecDeque;

use crazyflie_env::dual::{DIRECTIONS, DualNumber};
use crazyflie_env::effects::{self, Entry, Param, registry};
use crazyflie_env::model::Model;
use crazyflie_env::plant::{Accelerations, State};
use crazyflie_env::scalar::Scalar;
use crazyflie_env::sim_scalar::SimScalar;
use crazyflie_env::world::{Settings, World};

use super::derivative_pass::{DerivativePass, dual_command, start_state, variable};
use super::flight::{Flight, MEMORY_S, Sample, Window};
use super::hypothesis::{Hypothesis, Term};

/// Count of the numbers that a window starts from: position, velocity, attitude, rates.
pub const START: usize = 12;
/// Count of the numbers of a push: accelerations in the world frame, angular accelerations about the body
/// axes.
pub const PUSH: usize = 6;

/// A measured number and its prediction.
#[derive(Debug, Clone, Copy)]
pub struct PredictedMeasurement {
    /// Time since the first tick of the flight.
    pub t_s: f64,
    /// 0 to 2: roll, pitch, yaw; 3 to 5: x, y, z.
    pub channel: usize,
    /// Measured value, in rad or m by its channel.
    pub measured: f64,
    /// Predicted value, in the same unit.
    pub predicted: f64,
    /// Standard deviation of the measurement, in the same unit.
    pub sigma: f64,
    /// See [`super::flight::Sample::noise_scale`].
    pub noise_scale: f64,
}

impl PredictedMeasurement {
    /// Measured less predicted, in standard deviations of the measurement.
    pub fn residual(&self) -> f64 {
        (self.measured - self.predicted) / self.sigma
    }
}

/// A parameter is simulated at most this share of its range beyond a bound: a filter may pass through an inertia
/// below zero, and would not return from there.
const BEYOND: f64 = 0.05;

/// Steps that find a start by its report: a frame that is turned by 20 degrees leaves a thousandth.
const FRAME_STEPS: usize = 7;

/// Frames and their stamps reach back so far, with something to spare.
const PAST_S: f64 = 0.2;

/// Data of a tick before the window.
#[derive(Debug, Clone, Copy)]
struct PastTick {
    acc_mps2: [f64; 3],
    /// At its start.
    att_rad: [f64; 3],
}

/// Predicts windows with their slopes by all unknowns.
pub type SensitivitySimulator = WindowSimulator<DIRECTIONS>;
/// Predicts windows alone, ten times as fast.
pub type MeanSimulator = WindowSimulator<0>;

/// A thread's worlds with the parameters in place: simulates windows, with slopes by all unknowns if its numbers
/// have directions.
pub struct WindowSimulator<const D: usize>
where
    DualNumber<D>: SimScalar<Mask = bool>,
{
    model: Model,
    passes: Vec<DerivativePass<D>>,
    remembers: bool,
    /// Memory of the motion in effects, see [`effects::Effect::MOTION_MEMORY_S`].
    motion_memory_s: f64,
    /// Unknowns of each window: the start and the lags.
    own: usize,
    lags_push: [bool; 2],
    unknowns: usize,
    states: Vec<State<DualNumber<D>>>,
    /// Ticks before the window, the latest last; empty where only the window is known.
    past: VecDeque<PastTick>,
    offsets: Vec<[DualNumber<D>; 3]>,
    rows: Vec<PredictedMeasurement>,
    slopes: Vec<f64>,
    end: Vec<f64>,
    end_slopes: Vec<f64>,
    /// Effects change the frame in which positions are reported.
    turns_frame: bool,
    /// The start of the window as it would be reported, and its slopes; empty where nothing changes the frame.
    reported_start: Vec<f64>,
    reported_start_slopes: Vec<f64>,
    /// Per effect: name, values, and which are free.
    terms: Vec<Term>,
    free_of_model: usize,
    /// Acting during [`SensitivitySimulator::predict_from`], with slopes behind those of the shared
    /// parameters.
    push: Option<[f64; PUSH]>,
}

impl<const D: usize> WindowSimulator<D>
where
    DualNumber<D>: SimScalar<Mask = bool>,
{
    /// # Errors
    /// The errors of [`World::new`].
    pub fn new(hypothesis: &Hypothesis, flight: &Flight, pushed: bool) -> crazyflie_env::Result<Self> {
        let mut model = hypothesis.model.clone();
        let hz = (1.0 / flight.tick_s).round();
        // the base clock is the IMU's here, fast enough for every effect and even; frames are filmed when the
        // log has them, not by the rig's clock
        let fastest_hz = registry().iter().map(|e| e.physics_hz).max().unwrap_or(1);
        let base_hz = 2.0 * hz * (f64::from(fastest_hz) / (2.0 * hz)).ceil();
        (model.rig.control.value, model.rig.imu.value, model.rig.camera.value) = (hz, base_hz, 1.0);
        let entries: Vec<&'static Entry> = hypothesis.terms.iter().map(|t| t.entry).collect();
        let declared = hypothesis.model.effects.keys().filter_map(|name| Some(effects::find(name).ok()?.1));
        let all: Vec<&'static Entry> = entries.iter().copied().chain(declared).collect();
        let needed_hz = all.iter().map(|e| e.physics_hz).max().unwrap_or(1);
        let physics_hz = hypothesis.max_physics_hz.filter(|most| needed_hz > *most);
        let settings = Settings { input: flight.input, physics_hz };
        let lags_push = hypothesis.lags_push(flight.input);
        let own = START + hypothesis.lags_sd(flight.input).len();
        let values: Vec<f64> = hypothesis.terms.iter().flat_map(Term::free_values).collect();
        let shared = hypothesis.free.len() + values.len();
        let unknowns = if D > 0 { own + shared + if pushed { PUSH } else { 0 } } else { 0 };
        let mut passes = Vec::new();
        for first in (0..unknowns.max(1)).step_by(D.max(1)) {
            let mut pass = DerivativePass { first, world: World::for_fitting(&model, &entries, settings)? };
            let direction = |unknown: usize| unknown.checked_sub(first).filter(|d| *d < D);
            let paths = hypothesis.free.iter().enumerate();
            let seeds: Vec<(&str, usize)> =
                paths.filter_map(|(i, path)| Some((path.as_str(), direction(own + i)?))).collect();
            if !seeds.is_empty() {
                pass.world.seed_model(&model, settings, &seeds)?;
            }
            passes.push(pass);
        }
        let mut simulator = WindowSimulator {
            own,
            lags_push,
            model,
            passes,
            remembers: all.iter().any(|e| e.hooks.command),
            motion_memory_s: all.iter().map(|e| e.motion_memory_s).fold(0.0, f64::max),
            unknowns,
            states: Vec::new(),
            past: VecDeque::new(),
            offsets: Vec::new(),
            rows: Vec::new(),
            slopes: Vec::new(),
            end: vec![0.0; own],
            end_slopes: Vec::new(),
            turns_frame: all.iter().any(|e| e.hooks.frame),
            reported_start: Vec::new(),
            reported_start_slopes: Vec::new(),
            terms: hypothesis.terms.clone(),
            free_of_model: hypothesis.free.len(),
            push: pushed.then_some([0.0; PUSH]),
        };
        simulator.set_free(&values)?;
        Ok(simulator)
    }

    /// Clears the slopes of the memory of effects by the start, which was another one.
    pub fn clear_start_slopes(&mut self) {
        for pass in &mut self.passes {
            let own = self.own.saturating_sub(pass.first).min(D);
            pass.world.visit_memory(&mut |number| number.slope[..own].fill(0.0));
        }
    }

    /// Accelerate the vehicle from now on.
    pub fn set_push(&mut self, push: [f64; PUSH]) {
        self.push = Some(push);
    }

    /// Other values for the free parameters of the effects.
    ///
    /// # Errors
    /// None that [`SensitivitySimulator::new`] would not have had.
    pub fn set_free(&mut self, values: &[f64]) -> crazyflie_env::Result<()> {
        for pass in &mut self.passes {
            let first = self.own + self.free_of_model;
            let mut unknown = first;
            for term in &self.terms {
                let mut params: Vec<_> = term.values.iter().map(|v| DualNumber::from_f64(*v)).collect();
                for i in &term.free {
                    let Param { low, high, .. } = term.entry.params[*i];
                    let beyond = BEYOND * (high - low);
                    params[*i] = variable(
                        pass.first,
                        values[unknown - first].clamp(low - beyond, high + beyond),
                        unknown,
                    );
                    unknown += 1;
                }
                pass.world.set_params(term.entry.name, &params)?;
            }
        }
        Ok(())
    }

    /// Predict a window; rows and slopes are then in the simulator.
    pub fn predict(&mut self, flight: &Flight, window: &Window, own: &[f64]) {
        self.warm_up(flight, window.ticks.start, own);
        self.predict_from(flight, window, own);
    }

    /// Warms up the memory of effects: commands before a tick, and the motion as measured. The vehicle itself
    /// will start anew.
    pub fn warm_up(&mut self, flight: &Flight, tick: usize, own: &[f64]) {
        let first = tick as isize;
        let ticks = |s: f64| (s / flight.tick_s).ceil() as isize;
        let follows = self.motion_memory_s > 0.0;
        // before its first tick nothing was measured of a flight
        let moved = ticks(self.motion_memory_s).min(first);
        let back = moved.max(if self.remembers { ticks(MEMORY_S) } else { 0 });
        let measured = |tick: isize| flight.measured_numbers(tick.max(0) as usize);
        let mut passes = std::mem::take(&mut self.passes);
        for pass in &mut passes {
            // measurements do not depend on the start
            let number = |numbers: &[f64], i: usize| DualNumber::<D>::from_f64(numbers[i]);
            let state = |numbers: &[f64]| start_state(&self.model, flight, |i| number(numbers, i));
            let start = if follows {
                state(&measured(first - back))
            } else {
                start_state(&self.model, flight, |i| variable(pass.first, own[i], i))
            };
            let world = &mut pass.world;
            DualNumber::<D>::run(
                #[inline(always)]
                || {
                    world.start(0, true, &start, &dual_command(flight.command(first - back - 1)));
                    world.set_time(flight.before_s + (first - back) as f64 * flight.tick_s);
                    for tick in first - back..first {
                        if follows {
                            world.set_state(&state(&measured(tick)), [DualNumber::from_f64(0.0); 3]);
                        }
                        world.set_voltage(flight.voltage_v(tick).map(DualNumber::from_f64));
                        world.step(0, &dual_command(flight.command(tick)));
                    }
                },
            );
        }
        self.passes = passes;
    }

    /// Predicts a window from its start, with the effects' memory of the time before.
    pub fn predict_from(&mut self, flight: &Flight, window: &Window, own: &[f64]) {
        self.rows.clear();
        let count = 3
            * (flight.samples_in(&flight.angles, &window.ticks).len()
                + flight.samples_in(&flight.fixes, &window.ticks).len());
        self.slopes.clear();
        self.slopes.resize(count * self.unknowns, 0.0);
        self.end_slopes.clear();
        self.end_slopes.resize(self.own * self.unknowns, 0.0);
        if flight.sees_true_attitude && self.turns_frame {
            self.reported_start.clear();
            self.reported_start.extend_from_slice(&own[..START]);
            self.reported_start_slopes.clear();
            self.reported_start_slopes.resize(START * self.unknowns, 0.0);
        }
        let mut passes = std::mem::take(&mut self.passes);
        for pass in &mut passes {
            DualNumber::<D>::run(
                #[inline(always)]
                || {
                    self.simulate(pass, flight, window, own);
                    self.report_start(pass, flight.tick_s);
                    self.compare_samples(pass, flight, window);
                },
            );
            self.store_end(pass);
        }
        self.passes = passes;
    }

    /// The states at all ticks of the window.
    #[inline(always)]
    fn simulate(&mut self, pass: &mut DerivativePass<D>, flight: &Flight, window: &Window, own: &[f64]) {
        let start = start_state(&self.model, flight, |i| variable(pass.first, own[i], i));
        if let Some(push) = &self.push {
            let from = self.unknowns.saturating_sub(PUSH);
            let component = |i: usize| variable(pass.first, push[i], from + i);
            pass.world.disturb(Accelerations {
                acc_mps2: [component(0), component(1), component(2)],
                ang_radps2: [component(3), component(4), component(5)],
            });
        }
        let world = &mut pass.world;
        // the velocity that a drag sees half a tick later; a window begins with none
        let acc_mps2 = self.past.back().map_or([0.0; 3], |tick| tick.acc_mps2);
        world.set_state(&start, acc_mps2.map(DualNumber::from_f64));
        let mut lag = START;
        let first = pass.first;
        world.visit_lags(self.lags_push, &mut |slot| {
            *slot = variable(first, own[lag], lag);
            lag += 1;
        });
        self.states.clear();
        self.offsets.clear();
        self.states.push(*world.state(0));
        for tick in window.ticks.clone() {
            world.set_voltage(flight.voltage_v(tick as isize).map(DualNumber::from_f64));
            let y = world.step(0, &dual_command(flight.command(tick as isize))).reading;
            let x = world.state(0);
            // motion capture sees the vehicle itself, not what its estimator makes of it
            self.offsets.push(if flight.sees_true_attitude {
                [DualNumber::from_f64(0.0); 3]
            } else {
                std::array::from_fn(|i| y.att_rad[i] - x.att_rad[i])
            });
            self.states.push(*x);
        }
    }

    /// Remembers a window of one tick, which precedes the next.
    pub fn remember_tick(&mut self, tick_s: f64) {
        let [start, .., end] = &self.states[..] else { return };
        let acc_mps2 = std::array::from_fn(|i| (end.vel_mps[i].value - start.vel_mps[i].value) / tick_s);
        self.past.push_back(PastTick { acc_mps2, att_rad: start.att_rad.map(|angle| angle.value) });
        if self.past.len() as f64 * tick_s > PAST_S {
            self.past.pop_front();
        }
    }

    /// The state so long before the window, from the accelerations of the ticks before it. (The parabola of the
    /// window's first tick, over 0.1 s, made latencies some milliseconds too short.)
    #[inline(always)]
    fn state_before(&self, tick_s: f64, mut back_s: DualNumber<D>) -> State<DualNumber<D>> {
        let number = DualNumber::from_f64;
        let mut x = self.states[0];
        let mut later_rad = x.att_rad.map(|angle| angle.value);
        for (i, tick) in self.past.iter().rev().enumerate() {
            let is_within = back_s.value <= tick_s || i + 1 == self.past.len();
            let part_s = if is_within { back_s } else { number(tick_s) };
            for axis in 0..3 {
                let slower = number(tick.acc_mps2[axis]) * part_s;
                x.pos_m[axis] -= part_s * (x.vel_mps[axis] - number(0.5) * slower);
                x.vel_mps[axis] -= slower;
                x.att_rad[axis] += part_s * number((tick.att_rad[axis] - later_rad[axis]) / tick_s);
            }
            if is_within {
                break;
            }
            (later_rad, back_s) = (tick.att_rad, back_s - part_s);
        }
        x
    }

    fn store_end(&mut self, pass: &mut DerivativePass<D>) {
        let Some(x) = self.states.last() else { return };
        let mut numbers = [x.pos_m, x.vel_mps, x.att_rad, x.rate_radps].as_flattened().to_vec();
        pass.world.visit_lags(self.lags_push, &mut |lag| numbers.push(*lag));
        let here = pass.first.min(self.unknowns)..(pass.first + D).min(self.unknowns);
        for (i, number) in numbers.iter().enumerate() {
            self.end[i] = number.value;
            let to = &mut self.end_slopes[i * self.unknowns..][here.clone()];
            to.iter_mut().zip(&number.slope).for_each(|(to, slope)| *to = f64::from(*slope));
        }
    }

    /// Stores the start of the window as it would be reported.
    #[inline(always)]
    fn report_start(&mut self, pass: &mut DerivativePass<D>, tick_s: f64) {
        if self.reported_start.is_empty() {
            return;
        }
        let x = self.states[0];
        let [pos_m, vel_mps] = reported(&mut pass.world, &x, tick_s);
        let here = pass.first.min(self.unknowns)..(pass.first + D).min(self.unknowns);
        let numbers = [pos_m, vel_mps, x.att_rad, x.rate_radps];
        for (i, number) in numbers.as_flattened().iter().enumerate() {
            self.reported_start[i] = number.value;
            let to = &mut self.reported_start_slopes[i * self.unknowns..][here.clone()];
            to.iter_mut().zip(&number.slope).for_each(|(to, slope)| *to = f64::from(*slope));
        }
    }

    /// The start of the last window as it would be reported, with its slopes, a row of all unknowns for each
    /// number. `None` where nothing changes the frame: then it is the start itself.
    pub fn reported_start(&self) -> Option<(&[f64], &[f64])> {
        (!self.reported_start.is_empty())
            .then_some((&self.reported_start[..], &self.reported_start_slopes[..]))
    }

    /// The start that would be reported as what was measured at a tick, without lags.
    fn start_as_measured(&mut self, flight: &Flight, tick: usize) -> Vec<f64> {
        let measured = flight.measured_numbers(tick);
        if !(flight.sees_true_attitude && self.turns_frame) {
            return measured;
        }
        let mut start = measured.clone();
        let Some(pass) = self.passes.first_mut() else { return start };
        for _ in 0..FRAME_STEPS {
            let x = start_state(&self.model, flight, |i| DualNumber::<D>::from_f64(start[i]));
            let seen = reported(&mut pass.world, &x, flight.tick_s);
            for (i, seen) in seen.as_flattened().iter().enumerate() {
                start[i] += measured[i] - seen.value;
            }
        }
        start
    }

    /// Returns the start at a tick as measured, lags included.
    pub fn measured_start(&mut self, flight: &Flight, tick: usize) -> Vec<f64> {
        let mut start = self.start_as_measured(flight, tick);
        start.extend(self.initial_lags(flight, tick, &start));
        start
    }

    /// The lags at a tick if the vehicle was at its start state before it too.
    pub fn initial_lags(&mut self, flight: &Flight, tick: usize, start: &[f64]) -> Vec<f64> {
        self.warm_up(flight, tick, start);
        let mut lags = Vec::new();
        if let Some(pass) = self.passes.first_mut() {
            pass.world.visit_lags(self.lags_push, &mut |lag| lags.push(lag.value));
        }
        lags
    }

    /// The state at a time since the start of the window, and the tick that it lies in.
    #[inline(always)]
    fn state_at(
        &self,
        world: &World<DualNumber<D>>,
        tick_s: f64,
        t_s: DualNumber<D>,
    ) -> (State<DualNumber<D>>, usize) {
        if t_s.value < 0.0 && !self.past.is_empty() {
            return (self.state_before(tick_s, -t_s), 0);
        }
        let ticks = self.states.len() - 1;
        let tick = ((t_s.value / tick_s - 1e-6).max(0.0) as usize).min(ticks - 1);
        let share =
            (DualNumber::from_f64((tick + 1) as f64 * tick_s) - t_s) * DualNumber::from_f64(1.0 / tick_s);
        let after = &self.states[tick + 1];
        // half of the attitudes are measured as a tick ends
        let ends = share.value.abs() < 1e-9 && share.slope == [0.0; D];
        (if ends { *after } else { world.between(&self.states[tick], after, share) }, tick)
    }

    #[inline(always)]
    fn compare_samples(&mut self, pass: &mut DerivativePass<D>, flight: &Flight, window: &Window) {
        let begin_s = window.ticks.start as f64 * flight.tick_s;
        let mut row = 0;
        for sample in flight.samples_in(&flight.angles, &window.ticks) {
            let (x, tick) =
                self.state_at(&pass.world, flight.tick_s, DualNumber::from_f64(sample.t_s - begin_s));
            for axis in 0..3 {
                let predicted = x.att_rad[axis] + self.offsets[tick][axis];
                self.store_row(pass.first, row, sample, axis, predicted, flight.noise.att_rad[axis]);
                row += 1;
            }
        }
        for sample in flight.samples_in(&flight.fixes, &window.ticks) {
            // an effect may make the stamp wrong: what was captured earlier shows an earlier pose
            let stamp = DualNumber::from_f64(sample.t_s - begin_s);
            let (x, _) = self.state_at(&pass.world, flight.tick_s, stamp);
            let late = pass.world.film(&x, stamp).t_s - stamp;
            let captured = stamp - late;
            let x = if late.value == 0.0 && late.slope == [0.0; D] {
                x
            } else {
                self.state_at(&pass.world, flight.tick_s, captured).0
            };
            let seen = pass.world.film(&x, captured);
            for axis in 0..3 {
                self.store_row(pass.first, row, sample, 3 + axis, seen.pos_m[axis], flight.noise.pos_m[axis]);
                row += 1;
            }
        }
    }

    #[inline(always)]
    fn store_row(
        &mut self,
        first: usize,
        row: usize,
        sample: &Sample,
        channel: usize,
        predicted: DualNumber<D>,
        usual: f64,
    ) {
        let (measured, noise_scale) = (sample.value[channel % 3], sample.noise_scale[channel % 3]);
        let sigma = usual * noise_scale;
        if first == 0 {
            self.rows.push(PredictedMeasurement {
                t_s: sample.t_s,
                channel,
                measured,
                predicted: predicted.value,
                sigma,
                noise_scale,
            });
        }
        let here = first.min(self.unknowns)..(first + D).min(self.unknowns);
        let (slopes, per_sigma) = (&mut self.slopes[row * self.unknowns..][here], 1.0 / sigma);
        for (slot, slope) in slopes.iter_mut().zip(&predicted.slope) {
            *slot = f64::from(*slope) * per_sigma;
        }
    }

    /// The measurements of the last window with their predictions.
    pub fn rows(&self) -> &[PredictedMeasurement] {
        &self.rows
    }

    /// The velocity of the position that would be reported, at a tick of the window, from the ticks around
    /// it. A frame with a stamp that is late shows where the vehicle was before.
    pub fn reported_velocity(&mut self, flight: &Flight, tick: usize) -> Option<[f64; 3]> {
        let world = &mut self.passes.first_mut()?.world;
        let (states, tick_s) = (&self.states, flight.tick_s);
        let last = states.len() - 1;
        let mut film = |k: usize| world.film(&states[k], DualNumber::from_f64(k as f64 * tick_s));
        let late_s = film(tick.min(last)).t_s.value - tick.min(last) as f64 * tick_s;
        let taken = (tick as f64 - late_s / tick_s).clamp(0.0, last as f64);
        let mut position = |ticks: f64| -> [f64; 3] {
            let (k, share) = (ticks as usize, ticks.fract());
            let [a, b] = [k, (k + 1).min(last)].map(|k| film(k).pos_m);
            std::array::from_fn(|i| a[i].value + share * (b[i].value - a[i].value))
        };
        let (before, after) = ((taken - 1.0).max(0.0), (taken + 1.0).min(last as f64));
        let [a, b] = [position(before), position(after)];
        Some(std::array::from_fn(|i| (b[i] - a[i]) / ((after - before) * tick_s)))
    }

    /// Slopes of the predictions in standard deviations: for each, a row of all unknowns.
    pub fn slopes(&self) -> impl Iterator<Item = &[f64]> {
        self.slopes.chunks_exact(self.unknowns.max(1))
    }

    /// The state at the end of the window and its slopes, a row of all unknowns for each number.
    pub fn end(&self) -> (&[f64], &[f64]) {
        (&self.end, &self.end_slopes)
    }
}

/// Position and velocity of a state in the frame that is reported.
fn reported<const D: usize>(
    world: &mut World<DualNumber<D>>,
    x: &State<DualNumber<D>>,
    tick_s: f64,
) -> [[DualNumber<D>; 3]; 2]
where
    DualNumber<D>: SimScalar<Mask = bool>,
{
    let zero = DualNumber::from_f64(0.0);
    let mut later = *x;
    for axis in 0..3 {
        later.pos_m[axis] += x.vel_mps[axis] * DualNumber::from_f64(tick_s);
        later.att_rad[axis] += x.rate_radps[axis] * DualNumber::from_f64(tick_s);
    }
    let (here, there) = (world.film(x, zero).pos_m, world.film(&later, zero).pos_m);
    let per_s = DualNumber::from_f64(1.0 / tick_s);
    [here, std::array::from_fn(|axis| (there[axis] - here[axis]) * per_s)]
}
