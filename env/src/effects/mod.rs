//! Effects: what the identified linear model lacks. One effect is one small file here plus one line in
//! [`registry`]; everything else (configuration, command line, Python, docs, fitting) reads the registry.

mod fitting;
mod stage;
mod time;
mod values;

use std::ops::Deref;

use crate::dual::{Dual, Mean};
use crate::lanes::Lanes;
use crate::noise::{TickRng, channel};
use crate::plant::{Accelerations, Command, State, VehicleConstants};
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;

pub use fitting::{FlightSpread, GaussMarkovSignal, Geometry, Observability, Ubiquity};
pub use learned::{CURVES, Curve};
pub(crate) use stage::{Build, Stage, Tiles};
pub(crate) use values::BoundedNumber;
pub use values::{add_downwash, check_effects, numbers};

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Param {
    /// Key in configurations, with the unit as its suffix.
    pub name: &'static str,
    /// Symbol of the unit; "1" for a pure number.
    pub unit: &'static str,
    /// The value with which the parameter has no effect.
    pub off: f64,
    /// Smallest value that a configuration may give.
    pub low: f64,
    /// Largest value that a configuration may give.
    pub high: f64,
    /// Description for users, without a full stop.
    pub about: &'static str,
    /// Treatment by fits.
    pub role: Role,
    /// Values from which a search begins; empty for "off" alone. A length or a frequency has no slope while
    /// its effect is off.
    pub starts: &'static [f64],
    /// Least distance from "off" at which it counts as a cause of its own; 0 accepts any distance. A smaller one
    /// compensates a declared number that is not known better, or dynamics of a higher order than declared. Chosen
    /// below the sizes that `hidden_flights.py` hides, on its seed 404 and on rotorpy's 301, 401, 402, 2020, 3131 and
    /// 5150; judged on 2727 of `hidden_flights.py` and 6161 of rotorpy (docs/rates.md).
    pub least: f64,
    /// Numbers that were declared without a delay contain some of it here. So below "off" it is no cause of its own
    /// beside an effect that delays, see [`Effect::DELAYS`].
    pub holds_delay: bool,
    /// It counts something: a whole number, which decides how much there is to compute.
    pub counts: bool,
}

/// Role of a parameter in a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// It is estimated.
    Free,
    /// A constant of the law, or a thing that a log of commands and motion does not show: it keeps its value.
    Constant,
    /// A whole number that selects a variant: each is tried.
    Choice,
    /// It has no slope while its effect is off: a search for effects leaves it, a fit that has the effect
    /// anyway estimates it, from the first of its `starts`.
    Companion,
}

/// A parameter of an effect, for its [`Effect::PARAMS`]; its description follows.
pub(crate) const fn param(name: &'static str, unit: &'static str, off: f64, range: [f64; 2]) -> Param {
    Param {
        name,
        unit,
        off,
        low: range[0],
        high: range[1],
        about: "",
        role: Role::Free,
        starts: &[],
        least: 0.0,
        holds_delay: false,
        counts: false,
    }
}

impl Param {
    const fn about(self, about: &'static str) -> Param {
        Param { about, ..self }
    }
    const fn constant(self) -> Param {
        Param { role: Role::Constant, ..self }
    }
    const fn starting_from(self, starts: &'static [f64]) -> Param {
        Param { starts, ..self }
    }
    const fn at_least(self, least: f64) -> Param {
        Param { least, ..self }
    }
    const fn holding_delay(self) -> Param {
        Param { holds_delay: true, ..self }
    }
    const fn choice(self) -> Param {
        Param { role: Role::Choice, ..self }
    }
    const fn counting(self) -> Param {
        Param { counts: true, ..self }
    }
    const fn companion(self, starts: &'static [f64]) -> Param {
        Param { role: Role::Companion, starts, ..self }
    }
    /// Size of what a value changes: of a scale of 0.9 the tenth that is missing, of a limit, a length or a time
    /// the value itself.
    pub fn reach(&self, value: f64) -> f64 {
        let is_scale = self.unit == "1" && self.off != 0.0;
        if is_scale { value.abs().min((value - self.off).abs()) } else { value.abs() }
    }
    /// The end of the range that lies farther from "off".
    pub fn farthest_bound(&self) -> f64 {
        if (self.high - self.off).abs() >= (self.low - self.off).abs() { self.high } else { self.low }
    }
}

