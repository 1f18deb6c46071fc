//! Nuisance parameters: trims, and the PWM that carries the vehicle on that day's battery. They differ from
//! flight to flight.

use std::ops::Range;

use crazyflie_env::config::EffectTable;
use crazyflie_env::effects::{Entry, FlightSpread, Param, registry};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, World};
use crazyflie_statistics::mean;
use serde::Serialize;

use super::predict::rows;
use super::{FLOOR, HOVER, LEAST_FLIGHTS, measurement_noise};
use crate::fit::flight::{Flight, MeasurementNoise, Sample, TAKE_OFF_S, WINDOW_S, Window, with_lags};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::solve::{Prior, Solution, solve};

/// Flights that agree by chance do not make a number certain: no prior gets narrower than this share of the
/// first. Trims of eleven flights differ by 0.1 to 0.2 degrees.
const NARROWEST: f64 = 0.03;
/// Factor on standard deviations in fits of a few seconds, for the PWM that carries the vehicle and for its trims.
/// The error of a model does not average out over five seconds of one manoeuvre, so rows contain far less information
/// than their number suggests. Chosen on eleven flights, each part of them predicted from the others: with 60, 100
/// and 200 for the PWM, vertical velocity 2 s ahead was off by 0.207, 0.184 and 0.195 m/s; with 25, 50 and 100 for
/// the trims, horizontal velocity by 0.105, 0.105 and 0.104 m/s.
const INFLATION: f64 = 100.0;
const TRIM_INFLATION: f64 = 50.0;
/// The climb does not determine trims in their fit: this factor on the standard deviation of the height.
const HEIGHT_INFLATION: f64 = 1e3;
/// Pushes add up in positions, errors of attitudes do not: by this, attitudes are believed more where the trims of a
/// test flight are settled. With 1 in place of 10 a simulated flight without trims erred by 0.6 degrees in roll, with 10
/// by its noise of 0.05.
const ATTITUDE_DEFLATION: f64 = 10.0;
/// Flights that share a trim are at least so many.
const LEAST_SHARING: usize = 3;
/// A trim is shared if its mean is so many standard deviations of the flights from the declared value: of three flights,
/// one set in a hundred is by chance.
const SHARED: f64 = 5.0;
/// Less than this does not matter: half a degree, and two per cent of the thrust. Set by hand before it was tried.
const LEAST_TRIM_DEG: f64 = 0.5;
/// The share of the thrust, see [`LEAST_TRIM_DEG`].
const LEAST_THRUST: f64 = 0.02;
/// Time from the start of a flight not used in the fit, from which its nuisance parameters are estimated.
pub const SETTLE_S: f64 = 5.0;
/// No ground effect reaches so high.
const FAR_FROM_FLOOR_M: f64 = 10.0;

/// Moves the hover PWM of the model to the mean of the flights', so that their thrust scales, which are in `shared`
/// among all numbers of a fit, are 1 in the mean. Returns its standard error by how much flights differ.
pub(super) fn centre_hover(hypothesis: &mut Hypothesis, flights: usize, shared: &mut [f64]) -> Option<f64> {
    let local = hypothesis.place(thrust_term(hypothesis)?.entry.name).next()?;
    let priors = hypothesis.per_flight();
    let common = priors.iter().filter(|p| p.is_none()).count();
    let (own, rank) = (priors.len() - common, priors[..local].iter().filter(|p| p.is_some()).count());
    let places: Vec<usize> = (0..flights).map(|flight| common + flight * own + rank).collect();
    let n = flights as f64;
    let mean = places.iter().map(|i| shared[*i]).sum::<f64>() / n;
    let hover = hypothesis.model.parameter(HOVER).ok()? / mean;
    hypothesis.model = hypothesis.model.with_parameter(HOVER, hover).ok()?;
    places.iter().for_each(|i| shared[*i] /= mean);
    let squares: f64 = places.iter().map(|i| (shared[*i] - 1.0).powi(2)).sum();
    Some(hover * (squares / (n - 1.0).max(1.0) / n).sqrt())
}

/// The nuisance parameters of one flight.
#[derive(Debug, Clone, PartialEq)]
pub struct NuisanceParameters {
    /// Name of the flight's log.
    pub log: String,
    /// Name, unit and value of each; the hover PWM among them, where thrust is commanded.
    pub values: Vec<(String, &'static str, f64)>,
}

/// A nuisance parameter that all flights share, away from what the model declares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SharedTrim {
    /// Its effect and parameter, or `hover_pwm`.
    pub name: String,
    /// Mean over the flights.
    pub value: f64,
    /// Standard deviation over the flights.
    pub spread: f64,
    /// Value of the model.
    pub declared: f64,
    /// Unit of the numbers.
    pub unit: &'static str,
    /// Causes that these flights do not separate.
    pub causes: &'static str,
}

