//! The simulation on a thread of its own, in real time or as its clients drive it: links never wait for a step.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crazyflie_env::action::Interface;
use crazyflie_env::error::Result;
use crazyflie_env::free_flight::FreeFlight;
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::has_battery;
use tokio::runtime::Handle;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::board::Board;
use crate::fleet;
use crate::pilot::{Pilot, PilotPlan};
use crate::telemetry::{self, Telemetry};
use crate::{Pace, PositionSource, Settings};

/// Ticks a second: as the firmware's position loop, and a fresh value for each of the fastest logs.
pub const TICK_HZ: f64 = 100.0;
/// A simulation that is so far behind does not catch up.
const MAX_BEHIND: Duration = Duration::from_millis(200);

/// One drone at a moment, for who watches.
#[derive(Debug, Clone, Copy)]
pub struct Moment {
    /// Since the start, simulated.
    pub time_s: f64,
    /// The true state.
    pub state: State<f64>,
    /// Estimate of the filter.
    pub estimate_m: [f64; 3],
    /// Heading by the filter.
    pub estimate_yaw_rad: f64,
    /// Place of the set-point; 0 if there is none.
    pub target_m: [f64; 3],
    /// Heading of the set-point.
    pub target_yaw_rad: f64,
    /// Command in force.
    pub command: Command<f64>,
}

impl Moment {
    /// The true attitude as x, y, z, w.
    pub fn quaternion_xyzw(&self) -> [f64; 4] {
        telemetry::quaternion(self.state.att_rad)
    }
}

/// Observer: called after every tick with all drones.
pub type Watcher = Box<dyn FnMut(&[Moment]) + Send>;

pub(crate) struct Simulation {
    boards: Vec<Arc<Mutex<Board>>>,
    pilots: Vec<Pilot>,
    flight: FreeFlight,
    settings: Settings,
    /// In lock-step: a client has requested time, or is gone.
    changed: Arc<Notify>,
    tick_s: f64,
    ticks: u64,
    watcher: Option<Watcher>,
}

/// The drones on their places, and their pilots.
fn placed(settings: &Settings) -> Result<(FreeFlight, Vec<Pilot>)> {
    let model = settings.model.clone().with_control_hz(TICK_HZ);
    let Settings { vertical, effects, drones, .. } = settings;
    let flight = fleet::on_ground(&model, *vertical, effects, *drones, settings.seed)?;
    let plan = PilotPlan {
        interface: Interface::from_model(&model, *vertical)?,
        tick_s: 1.0 / TICK_HZ,
        positions: settings.positions,
        auto_arms: settings.auto_arms,
        patience: settings.pace.patience(),
        has_battery: has_battery(&model, effects, *vertical)?,
    };
    let seed = |drone: usize| crazyflie_env::noise::episode_key(settings.seed ^ PILOT_SEED, drone as u64);
    let pilots = (0..*drones).map(|drone| Pilot::new(&model, plan, seed(drone))).collect::<Result<_>>()?;
    Ok((flight, pilots))
}

impl Simulation {
    /// # Errors
    /// For a model, a form or effects that cannot be flown.
    pub(crate) fn new(settings: &Settings, watcher: Option<Watcher>) -> Result<Self> {
        let (flight, pilots) = placed(settings)?;
        let mut decks = settings.decks.clone();
        decks.extend((settings.positions == PositionSource::Lighthouse).then_some("deck.bcLighthouse4"));
        let changed = Arc::new(Notify::new());
        let lockstep = settings.pace == Pace::Lockstep;
        let latency_ms = if lockstep { settings.quality.latency.as_millis() as u32 } else { 0 };
        let board = |drone: usize| {
            let clock = lockstep.then(|| Arc::clone(&changed));
            Arc::new(Mutex::new(Board::new(drone, &settings.model.name, decks.clone(), clock, latency_ms)))
        };
        Ok(Simulation {
            boards: (0..settings.drones).map(board).collect(),
            pilots,
            flight,
            settings: settings.clone(),
            changed,
            tick_s: 1.0 / TICK_HZ,
            ticks: 0,
            watcher,
        })
    }

    pub(crate) fn boards(&self) -> &[Arc<Mutex<Board>>] {
        &self.boards
    }

