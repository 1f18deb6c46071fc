//! Reading numbers and text from bytes that may end anywhere.

use std::io::Read;

use super::{LogError, Result};

/// A position in a byte slice. Every read checks the length first; `None` means that the bytes end too soon.
#[derive(Debug, Clone)]
pub(super) struct Bytes<'a> {
    data: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    pub(super) fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0 }
    }

    /// Offset of the next byte.
    pub(super) fn position(&self) -> usize {
        self.at
    }

    pub(super) fn remaining(&self) -> usize {
        self.data.len() - self.at
    }

    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let taken = self.data.get(self.at..self.at.checked_add(count)?)?;
        self.at += count;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    /// All that is left.
    pub(super) fn rest(&mut self) -> &'a [u8] {
        let rest = &self.data[self.at..];
        self.at = self.data.len();
        rest
    }

    pub(super) fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Option<f32> {
        self.array().map(f32::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// A number of a type by its letter in Python's `struct`, such as `h`.
    pub(super) fn number(&mut self, letter: u8) -> Option<f64> {
        Some(match letter {
            b'b' => f64::from(self.u8()?.cast_signed()),
            b'B' => f64::from(self.u8()?),
            b'h' => f64::from(self.u16()?.cast_signed()),
            b'H' => f64::from(self.u16()?),
            b'i' => f64::from(self.u32()?.cast_signed()),
            b'I' => f64::from(self.u32()?),
            b'q' => self.u64()?.cast_signed() as f64,
            b'Q' => self.u64()? as f64,
            b'f' => f64::from(self.f32()?),
            b'd' => self.f64()?,
            _ => return None,
        })
    }

    /// Bytes with their length in front, as ROS 1 writes strings and record parts.
    pub(super) fn block(&mut self) -> Option<&'a [u8]> {
        let mut ahead = self.clone();
        let count = usize::try_from(ahead.u32()?).ok()?;
        let block = ahead.take(count)?;
        *self = ahead;
        Some(block)
    }

    /// Text up to a zero byte, which is skipped; `None` if there is none within `longest` bytes or it is no
    /// text.
    pub(super) fn c_string(&mut self, longest: usize) -> Option<&'a str> {
        let rest = &self.data[self.at..];
        let end = rest.iter().take(longest + 1).position(|byte| *byte == 0)?;
        let text = std::str::from_utf8(&rest[..end]).ok()?;
        self.at += end + 1;
        Some(text)
    }
}

/// The room that a file has for what its chunks unpack to.
#[derive(Debug, Default)]
pub(super) struct Room<'f> {
    pub(super) file: &'f str,
    pub(super) limit_mib: u64,
    /// Bytes so far.
    pub(super) unpacked: u64,
}

impl Room<'_> {
    /// Unpacks as far as possible, and returns whether that was to the end.
    pub(super) fn unpack(&mut self, from: std::io::Result<impl Read>) -> Result<(Vec<u8>, bool)> {
        let (mut unpacked, most) = (Vec::new(), self.limit_mib << 20);
        let read = from.and_then(|from| from.take(most - self.unpacked).read_to_end(&mut unpacked));
        self.unpacked += unpacked.len() as u64;
        if self.unpacked >= most {
            return Err(LogError::TooLarge { file: self.file.to_owned(), limit_mib: self.limit_mib });
        }
        Ok((unpacked, read.is_ok()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_stop_at_the_end() {
        let mut bytes = Bytes::new(&[1, 0, 9]);
        assert_eq!(bytes.u16(), Some(1));
        assert_eq!((bytes.u16(), bytes.position()), (None, 2));
        assert_eq!((bytes.u8(), bytes.remaining()), (Some(9), 0));
        assert_eq!(bytes.take(usize::MAX), None);
    }

    #[test]
    fn a_block_that_is_not_whole_is_left_in_place() {
        let mut bytes = Bytes::new(&[2, 0, 0, 0, 7, 8, 9, 0, 0, 0, 1]);
        assert_eq!(bytes.block(), Some(&[7, 8][..]));
        assert_eq!((bytes.block(), bytes.position()), (None, 6));
    }

    #[test]
    fn text_needs_its_end() {
        let mut bytes = Bytes::new(b"ab\0cd");
        assert_eq!(bytes.c_string(1), None);
        assert_eq!(bytes.c_string(2), Some("ab"));
        assert_eq!(bytes.c_string(9), None);
    }
}
