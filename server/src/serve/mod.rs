//! The network server: environments over WebSocket, and what it tells about itself over HTTP, on one port. `docs/protocol.md` is its contract.

mod board;
mod caps;
mod connection;
mod contest;
mod echo;
mod fault;
mod feed;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzzed;
mod http;
mod listed;
mod live;
mod make;
mod message;
mod metrics;
mod openenv;
mod page;
mod pilot;
mod replies;
mod requests;
mod server;
mod server_message;
mod session;
mod settings;
mod shared;
mod socket;
mod upgrade;
mod wire;
mod world;
mod worlds;

pub use listed::End;
pub(crate) use make::PROTOCOL;

/// The types of all requests in JSON, as a server names them.
pub fn request_kinds() -> impl Iterator<Item = &'static str> {
    message::REQUESTS.into_iter().map(|(kind, _)| kind)
}

pub use server::{Report, run};
pub use settings::{Limits, ServeError, Settings, tls};
