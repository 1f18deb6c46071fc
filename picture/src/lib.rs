//! Pictures of a flight, without a display server and without fonts.
//!
//! - [`render`] draws a [`Scene`] (drones, marker, trail, setpoint, camera cone) into an RGB buffer,
//! - [`chart()`] and [`path3d()`] make a [`Drawing`], which [`Format`] writes to files,
//! - [`Film`] has many such buffers and is written as GIF, WebP or MP4,
//! - [`Table`] sets results in columns, as text and as Markdown,
//! - [`ansi()`] turns such a buffer into text for a terminal.

#![forbid(unsafe_code)]

mod ansi;
mod axis;
mod chart;
mod color;
mod draw;
mod drawing;
mod error;
mod film;
mod floor;
mod font;
mod format;
mod legend;
mod panel;
mod path3d;
mod props;
mod render;
mod scene;
mod table;
mod thin;
mod vector;
mod vehicle;
mod view;

pub use ansi::ansi;
pub use chart::{chart, tiles};
pub use color::{BLACK, BLUE, Color, GREEN, GREY, ORANGE, PALETTE, PURPLE, SKY, VERMILION, YELLOW};
pub use drawing::Drawing;
pub use error::PictureError;
pub use film::{Film, FilmFormat};
pub use format::Format;
pub use panel::{Panel, Style};
pub use path3d::{Path3, path3d};
pub use render::render;
pub use scene::{Drone, Marker, Scene};
pub use table::Table;
pub use view::View;
