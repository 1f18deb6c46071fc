//! A flight made ready for fitting: commands per tick, measurements with their times and their noise, cut
//! into windows.

use std::borrow::Cow;
use std::ops::Range;

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::scalar::Scalar;

use crazyflie_logs::{AttitudeSource, Note, PositionSource};

use super::clock::{ControlClock, ROUNDING_S, usual_step};
use super::heteroscedastic::noise_scales;
use crate::estimate::robust_sd;
use crate::lift::{read_lift, read_pwm, read_tilt};
use crate::replay::measurements::Measurements;
use crate::{FlightLog, Result};

/// Long enough for a slow pole of 2.8 1/s and for drag to show, short enough that the small-angle plant has
/// not run away.
pub const WINDOW_S: f64 = 2.0;
/// A take-off passes through ground effect and climbs for so long, at most, and a landing likewise.
pub const TAKE_OFF_S: f64 = 2.0;
/// A shorter flight is not cut.
const SHORTEST_CUT_S: f64 = 9.0;
/// Longest memory of commands in an effect.
pub const MEMORY_S: f64 = 0.3;
/// Quartz clocks of two radios or computers agree to some hundred millionths.
const SAME_CLOCK: f64 = 1e-3;

/// Standard deviation of a white measurement error, per axis; of a measurement that scatters as usual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurementNoise {
    /// Roll, pitch and yaw.
    pub att_rad: [f64; 3],
    /// x, y and z in the world frame.
    pub pos_m: [f64; 3],
}

/// Three numbers measured at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time since the first tick of the flight.
    pub t_s: f64,
    /// Roll, pitch and yaw in rad, or x, y and z in m.
    pub value: [f64; 3],
    /// Standard deviation of each number over the usual one of [`Flight::noise`].
    pub noise_scale: [f64; 3],
}

impl Sample {
    fn with_usual_noise(t_s: f64, value: [f64; 3]) -> Self {
        Sample { t_s, value, noise_scale: [1.0; 3] }
    }
}

/// A flight on the world's clock: tick `k` lasts from `k tick_s` to `(k + 1) tick_s`, time counting from the
/// first tick.
#[derive(Debug, Clone)]
pub struct Flight {
    /// Name of the log.
    pub name: String,
    /// Length of a control tick.
    pub tick_s: f64,
    /// Number of ticks.
    pub ticks: usize,
    /// Vertical form that the lift of the commands is for.
    pub input: VerticalInput,
    /// Time of the log at which the first tick begins.
    pub start_s: f64,
    /// From the start of the log to the first tick.
    pub before_s: f64,
    /// In force over each tick, the first `memory` of them before the first tick.
    commands: Vec<Command<f64>>,
    memory: usize,
    voltage_v: Option<Vec<f64>>,
    setpoints_m: Option<Vec<[f64; 3]>>,
    /// Attitude by the IMU, or by motion capture.
    pub angles: Vec<Sample>,
    /// Marker positions by capture time.
    pub fixes: Vec<Sample>,
    /// Usual noise of [`Flight::angles`] and [`Flight::fixes`].
    pub noise: MeasurementNoise,
    measured_states: Vec<State<f64>>,
    /// Sampling interval of the attitude.
    pub row_s: f64,
    /// Motion capture measured the attitude, not the vehicle's own estimator.
    pub sees_true_attitude: bool,
}

/// A stretch of a flight predicted from a start of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Place of the flight in the list of the fit.
    pub flight: usize,
    /// Ticks that are predicted.
    pub ticks: Range<usize>,
}

