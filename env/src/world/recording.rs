//! Additions to a world for recording: effects that stay in the loop at any value, and a clock that stops.

use super::setup::{active, with_ranges};
use super::{Settings, World};
use crate::effect_table::EffectTable;
use crate::effects::{self, BoundedNumber, Entry, check_effects, numbers};
use crate::error::Result;
use crate::model::Model;
use crate::noise::EpisodeKeys;
use crate::number::Number;
use crate::sim_scalar::SimScalar;
use crate::symbol::Symbol;

/// An effect of a recorded world, with its requested values.
#[derive(Debug, Clone)]
pub struct RecordedEffect {
    /// Its line of the registry.
    pub entry: &'static Entry,
    /// Values of its parameters, or what they are drawn from.
    pub(crate) numbers: Vec<BoundedNumber>,
}

impl std::fmt::Debug for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl<R: SimScalar> World<R> {
    /// One drone with the effects of the model that are on and all that `effects` names, whatever the values of
    /// their parameters: those are given by [`World::set_params`].
    ///
    /// # Errors
    /// The errors of [`World::new`].
    pub(crate) fn recorded(
        model: &Model,
        effects: &EffectTable,
        settings: Settings,
    ) -> Result<(Self, Vec<RecordedEffect>)> {
        check_effects(effects)?;
        let mut all = active(model, effects, settings.input)?;
        for (name, given) in effects {
            let (place, entry) = effects::find(name)?;
            if all.iter().all(|(other, ..)| *other != place) {
                all.push((place, entry, numbers(entry, given)));
            }
        }
        all.sort_by_key(|(place, ..)| *place);
        let listed = all
            .iter()
            .map(|(_, entry, values)| RecordedEffect { entry, numbers: with_ranges(entry, values.clone()) });
        let listed = listed.collect();
        let off = |entry: &Entry| entry.params.iter().map(|p| Number::Fixed(p.off)).collect();
        let world = all.into_iter().map(|(place, entry, _)| (place, entry, off(entry))).collect();
        Ok((Self::assemble(model, world, settings, 1)?, listed))
    }

    /// The words that the noise is made of: the episode's key, low and high, and the tick.
    pub(crate) fn set_words(&mut self, [low, high, tick]: [R::Word; 3]) {
        self.ages[0].keys = EpisodeKeys::from_words([low, high]);
        self.ages[0].tick = tick;
    }

    /// See [`World::set_words`]; the tick alone moves on.
    pub(crate) fn tick_word(&self) -> R::Word {
        self.ages[0].tick
    }
}

impl World<Symbol> {
    /// Stops the clock just before a round of every ring is complete, so that the newest place of a ring is
    /// always its first.
    pub(crate) fn stop_clock(&mut self) {
        let mut round = 1;
        self.each_ring(&mut |ring, numbers| round *= numbers.len() / ring);
        self.clocks[0] = round - 1;
    }

    /// Moves what rings remember on by a place, as the clock would have done.
    pub(crate) fn turn_rings(&mut self) {
        self.each_ring(&mut |ring, numbers| numbers.rotate_left(ring));
    }

    fn each_ring(&mut self, see: &mut dyn FnMut(usize, &mut [Symbol])) {
        for stage in &mut self.stages {
            let ring = stage.ring();
            if ring > 0 {
                stage.numbers().visit_tile(0, &mut |numbers| see(ring, numbers));
            }
        }
    }
}
