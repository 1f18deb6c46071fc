//! The program `crazyflie`. The binary and the Python package both call [`main_from`].

#![forbid(unsafe_code)]

mod commands;
mod diagnosis;
mod explanation;
mod failure;
mod loop_plots;
mod measured;
mod recovery;
mod remote_submit;
mod robustness;
mod scorecard;
mod text;
mod trims;
mod tune;

pub use commands::{DeployFailure, Deployer, main_from, set_deployer};
pub use loop_plots::{loop_picture, loop_reports, vertical_form};
