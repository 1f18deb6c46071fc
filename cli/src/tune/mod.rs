//! The thesis's "PID Tuner" (7.2): the fastest response without overshoot, with a margin, by CMA-ES over
//! flights in the simulator.

mod margins;
mod picture;
mod response;

use cmaes::{CMAESOptions, DVector};
use crazyflie_control::pid::{Gains, Loop};
use crazyflie_env::Error;
use crazyflie_env::model::Model;
use crazyflie_env::observation::Interface;

pub(crate) use margins::{AXES, LoopAxis, Margins, margins};
pub(crate) use picture::picture;
pub(crate) use response::{Response, StepFigures, TuningSetup};

use margins::Plant;

/// Requirements on a loop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LoopRequirements {
    pub phase_deg: f64,
    pub gain_db: f64,
    /// Share of the step.
    pub overshoot: f64,
    /// Dead time of the loop, from sensing to the held command.
    pub dead_time_s: f64,
}

/// Margins, step response and task error of a loop with some gains.
#[derive(Debug, Clone)]
pub(crate) struct LoopEvaluation {
    pub gains: Loop,
    pub margins: Margins,
    pub figures: StepFigures,
    pub response: Response,
    pub task_error_s: Option<f64>,
}

/// A loop with stock, thesis and tuned gains.
#[derive(Debug, Clone)]
pub(crate) struct GainComparison {
    pub axis: LoopAxis,
    pub stock: LoopEvaluation,
    pub thesis: LoopEvaluation,
    pub found: LoopEvaluation,
    /// Flights of a batch that the search took.
    pub tried: usize,
}

/// Generations of the search per loop, and its seed.
const GENERATIONS: usize = 24;
const POPULATION: usize = 10;
const SEED: u64 = 71;
/// Largest factor between gains and their start, up or down.
const SPAN: f64 = 2.5;

/// Tunes the four loops, each with those before it as they came out; `done` is called after each.
///
/// # Errors
/// Those of the flights.
pub(crate) fn tune(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    done: &dyn Fn(LoopAxis),
) -> Result<(Gains, Vec<GainComparison>), Error> {
    let hover = Interface::from_model(tuning.model, tuning.vertical)?.hover_lift;
    let fit = |gains: Gains| if hover > 0.0 { gains.for_hover(hover) } else { gains };
    let (stock, thesis) = (fit(Gains::CRAZYFLIE_ROS), fit(Gains::THESIS));
    let (mut gains, mut all) = (thesis, Vec::new());
    for axis in AXES {
        // a height command needs no height loop
        if axis == LoopAxis::Z && !tuning.vertical.is_pwm() {
            continue;
        }
        let (best, tried) = search(tuning, requirements, &gains, axis)?;
        gains = with_loop(&gains, axis, best);
        // each loop of the others in the same company, so that loops are compared and nothing else
        let with = |table: &Gains| {
            evaluate(tuning, requirements, &with_loop(&gains, axis, *loop_of(table, axis)), axis)
        };
        all.push(GainComparison {
            axis,
            stock: with(&stock)?,
            thesis: with(&thesis)?,
            found: with(&gains)?,
            tried,
        });
        done(axis);
    }
    Ok((gains, all))
}

fn loop_of(gains: &Gains, axis: LoopAxis) -> &Loop {
    match axis {
        LoopAxis::X => &gains.x,
        LoopAxis::Y => &gains.y,
        LoopAxis::Z => &gains.z,
        LoopAxis::Yaw => &gains.yaw,
    }
}

/// With another loop. What is tried in x is tried in y as well, until y has its turn: a flight is no better
/// than the worse of the two.
fn with_loop(gains: &Gains, axis: LoopAxis, new: Loop) -> Gains {
    match axis {
        LoopAxis::X => Gains { x: new, y: new, ..*gains },
        LoopAxis::Y => Gains { y: new, ..*gains },
        LoopAxis::Z => Gains { z: new, ..*gains },
        LoopAxis::Yaw => Gains { yaw: new, ..*gains },
    }
}

fn evaluate(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    gains: &Gains,
    axis: LoopAxis,
) -> Result<LoopEvaluation, Error> {
    let plant = Plant::from_model(tuning.model, tuning.vertical, axis)?;
    let response = tuning.response(gains, axis)?;
    let (own, task_error_s) = (*loop_of(gains, axis), tuning.task_error_s(gains, axis)?);
    Ok(LoopEvaluation {
        gains: own,
        margins: margins(&plant, &own, requirements.dead_time_s),
        figures: response.figures(axis),
        response,
        task_error_s,
    })
}

/// The gains of one loop that cost least, and how many were tried.
fn search(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    gains: &Gains,
    axis: LoopAxis,
) -> Result<(Loop, usize), Error> {
    let start = *loop_of(gains, axis);
    let plant = Plant::from_model(tuning.model, tuning.vertical, axis)?;
    // in logarithms, from the start; a gain of nothing stays nothing
    let gains_at = |point: &DVector<f64>| {
        let scaled = |gain: f64, i: usize| gain * (SPAN * point[i].tanh()).exp();
        Loop { kp: scaled(start.kp, 0), ki: scaled(start.ki, 1), kd: scaled(start.kd, 2), ..start }
    };
    let cost = |point: &DVector<f64>| {
        let own = gains_at(point);
        let margins = margins(&plant, &own, requirements.dead_time_s);
        let gains = with_loop(gains, axis, own);
        let flights = tuning
            .response(&gains, axis)
            .and_then(|response| Ok((response, tuning.task_error_s(&gains, axis)?)));
        // gains that cannot be flown are the worst; the flight at the end says what is wrong
        flights.map_or(f64::MAX, |(response, task_error_s)| {
            penalised_error_s(requirements, &margins, &response, axis) + task_error_s.unwrap_or(0.0)
        })
    };
    let options = CMAESOptions::new(vec![0.0; 3], 0.35)
        .population_size(POPULATION)
        .max_generations(GENERATIONS)
        .seed(SEED);
    let mut search =
        options.build(cost).map_err(|e| Error::Config(format!("the search cannot begin: {e:?}")))?;
    let search_result = search.run_parallel();
    let best = search_result.overall_best.map_or(start, |best| gains_at(&best.point));
    Ok((best, search.function_evals()))
}

/// Seconds of error, and for what is not as wanted more of them.
fn penalised_error_s(
    requirements: &LoopRequirements,
    margins: &Margins,
    response: &Response,
    axis: LoopAxis,
) -> f64 {
    let f = response.figures(axis);
    let over = (f.overshoot - requirements.overshoot).max(0.0);
    let phase = (requirements.phase_deg - margins.phase_deg).clamp(0.0, 180.0);
    let gain = (requirements.gain_db - margins.gain_db).clamp(0.0, 40.0);
    f.error_s + 20.0 * over + 0.1 * phase + 0.2 * gain + 0.05 * response.travel_per_s
}

/// Dead time of the position loops on this rig: latency of the camera, and the mean age of a held frame and
/// of a held command.
pub(crate) fn dead_time_s(model: &Model, latency_s: f64) -> f64 {
    latency_s + 0.5 / model.rig.camera.value + 0.5 / model.rig.control.value
}
