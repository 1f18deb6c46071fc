//! The command line of the simulator. The bin and the Python package both call [`main_from`].
#![forbid(unsafe_code)]

mod afar;
mod bench;
mod cli;
pub mod dial;
mod explained;
mod flight;
mod frames;
#[cfg(any(test, fuzzing))]
pub mod fuzzed;
mod link;
mod measured;
mod recovery;
mod robustness;
mod score;
mod scorecard;
pub mod serve;
mod tune;
mod worlds;

pub use cli::main_from;
