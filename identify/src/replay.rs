//! The thesis's first simulation block (7.1.1): the commands of a recorded flight drive the model open loop,
//! and what it predicts is compared with what was measured.

pub(crate) mod measurements;

use crazyflie_statistics::quantile;
use std::borrow::Cow;
use std::ops::Range;
use std::str::FromStr;

use crazyflie_env::config::{EffectParams, EffectTable};
use crazyflie_env::model::{Model, TiltInput, Vertical, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use serde_json::{Map, Value, json};

use crate::fit::flight::with_lags;
use crate::lift::{no_commands, read_lift, read_tilt};
use crate::metrics::Fit;
use crate::{Error, FlightLog, Result};

use measurements::{Measurements, interpolate};

/// The clock on which the model is replayed: that of the recordings.
const TICK_HZ: f64 = 100.0;
const TICK_S: f64 = 1.0 / TICK_HZ;
/// A command whose time differs from a tick's only by rounding belongs to it.
const ROUNDING_S: f64 = 1e-6;

/// One of the outputs of the thesis's first block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signal {
    /// Label in tables and plots, such as `vx`.
    pub name: &'static str,
    /// Unit for people; values inside are SI and radians.
    pub unit: &'static str,
    /// Marks values that are angles, which people read in degrees.
    pub is_angle: bool,
}

impl Signal {
    /// A value of this signal in [`Signal::unit`].
    pub fn in_unit(&self, si: f64) -> f64 {
        if self.is_angle { si.to_degrees() } else { si }
    }
}

const fn signal(name: &'static str, unit: &'static str) -> Signal {
    Signal { name, unit, is_angle: matches!(unit.as_bytes(), b"deg") }
}

/// Outputs of the thesis's first block, in the order of its figure 7.1.
pub const SIGNALS: [Signal; 8] = [
    signal("roll", "deg"),
    signal("pitch", "deg"),
    signal("yaw", "deg"),
    signal("z", "m"),
    signal("vx", "m/s"),
    signal("vy", "m/s"),
    signal("x", "m"),
    signal("y", "m"),
];

/// Source of the hover PWM of the `thrust` form.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum HoverSource {
    /// The PWM in the model.
    #[default]
    OfModel,
    /// The median thrust command of the flight: what carried this vehicle.
    MedianThrust,
    /// This PWM, in counts.
    Given(f64),
}

impl FromStr for HoverSource {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.parse::<f64>() {
            _ if text == "auto" => Ok(HoverSource::MedianThrust),
            Ok(pwm) if (1.0..=65_535.0).contains(&pwm) => Ok(HoverSource::Given(pwm)),
            _ => Err("expected auto or a PWM from 1 to 65535"),
        }
    }
}

/// Options of a replay.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReplayOptions {
    /// Vertical form that is driven; the one whose command the log has unless given.
    pub vertical: Option<VerticalInput>,
    /// Start again from the measurement after so many seconds; `None` runs free from the start to the end.
    pub horizon_s: Option<f64>,
    /// Source of the PWM at which the model hovers.
    pub hover: HoverSource,
    /// Give the model the measured yaw rate for a command, if the log has none, so that its heading is right.
    pub measured_yaw_rate: bool,
}

/// One signal, measured and predicted at the same times.
#[derive(Debug, Clone, PartialEq)]
pub struct SignalComparison {
    /// Times of the measurements, on the clock of the log.
    pub t_s: Vec<f64>,
    /// Measured values.
    pub measured: Vec<f64>,
    /// Values of the model.
    pub predicted: Vec<f64>,
    /// Agreement of the two.
    pub fit: Fit,
}

/// A flight replayed.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// Vertical form that was driven.
    pub input: VerticalInput,
    /// From the first measured state to the end of the flight.
    pub start_s: f64,
    /// Time of the log at which the replay ends.
    pub end_s: f64,
    /// In the order of [`SIGNALS`], SI and radians.
    pub signals: [SignalComparison; 8],
    /// Assumptions and derivations, in the order in which they were made.
    pub remarks: Vec<String>,
}

