//! The network server: environments over WebSocket, pages and metrics over HTTP, on one port.
//! `docs/protocol.md` is its contract.

mod batch_session;
mod budget;
mod connection;
mod create_session;
mod echo;
mod extension;
mod feed;
mod flown;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzzed;
mod http;
mod live;
mod metrics;
mod openenv;
mod page;
mod pilot;
mod replies;
mod server;
mod session;
mod session_registry;
mod session_requests;
mod settings;
mod showcase;
mod shown;
mod socket;
mod turns;
mod upgrade;
mod wire;
mod world;
mod worlds;

pub use extension::{Batch, Begun, Extension};
pub use http::{TaggedBody, as_attachment, error_response};
pub use replies::Reply;
pub use session_registry::SessionEnd;
pub use showcase::eight_drones;

pub use server::{Report, Service};
pub use settings::{Limits, ServeError, Settings, Shares, tls};
pub use shown::{DroneView, FleetView};
