//! The program `crazyflie`, run as a user runs it, in one program: it links once.

mod attacks;
mod benchmark;
mod common;
mod contest;
mod control;
mod diagnose;
mod durability;
mod explain;
#[path = "../../../env/tests/simulator/fleet.rs"]
mod fleet;
mod flights;
mod identify;
mod inspect;
mod limits;
mod measured;
#[path = "../../../server/tests/network/net.rs"]
mod net;
mod process;
mod recorded;
mod remote_submit;
mod scorecard;
mod season;
#[path = "../../../server/tests/network/secrets.rs"]
mod secrets;
mod security;
mod tap;
mod traffic;
mod usage;
mod worlds;
