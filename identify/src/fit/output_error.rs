//! The output-error fit: the numbers of a hypothesis that make its predictions of windows nearest to what was
//! measured.

use crazyflie_env::model::VerticalInput;

use super::flight::{Flight, Window};
use super::hypothesis::Hypothesis;
use super::predict::{MeanSimulator, START, SensitivitySimulator};
use super::solve::{NormalEquations, Prior, Problem};

/// The output-error fit of a hypothesis to windows of flights.
pub struct OutputErrorProblem<'a> {
    /// Flights that the windows are of.
    pub flights: &'a [Flight],
    /// Windows to fit, each with a start of its own.
    pub windows: &'a [Window],
    /// Hypothesis whose free numbers are fitted.
    pub hypothesis: &'a Hypothesis,
    /// Standard deviations are taken this many times as large: for residuals that are not white.
    pub inflation: f64,
}

impl<'a> OutputErrorProblem<'a> {
    /// The problem with the standard deviations of the flights.
    pub fn new(flights: &'a [Flight], windows: &'a [Window], hypothesis: &'a Hypothesis) -> Self {
        OutputErrorProblem { flights, windows, hypothesis, inflation: 1.0 }
    }

    /// The windows' starts as measured.
    pub fn measured_starts(&self) -> Vec<Vec<f64>> {
        let simulator = |flight: &Flight| MeanSimulator::new(self.hypothesis, flight, false).ok();
        let mut simulators: Vec<Option<MeanSimulator>> = self.flights.iter().map(simulator).collect();
        let start = |w: &Window| {
            let flight = &self.flights[w.flight];
            let simulator = simulators[w.flight].as_mut();
            simulator.map_or_else(
                || flight.measured_numbers(w.ticks.start),
                |simulator| simulator.measured_start(flight, w.ticks.start),
            )
        };
        self.windows.iter().map(start).collect()
    }
}

/// Free numbers of a hypothesis: those that all flights share, and those that each has for itself, by their
/// places in [`Hypothesis::free_values`].
struct ParameterLayout {
    common: Vec<usize>,
    per_flight: Vec<usize>,
}

impl ParameterLayout {
    fn new(hypothesis: &Hypothesis) -> Self {
        let per_flight = hypothesis.per_flight();
        let (per_flight, common) = (0..per_flight.len()).partition(|i| per_flight[*i].is_some());
        ParameterLayout { common, per_flight }
    }

    /// The place among all free numbers of a flight's number with this place in [`Hypothesis::free_values`].
    fn place(&self, flight: usize, local: usize) -> usize {
        let rank = |all: &[usize]| all.iter().position(|i| *i == local);
        let first = self.common.len() + flight * self.per_flight.len();
        rank(&self.common).or_else(|| rank(&self.per_flight).map(|i| first + i)).unwrap_or(0)
    }

    fn places(&self, flight: usize) -> Vec<usize> {
        (0..self.common.len() + self.per_flight.len()).map(|local| self.place(flight, local)).collect()
    }
}

