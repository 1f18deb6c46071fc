//! The numbers of a model file from flight logs: output error through the simulator itself, all outputs at once.

mod choice;
mod predict;

use crazyflie_env::effects;
use crazyflie_env::model::{Model, VerticalInput};

use crate::FlightLog;
use crate::estimate::{Clusters, Comparison, Estimate, IdentifyError, at_bound, covariance};
use crate::fit::flight::{Flight, Noise, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::predict::Prediction;
use crate::fit::solve::{Solution, solve};
use crate::statistics::{Criteria, criteria};

pub use choice::visible;
use predict::{Rows, compare, rows};

/// The noise of each output is found beside the numbers.
const ROUNDS: usize = 6;
/// No simulation is exact to less.
const FLOOR: Noise = Noise { att_rad: [1e-6; 3], pos_m: [1e-6; 3] };
const WINDOW_MIN_S: f64 = 0.5;

/// What to fit, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Paths of the model's numbers; those that the logs can tell unless given, see [`visible`].
    pub free: Option<Vec<String>>,
    pub window_s: f64,
    /// Which vertical form is driven; the thrust form, if the logs hold a thrust command and the model has the form, unless given.
    pub vertical: Option<VerticalInput>,
    /// Fit also what markers and vehicle are out of trim: a constant tilt of the measured attitude and one of the commands, the same for all
    /// logs. A degree of it would move the vehicle by 34 cm in 2 s.
    pub trims: bool,
}

/// The effects that say so.
const TRIMS: [&str; 2] = ["com_offset", "imu_tilt"];

impl Default for Plan {
    fn default() -> Self {
        Plan { free: None, window_s: WINDOW_S, vertical: None, trims: false }
    }
}

/// A model found.
#[derive(Debug, Clone)]
pub struct Identified {
    /// With the numbers found and, as their source, logs and standard errors.
    pub model: Model,
    /// In the order of the paths.
    pub parameters: Vec<Estimate>,
    /// What the numbers were before.
    pub before: Vec<f64>,
    /// Standard deviation of what the model leaves: roll, pitch, yaw, x, y, z.
    pub noise: [f64; 6],
    pub criteria: Criteria,
    pub clusters: Clusters,
    pub converged: bool,
    pub samples: usize,
    pub input: VerticalInput,
    /// Six signals of each log of the fit.
    pub fit: Vec<Comparison>,
    hypothesis: Hypothesis,
    plan: Plan,
}

/// Fits numbers of a model to logs, each with its name. `done` is called after each of at most [`STAGES`] stages.
///
/// # Errors
/// [`IdentifyError`]: logs that cannot be flown or do not go together, paths that do not exist or cannot be told.
pub fn identify(model: &Model, logs: &[(String, FlightLog)], plan: &Plan, done: &dyn Fn()) -> Result<Identified, IdentifyError> {
    if !(plan.window_s >= WINDOW_MIN_S && plan.window_s.is_finite()) {
        return Err(IdentifyError::Window { value_s: plan.window_s, least_s: WINDOW_MIN_S });
    }
    let mut flights = prepare(model, plan.vertical, logs)?;
    let free = choice::check(model, logs, flights[0].input, plan.free.as_deref())?;
    let mut hypothesis = Hypothesis { free: free.clone(), pushed: false, ..Hypothesis::of(model) };
    for name in TRIMS.iter().filter(|_| plan.trims) {
        hypothesis = hypothesis.with(Term::off(effects::find(name)?.1));
    }
    let windows = windows(&flights, plan.window_s);
    let (solution, noise) = fit(&mut flights, &windows, &hypothesis, done).ok_or(IdentifyError::NoStart { what: "model".into() })?;
    let flight_of: Vec<usize> = windows.iter().map(|w| w.flight).collect();
    let bounds = hypothesis.bounds();
    let names = names(model, &hypothesis);
    let labels: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
    let (of_numbers, clusters) = covariance(&solution, &flight_of, &labels, &bounds)?;
    let estimate = |(i, (name, unit)): (usize, (String, String))| Estimate {
        name,
        unit,
        value: solution.shared[i],
        standard_error: of_numbers[(i, i)].max(0.0).sqrt(),
        at_bound: at_bound(solution.shared[i], bounds[i]),
    };
    let parameters: Vec<Estimate> = names.into_iter().enumerate().map(estimate).collect();
    let found = hypothesis.at(&solution.shared);
    let logs: Vec<&str> = logs.iter().map(|(name, _)| name.as_str()).collect();
    let model = choice::sourced(&found.model, &parameters[..free.len()], &format!("identified from {}", logs.join(", ")), clusters)?;
    // trims belong to a session: they stay free where other logs are compared, and out of the model
    let fixed = Hypothesis { model: model.clone(), free: Vec::new(), ..found };
    let fit = compare(&fixed, &flights, plan.window_s);
    let sums = Rows::squares(&fit);
    let own = crate::fit::predict::START + fixed.lags_sd(flights[0].input).len();
    let unknowns = parameters.len() + windows.len() * own;
    let identified = Identified {
        model,
        before: hypothesis.shared(),
        parameters,
        noise,
        criteria: criteria(&sums, unknowns),
        clusters,
        converged: solution.converged,
        samples: sums.iter().map(|(_, samples)| samples).sum(),
        input: flights[0].input,
        fit,
        hypothesis: fixed,
        plan: plan.clone(),
    };
    done();
    Ok(identified)
}

