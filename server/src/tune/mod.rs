//! The thesis's "PID Tuner" (7.2): the fastest response without overshoot, with a margin, by CMA-ES over
//! flights in the simulator. The search itself tunes the gains of any controller.

mod query;
mod response;
mod safety;
mod search;

use crazyflie_control::loop_analysis::{FeedbackLoop, LoopAxis, Margins};
use crazyflie_control::pid::{Gains, Loop};
use crazyflie_env::Error;
use crazyflie_env::action::Interface;
use crazyflie_env::model::{Model, VerticalInput};
use rayon::prelude::*;
use serde::Serialize;

pub use query::{MOST_FLIGHTS, TunerAnswer, TunerQuery};
pub use response::{Response, StepFigures, TuningSetup};
pub use safety::{FormCheck, Takeoff, check_forms, warnings};
pub use search::GainSearch;

/// Requirements on a loop.
#[derive(Debug, Clone, Copy)]
pub struct LoopRequirements {
    /// Least phase margin, in degrees.
    pub phase_deg: f64,
    /// Least gain margin, in decibels.
    pub gain_db: f64,
    /// Largest overshoot, as a share of the step.
    pub overshoot: f64,
    /// Dead time of the loop, from sensing to the command in force.
    pub dead_time_s: f64,
}

impl LoopRequirements {
    /// Degrees of phase margin and decibels of gain margin that are missing.
    fn missing(&self, margins: &Margins) -> [f64; 2] {
        [self.phase_deg - margins.phase_deg, self.gain_db - margins.gain_db].map(|missing| missing.max(0.0))
    }
}

/// Margins, step response and task error of a loop with some gains.
#[derive(Debug, Clone, Serialize)]
pub struct LoopEvaluation {
    /// Gains of the loop.
    pub gains: Loop,
    /// Margins on paper.
    pub margins: Margins,
    /// Figures of the step response.
    #[serde(rename = "response")]
    pub figures: StepFigures,
    /// Step response.
    #[serde(skip)]
    pub response: Response,
    /// Error in the task that counts besides, if there is one.
    pub task_error_s: Option<f64>,
}

/// A loop with stock, thesis and tuned gains.
#[derive(Debug, Clone, Serialize)]
pub struct GainComparison {
    /// Axis of the loop.
    #[serde(rename = "loop")]
    pub axis: LoopAxis,
    /// With the defaults of `crazyflie_ros`.
    pub crazyflie_ros: LoopEvaluation,
    /// With table 7.1.
    pub table_7_1: LoopEvaluation,
    /// With the gains that were found.
    pub tuned: LoopEvaluation,
    /// Flights of a batch that the search took.
    pub tried: usize,
}

/// Generations of the search per loop, and its seed.
const GENERATIONS: usize = 24;
const POPULATION: usize = 10;
const SEED: u64 = 71;
/// Distance of the first candidates from table 7.1: standard deviation of a gain's logarithm.
const STEP: f64 = 0.875;

/// Tunes the four loops, each with the results of those before it; `done` is called after each.
///
/// # Errors
/// Those of the flights.
pub fn tune(
    tuning: &TuningSetup<'_>,
    done: &dyn Fn(LoopAxis),
) -> Result<(Gains, Vec<GainComparison>), Error> {
    let lifting = tuning.forms(LoopAxis::Z).first().copied().unwrap_or(tuning.vertical);
    let [stock, thesis] =
        [&Gains::CRAZYFLIE_ROS, &Gains::THESIS].map(|table| hovering_gains(tuning.model, lifting, table));
    let (stock, thesis) = (stock?, thesis?);
    let (mut gains, mut all) = (thesis, Vec::new());
    for axis in LoopAxis::ALL {
        // a model that only a height commands needs no height loop
        let Some(vertical) = tuning.forms(axis).first().copied() else { continue };
        let shown = tuning.on_form(vertical);
        let (best, tried) = shown.search(&gains, axis)?;
        gains = with_loop(&gains, axis, best);
        // each loop of the others in the same company, so that loops are compared and nothing else
        let with = |table: &Gains| shown.evaluate(&with_loop(&gains, axis, *axis.gains(table)), axis);
        all.push(GainComparison {
            axis,
            crazyflie_ros: with(&stock)?,
            table_7_1: with(&thesis)?,
            tuned: with(&gains)?,
            tried,
        });
        done(axis);
    }
    Ok((gains, all))
}

/// Gains of a table, its height loop for the lift that carries the vehicle on this form.
///
/// # Errors
/// For a form that the model lacks.
pub fn hovering_gains(model: &Model, vertical: VerticalInput, table: &Gains) -> Result<Gains, Error> {
    let hover = Interface::from_model(model, vertical)?.hover_lift;
    Ok(if hover > 0.0 { table.for_hover(hover) } else { *table })
}

