//! Log blocks: the variables that a client subscribed to, and their period.

use crate::logs::LOGS;
use crate::packet::{Fields, MAX_DATA, Packet};
use crate::telemetry::Telemetry;
use crate::values::Kind;

/// The firmware's own limits.
const MAX_BLOCKS: usize = 16;
const MAX_VARIABLES: usize = 128;
/// After block and time stamp.
const MAX_BYTES: usize = MAX_DATA - 4;

const PORT: u8 = 5;
const DATA_CHANNEL: u8 = 2;

/// Errors as the firmware numbers them.
mod errno {
    pub(super) const OK: u8 = 0;
    pub(super) const ENOENT: u8 = 2;
    pub(super) const E2BIG: u8 = 7;
    pub(super) const ENOEXEC: u8 = 8;
    pub(super) const ENOMEM: u8 = 12;
    pub(super) const EEXIST: u8 = 17;
}

struct Block {
    id: u8,
    /// Places in the table, and the kinds in which they are sent.
    variables: Vec<(usize, Kind)>,
    /// While it runs.
    period_ms: Option<u32>,
    /// When it is sent next.
    due_ms: u32,
}

/// The blocks of a drone.
#[derive(Default)]
pub(crate) struct LogBlocks(Vec<Block>);

impl LogBlocks {
    /// Carries out a request on the control channel; the answer.
    pub(crate) fn control(&mut self, request: &[u8], now_ms: u32) -> Option<Vec<u8>> {
        let mut fields = Fields(request);
        let command = fields.u8()?;
        let id = fields.u8().unwrap_or(0);
        let status = match command {
            2 => self.delete(id),
            3 => self.start(id, fields.u8().unwrap_or(0), now_ms),
            4 => self.with(id, |block| block.period_ms = None),
            5 => {
                self.0.clear();
                errno::OK
            }
            6 => self.create(id, fields),
            7 => self.append(id, fields),
            _ => errno::ENOEXEC,
        };
        Some(vec![command, id, status])
    }

    fn with(&mut self, id: u8, change: impl FnOnce(&mut Block)) -> u8 {
        self.0.iter_mut().find(|block| block.id == id).map_or(errno::ENOENT, |block| {
            change(block);
            errno::OK
        })
    }

    fn delete(&mut self, id: u8) -> u8 {
        let before = self.0.len();
        self.0.retain(|block| block.id != id);
        if self.0.len() == before { errno::ENOENT } else { errno::OK }
    }

    /// A period of nothing sends the block once.
    fn start(&mut self, id: u8, period_10ms: u8, now_ms: u32) -> u8 {
        self.with(id, |block| {
            block.period_ms = Some(10 * u32::from(period_10ms));
            block.due_ms = now_ms.wrapping_add(10 * u32::from(period_10ms));
        })
    }

    fn create(&mut self, id: u8, variables: Fields<'_>) -> u8 {
        if self.0.iter().any(|block| block.id == id) {
            return errno::EEXIST;
        }
        if self.0.len() == MAX_BLOCKS {
            return errno::ENOMEM;
        }
        self.0.push(Block { id, variables: Vec::new(), period_ms: None, due_ms: 0 });
        let status = self.append(id, variables);
        if status != errno::OK {
            self.delete(id);
        }
        status
    }

    fn append(&mut self, id: u8, mut fields: Fields<'_>) -> u8 {
        let mut count: usize = self.0.iter().map(|block| block.variables.len()).sum();
        let Some(block) = self.0.iter_mut().find(|block| block.id == id) else { return errno::ENOENT };
        let mut bytes: usize = block.variables.iter().map(|(_, kind)| kind.size()).sum();
        let before = block.variables.len();
        while let Some(code) = fields.u8() {
            // the low half is the kind that is sent; bytes that are no whole entry are none
            let Some(place) = fields.u16().map(usize::from) else { break };
            let known = Kind::from_log_code(code & 0x0f).filter(|_| place < LOGS.len());
            let status = match known {
                None => errno::ENOENT,
                Some(kind) if bytes + kind.size() > MAX_BYTES => errno::E2BIG,
                Some(_) if count == MAX_VARIABLES => errno::ENOMEM,
                Some(kind) => {
                    (bytes, count) = (bytes + kind.size(), count + 1);
                    block.variables.push((place, kind));
                    continue;
                }
            };
            block.variables.truncate(before);
            return status;
        }
        errno::OK
    }