    /// Puts all drones on their places again, upright, if a client requests that, or connects and resets are on.
    fn put_back(&mut self) {
        let (mut asked, mut came, mut alone) = (false, false, true);
        for board in &self.boards {
            let mut board = lock(board);
            let (taken, is_new) = board.take_visit();
            asked |= board.take_reset();
            came |= is_new;
            alone &= is_new || !taken;
        }
        if asked || (self.settings.resets && came && alone) {
            // it went well at the start
            if let Ok(placed) = placed(&self.settings) {
                (self.flight, self.pilots) = placed;
            }
        }
    }

    /// One tick of all drones.
    pub(crate) fn tick(&mut self) {
        self.put_back();
        let mut flown: Vec<(Command<f64>, Telemetry)> = Vec::with_capacity(self.pilots.len());
        for ((pilot, board), sensed) in self.pilots.iter_mut().zip(&self.boards).zip(self.flight.drones()) {
            let (orders, settings) = lock(board).take_orders();
            flown.push(pilot.tick(orders, &settings, sensed));
        }
        let commands: Vec<Command<f64>> = flown.iter().map(|(command, _)| *command).collect();
        self.flight.tick(&commands);
        // telemetry is of the state before the step
        let time_ms = (self.ticks as f64 * self.tick_s * 1e3).round() as u64 as u32;
        self.ticks += 1;
        for (board, (_, telemetry)) in self.boards.iter().zip(&flown) {
            lock(board).show(Telemetry { time_ms, ..*telemetry });
        }
        if let Some(watcher) = &mut self.watcher {
            let time_s = self.ticks as f64 * self.tick_s;
            let moments = flown.iter().zip(self.flight.drones()).map(|((command, shown), sensed)| Moment {
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

    /// Returns whether the state of every drone is finite.
    #[cfg(any(test, fuzzing))]
    pub(crate) fn is_finite(&self) -> bool {
        let numbers = |state: &State<f64>| [state.pos_m, state.vel_mps, state.att_rad, state.rate_radps];
        self.flight
            .drones()
            .iter()
            .all(|drone| numbers(&drone.state).as_flattened().iter().all(|n| n.is_finite()))
    }

    /// Ticks until it is stopped, on a thread of the runtime that may block.
    pub(crate) fn run(self, stop: &CancellationToken) {
        match self.settings.pace {
            Pace::Clock { speed } => self.run_by_clock(speed, stop),
            Pace::Lockstep => Handle::current().block_on(self.run_in_lockstep(stop)),
        }
    }

    /// A tick whenever every client that drives the clock waits for one.
    async fn run_in_lockstep(mut self, stop: &CancellationToken) {
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                () = self.changed.notified() => {}
            }
            while self.is_waited_for() && !stop.is_cancelled() {
                self.tick();
            }
        }
    }

    fn is_waited_for(&self) -> bool {
        let mut waits = self.boards.iter().filter_map(|board| lock(board).waits_for_tick()).peekable();
        waits.peek().is_some() && waits.all(|waits| waits)
    }

    fn run_by_clock(mut self, speed: f64, stop: &CancellationToken) {
        let period = Duration::from_secs_f64(self.tick_s / speed);
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
                    tracing::warn!(speed, "this machine is too slow for this speed: time stretches");
                }
                (due, told) = (now, true);
            }
        }
    }
}

/// Keeps what pilots draw apart from what the worlds draw.
const PILOT_SEED: u64 = 0x5049_4c4f_5453_4545;

