//! The simulation in real time, on a thread of its own: links never wait for a step.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crazyflie_env::error::Result;
use crazyflie_env::model::Model;
use crazyflie_env::observation::Interface;
use crazyflie_env::plant::{Command, State};
use tokio_util::sync::CancellationToken;

use crate::board::Board;
use crate::fleet::Fleet;
use crate::pilot::{Pilot, PilotPlan};
use crate::telemetry::Telemetry;
use crate::{PositionSource, Settings};

/// Ticks a second: as the firmware's position loop, and a fresh value for each of the fastest logs.
pub(crate) const TICK_HZ: f64 = 100.0;
/// A simulation that is so far behind does not catch up.
const MAX_BEHIND: Duration = Duration::from_millis(200);

/// One drone at a moment, for who watches.
#[derive(Debug, Clone, Copy)]
pub struct Moment {
    /// Since the start, simulated.
    pub time_s: f64,
    /// The true state.
    pub state: State<f64>,
    /// Where the filter believes it.
    pub estimate_m: [f64; 3],
    /// Heading by the filter.
    pub estimate_yaw_rad: f64,
    /// Place that is asked for; 0 where none is.
    pub target_m: [f64; 3],
    /// Heading that is asked for.
    pub target_yaw_rad: f64,
    /// Command in force.
    pub command: Command<f64>,
}

/// Who watches: called after every tick with all drones.
pub type Watcher = Box<dyn FnMut(&[Moment]) + Send>;

pub(crate) struct Simulation {
    boards: Vec<Arc<Mutex<Board>>>,
    pilots: Vec<Pilot>,
    fleet: Fleet,
    speed: f64,
    tick_s: f64,
    ticks: u64,
    watcher: Option<Watcher>,
}

/// The model on the clocks of this simulation.
fn clocked(model: &Model) -> Model {
    let mut model = model.clone();
    let imu_hz = model.rig.imu.value;
    model.rig.control.value = TICK_HZ;
    model.rig.imu.value = (imu_hz / TICK_HZ).ceil().max(1.0) * TICK_HZ;
    model
}

impl Simulation {
    /// # Errors
    /// For a model, a form or effects that cannot be flown.
    pub(crate) fn new(settings: &Settings, watcher: Option<Watcher>) -> Result<Self> {
        let model = clocked(&settings.model);
        let fleet = Fleet::new(&model, settings.vertical, &settings.effects, settings.drones, settings.seed)?;
        let plan = PilotPlan {
            model: &model,
            interface: Interface::from_model(&model, settings.vertical)?,
            tick_s: 1.0 / TICK_HZ,
            positions: settings.positions,
            auto_arms: settings.auto_arms,
            patience: settings.speed.max(1.0),
        };
        let seed = |drone: usize| crazyflie_env::noise::episode_key(settings.seed ^ PILOT_SEED, drone as u64);
        let lighthouse = settings.positions == PositionSource::Lighthouse;
        let board = |drone: usize| Arc::new(Mutex::new(Board::new(drone, lighthouse)));
        Ok(Simulation {
            boards: (0..settings.drones).map(board).collect(),
            pilots: (0..settings.drones).map(|i| Pilot::new(&plan, seed(i))).collect::<Result<_>>()?,
            fleet,
            speed: settings.speed,
            tick_s: plan.tick_s,
            ticks: 0,
            watcher,
        })
    }

    pub(crate) fn boards(&self) -> &[Arc<Mutex<Board>>] {
        &self.boards
    }

    /// One tick of all drones.
    pub(crate) fn tick(&mut self) {
        let mut flown: Vec<(Command<f64>, Telemetry)> = Vec::with_capacity(self.pilots.len());
        for ((pilot, board), sensed) in self.pilots.iter_mut().zip(&self.boards).zip(self.fleet.sensed()) {
            let (orders, settings) = lock(board).take_orders();
            flown.push(pilot.tick(orders, &settings, sensed));
        }
        let commands: Vec<Command<f64>> = flown.iter().map(|(command, _)| *command).collect();
        self.fleet.step(&commands);
        self.ticks += 1;
        let time_ms = (self.ticks as f64 * self.tick_s * 1e3).round() as u64 as u32;
        for (board, (_, telemetry)) in self.boards.iter().zip(&flown) {
            lock(board).show(Telemetry { time_ms, ..*telemetry });
        }
        if let Some(watcher) = &mut self.watcher {
            let time_s = self.ticks as f64 * self.tick_s;
            let moments = flown.iter().zip(self.fleet.sensed()).map(|((command, shown), sensed)| Moment {
                time_s,
                state: sensed.state,
                estimate_m: shown.pos_m,
                estimate_yaw_rad: shown.att_deg[2].to_radians(),
                target_m: shown.target_m,
                target_yaw_rad: shown.target_yaw_deg.to_radians(),
                command: *command,
            });
            watcher(&moments.collect::<Vec<_>>());
        }
    }

    /// Ticks in real time, until it is told to stop.
    pub(crate) fn run(mut self, stop: &CancellationToken) {
        let period = Duration::from_secs_f64(self.tick_s / self.speed);
        let mut due = Instant::now();
        let mut told = false;
        while !stop.is_cancelled() {
            self.tick();
            due += period;
            let now = Instant::now();
            if let Some(left) = due.checked_duration_since(now) {
                sleep(left);
            } else if now - due > MAX_BEHIND {
                if !told {
                    tracing::warn!(
                        speed = self.speed,
                        "this machine is too slow for this speed: time stretches"
                    );
                }
                (due, told) = (now, true);
            }
        }
    }
}

/// Keeps what pilots draw apart from what the worlds draw.
const PILOT_SEED: u64 = 0x5049_4c4f_5453_4545;

fn lock(board: &Mutex<Board>) -> std::sync::MutexGuard<'_, Board> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}
