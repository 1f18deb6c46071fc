//! Poses of simulated Crazyflies, sent as the bridge of a motion capture sends them.

use std::fs::File;
use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::path::PathBuf;

use crazyflie_crtp::{Moment, Watcher};
use serde_json::json;

use crate::failure::{Failure, Outcome};

/// Receiver of the poses.
#[derive(Debug, Clone)]
pub(super) enum Listener {
    /// Datagrams, as a motion capture sends them.
    Udp(SocketAddr),
    /// Lines of a file, none of which is lost.
    File(PathBuf),
}

pub(super) fn listener(text: &str) -> Result<Listener, String> {
    match text.parse() {
        Ok(address) => Ok(Listener::Udp(address)),
        Err(_) if text.contains(':') => Err("expected ADDRESS:PORT, or a file".into()),
        Err(_) => Ok(Listener::File(text.into())),
    }
}

/// Sends every tick's poses to a listener.
pub(super) fn watcher(listener: &Listener) -> Outcome<Watcher> {
    let path = match listener {
        Listener::Udp(address) => return datagrams(*address),
        Listener::File(path) => path,
    };
    let mut file = File::create(path).map_err(|e| Failure::about(path.display(), e))?;
    // a full disk, or a reader that is gone, ends no flight
    Ok(each(move |message| drop(writeln!(file, "{message}"))))
}

/// A watcher that passes on every drone's message.
fn each(mut send: impl FnMut(&str) + Send + 'static) -> Watcher {
    Box::new(move |moments: &[Moment]| {
        moments.iter().enumerate().for_each(|(drone, moment)| send(&message(drone, moment)));
    })
}

/// One that is not there misses them.
fn datagrams(listener: SocketAddr) -> Outcome<Watcher> {
    let own: IpAddr =
        if listener.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
    let failed = |error| Failure::about(format!("--poses {listener}"), error);
    let socket = UdpSocket::bind((own, 0)).map_err(failed)?;
    // the simulation never waits for who listens
    socket.set_nonblocking(true).map_err(failed)?;
    // motion capture does not send a lost pose again either
    Ok(each(move |message| drop(socket.send_to(message.as_bytes(), listener))))
}

fn message(drone: usize, moment: &Moment) -> String {
    json!({
        "body": drone.to_string(),
        "t_s": moment.time_s,
        "pos_m": moment.state.pos_m,
        "quat_xyzw": moment.quaternion_xyzw(),
        "age_s": 0.0,
    })
    .to_string()
}
