//! The few ROS messages that a flight consists of, out of their bytes (ROS 1, or CDR as ROS 2 writes it).

use super::bytes::Bytes;

/// Byte layout of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Packed, little endian.
    Ros1,
    /// Aligned, after four bytes with the byte order.
    Cdr,
}

/// The message types that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Twist,
    TwistStamped,
    Imu,
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
    /// Several of them in one message, each of a body.
    Transforms,
    Odometry,
    Float32,
    /// Values of a vehicle's log block; a mapping names them.
    LogData,
}

impl Kind {
    /// By the name of the type, as ROS 1 and ROS 2 write it.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Some(match name.replace("/msg/", "/").as_str() {
            "geometry_msgs/Twist" => Self::Twist,
            "geometry_msgs/TwistStamped" => Self::TwistStamped,
            "sensor_msgs/Imu" => Self::Imu,
            "geometry_msgs/PoseStamped" => Self::PoseStamped,
            "geometry_msgs/PoseWithCovarianceStamped" => Self::PoseWithCovarianceStamped,
            "geometry_msgs/TransformStamped" => Self::TransformStamped,
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Self::Transforms,
            "nav_msgs/Odometry" => Self::Odometry,
            "std_msgs/Float32" => Self::Float32,
            "crazyflie_interfaces/LogDataGeneric" => Self::LogData,
            _ => return None,
        })
    }

    fn is_stamped(self) -> bool {
        !matches!(self, Self::Twist | Self::Float32)
    }

    /// Returns whether the name of a second frame follows the header.
    fn has_child_frame(self) -> bool {
        matches!(self, Self::TransformStamped | Self::Odometry)
    }

    /// Returns the fields of numbers after the header, and the length of each.
    fn fields(self) -> &'static [(&'static str, usize)] {
        match self {
            Self::Twist => &[("linear", 3), ("angular", 3)],
            Self::TwistStamped => &[("twist.linear", 3), ("twist.angular", 3)],
            Self::Imu => &[
                ("orientation", 4),
                ("orientation_covariance", 9),
                ("angular_velocity", 3),
                ("angular_velocity_covariance", 9),
                ("linear_acceleration", 3),
                ("linear_acceleration_covariance", 9),
            ],
            Self::PoseStamped => &[("pose.position", 3), ("pose.orientation", 4)],
            Self::TransformStamped | Self::Transforms => {
                &[("transform.translation", 3), ("transform.rotation", 4)]
            }
            Self::PoseWithCovarianceStamped => {
                &[("pose.pose.position", 3), ("pose.pose.orientation", 4), ("pose.covariance", 36)]
            }
            Self::Odometry => &[
                ("pose.pose.position", 3),
                ("pose.pose.orientation", 4),
                ("pose.covariance", 36),
                ("twist.twist.linear", 3),
                ("twist.twist.angular", 3),
                ("twist.covariance", 36),
            ],
            Self::Float32 => &[("data", 1)],
            Self::LogData => &[],
        }
    }

    /// Number of numbers after the header.
    fn numbers(self) -> usize {
        self.fields().iter().map(|(_, count)| count).sum()
    }

    /// The path of a number in the message, such as `pose.position.x`.
    pub(super) fn path(self, mut at: usize) -> String {
        for (field, count) in self.fields() {
            if at < *count {
                return match count {
                    1 => (*field).to_owned(),
                    3 | 4 => format!("{field}.{}", ["x", "y", "z", "w"][at]),
                    _ => format!("{field}[{at}]"),
                };
            }
            at -= count;
        }
        format!("values[{at}]")
    }
}

/// A message: the time in its header (nanoseconds; `None` without header or if nobody filled it), and its numbers in
/// the order of its definition.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Message {
    pub(super) stamp_ns: Option<u64>,
    pub(super) numbers: Vec<f64>,
}

/// Decodes a message; `None` if its bytes are too few or contain no finite numbers. In a message of several bodies
/// each has its name; otherwise the name is empty.
pub(super) fn decode(kind: Kind, encoding: Encoding, data: &[u8]) -> Option<Vec<(String, Message)>> {
    let mut fields = Fields::new(encoding, data)?;
    if kind == Kind::Transforms {
        let count = fields.u32()?;
        let body = |fields: &mut Fields<'_>| {
            let stamp_ns = fields.header()?;
            let name = fields.text()?;
            Some((name, Message { stamp_ns, numbers: fields.numbers(kind)? }))
        };
        return (0..count).map(|_| body(&mut fields)).collect();
    }
    let stamp_ns = if kind.is_stamped() { fields.header()? } else { None };
    if kind.has_child_frame() {
        fields.text()?;
    }
    Some(vec![(String::new(), Message { stamp_ns, numbers: fields.numbers(kind)? })])
}

