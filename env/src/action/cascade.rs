//! The onboard cascade: position error to velocity, velocity error to tilt and thrust, in front of the
//! vehicle's attitude loops. One memory for each tile of drones.

use super::{ActionLevel, SPEED_MAX_MPS};
use crate::archive::Archive;
use crate::error::Result;
use crate::model::{AxisForm, Model, Motors, Vertical, VerticalInput};
use crate::observation::{ACTION, Interface, wrap};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, tabulate};
use crate::sim_scalar::BatchScalar;

// Gains of the Crazyflie's firmware (platform_defaults_cf2.h, 2022).
/// Velocity asked for per metre of error, in all three directions, and per metre and second upwards.
const POSITION_PS: f64 = 2.0;
const HEIGHT_INTEGRAL_PS2: f64 = 0.5;
/// Tilt per m/s of error, and per metre that the error adds up to.
const TILT_DEG_PER_MPS: f64 = 25.0;
const TILT_DEG_PER_M: f64 = 1.0;
const TILT_MAX_DEG: f64 = 20.0;
/// Thrust per m/s of error and per metre that it adds up to, and its least, in PWM counts of a vehicle that
/// hovers at [`THRUST_BASE`].
const THRUST_PER_MPS: f64 = 25_000.0;
const THRUST_PER_M: f64 = 15_000.0;
const THRUST_MIN: f64 = 20_000.0;
const THRUST_BASE: f64 = 36_000.0;
/// Yaw rate per radian of error.
const YAW_PS: f64 = 6.0;
/// The angle loop is not closed faster: a tick is 20 ms.
const FASTEST_PS: f64 = 15.0;

/// How the height input follows from a climb rate.
#[derive(Debug, Clone, Copy)]
enum Lift<R> {
    /// The form's input sets the climb rate (5.3, 5.4): what its own equation gives for it.
    Climb { per_mps: R, per_m: R, offset: R },
    /// The input is a thrust: the firmware's PI loop around the hover.
    Thrust { hover: R, per_mps: R, per_m: R, least: R, most: R },
}

/// What the cascade of a tile remembers.
#[derive(Debug, Clone, Copy)]
struct Memory<R> {
    /// Sums of the velocity error: along the nose, to the left, up.
    velocity_m: [R; 3],
    /// Sum of the height error.
    height_ms: R,
}

impl<R: Scalar> Memory<R> {
    fn new() -> Self {
        Memory { velocity_m: [R::zero(); 3], height_ms: R::zero() }
    }
}

/// The loops on board that turn set-points into commands of the vehicle.
#[derive(Debug)]
pub(crate) struct Onboard<R> {
    level: ActionLevel,
    interface: Interface,
    tick_s: R,
    /// Of roll and pitch: command per angle held, and per angle that is still missing.
    per_tilt: [R; 2],
    closing: [R; 2],
    lift: Lift<R>,
    /// A height command is what its own loop follows.
    takes_height: bool,
    memory: Vec<Memory<R>>,
}

impl<R: Scalar> Onboard<R> {
    /// For `tiles` tiles of drones; nothing where actions are attitudes.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] if the model lacks the vertical input.
    pub(crate) fn new(
        model: &Model,
        interface: &Interface,
        tick_s: f64,
        tiles: usize,
    ) -> Result<Option<Self>> {
        let level = interface.level();
        if level.is_default() {
            return Ok(None);
        }
        let tilts = model.tilt_forms(interface.input);
        // the motor-level form has the firmware's attitude loop, which is fast enough
        let own_loops = interface.input == VerticalInput::Motors;
        Ok(Some(Onboard {
            level,
            interface: *interface,
            tick_s: R::from_f64(tick_s),
            per_tilt: tilts.map(|tilt| R::from_f64(tilt.input_per_output())),
            closing: tilts.map(|tilt| R::from_f64(if own_loops { 0.0 } else { closing(&tilt) })),
            lift: Lift::new(model, interface)?,
            takes_height: interface.input == VerticalInput::Height,
            memory: vec![Memory::new(); tiles],
        }))
    }

