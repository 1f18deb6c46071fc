//! The loops of the PID on paper: loop gain, margins, closed-loop poles and step response, each with the dead
//! time of the rig.

mod frequency;
mod margins;
mod report;
mod root_locus;
mod step_response;

use crazyflie_env::error::{Result, find_named};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::transfer_function::{Channel, TransferFunction};
use nalgebra::Complex;

use crate::pid::{Gains, Loop};

pub use frequency::FrequencyResponse;
pub use margins::Margins;
pub use report::{LoopReport, RootLocus};
pub use root_locus::roots;
pub use step_response::{StepFigures, StepResponse};

/// A loop of the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LoopAxis {
    /// The error along x commands a pitch.
    X,
    /// The error along y commands a roll.
    Y,
    /// The error of the height commands a thrust.
    Z,
    /// The error of the heading commands a yaw rate.
    Yaw,
}

impl LoopAxis {
    /// The order in which they are tuned: each with the results of those before it.
    pub const ALL: [LoopAxis; 4] = [LoopAxis::Yaw, LoopAxis::Z, LoopAxis::X, LoopAxis::Y];

    /// The loop of that name.
    ///
    /// # Errors
    /// With a proposal, if there is none.
    pub fn find(name: &str) -> Result<LoopAxis> {
        find_named("loop", name, LoopAxis::ALL, |axis| axis.name())
    }

    /// Returns the channel that the loop controls.
    pub fn channel(self) -> Channel {
        match self {
            LoopAxis::X => Channel::X,
            LoopAxis::Y => Channel::Y,
            LoopAxis::Z => Channel::Z,
            LoopAxis::Yaw => Channel::Yaw,
        }
    }

    /// Name for users, and in files of gains.
    pub fn name(self) -> &'static str {
        self.channel().name()
    }

    /// Its gains in a table.
    pub fn gains(self, all: &Gains) -> &Loop {
        match self {
            LoopAxis::X => &all.x,
            LoopAxis::Y => &all.y,
            LoopAxis::Z => &all.z,
            LoopAxis::Yaw => &all.yaw,
        }
    }

    /// A table with another loop in its place.
    #[must_use]
    pub fn with_gains(self, all: &Gains, new: Loop) -> Gains {
        match self {
            LoopAxis::X => Gains { x: new, ..*all },
            LoopAxis::Y => Gains { y: new, ..*all },
            LoopAxis::Z => Gains { z: new, ..*all },
            LoopAxis::Yaw => Gains { yaw: new, ..*all },
        }
    }
}

/// Returns the dead time of the position loops: latency of the camera, and the mean age of a frame and of a command;
/// without a camera a command's alone.
pub fn dead_time_s(model: &Model, camera_latency_s: Option<f64>) -> f64 {
    let camera_s = camera_latency_s.map_or(0.0, |latency_s| latency_s + 0.5 / model.rig.camera.value);
    camera_s + 0.5 / model.rig.control.value
}

/// One loop: (kp + ki / s + kd s) P(s) exp(-s dead time).
#[derive(Debug, Clone)]
pub struct FeedbackLoop {
    /// From the controller's output (degrees, PWM counts or deg/s) to what is measured (metres or radians),
    /// with the sign that the controller applies.
    pub plant: TransferFunction,
    /// Gains of the PID.
    pub gains: Loop,
    /// From sensing to the command in force, in seconds.
    pub dead_time_s: f64,
}

impl FeedbackLoop {
    /// The loop of an axis around a model.
    ///
    /// # Errors
    /// For a model that lacks the vertical form.
    pub fn from_model(
        model: &Model,
        input: VerticalInput,
        axis: LoopAxis,
        gains: &Gains,
        dead_time_s: f64,
    ) -> Result<FeedbackLoop> {
        let plant = model.transfer_function(axis.channel(), input)?;
        // the controller knows the vehicle's signs, and gives angles in degrees
        let sign = plant.numerator[0].signum();
        let unit = if axis == LoopAxis::Z { 1.0 } else { 1.0_f64.to_radians() };
        Ok(FeedbackLoop { plant: plant.scaled(sign * unit), gains: *axis.gains(gains), dead_time_s })
    }

    /// The PID as a transfer function: (kd s^2 + kp s + ki) / s.
    pub fn controller(&self) -> TransferFunction {
        let Loop { kp, ki, kd, .. } = self.gains;
        TransferFunction { numerator: vec![kd, kp, ki], denominator: vec![1.0, 0.0] }
    }

    /// Controller and plant, without the dead time.
    pub fn open(&self) -> TransferFunction {
        self.controller().in_series(&self.plant)
    }

    /// Loop gain at a frequency in rad/s, with the dead time.
    pub fn gain_at(&self, omega_radps: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega_radps);
        self.open().response_at(s) * (-s * self.dead_time_s).exp()
    }
}
