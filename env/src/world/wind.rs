//! Wind that differs from place to place: effects on the motion through the air see the velocity against it.

use super::{GROUP, World};
use crate::effects::registry;
use crate::error::{Error, Result};
use crate::lanes::LANES;
use crate::plant::{Accelerations, State};
use crate::scalar::{Scalar, tabulate};
use crate::sim_scalar::{BatchScalar, SimScalar};
use crate::wind_field::WindField;

/// A wind field, and what it acts on.
pub(super) struct Wind<R: Scalar> {
    field: WindField,
    sample: fn(&WindField, &[R; 3]) -> [R; 3],
    /// Rate at which the model itself loses velocity, by axis: its part of the drag.
    drag_ps: [R; 3],
    /// The velocity of the air at each tile, and the states with velocities against it.
    pub(super) velocity_mps: [[R; 3]; GROUP],
    pub(super) in_air: [State<R>; GROUP],
}

impl<R: Scalar> Wind<R> {
    /// Looks up the wind where the drones are; `middle` are the states that pushes see.
    #[inline(always)]
    pub(super) fn meet(&mut self, middle: &[State<R>]) {
        for (i, x) in middle.iter().enumerate() {
            let velocity_mps = (self.sample)(&self.field, &x.pos_m);
            self.velocity_mps[i] = velocity_mps;
            self.in_air[i] = State {
                vel_mps: tabulate(
                    #[inline(always)]
                    |k| x.vel_mps[k] - velocity_mps[k],
                ),
                ..*x
            };
        }
    }

    /// Adds the drag of the wind, which the model lacks: its own drag uses the velocity over the ground alone.
    #[inline(always)]
    pub(super) fn push(&self, tile: usize, push: &mut Accelerations<R>) {
        for k in 0..3 {
            push.acc_mps2[k] += self.drag_ps[k] * self.velocity_mps[tile][k];
        }
    }
}

fn sample_lanes<R: BatchScalar>(field: &WindField, pos_m: &[R; 3]) -> [R; 3] {
    let mut velocity_mps = [R::zero(); 3];
    for lane in 0..LANES {
        let wind = field.velocity_mps([pos_m[0].lane(lane), pos_m[1].lane(lane), pos_m[2].lane(lane)]);
        for (slot, wind) in velocity_mps.iter_mut().zip(wind) {
            slot.set_lane(lane, wind);
        }
    }
    velocity_mps
}

impl<R: SimScalar> World<R> {
    /// Lets a wind blow from now on.
    ///
    /// # Errors
    /// [`Error::Config`] where nothing would feel it: the model has no drag along it, and no effect that has is on.
    pub(crate) fn set_wind(&mut self, field: &WindField) -> Result<()>
    where
        R: BatchScalar,
    {
        let [drag_ps, _, heave_ps] = self.drag_ps;
        let by_model = drag_ps != 0.0 || (heave_ps != 0.0 && field.is_vertical());
        if !by_model && !self.feels_air.contains(&true) {
            let names: Vec<_> = registry().iter().filter(|entry| entry.feels_air).map(|e| e.name).collect();
            return Err(Error::Config(format!(
                "wind_field: nothing feels the air: the model's lateral.drag is 0, and none of the effects {} is on, \
                 such as effects={{\"drag_linear\": 0.3}}",
                names.join(", ")
            )));
        }
        self.wind = Some(Wind {
            field: field.clone(),
            sample: sample_lanes::<R>,
            drag_ps: self.drag_ps.map(R::from_f64),
            velocity_mps: [[R::zero(); 3]; GROUP],
            in_air: [State::rest(); GROUP],
        });
        Ok(())
    }
}
