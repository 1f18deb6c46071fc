//! The simulator from outside, in one program: it links once.

mod actions;
mod derivatives;
mod effects;
mod effects_analytic;
mod fleet;
mod model;
mod observations;
mod snapshot;
mod swarm;
mod vector;