impl SignalComparison {
    /// The measured and the predicted value at a time, between the measurements interpolated.
    #[must_use]
    pub fn values_at(&self, t_s: f64) -> [f64; 2] {
        [&self.measured, &self.predicted].map(|values| interpolate(&self.t_s, values, t_s))
    }
}

impl Replay {
    /// Returns how well every signal agrees, for machines; without a horizon the replay ran free.
    #[must_use]
    pub fn summary(&self, horizon_s: Option<f64>) -> Value {
        let signals = SIGNALS.iter().zip(&self.signals).map(|(signal, compared)| {
            let fit = compared.fit;
            let value = json!({"unit": signal.unit, "fit_percent": fit.fit_percent, "rmse": signal.in_unit(fit.rmse),
                "max_error": signal.in_unit(fit.max_error), "samples": compared.t_s.len()});
            (signal.name.to_owned(), value)
        });
        json!({"horizon_s": horizon_s, "vertical": self.input.name(), "start_s": self.start_s, "end_s": self.end_s,
            "remarks": self.remarks, "signals": signals.collect::<Map<_, _>>()})
    }
}

/// Replays a recorded flight on a model.
///
/// # Errors
/// [`Error`]: the log lacks commands or never flies, the model lacks the vertical form, or its effects
/// are drawn at random.
pub fn replay(model: &Model, log: &FlightLog, plan: &ReplayOptions) -> Result<Replay> {
    let horizon_ticks = horizon_ticks(plan.horizon_s)?;
    if read_tilt(log, model.command.tilt).is_err()
        && log.cmd_thrust_pwm.is_none()
        && log.cmd_height_m.is_none()
    {
        return Err(no_commands("commands"));
    }
    refuse_drawn(&model.effects)?;
    let (input, lift) = vertical_command(model, log, plan)?;
    let lift = &lift[..];
    let mut remarks = Vec::new();
    let model = model_on_replay_clock(model, log, lift, input, plan, &mut remarks)?;
    let measured = Measurements::from_log(log, &mut remarks)?;
    let commands =
        Commands::from_log(log, lift, &measured, model.yaw.sign(), model.command.tilt, plan, &mut remarks)?;
    let (start_s, ticks) = measured.interval(log, TICK_S)?;
    let end_s = start_s + ticks as f64 * TICK_S;
    let settings = Settings { input, physics_hz: None };
    let mut world = World::<f64>::new(&model, &EffectTable::new(), settings, 1)?.without_floor();
    let each = horizon_ticks.unwrap_or(ticks).min(ticks);
    let mut runs = Vec::new();
    for first in (0..ticks).step_by(each) {
        let begin_s = start_s + first as f64 * TICK_S;
        let start = with_lags(&model, input, measured.state(begin_s));
        runs.push(run_open_loop(&mut world, &start, begin_s, each.min(ticks - first), &commands));
    }
    let prediction = OpenLoopRuns { start_s, each, runs };
    let signals = compare(&measured, &prediction, end_s)?;
    Ok(Replay { input, start_s, end_s, signals, remarks })
}

fn horizon_ticks(horizon_s: Option<f64>) -> Result<Option<usize>> {
    match horizon_s {
        None => Ok(None),
        Some(s) if s >= TICK_S && s.is_finite() => Ok(Some((s * TICK_HZ).round() as usize)),
        Some(value_s) => Error::options(format!(
            "a horizon of {value_s} s cannot be replayed, expected at least {TICK_S} s"
        )),
    }
}

/// A replay has no seed: effects of the model must be numbers.
fn refuse_drawn(effects: &EffectTable) -> Result<()> {
    let drawn = effects.iter().find(|(_, params)| match params {
        EffectParams::First(number) => number.fixed().is_none(),
        EffectParams::Named(map) => map.values().any(|number| number.fixed().is_none()),
    });
    drawn.map_or(Ok(()), |(name, _)| {
        Error::options(format!(
            "the model's effect {name:?} is drawn at random; a replay needs fixed numbers"
        ))
    })
}