impl Flight {
    /// Prepare a log for a model. The vertical form that is driven is the thrust form, if the log has a thrust
    /// command and the model has the form, unless given.
    ///
    /// # Errors
    /// [`crate::Error`]: no commands, no position, never airborne, too short.
    pub fn from_log(
        name: &str,
        log: &FlightLog,
        model: &Model,
        vertical: Option<VerticalInput>,
    ) -> Result<Self> {
        let measured = Measurements::from_log(log, &mut Vec::new())?;
        let clock = ControlClock::from_log(log);
        let ControlClock { row_s, tick_s, .. } = clock;
        let (lift_off_s, rows) = measured.interval(log, row_s)?;
        let touch_down_s = lift_off_s + rows as f64 * row_s;
        let [first_s, last_s] = without_take_off(log, [lift_off_s, touch_down_s]);
        // ticks begin where commands change
        let start_s = clock.tick_from(first_s);
        let ticks = ((last_s - start_s) / tick_s + ROUNDING_S) as usize;
        let memory = (((start_s - log.t_s[0]) / tick_s + ROUNDING_S) as usize)
            .min((MEMORY_S / tick_s).ceil() as usize);
        let from_s = start_s - memory as f64 * tick_s;
        let (input, lift) = vertical_input(log, model, vertical)?;
        let command_at = command_source(log, model, &measured, &lift, &clock)?;
        let commands = (0..ticks + memory).map(|k| command_at(from_s + k as f64 * tick_s)).collect();
        let row_at = |t: f64| log.t_s.partition_point(|row| *row <= t + ROUNDING_S).saturating_sub(1);
        let row_of = |k: usize| row_at(start_s + (k as f64 - memory as f64) * tick_s);
        let voltage_v = log.steady_voltage_v().map(|v| (0..ticks + memory).map(|k| v[row_of(k)]).collect());
        let setpoint = |axes: &[Vec<f64>; 3], k: usize| {
            axes.each_ref().map(|axis| axis[row_at(start_s + k as f64 * tick_s)])
        };
        let setpoints_m =
            log.setpoint_m.as_ref().map(|axes| (0..=ticks).map(|k| setpoint(axes, k)).collect());
        let end_s = ticks as f64 * tick_s;
        let inside = |s: &Sample| s.t_s > ROUNDING_S && s.t_s <= end_s + ROUNDING_S;
        let attitude = |i: usize| [log.roll_rad[i], log.pitch_rad[i], log.yaw_rad[i]];
        let angle = |i: usize| Sample::with_usual_noise(log.t_s[i] - start_s, attitude(i));
        let mut angles: Vec<Sample> = (0..log.len()).map(angle).filter(inside).collect();
        if log.provenance.attitude == AttitudeSource::MotionCapture {
            remove_mean_tilt(&mut angles);
        }
        let place = |i: usize| log.fixes.pos_m.each_ref().map(|axis| axis[i]);
        let fix = |i: usize| Sample::with_usual_noise(log.fixes.capture_t_s[i] - start_s, place(i));
        let mut fixes: Vec<Sample> = (0..log.fixes.row.len()).map(fix).filter(inside).collect();
        fixes.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let by_motion_capture = log.provenance.position == PositionSource::MotionCapture;
        let floor = if by_motion_capture { FLOOR_MOCAP } else { FLOOR };
        // the noise of motion capture is not in the differences of neighbours
        if !by_motion_capture {
            set_noise_scales(&mut fixes, &|t_s| measured.state(start_s + t_s).pos_m);
        }
        let noise = MeasurementNoise {
            att_rad: white_noise_sd(&angles, floor.att_rad),
            pos_m: white_noise_sd(&fixes, floor.pos_m),
        };
        let measured_states = (0..=ticks)
            .map(|k| with_lags(model, input, measured.state(start_s + k as f64 * tick_s)))
            .collect();
        let before_s = start_s - log.t_s[0];
        Ok(Flight {
            name: name.to_owned(),
            tick_s,
            ticks,
            input,
            start_s,
            before_s,
            commands,
            memory,
            voltage_v,
            setpoints_m,
            angles,
            fixes,
            noise,
            measured_states,
            row_s,
            sees_true_attitude: log.provenance.attitude == AttitudeSource::MotionCapture,
        })
    }

    /// Returns whether two flights have the same control ticks: clocks drift apart by millionths, rates that differ
    /// do so by a hundredth at least.
    pub fn shares_clock(&self, other: &Flight) -> bool {
        (self.tick_s / other.tick_s - 1.0).abs() < SAME_CLOCK
    }

