//! Observations other than the measurements: the chosen fields, of now or of the last few ticks, as numbers of the
//! lanes until they are rows.

use super::ShardSpec;
use crate::archive::Archive;
use crate::coupling::NEIGHBOUR;
use crate::episode::FlightPlan;
use crate::error::{Result, check_range};
use crate::estimator::{Estimator, SensorNoise};
use crate::lanes::LANES;
use crate::observation::{
    Field, LONGEST_HISTORY, OBSERVABLE, OBSERVATION, Surroundings, need_estimate, observable,
};
use crate::plant::State;
use crate::rows::lanes_of;
use crate::sim_scalar::BatchScalar;

/// Which rows are written.
#[derive(Clone, Copy)]
pub(super) struct RowPlace {
    pub(super) tile: usize,
    pub(super) drone: usize,
    /// Lanes whose rows are written.
    pub(super) lanes: u32,
    /// Those of them in which the drone flies; rows of others are zeros.
    pub(super) flying: u32,
    /// Their episodes begin here.
    pub(super) begins: bool,
}

/// A drone's observation and its true state.
pub(super) struct Sight<'a, R> {
    pub(super) own: &'a [R; OBSERVATION],
    pub(super) x: &'a State<R>,
    /// Rows of what is measured, a row for each lane: behind the drone's own numbers those of the others.
    pub(super) rows: &'a [f32],
    pub(super) surroundings: Surroundings<R>,
}

/// State of a part of the batch for such observations.
pub(super) struct Observer<R: BatchScalar> {
    fields: Vec<Field>,
    drones: usize,
    /// Numbers of one tick: a drone's own, then those of the others.
    width: usize,
    history: usize,
    /// By tile, then by drone; empty where nothing is estimated.
    estimators: Vec<Estimator<R>>,
    /// The rows of the last ticks, the newest last, by environment and drone; empty where one tick is all.
    past: Vec<f32>,
    /// Row of one drone in a tile.
    now: Vec<f32>,
}

/// Returns the numbers of a row of one tick with `fields`.
fn own_width(fields: &[Field]) -> usize {
    fields.iter().map(|field| field.length).sum()
}

/// Numbers of a drone's observation.
///
/// # Errors
/// [`crate::Error::Range`] for the history; as [`crate::observation::ObservationChoice::sources`].
pub(super) fn row_width(options: &crate::config::Options, drones: usize) -> Result<usize> {
    check_range("history", options.history as f64, 1.0, LONGEST_HISTORY as f64)?;
    Ok(options.history * (own_width(&options.observation.sources()?) + NEIGHBOUR * (drones - 1)))
}

impl<R: BatchScalar> Observer<R> {
    /// Creates the observer; none if only the measurements are chosen. `surrounded`: the task has gates or obstacles.
    ///
    /// # Errors
    /// The errors of [`crate::config::Options::observed_fields`].
    pub(super) fn new(spec: &ShardSpec<'_>, drones: usize, surrounded: bool) -> Result<Option<Self>> {
        let ShardSpec { plan: FlightPlan { models, interfaces, options, tick_s, tiles }, envs } = *spec;
        if !options.observes() {
            return Ok(None);
        }
        let fields = options.observed_fields(surrounded)?;
        let width = own_width(&fields) + NEIGHBOUR * (drones - 1);
        let estimates = need_estimate(&fields);
        let estimator = |i: usize| {
            Estimator::new(models[i % drones], interfaces[i % drones].input, tick_s, &SensorNoise::default())
        };
        let kept = if options.history == 1 { 0 } else { envs * drones * options.history * width };
        Ok(Some(Observer {
            fields,
            drones,
            width,
            history: options.history,
            estimators: (0..if estimates { tiles * drones } else { 0 }).map(estimator).collect(),
            past: vec![0.0; kept],
            now: vec![0.0; LANES * width],
        }))
    }

    /// Writes the rows of a drone in a tile, of all rows of this part of the batch.
    // a function of its own, so that it does not weigh on steps without it
    #[inline(never)]
    pub(super) fn write(&mut self, place: RowPlace, sight: &Sight<'_, R>, rows: &mut [f32]) {
        R::run(
            #[inline(always)]
            || self.write_now(place, sight, rows),
        );
    }

    #[inline(always)]
    fn write_now(&mut self, place: RowPlace, sight: &Sight<'_, R>, rows: &mut [f32]) {
        let numbers = self.observable(place, sight);
        self.select(&numbers, sight.rows);
        let long = self.history * self.width;
        for lane in lanes_of(place.lanes) {
            let row = (place.tile * LANES + lane) * self.drones + place.drone;
            let out = &mut rows[row * long..(row + 1) * long];
            if place.flying >> lane & 1 == 0 {
                out.fill(0.0);
                continue;
            }
            let now = &self.now[lane * self.width..(lane + 1) * self.width];
            if self.past.is_empty() {
                out.copy_from_slice(now);
                continue;
            }
            let past = &mut self.past[row * long..(row + 1) * long];
            if place.begins {
                past.chunks_exact_mut(self.width).for_each(|tick| tick.copy_from_slice(now));
            } else {
                past.copy_within(self.width.., 0);
                past[long - self.width..].copy_from_slice(now);
            }
            out.copy_from_slice(past);
        }
    }

    /// Returns every number available to an observation, in the order of [`crate::observation::ALL_FIELDS`].
    #[inline(always)]
    fn observable(&mut self, place: RowPlace, sight: &Sight<'_, R>) -> [R; OBSERVABLE] {
        let begun = place.begins.then(|| R::mask(place.lanes));
        let estimate = self.estimators.get_mut(place.tile * self.drones + place.drone);
        let estimate = estimate.map(
            #[inline(always)]
            |estimator| estimator.estimate(begun, sight.own),
        );
        observable(sight.own, sight.x, estimate, &sight.surroundings)
    }

    /// Writes the rows of this tick: the chosen fields, within their bounds, and the knowledge of the others.
    #[inline(always)]
    fn select(&mut self, all: &[R; OBSERVABLE], measured: &[f32]) {
        let mut at = 0;
        for field in &self.fields {
            let (low, high) = (R::from_f64(field.low), R::from_f64(field.high));
            for number in &all[field.range()] {
                let values = number.clamp(low, high);
                for (row, value) in self.now.chunks_exact_mut(self.width).zip(values.array()) {
                    row[at] = *value;
                }
                at += 1;
            }
        }
        if self.drones > 1 {
            let wide = OBSERVATION + NEIGHBOUR * (self.drones - 1);
            for (row, measured) in self.now.chunks_exact_mut(self.width).zip(measured.chunks_exact(wide)) {
                row[at..].copy_from_slice(&measured[OBSERVATION..]);
            }
        }
    }

    /// Archives the state from which a tile's flights continue.
    pub(super) fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        let per_tile = tile * self.drones..(tile + 1) * self.drones;
        for estimator in self.estimators.get_mut(per_tile).unwrap_or_default() {
            estimator.show_numbers(archive);
            if archive.reads() {
                estimator.resume();
            }
        }
        let numbers = LANES * self.drones * self.history * self.width;
        let end = self.past.len().min((tile + 1) * numbers);
        let width = self.drones * self.history * self.width;
        archive.rows(&mut self.past[(tile * numbers).min(end)..end], width);
    }
}
