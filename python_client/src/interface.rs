//! The meaning of an action.

use crazyflie_env::action::{self, ActionLevel, SetpointRange};
use crazyflie_env::model::VerticalInput;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::guarded;

/// The meaning of an action: the ranges that -1..1 is mapped to.
#[pyclass(frozen, module = "crazyflie_gym._native")]
pub struct Interface {
    pub inner: action::Interface,
    /// Seconds per step.
    #[pyo3(get)]
    pub tick_s: f64,
    /// Environments that a controller flies at once, see `VectorEnv::shard_envs`.
    pub shard_envs: usize,
}

#[pymethods]
impl Interface {
    /// Creates the interface from a server's description.
    #[new]
    #[allow(clippy::too_many_arguments, reason = "each is a key of what a server says")]
    #[pyo3(signature = (*, tick_s, vertical, tilt_max_rad, yaw_rate_max_radps, lift_max, hover_lift, yaw_sign, set_point = None))]
    fn new(
        tick_s: f64,
        vertical: &str,
        tilt_max_rad: f64,
        yaw_rate_max_radps: f64,
        lift_max: f64,
        hover_lift: f64,
        yaw_sign: f64,
        set_point: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let input = guarded(|| VerticalInput::named(vertical))?;
        Ok(Interface {
            inner: action::Interface {
                input,
                tilt_max_rad,
                yaw_rate_max_radps,
                lift_max,
                hover_lift,
                yaw_sign,
                set_point: set_point.map(set_point_range).transpose()?,
            },
            tick_s,
            shard_envs: usize::MAX,
        })
    }

    fn __repr__(&self) -> String {
        format!(
            "Interface(action={:?}, vertical={:?}, tick_s={})",
            self.action(),
            self.vertical(),
            self.tick_s
        )
    }

    /// Roll and pitch in rad, yaw rate in rad/s (in the vehicle's own sign) and height in metres or PWM that an
    /// action of attitudes commands. `ValueError` where actions set something else.
    fn command(&self, action: [f64; 4]) -> PyResult<(f64, f64, f64, f64)> {
        if self.inner.set_point.is_some() {
            return Err(PyValueError::new_err(format!(
                "an action of the level {} is no command",
                self.action()
            )));
        }
        let u = self.inner.command(&action);
        Ok((u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift))
    }
    /// The quantity that an action sets: a name of `crazyflie_gym.action_levels()`.
    #[getter]
    fn action(&self) -> &'static str {
        self.inner.level().name()
    }
    /// The values set by actions of -1 and of 1, for each of its four numbers, in the units of
    /// `crazyflie_gym.action_levels()`.
    #[getter]
    fn action_ranges(&self) -> Vec<(f64, f64)> {
        self.inner.ranges().map(|[low, high]| (low, high)).to_vec()
    }
    /// Which height input is commanded: "height", "pwm", "thrust" or "motors".
    #[getter]
    fn vertical(&self) -> &'static str {
        self.inner.input.name()
    }
    /// Roll and pitch of an action of 1, in radians.
    #[getter]
    fn tilt_max_rad(&self) -> f64 {
        self.inner.tilt_max_rad
    }
    /// Yaw rate of an action of 1, in the vehicle's own sign, in rad/s.
    #[getter]
    fn yaw_rate_max_radps(&self) -> f64 {
        self.inner.yaw_rate_max_radps
    }
    /// Height in metres, or PWM, of an action of 1; an action of -1 is zero.
    #[getter]
    fn lift_max(&self) -> f64 {
        self.inner.lift_max
    }
    /// The PWM that carries the weight; zero where the command is a height.
    #[getter]
    fn hover_lift(&self) -> f64 {
        self.inner.hover_lift
    }
    /// +1 or -1: the direction in which a positive yaw-rate command turns, right-handed.
    #[getter]
    fn yaw_sign(&self) -> f64 {
        self.inner.yaw_sign
    }
}

/// Reads a server's description: the level and its ranges.
fn set_point_range(of: &Bound<'_, PyDict>) -> PyResult<SetpointRange> {
    let item = |key: &str| {
        of.get_item(key)?
            .ok_or_else(|| PyValueError::new_err(format!("set_point: the key {key:?} is missing")))
    };
    let level: String = item("level")?.extract()?;
    let level = guarded(|| ActionLevel::named(&level))?;
    Ok(SetpointRange { level, ranges: item("ranges")?.extract()? })
}
