//! Flight logs: one structure, many file formats.
//!
//! [`FlightLog`] is the one shape every later step reads, whatever file the flight came from: SI units and radians, a
//! right-handed frame with z up, +pitch accelerating to +x and +roll to -y. [`readers`] lists the formats; callers
//! query a log for facts ([`Provenance`], its channels), never for its format.
#![forbid(unsafe_code)]

mod align;
mod attitude;
mod bytes;
mod cells;
mod channels;
mod clock;
mod columns;
pub mod draft;
mod error;
mod firmware;
mod flight;
mod formats;
mod front;
pub mod inspect;
mod join;
mod long_form;
mod mapping;
mod marker;
mod mcap_write;
mod message;
mod names;
mod note;
mod npz;
mod pairs;
mod provenance;
mod quantity;
mod reader;
mod ros;
mod same;
mod samples;
mod scale;
mod series;
mod signal;
mod skew;
pub mod spectrum;
mod table;
mod text;
mod times;
mod topics;
mod usd;
mod variables;
mod write;

use error::Result;
pub use error::{LogError, MissingColumn};
pub use flight::{Fixes, FlightLog, Onboard, Truth};
pub use formats::readers;
pub use mapping::Mapping;
pub use note::Note;
pub use provenance::{AttitudeSource, PositionSource, Provenance};
pub use reader::{Content, ReadOptions, Reader};
pub use same::first_duplicate;
pub use series::Columns;
pub use variables::variables_markdown;

/// Standard gravity.
const G_MPS2: f64 = 9.80665;
