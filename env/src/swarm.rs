//! What the drones of one environment have in common at a tick. The batch runs it on lanes, and a recording on
//! symbols.

use crate::effects::Neighbour;
use crate::plant::State;
use crate::scalar::Scalar;
use crate::task::{crashed, outside};
use crate::world::Contact;

/// A drone as the others feel it, in the lanes of `flies`.
#[inline(always)]
pub(crate) fn neighbour<R: Scalar>(x: &State<R>, flies: R::Mask) -> Neighbour<R> {
    Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::select(flies, R::from_f64(1.0), R::zero()) }
}

/// Where a drone will be half a tick later.
#[inline(always)]
pub(crate) fn look_ahead<R: Scalar>(seen: &mut Neighbour<R>, acc_mps2: &[R; 3], half_tick_s: R) {
    for i in 0..3 {
        seen.pos_m[i] += half_tick_s * seen.vel_mps[i];
        seen.vel_mps[i] += half_tick_s * acc_mps2[i];
    }
}

/// Marks who is nearer to another than two radii, and notes the smallest square of a distance.
#[inline(always)]
pub(crate) fn mark_hits<R: Scalar>(
    scene: &[Neighbour<R>],
    radius_m: f64,
    hit: &mut [R::Mask],
    nearest2_m2: &mut R,
) {
    let (n, near2) = (scene.len(), R::from_f64(4.0 * radius_m * radius_m));
    hit.fill(R::nothing());
    for a in 0..n {
        for b in a + 1..n {
            let (p, q) = (&scene[a], &scene[b]);
            let [dx, dy, dz] = [p.pos_m[0] - q.pos_m[0], p.pos_m[1] - q.pos_m[1], p.pos_m[2] - q.pos_m[2]];
            let both = R::zero().lt(p.here * q.here);
            let far2 = R::select(both, dx * dx + dy * dy + dz * dz, *nearest2_m2);
            *nearest2_m2 = nearest2_m2.min(far2);
            let touches = both & far2.lt(near2);
            hit[a] = hit[a] | touches;
            hit[b] = hit[b] | touches;
        }
    }
}

/// How a flight came to harm.
#[derive(Clone, Copy)]
pub(crate) struct Harm<R: Scalar> {
    pub(crate) hit: R::Mask,
    pub(crate) crash: R::Mask,
    /// What the task's reward becomes by it.
    pub(crate) reward: R,
}

impl<R: Scalar> Harm<R> {
    /// Of a drone that `flies`, was `hit` or not, and is at `x`.
    #[inline(always)]
    pub(crate) fn new(
        [flies, hit]: [R::Mask; 2],
        x: &State<R>,
        contact: &Contact<R>,
        (reward, cost): (R, f64),
    ) -> Self {
        let hit = flies & hit;
        let crash = flies & (outside(x) | crashed(contact)) & !hit;
        let cost = R::select(hit | crash, R::from_f64(cost), R::zero());
        Harm { hit, crash, reward: R::select(flies, reward, R::zero()) - cost }
    }
}
