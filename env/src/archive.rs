//! The state of a batch as bytes: written down, and taken back in the same order. Little-endian, the same for
//! every thread count and instruction set.

use crate::lanes::LANES;
use crate::sim_scalar::BatchScalar;

/// Shows every number that flights go on from, to be written or to be overwritten.
pub(crate) enum Archive<'a> {
    Write(Vec<u8>),
    /// What is left to read; as long as what would be written, which the caller has seen to.
    Read(&'a [u8]),
}

impl Archive<'_> {
    pub(crate) fn reads(&self) -> bool {
        matches!(self, Archive::Read(_))
    }

    fn bytes<const N: usize>(&mut self, value: [u8; N]) -> [u8; N] {
        match self {
            Archive::Write(bytes) => {
                bytes.extend_from_slice(&value);
                value
            }
            Archive::Read(bytes) => {
                let Some((first, rest)) = bytes.split_first_chunk() else { return value };
                *bytes = rest;
                *first
            }
        }
    }

    pub(crate) fn word(&mut self, value: &mut u64) {
        *value = u64::from_le_bytes(self.bytes(value.to_le_bytes()));
    }

    pub(crate) fn count(&mut self, value: &mut usize) {
        let mut word = *value as u64;
        self.word(&mut word);
        *value = word as usize;
    }

    pub(crate) fn float(&mut self, value: &mut f32) {
        *value = f32::from_le_bytes(self.bytes(value.to_le_bytes()));
    }

    /// A bit per lane.
    pub(crate) fn bits(&mut self, value: &mut u16) {
        *value = u16::from_le_bytes(self.bytes(value.to_le_bytes()));
    }

    pub(crate) fn number<R: BatchScalar>(&mut self, value: &mut R) {
        for lane in 0..LANES {
            let number = f32::from_le_bytes(self.bytes(value.array()[lane].to_le_bytes()));
            if self.reads() {
                value.set_lane(lane, f64::from(number));
            }
        }
    }

    pub(crate) fn numbers<R: BatchScalar>(&mut self, values: &mut [R]) {
        values.iter_mut().for_each(|value| self.number(value));
    }
}