pub(crate) fn lock(board: &Mutex<Board>) -> std::sync::MutexGuard<'_, Board> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};

    use crazyflie_env::config::{EffectTable, Options};
    use crazyflie_env::free_flight::FreeStart;
    use crazyflie_env::model::{Model, VerticalInput};
    use tokio::sync::mpsc;

    use super::*;
    use crate::LinkQuality;
    use crate::packet::Packet;

    fn simulation(vertical: VerticalInput, drones: usize) -> Simulation {
        Simulation::new(&settings(vertical, drones), None).unwrap()
    }

    fn settings(vertical: VerticalInput, drones: usize) -> Settings {
        Settings {
            model: Model::thesis(),
            vertical,
            effects: EffectTable::new(),
            drones,
            pace: Pace::Clock { speed: 1.0 },
            quality: LinkQuality { loss: 0.0, latency: Duration::ZERO },
            seed: 7,
            positions: PositionSource::Lighthouse,
            auto_arms: true,
            decks: Vec::new(),
            resets: false,
            host: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 0,
            tcp_port: None,
        }
    }

    fn in_lockstep(drones: usize, latency: Duration) -> Simulation {
        let quality = LinkQuality { loss: 0.0, latency };
        let settings = Settings { pace: Pace::Lockstep, quality, ..settings(VerticalInput::Thrust, drones) };
        Simulation::new(&settings, None).unwrap()
    }

    fn send(simulation: &Simulation, drone: usize, port: u8, channel: u8, data: &[u8]) {
        lock(&simulation.boards[drone]).receive(&Packet::new(port, channel, data));
    }

    fn floats(head: &[u8], numbers: &[f32]) -> Vec<u8> {
        head.iter().copied().chain(numbers.iter().flat_map(|number| number.to_le_bytes())).collect()
    }

    /// Takes off to half a metre; the true places after as many seconds.
    fn take_off(simulation: &mut Simulation, seconds: usize) -> Vec<[f64; 3]> {
        for drone in 0..simulation.boards.len() {
            send(simulation, drone, 8, 0, &floats(&[1, 0], &[0.5, 2.0]));
        }
        (0..100 * seconds).for_each(|_| simulation.tick());
        simulation.flight.drones().iter().map(|sensed| sensed.state.pos_m).collect()
    }

    #[test]
    fn every_form_takes_off_and_the_same_seed_flies_the_same_bits() {
        for vertical in [VerticalInput::Thrust, VerticalInput::Motors, VerticalInput::Pwm] {
            let places = take_off(&mut simulation(vertical, 2), 6);
            for [x, y, z] in &places {
                let right = (x.abs() - 0.5).abs() < 0.05 && y.abs() < 0.05 && (z - 0.5).abs() < 0.1;
                assert!(right, "{vertical:?}: {places:?}");
            }
            assert_eq!(places, take_off(&mut simulation(vertical, 2), 6), "{vertical:?}");
        }
    }

    #[test]
    fn a_thrust_is_obeyed_only_after_a_thrust_of_nothing() {
        let mut simulation = simulation(VerticalInput::Thrust, 1);
        let setpoint = |thrust: u16| [floats(&[], &[0.0; 3]), thrust.to_le_bytes().to_vec()].concat();
        let mut fly = |thrusts: &[u16]| {
            for thrust in thrusts {
                send(&simulation, 0, 3, 0, &setpoint(*thrust));
                simulation.tick();
            }
            simulation.flight.drones()[0].state.pos_m[2]
        };
        assert_eq!(fly(&[50_000; 50]), 0.0);
        assert!(fly(&[&[0][..], &[50_000; 50]].concat()) > 0.1);
    }

    #[test]
    fn motors_stop_two_seconds_after_the_last_set_point() {
        let mut simulation = simulation(VerticalInput::Thrust, 1);
        for _ in 0..300 {
            send(&simulation, 0, 7, 0, &floats(&[9], &[0.0, 0.0, 0.0, 0.5]));
            simulation.tick();
        }
        let height_m = |simulation: &Simulation| simulation.flight.drones()[0].state.pos_m[2];
        (0..198).for_each(|_| simulation.tick());
        assert!(height_m(&simulation) > 0.4);
        (0..60).for_each(|_| simulation.tick());
        assert_eq!(height_m(&simulation), 0.0);
    }

    #[test]
    fn logs_go_to_the_client_and_a_slow_one_holds_nothing_up() {
        let mut simulation = simulation(VerticalInput::Thrust, 1);
        let (sink, mut outbox) = mpsc::channel(8);
        assert!(lock(&simulation.boards[0]).claim(&sink));
        assert!(!lock(&simulation.boards[0]).claim(&sink), "one client at a time");
        send(&simulation, 0, 5, 1, &[6, 1, 7, 2, 0]);
        send(&simulation, 0, 5, 1, &[3, 1, 1]);
        (0..1000).for_each(|_| simulation.tick());
        let first = outbox.try_recv().unwrap();
        assert_eq!((first.port, first.channel, first.data()[0]), (5, 2, 1));
        assert_eq!(std::iter::from_fn(|| outbox.try_recv().ok()).count(), 7);
    }

    /// Returns the text on the console of the only client within a tick.
    fn console(simulation: &mut Simulation, outbox: &mut mpsc::Receiver<Packet>) -> String {
        simulation.tick();
        let packets = std::iter::from_fn(|| outbox.try_recv().ok()).filter(|packet| packet.port == 0);
        String::from_utf8(packets.flat_map(|packet| packet.data().to_vec()).collect()).unwrap()
    }

    #[test]
    fn what_the_supervisor_refuses_is_told_once_with_the_remedy() {
        let take_off = floats(&[1, 0], &[0.5, 2.0]);
        let hover = floats(&[9], &[0.0, 0.0, 0.0, 0.5]);
        let mut simulation = simulation(VerticalInput::Thrust, 1);
        let (sink, mut outbox) = mpsc::channel(64);
        assert!(lock(&simulation.boards[0]).claim(&sink));
        simulation.tick();
        send(&simulation, 0, 3, 0, &[floats(&[], &[0.0; 3]), 50_000_u16.to_le_bytes().to_vec()].concat());
        let told = console(&mut simulation, &mut outbox);
        assert!(told.contains("Thrust refused. Send a thrust of 0 first"), "{told}");
        (0..300).for_each(|_| simulation.tick());
        send(&simulation, 0, 9, 1, &[3]);
        assert!(console(&mut simulation, &mut outbox).contains("Locked"));
        for (port, channel, packet, told) in [
            (8, 0, &take_off, "Flight refused. Locked"),
            (9, 1, &vec![2], "Crash recovery refused. Locked"),
            (9, 1, &vec![1, 1], "Arming refused. Locked"),
            (7, 0, &hover, "Flight refused. Locked"),
        ] {
            send(&simulation, 0, port, channel, packet);
            let heard = console(&mut simulation, &mut outbox);
            assert!(heard.contains(told) && heard.contains("sim.reset"), "{told}: {heard}");
        }
        for _ in 0..10 {
            send(&simulation, 0, 7, 0, &hover);
            assert_eq!(console(&mut simulation, &mut outbox), "", "of a stream the first set-point alone");
        }
    }

    #[test]
    fn a_vehicle_that_touches_another_tells_why_it_does_not_recover() {
        let mut simulation = simulation(VerticalInput::Thrust, 2);
        let (sink, mut outbox) = mpsc::channel(64);
        assert!(lock(&simulation.boards[0]).claim(&sink));
        let options = Options { vertical: Some(VerticalInput::Thrust), ..Options::default() };
        let start = FreeStart { pos_m: vec![[0.0; 3], [0.05, 0.0, 0.0]], load: None, seed: 1 };
        simulation.flight = FreeFlight::new(&Model::thesis(), &options, start).unwrap();
        (0..2).for_each(|_| simulation.tick());
        assert!(console(&mut simulation, &mut outbox).contains("Tumbled"));
        let answer = lock(&simulation.boards[0]).receive(&Packet::new(9, 1, &[2])).unwrap();
        assert_eq!(answer.data(), [0x82, 0, 0], "refused");
        let told = console(&mut simulation, &mut outbox);
        assert!(told.contains("Crash recovery refused. It touches another vehicle: set sim.reset"), "{told}");
        lock(&simulation.boards[0]).receive(&Packet::new(13, 0, &[2]));
        assert!(console(&mut simulation, &mut outbox).contains("Crash recovery refused"));
    }

    #[test]
    fn logs_have_the_errors_of_the_sensors() {
        let effects = Options::parse(r#"{"effects": {"gyro_bias": {"bias_degps": 5.0}}}"#).unwrap().effects;
        for (effects, errs) in [(EffectTable::new(), false), (effects, true)] {
            let settings = Settings { effects, ..settings(VerticalInput::Thrust, 1) };
            let mut simulation = Simulation::new(&settings, None).unwrap();
            let (sink, mut outbox) = mpsc::channel(8);
            assert!(lock(&simulation.boards[0]).claim(&sink));
            let id = crate::LOGS.iter().position(|log| log.name == "gyro.x").unwrap() as u8;
            send(&simulation, 0, 5, 1, &[6, 1, 7, id, 0]);
            send(&simulation, 0, 5, 1, &[3, 1, 1]);
            (0..3).for_each(|_| simulation.tick());
            let packet = std::iter::from_fn(|| outbox.try_recv().ok()).last().unwrap();
            let rate_degps = f32::from_le_bytes(*packet.data()[4..].first_chunk().unwrap());
            assert_eq!(rate_degps.abs() > 0.01, errs, "{rate_degps}");
        }
    }

    fn let_go_on(simulation: &Simulation, drone: usize, until_ms: u32) -> Option<u32> {
        let answer = lock(&simulation.boards[drone]).receive(&Packet::new(10, 0, &until_ms.to_le_bytes()))?;
        Some(u32::from_le_bytes(*answer.data().first_chunk().unwrap()))
    }

    #[test]
    fn a_tick_waits_for_every_client_that_drives_the_clock() {
        let mut simulation = in_lockstep(3, Duration::ZERO);
        let (sink, mut outbox) = mpsc::channel(8);
        assert!(lock(&simulation.boards[0]).claim(&sink) && lock(&simulation.boards[1]).claim(&sink));
        assert!(!simulation.is_waited_for(), "nobody drives the clock");
        assert_eq!(let_go_on(&simulation, 0, 20), None);
        assert!(simulation.is_waited_for());
        assert_eq!(let_go_on(&simulation, 1, 0), Some(0), "what has come is answered at once");
        assert!(simulation.is_waited_for(), "a client that only looks is not waited for");
        assert_eq!(let_go_on(&simulation, 1, 10), None);
        assert!(simulation.is_waited_for());
        simulation.tick();
        assert_eq!(outbox.try_recv().unwrap().data(), 10_u32.to_le_bytes());
        assert!(!simulation.is_waited_for(), "the second one has had its tick");
        lock(&simulation.boards[1]).disconnect(&sink);
        assert!(simulation.is_waited_for(), "who is gone is not waited for");
        simulation.tick();
        assert_eq!(outbox.try_recv().unwrap().data(), 20_u32.to_le_bytes());
        assert!(!simulation.is_waited_for() && outbox.try_recv().is_err());
    }

    #[test]
    fn by_the_clock_the_port_is_silent() {
        assert_eq!(let_go_on(&simulation(VerticalInput::Thrust, 1), 0, 0), None);
    }

    #[test]
    fn in_lockstep_set_points_and_logs_are_late_in_simulated_time() {
        let first_ms = |latency_ms: u64| {
            let mut simulation = in_lockstep(1, Duration::from_millis(latency_ms));
            let (sink, mut outbox) = mpsc::channel(64);
            assert!(lock(&simulation.boards[0]).claim(&sink));
            let id = crate::LOGS.iter().position(|log| log.name == "controller.cmd_thrust").unwrap() as u8;
            send(&simulation, 0, 5, 1, &[6, 1, 7, id, 0]);
            send(&simulation, 0, 5, 1, &[3, 1, 1]);
            (0..5).for_each(|_| simulation.tick());
            send(&simulation, 0, 7, 0, &floats(&[9], &[0.0, 0.0, 0.0, 0.5]));
            let mut thrust_pwm = |simulation: &mut Simulation| {
                simulation.tick();
                let log = std::iter::from_fn(|| outbox.try_recv().ok()).last();
                log.map_or(0.0, |packet| f32::from_le_bytes(*packet.data()[4..].first_chunk().unwrap()))
            };
            (0..40).position(|_| thrust_pwm(&mut simulation) > 0.0).unwrap() * 10
        };
        assert_eq!(first_ms(30) - first_ms(0), 60, "there and back");
    }

    #[test]
    fn a_battery_is_shown_where_something_says_it() {
        let vbat_v = |effects: &str| {
            let effects = crazyflie_env::config::Options::parse(effects).unwrap().effects;
            let settings = Settings { effects, ..settings(VerticalInput::Thrust, 1) };
            let mut simulation = Simulation::new(&settings, None).unwrap();
            let (orders, settings) = lock(&simulation.boards[0]).take_orders();
            let Simulation { pilots, flight, .. } = &mut simulation;
            pilots[0].tick(orders, &settings, &flight.drones()[0]).1.vbat_v
        };
        assert_eq!(vbat_v("{}"), 4.2);
        let low_v = vbat_v("{\"effects\": {\"battery_sag\": {\"charge\": 0.3}}}");
        assert!((3.0..4.0).contains(&low_v), "{low_v}");
    }
}
