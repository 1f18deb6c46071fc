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
pub fn readers() -> &'static [&'static dyn Reader] {
    &[
        &mapped::MappedReader,
        &project::ProjectCsv,
        #[cfg(feature = "labs")]
        &labs::nanobench::NanoBench,
        #[cfg(feature = "labs")]
        &labs::nanodrone::NanoDrone,
        #[cfg(feature = "labs")]
        &labs::hidden_effects::HiddenEffects,
        &firmware_csv::FirmwareCsv,
        &ros_bag::RosBag,
        &ros2_bag::Ros2Bag,
        &mcap::Mcap,
        &ulog::ULog,
        &micro_sd::MicroSd,
    ]
}
