//! Pictures of a flight, without a display server and without fonts.
//!
//! - [`render`] draws a [`Scene`] (drones, marker, trail, setpoint, camera cone) into an RGB buffer,
//! - [`chart()`] and [`path3d()`] write SVG documents, which [`Format`] turns into files,
//! - [`ansi()`] turns such a buffer into text for a terminal.

#![forbid(unsafe_code)]

mod ansi;
mod axis;
mod chart;
mod draw;
mod drawing;
mod error;
mod floor;
mod format;
mod legend;
mod panel;
mod path3d;
mod props;
mod render;
mod scale;
mod scene;
mod sheet;
mod thin;
mod vector;
mod vehicle;
mod view;

pub use ansi::ansi;
pub use chart::chart;
pub use error::PictureError;
pub use format::Format;
pub use panel::{Band, HLine, Panel, Series};
pub use path3d::{Path3, path3d, scene3d};
pub use render::render;
pub use scale::Scale;
pub use scene::{Drone, Marker, Scene};
pub use sheet::{PALETTE, Style};
pub use view::View;
