//! Any controller of the registry for worlds of several drones, with the layer that avoids collisions or
//! without it.

use super::avoidance::{CollisionAvoidance, MeasuredMotion};
use super::batch::mask;
use super::{Controller, ExtraInputs, InputNeeds, Mode};
use crazyflie_env::action::ACTION;
use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::error::{Result, check_length};
use crazyflie_env::lanes::{LANES, Lanes};
use crazyflie_env::observation::{OBSERVATION, SETPOINT};
use crazyflie_env::scalar::{Scalar, tabulate};
use crazyflie_env::vector::{BatchController, STATE};

impl BatchController for MultiController {
    fn act(&mut self, measured: &[f32], actions: &mut [f32]) -> Result<()> {
        MultiController::act(self, measured, actions)
    }
    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        MultiController::reset(self, of);
    }
}

impl BatchController for Box<dyn Controller> {
    fn act(&mut self, measured: &[f32], actions: &mut [f32]) -> Result<()> {
        (**self).act(measured, actions)
    }
    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        (**self).reset(of);
    }
}

/// A controller for each drone of a batch of worlds.
pub struct MultiController {
    /// Each of them flies one drone in all worlds.
    controllers: Vec<Box<dyn Controller>>,
    avoid: Option<CollisionAvoidance>,
    /// By drone, then by sixteen worlds.
    motions: Vec<Vec<MeasuredMotion<Lanes>>>,
    /// The others of a drone in sixteen worlds.
    near: Vec<[Lanes; NEIGHBOUR]>,
    worlds: usize,
    /// Number of others that a drone observes.
    others: usize,
    tick_s: f64,
    /// One drone's rows in all worlds.
    observations: Vec<f32>,
    actions: Vec<f32>,
    /// True states of all drones, if they are known for the next actions.
    states: Vec<f32>,
    /// One drone's true states and its knowledge of others, in all worlds.
    inputs: [Vec<f32>; 2],
}

impl MultiController {
    /// One controller for each drone, each made for `worlds` environments; `tick_s` between observations.
    ///
    /// # Errors
    /// [`crazyflie_env::Error::Range`] for `avoid`.
    pub fn new(
        controllers: Vec<Box<dyn Controller>>,
        worlds: usize,
        avoid: Option<CollisionAvoidance>,
        tick_s: f64,
    ) -> Result<Self> {
        let others = controllers.len().saturating_sub(1);
        MultiController::among(controllers, others, worlds, avoid, tick_s)
    }

    /// Makes controllers for some drones of each world, each of which sees so many others; one controller flies one
    /// drone for itself.
    ///
    /// # Errors
    /// The errors of [`MultiController::new`].
    pub fn among(
        controllers: Vec<Box<dyn Controller>>,
        others: usize,
        worlds: usize,
        avoid: Option<CollisionAvoidance>,
        tick_s: f64,
    ) -> Result<Self> {
        if let Some(avoid) = &avoid {
            avoid.check()?;
        }
        for (drone, controller) in controllers.iter().enumerate() {
            controller.needs().check_others(&format!("controller of drone {drone}"), others)?;
        }
        let motions = vec![vec![MeasuredMotion::new(); worlds.div_ceil(LANES)]; controllers.len()];
        Ok(MultiController {
            controllers,
            avoid,
            motions,
            near: vec![[Lanes::zero(); NEIGHBOUR]; others],
            worlds,
            others,
            tick_s,
            observations: vec![0.0; worlds * OBSERVATION],
            actions: vec![0.0; worlds * ACTION],
            states: Vec::new(),
            inputs: [Vec::new(), Vec::new()],
        })
    }

    /// Sets the mode of all drones, see [`Controller::set_mode`].
    pub fn set_mode(&mut self, mode: Mode) {
        self.controllers.iter_mut().for_each(|controller| controller.set_mode(mode));
    }

