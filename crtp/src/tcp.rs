//! A drone behind a TCP port: CPX frames, each with its length, a route and a function, that carry packets.

use std::io;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::OwnedReadHalf;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::line::{Line, wait_until};
use crate::packet::Packet;

/// From the flight computer to the host.
const ROUTE: u8 = 1 << 3 | 3;
/// The function that carries packets; others are ignored.
const CRTP: u8 = 3;
/// Longest frame that is read: more than CPX sends, and a bound for what a stranger may.
const MAX_FRAME: usize = 1024;
const OUTBOX: usize = 256;

/// Serves one client after the other.
pub(crate) async fn run(listener: TcpListener, mut line: Line, stop: CancellationToken) {
    loop {
        let accepted = tokio::select! {
            () = stop.cancelled() => return,
            accepted = listener.accept() => accepted,
        };
        let Ok((stream, client)) = accepted else {
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
            continue;
        };
        let (sink, outbox) = mpsc::channel(OUTBOX);
        if !line.board().claim(&sink) {
            // closed at once: the drone is another client's
            continue;
        }
        tracing::info!(%client, "a client has come");
        tokio::select! {
            () = stop.cancelled() => return,
            ended = serve(stream, &mut line, outbox, &listener) => tracing::info!(%client, ?ended, "the client is gone"),
        }
        line.board().disconnect(&sink);
        line.clear();
    }
}

async fn serve(
    stream: TcpStream,
    line: &mut Line,
    mut outbox: mpsc::Receiver<Packet>,
    listener: &TcpListener,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.into_split();
    let (forward, mut packets) = mpsc::channel(OUTBOX);
    let reading = tokio::spawn(read(reader, forward));
    let ended = loop {
        tokio::select! {
            packet = packets.recv() => match packet {
                Some(packet) => line.arrive(packet),
                None => break Ok(()),
            },
            Some(packet) = outbox.recv() => line.leave(packet),
            () = wait_until(line.due()) => {}
            // a second client is refused
            Ok(other) = listener.accept() => drop(other),
        }
        let mut frames = Vec::new();
        while let Some(packet) = line.next() {
            let (bytes, len) = packet.bytes();
            frames.extend((len as u16 + 2).to_le_bytes());
            frames.extend([ROUTE, CRTP]);
            frames.extend(&bytes[..len]);
        }
        if let Err(error) = writer.write_all(&frames).await {
            break Err(error);
        }
    };
    reading.abort();
    ended
}

/// Frames into packets, until the client closes or sends what is no frame.
async fn read(mut reader: OwnedReadHalf, forward: mpsc::Sender<Packet>) -> io::Result<()> {
    let mut frame = [0; MAX_FRAME];
    loop {
        let len = usize::from(reader.read_u16_le().await?);
        let Some(frame) = frame.get_mut(..len).filter(|frame| frame.len() >= 2) else {
            return Err(io::ErrorKind::InvalidData.into());
        };
        reader.read_exact(frame).await?;
        let packet = Packet::parse(&frame[2..]).filter(|_| frame[1] & 0x3f == CRTP);
        if let Some(packet) = packet
            && forward.send(packet).await.is_err()
        {
            return Ok(());
        }
    }
}