/// The fields of a message, one after the other.
struct Fields<'a> {
    bytes: Bytes<'a>,
    encoding: Encoding,
    big_endian: bool,
    /// CDR version 2 aligns to four bytes at most.
    widest: usize,
}

impl<'a> Fields<'a> {
    fn new(encoding: Encoding, data: &'a [u8]) -> Option<Self> {
        if encoding == Encoding::Ros1 {
            return Some(Self { bytes: Bytes::new(data), encoding, big_endian: false, widest: 1 });
        }
        let [0, kind, _, _] = *data.first_chunk()? else { return None };
        let widest = match kind {
            0 | 1 => 8,
            6 | 7 => 4,
            _ => return None,
        };
        Some(Self { bytes: Bytes::new(&data[4..]), encoding, big_endian: kind % 2 == 0, widest })
    }

    fn align(&mut self, size: usize) -> Option<()> {
        let size = size.min(self.widest);
        let past = self.bytes.position() % size;
        if past > 0 {
            self.bytes.take(size - past)?;
        }
        Some(())
    }

    fn u32(&mut self) -> Option<u32> {
        self.align(4)?;
        self.bytes.u32().map(|v| if self.big_endian { v.swap_bytes() } else { v })
    }

    fn f32(&mut self) -> Option<f64> {
        self.u32().map(|bits| f64::from(f32::from_bits(bits)))
    }

    fn f64(&mut self) -> Option<f64> {
        self.align(8)?;
        let bits = self.bytes.u64()?;
        Some(f64::from_bits(if self.big_endian { bits.swap_bytes() } else { bits }))
    }

    fn text(&mut self) -> Option<String> {
        let length = self.u32()?;
        let bytes = self.bytes.take(usize::try_from(length).ok()?)?;
        Some(String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned())
    }

    /// The numbers of a message.
    fn numbers(&mut self, kind: Kind) -> Option<Vec<f64>> {
        let count = match kind {
            Kind::LogData => {
                self.u32()?; // the vehicle's clock
                usize::try_from(self.u32()?).ok()?.min(self.bytes.remaining() / 4)
            }
            _ => kind.numbers(),
        };
        let is_single = matches!(kind, Kind::Float32 | Kind::LogData);
        let numbers: Option<Vec<f64>> =
            (0..count).map(|_| if is_single { self.f32() } else { self.f64() }).collect();
        // Nothing that flies measures more; squares stay finite.
        numbers.filter(|all| all.iter().all(|v| v.abs() <= 1e12))
    }

    /// A header: its stamp, `Some(None)` where that is zero.
    fn header(&mut self) -> Option<Option<u64>> {
        if self.encoding == Encoding::Ros1 {
            self.u32()?; // the sequence number, which ROS 2 dropped
        }
        let (seconds, nanoseconds) = (self.u32()?, self.u32()?);
        self.text()?;
        let stamp = u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds);
        Some((stamp > 0).then_some(stamp))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(with_sequence: bool) -> Vec<u8> {
        let mut bytes = Vec::new();
        if with_sequence {
            bytes.extend(7_u32.to_le_bytes());
        }
        bytes.extend(12_u32.to_le_bytes());
        bytes.extend(34_u32.to_le_bytes());
        bytes.extend(3_u32.to_le_bytes());
        bytes.extend(b"map");
        bytes
    }

    #[test]
    fn packed_and_aligned_poses_read_alike() {
        let numbers = [1.0, -2.0, 3.0, 0.0, 0.0, 0.6, 0.8];
        let body: Vec<u8> = numbers.iter().flat_map(|v: &f64| v.to_le_bytes()).collect();
        let ros1 = [header(true), body.clone()].concat();
        // 15 bytes of header: one byte to the next multiple of 8
        let cdr = [vec![0, 1, 0, 0], header(false), vec![0], body.clone()].concat();
        for (encoding, data) in [(Encoding::Ros1, ros1), (Encoding::Cdr, cdr)] {
            let message = decode(Kind::PoseStamped, encoding, &data).unwrap().remove(0).1;
            assert_eq!((message.stamp_ns, &message.numbers[..]), (Some(12_000_000_034), &numbers[..]));
            for end in 0..data.len() {
                assert_eq!(decode(Kind::PoseStamped, encoding, &data[..end]), None);
            }
        }
    }

    #[test]
    fn byte_order_and_odd_values() {
        let twist = |first: f64| [vec![0, 0, 0, 0], first.to_be_bytes().to_vec(), vec![0; 40]].concat();
        assert_eq!(decode(Kind::Twist, Encoding::Cdr, &twist(2.5)).unwrap()[0].1.numbers[0], 2.5);
        assert_eq!(decode(Kind::Twist, Encoding::Cdr, &twist(f64::NAN)), None);
        assert_eq!(decode(Kind::Twist, Encoding::Cdr, &[9; 60]), None);
        assert_eq!(Kind::from_name("sensor_msgs/msg/Imu"), Some(Kind::Imu));
    }
}