    /// The flight as it would have been logged without its trims. These are a lean of the vehicle under a
    /// level command and a tilt of the frame of the measured attitude, both of roll and pitch in radians, and
    /// `lift`, the command that gives the usual vehicle the thrust that this one had.
    #[must_use]
    pub fn without_trims(
        &self,
        model: &Model,
        lean_rad: [f64; 2],
        frame_rad: [f64; 2],
        lift: &dyn Fn(f64) -> f64,
    ) -> Self {
        let mut flight = self.clone();
        let tilts = [&model.roll, &model.pitch];
        // the command that holds this angle in 5.1, seen from the true frame
        let lean =
            [0, 1].map(|i| (lean_rad[i] - frame_rad[i]) * tilts[i].stiffness.value / tilts[i].gain.value);
        for u in &mut flight.commands {
            u.roll_rad += lean[0];
            u.pitch_rad += lean[1];
            u.lift = lift(u.lift);
        }
        for axis in 0..2 {
            flight.angles.iter_mut().for_each(|sample| sample.value[axis] -= frame_rad[axis]);
            flight.measured_states.iter_mut().for_each(|x| x.att_rad[axis] -= frame_rad[axis]);
        }
        flight
    }

    /// The flight as it would have been logged had its commands been stamped so many ticks earlier. The last command
    /// stays in force.
    #[must_use]
    pub fn with_earlier_commands(&self, ticks: usize) -> Self {
        let mut flight = self.clone();
        flight.commands.drain(..ticks.min(self.commands.len() - 1));
        flight
    }

    /// All its ticks.
    pub fn all_ticks(&self) -> Range<usize> {
        0..self.ticks
    }

    /// The command in force over a tick, which may lie before the first one as far as the log goes.
    pub fn command(&self, tick: isize) -> &Command<f64> {
        let at = (tick + self.memory as isize).clamp(0, self.commands.len() as isize - 1);
        &self.commands[at as usize]
    }

    /// The battery voltage at the start of a tick.
    pub fn voltage_v(&self, tick: isize) -> Option<f64> {
        let value = |v: &Vec<f64>| v[(tick + self.memory as isize).clamp(0, v.len() as isize - 1) as usize];
        self.voltage_v.as_ref().map(value)
    }

    /// Returns the set-point at the start of a tick, if the log has one.
    pub fn setpoint_m(&self, tick: usize) -> Option<[f64; 3]> {
        self.setpoints_m.as_ref().map(|all| all[tick])
    }

    /// The measured state at the start of a tick, from local polynomials.
    pub fn measured_state(&self, tick: usize) -> &State<f64> {
        &self.measured_states[tick]
    }

    /// Computes the distance of a window's start from the measured numbers, in their standard deviations, and its
    /// slope by each number of the start. Empty unless motion capture measures them well enough to constrain the
    /// window: a free start absorbs what the model lacks, and predictions from measured states gain nothing.
    pub fn start_residuals(&self, tick: usize, start: &[f64]) -> Vec<(f64, f64)> {
        if !self.sees_true_attitude {
            return Vec::new();
        }
        let residual = |(i, (measured, at)): (usize, (f64, &f64))| {
            let per_sd = 1.0 / START_SD_MOCAP[i / 3];
            ((measured - at) * per_sd, per_sd)
        };
        self.measured_numbers(tick).into_iter().zip(start).enumerate().map(residual).collect()
    }

    /// The measured position, velocity, attitude and rates at the start of a tick.
    pub fn measured_numbers(&self, tick: usize) -> Vec<f64> {
        let x = &self.measured_states[tick];
        [x.pos_m, x.vel_mps, x.att_rad, x.rate_radps].concat()
    }

