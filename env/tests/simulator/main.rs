//! The simulator from outside, in one program: it links once.

mod actions;
mod datasheet;
mod derivatives;
mod effects;
mod effects_analytic;
mod expressions;
mod fleet;
mod flight;
mod model;
mod motors;
mod observations;
mod snapshot;
mod swarm;
mod vector;
