//! Memories that clients read and write: the one of trajectories, and one which shows a client that no Lighthouse
//! base station is described.

use crate::packet::Fields;
use crate::polynomial::{Piece, bezier};

/// Bytes of the trajectory memory, as in the firmware.
const SIZE: usize = 4096;
/// Type and size of each memory: trajectories, geometry and calibration of base stations.
const MEMORIES: [(u8, usize); 2] = [(0x12, SIZE), (0x14, 0x2000)];
/// Most bytes in a packet after memory, address and status.
const MAX_READ: usize = 24;
/// Numbers of a piece that is not compressed: four axes of eight coefficients, and the duration.
const PIECE: usize = 33 * 4;

const EIO: u8 = 5;

/// A trajectory in the memory.
#[derive(Debug, Clone, Copy)]
struct Definition {
    offset: usize,
    pieces: u8,
    compressed: bool,
}

/// The memory, and the definitions of its trajectories.
pub(crate) struct TrajectoryMemory {
    bytes: Box<[u8; SIZE]>,
    definitions: [Option<Definition>; 256],
}

impl TrajectoryMemory {
    pub(crate) fn new() -> Self {
        TrajectoryMemory { bytes: Box::new([0; SIZE]), definitions: [None; 256] }
    }

    /// Answers requests about the list of memories.
    pub(crate) fn info(&self, request: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(request);
        match fields.u8()? {
            1 => Some(vec![1, MEMORIES.len() as u8]),
            2 => {
                let id = fields.u8()?;
                let mut answer = vec![2, id];
                if let Some((kind, size)) = MEMORIES.get(usize::from(id)) {
                    answer.push(*kind);
                    answer.extend((*size as u32).to_le_bytes());
                    answer.extend([0; 8]);
                }
                Some(answer)
            }
            _ => None,
        }
    }

    fn range(id: u8, address: u32, len: usize) -> Option<std::ops::Range<usize>> {
        let first = usize::try_from(address).ok()?;
        let last = first.checked_add(len)?;
        MEMORIES.get(usize::from(id)).filter(|(_, size)| last <= *size).map(|_| first..last)
    }

    /// Answers a request to read.
    pub(crate) fn read(&self, request: &[u8]) -> Option<Vec<u8>> {
        const NOTHING: [u8; MAX_READ] = [0; MAX_READ];
        let mut fields = Fields(request);
        let (id, address, len) = (fields.u8()?, fields.u32()?, usize::from(fields.u8()?).min(MAX_READ));
        let range = Self::range(id, address, len);
        let bytes = range.map(|range| if id == 0 { &self.bytes[range] } else { &NOTHING[..len] });
        let status = if bytes.is_some() { 0 } else { EIO };
        Some([&[id][..], &address.to_le_bytes(), &[status], bytes.unwrap_or_default()].concat())
    }

    /// Carries out a request to write. Base stations cannot be described: the filter gets its positions anyway.
    pub(crate) fn write(&mut self, request: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(request);
        let (id, address, data) = (fields.u8()?, fields.u32()?, fields.rest());
        let range = Self::range(id, address, data.len()).filter(|_| id == 0);
        let status = if range.is_some() { 0 } else { EIO };
        if let Some(range) = range {
            self.bytes[range].copy_from_slice(data);
        }
        Some([&[id][..], &address.to_le_bytes(), &[status]].concat())
    }

    /// Names a trajectory: id, location (1, the memory), type, offset, number of pieces. Returns whether it is valid.
    pub(crate) fn define(&mut self, mut fields: Fields<'_>) -> Option<bool> {
        let (id, location, kind) = (fields.u8()?, fields.u8()?, fields.u8()?);
        let (offset, pieces) = (fields.u32()?, fields.u8()?);
        let fine = location == 1 && kind <= 1 && (offset as usize) < SIZE;
        if fine {
            self.definitions[usize::from(id)] =
                Some(Definition { offset: offset as usize, pieces, compressed: kind == 1 });
        }
        Some(fine)
    }

    /// Returns the pieces of a trajectory from the present memory.
    pub(crate) fn pieces(&self, id: u8) -> Option<Vec<Piece>> {
        let Definition { offset, pieces, compressed } = self.definitions[usize::from(id)]?;
        let bytes = &self.bytes[offset..];
        if compressed {
            return compressed_pieces(Fields(bytes), pieces);
        }
        (0..usize::from(pieces)).map(|i| piece(Fields(bytes.get(i * PIECE..)?))).collect()
    }
}