/// Returns the gains with another loop. A loop for x replaces that of y as well, until y has its turn: a flight is no
/// better than the worse of the two.
fn with_loop(gains: &Gains, axis: LoopAxis, new: Loop) -> Gains {
    let replaced = axis.with_gains(gains, new);
    if axis == LoopAxis::X { Gains { y: new, ..replaced } } else { replaced }
}

impl TuningSetup<'_> {
    fn on_form(&self, vertical: VerticalInput) -> Self {
        Self { vertical, ..self.clone() }
    }

    fn evaluate(&self, gains: &Gains, axis: LoopAxis) -> Result<LoopEvaluation, Error> {
        let response = self.response(gains, axis)?;
        Ok(LoopEvaluation {
            gains: *axis.gains(gains),
            margins: self.margins(gains, axis)?,
            figures: response.figures(axis),
            response,
            task_error_s: self.task_error_s(gains, axis)?,
        })
    }

    fn margins(&self, gains: &Gains, axis: LoopAxis) -> Result<Margins, Error> {
        let dead_time_s = self.requirements.dead_time_s;
        Ok(FeedbackLoop::from_model(self.model, self.vertical, axis, gains, dead_time_s)?.margins())
    }

    /// The gains of one loop that cost least, and how many were tried.
    fn search(&self, gains: &Gains, axis: LoopAxis) -> Result<(Loop, usize), Error> {
        let start = *axis.gains(gains);
        let forms: Vec<_> = self.forms(axis).into_iter().map(|form| self.on_form(form)).collect();
        let loop_of = |found: &[f64]| Loop { kp: found[0], ki: found[1], kd: found[2], ..start };
        let cost = |found: &Vec<f64>| {
            let gains = with_loop(gains, axis, loop_of(found));
            let costs = forms.iter().map(|form| form.cost_s(&gains, axis));
            // gains that cannot fly one of the forms have the highest cost
            costs.map(|cost| cost.unwrap_or(f64::MAX)).sum::<f64>() / forms.len() as f64
        };
        let mut search = GainSearch::new(&[start.kp, start.ki, start.kd], STEP, POPULATION, SEED)?;
        for _ in 0..GENERATIONS {
            let Some(asked) = search.ask() else { break };
            let costs: Vec<f64> = asked.par_iter().map(cost).collect();
            search.tell(&costs)?;
        }
        Ok((search.best().map_or(start, loop_of), search.tried()))
    }

    /// The vertical forms that a loop is judged on, the chosen one first: those that the height loop commands; the
    /// other loops do not feel the form.
    fn forms(&self, axis: LoopAxis) -> Vec<VerticalInput> {
        if axis != LoopAxis::Z {
            return vec![self.vertical];
        }
        let mut forms: Vec<_> = self.model.inputs().into_iter().filter(|input| input.is_pwm()).collect();
        forms.sort_by_key(|form| *form != self.vertical);
        forms
    }

    /// Computes the cost of gains on this vertical form, in seconds of error: a step, the chosen task, and a take-off
    /// for the height.
    fn cost_s(&self, gains: &Gains, axis: LoopAxis) -> Result<f64, Error> {
        let margins = self.margins(gains, axis)?;
        let response = self.response(gains, axis)?;
        let task_s = self.task_error_s(gains, axis)?.unwrap_or(0.0);
        let takeoff_s = if axis == LoopAxis::Z { self.takeoff(gains)?.error_s() } else { 0.0 };
        Ok(penalised_error_s(&self.requirements, &margins, &response, axis) + task_s + takeoff_s)
    }
}

/// Cost of any missing margin: gains that have the margins cost less, whatever their errors.
const MISSED_MARGIN_S: f64 = 1000.0;
/// Cost of one range of the command per second of travel: nine shake the vehicle, one does not.
const TRAVEL_S2: f64 = 0.1;

/// Seconds of error, and for what is not as wanted more of them.
fn penalised_error_s(
    requirements: &LoopRequirements,
    margins: &Margins,
    response: &Response,
    axis: LoopAxis,
) -> f64 {
    let f = response.figures(axis);
    let over = (f.overshoot - requirements.overshoot).max(0.0);
    let [phase_deg, gain_db] = requirements.missing(margins);
    let missed_s = if phase_deg + gain_db > 0.0 { MISSED_MARGIN_S } else { 0.0 };
    let margins_s = missed_s + 0.1 * phase_deg.min(180.0) + 0.2 * gain_db.min(40.0);
    f.error_s + 20.0 * over + margins_s + TRAVEL_S2 * f.travel_per_s
}
