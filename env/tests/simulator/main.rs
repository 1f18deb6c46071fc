//! The simulator from outside, in one program: it links once.

mod actions;
mod datasheet;
mod derivatives;
mod effects;
mod effects_analytic;
mod expressions;
mod fleet;
mod flight;
mod force;
mod model;
mod motors;
mod observations;
mod own_mission;
mod race;
mod rollout;
mod snapshot;
mod swarm;
mod vector;
mod wind_field;
