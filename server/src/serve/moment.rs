//! Time as this process has lived through it. Nobody can act on a server that is paused (a stopped container, a
//! debugger, a machine that swaps), so a pause ends no session, no world and no pilot's turn.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use super::lock;

/// Time between two looks at the clock, and the time from which on there was a pause.
const LOOK: Duration = Duration::from_millis(250);
const PAUSE: Duration = Duration::from_secs(2);

/// The pauses so far.
#[derive(Debug)]
struct Pauses {
    looked: Option<Instant>,
    total: Duration,
}

static PAUSES: Mutex<Pauses> = Mutex::new(Pauses { looked: None, total: Duration::ZERO });

impl Pauses {
    fn until(&mut self, now: Instant) -> Duration {
        let gap = now.saturating_duration_since(self.looked.unwrap_or(now));
        if gap >= PAUSE {
            self.total += gap;
        }
        self.looked = self.looked.max(Some(now));
        self.total
    }
}

/// A point in time from which the pauses that follow do not count.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment {
    at: Instant,
    paused: Duration,
}

impl Moment {
    pub(crate) fn now() -> Self {
        let mut pauses = lock(&PAUSES);
        let at = Instant::now();
        Moment { at, paused: pauses.until(at) }
    }

    /// Time since then, without pauses.
    pub(crate) fn elapsed(self) -> Duration {
        let now = Moment::now();
        (now.at - self.at).saturating_sub(now.paused - self.paused)
    }
}

/// Waits for so long, without pauses.
pub(crate) async fn sleep(time: Duration) {
    let begun = Moment::now();
    loop {
        match time.saturating_sub(begun.elapsed()) {
            Duration::ZERO => return,
            left => tokio::time::sleep(left).await,
        }
    }
}

/// Looks at the clock until the server stops: a longer gap is a pause.
pub(crate) async fn watch(stop: CancellationToken) {
    while !stop.is_cancelled() {
        let _ = Moment::now();
        tokio::select! { () = tokio::time::sleep(LOOK) => {} () = stop.cancelled() => {} }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_between_two_looks_is_a_pause() {
        let (begun, mut pauses) = (Instant::now(), Pauses { looked: None, total: Duration::ZERO });
        let mut paused_until = |ms| pauses.until(begun + Duration::from_millis(ms)).as_millis();
        assert_eq!([0, 250, 700, 65_700, 65_900].map(&mut paused_until), [0, 0, 0, 65_000, 65_000]);
        // an older look is none
        assert_eq!([65_800, 70_000].map(paused_until), [65_000, 69_100]);
    }
}