/// The places at which an effect enters the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Hooks {
    /// On the command, before the vehicle obeys it.
    pub command: bool,
    /// On the rates that torques depend on.
    pub rates: bool,
    /// On the motion, as an acceleration.
    pub push: bool,
    /// On a camera frame when it is captured.
    pub frame: bool,
    /// On what is read at the end of a control tick.
    pub sense: bool,
}

impl Hooks {
    pub(crate) const NONE: Hooks =
        Hooks { command: false, rates: false, push: false, frame: false, sense: false };
    /// Changes of the command alone.
    pub const COMMAND: Hooks = Hooks { command: true, ..Hooks::NONE };
    pub(crate) const PUSH: Hooks = Hooks { push: true, ..Hooks::NONE };
    pub(crate) const FRAME: Hooks = Hooks { frame: true, ..Hooks::NONE };
    pub(crate) const SENSE: Hooks = Hooks { sense: true, ..Hooks::NONE };
    pub(crate) const COMMAND_AND_PUSH: Hooks = Hooks { command: true, ..Hooks::PUSH };
    pub(crate) const COMMAND_AND_SENSE: Hooks = Hooks { command: true, ..Hooks::SENSE };
    pub(crate) const RATES_AND_PUSH: Hooks = Hooks { rates: true, ..Hooks::PUSH };
    pub(crate) const PUSH_AND_SENSE: Hooks = Hooks { push: true, ..Hooks::SENSE };
    pub(crate) const FRAME_AND_SENSE: Hooks = Hooks { frame: true, ..Hooks::SENSE };
}

/// Requirements of an effect's formula on the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// Nothing: it flies with every form and at every action level.
    Any,
    /// Commanded angles and yaw rates: no body rates, no motors.
    Angles,
    /// The small-angle forms with their closed attitude loops: the motor-level form has its own.
    IdentifiedLoops,
}

/// Place and time of a call of a hook.
#[derive(Debug, Clone, Copy)]
pub struct HookContext<'a, R: Scalar> {
    /// Constants of the vehicle that the effect acts on.
    pub body: &'a VehicleConstants<R>,
    /// Length of the physics step for `command` and `push`, of the control tick for `sense`, from frame to
    /// frame for `frame`.
    pub h_s: f64,
    /// Length of a control tick.
    pub tick_s: f64,
    /// From the start of the control tick to the start of this physics step.
    pub since_tick_s: f64,
    /// Time since the episode began.
    pub t_s: R,
    /// First physics step of a control tick: a new command is here.
    pub first: bool,
    /// This tick's noise; channels are the effect's own.
    pub draw: &'a TickRng<'a, R>,
    /// Control ticks of this tile since the world was made; the same for all its lanes.
    pub clock: usize,
    /// Battery voltage of a log that has it; otherwise the battery is simulated.
    pub voltage_v: Option<&'a R>,
    /// The drones of the same world, this one among them, where they are expected at the middle of the tick.
    pub neighbours: &'a [Neighbour<R>],
    /// The place of this drone among them.
    pub own: usize,
}

/// One call of a hook.
#[derive(Debug, Clone, Copy)]
pub struct Call<'a, R: Scalar, const P: usize> {
    /// Values of the effect's parameters.
    pub params: &'a [R; P],
    /// The vehicle's state.
    pub x: &'a State<R>,
    /// Place and time, which a call shows as its own.
    pub context: &'a HookContext<'a, R>,
}

impl<'a, R: Scalar, const P: usize> Deref for Call<'a, R, P> {
    type Target = HookContext<'a, R>;
    #[inline(always)]
    fn deref(&self) -> &HookContext<'a, R> {
        self.context
    }
}

/// A drone as the others of its world feel it.
#[derive(Debug, Clone, Copy)]
pub struct Neighbour<R> {
    /// Position in the world frame.
    pub pos_m: [R; 3],
    /// Velocity in the world frame.
    pub vel_mps: [R; 3],
    /// 1 while it flies, 0 when it is gone.
    pub here: R,
}

impl<R: Scalar> Neighbour<R> {
    /// Nobody.
    #[inline(always)]
    pub fn gone() -> Self {
        Neighbour { pos_m: [R::zero(); 3], vel_mps: [R::zero(); 3], here: R::zero() }
    }
}