    /// Hands the packets that are due to `send`.
    pub(crate) fn send_due(&mut self, telemetry: &Telemetry, mut send: impl FnMut(Packet)) {
        for block in &mut self.0 {
            let Some(period_ms) = block.period_ms else { continue };
            let late_ms = telemetry.time_ms.wrapping_sub(block.due_ms);
            // due times lie ahead of the clock by at most a period of 2.55 s
            if late_ms > u32::MAX / 2 {
                continue;
            }
            let [t0, t1, t2, _] = telemetry.time_ms.to_le_bytes();
            let mut data = vec![block.id, t0, t1, t2];
            for (place, kind) in &block.variables {
                kind.write((LOGS[*place].read)(telemetry), &mut data);
            }
            send(Packet::new(PORT, DATA_CHANNEL, &data));
            if period_ms == 0 {
                block.period_ms = None;
            }
            block.due_ms = block.due_ms.wrapping_add(period_ms.max(1));
            // after a pause there is no burst
            if late_ms > period_ms {
                block.due_ms = telemetry.time_ms.wrapping_add(period_ms);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn create(blocks: &mut LogBlocks, id: u8, variables: &[(u8, u16)]) -> u8 {
        let mut request = vec![6, id];
        for (code, place) in variables {
            request.push(*code);
            request.extend(place.to_le_bytes());
        }
        blocks.control(&request, 0).unwrap()[2]
    }

    #[test]
    fn errors_are_the_firmwares() {
        let mut blocks = LogBlocks::default();
        assert_eq!(create(&mut blocks, 1, &[(7, 0)]), 0);
        assert_eq!(create(&mut blocks, 1, &[(7, 0)]), 17);
        assert_eq!(create(&mut blocks, 2, &[(7, 60_000)]), 2);
        assert_eq!(create(&mut blocks, 2, &[(7, 0); 7]), 7);
        assert_eq!(blocks.control(&[3, 9, 1], 0).unwrap(), [3, 9, 2]);
        assert_eq!(blocks.control(&[99, 1], 0).unwrap(), [99, 1, 8]);
        for id in 2..17 {
            assert_eq!(create(&mut blocks, id, &[(1, 0)]), 0);
        }
        assert_eq!(create(&mut blocks, 17, &[(1, 0)]), 12);
        assert_eq!(blocks.control(&[5], 0).unwrap()[2], 0);
        assert!(blocks.0.is_empty());
    }

    #[test]
    fn a_block_comes_as_often_as_asked_and_with_its_time() {
        let mut blocks = LogBlocks::default();
        assert_eq!(create(&mut blocks, 1, &[(0x77, 2), (5, 2)]), 0);
        blocks.control(&[3, 1, 2], 0);
        let mut sent = Vec::new();
        for tick in 0..100 {
            let telemetry = Telemetry { time_ms: 10 * tick, pos_m: [0.0, 0.0, 7.0], ..Telemetry::default() };
            blocks.send_due(&telemetry, |packet| sent.push(packet));
        }
        assert_eq!(sent.len(), 49);
        assert_eq!(sent[0].data()[..4], [1, 20, 0, 0]);
        assert_eq!(sent[0].data()[4..8], 7.0_f32.to_le_bytes());
        assert_eq!(sent[0].data()[8..], 7_i16.to_le_bytes());
        blocks.control(&[4, 1], 1000);
        blocks.send_due(&Telemetry { time_ms: 2000, ..Telemetry::default() }, |_| panic!("stopped"));
    }
}
