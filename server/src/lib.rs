//! The server, and flights with a controller in the loop.

#![forbid(unsafe_code)]

pub mod client;
pub mod connect;
pub mod flight;
pub mod frames;
#[cfg(any(test, fuzzing))]
pub mod fuzzed;
mod log_replay;
pub mod protocol;
pub mod serve;
pub mod tune;
pub mod worlds;
