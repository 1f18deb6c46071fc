//! The onboard cascade: position error to velocity, velocity error to tilt and thrust, in front of the
//! vehicle's attitude loops. One memory for each tile of drones.

use std::slice::from_mut;

use super::{ActionLevel, SPEED_MAX_MPS};
use crate::action::{ACTION, Interface};
use crate::archive::Ledger;
use crate::error::Result;
use crate::model::{AxisForm, Model, Vertical, VerticalInput};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, tabulate, wrap};

/// Gains and limits of the onboard cascade. The default is that of the Crazyflie's firmware
/// (platform_defaults_cf2.h, 2022).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CascadeGains {
    /// Commanded velocity per metre of error: x, y, z.
    pub position_ps: [f64; 3],
    /// Commanded climb rate per metre and second of integrated height error.
    pub height_integral_ps2: f64,
    /// Largest command of the position loop: x, y, z.
    pub speed_max_mps: [f64; 3],
    /// Tilt per m/s of error: along the nose, to the left.
    pub tilt_deg_per_mps: [f64; 2],
    /// Tilt per metre that the velocity error adds up to: along the nose, to the left.
    pub tilt_deg_per_m: [f64; 2],
    /// Largest commanded tilt; the model's own limit applies as well.
    pub tilt_max_deg: f64,
    /// Thrust per m/s of error, in PWM counts of a vehicle that hovers at [`THRUST_BASE`].
    pub thrust_per_mps: f64,
    /// Thrust per metre that the error adds up to, in the same counts.
    pub thrust_per_m: f64,
    /// Least thrust, in the same counts.
    pub thrust_min: f64,
    /// Thrust without error, in the same counts: [`THRUST_BASE`] is the model's own hover.
    pub thrust_base: f64,
    /// Yaw rate per radian of error.
    pub yaw_ps: f64,
}

impl Default for CascadeGains {
    fn default() -> Self {
        CascadeGains {
            position_ps: [2.0; 3],
            height_integral_ps2: 0.5,
            speed_max_mps: [SPEED_MAX_MPS; 3],
            tilt_deg_per_mps: [25.0; 2],
            tilt_deg_per_m: [1.0; 2],
            tilt_max_deg: 20.0,
            thrust_per_mps: 25_000.0,
            thrust_per_m: 15_000.0,
            thrust_min: 20_000.0,
            thrust_base: THRUST_BASE,
            yaw_ps: 6.0,
        }
    }
}

/// PWM at which the firmware expects its vehicle to hover (`posCtlPid.thrustBase`).
pub const THRUST_BASE: f64 = 36_000.0;
/// The angle loop is not closed faster: a tick is 20 ms.
const FASTEST_PS: f64 = 15.0;

/// Conversion of a climb rate into the height input.
#[derive(Debug, Clone, Copy)]
enum Lift<R> {
    /// The form's input sets the climb rate (5.3, 5.4): what its own equation gives for it.
    Climb { per_mps: R, per_m: R, offset: R },
    /// The input is a thrust: the firmware's PI loop around the hover.
    Thrust { hover: R, scale: f64, most: R },
}

