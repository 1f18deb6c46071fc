//! Additions to a world for fitting: effects that stay in the loop at any value, parameters and states that carry
//! derivatives, and a camera frame at any time.

use std::slice::{from_mut, from_ref};

use super::setup::{active, body};
use super::{Settings, State, World};
use crate::dual::DualNumber;
use crate::effect_table::EffectTable;
use crate::effects::{self, Entry, Frame, HookContext, Tiles};
use crate::error::{Error, Result};
use crate::model::{Model, VerticalInput};
use crate::number::Number;
use crate::plant::{Accelerations, Plant};
use crate::sim_scalar::SimScalar;

/// Relative step of a model parameter to each side for the derivatives of the discretised model.
const NUDGE: f64 = 1e-5;

impl<R: SimScalar> World<R> {
    /// One drone without a floor, with the model's own effects and `tried` in the loop, whatever the values
    /// of their parameters. A voltage given later by [`World::set_voltage`] takes the place of the simulated
    /// battery.
    ///
    /// # Errors
    /// The errors of [`World::new`]; [`Error::Config`] for the motor-level form, whose motors and loops are in no
    /// log.
    pub fn for_fitting(model: &Model, tried: &[&'static Entry], settings: Settings) -> Result<Self> {
        if settings.input == VerticalInput::Motors {
            return Err(Error::Config(
                "the vertical form \"motors\" is a data sheet's and is not fitted to logs: choose height, pwm or \
                 thrust"
                    .into(),
            ));
        }
        let mut all = active(model, &EffectTable::new(), settings.input)?;
        for entry in tried {
            let (place, _) = effects::find(entry.name)?;
            all.retain(|(other, ..)| *other != place);
            all.push((place, entry, entry.params.iter().map(|p| Number::Fixed(p.off)).collect()));
        }
        all.sort_by_key(|(place, ..)| *place);
        Ok(Self::assemble(model, all, settings, 1)?.without_floor())
    }

    /// Give an effect its parameters, in the order of its registry entry.
    ///
    /// # Errors
    /// [`Error::Unknown`] for an effect that is not in the loop.
    pub fn set_params(&mut self, effect: &str, params: &[R]) -> Result<()> {
        let index = self.names.iter().position(|name| *name == effect);
        let stage = index.ok_or_else(|| {
            crate::error::unknown("effect of this world", effect, self.names.iter().copied())
        })?;
        self.stages[stage].numbers().set_params(params);
        Ok(())
    }

    /// Sets another state and leaves the memory of effects (of past commands, say) as it is. `acc_mps2` is the
    /// acceleration until now, from which pushes expect the velocity in the middle of the next step.
    pub fn set_state(&mut self, x: &State<R>, acc_mps2: [R; 3]) {
        self.states[0] = *x;
        self.tiles[0].acc_mps2 = acc_mps2;
    }

    /// Show all that effects remember.
    pub fn visit_memory(&mut self, see: &mut dyn FnMut(&mut R)) {
        for stage in &mut self.stages {
            stage.numbers().visit(false, see);
        }
    }

    /// Show what is remembered of the motion besides velocities and rates: the lagged pushes of the model's
    /// forms where it has them (see [`Model::lags_push`]), then what effects remember (see
    /// [`effects::Effect::MOTION_STATES`]), effect by effect.
    pub fn visit_lags(&mut self, lags_push: [bool; 2], see: &mut dyn FnMut(&mut R)) {
        let pushes = self.states[0].aux.iter_mut().zip(lags_push);
        pushes.filter(|(_, lags)| *lags).for_each(|(push, _)| see(push));
        for stage in &mut self.stages {
            stage.numbers().visit(true, see);
        }
    }

    /// Sets the time since the start of the flight, for effects that grow with time.
    pub fn set_time(&mut self, t_s: f64) {
        self.ages[0].ticks = R::from_f64(t_s / self.tick_s);
    }

    /// Accelerate the vehicle, from now on, besides what effects do.
    pub fn disturb(&mut self, push: Accelerations<R>) {
        self.disturbance = Some(push);
    }

    /// Sets the measured battery voltage of the next tick.
    pub fn set_voltage(&mut self, measured_v: Option<R>) {
        self.voltage_v = measured_v;
    }

    /// The state `share` of a control tick before its end, between the states at its ends.
    pub fn between(&self, before: &State<R>, after: &State<R>, share: R) -> State<R> {
        before.look_back(after, share, self.tick_s)
    }

    /// The frame that the marker detection would report of the state `x`, captured at `t_s`; its time is the
    /// stamp that it would carry.
    pub fn film(&mut self, x: &State<R>, t_s: R) -> Frame<R> {
        let all = R::zero().le(R::zero());
        let mut frame = Frame::from_state(x, all, t_s);
        let draw = self.ages[0].draw();
        let cx = HookContext {
            h_s: self.schedule.seconds(self.schedule.camera),
            t_s,
            clock: self.clocks[0],
            ..HookContext::new(&self.body, self.tick_s, &draw, self.voltage_v.as_ref())
        };
        for &i in &self.order.frame {
            self.stages[i]
                .frame(&Tiles { first: 0, cx: from_ref(&cx), x: from_ref(x), u: &[] }, from_mut(&mut frame));
        }
        frame
    }
}

impl<const D: usize> World<DualNumber<D>>
where
    DualNumber<D>: SimScalar,
{
    /// Carry the derivatives of the model itself: `seeds` names parameters by path (see
    /// [`Model::parameters`]) and the direction of each.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a path that the model lacks.
    pub fn seed_model(&mut self, model: &Model, settings: Settings, seeds: &[(&str, usize)]) -> Result<()> {
        let h_s = self.tick_s / f64::from(self.steps_per_tick);
        let of = |m: &Model| -> Result<Vec<f64>> {
            let (mut plant, mut body) =
                (Plant::<f64>::new(m, settings.input, h_s)?, body::<f64>(m, settings.input)?);
            Ok(plant.numbers().chain(body.numbers()).map(|number| *number).collect())
        };
        self.plant = Plant::new(model, settings.input, h_s)?;
        self.body = body(model, settings.input)?;
        for (path, direction) in seeds {
            let value = model.parameter(path)?;
            let step = NUDGE * value.abs().max(NUDGE);
            // at the edge of what a model may hold (no drag), to one side only
            let moved = |to: f64| {
                model.with_parameter(path, to).map_or_else(|_| (value, model.clone()), |model| (to, model))
            };
            let ((high, up), (low, down)) = (moved(value + step), moved(value - step));
            let numbers = self.plant.numbers().chain(self.body.numbers());
            for (number, (up, down)) in numbers.zip(of(&up)?.into_iter().zip(of(&down)?)) {
                number.slope[*direction] = if high > low { ((up - down) / (high - low)) as f32 } else { 0.0 };
            }
        }
        Ok(())
    }
}
