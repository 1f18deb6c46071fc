//! Environments as modules of JAX functions, and the core as a function of XLA.

mod core;
mod xla;

pub use core::{JaxCore, jax_step_target};

use crazyflie_env::config::Options;
use crazyflie_env::recording::{EpisodeStart, fly_double, record_environment};
use crazyflie_jax::write_module;
use numpy::{PyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;

use crate::errors::guarded;
use crate::sim::parse_models;

/// The words of each drone's noise and the numbers of the start, episode by episode.
type Starts<'py> = Vec<(Vec<u64>, Bound<'py, PyArray1<f64>>)>;

/// The text of a module of JAX functions for an environment (see `Sim` for `options` and `models`), and the starts
/// that it picks from: those of the seeds from `seed` on.
#[pyfunction]
#[pyo3(signature = (options = "{}", models = None, *, seed = 0, starts = 256))]
pub fn jax_module<'py>(
    py: Python<'py>,
    options: &str,
    models: Option<Vec<String>>,
    seed: u64,
    starts: usize,
) -> PyResult<(String, Starts<'py>)> {
    let (text, starts) = py.detach(|| {
        guarded(|| {
            let models = parse_models(models.as_deref().unwrap_or_default())?;
            let recording = record_environment(&models, &Options::parse(options)?, (seed, starts))?;
            Ok::<_, crazyflie_env::Error>((write_module(&recording)?, recording.starts))
        })
    })?;
    let start = |start: EpisodeStart| (start.keys, PyArray1::from_vec(py, start.numbers));
    Ok((text, starts.into_iter().map(start).collect()))
}

/// Observations, rewards, terminated, truncated, true states; flat, tick by tick and drone by drone.
type DoubleRows<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
);

/// Flies the first episode of `seed` in double precision with these actions (see `Sim` for `options` and `models`);
/// it is not reset at its end. Observations begin with the first moment.
#[pyfunction]
#[pyo3(signature = (options, models, seed, actions))]
pub fn double_flight<'py>(
    py: Python<'py>,
    options: &str,
    models: Vec<String>,
    seed: u64,
    actions: PyReadonlyArrayDyn<'py, f64>,
) -> PyResult<DoubleRows<'py>> {
    let actions: Vec<f64> = actions.as_array().iter().copied().collect();
    let flight = py.detach(|| {
        guarded(|| fly_double(&parse_models(&models)?, &Options::parse(options)?, seed, &actions))
    })?;
    Ok((
        PyArray1::from_vec(py, flight.observations),
        PyArray1::from_vec(py, flight.rewards),
        PyArray1::from_vec(py, flight.terminated),
        PyArray1::from_vec(py, flight.truncated),
        PyArray1::from_vec(py, flight.states),
    ))
}
