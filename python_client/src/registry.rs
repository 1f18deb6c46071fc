//! Effects, tasks and observation fields of the registries, as Python dicts.

use crazyflie_env::coupling::NEIGHBOUR_FIELDS;
use crazyflie_env::error::check_range;
use crazyflie_env::model::{Model, Vehicle, VehicleSummary, VerticalInput};
use crazyflie_env::observation::{ALL_FIELDS, CHOICES, Field, NamedChoice, ObservationChoice};
use crazyflie_env::task_file::TaskFile;
use crazyflie_env::{Error, action, effects as effect, task};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

use crate::errors::guarded;

/// Every effect in the order of application, as a dict: name, about, source, hooks, params (name, unit, off,
/// low, high, about).
#[pyfunction]
pub fn effects(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let effect_dict = |entry: &effect::Entry| {
        let params: PyResult<Vec<_>> = entry.params.iter().map(|param| param_dict(py, param)).collect();
        let h = entry.hooks;
        let hooks = [("command", h.command), ("push", h.push), ("frame", h.frame), ("sense", h.sense)];
        let dict =
            [("name", entry.name), ("about", entry.about), ("source", entry.source)].into_py_dict(py)?;
        dict.set_item("hooks", hooks.iter().filter(|hook| hook.1).map(|hook| hook.0).collect::<Vec<_>>())?;
        dict.set_item("params", params?)?;
        Ok(dict)
    };
    effect::registry().iter().map(effect_dict).collect()
}

fn param_dict<'py>(py: Python<'py>, param: &effect::Param) -> PyResult<Bound<'py, PyDict>> {
    let dict = [("name", param.name), ("unit", param.unit), ("about", param.about)].into_py_dict(py)?;
    for (key, value) in [("off", param.off), ("low", param.low), ("high", param.high)] {
        dict.set_item(key, value)?;
    }
    Ok(dict)
}

/// Every task, as a dict: name, id (Gymnasium's), about, reward, max_episode_steps, drones, options (name,
/// unit, default, low and high number by number, range in words, drawn: may be a distribution, about).
#[pyfunction]
pub fn tasks(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let task_dict = |entry: &task::Entry| {
        let texts =
            [("name", entry.name), ("id", entry.id), ("about", entry.about), ("reward", entry.reward)];
        let dict = texts.into_py_dict(py)?;
        dict.set_item("max_episode_steps", entry.max_episode_steps)?;
        dict.set_item("drones", entry.drones)?;
        let options: PyResult<Vec<_>> =
            entry.options().iter().map(|option| option_dict(py, option)).collect();
        dict.set_item("options", options?)?;
        Ok(dict)
    };
    task::registry().iter().map(task_dict).collect()
}

fn option_dict<'py>(py: Python<'py>, option: &task::TaskOption) -> PyResult<Bound<'py, PyDict>> {
    let dict = [("name", option.name), ("unit", option.unit), ("about", option.about)].into_py_dict(py)?;
    let default = py.import("json")?.call_method1("loads", (option.default_value().to_string(),))?;
    dict.set_item("default", default)?;
    dict.set_item("low", option.low())?;
    dict.set_item("high", option.high())?;
    dict.set_item("range", option.range())?;
    dict.set_item("drawn", option.drawn)?;
    Ok(dict)
}

/// The rows of a track in a CSV file, for the option `points` of the task "track"; `name` is the file's, for
/// errors. `ValueError` names file, line and column.
#[pyfunction]
pub fn track_rows(text: &str, name: &str) -> PyResult<Vec<Vec<f64>>> {
    guarded(|| task::track_rows(text, name))
}

/// The layout of an observation row of `observation`: the name of a choice, or a list of names of fields. Returns
/// dicts: name, first, length, unit, low, high, about.
#[pyfunction]
#[pyo3(signature = (observation = NameOrNames::Name("measured".into())), text_signature = "(observation='measured')")]
pub fn observation_fields(py: Python<'_>, observation: NameOrNames) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let fields = guarded(|| ObservationChoice::from(observation).fields())?;
    fields.iter().map(|field| field_dict(py, field)).collect()
}

/// The names of an observation's fields, with estimates in the place of the true state: for use where only measurements
/// are known.
#[pyfunction]
pub fn estimated_fields(observation: NameOrNames) -> PyResult<Vec<&'static str>> {
    let fields = guarded(|| ObservationChoice::from(observation).estimated()?.fields())?;
    Ok(fields.into_iter().map(|field| field.name).collect())
}

/// A choice by its name, or fields by theirs.
#[derive(FromPyObject)]
pub enum NameOrNames {
    Name(String),
    Names(Vec<String>),
}

impl From<NameOrNames> for ObservationChoice {
    fn from(chosen: NameOrNames) -> Self {
        match chosen {
            NameOrNames::Name(name) => ObservationChoice::Named(name),
            NameOrNames::Names(names) => ObservationChoice::Fields(names),
        }
    }
}

/// Every field available to an observation, as dicts like those of `observation_fields`; "first" is its place if all
/// are chosen in this order.
#[pyfunction]
pub fn observable_fields(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    ALL_FIELDS.iter().map(|field| field_dict(py, field)).collect()
}

/// Every choice of fields that has a name, as dicts: name, about, fields (their names, in order).
#[pyfunction]
pub fn observation_choices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let choice_dict = |choice: &NamedChoice| {
        let dict = [("name", choice.name), ("about", choice.about)].into_py_dict(py)?;
        dict.set_item("fields", choice.fields.iter().map(|field| field.name).collect::<Vec<_>>())?;
        Ok(dict)
    };
    CHOICES.iter().map(choice_dict).collect()
}

