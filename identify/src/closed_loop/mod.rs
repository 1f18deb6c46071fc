//! The thesis's second simulation block (7.1.2): a controller flies the model along the set-points of a recorded
//! flight, and the resulting flight is compared with the recorded one.

mod firmware;

use crazyflie_control::pid::{Gains, Pid};
use crazyflie_control::{ControlLaw, Mode};
use crazyflie_env::action::Interface;
use crazyflie_env::config::{EffectParams, EffectTable, Number};
use crazyflie_env::effects::Reading;
use crazyflie_env::model::Model;
use crazyflie_env::observation::{Setpoint, observe};
use crazyflie_env::plant::Command;
use crazyflie_env::world::{Settings, World};
use firmware::FirmwareCascade;
use serde::Serialize;

use crate::fit::flight::{Flight, with_lags};
use crate::{FlightLog, Result};

/// Age beyond which frames are a camera's (s).
const LATENCY_S: f64 = 0.005;
const ROUNDING_S: f64 = 1e-6;
/// A controller that gives this share of the commands is the one that flew: of another's commands, the thesis
/// PID and the firmware's cascade give less than nothing or hardly anything.
const LEAST_SHARE: f64 = 0.5;

/// A recorded flight and the one that a controller is predicted to fly along its set-points, at the times of
/// the recorded positions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracking {
    /// Capture times of the recorded positions after the start, on the clock of the log.
    pub t_s: Vec<f64>,
    /// Set-points in force at these times: x, y, z in the world frame.
    pub setpoint_m: Vec<[f64; 3]>,
    /// Recorded positions: x, y, z in the world frame.
    pub measured_m: Vec<[f64; 3]>,
    /// Positions of the predicted flight, interpolated linearly between its ticks.
    pub predicted_m: Vec<[f64; 3]>,
}

/// Root mean square distances in metres, over all samples of some flights.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distances {
    /// From the predicted to the measured flight.
    pub predicted_m: f64,
    /// From the set-point to the measured flight: the tracking error, and the error of the prediction "exactly at the
    /// set-point".
    pub measured_tracking_m: f64,
    /// From the set-point to the predicted flight: the predicted tracking error.
    pub predicted_tracking_m: f64,
}

impl Distances {
    /// Computes the distances over all samples of the flights; NaN without samples.
    pub fn new(flights: &[Tracking]) -> Self {
        let rms = |pick: &dyn Fn(&Tracking) -> [&[[f64; 3]]; 2]| {
            let squares = |f: &Tracking| -> f64 {
                let [first, second] = pick(f);
                first.as_flattened().iter().zip(second.as_flattened()).map(|(a, b)| (a - b).powi(2)).sum()
            };
            let samples: usize = flights.iter().map(|f| f.t_s.len()).sum();
            (flights.iter().map(squares).sum::<f64>() / samples as f64).sqrt()
        };
        Distances {
            predicted_m: rms(&|f| [&f.predicted_m, &f.measured_m]),
            measured_tracking_m: rms(&|f| [&f.setpoint_m, &f.measured_m]),
            predicted_tracking_m: rms(&|f| [&f.setpoint_m, &f.predicted_m]),
        }
    }
}

/// The controllers that may have flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Controller {
    /// The thesis PID with its new gains on what the rig measures. The height loop's gains are in parts of
    /// the PWM that carries the model, as table 7.1's are of the thesis's vehicle.
    Thesis,
    /// The firmware's cascade with its default gains, on the true state.
    Firmware,
}

