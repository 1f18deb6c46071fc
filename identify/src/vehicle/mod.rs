//! The numbers of a model file from flight logs: output error through the simulator itself, all outputs at
//! once.

mod choice;
mod nuisance;
mod predict;
mod start;
mod unexplained;

use crazyflie_env::effects::{self, Entry, Geometry, Role, Ubiquity};
use crazyflie_env::model::{Model, PwmSource, VerticalInput};

use crate::axis_errors::{AxisErrors, axis_errors};
use crate::estimate::{Clusters, Comparison, ParameterEstimate, at_bound, covariance};
use crate::explain::calibration::recorded::CLEAR;
use crate::fit::flight::{Flight, MeasurementNoise, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::predict::START;
use crate::fit::solve::{Problem, Solution, solve};
use crate::lift::{read_tilt, tilt_input};
use crate::{Error, FlightLog, NamedLog, Result};
use crazyflie_logs::first_duplicate;
use crazyflie_statistics::{Criteria, criteria};

pub use choice::visible;
pub(crate) use choice::with_source;
pub use nuisance::{NuisanceParameters, SETTLE_S, SharedTrim, settle_flights, shared_trims};
pub(crate) use nuisance::{fit_on_start, hypothesis as nuisance_hypothesis};
use predict::{ResidualRows, compare, rows};
pub use unexplained::UnexplainedAngle;

/// The noise of each output, and how much flights differ, are found beside the numbers.
const ROUNDS: usize = 6;
/// No simulation is exact to less.
const FLOOR: MeasurementNoise = MeasurementNoise { att_rad: [1e-6; 3], pos_m: [1e-6; 3] };
/// Windows of flights with trims and a hover PWM of their own. The effect of voltage and of the thrust's slope on the
/// climb adds up over seconds: in shorter windows trims absorb it. Chosen on eleven flights, three at a time
/// predicted from the others: with 2, 3 and 4 s vertical velocity 2 s ahead was off by 0.276, 0.224 and 0.207 m/s,
/// but with 4 s the slope of the thrust approached its lower bound.
const LONG_WINDOW_S: f64 = 3.0;
/// So many flights show how much they differ; with fewer, the number of shorter windows is worth more.
const LEAST_FLIGHTS: usize = 4;
pub(crate) const HOVER: &str = "vertical.thrust.hover";
const HEAVE: &str = "vertical.thrust.heave";
/// A damping of climb with a larger standard error is undetermined. Flights that climb determine it to 0.002 (made)
/// and 0.14 1/s (NanoBench), steps sideways to 6 1/s.
const MOST_HEAVE_ERROR_PS: f64 = 1.0;

/// Options of a fit: free numbers, vertical form, nuisance parameters, effects.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FitOptions {
    /// Paths of the model's numbers; those that the logs determine unless given, see [`visible`].
    pub free: Option<Vec<String>>,
    /// Vertical form that is driven; the model's own, or the thrust form if the logs have a thrust command and the
    /// model has the form, unless given.
    pub vertical: Option<VerticalInput>,
    /// Source of the PWM in the logs; the model's unless given.
    pub pwm_source: Option<PwmSource>,
    /// Fit also what differs from flight to flight: trims of markers and vehicle, and the hover PWM. A degree
    /// of trim would move the vehicle by 34 cm in 2 s.
    pub nuisance: bool,
    /// Effects that are fitted with the model and belong to it then, see [`ubiquitous_effects`].
    pub effects: Vec<String>,
    /// Name of the model found; unchanged unless given.
    pub name: Option<String>,
    /// Mass of the vehicle that flew, for effects that need it; unchanged unless given.
    pub mass_kg: Option<f64>,
}

/// Returns the effects that every real vehicle under a thrust command shows; that of the battery only if all logs
/// have its voltage, and slow ones only with four such logs or more.
pub fn ubiquitous_effects(logs: &[NamedLog]) -> Vec<String> {
    let with_voltage = logs.iter().all(|(_, log)| log.vbat_v.is_some());
    let shows = |entry: &&Entry| match entry.ubiquity {
        Ubiquity::Some => false,
        Ubiquity::All => true,
        Ubiquity::AllWithVoltage => with_voltage,
        Ubiquity::AllSlowly => with_voltage && logs.len() >= LEAST_FLIGHTS,
    };
    effects::registry().iter().filter(shows).map(|entry| entry.name.to_owned()).collect()
}

