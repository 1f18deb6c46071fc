//! The onboard tasks of one drone in a tick: positions into the filter, set-points by their priority, the supervisor,
//! the cascade. The simulation calls it; packets reach it as orders.

use crazyflie_env::action::{Cascade, Interface, LateralSetpoint, VerticalSetpoint, YawSetpoint};
use crazyflie_env::effects::Reading;
use crazyflie_env::error::Result;
use crazyflie_env::free_flight::FreeDrone;
use crazyflie_env::model::{Model, ROOM_M};
use crazyflie_env::plant::{Command, State};
use rand::SeedableRng;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;

use crate::estimator::Estimator;
use crate::high_level::{HighLevelCommand, Planner};
use crate::order::{Order, PilotSettings};
use crate::polynomial::PathPoint;
use crate::setpoint::{AttitudeSetpoint, Setpoint, place, thrust};
use crate::supervisor::{LEVEL_AFTER_S, Request, STOP_AFTER_S, Supervisor, VehicleCondition, bit};
use crate::telemetry::{self, Telemetry};

/// The onboard filter's source of positions, besides those that the script sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PositionSource {
    /// The vehicle measures them itself, as with a Lighthouse deck.
    Lighthouse,
    /// Motion capture sends them: place and heading, a hundred times a second.
    Mocap,
    /// A camera and a marker send them: place and heading, with the camera's effects.
    Aruco,
    /// Nobody: the script has to.
    Script,
}

/// Standard deviations: of a Lighthouse's position, and of a motion capture's position and heading.
const LIGHTHOUSE_M: f64 = 0.002;
const MOCAP_M: f64 = 0.0005;
const MOCAP_RAD: f64 = 0.005;
/// Voltages of a full and an empty cell.
const FULL_V: f64 = 4.2;
const EMPTY_V: f64 = 3.0;

#[derive(Debug, Clone, Copy)]
enum LowLevel {
    Attitude { setpoint: AttitudeSetpoint, right_handed: bool },
    Fly(Setpoint),
    Stop,
}

impl LowLevel {
    /// Returns whether it wants a vehicle that flies.
    fn flies(&self) -> bool {
        match self {
            LowLevel::Attitude { setpoint, .. } => setpoint.thrust_pwm > 0.0,
            LowLevel::Fly(_) => true,
            LowLevel::Stop => false,
        }
    }
}

/// The set-point of the commander that is in force.
#[derive(Debug, Clone, Copy)]
struct InForce {
    setpoint: LowLevel,
    age_s: f64,
    /// A plan of the high-level commander goes before it.
    relaxed: bool,
}

/// Settings shared by all drones.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PilotPlan {
    pub interface: Interface,
    pub tick_s: f64,
    pub positions: PositionSource,
    pub auto_arms: bool,
    /// Set-points age slower by this: a script that sends in real time flies a faster simulation.
    pub patience: f64,
    /// The battery's effect is on.
    pub has_battery: bool,
}

/// The drone's own computer.
pub(crate) struct Pilot {
    plan: PilotPlan,
    gravity_mps2: f64,
    cascade: Cascade,
    estimator: Estimator,
    supervisor: Supervisor,
    planner: Planner,
    in_force: Option<InForce>,
    /// Request of a script since the last tick.
    request: Option<Request>,
    thrust_locked: bool,
    thrust_pwm: f64,
    seen_s: f64,
    extpos_m: [f64; 3],
    rng: Pcg64Mcg,
}

impl Pilot {
    /// # Errors
    /// The error of a model that lacks the form of the interface.
    pub(crate) fn new(model: &Model, plan: PilotPlan, seed: u64) -> Result<Self> {
        Ok(Pilot {
            plan,
            gravity_mps2: model.lateral.gravity.value,
            cascade: Cascade::new(model, &plan.interface, plan.tick_s)?,
            estimator: Estimator::new([0.0; 3], 0.0, 0.0),
            supervisor: Supervisor::new(plan.auto_arms),
            planner: Planner::default(),
            in_force: None,
            request: None,
            thrust_locked: true,
            thrust_pwm: 0.0,
            seen_s: f64::NEG_INFINITY,
            extpos_m: [0.0; 3],
            rng: Pcg64Mcg::seed_from_u64(seed),
        })
    }

