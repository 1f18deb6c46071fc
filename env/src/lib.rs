//! The Crazyflie that the TU Darmstadt thesis identified, as a fast, vectorised environment.
//!
//! One way for data: [`model`] -> [`effects`] -> [`world`] -> [`task`] -> [`vector`], a batch of environments
//! with one drone or several that share the air ([`coupling`]). No input or output, no clock, no Python here.

pub mod action;
mod archive;
pub mod config;
pub mod coupling;
pub mod datasheet;
pub mod dual;
mod effect_table;
pub mod effects;
mod elementary;
mod episode;
pub mod error;
pub mod estimator;
pub mod expression;
pub mod free_flight;
pub mod isa;
pub mod lanes;
#[cfg(all(target_arch = "x86_64", not(test)))]
mod lanes_avx2;
#[cfg(all(target_arch = "x86_64", not(test)))]
mod lanes_avx512;
pub mod model;
pub mod motors;
pub mod noise;
mod number;
pub mod observation;
pub mod plant;
mod pool;
#[cfg(feature = "recording")]
pub mod recording;
mod rows;
pub mod scalar;
pub mod sim_scalar;
#[cfg(feature = "recording")]
pub mod symbol;
pub mod task;
pub mod task_file;
pub mod transfer_function;
mod tree;
pub mod vector;
pub mod wind_field;
pub mod world;

// Unit tests are of the parts of a batch. For one kind of registers they compile in 111 s, for three in 196 s;
// tests/simulator asks for the same bits from all kinds.
#[cfg(all(target_arch = "x86_64", test))]
use lanes::{self as lanes_avx2, self as lanes_avx512};

pub use error::{Error, Result};