impl OutputErrorProblem<'_> {
    /// The free numbers: those that all flights share, then those of each flight in turn. Without numbers of
    /// flights, [`Hypothesis::free_values`].
    pub fn shared(&self) -> Vec<f64> {
        self.repeat_per_flight(&self.hypothesis.free_values())
    }

    /// One flight's free numbers in the order of [`Hypothesis::free_values`], out of all.
    pub fn flight_numbers(&self, shared: &[f64], flight: usize) -> Vec<f64> {
        ParameterLayout::new(self.hypothesis).places(flight).into_iter().map(|place| shared[place]).collect()
    }

    /// The same of each flight.
    pub fn each_flight(&self, shared: &[f64]) -> Vec<Vec<f64>> {
        (0..self.flights.len()).map(|flight| self.flight_numbers(shared, flight)).collect()
    }

    /// The hypothesis of each flight, with nothing free.
    pub fn each_fixed(&self, shared: &[f64]) -> Vec<Hypothesis> {
        let fixed = |numbers: &Vec<f64>| self.hypothesis.with_values(numbers).without_free();
        self.each_flight(shared).iter().map(fixed).collect()
    }

    /// All free numbers, out of those of each flight in the order of [`Hypothesis::free_values`]: the inverse
    /// of [`OutputErrorProblem::flight_numbers`].
    pub fn join_flights(&self, each: &[Vec<f64>]) -> Vec<f64> {
        let layout = ParameterLayout::new(self.hypothesis);
        let common = layout.common.iter().filter_map(|i| each.first().map(|numbers| numbers[*i]));
        common.chain(each.iter().flat_map(|numbers| layout.per_flight.iter().map(|i| numbers[*i]))).collect()
    }

    /// A simulator with the clock and the numbers of a flight.
    fn simulator(&self, shared: &[f64], flight: usize) -> Option<FlightSimulator> {
        let numbers = self.hypothesis.with_values(&self.flight_numbers(shared, flight));
        let worker = SensitivitySimulator::new(&numbers, self.flights.get(flight)?, false).ok()?;
        Some(FlightSimulator { worker, shared: shared.to_vec(), flight })
    }

    /// Gives a simulator the numbers of another flight, and its clock if that is another one. Returns whether
    /// the simulator can take them.
    fn turn_to(&self, simulator: &mut FlightSimulator, flight: usize) -> bool {
        let before = std::mem::replace(&mut simulator.flight, flight);
        if before == flight {
            return true;
        }
        if !self.flights[before].shares_clock(&self.flights[flight]) {
            let another = self.simulator(&simulator.shared, flight);
            return another.map(|another| *simulator = another).is_some();
        }
        let numbers = self.flight_numbers(&simulator.shared, flight);
        simulator.worker.set_free(&numbers[self.hypothesis.free.len()..]).is_ok()
    }

    /// Something of each free number, repeated for every flight that has its own.
    fn repeat_per_flight<T: Copy>(&self, local: &[T]) -> Vec<T> {
        let layout = ParameterLayout::new(self.hypothesis);
        let of_flights = self.flights.iter().flat_map(|_| layout.per_flight.iter());
        layout.common.iter().chain(of_flights).map(|i| local[*i]).collect()
    }
}

/// A thread's simulator with the numbers of one flight in place.
pub struct FlightSimulator {
    worker: SensitivitySimulator,
    shared: Vec<f64>,
    flight: usize,
}

impl Problem for OutputErrorProblem<'_> {
    type Worker = Option<FlightSimulator>;

    fn windows(&self) -> usize {
        self.windows.len()
    }
    fn own_unknowns(&self) -> usize {
        START + self.hypothesis.lags_sd(self.flights.first().map_or(VerticalInput::Height, |f| f.input)).len()
    }
    fn bounds(&self) -> Vec<[f64; 2]> {
        self.repeat_per_flight(&self.hypothesis.bounds())
    }
    fn common(&self) -> usize {
        ParameterLayout::new(self.hypothesis).common.len()
    }
    fn places(&self, window: usize) -> Vec<usize> {
        ParameterLayout::new(self.hypothesis).places(self.windows[window].flight)
    }
    fn priors(&self) -> Vec<Option<Prior>> {
        self.repeat_per_flight(&self.hypothesis.per_flight())
    }
    fn worker(&self, shared: &[f64]) -> Option<FlightSimulator> {
        self.simulator(shared, 0)
    }
    fn normal_equations(&self, worker: &mut Self::Worker, window: usize, own: &[f64]) -> NormalEquations {
        let window = &self.windows[window];
        let unknowns = self.own_unknowns() + self.hypothesis.per_flight().len();
        let mut normal = NormalEquations::new(unknowns);
        normal.loss = f64::INFINITY;
        let Some(simulator) = worker.as_mut() else { return normal };
        if !self.turn_to(simulator, window.flight) {
            return normal;
        }
        let worker = &mut simulator.worker;
        worker.predict(&self.flights[window.flight], window, own);
        if worker.rows().iter().any(|r| !r.predicted.is_finite()) {
            return normal;
        }
        normal.loss = 0.0;
        let mut slopes = vec![0.0; unknowns];
        let reported = worker.reported_start();
        let held = self.flights[window.flight]
            .start_residuals(window.ticks.start, reported.map_or(own, |(reported, _)| reported));
        for (i, (residual, per_sd)) in held.into_iter().enumerate() {
            match reported {
                Some((_, of_reported)) => {
                    let row = &of_reported[i * unknowns..][..unknowns];
                    slopes.iter_mut().zip(row).for_each(|(slope, of_row)| *slope = of_row * per_sd);
                }
                None => slopes[i] = per_sd,
            }
            normal.add(residual, &slopes);
            slopes.fill(0.0);
        }
        for (row, of_row) in worker.rows().iter().zip(worker.slopes()) {
            slopes.iter_mut().zip(of_row).for_each(|(slope, of_row)| *slope = of_row / self.inflation);
            normal.add(row.residual() / self.inflation, &slopes);
        }
        normal.symmetrise();
        normal
    }
}