/// Returns the better source of the PWM: the motors if all logs have them, because the motors' share of the battery
/// lifts the vehicle. On eleven real flights, each part predicted from the others, velocity in space 0.5 s ahead was
/// off by 0.109 m/s with it and by 0.118 m/s with the thrust command. (2 s ahead they were alike.)
pub fn best_pwm_source(logs: &[NamedLog]) -> PwmSource {
    // the reference scales the PWM and does not decide whether it is logged
    let holds_motors = |(_, log): &NamedLog| log.motor_pwm_at(1.0).is_some();
    if logs.iter().all(holds_motors) { PwmSource::Motors } else { PwmSource::Command }
}

/// Predictions of flights by a model beside the measurements.
#[derive(Debug, Clone)]
pub struct ModelComparison {
    /// Six signals of each flight.
    pub comparisons: Vec<Comparison>,
    /// The nuisance parameters of each flight.
    pub trims: Vec<NuisanceParameters>,
    /// Errors of predictions by the commands alone, after the first [`SETTLE_S`] seconds if trims were estimated from
    /// these.
    pub errors: Vec<AxisErrors>,
}

/// An identified model: values, standard errors, and predictions of the logs.
#[derive(Debug, Clone)]
pub struct ModelEstimate {
    /// With the numbers found and, as their source, logs and standard errors.
    pub model: Model,
    /// In the order of the paths, then those of effects.
    pub parameters: Vec<ParameterEstimate>,
    /// The values before the fit.
    pub before: Vec<f64>,
    /// Numbers and effect parameters that these logs do not determine: they would have run to a bound. They stay as
    /// the fit began, and an effect whose strength is one of them is left out.
    pub left_out: Vec<String>,
    /// Standard deviation of what the model leaves: roll, pitch, yaw, x, y, z.
    pub noise: [f64; 6],
    /// Information criteria, to compare forms on the same logs.
    pub criteria: Criteria,
    /// Groups behind the standard errors.
    pub clusters: Clusters,
    /// Convergence: the fit ended before its limit of steps.
    pub converged: bool,
    /// Number of measured values in the fit.
    pub samples: usize,
    /// Vertical form that the logs drive.
    pub input: VerticalInput,
    /// The logs of the fit.
    pub fit: ModelComparison,
    /// With nothing free but what flights have of their own.
    hypothesis: Hypothesis,
    plan: FitOptions,
}

/// Refuses logs of the same flight: a fit would count it twice, a test would know it.
///
/// # Errors
/// [`Error::Options`] names the two.
pub fn refuse_duplicates(logs: &[&NamedLog]) -> Result<()> {
    let bare: Vec<&FlightLog> = logs.iter().map(|(_, log)| log).collect();
    first_duplicate(&bare).map_or(Ok(()), |pair| {
        let [first, second] = pair.map(|i| &logs[i].0);
        Error::options(format!(
            "{first} and {second} hold the same flight: name it once, to fit or to judge by"
        ))
    })
}

/// Fits numbers of a model to logs, each with its name. `done` is called after each of at most [`STAGES`]
/// stages.
///
/// # Errors
/// [`Error`]: logs that cannot be flown, contain one flight twice or do not go together, paths that do not
/// exist or cannot be determined.
pub fn identify(
    model: &Model,
    logs: &[NamedLog],
    plan: &FitOptions,
    done: &dyn Fn(),
) -> Result<ModelEstimate> {
    refuse_duplicates(&logs.iter().collect::<Vec<_>>())?;
    let mut driven = model.clone();
    driven.vertical.pwm_source = plan.pwm_source.unwrap_or(model.vertical.pwm_source);
    let model = &with_tilt_input(driven, logs);
    let mut flights = prepare(model, plan.vertical, logs)?;
    let input = flights[0].input;
    let mut free = choice::check(model, logs, input, plan.free.as_deref())?;
    let per_flight_hover = plan.nuisance && input == VerticalInput::Thrust;
    if per_flight_hover {
        free.retain(|path| path != HOVER);
        if free.is_empty() {
            return Err(Error::singular(HOVER, "every flight has its own: name another number with it"));
        }
    }
    let near = start::model_near_vehicle(model, logs, plan, &free)?;
    let mut hypothesis = Hypothesis { free, ..nuisance::hypothesis(&near, plan.nuisance.then_some(input)) };
    for name in &plan.effects {
        hypothesis = hypothesis.with(fitted_effect(name, &plan.effects)?);
    }
    let long = plan.nuisance && flights.len() >= LEAST_FLIGHTS;
    let windows = windows(&flights, if long { LONG_WINDOW_S } else { WINDOW_S });
    if long {
        flights.iter_mut().for_each(nuisance::doubt_heights);
    }
    let mut left_out = Vec::new();
    loop {
        let fitted =
            fit(&mut flights, &windows, &mut hypothesis, done).ok_or_else(|| Error::no_start("model"))?;
        let mut untold = choice::leave_out(&mut hypothesis, &fitted.0.shared, plan.free.is_some());
        if untold.is_empty() {
            let before = hypothesis.free.iter().map(|path| model.parameter(path));
            let before: Vec<f64> = before.collect::<Result<_, _>>()?;
            let identified = report(model, logs, plan, &flights, &windows, &hypothesis, fitted, before)?;
            if plan.free.is_none() && !identified.tells_heave() {
                hypothesis.free.retain(|path| path != HEAVE);
                untold.push(HEAVE.to_owned());
            } else if let Some(effect) = identified.least_clear_effect(&hypothesis) {
                hypothesis = hypothesis.without(effect);
                untold.push(effect.to_owned());
            } else {
                done();
                return Ok(ModelEstimate { left_out, ..identified });
            }
        }
        left_out.extend(untold);
    }
}