/// The nuisance parameters that flights share: their mean is away from the model's value by an amount that matters, and
/// by several times what the flights differ by. `flights` are at least two of one vehicle, each with all parameters.
pub fn shared_trims(model: &Model, flights: &[NuisanceParameters]) -> Vec<SharedTrim> {
    let spreads = registry().iter().filter(|entry| entry.flight_spread.sd().is_some());
    let shared = |name: &str, unit, declared: f64, least: f64, causes| {
        let named =
            |trim: &NuisanceParameters| trim.values.iter().find(|(known, ..)| known == name).map(|v| v.2);
        let values: Vec<f64> = flights.iter().filter_map(named).collect();
        let value = mean(&values).filter(|_| values.len() >= LEAST_SHARING)?;
        let squares: f64 = values.iter().map(|v| (v - value).powi(2)).sum();
        let spread = (squares / (values.len() - 1) as f64).sqrt();
        let is_shared = (value - declared).abs() > least.max(SHARED * spread);
        is_shared.then(|| SharedTrim { name: name.to_owned(), value, spread, declared, unit, causes })
    };
    let of_entry = |entry: &'static Entry| {
        let causes = entry.flight_spread.shared_causes();
        if scales_thrust(entry) {
            let hover = model.parameter(HOVER).ok();
            let hover = hover.and_then(|pwm| shared("hover_pwm", "1", pwm, LEAST_THRUST * pwm, causes));
            return hover.into_iter().collect();
        }
        let name = |p: &Param| format!("{}.{}", entry.name, p.name);
        let params = entry.params.iter();
        params.filter_map(|p| shared(&name(p), p.unit, p.off, LEAST_TRIM_DEG, causes)).collect::<Vec<_>>()
    };
    spreads.flat_map(of_entry).collect()
}

/// A model that is fitted, with what differs from flight to flight if its input is given. Its damping of pushes is not
/// estimated.
pub(crate) fn hypothesis(model: &Model, input: Option<VerticalInput>) -> Hypothesis {
    let plain = Hypothesis { estimates_lagged_push: false, ..Hypothesis::from_model(model) };
    input.map_or_else(Vec::new, terms).into_iter().fold(plain, |h, term| h.with(term))
}

/// Effects whose free parameters every flight has for itself.
pub(super) fn terms(input: VerticalInput) -> Vec<Term> {
    let is_told = |entry: &&Entry| input == VerticalInput::Thrust || !scales_thrust(entry);
    let term = |(entry, sd): (&'static Entry, f64)| {
        let mut term = Term::off(entry);
        // the torques' share belongs to the vehicle: fits to single flights drove it to 0 or 1
        if scales_thrust(entry) {
            term.free.truncate(1);
        }
        let priors = term.free_values().into_iter().map(|mean| Prior { mean, sd }).collect();
        Term { per_flight: Some(priors), ..term }
    };
    let differing = registry().iter().filter(is_told);
    differing.filter_map(|entry| entry.flight_spread.sd().map(|sd| term((entry, sd)))).collect()
}

fn scales_thrust(entry: &Entry) -> bool {
    matches!(entry.flight_spread, FlightSpread::Thrust(_))
}

/// The term by which flights differ in their thrust.
fn thrust_term(hypothesis: &Hypothesis) -> Option<&Term> {
    hypothesis.terms.iter().find(|term| scales_thrust(term.entry))
}

/// Estimates the priors from the flights of a fit, whose free numbers are all in `each`: how much flights differ is
/// itself estimated.
pub(super) fn learn_priors(hypothesis: &mut Hypothesis, each: &[Vec<f64>]) {
    if each.len() < LEAST_FLIGHTS {
        return;
    }
    let n = each.len() as f64;
    let mut place = hypothesis.free.len();
    for term in &mut hypothesis.terms {
        let first_sd = term.entry.flight_spread.sd().unwrap_or(0.0);
        for (i, prior) in term.per_flight.iter_mut().flatten().enumerate() {
            let values = each.iter().map(|flight| flight[place + i]);
            let mean = values.clone().sum::<f64>() / n;
            // the mean thrust belongs to the hover PWM of the model
            prior.mean = if scales_thrust(term.entry) { 1.0 } else { mean };
            let squares: f64 = values.map(|v| (v - mean).powi(2)).sum();
            prior.sd = (squares / (n - 1.0)).sqrt().max(NARROWEST * first_sd);
        }
        place += term.free.len();
    }
}

