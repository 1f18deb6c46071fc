//! Pictures of a flight.

use crazyflie_picture as draw;
use numpy::{PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{input, shape_of, shaped};
use crate::errors::{Failure, guarded};

/// Rows of an array of `N` columns.
fn rows<const N: usize>(what: &str, object: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<[f32; N]>> {
    let Some(object) = object else { return Ok(Vec::new()) };
    let count = shape_of(object).first().copied().unwrap_or(0);
    let array = input::<f32>(what, &[count, N], object)?;
    Ok(array.as_slice()?.as_chunks::<N>().0.to_vec())
}

/// A line for each drone: (n, 3) for a single one, or (lines, n, 3).
fn lines(what: &str, object: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Vec<[f32; 3]>>> {
    let shape = object.map(shape_of);
    let (Some(object), Some([count, points, _])) = (object, shape.as_deref()) else {
        return Ok(object.map(|object| rows::<3>(what, Some(object))).transpose()?.into_iter().collect());
    };
    let array = input::<f32>(what, &[*count, *points, 3], object)?;
    let all = array.as_slice()?.as_chunks::<3>().0;
    Ok(if *points == 0 { Vec::new() } else { all.chunks(*points).map(<[_]>::to_vec).collect() })
}

fn point(what: &str, object: Option<&Bound<'_, PyAny>>) -> PyResult<Option<[f32; 3]>> {
    let Some(object) = object else { return Ok(None) };
    let array = input::<f32>(what, &[3], object)?;
    Ok(array.as_slice()?.first_chunk().copied())
}

/// A picture as a new uint8 array (height, width, 3). All lengths in metres, angles in radians, arrays
/// float32: `drones` (n, 6) with position and roll, pitch, yaw; `trail` (n, 3), or (drones, n, 3); `path` (n,
/// 3); `markers` (n, 3) with x, y, yaw; `setpoint` (3,) or (n, 3); `fix` (3,). The camera's view is drawn
/// where `camera_fov_rad`, the angle over the picture's diagonal, is given.
#[pyfunction]
#[pyo3(signature = (width, height, *, drones = None, trail = None, setpoint = None, path = None, markers = None, marker_side_m = 0.197, fix = None, camera_fov_rad = None))]
#[allow(clippy::too_many_arguments)]
pub fn render<'py>(
    py: Python<'py>,
    width: i64,
    height: i64,
    drones: Option<&Bound<'py, PyAny>>,
    trail: Option<&Bound<'py, PyAny>>,
    setpoint: Option<&Bound<'py, PyAny>>,
    path: Option<&Bound<'py, PyAny>>,
    markers: Option<&Bound<'py, PyAny>>,
    marker_side_m: f32,
    fix: Option<&Bound<'py, PyAny>>,
    camera_fov_rad: Option<f32>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    for (name, side) in [("width", width), ("height", height)] {
        if !(1..=8192).contains(&side) {
            return Err(PyValueError::new_err(format!("{name} is {side}, expected 1 to 8192 pixels")));
        }
    }
    let colors = draw::PALETTE.iter().cycle();
    let drones: Vec<draw::Drone> = rows::<6>("drones", drones)?
        .into_iter()
        .zip(colors)
        .map(|([x, y, z, roll_rad, pitch_rad, yaw_rad], color)| draw::Drone {
            pos_m: [x, y, z],
            roll_rad,
            pitch_rad,
            yaw_rad,
            color: *color,
        })
        .collect();
    let markers: Vec<draw::Marker> = rows::<3>("markers", markers)?
        .into_iter()
        .map(|[x_m, y_m, yaw_rad]| draw::Marker { x_m, y_m, yaw_rad, side_m: marker_side_m })
        .collect();
    let (trails, path) = (lines("trail", trail)?, rows::<3>("path", path)?);
    let trails: Vec<&[_]> = trails.iter().map(Vec::as_slice).collect();
    let single = setpoint.is_some_and(|object| shape_of(object).len() == 1);
    let setpoints = if single {
        point("setpoint", setpoint)?.into_iter().collect()
    } else {
        rows::<3>("setpoint", setpoint)?
    };
    let fix_m = point("fix", fix)?;
    let picture = PyArray3::<u8>::zeros(py, [height as usize, width as usize, 3], false);
    let mut pixels = picture.try_readwrite()?;
    let out = pixels.as_slice_mut()?;
    py.detach(|| {
        let scene = draw::Scene {
            drones: &drones,
            trails_m: &trails,
            setpoints_m: &setpoints,
            path_m: &path,
            markers: &markers,
            fix_m,
            camera_fov_rad,
        };
        guarded(|| draw::render(&scene, width as u32, height as u32, out))
    })?;
    drop(pixels);
    Ok(picture)
}

/// A picture (uint8, height x width x 3) as text for a terminal with 24-bit colour, at most `columns`
/// characters wide.
#[pyfunction]
#[pyo3(signature = (picture, columns = 80))]
pub fn ansi(picture: &Bound<'_, PyAny>, columns: i64) -> PyResult<String> {
    let columns = usize::try_from(columns)
        .map_err(|_| PyValueError::new_err(format!("columns is {columns}, expected at least 1")))?;
    let (height, width) = match shape_of(picture)[..] {
        [height, width, _] => (height, width),
        _ => (0, 0),
    };
    let pixels = input::<u8>("picture", &[height, width, 3], picture)?;
    let pixels = pixels.as_slice()?;
    guarded(|| draw::ansi(pixels, width, height, columns))
}

/// The path of a task's set-point in the first `ticks` steps of `tick_s` seconds, (n, 3) float32; no rows if it does
/// not move or differs from episode to episode. `options` is JSON.
#[pyfunction]
pub fn path<'py>(
    py: Python<'py>,
    task: &str,
    options: &str,
    tick_s: f64,
    ticks: u32,
) -> PyResult<Bound<'py, PyAny>> {
    let points = guarded(|| -> Result<_, Failure> {
        let options = serde_json::from_str(options)
            .map_err(|error| Failure::Argument(format!("task_options: {error}")))?;
        Ok(crazyflie_env::task::path(task, &options, tick_s, ticks)?)
    })?;
    shaped(py, points.as_flattened(), &[points.len(), 3])
}

/// The set-points of a task of one drone, or of one of several drones (`drone`: its place and their number), in the first `ticks` steps of `tick_s` seconds, as x, y, z in metres and
/// yaw in rad; `seed` decides what the task draws. `options` is JSON. `ValueError` where they depend on the flight.
#[pyfunction]
#[pyo3(signature = (task, options, tick_s, ticks, seed = 0, drone = None))]
pub fn setpoints(
    task: &str,
    options: &str,
    tick_s: f64,
    ticks: u32,
    seed: u64,
    drone: Option<(usize, usize)>,
) -> PyResult<Vec<(f64, f64, f64, f64)>> {
    let rows = guarded(|| -> Result<_, Failure> {
        let options = serde_json::from_str(options)
            .map_err(|error| Failure::Argument(format!("task_options: {error}")))?;
        Ok(crazyflie_env::task::setpoints(task, &options, tick_s, ticks, seed, drone)?)
    })?;
    Ok(rows.into_iter().map(Into::into).collect())
}
