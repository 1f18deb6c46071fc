//! Flight logs of every format.

use crazyflie_identify::FlightLog;

#[path = "../../../identify/tests/common/sound.rs"]
mod sound;

const BAG: &[u8] = b"#ROSBAG V2.0\n";
const MCAP: &[u8] = b"\x89MCAP0\r\n";
const CARD: &[u8] = b"\xbc";
const GZIP: &[u8] = b"\x1f\x8b";

fn read(bytes: &[u8]) -> bool {
    let log = FlightLog::from_bytes("log", bytes).map_err(|error| assert!(error.to_string().contains("log"), "{error}"));
    log.map(|log| sound::check(&log)).is_ok()
}

/// CSV; binary formats have targets of their own.
pub(super) fn text(bytes: &[u8]) -> bool {
    ![BAG, MCAP, CARD, GZIP].iter().any(|magic| bytes.starts_with(magic)) && read(bytes)
}

pub(super) fn ros_bag(bytes: &[u8]) -> bool {
    begun(BAG, bytes)
}

pub(super) fn mcap(bytes: &[u8]) -> bool {
    begun(MCAP, bytes)
}

pub(super) fn micro_sd(bytes: &[u8]) -> bool {
    begun(CARD, bytes)
}

/// With its magic bytes, whatever stands in their place.
fn begun(magic: &[u8], bytes: &[u8]) -> bool {
    read(&[magic, bytes.get(magic.len()..).unwrap_or_default()].concat())
}
