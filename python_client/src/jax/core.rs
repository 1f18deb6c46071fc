//! A step of the core as a function that XLA calls itself, without Python.

use std::collections::HashMap;
use std::ffi::{CString, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::null_mut;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, Weak};

use crazyflie_env::config::Options;
use crazyflie_env::vector::{StepBuffers, VectorEnv};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use super::xla::{self, Buffer, CallFrame};
use crate::errors::guarded;
use crate::sim::{checked_envs, parse_models};

/// A batch that XLA steps, with room for what is not returned.
struct Batch {
    env: VectorEnv,
    flying: Vec<bool>,
    metrics: Vec<f32>,
}

type Shared = Mutex<Batch>;

/// The batches that live, by handle.
static BATCHES: LazyLock<Mutex<HashMap<i64, Weak<Shared>>>> = LazyLock::new(Mutex::default);
static NEXT: AtomicI64 = AtomicI64::new(1);

/// A batch of environments that compiled JAX programs step; see `crazyflie_gym.jax.make_core`.
#[pyclass(module = "crazyflie_gym._native", frozen)]
pub struct JaxCore {
    batch: Arc<Shared>,
    #[pyo3(get)]
    handle: i64,
    #[pyo3(get)]
    num_envs: usize,
    #[pyo3(get)]
    num_drones: usize,
    #[pyo3(get)]
    width: usize,
    #[pyo3(get)]
    has_drone_axis: bool,
    #[pyo3(get)]
    tick_s: f64,
}

#[pymethods]
impl JaxCore {
    #[new]
    fn new(py: Python<'_>, num_envs: i64, options: &str, models: Vec<String>) -> PyResult<Self> {
        let num_envs = checked_envs(num_envs)?;
        let env = py.detach(|| {
            guarded(|| VectorEnv::new(&parse_models(&models)?, &Options::parse(options)?, num_envs))
        })?;
        let (drones, width, tick_s) = (env.num_drones(), env.width(), env.tick_s());
        let (metrics, handle) = (env.num_metrics(), NEXT.fetch_add(1, Ordering::Relaxed));
        let rows = num_envs * drones;
        let batch = Arc::new(Mutex::new(Batch {
            env,
            flying: vec![true; if metrics == 0 { 0 } else { rows }],
            metrics: vec![0.0; num_envs * metrics],
        }));
        let mut all = BATCHES.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|_, batch| batch.strong_count() > 0);
        all.insert(handle, Arc::downgrade(&batch));
        drop(all);
        Ok(JaxCore {
            batch,
            handle,
            num_envs,
            num_drones: drones,
            width,
            has_drone_axis: metrics > 0,
            tick_s,
        })
    }

    /// Begin an episode of each seed; the observations, flat.
    fn reset<'py>(&self, py: Python<'py>, seeds: Vec<u64>) -> PyResult<Bound<'py, numpy::PyArray1<f32>>> {
        let mut rows = vec![0.0; self.num_envs * self.num_drones * self.width];
        py.detach(|| {
            guarded(|| {
                let mut batch = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
                batch.flying.fill(true);
                batch.env.reset(Some(&seeds), None, &mut rows)
            })
        })?;
        Ok(numpy::PyArray1::from_vec(py, rows))
    }
}