/// The hypothesis with the nuisance parameters of a flight found from its first seconds; nothing else in it
/// is free.
pub(crate) fn fit_on_start(hypothesis: &Hypothesis, flight: &Flight) -> Hypothesis {
    // the first seconds, or what there is of a shorter flight
    let tick = |s: f64| (s / flight.tick_s).round() as usize;
    let last = tick(SETTLE_S).min(flight.ticks);
    // in a take-off perhaps a wrong damping of climb passes for another hover PWM: velocities 2 s ahead were off by
    // 0.330 m/s with it, by 0.294 without, on flights as in [`INFLATION`]; trims show there as anywhere
    let first = if last == tick(SETTLE_S) { tick(TAKE_OFF_S) } else { 0 };
    let lifted = fit_on_window(hypothesis, flight, first..last, INFLATION);
    // trims show in how far the vehicle drifts, the more the longer it does
    let mut trimmed = hypothesis.clone();
    if let Some(scale) = thrust_term(&lifted) {
        let known = Term { free: Vec::new(), per_flight: Some(Vec::new()), ..scale.clone() };
        trimmed = trimmed.without(scale.entry.name).with(known);
    }
    let mut drifting = flight.clone();
    drifting.noise.pos_m[2] *= HEIGHT_INFLATION;
    fit_on_window(&trimmed, &drifting, 0..last, TRIM_INFLATION).without_free()
}

/// Returns the hypothesis with its free numbers estimated from one window of a flight.
fn fit_on_window(
    hypothesis: &Hypothesis,
    flight: &Flight,
    ticks: Range<usize>,
    inflation: f64,
) -> Hypothesis {
    let windows = [Window { flight: 0, ticks }];
    let flights = std::slice::from_ref(flight);
    let prediction = OutputErrorProblem { flights, windows: &windows, hypothesis, inflation };
    let solution = solve(&prediction, prediction.measured_starts(), prediction.shared());
    hypothesis.with_values(&prediction.flight_numbers(&solution.shared, 0))
}

/// Reduces the weight of a flight's heights near take-off and landing. The model's error there is so large that it
/// distorts the slope of the thrust and the warming of the motors: of eleven flights, each part predicted from the
/// others, vertical velocity 2 s ahead was off by 0.177 m/s with them and by 0.168 m/s without.
pub(super) fn doubt_heights(flight: &mut Flight) {
    let end_s = flight.ticks as f64 * flight.tick_s;
    doubt_near_floor(&mut flight.fixes, end_s);
}

/// The heights of [`doubt_heights`]. A flight that is hardly longer than its ends has nothing else to use.
fn doubt_near_floor(fixes: &mut [Sample], end_s: f64) {
    let near_floor = |t_s: f64| t_s < TAKE_OFF_S || t_s > end_s - TAKE_OFF_S;
    if end_s > 2.0 * TAKE_OFF_S + SETTLE_S {
        let doubted = fixes.iter_mut().filter(|fix| near_floor(fix.t_s));
        doubted.for_each(|fix| fix.noise_scale[2] *= HEIGHT_INFLATION);
    }
}

