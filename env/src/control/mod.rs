//! Controllers are clients of the environment: they read the observation an agent gets and answer with an action.

pub mod avoid;
pub mod crowd;
pub mod pid;
