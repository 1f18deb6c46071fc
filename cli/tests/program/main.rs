//! The program `crazyflie`, run as a user runs it, in one program: it links once.

mod attacks;
#[cfg(feature = "bench")]
mod benchmark;
mod common;
#[cfg(feature = "bench")]
mod contest;
mod control;
mod diagnose;
#[cfg(feature = "bench")]
mod durability;
mod explain;
#[path = "../../../env/tests/simulator/fleet.rs"]
mod fleet;
mod flights;
mod identify;
mod inspect;
mod limits;
#[path = "../../../server/tests/network/net.rs"]
mod net;
mod process;
#[cfg(feature = "labs")]
mod recorded;
#[cfg(feature = "bench")]
mod remote_submit;
#[cfg(feature = "bench")]
mod season;
#[cfg(feature = "bench")]
#[path = "../../../bench/src/tests/spelled.rs"]
mod secrets;
mod security;
#[cfg(feature = "bench")]
mod tap;
#[cfg(feature = "bench")]
mod traffic;
mod turns;
mod usage;
mod worlds;