/// Numbers that `explain` fits beside a hover PWM of each flight, whose mean is the model's. The damping of
/// climb is not among them: there it would pass for effects that are searched.
pub(crate) fn beside_hover(free: Vec<String>) -> Vec<String> {
    free.into_iter().filter(|path| path != HOVER && path != HEAVE).collect()
}

/// An effect that joins the model, beside others: what is exact by geometry is not fitted.
fn fitted_effect(name: &str, all: &[String]) -> Result<Term> {
    let mut term = Term::off(effects::find(name)?.1);
    let geometric =
        |name: &String| effects::find(name).is_ok_and(|(_, entry)| entry.geometry != Geometry::None);
    if term.entry.geometry != Geometry::None {
        term.free.clear();
        term.values[0] = 1.0;
        // the only one brings all of the geometry that it can
        if all.iter().filter(|name| geometric(name)).count() == 1 {
            let choices = term.entry.params.iter().enumerate().filter(|(_, p)| p.role == Role::Choice);
            choices.for_each(|(i, p)| term.values[i] = p.farthest_bound());
        }
    }
    Ok(term.with_companions())
}

/// The model with the roll and pitch commands of the logs, where those are others than its own.
fn with_tilt_input(model: Model, logs: &[NamedLog]) -> Model {
    match tilt_input(logs) {
        Some(input) if logs.iter().any(|(_, log)| read_tilt(log, model.command.tilt).is_err()) => {
            model.with_tilt_input(input)
        }
        _ => model,
    }
}

/// The numbers found with their errors, and what they make of the logs.
#[expect(clippy::too_many_arguments)]
fn report(
    model: &Model,
    logs: &[NamedLog],
    plan: &FitOptions,
    flights: &[Flight],
    windows: &[Window],
    hypothesis: &Hypothesis,
    (solution, noise): (Solution, [f64; 6]),
    mut before: Vec<f64>,
) -> Result<ModelEstimate> {
    let prediction = OutputErrorProblem::new(flights, windows, hypothesis);
    let (bounds, common) = (prediction.bounds(), prediction.common());
    let names = names(model, hypothesis);
    let labels: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
    let flight_of: Vec<usize> = windows.iter().map(|w| w.flight).collect();
    let (number_covariance, clusters) = covariance(&solution, &flight_of, &labels, &bounds[..common])?;
    let estimate = |(i, (name, unit)): (usize, (String, String))| ParameterEstimate {
        name,
        unit,
        value: solution.shared[i],
        standard_error: number_covariance[(i, i)].max(0.0).sqrt(),
        at_bound: at_bound(solution.shared[i], bounds[i]),
    };
    let mut parameters: Vec<ParameterEstimate> = names.into_iter().enumerate().map(estimate).collect();
    let of_terms = hypothesis.terms.iter().filter(|t| t.per_flight.is_none());
    before.extend(of_terms.flat_map(|t| t.free.iter().map(|i| t.entry.params[*i].off)));
    let hover = nuisance::centre_hover(&mut hypothesis.clone(), flights.len(), &mut solution.shared.clone());
    if let Some(standard_error) = hover {
        let (name, unit) = (HOVER.to_owned(), "1".to_owned());
        let value = hypothesis.model.parameter(HOVER)?;
        parameters.push(ParameterEstimate { name, unit, value, standard_error, at_bound: false });
        before.push(model.parameter(HOVER)?);
    }
    let each = prediction.each_fixed(&solution.shared);
    let found = hypothesis.with_values(&prediction.flight_numbers(&solution.shared, 0));
    let names: Vec<&str> = logs.iter().map(|(name, _)| name.as_str()).collect();
    let model = choice::model_with_sources(&found, plan, flights[0].input, &parameters, &names, clusters)?;
    let fit = compare_flights(&each, flights, plan);
    let sums = ResidualRows::squares(&fit.comparisons);
    let own = START + hypothesis.lags_sd(flights[0].input).len();
    Ok(ModelEstimate {
        criteria: criteria(&sums, solution.shared.len() + windows.len() * own),
        hypothesis: open_per_flight(&found),
        model,
        before,
        left_out: Vec::new(),
        parameters,
        noise,
        clusters,
        converged: solution.converged,
        samples: sums.iter().map(|(_, samples)| samples).sum(),
        input: flights[0].input,
        fit,
        plan: plan.clone(),
    })
}

