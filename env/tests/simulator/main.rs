//! The simulator from outside, in one program: it links once.

mod derivatives;
mod effects;
mod effects_analytic;
mod fleet;
mod model;
mod observations;
mod rollout;
mod snapshot;
mod swarm;
mod vector;
