//! A link's quality: late packets, and lost packets.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tokio::time::Instant;

use crate::board::Board;
use crate::packet::Packet;

/// Quality of the links.
#[derive(Debug, Clone, Copy)]
pub struct LinkQuality {
    /// Share of streamed packets that are lost each way.
    pub loss: f64,
    /// From one end to the other.
    pub latency: Duration,
}

/// Packets on their way between a client and a board.
pub(crate) struct Line {
    board: Arc<Mutex<Board>>,
    quality: LinkQuality,
    rng: Pcg64Mcg,
    arriving: VecDeque<(Instant, Packet)>,
    leaving: VecDeque<(Instant, Packet)>,
}

/// Packets on their way in one direction: of a flood the newest are lost.
const MAX_UNDERWAY: usize = 4096;

impl Line {
    pub(crate) fn new(board: Arc<Mutex<Board>>, quality: LinkQuality, seed: u64) -> Self {
        let rng = Pcg64Mcg::seed_from_u64(seed);
        Line { board, quality, rng, arriving: VecDeque::new(), leaving: VecDeque::new() }
    }

    pub(crate) fn board(&self) -> MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A client sent this.
    pub(crate) fn arrive(&mut self, packet: Packet) {
        if self.survives(&packet) && self.arriving.len() < MAX_UNDERWAY {
            self.arriving.push_back((Instant::now() + self.quality.latency, packet));
        }
    }

    /// The board sends this.
    pub(crate) fn leave(&mut self, packet: Packet) {
        if self.survives(&packet) && self.leaving.len() < MAX_UNDERWAY {
            self.leaving.push_back((Instant::now() + self.quality.latency, packet));
        }
    }

    /// Returns whether a packet gets through. Streamed packets may be lost: set-points, positions, logs. A radio
    /// repeats packets without an acknowledgement, and clients over UDP rely on that: requests and answers get
    /// through.
    fn survives(&mut self, packet: &Packet) -> bool {
        let streamed = matches!((packet.port, packet.channel), (3, _) | (5, 2) | (6, 0) | (7, 0));
        !(streamed && self.quality.loss > 0.0 && self.rng.random::<f64>() < self.quality.loss)
    }

    /// When the next packet is due.
    pub(crate) fn due(&self) -> Option<Instant> {
        let first = |queue: &VecDeque<(Instant, Packet)>| queue.front().map(|(due, _)| *due);
        [first(&self.arriving), first(&self.leaving)].into_iter().flatten().min()
    }

    /// Hands what has arrived to the board, and returns the next packet for the client.
    pub(crate) fn next(&mut self) -> Option<Packet> {
        let arrived = Instant::now();
        while let Some((_, packet)) = self.arriving.pop_front_if(|(due, _)| *due <= arrived) {
            let answer = self.board().receive(&packet);
            if let Some(answer) = answer {
                self.leave(answer);
            }
        }
        // an answer that was just put there is due by now
        let now = Instant::now();
        self.leaving.pop_front_if(|(due, _)| *due <= now).map(|(_, packet)| packet)
    }

    /// Forgets what is on its way.
    pub(crate) fn clear(&mut self) {
        self.arriving.clear();
        self.leaving.clear();
    }
}

/// Waits until then; for ever without a time.
pub(crate) async fn wait_until(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn packets_are_late_and_streams_lose_their_share() {
        let board = Arc::new(Mutex::new(Board::new(0, "cf21", Vec::new(), None, 0)));
        let quality = LinkQuality { loss: 0.25, latency: Duration::from_millis(20) };
        let mut line = Line::new(board, quality, 1);
        line.arrive(Packet::new(15, 0, b"echo"));
        assert!(line.next().is_none());
        tokio::time::sleep(Duration::from_millis(21)).await;
        assert!(line.next().is_none(), "the answer has its way, too");
        tokio::time::sleep(Duration::from_millis(21)).await;
        assert_eq!(line.next().unwrap().data(), b"echo");
        line.quality.latency = Duration::ZERO;
        line.arrive(Packet::new(15, 0, b"now"));
        assert_eq!(line.next().unwrap().data(), b"now", "without latency nothing waits for a timer");
        let lost = (0..4000).filter(|_| !line.survives(&Packet::new(5, 2, &[]))).count();
        assert!((900..1100).contains(&lost), "{lost}");
        assert!((0..1000).all(|_| line.survives(&Packet::new(8, 0, &[]))));
    }
}