/// State of the cascade of one tile.
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
    gains: CascadeGains,
    tick_s: R,
    /// Roll and pitch: command per angle to keep, and command per missing angle.
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
        if interface.level().is_default() {
            return Ok(None);
        }
        Onboard::with_any_level(model, interface, tick_s, tiles).map(Some)
    }

    /// Creates the loops like [`Onboard::new`], for callers that give set-points themselves at any action level.
    fn with_any_level(model: &Model, interface: &Interface, tick_s: f64, tiles: usize) -> Result<Self> {
        let tilts = model.tilt_forms(interface.input);
        // the motor-level form has the firmware's attitude loop, which is fast enough
        let own_loops = interface.input == VerticalInput::Motors;
        Ok(Onboard {
            level: interface.level(),
            interface: *interface,
            gains: CascadeGains::default(),
            tick_s: R::from_f64(tick_s),
            per_tilt: tilts.map(|tilt| R::from_f64(tilt.input_per_output())),
            closing: tilts.map(|tilt| R::from_f64(if own_loops { 0.0 } else { closing(&tilt) })),
            lift: Lift::new(model, interface)?,
            takes_height: interface.input == VerticalInput::Height,
            memory: vec![Memory::new(); tiles],
        })
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
        let [x_mps, y_mps] = self.sideways_mps([x_m, y_m], x);
        let wanted_mps = [x_mps, y_mps, self.climb_mps(tile, z_m, x)];
        let turn = self.turn_radps(yaw_rad, x);
        let u = self.follow(tile, wanted_mps, turn, x);
        let lift = if self.takes_height { z_m } else { u.lift };
        Command { lift, ..u }
    }

    /// Velocity towards a place, along the axes of the room.
    #[inline(always)]
    fn sideways_mps(&self, place_m: [R; 2], x: &State<R>) -> [R; 2] {
        let CascadeGains { position_ps, speed_max_mps, .. } = self.gains;
        tabulate(
            #[inline(always)]
            |i| {
                let top = R::from_f64(speed_max_mps[i]);
                // a sum that begins at nothing, as that of the height does
                (R::from_f64(position_ps[i]) * (place_m[i] - x.pos_m[i]) + R::zero()).clamp(-top, top)
            },
        )
    }

    /// Climb rate towards a height.
    #[inline(always)]
    fn climb_mps(&mut self, tile: usize, z_m: R, x: &State<R>) -> R {
        let CascadeGains { position_ps, height_integral_ps2, speed_max_mps, .. } = self.gains;
        let error_m = z_m - x.pos_m[2];
        let memory = &mut self.memory[tile];
        let sum = memory.height_ms + error_m * self.tick_s;
        // no more than it takes to ask for the highest speed
        let most = R::from_f64(speed_max_mps[2] / height_integral_ps2);
        memory.height_ms = sum.clamp(-most, most);
        let slow = R::from_f64(height_integral_ps2) * memory.height_ms;
        let top = R::from_f64(speed_max_mps[2]);
        (R::from_f64(position_ps[2]) * error_m + slow).clamp(-top, top)
    }

    /// Yaw rate towards a heading, right-handed.
    #[inline(always)]
    fn turn_radps(&self, yaw_rad: R, x: &State<R>) -> R {
        let fastest = R::from_f64(self.interface.yaw_rate_max_radps);
        (R::from_f64(self.gains.yaw_ps) * wrap(yaw_rad - x.att_rad[2])).clamp(-fastest, fastest)
    }

    /// Velocity error to tilt and thrust, as the firmware's inner loop.
    #[inline(always)]
    fn follow(&mut self, tile: usize, wanted_mps: [R; 3], turn_radps: R, x: &State<R>) -> Command<R> {
        let tilt = self.tilt_rad(tile, [wanted_mps[0], wanted_mps[1]], x);
        let lift = self.lift(tile, wanted_mps[2], x);
        self.attitude_command(tilt, turn_radps, lift, x)
    }

    /// Roll and pitch that bring the velocity along the axes of the room.
    #[inline(always)]
    fn tilt_rad(&mut self, tile: usize, wanted_mps: [R; 2], x: &State<R>) -> [R; 2] {
        let CascadeGains { tilt_deg_per_mps, tilt_deg_per_m, tilt_max_deg, .. } = self.gains;
        let memory = &mut self.memory[tile];
        let error: [R; 2] = tabulate(
            #[inline(always)]
            |i| wanted_mps[i] - x.vel_mps[i],
        );
        let (sin, cos) = x.att_rad[2].sin_cos();
        // towards the nose, to the left
        let ahead = [cos * error[0] + sin * error[1], cos * error[1] - sin * error[0]];
        let deg = std::f64::consts::PI / 180.0;
        let most = R::from_f64((tilt_max_deg * deg).min(self.interface.tilt_max_rad));
        let mut tilt = [R::zero(); 2];
        for i in 0..2 {
            let most_m = R::from_f64(tilt_max_deg / tilt_deg_per_m[i]);
            let sum = memory.velocity_m[i] + ahead[i] * self.tick_s;
            memory.velocity_m[i] = sum.clamp(-most_m, most_m);
            let asked = R::from_f64(tilt_deg_per_mps[i] * deg) * ahead[i]
                + R::from_f64(tilt_deg_per_m[i] * deg) * memory.velocity_m[i];
            tilt[i] = asked.clamp(-most, most);
        }
        [-tilt[1], tilt[0]]
    }

    /// Height input that brings the climb rate.
    #[inline(always)]
    fn lift(&mut self, tile: usize, wanted_mps: R, x: &State<R>) -> R {
        let wanted = [wanted_mps, wanted_mps - x.vel_mps[2]];
        let sum_m = &mut self.memory[tile].velocity_m[2];
        self.lift.input(sum_m, wanted, x.pos_m[2], self.tick_s, &self.gains)
    }

    /// The command that brings roll, pitch and a right-handed yaw rate.
    #[inline(always)]
    fn attitude_command(&self, [roll, pitch]: [R; 2], turn_radps: R, lift: R, x: &State<R>) -> Command<R> {
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

impl<R: Scalar> Onboard<R> {
    pub(crate) fn show_numbers(&mut self, tile: usize, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("cascade_velocity_m", &mut self.memory[tile].velocity_m);
        ledger.numbers("cascade_height_ms", from_mut(&mut self.memory[tile].height_ms));
    }
}

/// Returns the share of a missing angle that is added to the command. The firmware's gains expect an attitude loop
/// that is faster than the identified one (5.1: 2.8 1/s), with which the position loop would oscillate. So this loop
/// closes the angle once more, as fast as possible without overshoot.
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
        let hover_pwm = vertical.hover_pwm().unwrap_or_default();
        Ok(match vertical {
            Vertical::Thrust { .. } | Vertical::Motors(_) => Lift::Thrust {
                hover: R::from_f64(hover_pwm),
                scale: hover_pwm / THRUST_BASE,
                most: R::from_f64(interface.lift_max),
            },
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
    fn input(
        &self,
        sum_m: &mut R,
        [wanted_mps, error_mps]: [R; 2],
        z_m: R,
        tick_s: R,
        gains: &CascadeGains,
    ) -> R {
        let CascadeGains { thrust_per_mps, thrust_per_m, .. } = *gains;
        match *self {
            Lift::Climb { per_mps, per_m, offset } => {
                // against what pushes, with the firmware's ratio of the two gains
                let slow = R::from_f64(thrust_per_m / thrust_per_mps);
                let limit = R::from_f64(gains.speed_max_mps[2] * thrust_per_mps / thrust_per_m);
                *sum_m = (*sum_m + error_mps * tick_s).clamp(-limit, limit);
                per_mps * (wanted_mps + slow * *sum_m) + per_m * z_m + offset
            }
            Lift::Thrust { hover, scale, most } => {
                let (per_mps, per_m) =
                    (R::from_f64(thrust_per_mps * scale), R::from_f64(thrust_per_m * scale));
                // no more than half a hover
                let limit = R::from_f64(0.5) * hover / per_m;
                *sum_m = (*sum_m + error_mps * tick_s).clamp(-limit, limit);
                let base = hover * R::from_f64(gains.thrust_base / THRUST_BASE);
                let least = R::from_f64(gains.thrust_min * scale);
                (base + per_mps * error_mps + per_m * *sum_m).clamp(least, most)
            }
        }
    }
}

/// Lateral set-point of a drone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LateralSetpoint {
    /// Be at a place in the room, m.
    Place([f64; 2]),
    /// Move along the axes of the room, m/s.
    Velocity([f64; 2]),
    /// Hold roll and pitch, rad, as the attitude level commands them.
    Tilt([f64; 2]),
}

/// Vertical set-point of a drone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VerticalSetpoint {
    /// Be at a height, m.
    Height(f64),
    /// Climb, m/s.
    Climb(f64),
    /// Apply this input of the model: height or PWM.
    Lift(f64),
}

