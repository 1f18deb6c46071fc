//! What a reader detected, cut or converted on the way to a [`FlightLog`](super::FlightLog).

use std::fmt;

/// One remark of a reader. Its text is for people; match on the variant in code.
#[derive(Debug, Clone, PartialEq)]
pub enum Note {
    /// The gzip stream ends before its end mark; what had been written was used.
    TruncatedGzip,
    /// The last line has no line end, so its last number may be cut short; it was left out.
    PartialLastLine { line: u64 },
    /// Columns that the format does not know.
    IgnoredColumns { columns: Vec<String> },
    /// `t_s` counts from this time of the file's own clock.
    TimeShifted { start_s: f64 },
    /// Steps of the time column longer than 1.5 of the usual step.
    TimeGaps { count: usize, usual_s: f64, longest_s: f64 },
    /// Rows after the last radio packet of `channels` are extrapolation and were cut.
    CutAfterLastPacket { channels: &'static str, kept_s: f64, cut_s: f64 },
    /// `channels` brought no packets in flight: absent from the log.
    DeadChannels { channels: &'static str },
    /// The battery voltage after its last packet is that packet's value, held.
    BatteryHeld { from_s: f64 },
    /// Stretches in flight where `channels` are interpolated over lost packets (0.1 s or longer).
    RadioGaps { channels: &'static str, count: usize, longest_s: f64 },
    /// Signs turned to the right-handed frame.
    Negated { columns: &'static [&'static str] },
    /// Columns that are not what their name or description says: `unit` is what they were read as.
    ReadAs { columns: &'static str, unit: &'static str },
    /// Onboard gyro against motion-capture rates: positive when the onboard data appears later. Median,
    /// lowest and highest of the thirds of the flight. Nothing was shifted.
    ClockSkew { median_s: f64, lowest_s: f64, highest_s: f64 },
    /// The onboard and motion-capture clocks could not be compared: the flight excites the rates too little.
    ClockSkewUnknown,
    /// Median of onboard yaw minus motion-capture yaw in flight.
    YawOffset { median_rad: f64 },
    /// The format logs no yaw-rate command and none can be derived from what it logs.
    NoYawRateCommand,
    /// A wrapped angle was made continuous.
    Unwrapped { channel: &'static str, jumps: usize },
    /// Camera fixes whose capture time is not later than the one before. They are kept in order of arrival.
    CaptureOutOfOrder { count: usize },
    /// Camera fixes stamped later than the row in which they arrived.
    CaptureInFuture { count: usize },
    /// The file holds no position at all, so it is unknown when the vehicle flew.
    NoPosition,
    /// The vehicle never rose above this height.
    NeverAirborne { above_m: f64 },
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TruncatedGzip => write!(f, "the gzip data is truncated; used what is whole"),
            Self::PartialLastLine { line } => {
                write!(f, "left out line {line}, which has no line end")
            }
            Self::IgnoredColumns { columns } => write!(f, "ignored columns {}", columns.join(", ")),
            Self::TimeShifted { start_s } => {
                write!(f, "time counts from {start_s} s of the file's clock")
            }
            Self::TimeGaps { count, usual_s, longest_s } => {
                write!(f, "{count} gaps in time, the longest {longest_s:.3} s where {usual_s:.3} s is usual")
            }
            Self::CutAfterLastPacket { channels, kept_s, cut_s } => {
                write!(f, "cut {cut_s:.2} s after the last radio packet of {channels}, kept {kept_s:.2} s")
            }
            Self::DeadChannels { channels } => {
                write!(f, "{channels}: no packets in flight, left out")
            }
            Self::BatteryHeld { from_s } => {
                write!(f, "battery voltage held from {from_s:.2} s, its last packet")
            }
            Self::RadioGaps { channels, count, longest_s } => {
                write!(f, "{channels}: {count} gaps filled by interpolation in flight, the longest {longest_s:.2} s")
            }
            Self::Negated { columns } => write!(f, "negated {}", columns.join(", ")),
            Self::ReadAs { columns, unit } => write!(f, "{columns} read as {unit}"),
            Self::ClockSkew { median_s, lowest_s, highest_s } => write!(
                f,
                "onboard data appears {:.0} ms later than motion capture ({:.0} to {:.0} ms over the flight)",
                median_s * 1e3,
                lowest_s * 1e3,
                highest_s * 1e3
            ),
            Self::ClockSkewUnknown => write!(f, "too little motion to compare the onboard clock"),
            Self::YawOffset { median_rad } => write!(f, "onboard yaw is {:.2} degrees above motion capture", median_rad.to_degrees()),
            Self::NoYawRateCommand => write!(f, "no yaw-rate command in the log"),
            Self::Unwrapped { channel, jumps } => {
                write!(f, "{channel} made continuous over {jumps} wraps")
            }
            Self::CaptureOutOfOrder { count } => {
                write!(f, "{count} camera fixes not later than the one before")
            }
            Self::CaptureInFuture { count } => {
                write!(f, "{count} camera fixes stamped later than they arrived")
            }
            Self::NoPosition => write!(f, "no position measurement: airborne interval unknown"),
            Self::NeverAirborne { above_m } => write!(f, "never above {above_m} m"),
        }
    }
}