/// Removes from flights of a fit and of a test the numbers that each has of its own under a model, and returns them.
/// They are estimated from whole flights of the fit, and from the first [`SETTLE_S`] seconds of those of the test.
/// Only under motion capture: elsewhere trims are what a user looks for.
pub fn settle_flights(model: &Model, fit: &mut [Flight], test: &mut [Flight]) -> Vec<NuisanceParameters> {
    let is_seen = fit.iter().chain(&*test).all(|f| f.sees_true_attitude);
    let Some(input) = fit.first().map(|f| f.input).filter(|_| is_seen) else { return Vec::new() };
    let mut hypothesis = hypothesis(model, Some(input));
    let each = settle_each(&hypothesis, fit);
    let usual: Vec<MeasurementNoise> = fit.iter().chain(&*test).map(|flight| flight.noise).collect();
    let residual_noise = |(flight, found): (&Flight, &Solution)| {
        let (own, windows) =
            (hypothesis.with_values(&found.shared).without_free(), flight.windows(0, WINDOW_S));
        rows(&[own], std::slice::from_ref(flight), &windows, &found.own).noise(&FLOOR)
    };
    let noise: Vec<[f64; 6]> = fit.iter().zip(&each).map(residual_noise).collect();
    let square = |i: usize| noise.iter().map(|noise| noise[i].powi(2)).sum::<f64>();
    let noise = measurement_noise(&std::array::from_fn(|i| (square(i) / fit.len() as f64).sqrt()));
    fit.iter_mut().chain(&mut *test).for_each(|flight| flight.noise = noise);
    let each: Vec<Vec<f64>> = settle_each(&hypothesis, fit).into_iter().map(|found| found.shared).collect();
    learn_priors(&mut hypothesis, &each);
    let mut trims = Vec::new();
    for (flight, numbers) in fit.iter_mut().zip(&each) {
        let own = hypothesis.with_values(numbers);
        trims.push(trim(&flight.name, &own));
        *flight = without_trims(flight, &own);
    }
    for flight in &mut *test {
        flight.noise.att_rad.iter_mut().for_each(|sd| *sd /= ATTITUDE_DEFLATION);
        let own = fit_on_start(&hypothesis, flight);
        trims.push(trim(&flight.name, &own));
        *flight = without_trims(flight, &own);
    }
    fit.iter_mut().chain(test).zip(usual).for_each(|(flight, noise)| flight.noise = noise);
    trims
}

/// The numbers that each flight has of its own, estimated from all of it.
fn settle_each(hypothesis: &Hypothesis, flights: &[Flight]) -> Vec<Solution> {
    let settle = |flight: &Flight| {
        let (flights, windows) = (std::slice::from_ref(flight), &flight.windows(0, WINDOW_S)[..]);
        let prediction = OutputErrorProblem::new(flights, windows, hypothesis);
        solve(&prediction, prediction.measured_starts(), prediction.shared())
    };
    flights.iter().map(settle).collect()
}

/// Standard deviations of what a flight's windows leave. Until they are known attitudes count too little: at ten times
/// their noise the trims of a test flight, which five seconds determine, followed its random pushes by two degrees.
fn without_trims(flight: &Flight, own: &Hypothesis) -> Flight {
    let tilt_rad = |is_it: fn(FlightSpread) -> bool| {
        let term = own.terms.iter().find(|term| is_it(term.entry.flight_spread));
        term.map_or([0.0; 2], |term| [term.values[0].to_radians(), term.values[1].to_radians()])
    };
    let lean_rad = tilt_rad(|spread| matches!(spread, FlightSpread::Lean(_)));
    let frame_rad = tilt_rad(|spread| matches!(spread, FlightSpread::Frame(_)));
    let [offset, factor] = usual_lift(flight.input, own).unwrap_or([0.0, 1.0]);
    let lift = |lift: f64| offset + factor * lift;
    flight.without_trims(&own.model, lean_rad, frame_rad, &lift)
}

/// Offset and factor of the command that gives the vehicle without its thrust scale the thrust that it has with it.
/// The thrust need not go through the origin: a slope of the model exists beside the scale.
fn usual_lift(input: VerticalInput, own: &Hypothesis) -> Option<[f64; 2]> {
    let scale = thrust_term(own)?.entry.name;
    let hover = own.model.vertical(input).ok()?.hover_pwm()?;
    let lifts = [hover, 1.1 * hover];
    let climbs_mps2 = |hypothesis: &Hypothesis| {
        let model = hypothesis.to_model("as fitted");
        let [first, second] = lifts.map(|lift| climb_mps2(&model, input, lift));
        first.zip(second).map(<[f64; 2]>::from)
    };
    let (scaled, usual) = (climbs_mps2(own)?, climbs_mps2(&own.without(scale))?);
    let slope = (usual[1] - usual[0]) / (lifts[1] - lifts[0]);
    // the usual command for each of the two
    let needed = [0, 1].map(|i| lifts[i] + (scaled[i] - usual[i]) / slope);
    let factor = (needed[1] - needed[0]) / (lifts[1] - lifts[0]);
    Some([needed[0] - factor * lifts[0], factor]).filter(|line| line.iter().all(|v| v.is_finite()))
}

/// Upward acceleration of a level vehicle at rest, far from the floor and at the reference voltage.
fn climb_mps2(model: &Model, input: VerticalInput, lift: f64) -> Option<f64> {
    let settings = Settings { input, physics_hz: None };
    let mut world = World::<f64>::new(model, &EffectTable::new(), settings, 1).ok()?;
    let rest = State { pos_m: [0.0, 0.0, FAR_FROM_FLOOR_M], ..State::rest() };
    let command = Command::level(lift);
    world.start(0, true, &with_lags(model, input, rest), &command);
    world.set_voltage(Some(model.battery_reference_v()));
    world.step(0, &command);
    Some(world.state(0).vel_mps[2] * model.rig.control.value)
}

