//! States, readings and frames: how they begin, how lanes of them are put together, and the floor.

use super::{Age, Contact, GROUP, Group, Tick, Tile, Times};
use crate::effects::{Frame, HookContext, PoseFix, Reading};
use crate::motors::MotorVehicle;
use crate::noise::TickRng;
use crate::plant::{Accelerations, Command, Plant, State, VehicleConstants, YawRotation};
use crate::scalar::{Scalar, Word, each, merge};

/// Nominal cell voltage (thesis 3.1.1): what is read without a battery effect.
const NOMINAL_V: f64 = 3.7;

#[inline(always)]
pub(super) fn at_rest<R: Scalar>(mask: R::Mask, v: R) -> R {
    R::select(mask, R::zero(), v)
}

/// The floor carries: no sinking, and on its legs the vehicle neither slides nor tilts.
#[inline(always)]
pub(super) fn land<R: Scalar>(x: &mut State<R>, from_m: R, contact: &mut Contact<R>) {
    let below = x.pos_m[2].lt(R::zero());
    contact.standing = below;
    if !R::any(below) {
        return;
    }
    // a vehicle on the floor does not hit it, though a first-order form (5.4) gives a standing vehicle a
    // sinking speed
    let fell = below & from_m.gt(R::zero());
    contact.impact_mps = contact.impact_mps.max(R::select(fell, -x.vel_mps[2], R::zero()));
    x.pos_m[2] = at_rest(below, x.pos_m[2]);
    x.vel_mps = each(
        x.vel_mps,
        #[inline(always)]
        |v| at_rest(below, v),
    );
    x.att_rad = [at_rest(below, x.att_rad[0]), at_rest(below, x.att_rad[1]), x.att_rad[2]];
    x.rate_radps = each(
        x.rate_radps,
        #[inline(always)]
        |v| at_rest(below, v),
    );
    x.aux = [R::select(below, x.aux[0].max(R::zero()), x.aux[0]), at_rest(below, x.aux[1])];
}

/// A physics step of the form that is flown. The last number is the specific force along the body's z axis of a
/// motor-level vehicle.
#[inline(always)]
pub(super) fn advance<R: Scalar>(
    plant: &Plant<R>,
    motors: Option<&mut MotorVehicle<R>>,
    tile: usize,
    x: &State<R>,
    u: &Command<R>,
    push: &Accelerations<R>,
) -> (State<R>, YawRotation<R>, Option<R>) {
    if let Some(motors) = motors {
        let (next, heading, up_mps2) = motors.advance(tile, x, u, push);
        return (next, heading, Some(up_mps2));
    }
    let (next, heading) = plant.advance(x, u, push);
    (next, heading, None)
}

/// Returns the specific force upwards at an accelerometer: that of the motors while they carry, or else that of the
/// motion.
#[inline(always)]
pub(super) fn felt<R: Scalar>(motors_mps2: Option<R>, moved_mps2: R, standing: R::Mask) -> R {
    motors_mps2.map_or(moved_mps2, |given| R::select(standing, moved_mps2, given))
}

/// Commands of a group of tiles as effects on the thrust see them.
#[inline(always)]
pub(super) fn thrust_commands<R: Scalar>(
    motors: &MotorVehicle<R>,
    first: usize,
    states: &[State<R>],
) -> [Command<R>; GROUP] {
    let mut commands = [Command::level(R::zero()); GROUP];
    for (i, (command, x)) in commands.iter_mut().zip(states).enumerate() {
        *command = motors.thrust_command(first + i, x);
    }
    commands
}

impl<R: Scalar> Contact<R> {
    #[inline(always)]
    pub(super) fn none() -> Self {
        Contact { impact_mps: R::zero(), standing: R::nothing() }
    }
}

impl<R: Scalar> Age<R> {
    /// One more tick.
    #[inline(always)]
    pub(super) fn count(&mut self) {
        self.tick = self.tick.add(R::Word::from_u32(1));
        self.ticks += R::from_f64(1.0);
    }
    /// The time at which the tick began that has been counted.
    #[inline(always)]
    pub(super) fn began_s(&self, times: &Times<R>) -> R {
        (self.ticks - R::from_f64(1.0)) * times.tick_s
    }
    #[inline(always)]
    pub(super) fn draw(&self) -> TickRng<'_, R> {
        self.keys.draw(&self.tick)
    }
}

impl<R: Scalar> Group<R> {
    pub(super) fn new() -> Self {
        let (x, nothing) = (State::rest(), R::nothing());
        Group {
            u: [Command::level(R::zero()); GROUP],
            push: [Accelerations::none(); GROUP],
            middle: [x; GROUP],
            seen: [x; GROUP],
            captured: [nothing; GROUP],
            frames: [Frame::from_state(&x, nothing, R::zero()); GROUP],
        }
    }
}

impl<R: Scalar> Tick<R> {
    /// To be written over.
    #[inline(always)]
    pub fn none() -> Self {
        let (zero, none) = (R::zero(), [R::zero(); 3]);
        let marker = PoseFix { pos_m: none, yaw_rad: zero, t_s: zero, valid: zero };
        Tick {
            contact: Contact::none(),
            reading: Reading { marker, att_rad: none, gyro_radps: none, acc_mps2: none, vbat_v: zero },
        }
    }
}

