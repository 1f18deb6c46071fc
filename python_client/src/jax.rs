//! Environments as modules of JAX functions.

use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::recording::{EpisodeStart, record_environment};
use crazyflie_jax::write_module;
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::errors::guarded;

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
            let texts = models.iter().flatten();
            let mut models =
                texts.map(|text| Model::parse(text)).collect::<crazyflie_env::Result<Vec<_>>>()?;
            if models.is_empty() {
                models.push(Model::thesis());
            }
            let recording = record_environment(&models, &Options::parse(options)?, (seed, starts))?;
            Ok::<_, crazyflie_env::Error>((write_module(&recording)?, recording.starts))
        })
    })?;
    let start = |start: EpisodeStart| (start.keys, PyArray1::from_vec(py, start.numbers));
    Ok((text, starts.into_iter().map(start).collect()))
}
