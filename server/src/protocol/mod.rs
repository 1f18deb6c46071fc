//! The messages, in JSON and in binary frames, written once for the server and its clients: `docs/protocol.md`
//! explains every field.

mod error;
pub(crate) mod fields;
pub mod frame;
mod numbers;
mod request;
mod response;
mod shared_world;

pub use error::{Code, ProtocolError};
pub use fields::Fields;
pub use numbers::{Numbers, Rows};
pub use request::{Actions, Hello, Make, Request, Reset, Resume, Step, request_kinds};
pub(crate) use request::{Message, parse};
pub use response::{EnvInfo, FinalRow, Response, ServerInfo, SessionInfo, StepResult};
pub use shared_world::{Fly, Join, SlotInfo, TickResult, WorldInfo, WorldRequest};

/// The name of this version of the protocol.
pub const PROTOCOL: &str = "crazyflie.v1";

/// The largest id: JSON numbers are exact up to here in every language.
pub(crate) const MAX_ID: u64 = (1 << 53) - 1;
