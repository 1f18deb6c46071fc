//! Formats in which single labs published their flights.

pub(super) mod hidden_effects;
pub(super) mod nanobench;
pub(super) mod nanodrone;
mod radio;
mod wander;
