//! CRTP packets: a header byte with port and channel, and at most thirty bytes.

/// Most bytes after the header.
pub const MAX_DATA: usize = 30;

/// The link layer's own packet, which carries nothing: port 15, channel 3.
const NULL: (u8, u8) = (15, 3);

/// A packet of the Crazy RealTime Protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// Service, 0 to 15.
    pub port: u8,
    /// Part of the service, 0 to 3.
    pub channel: u8,
    data: [u8; MAX_DATA],
    len: u8,
}

impl Packet {
    /// Creates a packet with as much of `data` as fits.
    pub fn new(port: u8, channel: u8, data: &[u8]) -> Packet {
        let len = data.len().min(MAX_DATA);
        let mut packet =
            Packet { port: port & 0x0f, channel: channel & 0x03, data: [0; MAX_DATA], len: len as u8 };
        packet.data[..len].copy_from_slice(&data[..len]);
        packet
    }

    /// The packet of a datagram; nothing where it is empty or too long for one.
    pub fn parse(bytes: &[u8]) -> Option<Packet> {
        let (header, data) = bytes.split_first()?;
        (data.len() <= MAX_DATA).then(|| Packet::new(header >> 4, header & 0x03, data))
    }

    /// Returns the bytes after the header.
    pub fn data(&self) -> &[u8] {
        &self.data[..self.len.into()]
    }

    /// Returns whether it is the link layer's own packet, with which clients search for vehicles.
    pub fn is_null(&self) -> bool {
        (self.port, self.channel) == NULL
    }

    /// The datagram of this packet. Bits 2 and 3 of the header are set, as the radio's are.
    pub fn bytes(&self) -> ([u8; MAX_DATA + 1], usize) {
        let mut bytes = [0; MAX_DATA + 1];
        bytes[0] = self.port << 4 | 0x0c | self.channel;
        bytes[1..].copy_from_slice(&self.data);
        (bytes, usize::from(self.len) + 1)
    }
}

/// Numbers of a packet, one after the other, little-endian.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*first)
    }
    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.take().map(|[byte]| byte)
    }
    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }
    pub(crate) fn i16(&mut self) -> Option<i16> {
        self.take().map(i16::from_le_bytes)
    }
    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }
    /// Reads a number, `None` unless it is finite: other values cannot be flown.
    pub(crate) fn f32(&mut self) -> Option<f64> {
        self.take().map(f32::from_le_bytes).filter(|number| number.is_finite()).map(f64::from)
    }
    pub(crate) fn f32s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f32()?;
        }
        Some(numbers)
    }
    pub(crate) fn i16s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.i16()?.into();
        }
        Some(numbers)
    }
    pub(crate) fn bool(&mut self) -> Option<bool> {
        self.u8().map(|byte| byte != 0)
    }
    pub(crate) fn rest(self) -> &'a [u8] {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_datagram_is_its_packet_and_back(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let packet = Packet::parse(&bytes);
            prop_assert_eq!(packet.is_some(), (1..=MAX_DATA + 1).contains(&bytes.len()));
            if let Some(packet) = packet {
                let (written, len) = packet.bytes();
                prop_assert_eq!(written[0], bytes[0] | 0x0c);
                prop_assert_eq!(&written[1..len], &bytes[1..]);
                prop_assert_eq!(Packet::parse(&written[..len]), Some(packet));
            }
        }
    }

    #[test]
    fn the_scan_of_a_client_is_a_null_packet() {
        assert!(Packet::parse(&[0xff]).unwrap().is_null());
        assert!(!Packet::parse(&[0xfd]).unwrap().is_null());
    }
}
