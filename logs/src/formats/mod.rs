//! The registry of file formats: one file and one line each.

mod firmware_csv;
#[cfg(feature = "labs")]
mod labs;
pub(crate) mod mapped;
mod mcap;
mod micro_sd;
pub(crate) mod project;
mod ros2_bag;
mod ros_bag;
mod ulog;

use crate::Reader;

/// All formats, in the order in which equal matches are preferred.
pub fn readers() -> &'static [&'static Reader] {
    static ALL: &[&Reader] = &[
        &mapped::READER,
        &project::READER,
        #[cfg(feature = "labs")]
        &labs::nanobench::READER,
        #[cfg(feature = "labs")]
        &labs::nanodrone::READER,
        #[cfg(feature = "labs")]
        &labs::hidden_effects::READER,
        &firmware_csv::READER,
        &ros_bag::READER,
        &ros2_bag::READER,
        &mcap::READER,
        &ulog::READER,
        &micro_sd::READER,
    ];
    ALL
}