/// The function of a step, for `jax.ffi.register_ffi_target`.
#[pyfunction]
#[allow(unsafe_code)]
pub fn jax_step_target(py: Python<'_>) -> PyResult<Bound<'_, PyCapsule>> {
    let handler: unsafe extern "C" fn(*mut CallFrame) -> *mut c_void = step;
    let pointer = std::ptr::NonNull::new(handler as *mut c_void)
        .ok_or_else(|| PyValueError::new_err("a function without an address"))?;
    // SAFETY: the address of a function is good for as long as the module is loaded, which is for ever
    unsafe { PyCapsule::new_with_pointer(py, pointer, c"xla._CUSTOM_CALL_TARGET") }
}

/// Handles the calls of XLA: the request for the version, then every step. Returns null, or an error of XLA's.
///
/// # Safety
/// `frame` is a call frame of XLA's as its header lays it out.
#[allow(unsafe_code)]
unsafe extern "C" fn step(frame: *mut CallFrame) -> *mut c_void {
    // a panic must not pass into XLA
    // SAFETY: the caller's promise
    let done = catch_unwind(AssertUnwindSafe(|| unsafe { answer(&mut *frame) }));
    let text = match done {
        Ok(Ok(())) => return null_mut(),
        Ok(Err(text)) => text,
        Err(_) => "a bug in crazyflie_gym, please report it".to_owned(),
    };
    let message = CString::new(text.replace('\0', " ")).unwrap_or_default();
    let mut error = xla::ErrorCreate {
        struct_size: size_of::<xla::ErrorCreate>(),
        extension_start: null_mut(),
        message: message.as_ptr(),
        code: xla::INVALID_ARGUMENT,
    };
    // SAFETY: the table of functions is XLA's own, and it copies the message
    unsafe { ((*(*frame).api).create_error)(&raw mut error) }
}

/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn answer(frame: &mut CallFrame) -> Result<(), String> {
    let asked = frame.extension_start.cast::<xla::MetadataExtension>();
    // SAFETY: XLA asks so while it registers: the first extension is then the one for metadata
    if !asked.is_null() && unsafe { (*asked).base.kind } == xla::METADATA {
        // SAFETY: it points to room for the answer
        let version = unsafe { &mut (*(*asked).metadata).api_version };
        (version.major, version.minor) = (xla::MAJOR, xla::MINOR);
        return Ok(());
    }
    if frame.stage != xla::EXECUTE {
        return Ok(());
    }
    // SAFETY: the caller's promise
    let handle = unsafe { handle(&frame.attributes) }.ok_or("expected the attribute handle, an int64")?;
    let batch = BATCHES.lock().unwrap_or_else(PoisonError::into_inner).get(&handle).and_then(Weak::upgrade);
    let batch = batch.ok_or("the batch of environments is gone: keep what make_core returned")?;
    let mut batch = batch.lock().unwrap_or_else(PoisonError::into_inner);
    // SAFETY: the caller's promise
    unsafe { step_batch(&mut batch, &frame.arguments, &frame.results) }
}

/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn handle(attributes: &xla::Attributes) -> Option<i64> {
    // SAFETY: XLA promises `size` entries of each
    unsafe {
        if attributes.size != 1 || *attributes.kinds != xla::SCALAR {
            return None;
        }
        let scalar = &**attributes.values;
        (scalar.dtype == xla::S64).then(|| *scalar.value.cast::<i64>())
    }
}

/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn step_batch(
    batch: &mut Batch,
    arguments: &xla::Buffers,
    results: &xla::Buffers,
) -> Result<(), String> {
    let Batch { env, flying, metrics } = batch;
    let rows = env.num_envs() * env.num_drones();
    let numbers = rows * env.width();
    // SAFETY: XLA promises that inputs are there, and room for outputs, for as long as the call lasts; the sizes
    // are checked. Outputs are filled with zeros first, which are valid numbers and truth values.
    unsafe {
        let count = *input::<i32>(arguments, 0, xla::S32, 1)?;
        let actions = std::slice::from_raw_parts(input::<f32>(arguments, 1, xla::F32, rows * 4)?, rows * 4);
        let [next, observations, rewards, terminated, truncated] = [
            output(results, 0, xla::S32, 1)?,
            output(results, 1, xla::F32, numbers)?,
            output(results, 2, xla::F32, rows)?,
            output(results, 3, xla::PRED, rows)?,
            output(results, 4, xla::PRED, rows)?,
        ];
        *next.cast::<i32>() = count.wrapping_add(1);
        let out = StepBuffers {
            observations: std::slice::from_raw_parts_mut(observations.cast::<f32>(), numbers),
            rewards: std::slice::from_raw_parts_mut(rewards.cast::<f32>(), rows),
            terminated: std::slice::from_raw_parts_mut(terminated.cast::<bool>(), rows),
            truncated: std::slice::from_raw_parts_mut(truncated.cast::<bool>(), rows),
            flying,
            metrics,
        };
        env.step(actions, out).map_err(|error| error.to_string())
    }
}

/// An argument, or a result, of this type and size.
///
/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn buffer(buffers: &xla::Buffers, place: i64, dtype: c_int, len: usize) -> Result<&Buffer, String> {
    // SAFETY: XLA promises `size` entries
    let buffer = (place < buffers.size).then(|| unsafe { &**buffers.buffers.add(place as usize) });
    let buffer = buffer.ok_or_else(|| format!("buffer {place} is missing"))?;
    // SAFETY: the caller's promise
    let length = unsafe { buffer.len() };
    if (buffer.dtype, length) != (dtype, len) {
        return Err(format!(
            "buffer {place}: expected {len} numbers of XLA's type {dtype}, got {length} of type {}",
            buffer.dtype
        ));
    }
    Ok(buffer)
}

/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn input<T>(buffers: &xla::Buffers, place: i64, dtype: c_int, len: usize) -> Result<*const T, String> {
    // SAFETY: the caller's promise
    Ok(unsafe { buffer(buffers, place, dtype, len) }?.data.cast())
}

/// # Safety
/// The same conditions as [`step`].
#[allow(unsafe_code)]
unsafe fn output(
    buffers: &xla::Buffers,
    place: i64,
    dtype: c_int,
    len: usize,
) -> Result<*mut c_void, String> {
    let width = if dtype == xla::PRED { 1 } else { 4 };
    // SAFETY: the caller's promise; there is room for `len` numbers of this width
    unsafe {
        let data = buffer(buffers, place, dtype, len)?.data;
        std::ptr::write_bytes(data.cast::<u8>(), 0, len * width);
        Ok(data)
    }
}