/// Every field that a reward or termination may name, as dicts like those of `observation_fields`.
#[pyfunction]
pub fn expression_fields(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    crazyflie_env::expression::expression_fields().map(|field| field_dict(py, field)).collect()
}

/// Every function that a reward or termination may call, by name.
#[pyfunction]
pub fn expression_functions() -> Vec<&'static str> {
    crazyflie_env::expression::expression_functions().collect()
}

/// Read a task file (TOML or JSON) and return its id, its description and its options as JSON; `ValueError` names a
/// problem and its place.
#[pyfunction]
pub fn read_task(text: &str) -> PyResult<(String, String, String)> {
    let file = guarded(|| TaskFile::parse(text))?;
    Ok((file.id(), file.about.clone(), serde_json::Value::Object(file.options).to_string()))
}

/// Every action level, as dicts: name, about, channels (name, unit, low, high, about, bandwidth_radps),
/// validity, source. The ranges are those of a model: the built-in one in its default form, unless `model` is
/// the text of another and `vertical` one of its forms. Levels of a form that the model lacks are left out.
#[pyfunction]
#[pyo3(signature = (model = None, vertical = None))]
pub fn action_levels<'py>(
    py: Python<'py>,
    model: Option<&str>,
    vertical: Option<&str>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let model = guarded(|| model.map_or_else(|| Ok(Model::thesis()), Model::parse))?;
    let asked = guarded(|| vertical.map(VerticalInput::named).transpose())?;
    let level_dict = |entry: &action::Entry| -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(interface) = guarded(|| entry.interface(&model, asked))? else { return Ok(None) };
        let channel_dict = |(i, channel): (usize, &action::Channel)| {
            let texts = [("name", channel.name), ("unit", channel.unit), ("about", channel.about)];
            let dict = texts.into_py_dict(py)?;
            let [low, high] = interface.ranges()[i];
            for (key, number) in [("low", low), ("high", high), ("bandwidth_radps", entry.bandwidth_radps[i])]
            {
                dict.set_item(key, number)?;
            }
            Ok(dict)
        };
        let channels: PyResult<Vec<_>> = entry.channels.iter().enumerate().map(channel_dict).collect();
        let texts = [("name", entry.name), ("about", entry.about), ("validity", entry.validity)];
        let dict = texts.into_iter().chain([("source", entry.source)]).into_py_dict(py)?;
        dict.set_item("channels", channels?)?;
        Ok(Some(dict))
    };
    action::registry().iter().filter_map(|entry| level_dict(entry).transpose()).collect()
}

/// The layout of what follows an observation row for each of the other drones of an environment.
#[pyfunction]
pub fn neighbour_fields(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    NEIGHBOUR_FIELDS.iter().map(|field| field_dict(py, field)).collect()
}

fn field_dict<'py>(py: Python<'py>, field: &Field) -> PyResult<Bound<'py, PyDict>> {
    let dict = [("name", field.name), ("unit", field.unit), ("about", field.about)].into_py_dict(py)?;
    for (key, count) in [("first", field.first), ("length", field.length)] {
        dict.set_item(key, count)?;
    }
    for (key, value) in [("low", field.low), ("high", field.high)] {
        dict.set_item(key, value)?;
    }
    Ok(dict)
}

/// The text of a vehicle's model or data sheet, TOML: a start for one of your own. With `control_hz` it is the model
/// at that rate of commands. `ValueError` for a strange name or rate.
#[pyfunction]
#[pyo3(signature = (vehicle = "cf2-thesis", *, control_hz = None))]
pub fn model_text(vehicle: &str, control_hz: Option<f64>) -> PyResult<String> {
    guarded(|| {
        let vehicle = Vehicle::named(vehicle)?;
        let Some(control_hz) = control_hz else { return Ok(vehicle.text.to_owned()) };
        check_range("control_hz", control_hz, 1.0, 2000.0)?;
        vehicle.model().with_control_hz(control_hz).to_toml()
    })
}

/// Every vehicle that has a name, the default first, as a dict: name, platform (its kind by its firmware), about,
/// mass_kg, arm_m, vertical (the form that is commanded by default), verticals (all that it has), identified and
/// stated (parts of the model).
#[pyfunction]
pub fn vehicles(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let text = guarded(|| {
        serde_json::to_string(&VehicleSummary::of_all()?).map_err(|e| Error::Config(e.to_string()))
    })?;
    py.import("json")?.call_method1("loads", (text,))
}

/// The text (TOML) of the model of a data sheet's text (TOML or JSON); `ValueError` names a missing or wrong entry.
#[pyfunction]
pub fn datasheet_model(text: &str) -> PyResult<String> {
    guarded(|| Model::from_datasheet(text)?.to_toml())
}

/// Read a model (TOML or JSON) and return its name; `ValueError` names a problem and its place.
#[pyfunction]
pub fn check_model(text: &str) -> PyResult<String> {
    guarded(|| Model::parse(text).map(|model| model.name))
}

/// The command line `crazyflie` with these arguments (the program's name is not one of them); returns the
/// exit status.
#[pyfunction]
pub fn cli(py: Python<'_>, argv: Vec<String>) -> PyResult<i32> {
    let argv = std::iter::once("crazyflie".to_owned()).chain(argv);
    py.detach(|| guarded(|| crazyflie_env::Result::Ok(crazyflie_cli::main_from(argv))))
}
