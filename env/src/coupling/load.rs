//! A load that hangs on ropes below the drones: springs that only pull, with the damping of a braided cord.

use crate::effects::Neighbour;
use crate::error::{Result, check_range};
use crate::scalar::Scalar;

/// The load and its suspension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Mass of the load alone, without the ropes, which weigh nothing.
    pub mass_kg: f64,
    /// Length of each rope.
    pub rope_m: f64,
}

/// Stiffness of a rope: a load of 10 g stretches it by 2.5 mm.
const STIFFNESS_NPM: f64 = 40.0;
/// Damping along a rope: a tenth of critical for 10 g.
const DAMPING_NSPM: f64 = 0.12;
/// The load swings on steps of a control tick divided by this: a rope's own oscillation lasts a tenth of a
/// second.
const STEPS: usize = 8;

/// A load in motion.
#[derive(Debug, Clone, Copy)]
pub struct State<R> {
    /// Position in the world frame.
    pub pos_m: [R; 3],
    /// Velocity in the world frame.
    pub vel_mps: [R; 3],
}

impl<R: Scalar> State<R> {
    /// Returns a load at the origin without velocity.
    pub fn rest() -> Self {
        State { pos_m: [R::zero(); 3], vel_mps: [R::zero(); 3] }
    }
}

impl Load {
    /// Creates a load for so many drones.
    ///
    /// # Errors
    /// [`crate::Error::Range`] for more than they lift.
    pub fn new(mass_kg: f64, rope_m: f64, drones: usize) -> Result<Self> {
        // a Crazyflie lifts 15 g (Bitcraze's data sheet)
        check_range("load_kg", mass_kg, 0.001, 0.015 * drones as f64)?;
        Ok(Load { mass_kg, rope_m })
    }

    /// Returns the place of the load at rest below drones at `places`.
    pub fn hangs(&self, places: impl ExactSizeIterator<Item = [f64; 3]> + Clone) -> [f64; 3] {
        let n = places.len() as f64;
        let middle: [f64; 3] = std::array::from_fn(|i| places.clone().map(|p| p[i]).sum::<f64>() / n);
        let across2 =
            places.map(|p| (p[0] - middle[0]).powi(2) + (p[1] - middle[1]).powi(2)).fold(0.0, f64::max);
        [
            middle[0],
            middle[1],
            (middle[2] - libm::sqrt((self.rope_m * self.rope_m - across2).max(0.0))).max(0.0),
        ]
    }

    /// Move on by a tick of `tick_s`, with `drones` as they are at its start, accelerating by `free_mps2` if
    /// no rope pulled. Writes the mean acceleration that its rope gives each drone of `drone_kg` over the
    /// tick.
    #[inline(always)]
    pub fn step<R: Scalar>(
        &self,
        load: &mut State<R>,
        drones: &[Neighbour<R>],
        free_mps2: &[[R; 3]],
        ropes: Ropes<'_, R>,
        [tick_s, gravity_mps2]: [f64; 2],
    ) {
        let Ropes { moving, pulls_mps2, drone_kg } = ropes;
        let h = R::from_f64(tick_s / STEPS as f64);
        moving.copy_from_slice(drones);
        pulls_mps2.fill([R::zero(); 3]);
        for _ in 0..STEPS {
            let mut acc = [R::zero(), R::zero(), R::from_f64(-gravity_mps2)];
            for (j, drone) in moving.iter_mut().enumerate() {
                let pull_n = self.pull(load, drone);
                for i in 0..3 {
                    acc[i] += pull_n[i] * R::from_f64(1.0 / self.mass_kg);
                    let pulled = -pull_n[i] / drone_kg[j];
                    pulls_mps2[j][i] += pulled * R::from_f64(1.0 / STEPS as f64);
                    drone.vel_mps[i] += h * (free_mps2[j][i] + pulled);
                    drone.pos_m[i] += h * drone.vel_mps[i];
                }
            }
            for i in 0..3 {
                load.vel_mps[i] += h * acc[i];
                load.pos_m[i] += h * load.vel_mps[i];
            }
            // on the floor it lies
            let below = load.pos_m[2].lt(R::zero());
            load.pos_m[2] = load.pos_m[2].max(R::zero());
            for v in &mut load.vel_mps {
                *v = R::select(below, R::zero(), *v);
            }
        }
    }

    /// The force of a drone's rope on the load.
    #[inline(always)]
    fn pull<R: Scalar>(&self, load: &State<R>, drone: &Neighbour<R>) -> [R; 3] {
        let (mut along, mut away, mut length2) = ([R::zero(); 3], R::zero(), R::from_f64(1e-12));
        for i in 0..3 {
            along[i] = drone.pos_m[i] - load.pos_m[i];
            length2 += along[i] * along[i];
        }
        let length = length2.sqrt();
        for i in 0..3 {
            along[i] = along[i] / length;
            away += along[i] * (drone.vel_mps[i] - load.vel_mps[i]);
        }
        let stretch = length - R::from_f64(self.rope_m);
        let force = (R::from_f64(STIFFNESS_NPM) * stretch + R::from_f64(DAMPING_NSPM) * away).max(R::zero());
        let taut = drone.here * R::select(stretch.gt(R::zero()), force, R::zero());
        for a in &mut along {
            *a = *a * taut;
        }
        along
    }
}

/// Buffers for the drones' motion within a tick, and the forces of the ropes.
pub struct Ropes<'a, R> {
    /// Scratch space: the drones between the start and the end of the tick.
    pub moving: &'a mut [Neighbour<R>],
    /// Pull on each drone.
    pub pulls_mps2: &'a mut [[R; 3]],
    /// Mass of each drone.
    pub drone_kg: &'a [R],
}
