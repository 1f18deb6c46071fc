//! Closed-loop flights of several drones that share the air.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, ControllerSpec, Mode, MultiController, build_each};
use crazyflie_env::Error;
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::vector::{METRICS, STATE, StepBuffers, VectorEnv};
use crazyflie_picture::{Drawing, PALETTE, Panel, Path3, PictureError, Style, chart, path3d};

use super::picture::way;
use super::{Setup, Trace, options, row};
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
        METRICS
            .iter()
            .zip(self.metrics)
            .find(|((known, ..), _)| *known == name)
            .map_or(f32::NAN, |(_, value)| value)
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

/// Flies the setup once per seed, every drone by its controller.
pub fn fly_multi_drone(
    setup: &Setup,
    multi_drone: &MultiDroneSetup,
    seeds: &[u64],
) -> Result<Vec<MultiDroneTrace>, Error> {
    let options = options(setup, multi_drone.drones)?;
    let mut env = VectorEnv::new(std::slice::from_ref(&setup.model), &options, seeds.len())?;
    let (tick_s, n, width) = (env.tick_s(), env.num_drones(), env.width());
    let site = |interface: &Interface| ControllerContext {
        model: &setup.model,
        interface: *interface,
        tick_s,
        envs: seeds.len(),
        mode: Mode::Automatic,
    };
    let specs = match &multi_drone.controllers[..] {
        [] => std::slice::from_ref(&setup.controller),
        each => each,
    };
    let controllers = build_each(specs, env.interfaces().iter().map(site), 0)?;
    let mut crowd = MultiController::new(
        controllers,
        seeds.len(),
        multi_drone.avoid.then(CollisionAvoidance::default),
        tick_s,
    )?;
    let all = seeds.len() * n;
    let mut observations = vec![0.0; all * width];
    let (mut actions, mut states, mut metrics) =
        (vec![0.0; all * ACTION], vec![0.0; all * STATE], vec![0.0; seeds.len() * METRICS.len()]);
    let (mut rewards, [mut terminated, mut truncated, mut flying]) =
        (vec![0.0; all], [(); 3].map(|()| vec![true; all]));
    let flight = MultiDroneTrace {
        drones: env.interfaces().iter().map(|interface| Trace::new(tick_s, *interface)).collect(),
        metrics: [0.0; METRICS.len()],
    };
    let mut flights = vec![flight; seeds.len()];
    let mut over = vec![false; all];
    env.reset(Some(seeds), None, &mut observations)?;
    let ticks = (setup.seconds / tick_s).round() as usize;
    for tick in 0..=ticks {
        env.states(&mut states)?;
        crowd.set_states(&states);
        crowd.act(&observations, &mut actions)?;
        let traces = flights.iter_mut().flat_map(|flight| &mut flight.drones);
        for (i, (trace, over)) in traces.zip(&mut over).enumerate().filter(|(_, (_, over))| !**over) {
            trace.rows.push(row(i, width, &observations, &states, &actions));
            *over = !flying[i];
        }
        if tick == ticks || over.iter().all(|over| *over) {
            break;
        }
        let aloft: Vec<bool> = over.chunks(n).map(|over| over.contains(&false)).collect();
        let out = StepBuffers {
            observations: &mut observations,
            rewards: &mut rewards,
            terminated: &mut terminated,
            truncated: &mut truncated,
            flying: &mut flying,
            metrics: &mut metrics,
        };
        env.step(&actions, out)?;
        let traces = flights.iter_mut().flat_map(|flight| &mut flight.drones);
        for ((trace, reward), _) in traces.zip(&rewards).zip(&over).filter(|(_, over)| !**over) {
            trace.reward += f64::from(*reward);
        }
        let rows = metrics.as_chunks::<{ METRICS.len() }>().0;
        for ((flight, row), _) in flights.iter_mut().zip(rows).zip(&aloft).filter(|(_, aloft)| **aloft) {
            flight.metrics = *row;
        }
    }
    Ok(flights)
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
