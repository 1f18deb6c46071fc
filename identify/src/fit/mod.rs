//! Fitting the simulator to flights.

pub mod filter;
pub mod flight;
pub mod held;
pub mod hypothesis;
pub mod predict;
pub mod solve;
pub mod spread;
