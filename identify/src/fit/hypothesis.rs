//! Hypotheses about a vehicle: a model with some of its numbers free, and effects with some of their
//! parameters free.

use crazyflie_env::config::{EffectParams, Number, SourcedValue};
use crazyflie_env::effects::{self, Entry, Observability, Param, Role};
use crazyflie_env::model::{Model, VerticalInput};

use super::solve::Prior;

/// Initial standard deviations of the lagged pushes: a climb in m/s, a turn in rad/s.
const LAGGED_PUSH_SD: [f64; 2] = [0.3, 1.0];

/// An effect with values for all its parameters, some of them free.
#[derive(Clone)]
pub struct Term {
    /// Registry entry of the effect.
    pub entry: &'static Entry,
    /// Values of all parameters, in the order and units of the entry.
    pub values: Vec<f64>,
    /// Indices of the free parameters.
    pub free: Vec<usize>,
    /// If every flight has its own values of the free parameters (nuisance parameters of a fit): what is
    /// known of each beforehand.
    pub per_flight: Option<Vec<Prior>>,
}

impl Term {
    /// An effect that is off, its parameters free but for constants and choices.
    pub fn off(entry: &'static Entry) -> Self {
        let free = (0..entry.params.len()).filter(|i| entry.params[*i].role == Role::Free).collect();
        Term { entry, values: entry.params.iter().map(|p| p.off).collect(), free, per_flight: None }
    }

    /// An effect that is off, nothing of it free.
    pub fn without_free(entry: &'static Entry) -> Self {
        Term { free: Vec::new(), ..Term::off(entry) }
    }

    /// The terms of the effect at each of its own starts ([`Entry::starts`]).
    pub fn at_given_starts(entry: &'static Entry) -> impl Iterator<Item = Self> {
        let starts = entry.starts.chunks_exact(entry.params.len());
        starts.map(move |values| Term { values: values.to_vec(), ..Term::off(entry) })
    }

    /// The same with another value of one parameter.
    #[must_use]
    pub fn with_value(&self, param: usize, value: f64) -> Self {
        let mut other = self.clone();
        other.values[param] = value;
        other
    }

    /// An effect at the first of the values from which a search begins.
    pub fn at_start(entry: &'static Entry) -> Self {
        Term { values: entry.params.iter().map(first_start).collect(), ..Term::off(entry) }
    }

    /// Returns whether it is large enough, and neither a property of the declared form nor a description of the
    /// residual. A smaller size only compensates declared numbers that are not known better
    /// ([`effects::Param::least`]).
    pub fn is_cause(&self) -> bool {
        if matches!(self.entry.observability, Observability::HigherOrder | Observability::Surrogate) {
            return false;
        }
        let mut sized = self.entry.params.iter().zip(&self.values).filter(|(p, _)| p.least > 0.0).peekable();
        sized.peek().is_none() || sized.any(|(p, value)| (value - p.off).abs() >= p.least)
    }

    /// Returns whether it only describes what no effect explains.
    pub fn is_description(&self) -> bool {
        self.entry.observability == Observability::Surrogate
    }

    /// Returns whether it removes a delay from the declared numbers ([`effects::Param::holds_delay`]).
    fn makes_up_for_delay(&self) -> bool {
        self.entry.params.iter().zip(&self.values).any(|(p, value)| p.holds_delay && *value < p.off)
    }

    /// Returns the same with those parameters free too that only show beside the first, if a fit constrains the
    /// flight to its measured motion.
    #[must_use]
    pub fn with_companions(mut self) -> Self {
        let is_companion = |(_, param): &(usize, &Param)| param.role == Role::Companion;
        for (i, param) in self.entry.params.iter().enumerate().filter(is_companion) {
            if !self.free.contains(&i) {
                self.values[i] = first_start(param);
                self.free.push(i);
            }
        }
        self.free.sort_unstable();
        self
    }

    /// The values of the free parameters.
    pub fn free_values(&self) -> Vec<f64> {
        self.free.iter().map(|i| self.values[*i]).collect()
    }
}

/// The first of the values from which a search begins.
fn first_start(param: &Param) -> f64 {
    param.starts.first().copied().unwrap_or(param.off)
}

impl std::fmt::Debug for Term {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:?}", self.entry.name, self.values)
    }
}

