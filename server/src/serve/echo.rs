//! `crazyflie.echo.v1`: every message is returned as it is. For conformance runners, and to separate the network's
//! time from the simulator's.

use tokio_tungstenite::tungstenite::Message;

use super::server::Server;
use super::socket::{Incoming, Socket};

pub(crate) const PROTOCOL: &str = "crazyflie.echo.v1";

pub(crate) async fn serve_socket(server: &Server, mut socket: Socket) {
    let disconnect = loop {
        let message = match socket.next().await {
            Ok(Incoming::Text(text)) => Message::Text(text),
            Ok(Incoming::Binary(bytes)) => Message::Binary(bytes),
            Err(disconnect) => break disconnect,
        };
        if let Err(disconnect) = socket.send(message).await {
            break disconnect;
        }
    };
    socket.goodbye(&disconnect, &server.stop, &server.metrics).await;
}
