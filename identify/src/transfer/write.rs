//! A transfer function as a part of a model file, where the model has that form.

use crazyflie_env::model::{Model, Quantity, Vertical, Yaw};

use super::{Channel, Structure, TransferFunctionEstimate};
use crate::Result;

impl TransferFunctionEstimate {
    /// Returns a copy of the model with this transfer function in its place; `logs` name its source.
    ///
    /// # Errors
    /// [`crate::Error::Options`] if the model has no such form, [`crate::Error::Model`] if it refuses a
    /// value.
    pub fn in_model(&self, model: &Model, logs: &str) -> Result<Model> {
        let Structure { numerator, denominator, integrator, delay, .. } = self.structure;
        let refused = |reason| self.structure.refused(reason);
        if delay {
            return Err(refused("a model file holds no delay: declare the effect cmd_delay instead"));
        }
        let quantity = |name: &str, unit: &str, sign: f64| {
            let found = self.parameters.iter().find(|p| p.name == name);
            found.map(|p| {
                let source = format!(
                    "identified from {logs}: standard error {:.3e}, {}",
                    p.standard_error, self.clusters
                );
                Quantity { value: sign * p.value, unit: unit.to_owned(), source }
            })
        };
        let need = |name, unit, sign| {
            quantity(name, unit, sign).ok_or_else(|| refused("the model has no such form"))
        };
        let not_first = || refused("the model's vertical form is not of first order");
        let mut model = model.clone();
        match (self.channel, numerator, denominator, integrator) {
            (Channel::Roll | Channel::Pitch, 0, 2, false) => {
                let tilt = if self.channel == Channel::Roll { &mut model.roll } else { &mut model.pitch };
                (tilt.gain, tilt.damping) = (need("b0", "1/s^2", 1.0)?, need("a1", "1/s", 1.0)?);
                tilt.stiffness = need("a0", "1/s^2", 1.0)?;
            }
            (Channel::Yaw, 0, 1, true) => model.yaw = Yaw::Integrator { gain: need("b0", "1", 1.0)? },
            (Channel::Yaw, 0, 2, true) => {
                let bandwidth = need("a1", "1/s", 1.0)?;
                let mut gain = need("b0", "1", 1.0)?;
                gain.value /= bandwidth.value;
                gain.source = format!("identified from {logs}: b0 / a1");
                model.yaw = Yaw::Rate { gain, bandwidth };
            }
            (Channel::Height, 0, 1, false) => {
                let (gain, pole) = (need("b0", "1/s", 1.0)?, need("a0", "1/s", 1.0)?);
                put_vertical(&mut model.vertical.height, gain, pole, None).ok_or_else(not_first)?;
            }
            (Channel::Pwm, 0, 1, false) => {
                let (gain, pole) = (need("b0", "m/s", 1.0)?, need("a0", "1/s", 1.0)?);
                let offset = quantity("offset", "1", 1.0);
                put_vertical(&mut model.vertical.pwm, gain, pole, offset).ok_or_else(not_first)?;
            }
            (Channel::Vx | Channel::Vy, 0, 1, _) => {
                // roll accelerates to -y
                let sign = if self.channel == Channel::Vx { 1.0 } else { -1.0 };
                model.lateral.gravity = need("b0", "m/s^2", sign)?;
                if let Some(drag) = quantity("a0", "1/s", 1.0) {
                    model.lateral.drag = drag;
                }
            }
            _ => return Err(refused("the model has no such form")),
        }
        // units and ranges are checked where a model is read
        Ok(Model::parse(&model.to_toml()?)?)
    }
}

fn put_vertical(
    form: &mut Option<Vertical>,
    new_gain: Quantity,
    new_pole: Quantity,
    new_offset: Option<Quantity>,
) -> Option<()> {
    let Some(Vertical::FirstOrder { gain, pole, offset, .. }) = form else { return None };
    (*gain, *pole) = (new_gain, new_pole);
    *offset = new_offset.or(offset.take());
    Some(())
}
