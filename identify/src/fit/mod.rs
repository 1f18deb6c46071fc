//! Fitting the simulator to flights.

pub(crate) mod clock;
mod derivative_pass;
pub mod filter;
pub mod flight;
pub(crate) mod heteroscedastic;
pub(crate) mod huber;
pub mod hypothesis;
mod kalman;
pub mod likelihood_slopes;
mod matrix;
pub mod output_error;
pub(crate) mod packet_loss_moments;
pub mod predict;
pub mod solve;
