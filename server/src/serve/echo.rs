//! `crazyflie.echo.v1`: every message is returned as it is. For conformance runners, and to separate the network's
//! time from the simulator's.

use std::convert::Infallible;

use tokio_tungstenite::tungstenite::Message;

use super::socket::{Disconnect, Incoming, Socket};

pub(crate) const PROTOCOL: &str = "crazyflie.echo.v1";

/// # Errors
/// The way in which the connection ends.
pub(crate) async fn serve_socket(socket: &mut Socket) -> Result<Infallible, Disconnect> {
    loop {
        let message = match socket.next().await? {
            Incoming::Text(text) => Message::Text(text),
            Incoming::Binary(bytes) => Message::Binary(bytes),
        };
        socket.send(message).await?;
    }
}