impl Controller {
    /// Returns the controller's name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Thesis => "thesis PID",
            Self::Firmware => "firmware's cascade",
        }
    }

    /// Recognises the controller that flew, by its logged commands for roll and pitch: from the measured states and
    /// the set-points, it reproduces most of them. Returns `None` if none does, or the log has no set-points.
    ///
    /// # Errors
    /// [`crate::Error`] if the model cannot be flown.
    pub fn recognise(model: &Model, log: &FlightLog, flight: &Flight) -> Result<Option<Self>> {
        let mut best = (LEAST_SHARE, None);
        for controller in [Self::Thesis, Self::Firmware] {
            let share = controller.command_share(model, log, flight)?.filter(|share| *share > best.0);
            best = share.map_or(best, |share| (share, Some(controller)));
        }
        Ok(best.1)
    }

    /// Share of the squared roll and pitch commands of a flight, in their mean over both, that a controller gives
    /// on the measured states.
    fn command_share(self, model: &Model, log: &FlightLog, flight: &Flight) -> Result<Option<f64>> {
        let Some(targets) = Targets::from_log(log) else { return Ok(None) };
        let mut control_loop = ControlLoop::new(model, log, flight, self)?;
        let first = targets.first_tick(flight);
        let (mut left, mut all) = (0.0, 0.0);
        for tick in first..flight.ticks {
            let state = with_lags(model, flight.input, *flight.measured_state(tick));
            let t_s = tick as f64 * flight.tick_s;
            let (pos_m, yaw_rad) = targets.setpoint_at(flight.start_s + t_s, state.att_rad[2]);
            let flown = flight.command(tick as isize);
            let reading = control_loop.world.start(0, true, &state, flown);
            let predicted = control_loop.command(&reading, t_s, &Setpoint { pos_m, yaw_rad });
            left += (predicted.roll_rad - flown.roll_rad).powi(2)
                + (predicted.pitch_rad - flown.pitch_rad).powi(2);
            all += flown.roll_rad.powi(2) + flown.pitch_rad.powi(2);
        }
        Ok((all > 0.0).then(|| 1.0 - left / all))
    }

    /// Flies the controller on a model along the set-points of a log, from the state in which the recorded flight begins.
    /// If positions were late, as from a camera, the thesis PID gets 30 frames a second with that delay. Returns `None`
    /// if the log has no set-points, or for the firmware with other commands than thrust.
    ///
    /// # Errors
    /// [`crate::Error`] if the model cannot be flown.
    pub fn follow(self, model: &Model, log: &FlightLog, flight: &Flight) -> Result<Option<Tracking>> {
        let Some(targets) = Targets::from_log(log) else { return Ok(None) };
        let mut control_loop = ControlLoop::new(model, log, flight, self)?;
        let interface = control_loop.interface;
        let tick_s = control_loop.world.tick_s();
        let first = targets.first_tick(flight);
        if first >= flight.ticks || (self == Controller::Firmware && !interface.input.is_pwm()) {
            return Ok(None);
        }
        let start = with_lags(model, flight.input, *flight.measured_state(first));
        let offset_s = first as f64 * flight.tick_s;
        let lift = if interface.input.is_pwm() { interface.hover_lift } else { start.pos_m[2] };
        let mut reading = control_loop.world.start(0, true, &start, &Command::level(lift));
        let mut positions = vec![start.pos_m];
        for tick in 0..((flight.ticks as f64 * flight.tick_s - offset_s) / tick_s + ROUNDING_S) as usize {
            let t_s = tick as f64 * tick_s;
            let (pos_m, yaw_rad) = targets.setpoint_at(flight.start_s + offset_s + t_s, start.att_rad[2]);
            let command = control_loop.command(&reading, t_s, &Setpoint { pos_m, yaw_rad });
            reading = control_loop.world.step(0, &command).reading;
            positions.push(control_loop.world.state(0).pos_m);
        }
        Ok(Some(targets.compare(flight, offset_s, tick_s, &positions)))
    }
}

/// Controllers with the world that they steer.
struct ControlLoop {
    controller: Controller,
    world: World<f64>,
    interface: Interface,
    pid: Pid<f64>,
    firmware: FirmwareCascade,
    action: [f64; 4],
}

impl ControlLoop {
    fn new(model: &Model, log: &FlightLog, flight: &Flight, controller: Controller) -> Result<Self> {
        let settings = Settings { input: flight.input, physics_hz: None };
        let world = World::<f64>::new(model, &localisation_effects(log, model), settings, 1)?;
        let interface = Interface::from_model(model, flight.input)?;
        let (tick_s, hover) = (world.tick_s(), interface.hover_lift);
        let pid = Pid::<f64>::new(Gains::THESIS.for_hover(hover), interface, tick_s, Mode::Automatic);
        let firmware = FirmwareCascade::new(tick_s, hover, interface.yaw_sign);
        Ok(ControlLoop { controller, world, interface, pid, firmware, action: [0.0; 4] })
    }

