//! The model and its loops for control engineers: transfer functions, matrices, reports and pictures.

use std::path::Path;

use crazyflie_cli::{loop_picture, loop_reports, vertical_form};
use crazyflie_control::loop_analysis::{LoopAxis, LoopReport};
use crazyflie_control::pid::Gains;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::transfer_function::Channel;
use crazyflie_env::{Error, Result};
use crazyflie_picture::Format;
use crazyflie_server::tune::hovering_gains;
use numpy::{PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{Failure, guarded, parse_json};

type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// A model's text (the thesis's unless given) and the vertical form that is commanded.
fn vehicle(model: Option<&str>, vertical: Option<&str>) -> Result<(Model, VerticalInput)> {
    let model = model.map_or_else(|| Ok(Model::thesis()), Model::parse)?;
    let form = vertical_form(&model, vertical)?;
    Ok((model, form))
}

/// Coefficients of numerator and denominator, highest power of s first.
#[pyfunction]
#[pyo3(signature = (channel, model = None, vertical = None))]
pub fn transfer_function(
    channel: &str,
    model: Option<&str>,
    vertical: Option<&str>,
) -> PyResult<(Vec<f64>, Vec<f64>)> {
    guarded(|| {
        let (model, form) = vehicle(model, vertical)?;
        let function = model.transfer_function(Channel::find(channel)?, form)?;
        Result::Ok((function.numerator, function.denominator))
    })
}

/// A (12, 12), B (12, 4), C (7, 12) and D (7, 4).
#[pyfunction]
#[pyo3(signature = (model = None, vertical = None))]
pub fn state_space<'py>(
    py: Python<'py>,
    model: Option<&str>,
    vertical: Option<&str>,
) -> PyResult<(Matrix<'py>, Matrix<'py>, Matrix<'py>, Matrix<'py>)> {
    let space = guarded(|| {
        let (model, form) = vehicle(model, vertical)?;
        model.state_space(form)
    })?;
    let matrix = |rows: usize, columns: usize, at: &dyn Fn(usize, usize) -> f64| {
        let numbers: Vec<f64> = (0..rows * columns).map(|i| at(i / columns, i % columns)).collect();
        numpy::PyArray1::from_vec(py, numbers).reshape([rows, columns])
    };
    Ok((
        matrix(12, 12, &|i, j| space.a[(i, j)])?,
        matrix(12, 4, &|i, j| space.b[(i, j)])?,
        matrix(7, 12, &|i, j| space.c[(i, j)])?,
        matrix(7, 4, &|i, j| space.d[(i, j)])?,
    ))
}

/// Loops of the PID as JSON: a list of one, or of all for `axis` None. `gains` is JSON as `crazyflie tune`
/// writes it, table 7.1 unless given.
#[pyfunction]
#[pyo3(signature = (axis = None, gains = None, model = None, vertical = None, sensors = "lab"))]
pub fn loop_report(
    axis: Option<&str>,
    gains: Option<&str>,
    model: Option<&str>,
    vertical: Option<&str>,
    sensors: &str,
) -> PyResult<String> {
    guarded(|| {
        let (model, form) = vehicle(model, vertical)?;
        let all = reports(&model, form, axis, gains, sensors)?;
        serde_json::to_string(&all).map_err(|e| Error::Config(e.to_string()))
    })
}

/// Returns plots of the loops as the bytes of a file, in the format of the ending of `file`.
#[pyfunction]
#[pyo3(signature = (file, axis = None, gains = None, model = None, vertical = None, sensors = "lab"))]
pub fn loop_plots<'py>(
    py: Python<'py>,
    file: &str,
    axis: Option<&str>,
    gains: Option<&str>,
    model: Option<&str>,
    vertical: Option<&str>,
    sensors: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let format = guarded(|| Format::from_path(Path::new(file)))?;
    let bytes = guarded(|| -> std::result::Result<Vec<u8>, Failure> {
        let (model, form) = vehicle(model, vertical)?;
        let all = reports(&model, form, axis, gains, sensors)?;
        let title = format!("{}, {} form: loops of the PID", model.name, form.name());
        Ok(format.encode(&loop_picture(&all, &title)?)?)
    })?;
    Ok(PyBytes::new(py, &bytes))
}

fn reports(
    model: &Model,
    form: VerticalInput,
    axis: Option<&str>,
    gains: Option<&str>,
    sensors: &str,
) -> Result<Vec<LoopReport>> {
    let axis = axis.map(LoopAxis::find).transpose()?;
    let gains = match gains {
        Some(text) => {
            let gains: Gains = parse_json("the gains", text)?;
            gains.check().map_err(Error::Config)?;
            gains
        }
        None => hovering_gains(model, form, &Gains::THESIS)?,
    };
    loop_reports(model, form, axis, &gains, sensors)
}