    /// Forget the flights in the lanes of `mask`.
    pub(crate) fn start(&mut self, tile: usize, mask: R::Mask) {
        let memory = &mut self.memory[tile];
        for sum in memory.velocity_m.iter_mut().chain([&mut memory.height_ms]) {
            *sum = R::select(mask, R::zero(), *sum);
        }
    }

    /// The command of an action row for drones that are at `x`.
    #[inline(always)]
    pub(crate) fn command(&mut self, tile: usize, action: &[R; ACTION], x: &State<R>) -> Command<R> {
        let set_point = self.interface.set_point(action);
        match self.level {
            ActionLevel::Attitude => self.interface.command(action),
            ActionLevel::Velocity => {
                let [x_mps, y_mps, z_mps, yaw_rate_radps] = set_point;
                self.follow(tile, [x_mps, y_mps, z_mps], yaw_rate_radps, x)
            }
            ActionLevel::Position => self.approach(tile, set_point, x),
            ActionLevel::BodyRates | ActionLevel::Motors => {
                let [roll_rad, pitch_rad, yaw_rate_radps, lift] = set_point;
                Command { roll_rad, pitch_rad, yaw_rate_radps, lift }
            }
        }
    }

    /// Position error to velocity, as the firmware's outer loop.
    #[inline(always)]
    fn approach(&mut self, tile: usize, [x_m, y_m, z_m, yaw_rad]: [R; 4], x: &State<R>) -> Command<R> {
        let (gain, top) = (R::from_f64(POSITION_PS), R::from_f64(SPEED_MAX_MPS));
        let error_m = [x_m - x.pos_m[0], y_m - x.pos_m[1], z_m - x.pos_m[2]];
        let memory = &mut self.memory[tile];
        let sum = memory.height_ms + error_m[2] * self.tick_s;
        // no more than it takes to ask for the highest speed
        let most = R::from_f64(SPEED_MAX_MPS / HEIGHT_INTEGRAL_PS2);
        memory.height_ms = sum.clamp(-most, most);
        let slow = [R::zero(), R::zero(), R::from_f64(HEIGHT_INTEGRAL_PS2) * memory.height_ms];
        let wanted_mps = tabulate(
            #[inline(always)]
            |i| (gain * error_m[i] + slow[i]).clamp(-top, top),
        );
        let fastest = R::from_f64(self.interface.yaw_rate_max_radps);
        let turn = (R::from_f64(YAW_PS) * wrap(yaw_rad - x.att_rad[2])).clamp(-fastest, fastest);
        let u = self.follow(tile, wanted_mps, turn, x);
        let lift = if self.takes_height { z_m } else { u.lift };
        Command { lift, ..u }
    }

    /// Velocity error to tilt and thrust, as the firmware's inner loop.
    #[inline(always)]
    fn follow(&mut self, tile: usize, wanted_mps: [R; 3], turn_radps: R, x: &State<R>) -> Command<R> {
        let memory = &mut self.memory[tile];
        let error: [R; 3] = tabulate(
            #[inline(always)]
            |i| wanted_mps[i] - x.vel_mps[i],
        );
        let (sin, cos) = x.att_rad[2].sin_cos();
        // towards the nose, to the left
        let ahead = [cos * error[0] + sin * error[1], cos * error[1] - sin * error[0]];
        let deg = std::f64::consts::PI / 180.0;
        let most = R::from_f64((TILT_MAX_DEG * deg).min(self.interface.tilt_max_rad));
        let most_m = R::from_f64(TILT_MAX_DEG / TILT_DEG_PER_M);
        let mut tilt = [R::zero(); 2];
        for i in 0..2 {
            let sum = memory.velocity_m[i] + ahead[i] * self.tick_s;
            memory.velocity_m[i] = sum.clamp(-most_m, most_m);
            let asked = R::from_f64(TILT_DEG_PER_MPS * deg) * ahead[i]
                + R::from_f64(TILT_DEG_PER_M * deg) * memory.velocity_m[i];
            tilt[i] = asked.clamp(-most, most);
        }
        let [pitch, roll] = [tilt[0], -tilt[1]];
        let lift =
            self.lift.input(&mut memory.velocity_m[2], [wanted_mps[2], error[2]], x.pos_m[2], self.tick_s);
        let limit = R::from_f64(self.interface.tilt_max_rad);
        let angle = |i: usize, wanted: R| {
            (self.per_tilt[i] * wanted + self.closing[i] * (wanted - x.att_rad[i])).clamp(-limit, limit)
        };
        let fastest = R::from_f64(self.interface.yaw_rate_max_radps);
        Command {
            roll_rad: angle(0, roll),
            pitch_rad: angle(1, pitch),
            yaw_rate_radps: (R::from_f64(self.interface.yaw_sign) * turn_radps).clamp(-fastest, fastest),
            lift: lift.clamp(R::zero(), R::from_f64(self.interface.lift_max)),
        }
    }
}

