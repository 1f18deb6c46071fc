//! The thesis's "PID Tuner" (7.2): the fastest response without overshoot, with a margin, by CMA-ES over
//! flights in the simulator.

mod picture;
mod response;
mod safety;

use cmaes::{CMAESOptions, DVector};
use crazyflie_control::loop_analysis::{FeedbackLoop, LoopAxis, Margins};
use crazyflie_control::pid::{Gains, Loop};
use crazyflie_env::Error;
use crazyflie_env::action::Interface;
use crazyflie_env::model::VerticalInput;

pub(crate) use picture::picture;
pub(crate) use response::{Response, StepFigures, TuningSetup};
pub(crate) use safety::{FormCheck, check_forms, warnings};

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
    for axis in LoopAxis::ALL {
        // a height command needs no height loop
        if axis == LoopAxis::Z && !tuning.vertical.is_pwm() {
            continue;
        }
        let (best, tried) = search(tuning, requirements, &gains, axis)?;
        gains = with_loop(&gains, axis, best);
        // each loop of the others in the same company, so that loops are compared and nothing else
        let with = |table: &Gains| {
            evaluate(tuning, requirements, &with_loop(&gains, axis, *axis.gains(table)), axis)
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
    let response = tuning.response(gains, axis)?;
    Ok(LoopEvaluation {
        gains: *axis.gains(gains),
        margins: margins(tuning, requirements, tuning.vertical, axis, gains)?,
        figures: response.figures(axis),
        response,
        task_error_s: tuning.task_error_s(gains, axis)?,
    })
}

fn margins(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    vertical: VerticalInput,
    axis: LoopAxis,
    gains: &Gains,
) -> Result<Margins, Error> {
    let dead_time_s = requirements.dead_time_s;
    Ok(FeedbackLoop::from_model(tuning.model, vertical, axis, gains, dead_time_s)?.margins())
}

/// The gains of one loop that cost least, and how many were tried.
fn search(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    gains: &Gains,
    axis: LoopAxis,
) -> Result<(Loop, usize), Error> {
    let start = *axis.gains(gains);
    let forms = forms_of(tuning, axis);
    // in logarithms, from the start; a gain of nothing stays nothing
    let gains_at = |point: &DVector<f64>| {
        let scaled = |gain: f64, i: usize| gain * (SPAN * point[i].tanh()).exp();
        Loop { kp: scaled(start.kp, 0), ki: scaled(start.ki, 1), kd: scaled(start.kd, 2), ..start }
    };
    let cost = |point: &DVector<f64>| {
        let gains = with_loop(gains, axis, gains_at(point));
        let costs = forms.iter().map(|form| error_on_form_s(tuning, requirements, *form, &gains, axis));
        // what cannot be flown on one form is the worst of all
        costs.map(|cost| cost.unwrap_or(f64::MAX)).sum::<f64>() / forms.len() as f64
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

/// The vertical forms that a loop is judged on: those that the height loop commands; the other loops do not
/// feel the form.
fn forms_of(tuning: &TuningSetup<'_>, axis: LoopAxis) -> Vec<VerticalInput> {
    if axis != LoopAxis::Z {
        return vec![tuning.vertical];
    }
    tuning.model.inputs().into_iter().filter(|input| input.is_pwm()).collect()
}

/// Cost of gains on one vertical form, in seconds of error: a step, the task that is asked for, and a
/// take-off for the height.
fn error_on_form_s(
    tuning: &TuningSetup<'_>,
    requirements: &LoopRequirements,
    vertical: VerticalInput,
    gains: &Gains,
    axis: LoopAxis,
) -> Result<f64, Error> {
    let on_form = TuningSetup { vertical, ..tuning.clone() };
    let margins = margins(tuning, requirements, vertical, axis, gains)?;
    let response = on_form.response(gains, axis)?;
    let task_s = on_form.task_error_s(gains, axis)?.unwrap_or(0.0);
    let takeoff_s = if axis == LoopAxis::Z { on_form.takeoff(gains)?.error_s() } else { 0.0 };
    Ok(penalised_error_s(requirements, &margins, &response, axis) + task_s + takeoff_s)
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
