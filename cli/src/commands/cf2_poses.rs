//! Poses of simulated Crazyflies, sent as the bridge of a motion capture sends them.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use crazyflie_crtp::{Moment, Watcher};
use serde_json::json;

use super::{Failure, Outcome};

/// Tells a listener of every tick's poses. One that is not there misses them.
pub(super) fn watcher(listener: SocketAddr) -> Outcome<Watcher> {
    let own: IpAddr =
        if listener.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
    let failed = |error| Failure::about(format!("--poses {listener}"), error);
    let socket = UdpSocket::bind((own, 0)).map_err(failed)?;
    // the simulation never waits for who listens
    socket.set_nonblocking(true).map_err(failed)?;
    Ok(Box::new(move |moments: &[Moment]| {
        for (drone, moment) in moments.iter().enumerate() {
            // as motion capture does: what is not heard is gone
            let _ = socket.send_to(message(drone, moment).as_bytes(), listener);
        }
    }))
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
