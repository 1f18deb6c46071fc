//! The page of the server, on which the simulated Crazyflies are seen.

use std::net::SocketAddr;

use crazyflie_crtp::{Moment, Settings, Watcher};
use crazyflie_env::action::Interface;
use crazyflie_env::config::Options;
use crazyflie_env::observation::{MARKER_POS, OBSERVATION, SETPOINT, index};
use crazyflie_env::vector::{STATE, state_index};
use crazyflie_server::serve::{self, DroneView, FleetView, Service};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::failure::{Failure, Outcome};

/// A server that has its port and does not serve yet.
pub(super) struct Page {
    listener: TcpListener,
    pub(super) address: SocketAddr,
    fleet: FleetView,
}

/// Ticks between two updates: nobody draws more often.
const TICKS: u64 = 2;

impl Page {
    /// Takes the port; returns the watcher of every tick, too.
    pub(super) async fn bind(address: SocketAddr, settings: &Settings) -> Outcome<(Watcher, Page)> {
        serve::Settings::default().check(address).map_err(|e| Failure::Usage(e.to_string()))?;
        let listener = TcpListener::bind(address).await.map_err(|e| Failure::about(address, e))?;
        let address = listener.local_addr()?;
        let (watcher, fleet) = fleet_view(settings)?;
        Ok((watcher, Page { listener, address, fleet }))
    }

    /// Serves until it is stopped.
    pub(super) async fn run(self, stop: CancellationToken) -> Outcome {
        let service = Service::open(self.listener, serve::Settings::default());
        let service = service.map_err(|e| Failure::Failed(e.to_string()))?;
        service.with_fleet(self.fleet).run(stop.cancelled()).await;
        Ok(())
    }
}

/// Returns the watcher of every tick, and the view that a server shows.
pub(super) fn fleet_view(settings: &Settings) -> Outcome<(Watcher, FleetView)> {
    let interface = Interface::from_model(&settings.model, settings.vertical)?;
    let nowhere = DroneView {
        time_s: 0.0,
        observation: [0.0; OBSERVATION],
        state: [0.0; STATE],
        action: [0.0; 4],
        flying: false,
    };
    let (sender, drones) = watch::channel(vec![nowhere; settings.drones]);
    let fleet = FleetView {
        name: "cf2".to_owned(),
        options: Options { effects: settings.effects.clone(), ..Options::default() },
        tick_s: TICKS as f64 / crazyflie_crtp::TICK_HZ,
        interface,
        drones,
    };
    let mut ticks = 0;
    let watcher = Box::new(move |moments: &[Moment]| {
        ticks += 1;
        if ticks % TICKS == 0 {
            sender.send_replace(moments.iter().map(|moment| shown(moment, &interface)).collect());
        }
    });
    Ok((watcher, fleet))
}

/// The row of a drone: where it is, where it believes it is, where it is to be.
fn shown(moment: &Moment, interface: &Interface) -> DroneView {
    let mut observation = [0.0; OBSERVATION];
    let place = |row: &mut [f32], numbers: &[f64]| {
        row.iter_mut().zip(numbers).for_each(|(slot, number)| *slot = *number as f32);
    };
    place(&mut observation[MARKER_POS.range()], &moment.estimate_m);
    observation[index::MARKER_YAW] = moment.estimate_yaw_rad as f32;
    observation[index::MARKER_VALID] = 1.0;
    let [x, y, z] = moment.target_m;
    place(&mut observation[SETPOINT.range()], &[x, y, z, moment.target_yaw_rad]);
    let mut state = [0.0; STATE];
    place(&mut state[state_index::POS..], &moment.state.pos_m);
    place(&mut state[state_index::VEL..], &moment.state.vel_mps);
    place(&mut state[state_index::ROLL..], &moment.state.att_rad);
    place(&mut state[state_index::YAW + 1..], &moment.state.rate_radps);
    DroneView {
        time_s: moment.time_s,
        observation,
        state,
        action: interface.action(&moment.command).map(|number| number as f32),
        flying: moment.command.lift > 0.0,
    }
}