/// A camera frame: the pose that the marker detection reports.
#[derive(Debug, Clone, Copy)]
pub struct Frame<R: Scalar> {
    /// Lanes for which a frame was captured in this tick and is on its way.
    pub captured: R::Mask,
    /// Number of markers found in it; none means a lost marker.
    pub markers: R,
    /// Position of the vehicle over the marker, in the world frame.
    pub pos_m: [R; 3],
    /// Heading over the marker, right-handed about the upward axis.
    pub yaw_rad: R,
    /// Capture time.
    pub t_s: R,
    /// The field of markers: columns, rows and pitch; one marker at the origin unless an effect changes it.
    pub field: [R; 3],
    /// Horizontal offset of the nearest marker centre that is in view.
    pub nearest_m: [R; 2],
}

/// The last marker pose that arrived.
#[derive(Debug, Clone, Copy)]
pub struct PoseFix<R> {
    /// Position of the vehicle over the marker, in the world frame.
    pub pos_m: [R; 3],
    /// Heading over the marker, right-handed about the upward axis.
    pub yaw_rad: R,
    /// Capture time of its frame, since the episode began.
    pub t_s: R,
    /// 1 while the newest frame showed a marker, 0 after a frame without.
    pub valid: R,
}

impl<R: Scalar> PoseFix<R> {
    /// Delivers a frame to the lanes of `arrived`; one without markers keeps the last pose and marks it as no longer
    /// valid.
    #[inline(always)]
    pub fn deliver(&mut self, arrived: R::Mask, pos_m: [R; 3], yaw_rad: R, t_s: R, markers: R) {
        let seen = arrived & markers.gt(R::zero());
        for i in 0..3 {
            self.pos_m[i] = R::select(seen, pos_m[i], self.pos_m[i]);
        }
        self.yaw_rad = R::select(seen, yaw_rad, self.yaw_rad);
        self.t_s = R::select(seen, t_s, self.t_s);
        self.valid = R::select(seen, R::from_f64(1.0), R::select(arrived, R::zero(), self.valid));
    }
}

/// Measurements of the rig at a control tick.
#[derive(Debug, Clone, Copy)]
pub struct Reading<R> {
    /// Pose by the camera.
    pub marker: PoseFix<R>,
    /// Roll, pitch, yaw by the IMU.
    pub att_rad: [R; 3],
    /// Angular rates by the gyroscopes: roll, pitch, yaw.
    pub gyro_radps: [R; 3],
    /// Specific force along the body axes.
    pub acc_mps2: [R; 3],
    /// Voltage at the battery terminals.
    pub vbat_v: R,
}

