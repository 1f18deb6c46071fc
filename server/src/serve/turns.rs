//! Turns at the processor. Connections of one address take turns in the order of their arrival; long work takes turns
//! with other long work besides, and gives up its turn after each slice, so that a core is left for short requests.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{CountGuard, lock};

/// Tiles of sixteen drones times steps from which a request is long: some 100 us without effects.
const LONG: usize = 512;

/// Time after which long work lets others go on.
const SLICE: Duration = Duration::from_micros(500);

pub(crate) struct Turns {
    cores: usize,
    /// One core fewer than there are, where there are several.
    long: Arc<Semaphore>,
    /// One of all who download at a time, so that others do not queue behind them.
    download: Arc<Semaphore>,
    addresses: Mutex<HashMap<IpAddr, Weak<Semaphore>>>,
    /// Connections that wait for their turn.
    pub waiting: AtomicUsize,
}

/// The place of a connection in the queues.
pub(crate) struct Queue {
    turns: Arc<Turns>,
    address: Arc<Semaphore>,
}

/// A turn that is being taken; it ends when dropped.
pub(crate) struct Turn<'a> {
    queue: &'a Queue,
    long: bool,
    permits: Option<(Option<OwnedSemaphorePermit>, OwnedSemaphorePermit)>,
    since: Instant,
}

impl Turns {
    pub(crate) fn new() -> Arc<Self> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let long = Arc::new(Semaphore::new(cores.saturating_sub(1).max(1)));
        Arc::new(Turns {
            cores,
            long,
            download: Arc::new(Semaphore::new(1)),
            addresses: Mutex::default(),
            waiting: AtomicUsize::new(0),
        })
    }

    /// A place for a connection of this address.
    pub(crate) fn queue(self: &Arc<Self>, address: IpAddr) -> Queue {
        let mut addresses = lock(&self.addresses);
        let known = addresses.get(&address).and_then(Weak::upgrade);
        let semaphore = known.unwrap_or_else(|| {
            // addresses without clients are forgotten
            addresses.retain(|_, semaphore| semaphore.strong_count() > 0);
            let new = Arc::new(Semaphore::new(self.cores));
            addresses.insert(address, Arc::downgrade(&new));
            new
        });
        Queue { turns: self.clone(), address: semaphore }
    }
}

/// Returns whether work on so many drones for so many steps is long.
pub(crate) fn is_long(rows: usize, steps: usize) -> bool {
    rows.div_ceil(16).saturating_mul(steps) >= LONG
}

impl Queue {
    /// Waits for a turn.
    pub(crate) async fn turn(&self, long: bool) -> Turn<'_> {
        let permits = Some(self.permits(long).await);
        Turn { queue: self, long, permits, since: Instant::now() }
    }

    /// Waits for a turn to make a part of a download: the others who download wait for it.
    pub(crate) async fn download_turn(&self) -> (Turn<'_>, OwnedSemaphorePermit) {
        let download = permit(&self.turns.download).await;
        (self.turn(true).await, download)
    }

    /// The queue of long work is first: a request that waits in it delays nobody of the same address.
    async fn permits(&self, long: bool) -> (Option<OwnedSemaphorePermit>, OwnedSemaphorePermit) {
        // also if the wait is given up
        let waiting = CountGuard::new(&self.turns.waiting);
        let long_permit = if long { Some(permit(&self.turns.long).await) } else { None };
        let address_permit = permit(&self.address).await;
        drop(waiting);
        (long_permit, address_permit)
    }
}

async fn permit(semaphore: &Arc<Semaphore>) -> OwnedSemaphorePermit {
    match semaphore.clone().acquire_owned().await {
        Ok(permit) => permit,
        // nobody closes these semaphores
        Err(_) => std::future::pending().await,
    }
}

impl Turn<'_> {
    /// Between two parts of the work: lets others go on if the slice is used up.
    pub(crate) async fn pause_if_due(&mut self) {
        if self.since.elapsed() < SLICE {
            return;
        }
        self.permits = None;
        tokio::task::yield_now().await;
        self.permits = Some(self.queue.permits(self.long).await);
        self.since = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_times_steps_are_counted() {
        assert!(!is_long(1, 511) && is_long(1, 512), "one drone flies a tile of its own");
        assert!(!is_long(1024, 7) && is_long(1024, 8) && is_long(16384, 1));
    }

    #[tokio::test]
    async fn long_work_leaves_the_address_to_others() {
        let turns = Turns::new();
        let (a, b, c) = (
            turns.queue([10, 0, 0, 1].into()),
            turns.queue([10, 0, 0, 1].into()),
            turns.queue([10, 0, 0, 1].into()),
        );
        let mut held = Vec::new();
        for _ in 0..turns.long.available_permits() {
            held.push(a.turn(true).await);
        }
        // a second long one waits, a short one does not if there is a core
        assert!(tokio::time::timeout(Duration::from_millis(20), b.turn(true)).await.is_err());
        if turns.cores > 1 {
            drop(c.turn(false).await);
        }
        drop(held);
        drop(b.turn(true).await);
        assert_eq!(turns.waiting.load(std::sync::atomic::Ordering::Relaxed), 0);
    }

    #[test]
    fn addresses_that_are_gone_are_forgotten() {
        let turns = Turns::new();
        for i in 0..100 {
            drop(turns.queue([10, 0, 0, i].into()));
        }
        assert!(lock(&turns.addresses).len() <= 1);
    }
}
