//! The native half of the Python package: borrow the arrays, let go of the interpreter, translate the error.
//! No logic lives here.

mod arrays;
mod controller;
mod errors;
mod guarded_cell;
mod multi_controller;
mod picture;
mod registry;
mod remote;
mod sim;

/// The simulator in Rust. Use it through the package `crazyflie_gym`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::controller::{Controller, Pid, controllers};
    #[pymodule_export]
    use crate::multi_controller::{Crowd, metrics};
    #[pymodule_export]
    use crate::picture::{ansi, path, render};
    #[pymodule_export]
    use crate::registry::{
        action_levels, check_model, cli, effects, model_text, neighbour_fields, observable_fields,
        observation_choices, observation_fields, tasks,
    };
    #[pymodule_export]
    use crate::remote::Remote;
    #[pymodule_export]
    use crate::sim::{Interface, Sim};
}
