//! A drone behind a UDP port: one datagram, one packet.
//!
//! While a client flies, the socket is connected to it. The system then refuses any other client at once ("connection
//! refused"), which cflib reports as a failed connection; the protocol has no answer for "busy". The drone is free
//! again when its client has closed its socket or was silent for some seconds.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::line::{Line, wait_until};
use crate::packet::{MAX_DATA, Packet};

/// cflib sends ten packets a second.
const SILENCE: Duration = Duration::from_secs(3);
/// A client that is silent for so long is sent an empty packet: if its socket is closed, its system reports it.
const PROBE: Duration = Duration::from_millis(50);
/// Interval like [`PROBE`], after the empty set-point with which cflib disconnects: the next script may connect at
/// once.
const PROBE_AFTER_FAREWELL: Duration = Duration::from_millis(5);
/// Packets that wait to be sent: of more than that the newest are lost.
const OUTBOX: usize = 256;

pub(crate) struct UdpLink {
    socket: UdpSocket,
    line: Line,
    /// A client that is silent for so long may be replaced; in lock-step one may think as long as it likes.
    silence: Option<Duration>,
    client: Option<Client>,
    sink: mpsc::Sender<Packet>,
    outbox: mpsc::Receiver<Packet>,
}

struct Client {
    address: SocketAddr,
    heard: Instant,
    probed: Instant,
    /// Its last packet but the link's own was a farewell.
    leaves: bool,
    /// The socket is its alone.
    connected: bool,
}

/// Ports of the set-points with which clients take their leave, and of the echo that goes on meanwhile.
const COMMANDER_PORT: u8 = 3;
const LINK_PORT: u8 = 15;

impl Client {
    fn next_probe(&self) -> Instant {
        if self.leaves { self.probed + PROBE_AFTER_FAREWELL } else { self.heard.max(self.probed) + PROBE }
    }
}

impl UdpLink {
    pub(crate) fn new(socket: UdpSocket, line: Line) -> Self {
        let (sink, outbox) = mpsc::channel(OUTBOX);
        let silence = (!line.board().is_in_lockstep()).then_some(SILENCE);
        UdpLink { socket, line, silence, client: None, sink, outbox }
    }

    pub(crate) async fn run(mut self, stop: CancellationToken) {
        // room for one byte more than a packet has: what is longer is none
        let mut bytes = [0; MAX_DATA + 2];
        loop {
            let client = self.client.as_ref().filter(|client| client.connected);
            let quiet = client.map(Client::next_probe);
            let silent = client.zip(self.silence).map(|(client, silence)| client.heard + silence);
            tokio::select! {
                () = stop.cancelled() => return,
                received = self.socket.recv_from(&mut bytes) => match received {
                    Ok((len, from)) => self.receive(&bytes[..len], from).await,
                    Err(error) => self.fail(&error).await,
                },
                Some(packet) = self.outbox.recv() => self.line.leave(packet),
                () = wait_until(self.line.due()) => {}
                () = wait_until(silent) => self.release(),
                () = wait_until(quiet) => self.probe().await,
            }
            while let Some(packet) = self.line.next() {
                self.send(&packet).await;
            }
        }
    }

    async fn receive(&mut self, bytes: &[u8], from: SocketAddr) {
        let Some(packet) = Packet::parse(bytes) else { return };
        if packet.is_null() && packet.data().is_empty() {
            // somebody looks for vehicles, which takes none
            let (bytes, len) = packet.bytes();
            let _ = self.socket.send_to(&bytes[..len], from).await;
            return;
        }
        if self.admits(from).await {
            if let Some(client) = self.client.as_mut().filter(|_| packet.port != LINK_PORT) {
                client.leaves = packet.port == COMMANDER_PORT && packet.data().iter().all(|byte| *byte == 0);
            }
            self.line.arrive(packet);
        }
    }

    /// Returns whether the drone belongs to that client; a free drone is assigned to it.
    async fn admits(&mut self, from: SocketAddr) -> bool {
        let now = Instant::now();
        if let Some(client) = self.client.as_mut().filter(|client| client.connected) {
            // a packet of another client, from before the socket was connected
            if client.address != from {
                return false;
            }
            client.heard = now;
            return true;
        }
        if !self.line.board().claim(&self.sink) {
            return false;
        }
        if self.client.as_ref().is_none_or(|client| client.address != from) {
            self.line.clear();
            while self.outbox.try_recv().is_ok() {}
        }
        // a system that cannot do this ignores other clients, by their address
        if let Err(error) = self.socket.connect(from).await {
            tracing::warn!(%error, "the socket cannot be given to one client");
        }
        tracing::info!(client = %from, "a client has come");
        self.client = Some(Client { address: from, heard: now, probed: now, leaves: false, connected: true });
        true
    }

    /// Frees the drone of a silent client for another one.
    fn release(&mut self) {
        if let Some(client) = self.client.as_mut().filter(|client| client.connected) {
            client.connected = false;
            tracing::info!(client = %client.address, "the client is silent");
            self.line.board().release(&self.sink);
            if let Err(error) = free(&self.socket) {
                tracing::warn!(%error, "the socket stays the last client's");
            }
        }
    }

    async fn probe(&mut self) {
        if let Some(client) = &mut self.client {
            client.probed = Instant::now();
            self.send(&Packet::new(15, 3, &[])).await;
        }
    }

    /// A client that has closed its socket is refused packets, which the system reports here.
    async fn fail(&mut self, error: &io::Error) {
        if matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset) {
            self.release();
            self.client = None;
            self.line.board().disconnect(&self.sink);
            self.line.clear();
            return;
        }
        tracing::warn!(%error, "receiving");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }

    async fn send(&mut self, packet: &Packet) {
        let Some(client) = &self.client else { return };
        let (bytes, len) = packet.bytes();
        let sent = if client.connected {
            self.socket.send(&bytes[..len]).await
        } else {
            self.socket.send_to(&bytes[..len], client.address).await
        };
        if let Err(error) = sent {
            self.fail(&error).await;
        }
    }
}

/// A connected socket listens to everybody again.
#[cfg(unix)]
fn free(socket: &UdpSocket) -> io::Result<()> {
    Ok(rustix::net::connect_unspec(socket)?)
}

#[cfg(not(unix))]
fn free(_: &UdpSocket) -> io::Result<()> {
    Ok(())
}
