//! A drone's knowledge of the others: everything, those in range, or the last radio messages.

use serde::{Deserialize, Serialize};

use crate::archive::Archive;
use crate::effects::{Neighbour, PoseFix};
use crate::error::{Result, check_range};
use crate::noise::{TickRng, channel};
use crate::observation::{Field, field};
use crate::scalar::{Scalar, merge, tabulate};
use crate::sim_scalar::BatchScalar;

/// Numbers that an observation has for each of the others.
pub const NEIGHBOUR: usize = 8;

/// Farther than anything in the room, and faster.
const FAR_M: f64 = 10.0;
const FAST_MPS: f64 = 40.0;
/// Age beyond which a message is ignored.
const STALE_S: f64 = 1.0;

/// The layout of what an observation has for each of the others; all zero while nothing is known of it.
pub const NEIGHBOUR_FIELDS: [Field; 4] = [
    field("pos_m", 0, 3, "m", [-FAR_M, FAR_M]).about("place relative to the own, in the room's axes"),
    field("vel_mps", 3, 3, "m/s", [-FAST_MPS, FAST_MPS]).about("velocity relative to the own"),
    field("age_s", 6, 1, "s", [0.0, STALE_S]).about("time since it was there"),
    field("known", 7, 1, "1", [0.0, 1.0]).about("1 where it flies and is known"),
];

/// Source of the knowledge about the others.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "by")]
pub enum Knowledge {
    /// Their true state, now.
    Ideal,
    /// The same, of those within range.
    Range {
        /// Largest distance between two drones that know of each other, 0 to 100 m.
        range_m: f64,
    },
    /// Each drone broadcasts its camera's fix by radio; the message arrives late, and sometimes not at all.
    Radio {
        /// Time from a message to its arrival, at most 31 control ticks.
        #[serde(default)]
        delay_s: f64,
        /// Probability that one receiver misses one message.
        #[serde(default)]
        loss: f64,
    },
}

/// Ticks for which messages are kept.
const RING: usize = 32;
/// A message: place, velocity, time.
const MESSAGE: usize = 7;

impl Knowledge {
    /// # Errors
    /// [`crate::Error::Range`].
    pub fn check(&self, tick_s: f64) -> Result<()> {
        match *self {
            Knowledge::Ideal => {}
            Knowledge::Range { range_m } => drop(check_range("neighbours.range_m", range_m, 0.0, 100.0)?),
            Knowledge::Radio { delay_s, loss } => {
                check_range("neighbours.delay_s", delay_s, 0.0, (RING - 1) as f64 * tick_s)?;
                check_range("neighbours.loss", loss, 0.0, 1.0)?;
            }
        }
        Ok(())
    }
}

/// Knowledge of the drones of a tile of environments about each other.
pub(crate) struct Communication<R> {
    how: Knowledge,
    drones: usize,
    /// Ticks that a message takes.
    late: usize,
    /// Ticks so far.
    clock: usize,
    radio: Option<Radio<R>>,
}

struct Radio<R> {
    /// By tick, then by sender.
    said: Vec<[R; MESSAGE]>,
    /// By receiver, then by sender.
    heard: Vec<[R; MESSAGE]>,
    /// The fix from which each drone last derived its velocity.
    fixes: Vec<PoseFix<R>>,
}

impl<R: Scalar> Communication<R> {
    pub(crate) fn new(how: Knowledge, drones: usize, tick_s: f64) -> Self {
        let none = [R::zero(); MESSAGE];
        let fix = PoseFix { pos_m: [R::zero(); 3], yaw_rad: R::zero(), t_s: R::zero(), valid: R::zero() };
        let (late, radio) = match how {
            Knowledge::Radio { delay_s, .. } => {
                let radio = Radio {
                    said: vec![none; RING * drones],
                    heard: vec![none; drones * drones],
                    fixes: vec![fix; drones],
                };
                ((delay_s / tick_s).round() as usize, Some(radio))
            }
            _ => (0, None),
        };
        Communication { how, drones, late, clock: 0, radio }
    }

    /// Archives the messages sent and received.
    pub(crate) fn archive(&mut self, archive: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
        archive.count(&mut self.clock);
        let Some(radio) = &mut self.radio else { return };
        radio.said.iter_mut().chain(&mut radio.heard).for_each(|message| archive.numbers(message));
        for fix in &mut radio.fixes {
            archive.numbers(&mut fix.pos_m);
            for number in [&mut fix.yaw_rad, &mut fix.t_s, &mut fix.valid] {
                archive.number(number);
            }
        }
    }

    /// Begin episodes in the lanes of `mask`: before the first flight everybody was heard.
    #[inline(always)]
    pub(crate) fn start(&mut self, mask: R::Mask, drone: usize, fix: &PoseFix<R>) {
        let n = self.drones;
        let Some(radio) = &mut self.radio else { return };
        let message = [fix.pos_m[0], fix.pos_m[1], fix.pos_m[2], R::zero(), R::zero(), R::zero(), fix.t_s];
        let slots = radio.said.iter_mut().skip(drone).step_by(n);
        for slot in slots.chain(radio.heard.iter_mut().skip(drone).step_by(n)) {
            *slot = merge(mask, *slot, message);
        }
        let f = &mut radio.fixes[drone];
        *f = PoseFix { pos_m: merge(mask, f.pos_m, fix.pos_m), t_s: R::select(mask, fix.t_s, f.t_s), ..*f };
    }