    /// A tick: what the motors get, and what the drone shows of itself.
    pub(crate) fn tick(
        &mut self,
        orders: impl IntoIterator<Item = Order>,
        settings: &PilotSettings,
        sensed: &FreeDrone,
    ) -> (Command<f64>, Telemetry) {
        self.cascade.set_gains(settings.gains);
        self.estimator.predict(&sensed.reading, self.gravity_mps2, settings.noise, self.plan.tick_s);
        self.measure_position(sensed, settings);
        for order in orders {
            self.obey(order, settings, sensed);
        }
        let vbat_v = if self.plan.has_battery { sensed.reading.vbat_v } else { FULL_V };
        let [roll, pitch, _] = sensed.reading.att_rad;
        let watched = VehicleCondition {
            tilt_rad: roll.hypot(pitch),
            collided: sensed.collided,
            thrust: self.thrust_pwm > 0.0,
            vbat_v,
        };
        self.supervisor.tick(&watched, &settings.limits, self.plan.tick_s);
        let setpoint = self.choose(settings).filter(|_| self.supervisor.can_fly());
        let command = self.command(setpoint, &sensed.reading);
        self.thrust_pwm = command.lift;
        let shown = self.telemetry(sensed, settings, setpoint, &command, vbat_v);
        (command, Telemetry { request: self.request.take(), ..shown })
    }

    /// Measures the drone's position, by its own sensors or by the system around it.
    fn measure_position(&mut self, sensed: &FreeDrone, settings: &PilotSettings) {
        let State { pos_m, att_rad, .. } = sensed.state;
        match self.plan.positions {
            PositionSource::Lighthouse => {
                let seen_m = self.scattered(pos_m, LIGHTHOUSE_M);
                self.estimator.correct(seen_m, LIGHTHOUSE_M);
            }
            PositionSource::Mocap => {
                let seen_m = self.scattered(pos_m, MOCAP_M);
                let [yaw_rad, ..] = self.scattered([att_rad[2]; 3], MOCAP_RAD);
                self.extpos_m = seen_m;
                self.estimator.correct(seen_m, settings.extpos_m);
                self.estimator.correct_yaw(yaw_rad, MOCAP_RAD.max(settings.extquat_rad));
            }
            PositionSource::Aruco => {
                let fix = sensed.reading.marker;
                if fix.valid > 0.5 && fix.t_s > self.seen_s {
                    self.seen_s = fix.t_s;
                    self.extpos_m = fix.pos_m;
                    self.estimator.correct(fix.pos_m, settings.extpos_m);
                    // a degree, as a good marker pose has
                    self.estimator.correct_yaw(fix.yaw_rad, 1_f64.to_radians());
                }
            }
            PositionSource::Script => {}
        }
    }

    fn scattered(&mut self, numbers: [f64; 3], sd: f64) -> [f64; 3] {
        // the deviation is a constant that is fine
        let Ok(normal) = Normal::new(0.0, sd) else { return numbers };
        numbers.map(|number| number + normal.sample(&mut self.rng))
    }

    fn obey(&mut self, order: Order, settings: &PilotSettings, sensed: &FreeDrone) {
        match order {
            Order::Attitude(setpoint) => self.attitude(setpoint),
            Order::Manual(setpoint) => self.force(LowLevel::Attitude { setpoint, right_handed: true }),
            Order::Fly(setpoint) => self.force(LowLevel::Fly(setpoint)),
            Order::Stop => self.force(LowLevel::Stop),
            Order::Relax { remains_s } => {
                if let Some(now) = &mut self.in_force {
                    (now.relaxed, now.age_s) = (true, LEVEL_AFTER_S * self.plan.patience - remains_s);
                }
            }
            Order::HighLevel(command) => {
                if command.flies() {
                    self.request =
                        Some(if settings.high_level { Request::Flight } else { Request::DisabledFlight });
                }
                if settings.high_level {
                    self.plan(command, settings, sensed);
                }
            }
            Order::Arm(arm) => {
                self.request = if arm { Some(Request::Arming) } else { self.request };
                self.supervisor.arm(arm);
            }
            Order::Recover => {
                self.request = Some(Request::Recovery);
                self.supervisor.recover();
                self.planner.stop();
                self.in_force = None;
            }
            Order::Emergency => self.supervisor.stop_for_good(),
            Order::EmergencyWatchdog => self.supervisor.feed_watchdog(),
            Order::Position(pos_m) => {
                self.extpos_m = pos_m;
                self.estimator.correct(pos_m, settings.extpos_m);
            }
            Order::Pose { pos_m, yaw_rad } => {
                self.extpos_m = pos_m;
                self.estimator.correct(pos_m, settings.extpos_m);
                self.estimator.correct_yaw(yaw_rad, settings.extquat_rad);
            }
            Order::ResetEstimator => self.reset_estimator(settings, sensed),
            Order::Restart => {
                self.supervisor = Supervisor::new(self.plan.auto_arms);
                (self.planner, self.in_force, self.thrust_locked) = (Planner::default(), None, true);
                self.reset_estimator(settings, sensed);
            }
        }
    }

