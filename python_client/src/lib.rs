//! The native half of the Python package: borrow the arrays, let go of the interpreter, translate the error.
//! No logic lives here.

mod arrays;
#[cfg(feature = "bench")]
mod benchmark;
mod controller;
mod custom;
#[cfg(feature = "crazyflies")]
mod deploy;
mod errors;
mod gain_search;
mod guarded_cell;
mod interface;
#[cfg(feature = "jax")]
mod jax;
mod linear;
mod multi_controller;
mod parts;
mod picture;
mod pilot;
mod policy;
mod registry;
mod rollout;
mod sim;

/// The simulator in Rust. Use it through the package `crazyflie_gym`.
#[pyo3::pymodule]
mod _native {
    #[cfg(feature = "bench")]
    #[pymodule_export]
    use crate::benchmark::{read_season, robustness, submit, verify_attempts};
    #[pymodule_export]
    use crate::controller::{Controller, Pid, controllers};
    #[pymodule_export]
    use crate::gain_search::GainSearch;
    #[pymodule_export]
    use crate::interface::Interface;
    #[cfg(feature = "jax")]
    #[pymodule_export]
    use crate::jax::{JaxCore, double_flight, jax_module, jax_step_target};
    #[pymodule_export]
    use crate::linear::{loop_plots, loop_report, state_space, transfer_function};
    #[pymodule_export]
    use crate::multi_controller::{Crowd, metrics};
    #[pymodule_export]
    use crate::picture::{ansi, path, render, setpoints};
    #[pymodule_export]
    use crate::policy::policy_c;
    #[pymodule_export]
    use crate::registry::{
        action_levels, check_model, cli, datasheet_model, effects, estimated_fields, expression_fields,
        expression_functions, model_text, neighbour_fields, observable_fields, observation_choices,
        observation_fields, read_task, tasks, track_rows, vehicles,
    };
    #[pymodule_export]
    use crate::sim::Sim;

    /// The parts that a build may leave out, each a feature of this crate, and whether they are here.
    #[pymodule_export]
    const PARTS: [(&str, bool); 4] = [
        ("bench", cfg!(feature = "bench")),
        ("crazyflies", cfg!(feature = "crazyflies")),
        ("jax", cfg!(feature = "jax")),
        ("labs", cfg!(feature = "labs")),
    ];

    #[pymodule_init]
    fn init(_module: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        crazyflie_control::set_python_loader(crate::custom::load);
        #[cfg(feature = "crazyflies")]
        crazyflie_cli::set_deployer(crate::deploy::deploy);
        Ok(())
    }
}
