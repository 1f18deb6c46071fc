//! Notes on what a reader detected, cut or converted on the way to a [`FlightLog`](super::FlightLog).

use std::fmt;

/// One remark of a reader. Its text is for people; match on the variant in code.
#[derive(Debug, Clone, PartialEq)]
pub enum Note {
    /// The gzip stream ends before its end mark; what had been written was used.
    TruncatedGzip,
    /// The last line has no line end, so its last number may be cut short; it was left out.
    PartialLastLine {
        /// Number of that line; the header is line 1.
        line: u64,
    },
    /// The text was in this encoding, not in UTF-8.
    Decoded {
        /// Name of the encoding.
        encoding: &'static str,
    },
    /// Lines of comments between the rows were left out.
    Comments {
        /// Number of such lines.
        count: usize,
    },
    /// The line of names appears again between the rows.
    RepeatedHeader {
        /// Number of repetitions.
        count: usize,
    },
    /// Rows with another number of cells than the line of names were left out.
    RaggedRows {
        /// Number of such rows.
        count: usize,
        /// Line of the first.
        line: u64,
    },
    /// A row or line contains names and values; they were made columns.
    Pivoted {
        /// The form in words.
        from: &'static str,
    },
    /// Files of one flight were joined on their clock.
    Joined {
        /// Their names.
        files: Vec<String>,
    },
    /// Columns that several of the joined files have; those of the first file were read.
    ColumnsTwice {
        /// Their names.
        columns: Vec<String>,
    },
    /// The counter of the time stamps wrapped and was made continuous.
    ClockWraps {
        /// Name of the time column.
        column: String,
        /// Number of wraps.
        wraps: usize,
    },
    /// The clock begins anew in the file: it contains several flights, of which one was read.
    Flights {
        /// Number of flights.
        count: usize,
        /// Number of the one that was read, from 1.
        read: usize,
    },
    /// Columns that the format does not know.
    IgnoredColumns {
        /// Their names, in the order of the file.
        columns: Vec<String>,
    },
    /// `t_s` counts from this time of the file's own clock.
    TimeShifted {
        /// Time of the first row on that clock.
        start_s: f64,
    },
    /// Steps of the time column longer than 1.5 of the usual step.
    TimeGaps {
        /// Number of such steps.
        count: usize,
        /// Median step.
        usual_s: f64,
        /// Longest step.
        longest_s: f64,
    },
    /// Rows after the last radio packet of `channels` are extrapolation and were cut.
    CutAfterLastPacket {
        /// Group of columns, in words.
        channels: &'static str,
        /// Time of the last row that was kept.
        kept_s: f64,
        /// Duration of the part that was cut.
        cut_s: f64,
    },
    /// `channels` brought no packets in flight: absent from the log.
    DeadChannels {
        /// Group of columns, in words.
        channels: &'static str,
    },
    /// The battery voltage after its last packet is that packet's value, repeated.
    BatteryHeld {
        /// Time of the last packet.
        from_s: f64,
    },
    /// Stretches in flight where `channels` are interpolated over lost packets (0.1 s or longer).
    RadioGaps {
        /// Group of columns, in words.
        channels: &'static str,
        /// Number of stretches.
        count: usize,
        /// Longest stretch.
        longest_s: f64,
    },
    /// Signs turned to the right-handed frame.
    Negated {
        /// Names of the columns in the file.
        columns: &'static [&'static str],
    },
    /// Columns that differ from their name or description: `unit` is the one in which they were read.
    ReadAs {
        /// Names of the columns in the file.
        columns: &'static str,
        /// Quantity or unit, in words.
        unit: &'static str,
    },
    /// A column that the firmware does not write was taken for a position from outside, by its name, in metres.
    OutsideColumn {
        /// Name of the column.
        column: String,
    },
    /// A channel was multiplied by the mapping file's factor.
    Scaled {
        /// Name of the channel.
        channel: &'static str,
        /// Its factor.
        factor: f64,
    },
    /// A column is in another unit than usual, given in the file.
    ReadInUnit {
        /// Name of the column.
        column: String,
        /// Unit as in a mapping file, such as `rad`.
        unit: &'static str,
    },
    /// Onboard gyro against motion-capture rates: positive when the onboard data appears later. Median,
    /// lowest and highest of the thirds of the flight. Nothing was shifted.
    ClockSkew {
        /// Median of the thirds.
        median_s: f64,
        /// Lowest of the thirds.
        lowest_s: f64,
        /// Highest of the thirds.
        highest_s: f64,
    },
    /// The onboard and motion-capture clocks could not be compared: the flight excites the rates too little.
    ClockSkewUnknown,
    /// Median of onboard yaw minus motion-capture yaw in flight.
    YawOffset {
        /// Median over the flight, positive where the onboard yaw is larger.
        median_rad: f64,
    },
    /// The format logs no yaw-rate command and none can be derived from what it logs.
    NoYawRateCommand,
    /// A wrapped angle was made continuous.
    Unwrapped {
        /// Name of the angle, in words.
        channel: &'static str,
        /// Number of wraps.
        jumps: usize,
    },
    /// Camera fixes whose capture time is not later than the one before. They are kept in order of arrival.
    CaptureOutOfOrder {
        /// Number of such fixes.
        count: usize,
    },
    /// Camera fixes stamped later than the row in which they arrived.
    CaptureInFuture {
        /// Number of such fixes.
        count: usize,
    },
    /// The camera's clock, by which capture times were stamped, ran at another rate than the log's: corrected.
    CaptureDrift {
        /// Its rate beyond the log's, in millionths.
        fast_ppm: f64,
    },
    /// The file has no position at all, so it is unknown when the vehicle flew.
    NoPosition,
    /// The vehicle never rose above this height.
    NeverAirborne {
        /// Height that counts as flight, on the scale of the log's position.
        above_m: f64,
    },
    /// The file ends or is damaged at this byte; the `kept` records or messages before it were used.
    CutShort {
        /// Offset from the start of the file's content.
        byte: usize,
        /// Number of records or messages used.
        kept: usize,
        /// Word for what is counted: `records` or `messages`.
        unit: &'static str,
        /// The problem at that place.
        reason: String,
    },
    /// The database is damaged behind the messages that were used.
    DamagedDatabase {
        /// Number of messages used.
        kept: usize,
        /// The database's own message.
        reason: String,
    },
    /// The check sum at the end of the file is not that of its content.
    WrongChecksum,
    /// Rows or messages of `source` with values that are not finite, or that cannot be decoded, were left out.
    OddValues {
        /// Name of the topic, event or quantity.
        source: String,
        /// Number of rows or messages left out.
        count: usize,
    },
    /// Time stamps of `source` that are not later than the one before; put in order, repeated ones left out.
    StampsOutOfOrder {
        /// Name of the topic, event or channel.
        source: String,
        /// Number of such stamps.
        count: usize,
    },
    /// No messages of the topic that the thesis's rig calls so.
    TopicMissing {
        /// Usual name of the topic, without namespace.
        topic: &'static str,
    },
    /// Topics of which a flight needs nothing.
    IgnoredTopics {
        /// Their names, with the type of the message where no flight needs it.
        topics: Vec<String>,
    },
    /// Messages without time stamps: times of record were used.
    NoStamps {
        /// Name of the topic.
        topic: String,
    },
    /// The stamps' clock against the recorder's. If it is another (`!same`), `offset_s` was added; the drift
    /// never is.
    TopicClock {
        /// Name of the topic.
        topic: String,
        /// True if the stamps are of the recorder's clock.
        same: bool,
        /// Time added to each stamp; 0 on the same clock.
        offset_s: f64,
        /// Median time from stamp to record, less the offset.
        transport_s: f64,
        /// Spread of that time, from its 5 % to its 95 % quantile.
        spread_s: f64,
        /// Rate at which the clocks part, in millionths; `None` for a short recording.
        drift_ppm: Option<f64>,
    },
    /// Stamps more than a second from their times of record, which were used instead.
    StrayStamps {
        /// Name of the topic.
        topic: String,
        /// Number of such stamps.
        count: usize,
    },
    /// Messages that the topic's usual rate lacks.
    LostMessages {
        /// Name of the topic.
        topic: String,
        /// Number of messages.
        count: usize,
        /// Longest time between two messages.
        longest_s: f64,
    },
    /// The camera against the IMU, by the motion that both measured: positive when the camera's data is later than
    /// its stamps. `shifted`: the capture times were corrected by it, since their stamps are unusable.
    CameraLag {
        /// Delay of the camera's data.
        lag_s: f64,
        /// Standard error of the delay, from the scatter between parts of the flight.
        sigma_s: f64,
        /// Correlation of the two motions at this delay, at most 1.
        correlation: f64,
        /// Motion that was compared, in words.
        by: &'static str,
        /// True if the capture times were corrected.
        shifted: bool,
    },
    /// Camera and IMU could not be compared: the flight moves too little or is too short.
    CameraLagUnknown,
    /// Marker poses in the frame of a camera that looks down were turned into the vehicle's over the marker.
    SeenFromCamera,
    /// Added to the integrated yaw so that it starts at the marker's.
    YawFromMarker {
        /// Angle added, positive counter-clockwise.
        offset_rad: f64,
    },
    /// Roll, pitch and yaw are the integrated gyro, less this bias, measured before take-off or (`!at_rest`) the mean
    /// of roll and pitch rates over the file; `None`: the file's rates have none, and the integration restarts
    /// whenever the vehicle is at rest.
    AttitudeIntegrated {
        /// Bias about the body's x, y and z axes.
        bias_radps: Option<[f64; 3]>,
        /// True if the bias was measured while the vehicle was at rest.
        at_rest: bool,
    },
    /// There is no IMU: roll, pitch and yaw are the marker's, interpolated.
    AttitudeFromMarker,
    /// Angles derived from the direction of the acceleration; yaw taken as zero where it is not logged.
    TiltFromAcceleration {
        /// True if roll is derived.
        roll: bool,
        /// True if pitch is derived.
        pitch: bool,
        /// True if the log lacks yaw.
        yaw_taken_as_zero: bool,
    },
    /// Nothing outside the vehicle measured its position: the fixes are its own estimate.
    PositionEstimated,
    /// The thrust command is the mean of the motors' requests.
    ThrustFromMotors,
    /// Channels on clocks of their own were brought to the rows: commands repeated, measurements interpolated.
    Resampled {
        /// Names of the channels.
        channels: Vec<String>,
    },
    /// The unit of a time column, which follows from its steps.
    TimeUnit {
        /// Name of the column.
        column: String,
        /// Unit as in a mapping file, such as `ms`.
        unit: &'static str,
    },
    /// Positions that repeat the one before were taken for rows without a fix.
    RepeatedPositions {
        /// Share of the positions left out, 0 to 1.
        share: f64,
    },
    /// A command in another unit was turned into 16-bit PWM.
    ScaledToPwm {
        /// Name of the command.
        channel: String,
        /// Unit in the file.
        unit: String,
    },
    /// Numbers are written with a decimal comma.
    DecimalCommas,
    /// In this share of the rows the vehicle feels gravity from below: it lies on its back.
    UpsideDown {
        /// Share of all rows, 0 to 1.
        share: f64,
    },
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
                write!(
                    f,
                    "{channels}: {count} gaps filled by interpolation in flight, the longest {longest_s:.2} s"
                )
            }
            Self::Negated { columns } => write!(f, "negated {}", columns.join(", ")),
            Self::OutsideColumn { column } => write!(f, "{column} taken for the position from outside, in m"),
            Self::Scaled { channel, factor } => {
                write!(f, "{channel} times {factor}, as the mapping file says")
            }
            Self::ReadInUnit { column, unit } => write!(f, "{column} is in {unit}, as the file says"),
            Self::ReadAs { columns, unit } => write!(f, "{columns} read as {unit}"),
            Self::ClockSkew { median_s, lowest_s, highest_s } => write!(
                f,
                "onboard data appears {:.0} ms later than motion capture ({:.0} to {:.0} ms over the flight)",
                median_s * 1e3,
                lowest_s * 1e3,
                highest_s * 1e3
            ),
            Self::ClockSkewUnknown => write!(f, "too little motion to compare the onboard clock"),
            Self::YawOffset { median_rad } => {
                write!(f, "onboard yaw is {:.2} degrees above motion capture", median_rad.to_degrees())
            }
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
            Self::CaptureDrift { fast_ppm } => {
                let (percent, how) = (fast_ppm.abs() / 1e4, if *fast_ppm > 0.0 { "fast" } else { "slow" });
                write!(
                    f,
                    "the camera's clock runs {percent:.2} % {how}: capture times brought to the log's clock"
                )
            }
            Self::NoPosition => write!(f, "no position measurement: airborne interval unknown"),
            Self::NeverAirborne { above_m } => write!(f, "never above {above_m} m"),
            other => other.write_recording(f),
        }
    }
}