/// A model with free numbers and effects.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// Model with its free numbers at their present values.
    pub model: Model,
    /// Paths of the model's free numbers.
    pub free: Vec<String>,
    /// Effects beside those of the model, in registry order.
    pub terms: Vec<Term>,
    /// Physics steps per second are at most so many, although an effect needs more.
    pub max_physics_hz: Option<u32>,
    /// Estimates the lagged pushes of first-order forms: something may have pushed the vehicle before a
    /// window began.
    pub estimates_lagged_push: bool,
}

impl Hypothesis {
    /// The model as it is.
    pub fn from_model(model: &Model) -> Self {
        Hypothesis {
            model: model.clone(),
            free: Vec::new(),
            terms: Vec::new(),
            max_physics_hz: None,
            estimates_lagged_push: true,
        }
    }

    /// The same with one more effect, in registry order.
    #[must_use]
    pub fn with(&self, term: Term) -> Self {
        let mut more = self.clone();
        more.terms.push(term);
        let place = |t: &Term| effects::find(t.entry.name).map_or(usize::MAX, |(place, _)| place);
        more.terms.sort_by_key(place);
        more
    }

    /// The same without an effect.
    #[must_use]
    pub fn without(&self, effect: &str) -> Self {
        let mut less = self.clone();
        less.terms.retain(|t| t.entry.name != effect);
        less
    }

    /// Returns whether an effect is among the terms, by its registry name.
    pub fn has(&self, effect: &str) -> bool {
        self.term(effect).is_some()
    }

    /// Returns the term of an effect, by its registry name.
    pub fn term(&self, effect: &str) -> Option<&Term> {
        self.terms.iter().find(|t| t.entry.name == effect)
    }

    /// Returns whether an effect of the hypothesis is a cause: large enough (see [`Term::is_cause`]), and not the
    /// delay contained in declared numbers beside it.
    pub fn is_cause(&self, effect: &str) -> bool {
        self.term(effect).is_some_and(|term| term.is_cause() && !self.holds_delay(term))
    }

    /// Returns the effect in which declared numbers contain some of a delay, see [`effects::Param::holds_delay`].
    pub fn delay_holder(&self) -> Option<&Term> {
        self.terms.iter().find(|term| self.holds_delay(term))
    }

    fn holds_delay(&self, term: &Term) -> bool {
        let is_delayed = self.terms.iter().any(|t| t.entry.delays && t.entry.name != term.entry.name);
        is_delayed && term.makes_up_for_delay()
    }

    /// Which lagged pushes of the model's forms are estimated (see [`Model::lags_push`]).
    pub fn lags_push(&self, input: VerticalInput) -> [bool; 2] {
        if self.estimates_lagged_push { self.model.lags_push(input).unwrap_or_default() } else { [false; 2] }
    }

    /// Initial standard deviations of the lag states, each in its state's unit: lagged pushes of the model's
    /// forms, then the states of effects.
    pub fn lags_sd(&self, input: VerticalInput) -> Vec<f64> {
        let of_model = self.lags_push(input).into_iter().zip(LAGGED_PUSH_SD).filter(|(lags, _)| *lags);
        // registry order, like the world's
        let entries = effects::registry().iter();
        let acting = entries.filter(|e| self.has(e.name) || self.model.effects.contains_key(e.name));
        let of_effects = acting.flat_map(|entry| std::iter::repeat_n(entry.lag_sd, entry.lags));
        of_model.map(|(_, sd)| sd).chain(of_effects).collect()
    }

    /// The free numbers: the model's, then the effects'.
    pub fn free_values(&self) -> Vec<f64> {
        let of_model = self.free.iter().filter_map(|path| self.model.parameter(path).ok());
        of_model.chain(self.terms.iter().flat_map(Term::free_values)).collect()
    }

    /// The prior of each free number that every flight has for itself; `None` for a number that all flights
    /// share.
    pub fn per_flight(&self) -> Vec<Option<Prior>> {
        let of_term = |t: &Term| -> Vec<Option<Prior>> {
            let priors = t.per_flight.as_ref().map(|priors| priors.iter().copied().map(Some).collect());
            let mut priors = priors.unwrap_or_else(|| vec![None; t.free.len()]);
            priors.truncate(t.free.len());
            priors
        };
        std::iter::repeat_n(None, self.free.len()).chain(self.terms.iter().flat_map(of_term)).collect()
    }

