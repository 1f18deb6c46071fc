//! Measures how well a model fits flight logs, and what it lacks.
//!
//! [`metrics`] compares a measured signal with a model's.
#![forbid(unsafe_code)]

pub mod axis_errors;
pub mod case;
pub mod closed_loop;
pub mod diagnose;
mod error;
pub mod estimate;
pub mod explain;
pub mod fit;
pub mod lift;
pub mod metrics;
pub mod motor;
pub mod replay;
pub mod transfer;
pub mod vehicle;

pub use crazyflie_logs::{FlightLog, LogError, Note, ReadOptions};
pub use error::{Error, Result};

/// A flight log and its name.
pub type NamedLog = (String, FlightLog);