/// The same with nothing free but what flights have of their own.
pub(crate) fn open_per_flight(found: &Hypothesis) -> Hypothesis {
    let mut open = Hypothesis { free: Vec::new(), ..found.clone() };
    for term in &mut open.terms {
        match &term.per_flight {
            None => term.free.clear(),
            Some(priors) => term.free.iter().zip(priors).for_each(|(i, prior)| term.values[*i] = prior.mean),
        }
    }
    open
}

/// Most calls back from [`identify`] each time it fits; it fits again after leaving something out.
pub const STAGES: usize = ROUNDS + 1;

impl ModelEstimate {
    /// Returns whether the damping of climb is known, or was not fitted.
    fn tells_heave(&self) -> bool {
        self.parameters.iter().all(|p| p.name != HEAVE || p.standard_error < MOST_HEAVE_ERROR_PS)
    }

    /// The effect that is fitted because every vehicle shows it, and whose strength these logs determine least; `None`
    /// if all are clear. At constant height the slope of the thrust took any value, and the hover PWM with it.
    fn least_clear_effect(&self, hypothesis: &Hypothesis) -> Option<&'static str> {
        let expected =
            hypothesis.terms.iter().filter(|t| t.per_flight.is_none() && t.entry.ubiquity != Ubiquity::Some);
        let clearance = |term: &Term| {
            let param = &term.entry.params[*term.free.first()?];
            let name = format!("{}.{}", term.entry.name, param.name);
            let found = self.parameters.iter().find(|known| known.name == name)?;
            Some((term.entry.name, (found.value - param.off).abs() / found.standard_error))
        };
        let unclear = expected.filter_map(clearance).filter(|(_, errors)| *errors < CLEAR);
        unclear.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(name, _)| name)
    }

    /// Predicts logs that the fit has not seen: only initial states are taken from them and, from their first
    /// [`SETTLE_S`] seconds, what every flight has of its own.
    ///
    /// # Errors
    /// The errors of [`identify`].
    pub fn compare_logs(&self, logs: &[NamedLog]) -> Result<ModelComparison> {
        self.compare_by(&self.hypothesis, logs)
    }

    /// Compares like [`ModelEstimate::compare_logs`], by another model: the one before, to measure the gain.
    ///
    /// # Errors
    /// The errors of [`identify`].
    pub fn compare_with(&self, model: &Model, logs: &[NamedLog]) -> Result<ModelComparison> {
        let mut model = with_tilt_input(model.clone(), logs);
        if self.model.vertical.pwm_source == PwmSource::Command {
            // the logs need no motors for the fit, nor here
            model.vertical.pwm_source = PwmSource::Command;
        }
        let input = self.plan.nuisance.then_some(self.input);
        self.compare_by(&nuisance::hypothesis(&model, input), logs)
    }

    fn compare_by(&self, hypothesis: &Hypothesis, logs: &[NamedLog]) -> Result<ModelComparison> {
        let mut flights = prepare(&hypothesis.model, Some(self.input), logs)?;
        flights.iter_mut().for_each(|f| f.noise = measurement_noise(&self.noise));
        let each: Vec<_> = flights.iter().map(|flight| nuisance::fit_on_start(hypothesis, flight)).collect();
        Ok(compare_flights(&each, &flights, &self.plan))
    }
}

/// Predictions of flights by hypotheses without free numbers, one for each flight.
fn compare_flights(each: &[Hypothesis], flights: &[Flight], plan: &FitOptions) -> ModelComparison {
    let from_s = if plan.nuisance { SETTLE_S } else { 0.0 };
    let pairs = || each.iter().zip(flights);
    let trims = pairs().map(|(hypothesis, flight)| nuisance::trim(&flight.name, hypothesis));
    let errors = pairs().filter_map(|(hypothesis, flight)| axis_errors(hypothesis, flight, from_s));
    ModelComparison {
        comparisons: pairs().flat_map(|(hypothesis, flight)| compare(hypothesis, flight)).collect(),
        trims: trims.filter(|trim| !trim.values.is_empty()).collect(),
        errors: errors.collect(),
    }
}

