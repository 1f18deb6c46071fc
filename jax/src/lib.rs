//! Writes recorded environments as Python modules that need JAX alone.
//!
//! The formulas are those of the simulator: [`crazyflie_env::recording`] lets it run on symbols and returns what it
//! computed. Here that becomes text.

mod code;
mod module;
mod starts;

pub use module::write_module;