    fn command(&mut self, reading: &Reading<f64>, t_s: f64, setpoint: &Setpoint<f64>) -> Command<f64> {
        match self.controller {
            Controller::Thesis => {
                self.action = self.pid.act(&observe(reading, t_s, setpoint, &self.action));
                self.interface.command(&self.action)
            }
            Controller::Firmware => self.firmware.command(self.world.state(0), setpoint),
        }
    }
}

/// The localisation that the log speaks of: a camera as late as its frames are, or none.
fn localisation_effects(log: &FlightLog, model: &Model) -> EffectTable {
    const LATENCY: &str = "camera_latency";
    let fixes = log.fixes.row.iter().zip(&log.fixes.capture_t_s);
    let late_s = fixes.map(|(row, captured_s)| log.t_s[*row] - captured_s);
    let latency_s = late_s.sum::<f64>() / log.fixes.row.len().max(1) as f64;
    if latency_s < LATENCY_S {
        return EffectTable::new();
    }
    let mut params = match model.effects.get(LATENCY) {
        Some(EffectParams::Named(params)) => params.clone(),
        _ => Default::default(),
    };
    params.insert("latency_s".to_owned(), Number::Fixed(latency_s));
    EffectTable::from([(LATENCY.to_owned(), EffectParams::Named(params))])
}

/// Set-points of a log, constant between its rows.
struct Targets<'a> {
    t_s: &'a [f64],
    pos_m: &'a [Vec<f64>; 3],
    yaw_rad: Option<&'a [f64]>,
    first_s: f64,
    last_row: usize,
}

impl<'a> Targets<'a> {
    fn from_log(log: &'a FlightLog) -> Option<Self> {
        let pos_m = log.setpoint_m.as_ref()?;
        // three zeros say "none"
        let has_setpoint = |row: &usize| pos_m.iter().any(|axis| axis[*row] != 0.0);
        let first = (0..log.t_s.len()).find(has_setpoint)?;
        let last_row = (0..log.t_s.len()).rev().find(has_setpoint)?;
        Some(Targets {
            t_s: &log.t_s,
            pos_m,
            yaw_rad: log.setpoint_yaw_rad.as_deref(),
            first_s: log.t_s[first],
            last_row,
        })
    }

    /// The predicted flight at the times of the measured positions.
    fn compare(&self, flight: &Flight, offset_s: f64, tick_s: f64, positions: &[[f64; 3]]) -> Tracking {
        let mut out = Tracking::default();
        for fix in flight.fixes.iter().filter(|f| f.t_s > offset_s) {
            let tick = (fix.t_s - offset_s) / tick_s;
            let (before, share) = (tick as usize, tick.fract());
            let Some([a, b]) = positions.get(before..before + 2) else { break };
            out.t_s.push(flight.start_s + fix.t_s);
            out.setpoint_m.push(self.setpoint_at(flight.start_s + fix.t_s, 0.0).0);
            out.measured_m.push(fix.value);
            out.predicted_m.push(std::array::from_fn(|i| a[i] + share * (b[i] - a[i])));
        }
        out
    }

    /// The first tick of a flight with a set-point.
    fn first_tick(&self, flight: &Flight) -> usize {
        ((self.first_s - flight.start_s).max(0.0) / flight.tick_s).ceil() as usize
    }

    /// In force at a time of the log: position, and the heading unless the log has none.
    fn setpoint_at(&self, t_s: f64, yaw_rad: f64) -> ([f64; 3], f64) {
        let row = self.t_s.partition_point(|t| *t <= t_s + ROUNDING_S).saturating_sub(1).min(self.last_row);
        (std::array::from_fn(|axis| self.pos_m[axis][row]), self.yaw_rad.map_or(yaw_rad, |yaw| yaw[row]))
    }
}