/// An effect with `P` parameters and `S` numbers of state, generic over the number type. Only the hooks named
/// in `HOOKS` are called.
pub trait Effect<const P: usize, const S: usize>: Send + 'static {
    /// Key in configurations and in the registry, in snake case.
    const NAME: &'static str;
    /// Description for users, without a full stop.
    const ABOUT: &'static str;
    /// Equation, paper or derivation.
    const SOURCE: &'static str;
    /// Parameters in the order in which hooks get their values.
    const PARAMS: [Param; P];
    /// Values of all parameters from which a search begins too, beside "off" and [`Param::starts`].
    const STARTS: &'static [[f64; P]] = &[];
    /// Functions of the trait that are called.
    const HOOKS: Hooks;
    /// Physics steps per second that the effect needs. Pushes are held over a step and see the state at its
    /// middle, which is good to second order; only what feeds back on the fast attitude dynamics (5.1 has a
    /// pole at -28.8 1/s) needs more than the control rate.
    const PHYSICS_HZ: u32 = 50;
    /// Trace that the effect leaves in the log of a flight.
    const OBSERVABILITY: Observability = Observability::Deterministic;
    /// Part of what a small-angle model leaves out by its form: all effects of this kind are one finding.
    const MODEL_FORM: Geometry = Geometry::None;
    /// Requirements of its formula on the vehicle.
    const SCOPE: Scope = Scope::Any;
    /// Path of the model's number that has the same meaning as the effect's first parameter: the two add up.
    const MODEL_NUMBER: Option<&'static str> = None;
    /// [`Effect::push`] acts on the motion through the air: in a wind field it gets the velocity relative to the air
    /// in place of the velocity over the ground.
    const FEELS_AIR: bool = false;
    /// The vehicle gets its torques later than without the effect.
    const DELAYS: bool = false;
    /// The effect determines the battery's voltage.
    const IS_BATTERY: bool = false;
    /// Share of real vehicles that show the effect.
    const UBIQUITY: Ubiquity = Ubiquity::Some;
    /// The part that differs between flights.
    const FLIGHT_SPREAD: FlightSpread = FlightSpread::None;
    /// Number of its states, the last ones, that follow the vehicle's motion: a fit has to estimate them with it.
    /// (States that follow the commands alone can be run up.)
    const MOTION_STATES: usize = 0;
    /// Memory of the motion in its states other than lags, in seconds: a fit runs them up on the measured motion.
    const MOTION_MEMORY_S: f64 = 0.0;
    /// Numbers of one place of the ring, for a state that is a ring turned by [`HookContext::clock`]; otherwise 0.
    const RING: usize = 0;
    /// Returns the effect with more numbers of state, if `S` are too few for its memory at this control rate.
    fn wider<R: SimScalar>(_build: Build) -> Option<Box<dyn Stage<R>>> {
        None
    }
    /// Standard deviation of these at first, in their own units (rad/s^2 for what motors give).
    const LAG_SD: f64 = 20.0;
    /// First noise channel; an effect's own channels count on from here.
    const NOISE: u32 = channel(Self::NAME);

    /// The state at the start of an episode.
    #[inline(always)]
    fn start<R: Scalar>(_cx: Call<R, P>, _u: &Command<R>) -> [R; S] {
        [R::zero(); S]
    }
    /// Changes the command for the next physics step.
    #[inline(always)]
    fn command<R: Scalar>(_cx: Call<R, P>, _s: &mut [R; S], _u: &mut Command<R>) {}
    /// The rates about the body axes, which torques depend on, of a state whose rates are those of the angles.
    #[inline(always)]
    fn body_rates<R: Scalar>(_p: &[R; P], x: &State<R>) -> [R; 3] {
        x.rate_radps
    }
    /// Adds accelerations for the next physics step; the call's `x` is the state expected at its middle, its rates
    /// those of [`Effect::body_rates`] if an effect has them.
    #[inline(always)]
    fn push<R: Scalar>(_cx: Call<R, P>, _s: &mut [R; S], _u: &Command<R>, _out: &mut Accelerations<R>) {}
    /// Change a camera frame; the call's `x` is the true state at capture. Called only when some lane captured one:
    /// change state under `f.captured`.
    #[inline(always)]
    fn frame<R: Scalar>(_cx: Call<R, P>, _s: &mut [R; S], _f: &mut Frame<R>) {}
    /// Change the reading at the end of a control tick.
    #[inline(always)]
    fn sense<R: Scalar>(_cx: Call<R, P>, _s: &mut [R; S], _y: &mut Reading<R>) {}
}

/// An effect as the rest of the program sees it.
pub struct Entry {
    /// See [`Effect::NAME`].
    pub name: &'static str,
    /// See [`Effect::ABOUT`].
    pub about: &'static str,
    /// See [`Effect::SOURCE`].
    pub source: &'static str,
    /// See [`Effect::PARAMS`].
    pub params: &'static [Param],
    /// See [`Effect::STARTS`]: as many numbers for each as there are parameters.
    pub starts: &'static [f64],
    /// See [`Effect::HOOKS`].
    pub hooks: Hooks,
    /// See [`Effect::PHYSICS_HZ`].
    pub physics_hz: u32,
    /// See [`Effect::OBSERVABILITY`].
    pub observability: Observability,
    /// See [`Effect::MODEL_FORM`].
    pub geometry: Geometry,
    /// See [`Effect::SCOPE`].
    pub scope: Scope,
    /// See [`Effect::MODEL_NUMBER`].
    pub model_number: Option<&'static str>,
    /// See [`Effect::FEELS_AIR`].
    pub feels_air: bool,
    /// See [`Effect::DELAYS`].
    pub delays: bool,
    /// See [`Effect::IS_BATTERY`].
    pub is_battery: bool,
    /// See [`Effect::UBIQUITY`].
    pub ubiquity: Ubiquity,
    /// See [`Effect::FLIGHT_SPREAD`].
    pub flight_spread: FlightSpread,
    /// See [`Effect::MOTION_STATES`] and [`Effect::LAG_SD`].
    pub lags: usize,
    /// See [`Effect::LAG_SD`].
    pub lag_sd: f64,
    /// See [`Effect::MOTION_MEMORY_S`].
    pub motion_memory_s: f64,
    pub(crate) lanes: fn(Build) -> Box<dyn Stage<Lanes>>,
    #[cfg(all(target_arch = "x86_64", not(test)))]
    pub(crate) avx2: fn(Build) -> Box<dyn Stage<crate::lanes_avx2::Lanes>>,
    #[cfg(all(target_arch = "x86_64", not(test)))]
    pub(crate) avx512: fn(Build) -> Box<dyn Stage<crate::lanes_avx512::Lanes>>,
    pub(crate) double: fn(Build) -> Box<dyn Stage<f64>>,
    #[cfg(feature = "recording")]
    pub(crate) symbol: fn(Build) -> Box<dyn Stage<crate::symbol::Symbol>>,
    pub(crate) dual: fn(Build) -> Box<dyn Stage<Dual>>,
    pub(crate) mean: fn(Build) -> Box<dyn Stage<Mean>>,
}