/// Which vertical form, and the log's command for it.
fn vertical_command<'a>(
    model: &Model,
    log: &'a FlightLog,
    plan: &ReplayOptions,
) -> Result<(VerticalInput, Cow<'a, [f64]>)> {
    let wanted = match (plan.vertical, plan.hover) {
        (Some(input), _) => input,
        (None, HoverSource::OfModel) => {
            let inputs = model.inputs();
            let held = inputs.iter().find(|input| read_lift(log, model, **input).is_ok());
            // without any, the error names the first one
            held.or(inputs.first()).copied().unwrap_or(VerticalInput::Pwm)
        }
        (None, _) => VerticalInput::Thrust,
    };
    model.vertical(wanted)?;
    Ok((wanted, read_lift(log, model, wanted)?))
}

/// Returns a copy of the model whose control tick is the replay's, with the requested hover PWM.
fn model_on_replay_clock(
    model: &Model,
    log: &FlightLog,
    lift: &[f64],
    input: VerticalInput,
    plan: &ReplayOptions,
    remarks: &mut Vec<String>,
) -> Result<Model> {
    let mut model = model.clone();
    model.rig.control.value = TICK_HZ;
    model.rig.imu.value = TICK_HZ;
    model.rig.camera.value = model.rig.camera.value.min(TICK_HZ);
    if !input.is_pwm() {
        return Ok(model);
    }
    let flight = quantile(lift.get(log.airborne.clone()).unwrap_or(lift), 0.5).unwrap_or(0.0);
    if plan.hover == HoverSource::OfModel {
        let words = |model: f64| format!("of the flight {flight:.0} PWM; the model hovers at {model:.0} PWM");
        let hovers = model.vertical(input)?.hover_pwm();
        remarks.extend(hovers.map(|model| format!("median thrust command {}", words(model))));
        return Ok(model);
    }
    let (VerticalInput::Thrust, Some(Vertical::Thrust { hover, .. })) = (input, &mut model.vertical.thrust)
    else {
        return Error::options("the hover PWM can only be set for the model's vertical form \"thrust\"");
    };
    let pwm = if let HoverSource::Given(pwm) = plan.hover { pwm } else { flight };
    if !(pwm > 0.0 && pwm.is_finite()) {
        return Error::logs(format!(
            "a hover PWM of {pwm} cannot carry a vehicle, expected a positive number"
        ));
    }
    remarks.push(format!("hover PWM taken as {pwm:.0} instead of the model's {:.0}", hover.value));
    hover.value = pwm;
    Ok(model)
}

/// The commands of a log, constant between its rows.
struct Commands<'a> {
    t_s: &'a [f64],
    vbat_v: Option<Vec<f64>>,
    roll_rad: &'a [f64],
    pitch_rad: &'a [f64],
    yaw_rate_radps: Option<Vec<f64>>,
    lift: &'a [f64],
}

impl<'a> Commands<'a> {
    fn from_log(
        log: &'a FlightLog,
        lift: &'a [f64],
        measured: &Measurements,
        yaw_sign: f64,
        tilt: TiltInput,
        plan: &ReplayOptions,
        remarks: &mut Vec<String>,
    ) -> Result<Self> {
        let [roll_rad, pitch_rad] = read_tilt(log, tilt)?;
        let yaw_rate_radps = match &log.cmd_yaw_rate_radps {
            Some(logged) => Some(logged.clone()),
            None if plan.measured_yaw_rate => {
                let why = "the measured yaw rate is given instead, so the fit of yaw says nothing";
                remarks.push(format!("no yaw-rate command in the log: {why}"));
                Some(log.t_s.iter().map(|t| yaw_sign * measured.yaw_rate(*t)).collect())
            }
            None => {
                remarks.push("no yaw-rate command in the log: taken as 0".to_owned());
                None
            }
        };
        let (t_s, vbat_v) = (&log.t_s[..], log.steady_voltage_v());
        Ok(Commands { t_s, vbat_v, roll_rad, pitch_rad, yaw_rate_radps, lift })
    }