    /// Forget the flights of the worlds that `of` names.
    pub fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        self.controllers.iter_mut().for_each(|controller| controller.reset(of));
        for tiles in &mut self.motions {
            for (tile, motion) in tiles.iter_mut().enumerate() {
                motion.reset(mask(tile, self.worlds, of));
            }
        }
    }

    /// Forget the flights of one drone in all worlds: it was flown by somebody else.
    pub fn take_over(&mut self, drone: usize) {
        self.controllers[drone].reset(&|_| true);
        self.motions[drone].iter_mut().for_each(|motion| motion.reset(!Lanes::nothing()));
    }

    /// Returns what its controllers need beside measured rows, the others aside; see [`Self::set_states`].
    pub fn needs(&self) -> InputNeeds {
        InputNeeds { truth: self.controllers.iter().any(|controller| controller.needs().truth), others: 0 }
    }

    /// Sets the true states (worlds x drones rows of [`STATE`]) for the next actions.
    pub fn set_states(&mut self, states: &[f32]) {
        self.states.clear();
        if self.needs().truth {
            self.states.extend_from_slice(states);
        }
    }

    /// Actions (worlds x drones rows of [`ACTION`]) for observations (worlds x drones rows of
    /// [`crazyflie_env::vector::VectorEnv::width`]).
    ///
    /// # Errors
    /// [`crazyflie_env::Error::Shape`].
    pub fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        let (n, worlds) = (self.controllers.len(), self.worlds);
        let width = OBSERVATION + NEIGHBOUR * self.others;
        check_length("observations", worlds * n * width, observations.len())?;
        check_length("actions", worlds * n * ACTION, actions.len())?;
        for drone in 0..n {
            let rows = observations.chunks_exact(width).skip(drone).step_by(n);
            for (own, row) in self.observations.chunks_exact_mut(OBSERVATION).zip(rows) {
                own.copy_from_slice(&row[..OBSERVATION]);
            }
            if let Some(avoid) = self.avoid {
                self.keep_out(&avoid, drone, observations);
            }
            self.pass_inputs(drone, observations);
            self.controllers[drone].act(&self.observations, &mut self.actions)?;
            let rows = actions.chunks_exact_mut(ACTION).skip(drone).step_by(n);
            for (row, own) in rows.zip(self.actions.chunks_exact(ACTION)) {
                row.copy_from_slice(own);
            }
        }
        self.states.clear();
        Ok(())
    }

    /// Passes on to a drone's controller what it needs beside the drone's measurements.
    fn pass_inputs(&mut self, drone: usize, observations: &[f32]) {
        let (n, width) = (self.controllers.len(), OBSERVATION + NEIGHBOUR * self.others);
        let controller = &mut self.controllers[drone];
        let InputNeeds { truth, others } = controller.needs();
        if !truth && others == 0 {
            return;
        }
        let [states, near] = &mut self.inputs;
        states.clear();
        states.extend(self.states.chunks_exact(STATE).skip(drone).step_by(n).flatten());
        near.clear();
        near.extend(
            observations.chunks_exact(width).skip(drone).step_by(n).flat_map(|row| &row[OBSERVATION..]),
        );
        controller.set_inputs(ExtraInputs { states, others: near });
    }

    /// The avoidance's set-points in place of the mission's.
    fn keep_out(&mut self, avoid: &CollisionAvoidance, drone: usize, observations: &[f32]) {
        let (n, worlds) = (self.controllers.len(), self.worlds);
        let width = OBSERVATION + NEIGHBOUR * self.others;
        let tiles = self.observations.chunks_mut(LANES * OBSERVATION).zip(&mut self.motions[drone]);
        for (tile, (rows, motion)) in tiles.enumerate() {
            let (first, lanes) = (tile * LANES, LANES.min(worlds - tile * LANES));
            let read = |at: usize| {
                let mut v = Lanes::zero();
                for lane in 0..lanes {
                    v.array_mut()[lane] = observations[((first + lane) * n + drone) * width + at];
                }
                v
            };
            for (k, near) in self.near.iter_mut().enumerate() {
                *near = tabulate(|c| read(OBSERVATION + k * NEIGHBOUR + c));
            }
            let target_m = tabulate(|i| read(SETPOINT.first + i));
            let change_m = avoid.filter(motion, tabulate(read), target_m, &self.near, self.tick_s);
            for (lane, row) in rows.chunks_exact_mut(OBSERVATION).enumerate() {
                for (slot, change) in row[SETPOINT.first..].iter_mut().zip(&change_m) {
                    *slot += change.array()[lane];
                }
            }
        }
    }
}
