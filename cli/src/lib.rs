//! The program `crazyflie`. The binary and the Python package both call [`main_from`].
#![forbid(unsafe_code)]

mod afar;
mod commands;
mod diagnosis;
mod explained;
mod failure;
mod measured;
mod recovery;
mod robustness;
mod score;
mod scorecard;
mod text;
mod trims;
mod tune;

pub use commands::main_from;
