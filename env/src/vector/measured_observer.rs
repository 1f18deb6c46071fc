//! Observations that a controller computes from what is measured.

use super::observer::{Observer, RowPlace, Sight, observation_width};
use super::state_index;
use crate::coupling::NEIGHBOUR;
use crate::error::{Error, Result};
use crate::estimator::{Estimator, SensorNoise};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, VerticalInput};
use crate::observation::{
    OBSERVATION, ObservationChoice, Surroundings, is_of_surroundings, need_estimate, need_truth,
};
use crate::plant::State;
use crate::rows::STATE;
use crate::scalar::{Scalar, tabulate};

/// Computes observations of one drone in each of some environments from its measured rows, to the bit as an environment
/// with these options gives them. Use it where only measurements arrive: in front of a vehicle, or on a server.
pub struct MeasuredObserver {
    inner: Observer<Lanes>,
    needs_truth: bool,
    others: usize,
    width: usize,
    /// Environments of each tile, and those of them whose episodes begin.
    tiles: Vec<[u32; 2]>,
}

impl MeasuredObserver {
    /// Observes `envs` environments whose drone knows `others`; a filter believes in the model.
    ///
    /// # Errors
    /// The errors of [`observation_width`]; [`Error::Config`] for fields of gates and obstacles, which no row has.
    pub fn new(
        choice: &ObservationChoice,
        history: usize,
        [envs, others]: [usize; 2],
        (model, input, tick_s): (&Model, VerticalInput, f64),
    ) -> Result<Self> {
        let (fields, width) = (choice.sources()?, observation_width(choice, history, others)?);
        if let Some(field) = fields.iter().find(|field| is_of_surroundings(field)) {
            let name = field.name;
            return Err(Error::Config(format!("observation: a controller is not told the field {name:?}")));
        }
        let needs_truth = need_truth(&fields);
        let tiles: Vec<_> =
            (0..envs).step_by(LANES).map(|first| (1_u32 << LANES.min(envs - first)) - 1).collect();
        let estimators = if need_estimate(&fields) { tiles.len() } else { 0 };
        let belief = SensorNoise::default();
        let estimators = vec![Estimator::new(model, input, tick_s, &belief); estimators];
        let inner = Observer::with(fields, [envs, 1, others], history, estimators);
        let tiles = tiles.into_iter().map(|used| [used, used]).collect();
        Ok(MeasuredObserver { inner, needs_truth, others, width, tiles })
    }

    /// Numbers in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns whether rows hold fields of the true state.
    pub fn needs_truth(&self) -> bool {
        self.needs_truth
    }

    /// The next rows are the first of an episode in the environments that `of` names.
    pub fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, [used, fresh]) in self.tiles.iter_mut().enumerate() {
            let named = (0..LANES).filter(|lane| *used >> lane & 1 == 1 && of(tile * LANES + lane));
            *fresh |= named.fold(0, |bits, lane| bits | 1 << lane);
        }
    }

    /// Writes observations, rows of [`Self::width`], for measured rows ([`OBSERVATION`] numbers, then [`NEIGHBOUR`] for
    /// each of the others) and true states (rows of [`STATE`]; none where no field needs them).
    pub fn observe(&mut self, measured: &[f32], states: &[f32], rows: &mut [f32]) {
        let wide = OBSERVATION + NEIGHBOUR * self.others;
        for (tile, [used, fresh]) in self.tiles.iter_mut().enumerate() {
            let measured = &measured[tile * LANES * wide..];
            let own = tabulate(|i| lanes_at(measured, wide, i));
            let x = state(states.get(tile * LANES * STATE..).unwrap_or_default());
            let seen = Sight { own: &own, x: &x, rows: measured, surroundings: Surroundings::none() };
            for (lanes, begins) in [(*used & !*fresh, false), (*fresh, true)] {
                if lanes != 0 {
                    let place = RowPlace { tile, drone: 0, lanes, flying: lanes, begins };
                    self.inner.write(place, &seen, rows);
                }
            }
            *fresh = 0;
        }
    }
}

/// One number of up to sixteen rows; zeros where there are fewer.
fn lanes_at(rows: &[f32], width: usize, at: usize) -> Lanes {
    let mut lanes = Lanes::zero();
    for (slot, value) in lanes.array_mut().iter_mut().zip(rows.iter().skip(at).step_by(width)) {
        *slot = *value;
    }
    lanes
}

/// The states of up to sixteen rows.
fn state(rows: &[f32]) -> State<Lanes> {
    let three = |first: usize| tabulate(|i| lanes_at(rows, STATE, first + i));
    State {
        pos_m: three(state_index::POS),
        vel_mps: three(state_index::VEL),
        att_rad: three(state_index::ROLL),
        rate_radps: three(state_index::RATE),
        aux: [Lanes::zero(); 2],
    }
}
