//! Reads Crazyflie flight logs and measures how well a model fits them.
//!
//! [`FlightLog`] is the one shape every later step reads, whatever file the flight came from: SI units and
//! radians, a right-handed frame with z up, +pitch accelerating to +x and +roll to -y.
//! [`metrics`] compares a measured signal with a model's.
#![forbid(unsafe_code)]

pub mod axis_errors;
pub mod case;
pub mod closed_loop;
pub mod estimate;
pub mod explain;
pub mod fit;
pub mod hover;
pub mod log;
pub mod metrics;
pub mod replay;
pub mod statistics;
pub mod transfer;
pub mod vehicle;

pub use log::{FlightLog, LogError, Note};