/// Nuisance parameters as people read them.
pub(super) fn trim(log: &str, hypothesis: &Hypothesis) -> NuisanceParameters {
    let mut values = Vec::new();
    for term in hypothesis.terms.iter().filter(|t| t.per_flight.is_some()) {
        if scales_thrust(term.entry) {
            let hover = hypothesis.model.parameter(HOVER).unwrap_or(f64::NAN);
            values.push(("hover_pwm".to_owned(), "1", hover / term.values[0]));
        } else {
            let params = term.entry.params.iter().zip(&term.values);
            values.extend(params.map(|(p, v)| (format!("{}.{}", term.entry.name, p.name), p.unit, *v)));
        }
    }
    NuisanceParameters { log: log.to_owned(), values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::config::{EffectParams, Number};

    fn with_slope(slope: f64) -> Model {
        let mut model = Model::thesis();
        model.effects.insert("thrust_slope".into(), EffectParams::First(Number::Fixed(slope)));
        model
    }

    #[test]
    fn the_usual_command_gives_the_thrust_that_a_flight_had() {
        let mut scale = Term::off(registry().iter().find(|entry| scales_thrust(entry)).unwrap());
        scale.values[0] = 0.94;
        for slope in [0.5, 1.0, 1.6] {
            let own = Hypothesis::from_model(&with_slope(slope)).with(scale.clone());
            let [offset, factor] = usual_lift(VerticalInput::Thrust, &own).unwrap();
            for lift in [30_000.0, 39_342.5, 45_000.0] {
                let had = climb_mps2(&own.to_model("test"), VerticalInput::Thrust, lift).unwrap();
                let usual = climb_mps2(&own.model, VerticalInput::Thrust, offset + factor * lift).unwrap();
                assert!((had - usual).abs() < 1e-9, "slope {slope}, lift {lift}: {had} {usual}");
            }
        }
    }

    #[test]
    fn a_trim_is_shared_if_flights_agree_on_it() {
        let model = Model::thesis();
        let hover = model.parameter(HOVER).unwrap();
        let flight = |roll_deg: f64, pitch_deg: f64, ratio: f64| NuisanceParameters {
            log: "a flight".into(),
            values: vec![
                ("com_offset.roll_deg".into(), "deg", roll_deg),
                ("com_offset.pitch_deg".into(), "deg", pitch_deg),
                ("hover_pwm".into(), "1", ratio * hover),
            ],
        };
        // roll is the same in all, pitch differs, and the thrust is that of a weight
        let flights = [flight(2.0, 1.5, 1.07), flight(2.2, -1.4, 1.08), flight(1.9, 0.8, 1.07)];
        let found = shared_trims(&model, &flights);
        let named: Vec<(&str, f64)> = found.iter().map(|trim| (trim.name.as_str(), trim.value)).collect();
        assert_eq!(named.len(), 2, "{found:?}");
        assert!(named.iter().any(|(name, deg)| *name == "com_offset.roll_deg" && (deg - 2.033).abs() < 0.01));
        assert!(named.iter().any(|(name, pwm)| *name == "hover_pwm" && (pwm / hover - 1.073).abs() < 0.001));
        assert!(shared_trims(&model, &flights[..2]).is_empty());
        assert!(
            shared_trims(&model, &[flight(0.2, 0.1, 1.01), flight(0.21, 0.1, 1.01), flight(0.2, 0.1, 1.01)])
                .is_empty()
        );
    }

    #[test]
    fn take_off_and_landing_tell_places_and_no_heights() {
        let marked_fixes = |end_s: f64| -> Vec<Sample> {
            let fix = |i: usize| Sample { t_s: 0.5 * i as f64, value: [0.0; 3], noise_scale: [1.0; 3] };
            let mut fixes: Vec<Sample> = (0..=(2.0 * end_s) as usize).map(fix).collect();
            doubt_near_floor(&mut fixes, end_s);
            fixes
        };
        for fix in marked_fixes(20.0) {
            assert_eq!(fix.noise_scale[..2], [1.0; 2]);
            assert_eq!(fix.noise_scale[2] > 1.0, !(2.0..=18.0).contains(&fix.t_s), "{fix:?}");
        }
        assert!(marked_fixes(8.0).iter().all(|fix| fix.noise_scale == [1.0; 3]));
    }
}
