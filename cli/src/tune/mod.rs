//! The thesis's "PID Tuner" (7.2): the fastest response without overshoot, with a margin, by CMA-ES over flights in the simulator.

mod margins;
mod picture;
mod response;

use cmaes::{CMAESOptions, DVector};
use crazyflie_control::pid::{Gains, Loop};
use crazyflie_env::Error;
use crazyflie_env::model::Model;
use crazyflie_env::observation::Interface;

pub(crate) use margins::{AXES, Axis, Margins, margins};
pub(crate) use picture::picture;
pub(crate) use response::{Figures, Flown, Response};

use margins::Plant;

/// What is asked of a loop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub phase_deg: f64,
    pub gain_db: f64,
    /// Share of the step.
    pub overshoot: f64,
    /// Of the loop: what the controller sees is so old, and what it says is held.
    pub dead_time_s: f64,
}

/// How a loop does with some gains.
#[derive(Debug, Clone)]
pub(crate) struct Done {
    pub gains: Loop,
    pub margins: Margins,
    pub figures: Figures,
    pub response: Response,
    pub task_error_s: Option<f64>,
}

/// One loop with each of the gains that are compared.
#[derive(Debug, Clone)]
pub(crate) struct Tuned {
    pub axis: Axis,
    pub stock: Done,
    pub thesis: Done,
    pub found: Done,
    /// Flights of a batch that the search took.
    pub tried: usize,
}

/// Generations of the search per loop, and its seed.
const GENERATIONS: usize = 24;
const POPULATION: usize = 10;
const SEED: u64 = 71;
/// Gains may be so many times those of the start, up or down.
const SPAN: f64 = 2.5;

/// Tunes the four loops, each with those before it as they came out; `done` is called after each.
///
/// # Errors
/// Those of the flights.
pub(crate) fn tune(flown: &Flown<'_>, wanted: &Wanted, done: &dyn Fn(Axis)) -> Result<(Gains, Vec<Tuned>), Error> {
    let hover = Interface::from_model(flown.model, flown.vertical)?.hover_lift;
    let fit = |gains: Gains| if hover > 0.0 { gains.for_hover(hover) } else { gains };
    let (stock, thesis) = (fit(Gains::CRAZYFLIE_ROS), fit(Gains::THESIS));
    let (mut gains, mut all) = (thesis, Vec::new());
    for axis in AXES {
        // a height command needs no height loop
        if axis == Axis::Z && !flown.vertical.is_pwm() {
            continue;
        }
        let (best, tried) = search(flown, wanted, &gains, axis)?;
        gains = with_loop(&gains, axis, best);
        // each loop of the others in the same company, so that loops are compared and nothing else
        let with = |table: &Gains| judge(flown, wanted, &with_loop(&gains, axis, *of(table, axis)), axis);
        all.push(Tuned { axis, stock: with(&stock)?, thesis: with(&thesis)?, found: with(&gains)?, tried });
        done(axis);
    }
    Ok((gains, all))
}

fn of(gains: &Gains, axis: Axis) -> &Loop {
    match axis {
        Axis::X => &gains.x,
        Axis::Y => &gains.y,
        Axis::Z => &gains.z,
        Axis::Yaw => &gains.yaw,
    }
}

/// With another loop. What is tried in x is tried in y as well, until y has its turn: a flight is no better than the worse of the two.
fn with_loop(gains: &Gains, axis: Axis, new: Loop) -> Gains {
    match axis {
        Axis::X => Gains { x: new, y: new, ..*gains },
        Axis::Y => Gains { y: new, ..*gains },
        Axis::Z => Gains { z: new, ..*gains },
        Axis::Yaw => Gains { yaw: new, ..*gains },
    }
}

fn judge(flown: &Flown<'_>, wanted: &Wanted, gains: &Gains, axis: Axis) -> Result<Done, Error> {
    let plant = Plant::of(flown.model, flown.vertical, axis)?;
    let response = flown.response(gains, axis)?;
    let (own, task_error_s) = (*of(gains, axis), flown.task_error_s(gains, axis)?);
    Ok(Done { gains: own, margins: margins(&plant, &own, wanted.dead_time_s), figures: response.figures(axis), response, task_error_s })
}

/// The gains of one loop that cost least, and how many were tried.
fn search(flown: &Flown<'_>, wanted: &Wanted, gains: &Gains, axis: Axis) -> Result<(Loop, usize), Error> {
    let start = *of(gains, axis);
    let plant = Plant::of(flown.model, flown.vertical, axis)?;
    // in logarithms, from the start; a gain of nothing stays nothing
    let at = |point: &DVector<f64>| {
        let scaled = |gain: f64, i: usize| gain * (SPAN * point[i].tanh()).exp();
        Loop { kp: scaled(start.kp, 0), ki: scaled(start.ki, 1), kd: scaled(start.kd, 2), ..start }
    };
    let cost = |point: &DVector<f64>| {
        let own = at(point);
        let margins = margins(&plant, &own, wanted.dead_time_s);
        let gains = with_loop(gains, axis, own);
        let flights = flown.response(&gains, axis).and_then(|response| Ok((response, flown.task_error_s(&gains, axis)?)));
        // gains that cannot be flown are the worst; the flight at the end says what is wrong
        flights.map_or(f64::MAX, |(response, task_error_s)| price(wanted, &margins, &response, axis) + task_error_s.unwrap_or(0.0))
    };
    let options = CMAESOptions::new(vec![0.0; 3], 0.35).population_size(POPULATION).max_generations(GENERATIONS).seed(SEED);
    let mut search = options.build(cost).map_err(|e| Error::Config(format!("the search cannot begin: {e:?}")))?;
    let ended = search.run_parallel();
    let best = ended.overall_best.map_or(start, |best| at(&best.point));
    Ok((best, search.function_evals()))
}

/// Seconds of error, and for what is not as wanted more of them.
fn price(wanted: &Wanted, margins: &Margins, response: &Response, axis: Axis) -> f64 {
    let f = response.figures(axis);
    let over = (f.overshoot - wanted.overshoot).max(0.0);
    let phase = (wanted.phase_deg - margins.phase_deg).clamp(0.0, 180.0);
    let gain = (wanted.gain_db - margins.gain_db).clamp(0.0, 40.0);
    f.error_s + 20.0 * over + 0.1 * phase + 0.2 * gain + 0.05 * response.travel_per_s
}

/// Dead time of the position loops on this rig: latency of the camera, and the mean age of a held frame and of a held command.
pub(crate) fn dead_time_s(model: &Model, latency_s: f64) -> f64 {
    latency_s + 0.5 / model.rig.camera.value + 0.5 / model.rig.control.value
}