    /// Places of the free numbers of an effect among [`Hypothesis::free_values`].
    pub fn place(&self, effect: &str) -> std::ops::Range<usize> {
        let before = self.terms.iter().take_while(|term| term.entry.name != effect);
        let first = self.free.len() + before.map(|term| term.free.len()).sum::<usize>();
        first..first + self.term(effect).map_or(0, |term| term.free.len())
    }

    /// The same with other values for the free numbers. (Model numbers stay where the model would refuse the
    /// value.)
    #[must_use]
    pub fn with_values(&self, shared: &[f64]) -> Self {
        let mut moved = self.clone();
        let (of_model, mut rest) = shared.split_at(self.free.len());
        for (path, value) in self.free.iter().zip(of_model) {
            moved.model = moved.model.with_parameter(path, *value).unwrap_or(moved.model);
        }
        for term in &mut moved.terms {
            for (i, value) in term.free.iter().zip(rest) {
                term.values[*i] = *value;
            }
            rest = &rest[term.free.len()..];
        }
        moved
    }

    /// The same with nothing free.
    #[must_use]
    pub fn without_free(&self) -> Self {
        let mut fixed = Hypothesis { free: Vec::new(), ..self.clone() };
        fixed.terms.iter_mut().for_each(|term| term.free.clear());
        fixed
    }

    /// Returns lower and upper bound of each free number, in the order of [`Hypothesis::free_values`].
    pub fn bounds(&self) -> Vec<[f64; 2]> {
        let of_model = self.free.iter().map(|path| {
            let value = self.model.parameter(path).unwrap_or(0.0);
            // a number of a model keeps its sign, and what is nothing may become something
            let reach = if value == 0.0 { 10.0 } else { 20.0 * value.abs() };
            if value < 0.0 { [-reach, 0.0] } else { [0.0, reach] }
        });
        let bounds = |t: &Term| t.free.iter().map(|i| &t.entry.params[*i]).map(|p| [p.low, p.high]).collect();
        of_model.chain(self.terms.iter().flat_map::<Vec<[f64; 2]>, _>(bounds)).collect()
    }

    /// The model with the effects written into it, which the simulator flies.
    pub fn to_model(&self, source: &str) -> Model {
        let mut model = self.model.clone();
        for term in &self.terms {
            let sourced = |(p, value): (&Param, &f64)| {
                let (unit, source) = (p.unit.to_owned(), source.to_owned());
                (p.name.to_owned(), Number::Sourced(SourcedValue { value: *value, unit, source }))
            };
            let params = term.entry.params.iter().zip(&term.values).map(sourced).collect();
            model.effects.insert(term.entry.name.to_owned(), EffectParams::Named(params));
        }
        model
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_cause(effect: &str, values: &[f64]) -> bool {
        let mut term = Term::off(effects::find(effect).unwrap().1);
        term.values[..values.len()].copy_from_slice(values);
        Hypothesis::from_model(&Model::thesis()).with(term).is_cause(effect)
    }

    #[test]
    fn a_tenth_of_a_percent_of_thrust_is_no_cause() {
        // the torques' share makes no difference
        assert!(!is_cause("thrust_scale", &[1.001, 0.9]));
        assert!(is_cause("thrust_scale", &[0.95]));
        assert!(!is_cause("cmd_delay", &[0.005]) && is_cause("cmd_delay", &[0.02]));
        assert!(!is_cause("yaw_rate_loop", &[1.001, 0.005]) && is_cause("yaw_rate_loop", &[1.001, 0.05]));
        assert!(is_cause("wind", &[0.02]), "no declared number stands for it");
        assert!(!is_cause("attitude_order", &[0.02]), "a property of the declared form");
    }

    #[test]
    fn less_inertia_beside_a_lag_is_no_cause() {
        let term = |name: &str, value: f64| {
            let mut term = Term::off(effects::find(name).unwrap().1);
            term.values[0] = value;
            term
        };
        let with_inertia =
            |scale: f64| Hypothesis::from_model(&Model::thesis()).with(term("inertia_scale", scale));
        let with_lag = |scale: f64| with_inertia(scale).with(term("motor_lag", 0.06));
        assert!(with_inertia(0.8).is_cause("inertia_scale"), "alone it is lighter");
        assert!(!with_lag(0.8).is_cause("inertia_scale") && with_lag(1.3).is_cause("inertia_scale"));
        assert!(with_lag(0.8).is_cause("motor_lag"));
    }
}
