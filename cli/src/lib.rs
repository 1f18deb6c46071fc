//! The program `crazyflie`. The binary and the Python package both call [`main_from`].

#![forbid(unsafe_code)]

mod commands;
mod diagnosis;
mod explanation;
mod failure;
mod loop_plots;
mod text;
mod trims;

pub use commands::main_from;
#[cfg(feature = "crazyflies")]
pub use commands::{Deployer, set_deployer};
pub use failure::Failure;
pub use loop_plots::{loop_picture, loop_reports, vertical_form};
