//! Metrics of an episode, and of an attempt.

use crazyflie_statistics::{mean, median};
use serde::{Deserialize, Serialize};

use crazyflie_env::vector::{METRICS, state_index};

use super::episodes::{DronePath, Episode};
use super::error::{Error, Result};
use super::scenario::Scenario;
use crazyflie_server::flight::{self, Figures, Trace};

/// Metrics of one episode. Numbers are rounded to six decimals, which hides differences between the maths of
/// platforms.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeMetrics {
    /// Reason that the flight counts as a failure.
    pub failed: Option<String>,
    pub duration_s: f64,
    /// From the start of a phase until x, y and z stay within 5 cm, in the slowest phase; none if the
    /// set-point moves or they never do.
    pub settling_s: Option<f64>,
    /// Beyond the set-point, largest of x, y, z and of all phases; none if the set-point moves.
    pub overshoot_m: Option<f64>,
    /// Root mean square of the distance to the set-point, from the start on.
    pub rmse_m: f64,
    pub yaw_rmse_deg: f64,
    /// Root mean square of the commanded tilt, and how far the tilt commands travel per second.
    pub effort_deg: f64,
    pub travel_degps: f64,
    pub marker_losses: usize,
    pub marker_lost_s: f64,
    /// Speed and distance from the set-point at touch-down, in scenarios that land.
    pub touch_mps: Option<f64>,
    pub touch_off_m: Option<f64>,
    /// Drones that hit another, and the smallest distance between two that flew; only if several share the
    /// air.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub collisions: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_separation_m: Option<f64>,
}

/// Metrics of an attempt: medians over the flights that did not fail, sums of losses over all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metrics {
    /// Flights that settled.
    pub settled: usize,
    pub settling_s: Option<f64>,
    pub overshoot_m: Option<f64>,
    pub rmse_m: Option<f64>,
    pub yaw_rmse_deg: Option<f64>,
    pub effort_deg: Option<f64>,
    pub travel_degps: Option<f64>,
    pub marker_losses: usize,
    pub marker_lost_s: f64,
    pub touch_mps: Option<f64>,
    pub touch_off_m: Option<f64>,
    pub duration_s: Option<f64>,
    /// The sum, and the smallest of all flights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub collisions: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_separation_m: Option<f64>,
}

pub(super) fn episode_metrics(scenario: &Scenario, episode: &Episode) -> Result<EpisodeMetrics> {
    let each = episode.paths.iter().map(|path| path_metrics(scenario, path)).collect::<Result<Vec<_>>>()?;
    match &episode.world_metrics {
        Some(world_metrics) => multi_drone_metrics(scenario, &each, world_metrics),
        None => each.into_iter().next().ok_or_else(|| Error::Internal("an episode without a drone".into())),
    }
}

/// Metrics of the world of several drones, and means over the drones.
fn multi_drone_metrics(
    scenario: &Scenario,
    each: &[EpisodeMetrics],
    world_metrics: &[f32; METRICS.len()],
) -> Result<EpisodeMetrics> {
    let world_metric = |name: &str| {
        METRICS
            .iter()
            .position(|(known, ..)| *known == name)
            .map_or(f64::NAN, |at| f64::from(world_metrics[at]))
    };
    let over = |value: &dyn Fn(&EpisodeMetrics) -> f64| {
        round_figure(mean(&each.iter().map(value).collect::<Vec<_>>()).unwrap_or(0.0))
    };
    let squares = |value: &dyn Fn(&EpisodeMetrics) -> f64| {
        round_figure(mean(&each.iter().map(|e| value(e).powi(2)).collect::<Vec<_>>()).unwrap_or(0.0).sqrt())
    };
    let (drones, collisions, crashes, done) =
        (each.len(), world_metric("collisions"), world_metric("crashes"), world_metric("done"));
    let all_done = done >= drones as f64;
    // a cost of settling requires that all drones settle
    let late = scenario.plan.cost.settling_s.is_some() && !all_done;
    let failed = match (collisions > 0.0, crashes > 0.0, late) {
        (true, ..) => Some(format!("{collisions} of {drones} drones collided")),
        (_, true, _) => Some(format!("{crashes} of {drones} drones hit the floor or left the room")),
        (.., true) => Some(format!(
            "{} of {drones} drones were not where they should be in the end",
            drones as f64 - done
        )),
        _ => None,
    };
    Ok(EpisodeMetrics {
        failed,
        duration_s: each.iter().map(|e| e.duration_s).fold(0.0, f64::max),
        settling_s: all_done.then(|| round_figure(world_metric("settled_s"))).transpose()?,
        rmse_m: round_figure(world_metric("rms_error_m"))?,
        yaw_rmse_deg: squares(&|e| e.yaw_rmse_deg)?,
        effort_deg: squares(&|e| e.effort_deg)?,
        travel_degps: over(&|e| e.travel_degps)?,
        marker_losses: each.iter().map(|e| e.marker_losses).sum(),
        marker_lost_s: round_figure(each.iter().map(|e| e.marker_lost_s).sum())?,
        collisions: Some(collisions as usize),
        min_separation_m: Some(round_figure(world_metric("min_separation_m"))?),
        ..EpisodeMetrics::default()
    })
}

