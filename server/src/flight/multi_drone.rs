//! Closed-loop flights of several drones that share the air.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController, build_each};
use crazyflie_env::Error;
use crazyflie_env::action::Interface;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{METRICS, STATE, VectorEnv};
use crazyflie_picture::{Drawing, PALETTE, Panel, Path3, PictureError, Style, chart, path3d};

use super::picture::way;
use super::{Setup, Trace, fly_by, options};
use crate::frames::separations_m;

/// One flight of several drones, each until it flew no more.
#[derive(Debug, Clone)]
pub struct MultiDroneTrace {
    /// Flight of each drone, in the order of the environment.
    pub drones: Vec<Trace>,
    /// Metrics of the whole flight, in the order of [`METRICS`].
    pub metrics: [f32; METRICS.len()],
}

impl MultiDroneTrace {
    /// Returns the metric of that name, NaN for an unknown one.
    pub fn metric(&self, name: &str) -> f32 {
        metric(&self.metrics, name).unwrap_or(f32::NAN)
    }

    /// Distance of a drone from where it should be, at each of its rows.
    pub fn errors_m(&self, drone: usize) -> Vec<f64> {
        self.drones[drone].rows.iter().map(super::TraceRow::error_m).collect()
    }
}

/// Configuration of the drones, and whether a layer keeps them apart.
#[derive(Debug, Clone, Default)]
pub struct MultiDroneSetup {
    /// 0 for the task's own number.
    pub drones: usize,
    /// True if [`crazyflie_control::avoidance`] acts between set-points and controllers.
    pub avoid: bool,
    /// A controller for each drone; none for the setup's own for all.
    pub controllers: Vec<ControllerSpec>,
}

/// Returns the metric of that name in a row of [`METRICS`]; none for an unknown one, or without a row.
pub(crate) fn metric(row: &[f32], name: &str) -> Option<f32> {
    METRICS.iter().zip(row).find(|((known, ..), _)| *known == name).map(|(_, value)| *value)
}

/// Builds a controller for each drone of the environments, or one for all, with or without a layer that keeps drones
/// apart.
///
/// # Errors
/// Those of the controllers.
pub(crate) fn crowd(
    model: &Model,
    env: &VectorEnv,
    specs: &[ControllerSpec],
    avoid: bool,
) -> Result<MultiController, Error> {
    let (tick_s, envs, mode) = (env.tick_s(), env.num_envs(), Mode::Automatic);
    let site = |interface: &Interface| ControllerContext { model, interface: *interface, tick_s, envs, mode };
    let controllers = build_each(specs, env.interfaces().iter().map(site), 0)?;
    MultiController::new(controllers, envs, avoid.then(CollisionAvoidance::default), tick_s)
}

/// Flies the setup once per seed, every drone by its controller.
pub fn fly_multi_drone(
    setup: &Setup,
    multi_drone: &MultiDroneSetup,
    seeds: &[u64],
) -> Result<Vec<MultiDroneTrace>, Error> {
    let options = options(setup, multi_drone.drones)?;
    let env = VectorEnv::new(std::slice::from_ref(&setup.model), &options, seeds.len())?;
    let specs = match &multi_drone.controllers[..] {
        [] => std::slice::from_ref(&setup.controller),
        each => each,
    };
    let mut crowd = crowd(&setup.model, &env, specs, multi_drone.avoid)?;
    fly_by(env, setup.seconds, seeds, &mut |_, batch| {
        crowd.set_states(&batch.states);
        crowd.act(&batch.observations, &mut batch.actions)
    })
}

/// Heights, distances from where each should be, and distances to the nearest other one, over time.
pub fn multi_drone_picture(flight: &MultiDroneTrace, title: &str) -> Result<Drawing, PictureError> {
    let drones = &flight.drones;
    let longest = drones.iter().max_by_key(|trace| trace.rows.len());
    let t_s: Vec<f64> =
        longest.map_or_else(Vec::new, |trace| (0..trace.rows.len()).map(|row| trace.t_s(row)).collect());
    let mut apart = vec![Vec::new(); drones.len()];
    for moment in 0..t_s.len() {
        let flying: Vec<bool> = drones.iter().map(|trace| moment < trace.rows.len()).collect();
        let state = |trace: &Trace| trace.rows.get(moment).map_or([0.0; STATE], |row| row.state);
        let states: Vec<f32> = drones.iter().flat_map(state).collect();
        for (apart, separation_m) in
            apart.iter_mut().zip(separations_m(&states, &flying)).filter(|(_, s)| s.is_finite())
        {
            apart.push(f64::from(separation_m));
        }
    }
    let panel = |y_label: &str, values: Vec<Vec<f64>>| {
        let named = values.into_iter().enumerate().zip(PALETTE.into_iter().cycle());
        named.fold(Panel::new("time (s)", y_label), |panel, ((drone, y), color)| {
            panel.curve(Style::Solid, color, format!("drone {drone}"), &t_s[..y.len()], &y)
        })
    };
    let panels = [
        panel("height (m)", drones.iter().map(|trace| trace.state(2)).collect()),
        panel("from its set-point (m)", (0..drones.len()).map(|drone| flight.errors_m(drone)).collect()),
        panel("to the nearest other (m)", apart),
    ];
    chart(&panels, 1, title)
}

/// The ways through space.
pub fn multi_drone_path(flight: &MultiDroneTrace, title: &str) -> Result<Drawing, PictureError> {
    let drones = flight.drones.iter().enumerate().zip(PALETTE.into_iter().cycle());
    let paths = drones.map(|((drone, trace), color)| Path3 {
        label: format!("drone {drone}"),
        points_m: way(trace),
        style: Style::Solid,
        color,
    });
    path3d(&paths.collect::<Vec<_>>(), &[], title)
}
