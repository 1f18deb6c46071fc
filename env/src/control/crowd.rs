//! The thesis PID for worlds of several drones, with the layer that avoids collisions or without it.

use super::avoid::Avoid;
use super::pid::{Gains, Mode, Pid};
use crate::error::Result;
use crate::lanes::{LANES, LaneMask, Lanes};
use crate::observation::{ACTION, Interface, OBSERVATION};
use crate::real::{Real, tabulate};
use crate::rows::shape;
use crate::swarm::NEIGHBOUR;

/// One drone in sixteen worlds.
#[derive(Debug, Clone)]
struct Pilot {
    pid: Pid<Lanes>,
    /// The set-point that the avoidance moves.
    at_m: [Lanes; 3],
    fresh: LaneMask,
}

/// A PID for each drone of a batch of worlds, row by row as they observe.
#[derive(Debug, Clone)]
pub struct Crowd {
    /// By sixteen worlds, then by drone.
    pilots: Vec<Pilot>,
    avoid: Option<Avoid>,
    worlds: usize,
    drones: usize,
    dt_s: f64,
}

impl Crowd {
    /// For worlds of as many drones as there are `interfaces`, with a tick of `dt_s`.
    ///
    /// # Errors
    /// [`crate::Error::Range`] for `avoid`.
    pub fn new(worlds: usize, interfaces: &[Interface], gains: Gains, avoid: Option<Avoid>, dt_s: f64) -> Result<Self> {
        if let Some(avoid) = &avoid {
            avoid.check()?;
        }
        let pilot = |interface: &Interface| Pilot {
            pid: Pid::new(gains, *interface, dt_s, Mode::Automatic),
            at_m: [Lanes::zero(); 3],
            fresh: !Lanes::nothing(),
        };
        let tile: Vec<Pilot> = interfaces.iter().map(pilot).collect();
        let pilots = (0..worlds.div_ceil(LANES)).flat_map(|_| tile.iter().cloned()).collect();
        Ok(Crowd { pilots, avoid, worlds, drones: interfaces.len(), dt_s })
    }

    /// Forget the flights of the worlds that `of` names.
    pub fn reset(&mut self, of: impl Fn(usize) -> bool) {
        for (i, pilot) in self.pilots.iter_mut().enumerate() {
            let mask = LaneMask::from_bools(std::array::from_fn(|lane| of(i / self.drones * LANES + lane)));
            pilot.pid.reset(mask);
            pilot.fresh = pilot.fresh | mask;
        }
    }

    /// Actions (worlds x drones rows of [`ACTION`]) for observations (worlds x drones rows of [`crate::swarm::SwarmEnv::width`]).
    ///
    /// # Errors
    /// [`crate::Error::Shape`].
    pub fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        let (n, worlds) = (self.drones, self.worlds);
        let width = OBSERVATION + NEIGHBOUR * (n - 1);
        shape("observations", worlds * n * width, observations.len())?;
        shape("actions", worlds * n * ACTION, actions.len())?;
        for (i, pilot) in self.pilots.iter_mut().enumerate() {
            let (first, drone) = (i / n * LANES, i % n);
            let rows = |lane: usize| (first + lane) * n + drone;
            let lanes = LANES.min(worlds - first);
            let read = |at: usize| {
                let mut v = Lanes::zero();
                for lane in 0..lanes {
                    v.0[lane] = observations[rows(lane) * width + at];
                }
                v
            };
            let mut o: [Lanes; OBSERVATION] = tabulate(read);
            if let Some(avoid) = &self.avoid {
                let others = (0..n - 1).map(|k| tabulate(|c| read(OBSERVATION + k * NEIGHBOUR + c)));
                pilot.keep_out(avoid, &mut o, self.dt_s, others);
            }
            let a = pilot.pid.act(&o);
            for lane in 0..lanes {
                for (slot, value) in actions[rows(lane) * ACTION..].iter_mut().zip(&a) {
                    *slot = value.0[lane];
                }
            }
        }
        Ok(())
    }
}

impl Pilot {
    /// The avoidance's set-point in place of the mission's.
    fn keep_out(&mut self, avoid: &Avoid, o: &mut [Lanes; OBSERVATION], dt_s: f64, others: impl Iterator<Item = [Lanes; NEIGHBOUR]>) {
        let (own_m, target_m) = ([o[0], o[1], o[2]], [o[16], o[17], o[18]]);
        for i in 0..3 {
            self.at_m[i] = Lanes::select(self.fresh, own_m[i], self.at_m[i]);
        }
        self.fresh = Lanes::nothing();
        avoid.advance(&mut self.at_m, own_m, target_m, dt_s, others);
        o[16..19].copy_from_slice(&self.at_m);
    }
}