impl<R: BatchScalar> Onboard<R> {
    pub(crate) fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        archive.numbers(&mut self.memory[tile].velocity_m);
        archive.number(&mut self.memory[tile].height_ms);
    }
}

/// How much of a missing angle is added to the command. The firmware's gains expect an attitude loop that is
/// faster than the identified one (5.1: 2.8 1/s), with which the position loop would swing by itself. So the
/// angle is closed once more, as fast as it goes without overshoot.
fn closing(tilt: &AxisForm) -> f64 {
    let damping_ps = -tilt.a[1][1];
    let pole_ps = (0.5 * damping_ps).min(FASTEST_PS);
    let stiffness_ps2 = pole_ps * (damping_ps - pole_ps);
    ((stiffness_ps2 + tilt.a[1][0]) / tilt.u[1]).max(0.0)
}

impl<R: Scalar> Lift<R> {
    fn new(model: &Model, interface: &Interface) -> Result<Self> {
        let vertical = model.vertical(interface.input)?;
        let AxisForm { a, u, offset, .. } = vertical.form(model.lateral.gravity.value);
        Ok(match vertical {
            Vertical::Thrust { hover, .. } | Vertical::Motors(Motors { hover, .. }) => {
                let scale = hover.value / THRUST_BASE;
                Lift::Thrust {
                    hover: R::from_f64(hover.value),
                    per_mps: R::from_f64(THRUST_PER_MPS * scale),
                    per_m: R::from_f64(THRUST_PER_M * scale),
                    least: R::from_f64(THRUST_MIN * scale),
                    most: R::from_f64(interface.lift_max),
                }
            }
            // z' = u (input - offset) + a z
            Vertical::FirstOrder { .. } => Lift::Climb {
                per_mps: R::from_f64(1.0 / u[0]),
                per_m: R::from_f64(-a[0][0] / u[0]),
                offset: R::from_f64(offset),
            },
            // settled: 0 = u (input - offset) + a z + a' z'
            Vertical::SecondOrder { .. } => Lift::Climb {
                per_mps: R::from_f64(-a[1][1] / u[1]),
                per_m: R::from_f64(-a[1][0] / u[1]),
                offset: R::from_f64(offset),
            },
        })
    }

    /// The input for a wanted climb rate, which is `error_mps` from being reached at the height `z_m`.
    #[inline(always)]
    fn input(&self, sum_m: &mut R, [wanted_mps, error_mps]: [R; 2], z_m: R, tick_s: R) -> R {
        match *self {
            Lift::Climb { per_mps, per_m, offset } => {
                // against what pushes, with the firmware's ratio of the two gains
                let slow = R::from_f64(THRUST_PER_M / THRUST_PER_MPS);
                let limit = R::from_f64(SPEED_MAX_MPS * THRUST_PER_MPS / THRUST_PER_M);
                *sum_m = (*sum_m + error_mps * tick_s).clamp(-limit, limit);
                per_mps * (wanted_mps + slow * *sum_m) + per_m * z_m + offset
            }
            Lift::Thrust { hover, per_mps, per_m, least, most } => {
                // no more than half a hover
                let limit = R::from_f64(0.5) * hover / per_m;
                *sum_m = (*sum_m + error_mps * tick_s).clamp(-limit, limit);
                (hover + per_mps * error_mps + per_m * *sum_m).clamp(least, most)
            }
        }
    }
}