    fn reset_estimator(&mut self, settings: &PilotSettings, sensed: &FreeDrone) {
        let imu_yaw_rad = sensed.reading.att_rad[2];
        self.estimator = Estimator::new(settings.start_m, settings.start_yaw_rad, imu_yaw_rad);
        self.seen_s = f64::NEG_INFINITY;
    }

    fn force(&mut self, setpoint: LowLevel) {
        self.planner.stop();
        // only the first set-point of a stream
        if setpoint.flies() && !self.in_force.is_some_and(|before| before.setpoint.flies()) {
            self.request = Some(Request::Flight);
        }
        self.in_force = Some(InForce { setpoint, age_s: 0.0, relaxed: false });
    }

    /// The first of all commanders gives no thrust before it got a thrust of zero.
    fn attitude(&mut self, setpoint: AttitudeSetpoint) {
        let is_first = self.in_force.is_none();
        self.thrust_locked |= is_first;
        self.thrust_locked &= setpoint.thrust_pwm > 0.0;
        if is_first && self.thrust_locked {
            self.request = Some(Request::LockedThrust);
        }
        let thrust_pwm = if self.thrust_locked { 0.0 } else { thrust(setpoint.thrust_pwm) };
        let setpoint = AttitudeSetpoint { thrust_pwm, ..setpoint };
        self.force(LowLevel::Attitude { setpoint, right_handed: false });
    }

    fn plan(&mut self, command: HighLevelCommand, settings: &PilotSettings, sensed: &FreeDrone) {
        // a client takes its leave with a thrust of nothing: on the ground that is not in the way of the next
        if sensed.contact.standing && self.thrust_pwm == 0.0 {
            self.in_force = None;
        }
        let ([x, y, z], [vx, vy, vz]) = (self.estimator.pos_m(), self.estimator.vel_mps());
        let now = PathPoint { at: [x, y, z, self.estimator.yaw_rad()], rate: [vx, vy, vz, 0.0] };
        self.planner.obey(command, &now, settings.speeds_mps);
    }

    /// Returns the set-point in force. An old set-point is levelled, and then dropped.
    fn choose(&mut self, settings: &PilotSettings) -> Option<LowLevel> {
        let held = self.in_force.filter(|now| !(now.relaxed && self.planner.is_active()));
        let Some(mut now) = held else {
            self.in_force = None;
            let path = self.planner.tick(self.plan.tick_s).filter(|_| settings.high_level)?;
            let [x, y, z, yaw] = path.at;
            return Some(LowLevel::Fly(place([x, y, z], yaw)));
        };
        now.age_s += self.plan.tick_s;
        self.in_force = Some(now);
        if now.age_s > STOP_AFTER_S * self.plan.patience {
            self.in_force = None;
            return None;
        }
        Some(if now.age_s > LEVEL_AFTER_S * self.plan.patience {
            levelled(now.setpoint)
        } else {
            now.setpoint
        })
    }

    fn command(&mut self, setpoint: Option<LowLevel>, y: &Reading<f64>) -> Command<f64> {
        let x = State {
            pos_m: self.estimator.pos_m(),
            vel_mps: self.estimator.vel_mps(),
            att_rad: [y.att_rad[0], y.att_rad[1], self.estimator.yaw_rad()],
            rate_radps: y.gyro_radps,
            aux: [0.0; 2],
        };
        match setpoint {
            Some(LowLevel::Fly(Setpoint { lateral, in_body, vertical, yaw })) => {
                let lateral = match lateral {
                    LateralSetpoint::Velocity([front, left]) if in_body => {
                        let (sin, cos) = x.att_rad[2].sin_cos();
                        LateralSetpoint::Velocity([cos * front - sin * left, sin * front + cos * left])
                    }
                    lateral => lateral,
                };
                self.cascade.command(lateral, vertical, yaw, &x)
            }
            Some(LowLevel::Attitude { setpoint, right_handed }) if setpoint.thrust_pwm > 0.0 => {
                let sign = if right_handed { 1.0 } else { self.plan.interface.yaw_sign };
                let thrust_pwm = setpoint.thrust_pwm.min(self.plan.interface.lift_max);
                self.cascade.command(
                    LateralSetpoint::Tilt(setpoint.tilt_rad),
                    VerticalSetpoint::Lift(thrust(thrust_pwm)),
                    YawSetpoint::Rate(sign * setpoint.yaw_rate_radps),
                    &x,
                )
            }
            _ => {
                self.cascade.reset();
                Command::level(0.0)
            }
        }
    }

