//! The native half of the Python package: borrow the arrays, let go of the interpreter, translate the error. No logic lives here.

mod arrays;
mod controller;
mod errors;
mod held;
mod picture;
mod registry;
mod remote;
mod sim;
mod swarm;

/// The simulator in Rust. Use it through the package `crazyflie_gym`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::controller::{Controller, Pid, controllers};
    #[pymodule_export]
    use crate::picture::{ansi, path, render};
    #[pymodule_export]
    use crate::registry::{check_model, cli, effects, model_text, observation_fields, tasks};
    #[pymodule_export]
    use crate::remote::Remote;
    #[pymodule_export]
    use crate::sim::{Interface, Sim};
    #[pymodule_export]
    use crate::swarm::{Crowd, Swarm, metrics, missions};
}