/// Names and units of the free numbers that all flights share: the model's, then the effects'.
fn names(model: &Model, hypothesis: &Hypothesis) -> Vec<(String, String)> {
    let of_model = hypothesis.free.iter().map(|path| (path.clone(), unit_of(model, path)));
    let of_term = |t: &Term| -> Vec<(String, String)> {
        let params = t.free.iter().map(|i| &t.entry.params[*i]);
        params.map(|p| (format!("{}.{}", t.entry.name, p.name), p.unit.to_owned())).collect()
    };
    of_model.chain(hypothesis.terms.iter().filter(|t| t.per_flight.is_none()).flat_map(of_term)).collect()
}

/// The unit of a number of a model; empty if it has no such number.
pub(crate) fn unit_of(model: &Model, path: &str) -> String {
    let known = model.parameters().into_iter().find(|(name, ..)| name == path);
    known.map_or(String::new(), |(.., unit)| unit.to_owned())
}

pub(crate) fn prepare(model: &Model, input: Option<VerticalInput>, logs: &[NamedLog]) -> Result<Vec<Flight>> {
    let flight = |(name, log): &NamedLog| {
        Flight::from_log(name, log, model, input).map_err(|why| Error::about(name, why))
    };
    let flights: Vec<Flight> = logs.iter().map(flight).collect::<Result<_, _>>()?;
    let first = flights.first().ok_or_else(Error::no_logs)?;
    match flights.iter().find(|f| f.input != first.input) {
        Some(other) => Err(Error::mixed(&first.name, &other.name)),
        None => Ok(flights),
    }
}

fn windows(flights: &[Flight], length_s: f64) -> Vec<Window> {
    flights.iter().enumerate().flat_map(|(i, f)| f.windows(i, length_s)).collect()
}

/// The numbers, fitted again with the noise that they leave, and with what flights differ by, until both
/// stay.
pub(crate) fn fit(
    flights: &mut [Flight],
    windows: &[Window],
    hypothesis: &mut Hypothesis,
    done: &dyn Fn(),
) -> Option<(Solution, [f64; 6])> {
    // the start knows roll and pitch by their transfer functions: believed too little, they would follow the pushes on
    // the position, and once far off their residuals would keep them there
    let mut noise = noise_at_start(flights, windows, hypothesis);
    flights.iter_mut().for_each(|f| f.noise = measurement_noise(&noise));
    let mut found: Option<Solution> = None;
    for _ in 0..ROUNDS {
        let prediction = OutputErrorProblem::new(flights, windows, hypothesis);
        let (own, shared) =
            found.map_or_else(|| (prediction.measured_starts(), prediction.shared()), |f| (f.own, f.shared));
        let solution = solve(&prediction, own, shared);
        if !solution.loss.is_finite() {
            return None;
        }
        let numbers = prediction.each_flight(&solution.shared);
        let each = prediction.each_fixed(&solution.shared);
        let left = rows(&each, flights, windows, &solution.own).noise(&FLOOR);
        done();
        let same = noise.iter().zip(&left).all(|(a, b): (&f64, &f64)| (b / a - 1.0).abs() < 0.03);
        noise = left;
        found = Some(solution);
        if same {
            break;
        }
        nuisance::learn_priors(hypothesis, &numbers);
        if let Some(found) = &mut found {
            nuisance::centre_hover(hypothesis, flights.len(), &mut found.shared);
        }
        flights.iter_mut().for_each(|f| f.noise = measurement_noise(&noise));
    }
    found.map(|solution| (solution, noise))
}

/// Residuals of the windows from their measured states, as standard deviations, before anything is fitted.
fn noise_at_start(flights: &[Flight], windows: &[Window], hypothesis: &Hypothesis) -> [f64; 6] {
    let prediction = OutputErrorProblem::new(flights, windows, hypothesis);
    let each = prediction.each_fixed(&prediction.shared());
    let left = rows(&each, flights, windows, &prediction.measured_starts()).noise(&FLOOR);
    let usual = [flights[0].noise.att_rad, flights[0].noise.pos_m].concat();
    // a start that is far off is no reason to believe less than usual
    std::array::from_fn(|channel| left[channel].min(usual[channel]))
}

fn measurement_noise(noise: &[f64; 6]) -> MeasurementNoise {
    let [roll, pitch, yaw, x, y, z] = *noise;
    MeasurementNoise { att_rad: [roll, pitch, yaw], pos_m: [x, y, z] }
}