    /// Windows of about `length_s`, all of one length but the last, which takes what is left.
    pub fn windows(&self, flight: usize, length_s: f64) -> Vec<Window> {
        let each = ((length_s / self.tick_s).round() as usize).max(1);
        let count = (self.ticks / each).max(1);
        let end = |w: usize| if w + 1 == count { self.ticks } else { (w + 1) * each };
        (0..count).map(|w| Window { flight, ticks: w * each..end(w) }).collect()
    }

    /// Measurements after the start of a window up to its end, whose last instant belongs to it.
    pub fn samples_in<'a>(&self, samples: &'a [Sample], ticks: &Range<usize>) -> &'a [Sample] {
        let after =
            |tick: usize| samples.partition_point(|s| s.t_s <= tick as f64 * self.tick_s + ROUNDING_S);
        &samples[after(ticks.start)..after(ticks.end)]
    }
}

/// Third differences of a vehicle that moves hard are as large as those of noise of a quarter of this.
const LEAST_SEEN_M: f64 = 1e-3;
/// Least noise of a recording, whatever its third differences.
const FLOOR: MeasurementNoise = MeasurementNoise { att_rad: [1e-4; 3], pos_m: [1e-4; 3] };
/// Motion capture is filtered and its markers shake: differences of neighbours are smaller than its error.
const FLOOR_MOCAP: MeasurementNoise = MeasurementNoise { att_rad: [0.01; 3], pos_m: [0.002; 3] };

/// Standard deviations of position, velocity, attitude and rates by motion capture. Two ways to take the
/// velocity differ by 2 to 10 mm/s on real flights. The attitude is as [`FLOOR_MOCAP`]; rates are its slopes
/// over 0.06 s.
const START_SD_MOCAP: [f64; 4] = [0.002, 0.01, 0.01, 0.3];

/// A camera's log without the take-off and the landing, if it has them and is long enough: there the floor carries
/// a part of the weight, and a filter takes that for a thrust that is shaken.
fn without_take_off(log: &FlightLog, [first_s, last_s]: [f64; 2]) -> [f64; 2] {
    let is_cameras = log.provenance.position == PositionSource::Camera;
    if !is_cameras || last_s - first_s < SHORTEST_CUT_S || log.resting_height_m().is_none() {
        return [first_s, last_s];
    }
    let takes_off = log.airborne.start > 0;
    let lands = log.airborne.end < log.len();
    let cut_s = |is_cut: bool| if is_cut { TAKE_OFF_S } else { 0.0 };
    [first_s + cut_s(takes_off), last_s - cut_s(lands)]
}

/// The frame of motion-capture markers is tilted against the vehicle, differently in each session. Over a
/// flight that begins and ends at rest the mean tilt is next to nothing, so the mean of what was measured is
/// the frame's.
fn remove_mean_tilt(angles: &mut [Sample]) {
    for axis in 0..2 {
        let mean = angles.iter().map(|s| s.value[axis]).sum::<f64>() / angles.len() as f64;
        angles.iter_mut().for_each(|sample| sample.value[axis] -= mean);
    }
}

/// The vertical form that a log drives, and its command of each row: the given form, the model's own, or the first that
/// the model has.
fn vertical_input<'a>(
    log: &'a FlightLog,
    model: &Model,
    vertical: Option<VerticalInput>,
) -> Result<(VerticalInput, Cow<'a, [f64]>)> {
    // a log without either is told of the PWM that it lacks
    let commands_pwm = log.cmd_height_m.is_none() || read_pwm(log, model).is_ok();
    let wanted =
        if commands_pwm { [VerticalInput::Thrust, VerticalInput::Pwm] } else { [VerticalInput::Height; 2] };
    let declared = model.default_input().filter(|input| input.is_pwm() == commands_pwm);
    let known = || wanted.into_iter().find(|input| model.vertical(*input).is_ok());
    let input = vertical.or(declared).or_else(known).unwrap_or(wanted[0]);
    model.vertical(input)?;
    Ok((input, read_lift(log, model, input)?))
}