impl Note {
    /// The remarks on recordings: bags, MCAP and micro-SD logs.
    fn write_recording(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CutShort { byte, kept, unit, reason } => {
                write!(f, "reading ended at byte {byte} ({reason}); used {kept} {unit}")
            }
            Self::DamagedDatabase { kept, reason } => {
                write!(f, "the database is damaged ({reason}); used {kept} messages")
            }
            Self::WrongChecksum => write!(f, "the check sum does not match: the file is damaged or cut"),
            Self::OddValues { source, count } => {
                write!(f, "{source}: left out {count} records that cannot be read or are not finite")
            }
            Self::StampsOutOfOrder { source, count } => {
                write!(f, "{source}: {count} time stamps not later than the one before")
            }
            Self::TopicMissing { topic } => write!(f, "no {topic} (whatever its namespace)"),
            Self::IgnoredTopics { topics } => write!(f, "ignored topics {}", topics.join(", ")),
            Self::NoStamps { topic } => write!(f, "{topic}: no time stamps, times of record used"),
            Self::TopicClock { topic, same, offset_s, transport_s, spread_s, drift_ppm } => {
                let drift = drift_ppm.map_or(String::new(), |ppm| format!(", drift {ppm:.0} ppm"));
                let (transport_ms, spread_ms) = (transport_s * 1e3, spread_s * 1e3);
                let clock = if *same {
                    "stamps on the recorder's clock".into()
                } else {
                    format!("stamps on another clock, {offset_s:.3} s added")
                };
                write!(
                    f,
                    "{topic}: {clock}; recorded {transport_ms:.1} ms later (spread {spread_ms:.1} ms){drift}"
                )
            }
            Self::StrayStamps { topic, count } => {
                write!(f, "{topic}: {count} stray time stamps, times of record used")
            }
            Self::LostMessages { topic, count, longest_s } => {
                write!(f, "{topic}: {count} messages lost, the longest gap {longest_s:.3} s")
            }
            Self::CameraLag { lag_s, sigma_s, correlation, by, shifted } => {
                let (lag_ms, sigma_ms) = (lag_s * 1e3, sigma_s * 1e3);
                let done = if *shifted { "capture times corrected" } else { "not corrected" };
                write!(
                    f,
                    "camera {lag_ms:.0} +- {sigma_ms:.0} ms later than the IMU by {by} (correlation {correlation:.2}), {done}"
                )
            }
            Self::CameraLagUnknown => {
                write!(f, "too little motion to compare the camera's clock with the IMU's")
            }
            other => other.write_derived(f),
        }
    }

    /// The remarks on quantities that a recording lacks and that were derived.
    fn write_derived(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SeenFromCamera => {
                write!(f, "marker poses are in the camera's frame: turned into the vehicle's over the marker")
            }
            Self::YawFromMarker { offset_rad } => {
                write!(f, "yaw turned by {:.2} degrees to the marker's", offset_rad.to_degrees())
            }
            Self::AttitudeIntegrated { bias_radps: None, .. } => {
                write!(f, "attitude integrated from the gyro, from every standstill on")
            }
            Self::AttitudeIntegrated { bias_radps: Some(bias), at_rest } => {
                let [x, y, z] = bias.map(f64::to_degrees);
                let how = if *at_rest { "at rest" } else { "on average: no standstill to tell it better" };
                write!(
                    f,
                    "attitude integrated from the gyro, less its bias of {x:.3}, {y:.3}, {z:.3} degrees per second {how}"
                )
            }
            Self::AttitudeFromMarker => write!(f, "no IMU: attitude of the marker, interpolated"),
            Self::TiltFromAcceleration { roll, pitch, yaw_taken_as_zero } => {
                let named = [(*roll, "roll"), (*pitch, "pitch")]
                    .into_iter()
                    .filter(|(is, _)| *is)
                    .map(|(_, name)| name);
                let named: Vec<&str> = named.collect();
                let derived = (!named.is_empty())
                    .then(|| format!("not logged, derived from the acceleration: {}", named.join(", ")));
                let yaw = yaw_taken_as_zero.then(|| "yaw is not logged, taken as 0".to_owned());
                write!(f, "{}", derived.into_iter().chain(yaw).collect::<Vec<_>>().join("; "))
            }
            Self::PositionEstimated => {
                write!(f, "no outside measurement: position is the vehicle's own estimate")
            }
            Self::ThrustFromMotors => write!(f, "thrust command: mean of the four motors' requests"),
            Self::Resampled { channels } => {
                write!(f, "brought to the clock of the rows: {}", channels.join(", "))
            }
            Self::TimeUnit { column, unit } => write!(f, "{column} read as {unit}"),
            Self::RepeatedPositions { share } => {
                write!(
                    f,
                    "{:.0} % of the positions repeat the one before: no fix arrived there",
                    share * 100.0
                )
            }
            Self::ScaledToPwm { channel, unit } => {
                write!(f, "{channel}: {unit} scaled to PWM, 65535 being all")
            }
            Self::DecimalCommas => write!(f, "numbers have a decimal comma"),
            Self::UpsideDown { share } => {
                write!(f, "on its back for {:.0} % of the time: a crash", share * 100.0)
            }
            other => other.write_table(f),
        }
    }

    /// Writes the remarks on the text around a table and in it.
    fn write_table(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Decoded { encoding } => write!(f, "the text is {encoding}, not UTF-8"),
            Self::Comments { count } => write!(f, "left out {count} lines of comments"),
            Self::RepeatedHeader { count } => {
                write!(f, "left out {count} lines that repeat the names of the columns")
            }
            Self::RaggedRows { count, line } => {
                write!(f, "left out {count} rows with a wrong number of cells, the first in line {line}")
            }
            Self::Pivoted { from } => write!(f, "{from} made columns"),
            Self::Joined { files } => write!(f, "joined on their clock: {}", files.join(", ")),
            Self::ColumnsTwice { columns } => {
                write!(f, "in several of the files, read from the first: {}", columns.join(", "))
            }
            Self::ClockWraps { column, wraps } => {
                write!(f, "{column} wraps {wraps} times, made continuous")
            }
            Self::Flights { count, read } => {
                let all = if *count == 2 { "two flights".to_owned() } else { format!("{count} flights") };
                let (which, other) =
                    if *read == 1 { ("the first".to_owned(), 2) } else { (format!("part {read}"), 1) };
                write!(f, "{all}: the clock begins anew; {which} is read (--part {other} reads another)")
            }
            // All others are written by `fmt`.
            _ => Ok(()),
        }
    }
}
