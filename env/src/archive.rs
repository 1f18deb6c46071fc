//! The state of a batch as bytes: written down, and taken back in the same order. Little-endian, the same for
//! every thread count and instruction set.

use crate::lanes::LANES;
use crate::sim_scalar::BatchScalar;

/// Sees every number that a flight goes on from, by name, and may replace it.
pub(crate) trait Ledger<R> {
    /// The numbers that follow are those of a drone whose names begin with `prefix`, where names matter.
    #[cfg(feature = "recording")]
    fn begin(&mut self, _prefix: String) {}
    fn numbers(&mut self, name: &str, numbers: &mut [R]);
}

impl<R: BatchScalar> Ledger<R> for Archive<'_> {
    fn numbers(&mut self, _: &str, numbers: &mut [R]) {
        self.numbers(numbers);
    }
}

/// Shows every number that flights go on from, to be written or to be overwritten.
pub(crate) enum Archive<'a> {
    Write(Vec<u8>),
    /// The bytes left to read. The caller has checked that they are as many as would be written.
    Read(&'a [u8]),
    /// Like `Read`, from a tile with one environment, whose numbers every environment of the tile gets; with these
    /// seeds, if given.
    Spread(&'a [u8], Option<[u64; LANES]>),
}

impl Archive<'_> {
    pub(crate) fn reads(&self) -> bool {
        !matches!(self, Archive::Write(_))
    }

    fn bytes<const N: usize>(&mut self, value: [u8; N]) -> [u8; N] {
        match self {
            Archive::Write(bytes) => {
                bytes.extend_from_slice(&value);
                value
            }
            Archive::Read(bytes) | Archive::Spread(bytes, _) => {
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

    /// Words of the lanes.
    pub(crate) fn words(&mut self, values: &mut [u64; LANES]) {
        values.iter_mut().for_each(|value| self.word(value));
        if let Archive::Spread(..) = self {
            *values = [values[0]; LANES];
        }
    }

    /// Seeds of the lanes' episodes.
    pub(crate) fn seeds(&mut self, values: &mut [u64; LANES]) {
        self.words(values);
        if let Archive::Spread(_, Some(seeds)) = self {
            *values = *seeds;
        }
    }

    /// Rows of as many lanes as there are.
    pub(crate) fn rows(&mut self, values: &mut [f32], width: usize) {
        if !matches!(self, Archive::Spread(..)) {
            return values.iter_mut().for_each(|value| self.float(value));
        }
        let (first, others) = values.split_at_mut(width.min(values.len()));
        first.iter_mut().for_each(|value| self.float(value));
        others.chunks_mut(width.max(1)).for_each(|row| row.copy_from_slice(first));
    }

    /// A bit per lane, of the environments that are `used`.
    pub(crate) fn bits(&mut self, value: &mut u16, used: u16) {
        *value = u16::from_le_bytes(self.bytes(value.to_le_bytes()));
        if let Archive::Spread(..) = self {
            *value = if *value & 1 == 1 { used } else { 0 };
        }
    }

    pub(crate) fn number<R: BatchScalar>(&mut self, value: &mut R) {
        let spreads = matches!(self, Archive::Spread(..));
        let mut first = 0.0;
        for lane in 0..LANES {
            let number = f32::from_le_bytes(self.bytes(value.array()[lane].to_le_bytes()));
            first = if lane == 0 { number } else { first };
            if self.reads() {
                value.set_lane(lane, f64::from(if spreads { first } else { number }));
            }
        }
    }

    pub(crate) fn numbers<R: BatchScalar>(&mut self, values: &mut [R]) {
        values.iter_mut().for_each(|value| self.number(value));
    }
}
