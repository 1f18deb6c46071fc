//! Motor-level model of a flight: rotor speeds from motor PWM and battery voltage drive the rigid body, and
//! named parameters are fitted.

pub mod carried;
pub mod fit;
pub mod flight;
pub mod form;
pub mod horizons;
pub mod model;
pub mod regression;
