//! Inputs of the pilot: orders of packets, and settings of parameters.

use crazyflie_env::action::CascadeGains;

use crate::estimator::FilterNoise;
use crate::high_level::HighLevelCommand;
use crate::params::ParamValues;
use crate::setpoint::{AttitudeSetpoint, Setpoint};
use crate::supervisor::SupervisorLimits;

/// A request of a packet to the drone.
#[derive(Debug, Clone)]
pub(crate) enum Order {
    Attitude(AttitudeSetpoint),
    /// The set-point of [`Order::Attitude`], with a right-handed yaw rate and no thrust lock.
    Manual(AttitudeSetpoint),
    Fly(Setpoint),
    Stop,
    /// Set-points end: what the high-level commander plans counts again. The last one stays in force for so long.
    Relax {
        remains_s: f64,
    },
    HighLevel(HighLevelCommand),
    Arm(bool),
    Recover,
    Emergency,
    EmergencyWatchdog,
    Position([f64; 3]),
    Pose {
        pos_m: [f64; 3],
        yaw_rad: f64,
    },
    ResetEstimator,
    Restart,
}

impl Order {
    /// Returns whether the next one of its kind compensates its loss.
    pub(crate) fn is_streamed(&self) -> bool {
        use Order::{Attitude, Fly, Manual, Pose, Position, Stop};
        matches!(self, Attitude(_) | Manual(_) | Fly(_) | Stop | Position(_) | Pose { .. })
    }
}

/// The pilot's settings by parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PilotSettings {
    pub gains: CascadeGains,
    pub high_level: bool,
    /// Mean speeds of take-offs and landings.
    pub speeds_mps: [f64; 2],
    pub limits: SupervisorLimits,
    pub noise: FilterNoise,
    /// Standard deviations that the filter gives places and headings from outside.
    pub extpos_m: f64,
    pub extquat_rad: f64,
    /// Position of the filter after a reset.
    pub start_m: [f64; 3],
    pub start_yaw_rad: f64,
}

impl PilotSettings {
    pub(crate) fn new(params: &ParamValues) -> Self {
        // a client may write NaN, or a value that no filter can use
        let positive = |name: &str| {
            let value = params.get(name);
            if value.is_finite() { value.clamp(1e-4, 1e3) } else { 1.0 }
        };
        let finite = |name: &str| Some(params.get(name)).filter(|value| value.is_finite()).unwrap_or(0.0);
        PilotSettings {
            gains: params.gains(),
            high_level: params.get("commander.enHighLevel") != 0.0,
            speeds_mps: [positive("hlCommander.vtoff"), positive("hlCommander.vland")],
            limits: SupervisorLimits {
                low_v: params.get("pm.lowVoltage"),
                empty_v: params.get("pm.criticalLowVoltage"),
                tumble: params.get("supervisor.tmblChckEn") != 0.0,
            },
            noise: FilterNoise { acc_mps2: [positive("kalman.pNAcc_xy"), positive("kalman.pNAcc_z")] },
            extpos_m: positive("locSrv.extPosStdDev"),
            extquat_rad: positive("locSrv.extQuatStdDev"),
            start_m: ["kalman.initialX", "kalman.initialY", "kalman.initialZ"].map(finite),
            start_yaw_rad: finite("kalman.initialYaw"),
        }
    }
}