impl<R: Scalar> Reading<R> {
    /// Returns the sensors' reading of a state, before any effect.
    #[inline(always)]
    pub(super) fn from_state(x: &State<R>, acc_mps2: [R; 3], marker: PoseFix<R>) -> Self {
        Reading {
            marker,
            att_rad: x.att_rad,
            gyro_radps: x.rate_radps,
            acc_mps2,
            vbat_v: R::from_f64(NOMINAL_V),
        }
    }
}

impl<R: Scalar> Frame<R> {
    #[inline(always)]
    pub(super) fn from_state(x: &State<R>, captured: R::Mask, t_s: R) -> Self {
        let (one, zero) = (R::from_f64(1.0), R::zero());
        Frame {
            captured,
            markers: one,
            pos_m: x.pos_m,
            yaw_rad: x.att_rad[2],
            t_s,
            field: [one, one, one],
            nearest_m: [zero, zero],
        }
    }
}

impl<R: Scalar> State<R> {
    /// `other` in the lanes of `mask`.
    #[inline(always)]
    pub(super) fn merge(&self, mask: R::Mask, other: &Self) -> Self {
        State {
            pos_m: merge(mask, self.pos_m, other.pos_m),
            vel_mps: merge(mask, self.vel_mps, other.vel_mps),
            att_rad: merge(mask, self.att_rad, other.att_rad),
            rate_radps: merge(mask, self.rate_radps, other.rate_radps),
            aux: merge(mask, self.aux, other.aux),
        }
    }

    /// Predicts the state after so short a time, to second order in the position: the state for a push that is
    /// constant over twice that time.
    #[inline(always)]
    pub(super) fn ahead(&self, acc_mps2: &[R; 3], time_s: f64) -> Self {
        let t = R::from_f64(time_s);
        let mut x = *self;
        for i in 0..3 {
            x.pos_m[i] += t * self.vel_mps[i];
            x.vel_mps[i] += t * acc_mps2[i];
            x.att_rad[i] += t * self.rate_radps[i];
        }
        x
    }

    /// Position and attitude `share` of a step of `h_s` before its end, on the parabola through both ends
    /// with the velocity of the end. (A first-order form's velocity jumps at the start of a step.) The third
    /// derivative makes an error of less than 3e-6 m at 50 Hz.
    #[inline(always)]
    pub(super) fn look_back(&self, end: &Self, share: R, h_s: f64) -> Self {
        let (h, square) = (R::from_f64(h_s), share * share);
        let mut x = *end;
        for i in 0..3 {
            let (dp, da) = (h * end.vel_mps[i], h * end.rate_radps[i]);
            x.pos_m[i] = end.pos_m[i] - share * dp + square * (self.pos_m[i] - end.pos_m[i] + dp);
            x.att_rad[i] = end.att_rad[i] - share * da + square * (self.att_rad[i] - end.att_rad[i] + da);
        }
        x
    }
}

impl<R: Scalar> PoseFix<R> {
    /// `other` in the lanes of `mask`.
    #[inline(always)]
    pub(super) fn merge(&self, mask: R::Mask, other: &Self) -> Self {
        let [yaw_rad, t_s, valid] =
            merge(mask, [self.yaw_rad, self.t_s, self.valid], [other.yaw_rad, other.t_s, other.valid]);
        PoseFix { pos_m: merge(mask, self.pos_m, other.pos_m), yaw_rad, t_s, valid }
    }

    /// Ideal localisation: the true pose, now.
    #[inline(always)]
    pub(super) fn ideal(x: &State<R>, now_s: R) -> Self {
        PoseFix { pos_m: x.pos_m, yaw_rad: x.att_rad[2], t_s: now_s, valid: R::from_f64(1.0) }
    }
}

impl<R: Scalar> YawRotation<R> {
    /// The specific force along the body axes: what pushes sideways, and what carries.
    #[inline(always)]
    pub(super) fn specific(&self, push: &Accelerations<R>, up_mps2: R) -> [R; 3] {
        let [ax, ay, _] = push.acc_mps2;
        [self.cos * ax + self.sin * ay, self.cos * ay - self.sin * ax, up_mps2]
    }
}

impl<R: Scalar> Tile<R> {
    pub(super) fn new() -> Self {
        let (zero, none) = (R::zero(), [R::zero(); 3]);
        let fix = PoseFix { pos_m: none, yaw_rad: zero, t_s: zero, valid: zero };
        Tile { acc_mps2: none, until_frame: R::from_f64(1e9), fix }
    }
}

impl<'a, R: Scalar> HookContext<'a, R> {
    /// The start of a control tick that is one physics step, at time 0, with no other drone around.
    #[inline(always)]
    pub(super) fn new(
        body: &'a VehicleConstants<R>,
        tick_s: f64,
        draw: &'a TickRng<'a, R>,
        voltage_v: Option<&'a R>,
    ) -> Self {
        HookContext {
            body,
            h_s: tick_s,
            tick_s,
            since_tick_s: 0.0,
            t_s: R::zero(),
            first: true,
            draw,
            clock: 0,
            voltage_v,
            neighbours: &[],
            own: 0,
        }
    }
}
