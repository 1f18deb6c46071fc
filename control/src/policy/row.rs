//! Policies that read an observation of their choice, number by number.

use std::sync::Arc;

use safetensors::SafeTensors;
use serde::de::DeserializeOwned;

use super::PolicyFile;
use super::network::{LayerKind, Network, Scratch, deviations, layers, vector};
use crate::batch::{mask, write};
use crate::edited::EditedController;
use crate::landing::SetpointLanding;
use crate::observing::{ObservationSpec, with_observation};
use crate::{Controller, ControllerConfig, ControllerContext};
use crazyflie_env::action::{ACTION, ActionLevel, Interface};
use crazyflie_env::error::{Result, check_length};
use crazyflie_env::lanes::{LANES, Lanes};
use crazyflie_env::model::VerticalInput;
use crazyflie_env::scalar::Scalar;
use crazyflie_env::vector::observation_width;

/// Contents of a file.
#[derive(Debug)]
pub(super) struct RowPolicy {
    pub network: Network,
    pub spec: ObservationSpec,
    /// Action level and, for attitudes, vertical form that it commands.
    action: String,
    vertical: VerticalInput,
}

impl RowPolicy {
    /// # Errors
    /// Naming the key of the metadata, or the tensor, that is missing or wrong.
    pub(super) fn read(
        file: &PolicyFile<'_>,
        tensors: &SafeTensors<'_>,
    ) -> std::result::Result<Self, String> {
        let spec = ObservationSpec {
            observation: json(file, "observation")?,
            history: json(file, "history")?,
            others: json(file, "others")?,
        };
        let width = observation_width(&spec.observation, spec.history, spec.others)
            .map_err(|problem| problem.to_string())?;
        let kinds: Vec<LayerKind> = json(file, "layers")?;
        let clip: Option<f64> = json(file, "clip")?;
        let network = Network {
            mean: vector(tensors, "observation_mean", width)?,
            std: deviations(tensors, "observation_std", width)?,
            clip: clip.unwrap_or(f64::INFINITY),
            layers: layers(tensors, &kinds, width)?,
            skip: Vec::new(),
        };
        let word = |key: &str| file.get(key).ok_or_else(|| format!("it lacks {key}"));
        let vertical = VerticalInput::named(word("vertical")?).map_err(|problem| problem.to_string())?;
        Ok(RowPolicy { network, spec, action: word("action")?.to_owned(), vertical })
    }

    /// # Errors
    /// For an action level or a vertical form that it was not trained for.
    pub(super) fn check_commands(&self, interface: &Interface) -> std::result::Result<(), String> {
        let (level, form) = (interface.level(), interface.input.name());
        if self.action != level.name() {
            let (trained, asked) = (&self.action, level.name());
            return Err(format!(
                "it was trained for the action level {trained}, and {asked} is asked for: choose that level, or train it \
                 with action=\"{asked}\""
            ));
        }
        // both forms of a PWM take the same commands
        let is_same = self.vertical == interface.input || self.vertical.is_pwm() && interface.input.is_pwm();
        if level == ActionLevel::Attitude && !is_same {
            let trained = self.vertical.name();
            return Err(format!(
                "it commands the vertical form {trained}, and {form} is asked for: choose that form, or train it with \
                 vertical=\"{form}\""
            ));
        }
        Ok(())
    }

    /// Ready to fly: behind what computes its observation and what lands it.
    pub(super) fn controller(
        self,
        given: &ControllerConfig<'_>,
        site: &ControllerContext<'_>,
    ) -> Result<Box<dyn Controller>> {
        let (spec, scratch) = (self.spec, Scratch::new(&self.network));
        let width = self.network.mean.len();
        let tiles = vec![scratch; site.envs.div_ceil(LANES)];
        let pilot = RowController { network: Arc::new(self.network), width, tiles, envs: site.envs };
        let sees = with_observation(Box::new(pilot), site, spec, &given.label())?;
        Ok(Box::new(EditedController::new(sees, site.envs, SetpointLanding::new(site))))
    }
}

/// A value of the metadata.
fn json<T: DeserializeOwned>(file: &PolicyFile<'_>, key: &str) -> std::result::Result<T, String> {
    let text = file.get(key).ok_or_else(|| format!("it lacks {key}"))?;
    serde_json::from_str(text).map_err(|e| format!("{key}: {e}"))
}

/// The network for a batch of environments.
struct RowController {
    network: Arc<Network>,
    width: usize,
    tiles: Vec<Scratch<Lanes>>,
    envs: usize,
}

impl Controller for RowController {
    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, scratch) in self.tiles.iter_mut().enumerate() {
            scratch.forget(mask(tile, self.envs, of));
        }
    }

    fn act(&mut self, rows: &[f32], actions: &mut [f32]) -> Result<()> {
        check_length("observations", self.envs * self.width, rows.len())?;
        check_length("actions", self.envs * ACTION, actions.len())?;
        let tiles = rows.chunks(LANES * self.width).zip(actions.chunks_mut(LANES * ACTION));
        let one = Lanes::from_f64(1.0);
        for (scratch, (rows, out)) in self.tiles.iter_mut().zip(tiles) {
            let x = &mut scratch.layer[0];
            x.clear();
            x.resize(self.width, Lanes::zero());
            for (lane, row) in rows.chunks_exact(self.width).enumerate() {
                x.iter_mut().zip(row).for_each(|(slot, value)| slot.array_mut()[lane] = *value);
            }
            let answer = self.network.answer(scratch).map(|number| number.clamp(-one, one));
            write(&answer, out, ACTION);
        }
        Ok(())
    }
}