macro_rules! registry {
    ($($module:ident :: $effect:ident $(:: $value:ident)?),* $(,)?) => {
        $(mod $module;)*
        /// Every effect, in the order in which they are applied.
        pub fn registry() -> &'static [Entry] {
            static REGISTRY: &[Entry] = &[$(stage::entry(&$module::$effect $(:: $value)?)),*];
            REGISTRY
        }
    };
}

// Command effects stand in the order in which a command passes them: ground station, radio, firmware, motors.
// Changes of the thrust precede changes of its direction, and so do torques, which the rigid body turns into
// angles; other forces follow. Frame effects: field of view, then errors of the detection, then the way to the
// controller.
registry![
    cmd_deadband::CmdDeadband,
    packet_loss::PacketLoss,
    cmd_delay::CmdDelay::NEW,
    cmd_limit::CmdLimit,
    cmd_rate_limit::CmdRateLimit,
    backlash::Backlash,
    yaw_rate_loop::YawRateLoop,
    attitude_gain::AttitudeGain,
    attitude_order::AttitudeOrder,
    alloc_cross::AllocCross,
    estimator_tilt::EstimatorTilt,
    com_offset::ComOffset,
    motor_lag::MotorLag,
    motor_saturation::MotorSaturation,
    ground_effect::GroundEffect,
    ground_effect_exp::GroundEffectExp,
    battery_sag::BatterySag,
    motor_warming::MotorWarming,
    mass_change::MassChange,
    slung_load::SlungLoad,
    thrust_scale::ThrustScale,
    thrust_step::ThrustStep,
    thrust_slope::ThrustSlope,
    weak_motor::WeakMotor,
    inertia_scale::InertiaScale,
    flap::Flap,
    rigid_body::RigidBody,
    tilt_loss::TiltLoss,
    exact_tan::ExactTan,
    drag_linear::DragLinear,
    drag_quadratic::DragQuadratic,
    wind::Wind,
    wind_step::WindStep,
    gust::Gust,
    periodic_force::PeriodicForce,
    heave_damping::HeaveDamping,
    euler_kinematics::EulerKinematics,
    yaw_drift::YawDrift,
    downwash::Downwash,
    learned::Learned,
    imu_tilt::ImuTilt,
    marker_tilt::MarkerTilt,
    gyro_bias::GyroBias,
    camera::Camera,
    markers::Markers,
    camera_fov::CameraFov,
    camera_vibration::CameraVibration,
    lens_distortion::LensDistortion,
    frame_yaw::FrameYaw,
    camera_mount::CameraMount,
    camera_lever::CameraLever,
    camera_scale::CameraScale,
    camera_noise::CameraNoise,
    camera_drift::CameraDrift,
    camera_outliers::CameraOutliers,
    camera_flip::CameraFlip,
    camera_latency::CameraLatency::NEW,
];

/// The entry of an effect and its place in the registry.
///
/// # Errors
/// [`crate::Error::Unknown`] with a proposal.
pub fn find(name: &str) -> crate::Result<(usize, &'static Entry)> {
    crate::error::find_named("effect", name, registry().iter().enumerate(), |(_, e)| e.name)
}