    fn row(&self, t_s: f64) -> usize {
        self.t_s.partition_point(|t| *t <= t_s + ROUNDING_S).saturating_sub(1)
    }

    /// Returns the battery voltage at a time, if the log has it.
    fn voltage_v(&self, t_s: f64) -> Option<f64> {
        self.vbat_v.as_ref().map(|v| v[self.row(t_s)])
    }

    /// The command in force at a time: that of the last row before it.
    fn command_at(&self, t_s: f64) -> Command<f64> {
        let row = self.row(t_s);
        Command {
            roll_rad: self.roll_rad[row],
            pitch_rad: self.pitch_rad[row],
            yaw_rate_radps: self.yaw_rate_radps.as_ref().map_or(0.0, |rate| rate[row]),
            lift: self.lift[row],
        }
    }
}

/// The eight signals over one open-loop run, one row per tick, the start included.
fn run_open_loop(
    world: &mut World<f64>,
    start: &State<f64>,
    begin_s: f64,
    ticks: usize,
    commands: &Commands<'_>,
) -> Vec<[f64; 8]> {
    world.start(0, true, start, &commands.command_at(begin_s - TICK_S));
    let step = |tick: usize| {
        let t_s = begin_s + tick as f64 * TICK_S;
        world.set_voltage(commands.voltage_v(t_s));
        world.step(0, &commands.command_at(t_s));
        outputs(world.state(0))
    };
    std::iter::once(outputs(start)).chain((0..ticks).map(step)).collect()
}

/// A state in the order of [`SIGNALS`].
fn outputs(x: &State<f64>) -> [f64; 8] {
    let ([roll, pitch, yaw], [px, py, z], [vx, vy, _]) = (x.att_rad, x.pos_m, x.vel_mps);
    [roll, pitch, yaw, z, vx, vy, px, py]
}

/// Open-loop runs, one after the other.
struct OpenLoopRuns {
    start_s: f64,
    /// Ticks per run.
    each: usize,
    runs: Vec<Vec<[f64; 8]>>,
}

impl OpenLoopRuns {
    /// A signal at a time after the start. At the moment of a new start the value is of the run before it: its
    /// prediction is the older one.
    fn value_at(&self, signal: usize, t_s: f64) -> f64 {
        let tick = ((t_s - self.start_s) * TICK_HZ).max(0.0);
        let run = ((tick - ROUNDING_S).max(0.0) / self.each as f64) as usize;
        let run = run.min(self.runs.len() - 1);
        let rows = &self.runs[run];
        let within = (tick - (run * self.each) as f64).clamp(0.0, (rows.len() - 1) as f64);
        let (before, part) = (within.floor() as usize, within.fract());
        let after = (before + 1).min(rows.len() - 1);
        rows[before][signal] + part * (rows[after][signal] - rows[before][signal])
    }
}

fn compare(measured: &Measurements, prediction: &OpenLoopRuns, end_s: f64) -> Result<[SignalComparison; 8]> {
    let mut all = Vec::with_capacity(SIGNALS.len());
    for (index, signal) in SIGNALS.iter().enumerate() {
        let track = measured.track(index);
        let Range { start, end } = track.between(prediction.start_s + ROUNDING_S, end_s + ROUNDING_S);
        let t_s = track.t_s[start..end].to_vec();
        let measured = track.values[start..end].to_vec();
        let predicted: Vec<f64> = t_s.iter().map(|t| prediction.value_at(index, *t)).collect();
        let fit = Fit::new(&measured, &predicted).map_err(|why| Error::about(signal.name, why))?;
        all.push(SignalComparison { t_s, measured, predicted, fit });
    }
    // one per signal
    all.try_into().map_err(|_| no_commands("signals"))
}