/// How often [`identify`] calls back at most.
pub const STAGES: usize = ROUNDS + 1;

impl Identified {
    /// Predicts logs that the fit has not seen: only initial states are taken from them, and trims if there are any.
    ///
    /// # Errors
    /// As [`identify`].
    pub fn compare(&self, logs: &[(String, FlightLog)]) -> Result<Vec<Comparison>, IdentifyError> {
        self.compare_with(&self.model, logs)
    }

    /// As [`Identified::compare`], by another model: the one before, to see what was gained.
    ///
    /// # Errors
    /// As [`identify`].
    pub fn compare_with(&self, model: &Model, logs: &[(String, FlightLog)]) -> Result<Vec<Comparison>, IdentifyError> {
        let mut flights = prepare(model, self.plan.vertical, logs)?;
        flights.iter_mut().for_each(|f| f.noise = of_six(&self.noise));
        let hypothesis = Hypothesis { model: model.clone(), ..self.hypothesis.clone() };
        Ok(compare(&hypothesis, &flights, self.plan.window_s))
    }
}

/// Names and units of the free numbers: the model's, then the trims'.
fn names(model: &Model, of: &Hypothesis) -> Vec<(String, String)> {
    let known = model.parameters();
    let unit = |path: &String| known.iter().find(|(p, ..)| p == path).map_or(String::new(), |(_, _, unit)| (*unit).to_owned());
    let trims = of
        .terms
        .iter()
        .flat_map(|t| t.free.iter().map(|i| (format!("{}.{}", t.entry.name, t.entry.params[*i].name), t.entry.params[*i].unit.to_owned())));
    of.free.iter().map(|path| (path.clone(), unit(path))).chain(trims).collect()
}

fn prepare(model: &Model, vertical: Option<VerticalInput>, logs: &[(String, FlightLog)]) -> Result<Vec<Flight>, IdentifyError> {
    let of = |(name, log): &(String, FlightLog)| {
        Flight::of(name, log, model, vertical).map_err(|source| IdentifyError::Flight { log: name.clone(), source })
    };
    let flights: Vec<Flight> = logs.iter().map(of).collect::<Result<_, _>>()?;
    let first = flights.first().ok_or(IdentifyError::NoLogs)?;
    let clock = |f: &Flight| (1.0 / f.tick_s).round();
    match flights.iter().find(|f| f.input != first.input || clock(f) != clock(first)) {
        Some(other) => Err(IdentifyError::Mixed { first: first.name.clone(), second: other.name.clone() }),
        None => Ok(flights),
    }
}

fn windows(flights: &[Flight], window_s: f64) -> Vec<Window> {
    flights.iter().enumerate().flat_map(|(i, f)| f.windows(i, window_s)).collect()
}

/// The numbers, fitted again with the noise that they leave until it stays.
fn fit(flights: &mut [Flight], windows: &[Window], at: &Hypothesis, done: &dyn Fn()) -> Option<(Solution, [f64; 6])> {
    let mut noise = [0.0; 6];
    let mut found: Option<Solution> = None;
    for _ in 0..ROUNDS {
        let prediction = Prediction { flights, windows, hypothesis: at, inflation: 1.0 };
        let (own, shared) = found.map_or_else(|| (prediction.starts(), at.shared()), |f| (f.own, f.shared));
        let solution = solve(&prediction, own, shared);
        if !solution.loss.is_finite() {
            return None;
        }
        let left = rows(&at.at(&solution.shared).fixed(), flights, windows, &solution.own).noise(&FLOOR);
        done();
        let same = noise.iter().zip(&left).all(|(a, b): (&f64, &f64)| (b / a - 1.0).abs() < 0.03);
        noise = left;
        found = Some(solution);
        if same {
            break;
        }
        flights.iter_mut().for_each(|f| f.noise = of_six(&noise));
    }
    found.map(|solution| (solution, noise))
}

fn of_six(noise: &[f64; 6]) -> Noise {
    let [roll, pitch, yaw, x, y, z] = *noise;
    Noise { att_rad: [roll, pitch, yaw], pos_m: [x, y, z] }
}
