//! Ways to damage a file.

use proptest::prelude::*;

/// A way to damage a file.
#[derive(Debug, Clone)]
pub enum Damage {
    Byte(usize, u8),
    Bit(usize, u8),
    Delete(usize, usize),
    Insert(usize, Vec<u8>),
    Repeat(usize, usize),
    Truncate(usize),
}

pub fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<u32>().prop_map(|at| at as usize);
    // Lengths that ask for too much, and numbers that are none.
    let odd = prop::sample::select(vec![
        vec![0xff; 4],
        vec![0xff; 8],
        vec![0; 8],
        vec![0xff, 0xff, 0xff, 0x7f],
        f64::NAN.to_le_bytes().to_vec(),
        f64::MAX.to_le_bytes().to_vec(),
        f32::INFINITY.to_le_bytes().to_vec(),
    ]);
    prop_oneof![
        (at.clone(), any::<u8>()).prop_map(|(a, b)| Damage::Byte(a, b)),
        (at.clone(), 0..8_u8).prop_map(|(a, b)| Damage::Bit(a, b)),
        (at.clone(), 1..200_usize).prop_map(|(a, n)| Damage::Delete(a, n)),
        (at.clone(), odd).prop_map(|(a, s)| Damage::Insert(a, s)),
        (at.clone(), 1..400_usize).prop_map(|(a, n)| Damage::Repeat(a, n)),
        at.prop_map(Damage::Truncate),
    ]
}

impl Damage {
    pub fn apply(&self, bytes: &mut Vec<u8>) {
        let length = bytes.len();
        let wrap = |at: &usize| at % (length + 1);
        match self {
            Self::Byte(at, value) => {
                if let Some(byte) = bytes.get_mut(wrap(at)) {
                    *byte = *value;
                }
            }
            Self::Bit(at, bit) => {
                if let Some(byte) = bytes.get_mut(wrap(at)) {
                    *byte ^= 1 << bit;
                }
            }
            Self::Delete(at, count) => {
                let at = wrap(at);
                bytes.drain(at..(at + count).min(length));
            }
            Self::Insert(at, new) => {
                let at = wrap(at);
                let end = (at + new.len()).min(length);
                // Over what is there, so that fields stay in place.
                bytes.splice(at..end, new.iter().copied());
            }
            Self::Repeat(at, count) => {
                let at = wrap(at);
                let copy = bytes[at..(at + count).min(length)].to_vec();
                bytes.splice(at..at, copy);
            }
            Self::Truncate(at) => bytes.truncate(wrap(at)),
        }
    }
}
