//! From the residual of a model to its cause.

pub mod candidates;
pub mod errors;
pub mod noise;
pub mod search;
pub mod verdict;
