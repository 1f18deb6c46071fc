//! Level, with the thrust that carries the weight.

use serde::{Deserialize, Serialize};

use super::batch::check;
use super::{Controller, Entry, defaults};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::plant::Command;

/// It has none.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Options {}

pub(super) const ENTRY: Entry = Entry {
    name: "hover",
    also: None,
    about: "Level, with the thrust that carries the weight: what no control at all is worth",
    source: "the model's hover PWM; where a height is commanded, the set-point's",
    any_level: false,
    file: None,
    member: None,
    options: &[],
    defaults: defaults::<Options>,
    build: |given, site| {
        given.options::<Options>()?;
        Ok(Box::new(Hover { interface: site.interface, envs: site.envs }))
    },
};

struct Hover {
    interface: Interface,
    envs: usize,
}

impl Controller for Hover {
    fn reset(&mut self, _: &dyn Fn(usize) -> bool) {}

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        for (action, seen) in actions.chunks_exact_mut(ACTION).zip(observations.chunks_exact(OBSERVATION)) {
            let lift =
                if self.interface.input.is_pwm() { self.interface.hover_lift } else { f64::from(seen[18]) };
            action.copy_from_slice(&self.interface.action(&Command::level(lift)).map(|a| a as f32));
        }
        Ok(())
    }
}
