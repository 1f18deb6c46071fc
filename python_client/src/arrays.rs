//! Borrowing NumPy arrays: the dtype, the shape and the layout are checked, and an error names what was expected.

use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArrayDyn,
};
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyTuple;

/// A shape as Python prints it.
fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

fn dtype_name<T: Element>(py: Python<'_>) -> String {
    numpy::dtype::<T>(py).typeobj().name().map_or_else(|_| "another dtype".into(), |name| name.to_string())
}

#[cold]
fn wrong_type<T: Element>(what: &str, shape: &[usize], got: &Bound<'_, PyAny>) -> PyErr {
    let actual = match got.cast::<PyUntypedArray>() {
        Ok(array) => format!("dtype {}", array.dtype()),
        Err(_) => got.get_type().name().map_or_else(|_| "another type".into(), |name| name.to_string()),
    };
    PyTypeError::new_err(format!(
        "{what}: expected a numpy array of {} with shape {}, got {actual}",
        dtype_name::<T>(got.py()),
        tuple(shape)
    ))
}

fn check_shape<'a, 'py, T: Element>(
    what: &str,
    shape: &[usize],
    object: &'a Bound<'py, PyAny>,
) -> PyResult<&'a Bound<'py, PyArrayDyn<T>>> {
    let Ok(array) = object.cast::<PyArrayDyn<T>>() else { return Err(wrong_type::<T>(what, shape, object)) };
    if array.shape() != shape {
        return Err(PyValueError::new_err(format!(
            "{what}: expected shape {}, got {}",
            tuple(shape),
            tuple(array.shape())
        )));
    }
    if !array.is_c_contiguous() {
        let hint =
            "expected a C-contiguous array, got one with other strides; numpy.ascontiguousarray makes one";
        return Err(PyValueError::new_err(format!("{what}: {hint}")));
    }
    if !array.is_aligned() {
        return Err(PyValueError::new_err(format!(
            "{what}: expected an aligned array, got one that is not; numpy.copy makes one"
        )));
    }
    Ok(array)
}

/// An array to read.
///
/// # Errors
/// `TypeError` for another type or dtype, `ValueError` for another shape or layout, or while it is being
/// written to.
pub fn input<'py, T: Element>(
    what: &str,
    shape: &[usize],
    object: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let array = check_shape::<T>(what, shape, object)?;
    array.try_readonly().map_err(|e| PyValueError::new_err(format!("{what}: {e}")))
}

/// An array of float64 as one of float32, and anything else as it is.
///
/// # Errors
/// The errors of NumPy.
pub fn narrowed<'py>(object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    match object.cast::<PyArrayDyn<f64>>() {
        Ok(array) => array.call_method1("astype", (numpy::dtype::<f32>(object.py()),)),
        Err(_) => Ok(object.clone()),
    }
}

/// An array to write.
///
/// # Errors
/// The errors of [`input`]; also one if it is read-only or passed twice.
pub fn output<'py, T: Element>(
    what: &str,
    shape: &[usize],
    object: &Bound<'py, PyAny>,
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    let array = check_shape::<T>(what, shape, object)?;
    array.try_readwrite().map_err(|e| PyValueError::new_err(format!("{what}: {e}")))
}

/// A mask as a list. NumPy lets the bytes of a bool array be other than 0 and 1, which a Rust `bool` must not
/// be.
///
/// # Errors
/// The errors of [`input`].
pub fn mask(what: &str, shape: &[usize], object: &Bound<'_, PyAny>) -> PyResult<Vec<bool>> {
    let bytes = check_shape::<bool>(what, shape, object)?.call_method1("view", ("uint8",))?;
    Ok(input::<u8>(what, shape, &bytes)?.as_slice()?.iter().map(|byte| *byte != 0).collect())
}

/// A new array whose content is not set yet: `numpy.empty`, which unlike zeros costs no pass over the memory.
///
/// # Errors
/// The exceptions of NumPy.
pub fn empty<'py, T: Element>(
    py: Python<'py>,
    shape: impl IntoPyObject<'py, Target = PyTuple>,
) -> PyResult<Bound<'py, PyAny>> {
    static EMPTY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    EMPTY.import(py, "numpy", "empty")?.call1((shape, numpy::dtype::<T>(py)))
}

/// A copy as a new array of this shape.
///
/// # Errors
/// `ValueError` for numbers that do not fill the shape.
pub fn shaped<'py, T: Element + Copy>(
    py: Python<'py>,
    values: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_slice(py, values).reshape(shape)?.into_any())
}

/// The shape of an array; nothing for anything else.
pub fn shape_of(object: &Bound<'_, PyAny>) -> Vec<usize> {
    object.cast::<PyUntypedArray>().map_or(Vec::new(), |array| array.shape().to_vec())
}