/// Yaw set-point of a drone, right-handed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum YawSetpoint {
    /// Look there, rad.
    Heading(f64),
    /// Turn, rad/s.
    Rate(f64),
}

/// The onboard cascade of one drone, for set-points that mix levels, with gains that may change in flight.
#[derive(Debug)]
pub struct Cascade {
    onboard: Onboard<f64>,
}

impl Cascade {
    /// For a model whose height input is that of `interface`, called every `tick_s` seconds.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] if the model lacks the vertical input.
    pub fn new(model: &Model, interface: &Interface, tick_s: f64) -> Result<Self> {
        Ok(Cascade { onboard: Onboard::with_any_level(model, interface, tick_s, 1)? })
    }

    /// Takes other gains.
    pub fn set_gains(&mut self, gains: CascadeGains) {
        self.onboard.gains = gains;
    }

    /// Forgets the flight.
    pub fn reset(&mut self) {
        self.onboard.memory[0] = Memory::new();
    }

    /// The command for a drone that is at `x`.
    pub fn command(
        &mut self,
        lateral: LateralSetpoint,
        vertical: VerticalSetpoint,
        yaw: YawSetpoint,
        x: &State<f64>,
    ) -> Command<f64> {
        let onboard = &mut self.onboard;
        let turn_radps = match yaw {
            YawSetpoint::Heading(yaw_rad) => onboard.turn_radps(yaw_rad, x),
            YawSetpoint::Rate(radps) => radps,
        };
        let lift = match vertical {
            VerticalSetpoint::Height(z_m) if onboard.takes_height => z_m,
            VerticalSetpoint::Height(z_m) => {
                let climb_mps = onboard.climb_mps(0, z_m, x);
                onboard.lift(0, climb_mps, x)
            }
            VerticalSetpoint::Climb(mps) => onboard.lift(0, mps, x),
            VerticalSetpoint::Lift(lift) => lift,
        };
        let wanted_mps = match lateral {
            LateralSetpoint::Place(place_m) => onboard.sideways_mps(place_m, x),
            LateralSetpoint::Velocity(mps) => mps,
            LateralSetpoint::Tilt(tilt) => {
                let limit = onboard.interface.tilt_max_rad;
                let [roll_rad, pitch_rad] = tilt.map(|rad| rad.clamp(-limit, limit));
                let level = onboard.attitude_command([0.0; 2], turn_radps, lift, x);
                return Command { roll_rad, pitch_rad, ..level };
            }
        };
        let tilt = onboard.tilt_rad(0, wanted_mps, x);
        onboard.attitude_command(tilt, turn_radps, lift, x)
    }
}
