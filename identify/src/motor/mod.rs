//! Motor-level model of a flight: rotor speeds from motor PWM and battery voltage drive the rigid body, and
//! named parameters are fitted.

pub mod fit;
pub mod flight;
pub mod horizons;
pub mod model;
pub mod regression;
