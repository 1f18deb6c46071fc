//! Simulated Crazyflies behind the protocol of real ones (CRTP): stock cflib scripts fly them unchanged.
//!
//! `packet -> board -> orders -> pilot -> fleet`: a board answers packets at once; orders wait for the next tick,
//! in which a pilot (filter, supervisor, planner, cascade) commands the simulator's own worlds. Nothing here is
//! taken from cflib or from the firmware: the protocol is public.

#![forbid(unsafe_code)]

mod board;
mod estimator;
mod fleet;
#[cfg(any(test, fuzzing))]
pub mod fuzzed;
mod high_level;
mod line;
mod log_blocks;
mod logs;
mod order;
mod packet;
mod params;
mod pilot;
mod polynomial;
mod server;
mod setpoint;
mod simulation;
mod supervisor;
mod tcp;
mod telemetry;
mod toc;
mod trajectory_memory;
mod udp;
mod values;

pub use line::LinkQuality;
pub use logs::{LOGS, LogVariable};
pub use packet::{MAX_DATA, Packet};
pub use params::{PARAMS, Param, deck};
pub use pilot::PositionSource;
pub use server::{Address, Error, Pace, Server, Settings};
pub use simulation::{Moment, TICK_HZ, Watcher};
pub use values::Kind;