fn command_source<'a>(
    log: &'a FlightLog,
    model: &Model,
    measured: &'a Measurements,
    lift: &'a [f64],
    clock: &'a ControlClock,
) -> Result<impl Fn(f64) -> Command<f64> + 'a> {
    let [roll, pitch] = read_tilt(log, model.command.tilt)?;
    let sign = model.yaw.sign();
    let skew_s = |n: &Note| if let Note::ClockSkew { median_s, .. } = n { Some(*median_s) } else { None };
    let skew_s = log.notes.iter().find_map(skew_s).unwrap_or(0.0);
    let row_at = |t_s: f64| log.t_s.partition_point(|t| *t <= t_s + ROUNDING_S).saturating_sub(1);
    let late_s = log.onboard.as_ref().and_then(|onboard| onboard.late_s.as_ref());
    Ok(move |here_s: f64| {
        // commands are on the clock of the vehicle
        let t_s = here_s + late_s.map_or(skew_s, |late| late[row_at(here_s)]);
        // the first row of a tick may be lost, or bear an early or late stamp
        let early_s = if clock.skips_rows { t_s - 0.5 * clock.row_s } else { t_s };
        let last = row_at(early_s + clock.tick_s - 2.0 * ROUNDING_S);
        let first = log.t_s.partition_point(|t| *t < early_s);
        let row = if clock.skips_rows { first.min(last) } else { row_at(t_s) };
        let mean = |v: &[f64]| v[row..=last].iter().sum::<f64>() / (last - row + 1) as f64;
        // without a logged command the heading follows what was measured: the fit of yaw then says nothing
        let yaw_rate_radps =
            log.cmd_yaw_rate_radps.as_ref().map_or_else(|| sign * measured.yaw_rate(t_s), |v| mean(v));
        Command { roll_rad: mean(roll), pitch_rad: mean(pitch), yaw_rate_radps, lift: mean(lift) }
    })
}

/// A measured state with the second states of the model's forms: the rate itself, or no lagged push (see
/// [`Model::lags_push`]).
pub fn with_lags<R: Scalar>(model: &Model, input: VerticalInput, mut x: State<R>) -> State<R> {
    let [climb, turn] = model.lags_push(input).unwrap_or_default();
    x.aux = [if climb { R::zero() } else { x.vel_mps[2] }, if turn { R::zero() } else { x.rate_radps[2] }];
    x
}

/// Sets how much more each fix scatters where the camera sees worse.
fn set_noise_scales(fixes: &mut [Sample], place_m: &dyn Fn(f64) -> [f64; 3]) {
    let places: Vec<[f64; 3]> = fixes.iter().map(|f| place_m(f.t_s)).collect();
    let noise_m = white_noise_sd(fixes, FLOOR.pos_m);
    for axis in (0..3).filter(|axis| noise_m[*axis] > LEAST_SEEN_M) {
        let scales = noise_scales(&places, &third_differences(fixes, axis));
        fixes.iter_mut().zip(scales).for_each(|(fix, scale)| fix.noise_scale[axis] = scale);
    }
}

/// The white part of the error per axis, by the median against outliers.
fn white_noise_sd(samples: &[Sample], floor: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let third = third_differences(samples, axis).into_iter();
        robust_sd(third.map(|(i, third)| third / samples[i + 1].noise_scale[axis])).max(floor[axis])
    })
}

/// Third differences of four neighbours none of which is missing, with the index of the first, scaled to the
/// variance of one white error: the squares of 1, 3, 3 and 1 are 20 together.
fn third_differences(samples: &[Sample], axis: usize) -> Vec<(usize, f64)> {
    let usual = usual_step(&samples.iter().map(|s| s.t_s).collect::<Vec<_>>()).unwrap_or(0.0);
    let whole = |four: &[Sample]| four[3].t_s - four[0].t_s < 3.5 * usual;
    let third = |s: &[Sample]| {
        (s[3].value[axis] - 3.0 * (s[2].value[axis] - s[1].value[axis]) - s[0].value[axis]) / 20.0_f64.sqrt()
    };
    samples.windows(4).enumerate().filter(|(_, four)| whole(four)).map(|(i, four)| (i, third(four))).collect()
}