    fn telemetry(
        &self,
        sensed: &FreeDrone,
        settings: &PilotSettings,
        setpoint: Option<LowLevel>,
        command: &Command<f64>,
        vbat_v: f64,
    ) -> Telemetry {
        let y = &sensed.reading;
        let [var_pos_m2, var_vel_m2ps2] = self.estimator.variances();
        let mut shown = Telemetry {
            tick_s: self.plan.tick_s,
            pos_m: self.estimator.pos_m(),
            vel_mps: self.estimator.vel_mps(),
            var_pos_m2,
            var_vel_m2ps2,
            att_deg: [y.att_rad[0], y.att_rad[1], self.estimator.yaw_rad()].map(f64::to_degrees),
            gyro_degps: y.gyro_radps.map(f64::to_degrees),
            acc_g: y.acc_mps2.map(|acc| acc / self.gravity_mps2),
            vbat_v,
            battery_percent: (100.0 * (vbat_v - EMPTY_V) / (FULL_V - EMPTY_V)).clamp(0.0, 100.0),
            power_state: self.supervisor.power_state(),
            thrust_pwm: command.lift,
            asked_deg: [
                command.roll_rad,
                command.pitch_rad,
                self.plan.interface.yaw_sign * command.yaw_rate_radps,
            ]
            .map(f64::to_degrees),
            info: self.info(settings),
            touches: sensed.collided && settings.limits.tumble,
            extpos_m: self.extpos_m,
            true_pos_m: sensed.state.pos_m,
            clear_m: telemetry::clear_m(&sensed.state, ROOM_M),
            flow: telemetry::flow(&sensed.state, y.gyro_radps, self.plan.tick_s),
            ..Telemetry::default()
        };
        if let Some(LowLevel::Fly(setpoint)) = setpoint {
            match setpoint.lateral {
                LateralSetpoint::Place(xy) => shown.target_m[..2].copy_from_slice(&xy),
                LateralSetpoint::Velocity(xy) => shown.target_mps[..2].copy_from_slice(&xy),
                LateralSetpoint::Tilt(_) => {}
            }
            match setpoint.vertical {
                VerticalSetpoint::Height(z) => shown.target_m[2] = z,
                VerticalSetpoint::Climb(z) => shown.target_mps[2] = z,
                VerticalSetpoint::Lift(_) => {}
            }
            if let YawSetpoint::Heading(yaw_rad) = setpoint.yaw {
                shown.target_yaw_deg = yaw_rad.to_degrees();
            }
        }
        shown
    }

    fn info(&self, settings: &PilotSettings) -> u16 {
        let on = |condition: bool, bit: u16| if condition { bit } else { 0 };
        let blocked = self.in_force.is_some_and(|now| !now.relaxed) || !settings.high_level;
        self.supervisor.info()
            | on(self.planner.is_active() && !blocked, bit::HL_ACTIVE)
            | on(self.planner.is_finished(), bit::HL_FINISHED)
            | on(blocked, bit::HL_DISABLED)
    }
}

/// Levels a set-point: upright and without turning; height and thrust stay as commanded.
fn levelled(setpoint: LowLevel) -> LowLevel {
    match setpoint {
        LowLevel::Fly(setpoint) => LowLevel::Fly(Setpoint {
            lateral: LateralSetpoint::Tilt([0.0; 2]),
            yaw: YawSetpoint::Rate(0.0),
            ..setpoint
        }),
        LowLevel::Attitude { setpoint: AttitudeSetpoint { thrust_pwm, .. }, right_handed } => {
            let setpoint = AttitudeSetpoint { tilt_rad: [0.0; 2], yaw_rate_radps: 0.0, thrust_pwm };
            LowLevel::Attitude { setpoint, right_handed }
        }
        LowLevel::Stop => LowLevel::Stop,
    }
}
