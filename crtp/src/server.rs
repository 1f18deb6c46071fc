//! Ports for all drones, and the simulation behind them.

use std::io;
use std::net::{IpAddr, SocketAddr};

use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::noise::episode_key;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, UdpSocket};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::line::{Line, LinkQuality};
use crate::pilot::PositionSource;
use crate::simulation::{Simulation, Watcher};
use crate::tcp;
use crate::udp::UdpLink;

/// Driver of the simulation's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// The machine's clock.
    Clock {
        /// Simulated seconds per second.
        speed: f64,
    },
    /// Its clients: time advances to the earliest moment that every client allows.
    Lockstep,
}

impl Pace {
    /// Returns the factor by which set-points age more slowly than simulated time: a script sends them by the
    /// machine's clock.
    pub(crate) fn patience(self) -> f64 {
        match self {
            Pace::Clock { speed } => speed.max(1.0),
            Pace::Lockstep => 1.0,
        }
    }
}

/// The simulated fleet, and the address on which it listens.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Any identified vehicle.
    pub model: Model,
    /// Height input: one that is a PWM, as the set-points of scripts are.
    pub vertical: VerticalInput,
    /// Effects that are on.
    pub effects: EffectTable,
    /// Number of drones.
    pub drones: usize,
    /// Driver of the clock.
    pub pace: Pace,
    /// Quality of every link.
    pub quality: LinkQuality,
    /// Decides noise, losses and drawn parameters.
    pub seed: u64,
    /// Source of positions.
    pub positions: PositionSource,
    /// True if drones arm themselves.
    pub auto_arms: bool,
    /// Parameters of the decks that are on, see [`crate::deck`].
    pub decks: Vec<&'static str>,
    /// Puts all drones back on their places when a client connects while no other is connected.
    pub resets: bool,
    /// Host on which to listen.
    pub host: IpAddr,
    /// UDP port of the first drone; the others follow. 0 for any.
    pub port: u16,
    /// TCP port of the first drone, if wanted.
    pub tcp_port: Option<u16>,
}

/// Address of a drone.
#[derive(Debug, Clone, Copy)]
pub struct Address {
    /// For `udp://`.
    pub udp: SocketAddr,
    /// For `tcp://`.
    pub tcp: Option<SocketAddr>,
}

/// Why drones cannot be flown.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The model, its form or the effects.
    #[error(transparent)]
    Simulator(#[from] crazyflie_env::Error),
    /// A port cannot be had.
    #[error("{address}: {error}")]
    Port {
        /// Which one.
        address: SocketAddr,
        /// The system's error.
        error: io::Error,
    },
}

/// Drones that listen and do not fly yet.
pub struct Server {
    simulation: Simulation,
    links: Vec<(UdpLink, Option<(TcpListener, Line)>)>,
    addresses: Vec<Address>,
}

impl Server {
    /// Takes the ports.
    ///
    /// # Errors
    /// For what cannot be flown, and ports that cannot be had.
    pub async fn bind(settings: &Settings, watcher: Option<Watcher>) -> Result<Server, Error> {
        let simulation = Simulation::new(settings, watcher)?;
        // in lock-step the latency is simulated, by the boards
        let latency = if settings.pace == Pace::Lockstep { Duration::ZERO } else { settings.quality.latency };
        let quality = LinkQuality { latency, ..settings.quality };
        let (mut links, mut addresses) = (Vec::new(), Vec::new());
        for (drone, board) in simulation.boards().iter().enumerate() {
            let line = |way: u64| {
                let seed = episode_key(settings.seed, (drone as u64) << 1 | way);
                Line::new(Arc::clone(board), quality, seed)
            };
            let address = SocketAddr::new(settings.host, port(settings.port, drone));
            let failed = |error| Error::Port { address, error };
            let socket = bind_udp(address).await.map_err(failed)?;
            let mut listens = Address { udp: socket.local_addr().map_err(failed)?, tcp: None };
            let mut listener = None;
            if let Some(first) = settings.tcp_port {
                let address = SocketAddr::new(settings.host, port(first, drone));
                let failed = |error| Error::Port { address, error };
                let bound = TcpListener::bind(address).await.map_err(failed)?;
                listens.tcp = Some(bound.local_addr().map_err(failed)?);
                listener = Some((bound, line(1)));
            }
            links.push((UdpLink::new(socket, line(0)), listener));
            addresses.push(listens);
        }
        Ok(Server { simulation, links, addresses })
    }

    /// Returns the addresses of the drones, in order.
    pub fn addresses(&self) -> &[Address] {
        &self.addresses
    }

    /// Flies until it is stopped.
    pub async fn run(self, stop: CancellationToken) {
        let tasks = TaskTracker::new();
        for (udp, tcp) in self.links {
            tasks.spawn(udp.run(stop.clone()));
            if let Some((listener, line)) = tcp {
                tasks.spawn(tcp::run(listener, line, stop.clone()));
            }
        }
        tasks.close();
        let (simulation, ended) = (self.simulation, stop.clone());
        let thread = tokio::task::spawn_blocking(move || simulation.run(&ended));
        tasks.wait().await;
        if thread.await.is_err() {
            tracing::error!("the simulation broke");
        }
    }
}

/// Binds a socket. One that loses its client keeps a port that was named, not one that the system chose: so the
/// system chooses first, and its choice is named.
async fn bind_udp(mut address: SocketAddr) -> io::Result<UdpSocket> {
    if address.port() == 0 {
        address = UdpSocket::bind(address).await?.local_addr()?;
    }
    UdpSocket::bind(address).await
}

/// Returns the port of the drone at that place; 0 stays any.
fn port(first: u16, drone: usize) -> u16 {
    if first == 0 { 0 } else { first.saturating_add(drone as u16) }
}
