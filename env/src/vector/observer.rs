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
    Field, LONGEST_HISTORY, OBSERVATION, Observable, ObservationChoice, Surroundings, need_estimate,
    need_truth,
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
    /// Least and greatest numbers of each field.
    bounds: Vec<[R; 2]>,
    needs_truth: bool,
    drones: usize,
    /// Numbers of one tick: a drone's own, then those of the others.
    width: usize,
    history: usize,
    /// By tile, then by drone; empty where nothing is estimated.
    estimators: Vec<Estimator<R>>,
    /// The rows of the last ticks, the newest last, by environment and drone; empty where one tick is all.
    past: Vec<f32>,
    /// Chosen numbers of one drone in a tile.
    chosen: Vec<R>,
    /// The same as rows.
    now: Vec<f32>,
}

/// Returns the numbers of a row of one tick with `fields`.
fn own_width(fields: &[Field]) -> usize {
    fields.iter().map(|field| field.length).sum()
}

/// Numbers of a drone's observation.
///
/// # Errors
/// The errors of [`observation_width`].
pub(super) fn row_width(options: &crate::config::Options, drones: usize) -> Result<usize> {
    observation_width(&options.observation, options.history, drones - 1)
}

/// Numbers of an observation of one drone that knows so many others.
///
/// # Errors
/// [`crate::Error::Range`] for the history; as [`ObservationChoice::sources`].
pub fn observation_width(choice: &ObservationChoice, history: usize, others: usize) -> Result<usize> {
    check_range("history", history as f64, 1.0, LONGEST_HISTORY as f64)?;
    Ok(history * (own_width(&choice.sources()?) + NEIGHBOUR * others))
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
        let estimator = |i: usize| {
            Estimator::new(models[i % drones], interfaces[i % drones].input, tick_s, &SensorNoise::default())
        };
        let estimators = if need_estimate(&fields) { tiles * drones } else { 0 };
        let estimators = (0..estimators).map(estimator).collect();
        Ok(Some(Observer::with(fields, [envs, drones, drones - 1], options.history, estimators)))
    }

    /// Observes `envs` environments of `drones` drones, each of which knows `others`.
    pub(super) fn with(
        fields: Vec<Field>,
        [envs, drones, others]: [usize; 3],
        history: usize,
        estimators: Vec<Estimator<R>>,
    ) -> Self {
        let own = own_width(&fields);
        let width = own + NEIGHBOUR * others;
        let kept = if history == 1 { 0 } else { envs * drones * history * width };
        Observer {
            needs_truth: need_truth(&fields),
            bounds: fields.iter().map(|field| [field.low, field.high].map(R::from_f64)).collect(),
            fields,
            drones,
            width,
            history,
            estimators,
            past: vec![0.0; kept],
            chosen: vec![R::zero(); own],
            now: vec![0.0; LANES * width],
        }
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
        self.choose(&numbers);
        let long = self.history * self.width;
        let first = place.tile * LANES * long;
        let is_plain = self.width == self.chosen.len() && self.drones == 1 && self.past.is_empty();
        if is_plain
            && place.lanes & place.flying == u32::from(u16::MAX)
            && let Some(rows) = rows.get_mut(first..first + LANES * long)
        {
            return write_rows(&self.chosen, rows, long);
        }
        write_rows(&self.chosen, &mut self.now, self.width);
        self.add_others(sight.rows);
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

    /// Returns what the drone may observe.
    #[inline(always)]
    fn observable<'a>(&mut self, place: RowPlace, sight: &Sight<'a, R>) -> Observable<'a, R> {
        let begun = if place.begins { Some(R::mask(place.lanes)) } else { None };
        // not by `map`, which would not be compiled for the lanes' instruction set
        let estimate = match self.estimators.get_mut(place.tile * self.drones + place.drone) {
            Some(estimator) => Some(estimator.estimate(begun, sight.own)),
            None => None,
        };
        Observable::new(self.needs_truth, sight.own, sight.x, estimate, &sight.surroundings)
    }

    /// Takes the chosen fields, within their bounds.
    #[inline(always)]
    fn choose(&mut self, all: &Observable<'_, R>) {
        let mut rest = &mut self.chosen[..];
        for (field, [low, high]) in self.fields.iter().zip(&self.bounds) {
            let numbers = all.field(field);
            let Some((slots, others)) = rest.split_at_mut_checked(numbers.len()) else { return };
            for (slot, number) in slots.iter_mut().zip(numbers) {
                *slot = number.clamp(*low, *high);
            }
            rest = others;
        }
    }

    /// Adds the knowledge of the others to the rows of this tick.
    #[inline(always)]
    fn add_others(&mut self, measured: &[f32]) {
        let (own, wide) = (self.chosen.len(), OBSERVATION + self.width - self.chosen.len());
        if wide > OBSERVATION {
            for (row, measured) in self.now.chunks_exact_mut(self.width).zip(measured.chunks_exact(wide)) {
                row[own..].copy_from_slice(&measured[OBSERVATION..]);
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

/// Lanes as sixteen rows, `stride` apart: in blocks that the lanes transpose in registers.
#[inline(always)]
fn write_rows<R: BatchScalar>(numbers: &[R], rows: &mut [f32], stride: usize) {
    let (wide, rest) = numbers.as_chunks::<16>();
    let (narrow, rest) = rest.as_chunks::<8>();
    let (least, rest) = rest.as_chunks::<4>();
    let mut first = 0;
    for block in wide {
        R::write(block, &mut rows[first..], stride);
        first += block.len();
    }
    for block in narrow {
        R::write(block, &mut rows[first..], stride);
        first += block.len();
    }
    for block in least {
        R::write(block, &mut rows[first..], stride);
        first += block.len();
    }
    for (at, number) in (first..).zip(rest) {
        for (row, value) in rows.chunks_mut(stride).zip(number.array()) {
            row[at] = *value;
        }
    }
}
