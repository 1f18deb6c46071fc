//! The command line of the simulator. The bin and the Python package both call [`main_from`].
#![forbid(unsafe_code)]

#[allow(dead_code, reason = "the network server will call what the command line does not")]
mod bench;
mod cli;
mod explained;
mod flight;
mod frames;
mod measured;
mod recovery;
mod score;
mod scorecard;
pub mod serve;

pub use cli::main_from;
