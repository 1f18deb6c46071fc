//! The search of gains, for `crazyflie_gym.tuning`.

use crazyflie_server::tune;
use pyo3::prelude::*;

use crate::errors::guarded;

/// A search of gains by CMA-ES, from `start`. It requests the costs of a generation at a time; the same costs lead to
/// the same gains.
#[pyclass(module = "crazyflie_gym._native")]
pub struct GainSearch(tune::GainSearch);

#[pymethods]
impl GainSearch {
    #[new]
    fn new(start: Vec<f64>, step: f64, population: usize, seed: u64) -> PyResult<GainSearch> {
        guarded(|| tune::GainSearch::new(&start, step, population, seed)).map(GainSearch)
    }

    /// The gains of the next generation, or None if the search has converged.
    fn ask(&mut self) -> Option<Vec<Vec<f64>>> {
        self.0.ask().map(<[_]>::to_vec)
    }

    /// Receives the costs of the requested generation, in its order.
    fn tell(&mut self, costs: Vec<f64>) -> PyResult<()> {
        guarded(|| self.0.tell(&costs))
    }
}
