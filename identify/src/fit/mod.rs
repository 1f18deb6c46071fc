//! Fitting the simulator to flights.

pub mod filter;
pub mod flight;
pub mod heteroscedastic;
pub mod hypothesis;
pub mod packet_loss_moments;
pub mod predict;
pub mod solve;