    /// One more tick.
    #[inline(always)]
    pub(crate) fn tick(&mut self) {
        self.clock += 1;
    }

    /// Broadcasts a drone's position, as of its newest fix.
    #[inline(always)]
    pub(crate) fn say(&mut self, drone: usize, fix: &PoseFix<R>) {
        let Some(radio) = &mut self.radio else { return };
        let last = &mut radio.fixes[drone];
        let before = radio.said[(self.clock + RING - 1) % RING * self.drones + drone];
        let newer = last.t_s.lt(fix.t_s);
        let per_s = R::from_f64(1.0) / (fix.t_s - last.t_s).max(R::from_f64(1e-3));
        let mut message =
            [fix.pos_m[0], fix.pos_m[1], fix.pos_m[2], R::zero(), R::zero(), R::zero(), fix.t_s];
        for i in 0..3 {
            // half of what is new: one outlier of a fix is not a velocity
            let moved = (fix.pos_m[i] - last.pos_m[i]) * per_s;
            message[3 + i] = R::select(newer, R::from_f64(0.5) * (before[3 + i] + moved), before[3 + i]);
        }
        *last = PoseFix {
            pos_m: merge(newer, last.pos_m, fix.pos_m),
            t_s: R::select(newer, fix.t_s, last.t_s),
            ..*last
        };
        radio.said[self.clock % RING * self.drones + drone] = message;
    }

    /// Lets every drone receive the messages of `late` ticks ago, or lose them. A drone that is gone is silent.
    #[inline(always)]
    pub(crate) fn listen(&mut self, truth: &[Neighbour<R>], draw: &TickRng<'_, R>) {
        let (n, Knowledge::Radio { loss, .. }) = (self.drones, self.how) else { return };
        let Some(radio) = &mut self.radio else { return };
        let then = (self.clock + RING - self.late) % RING * n;
        for to in 0..n {
            for from in 0..n {
                let mut arrives = truth[from].here.gt(R::zero());
                if loss > 0.0 {
                    let link = channel("broadcast").wrapping_add((to * n + from) as u32);
                    arrives = arrives & R::from_f64(loss).le(draw.uniform(link));
                }
                let slot = &mut radio.heard[to * n + from];
                *slot = merge(arrives, *slot, radio.said[then + from]);
            }
        }
    }

    /// Returns the knowledge of `to` about `from`, relative to its knowledge of itself.
    #[inline(always)]
    pub(crate) fn neighbour_row(
        &self,
        to: usize,
        from: usize,
        truth: &[Neighbour<R>],
        now_s: R,
    ) -> [R; NEIGHBOUR] {
        let (mut row, valid, age) = match (&self.how, &self.radio) {
            (Knowledge::Radio { .. }, Some(radio)) => {
                let (own, other) = (
                    &radio.said[self.clock % RING * self.drones + to],
                    &radio.heard[to * self.drones + from],
                );
                let age = now_s - other[6];
                let mut row = between(own, other);
                // a fix may be an outlier; where drones truly are, the walls say
                for place in &mut row[..3] {
                    *place = place.clamp(R::from_f64(-FAR_M), R::from_f64(FAR_M));
                }
                (row, age.lt(R::from_f64(STALE_S)), age)
            }
            (how, _) => {
                let (own, other) = (flat(&truth[to]), flat(&truth[from]));
                let row = between(&own, &other);
                let range_m = if let Knowledge::Range { range_m } = how { *range_m } else { 1e6 };
                let far2 = row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
                (row, truth[from].here.gt(R::zero()) & far2.le(R::from_f64(range_m * range_m)), R::zero())
            }
        };
        for speed in &mut row[3..] {
            *speed = speed.clamp(R::from_f64(-FAST_MPS), R::from_f64(FAST_MPS));
        }
        for v in &mut row {
            *v = R::select(valid, *v, R::zero());
        }
        let [x, y, z, vx, vy, vz] = row;
        [
            x,
            y,
            z,
            vx,
            vy,
            vz,
            R::select(valid, age.max(R::zero()), R::zero()),
            R::select(valid, R::from_f64(1.0), R::zero()),
        ]
    }
}

#[inline(always)]
fn flat<R: Scalar>(drone: &Neighbour<R>) -> [R; MESSAGE] {
    let ([x, y, z], [vx, vy, vz]) = (drone.pos_m, drone.vel_mps);
    [x, y, z, vx, vy, vz, R::zero()]
}

/// Place and velocity of `other` as seen from `own`.
#[inline(always)]
fn between<R: Scalar>(own: &[R; MESSAGE], other: &[R; MESSAGE]) -> [R; 6] {
    tabulate(
        #[inline(always)]
        |i| other[i] - own[i],
    )
}