fn path_metrics(scenario: &Scenario, path: &DronePath) -> Result<EpisodeMetrics> {
    let trace = &path.trace;
    let figures = flight::figures(&scenario.phases, trace);
    let last = trace.rows.last().ok_or_else(|| Error::Internal("an episode without rows".into()))?;
    let squares: Vec<f64> =
        trace.rows.iter().map(|row| flight::squared_distance(&row.state[..3], row.setpoint())).collect();
    let yaw = trace.rows.iter().map(|row| {
        wrap_angle(f64::from(row.state[state_index::YAW] - row.setpoint()[3])).to_degrees().powi(2)
    });
    let touch = figures.touch_down.filter(|_| scenario.lands());
    let metrics = EpisodeMetrics {
        failed: failure(scenario, &figures, trace),
        duration_s: round_figure(figures.end_s)?,
        settling_s: settling(&figures).map(round_figure).transpose()?,
        overshoot_m: overshoot(&figures).map(round_figure).transpose()?,
        rmse_m: round_figure(mean(&squares).unwrap_or(0.0).sqrt())?,
        yaw_rmse_deg: round_figure(mean(&yaw.collect::<Vec<_>>()).unwrap_or(0.0).sqrt())?,
        effort_deg: round_figure(
            over_phases(&figures, |[x, y, ..]| x.effort.powi(2) + y.effort.powi(2)).sqrt(),
        )?,
        travel_degps: round_figure(over_phases(&figures, |[x, y, ..]| x.travel_per_s + y.travel_per_s))?,
        marker_losses: figures.marker_losses,
        marker_lost_s: round_figure(figures.marker_lost_s)?,
        touch_mps: touch.map(|touch| round_figure(touch.mps)).transpose()?,
        touch_off_m: touch
            .map(|_| round_figure(flight::squared_distance(&last.state[..2], last.setpoint()).sqrt()))
            .transpose()?,
        ..EpisodeMetrics::default()
    };
    Ok(metrics)
}

/// Returns the failure: breaking the vehicle, leaving the room, ending on the floor at the end of a flight or in the
/// air at the end of a landing.
fn failure(scenario: &Scenario, figures: &Figures, trace: &Trace) -> Option<String> {
    let down = trace.rows.last().is_some_and(|row| row.state[state_index::HEIGHT] <= 0.0);
    let wrong_place = match scenario.lands() {
        true => (!down).then(|| "did not land".to_owned()),
        false => down.then(|| "ended on the floor".to_owned()),
    };
    figures.crash.clone().or(wrong_place)
}

fn settling(figures: &Figures) -> Option<f64> {
    let axes = figures.phases.iter().flat_map(|phase| &phase.axes[..3]);
    axes.map(|axis| axis.settled_s).try_fold(0.0, |worst, s| Some(f64::max(worst, s?)))
}

fn overshoot(figures: &Figures) -> Option<f64> {
    let axes = figures.phases.iter().flat_map(|phase| &phase.axes[..3]);
    axes.map(|axis| axis.overshoot).try_fold(0.0, |worst, m| Some(f64::max(worst, m?)))
}

/// The mean of a quantity of phases, weighted by how long they were.
fn over_phases(figures: &Figures, of: impl Fn(&[flight::AxisFigures; 4]) -> f64) -> f64 {
    let seconds = |phase: &flight::PhaseFigures| (phase.to_s - phase.from_s).max(f64::MIN_POSITIVE);
    let all: f64 = figures.phases.iter().map(seconds).sum();
    figures.phases.iter().map(|phase| of(&phase.axes) * seconds(phase) / all).sum()
}

fn wrap_angle(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

/// To six decimals.
///
/// # Errors
/// [`Error::Internal`] for a value that is not a finite number, which must not become a score.
pub(super) fn round_figure(value: f64) -> Result<f64> {
    if value.is_finite() {
        Ok((value * 1e6).round() / 1e6)
    } else {
        Err(Error::Internal(format!("a figure is {value}")))
    }
}

pub(super) fn attempt_metrics(episodes: &[EpisodeMetrics]) -> Result<Metrics> {
    let flown = || episodes.iter().filter(|e| e.failed.is_none());
    let median_of = |value: &dyn Fn(&EpisodeMetrics) -> Option<f64>| {
        median(&flown().filter_map(value).collect::<Vec<_>>()).map(round_figure).transpose()
    };
    Ok(Metrics {
        settled: flown().filter(|e| e.settling_s.is_some()).count(),
        settling_s: median_of(&|e| e.settling_s)?,
        overshoot_m: median_of(&|e| e.overshoot_m)?,
        rmse_m: median_of(&|e| Some(e.rmse_m))?,
        yaw_rmse_deg: median_of(&|e| Some(e.yaw_rmse_deg))?,
        effort_deg: median_of(&|e| Some(e.effort_deg))?,
        travel_degps: median_of(&|e| Some(e.travel_degps))?,
        marker_losses: episodes.iter().map(|e| e.marker_losses).sum(),
        marker_lost_s: round_figure(episodes.iter().map(|e| e.marker_lost_s).sum())?,
        touch_mps: median_of(&|e| e.touch_mps)?,
        touch_off_m: median_of(&|e| e.touch_off_m)?,
        duration_s: median_of(&|e| Some(e.duration_s))?,
        collisions: episodes.iter().map(|e| e.collisions).sum(),
        min_separation_m: episodes.iter().filter_map(|e| e.min_separation_m).reduce(f64::min),
    })
}