fn piece(mut fields: Fields<'_>) -> Option<Piece> {
    let axes = [fields.f32s()?, fields.f32s()?, fields.f32s()?, fields.f32s()?];
    Some(Piece { duration_s: fields.f32()?, axes })
}

/// Millimetres and tenths of a degree: where it starts, then for each piece the degrees of the axes, two bits
/// each, its milliseconds, and the control points after the first.
fn compressed_pieces(mut fields: Fields<'_>, pieces: u8) -> Option<Vec<Piece>> {
    const UNIT: [f64; 4] = [1e-3, 1e-3, 1e-3, 0.1 * std::f64::consts::PI / 180.0];
    let start: [f64; 4] = fields.i16s()?;
    let mut now: [f64; 4] = std::array::from_fn(|i| start[i] * UNIT[i]);
    let mut all = Vec::new();
    for _ in 0..pieces {
        let degrees = fields.u8()?;
        let duration_s = f64::from(fields.u16()?) * 1e-3;
        let mut axes = [[0.0; 8]; 4];
        for (i, axis) in axes.iter_mut().enumerate() {
            let count = [0, 1, 3, 7][usize::from(degrees >> (2 * i) & 3)];
            let points: Vec<f64> = (0..count)
                .map(|_| fields.i16().map(|number| f64::from(number) * UNIT[i]))
                .collect::<Option<_>>()?;
            *axis = bezier(now[i], &points, duration_s);
            now[i] = *points.last().unwrap_or(&now[i]);
        }
        all.push(Piece { duration_s, axes });
    }
    Some(all)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn defined(kind: u8, pieces: u8, bytes: &[u8]) -> TrajectoryMemory {
        let mut memory = TrajectoryMemory::new();
        for (i, chunk) in bytes.chunks(24).enumerate() {
            let address = (24 * i) as u32;
            let answer = memory.write(&[&[0][..], &address.to_le_bytes(), chunk].concat()).unwrap();
            assert_eq!(answer[5], 0);
        }
        assert_eq!(memory.define(Fields(&[3, 1, kind, 0, 0, 0, 0, pieces])), Some(true));
        memory
    }

    #[test]
    fn what_was_uploaded_is_flown() {
        let numbers: Vec<f32> = (0..33).map(|i| i as f32).collect();
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let pieces = defined(0, 1, &bytes).pieces(3).unwrap();
        assert_eq!(pieces[0].duration_s, 32.0);
        assert_eq!(pieces[0].axes[3][7], 31.0);
        assert!(defined(0, 1, &bytes).pieces(4).is_none());
    }

    #[test]
    fn compressed_trajectories_go_on_from_their_last_point() {
        let mut bytes = Vec::new();
        for number in [1000_i16, 0, 500, 0] {
            bytes.extend(number.to_le_bytes());
        }
        for end in [2000_i16, 3000] {
            bytes.extend([0b0000_0001, 0xe8, 0x03]);
            bytes.extend(end.to_le_bytes());
        }
        let pieces = defined(1, 2, &bytes).pieces(3).unwrap();
        assert!(
            (pieces[0].point(1.0).at[0] - 2.0).abs() < 1e-9
                && (pieces[1].point(0.0).at[0] - 2.0).abs() < 1e-9
        );
        assert!(
            (pieces[1].point(1.0).at[0] - 3.0).abs() < 1e-9
                && (pieces[1].point(1.0).at[2] - 0.5).abs() < 1e-9
        );
    }

    #[test]
    fn no_base_station_is_described_and_none_can_be() {
        let mut memory = TrajectoryMemory::new();
        assert_eq!(memory.info(&[2, 1]).unwrap()[..3], [2, 1, 0x14]);
        assert_eq!(memory.read(&[1, 0, 0x10, 0, 0, 3]).unwrap(), [1, 0, 0x10, 0, 0, 0, 0, 0, 0]);
        assert_eq!(memory.write(&[1, 0, 0, 0, 0, 7]).unwrap()[5], EIO);
        assert_eq!(memory.read(&[0, 0xff, 0x0f, 0, 0, 2]).unwrap()[5], EIO);
        assert_eq!(memory.read(&[2, 0, 0, 0, 0, 1]).unwrap()[5], EIO);
    }

    proptest! {
        #[test]
        fn no_request_leaves_the_memory(request in proptest::collection::vec(any::<u8>(), 0..31)) {
            let mut memory = TrajectoryMemory::new();
            let _ = (memory.info(&request), memory.read(&request), memory.write(&request));
            if memory.define(Fields(&request)) == Some(true) {
                let _ = memory.pieces(request[0]);
            }
        }
    }
}
