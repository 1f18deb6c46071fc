//! Any action, as likely as any other.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::batch::check;
use super::{Controller, Entry, defaults};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::Result;

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Options {
    seed: u64,
}

pub(super) const ENTRY: Entry = Entry {
    name: "random",
    also: None,
    about: "Any action, as likely as any other",
    source: "uniform from -1 to 1, by PCG64 seeded with the seed plus the environment's place in the batch",
    any_level: true,
    file: None,
    member: None,
    options: &[("seed", "where the dice begin")],
    defaults: defaults::<Options>,
    build: |given, site| {
        let Options { seed } = given.options()?;
        let dice = |env: u64| Pcg64Mcg::seed_from_u64(seed.wrapping_add(env));
        let place = |env: usize| (given.first_env + env) as u64;
        Ok(Box::new(Random((0..site.envs).map(|env| dice(place(env))).collect())))
    },
};

struct Random(Vec<Pcg64Mcg>);

impl Controller for Random {
    /// Dice have no memory of a flight.
    fn reset(&mut self, _: &dyn Fn(usize) -> bool) {}

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.0.len(), observations, actions)?;
        for (dice, action) in self.0.iter_mut().zip(actions.chunks_exact_mut(ACTION)) {
            action.iter_mut().for_each(|a| *a = dice.random_range(-1.0..=1.0));
        }
        Ok(())
    }
}
