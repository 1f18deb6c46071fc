//! Notes on what a reader detected, cut or converted on the way to a [`FlightLog`](super::FlightLog).

use thiserror::Error;

/// One remark of a reader. Its text is for people; match on the variant in code.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs, reason = "each variant lists its fields")]
pub enum Note {
    /// The gzip stream ends before its end mark; what had been written was used.
    #[error("the gzip data is truncated; used what is whole")]
    TruncatedGzip,
    /// The last line has no line end, so its last number may be cut short; it was left out.
    ///
    /// - `line`: number of that line; the header is line 1.
    #[error("left out line {line}, which has no line end")]
    PartialLastLine { line: u64 },
    /// The text was in this encoding, not in UTF-8.
    ///
    /// - `encoding`: name of the encoding.
    #[error("the text is {encoding}, not UTF-8")]
    Decoded { encoding: &'static str },
    /// Lines of comments between the rows were left out.
    ///
    /// - `count`: number of such lines.
    #[error("left out {count} lines of comments")]
    Comments { count: usize },
    /// The line of names appears again between the rows.
    ///
    /// - `count`: number of repetitions.
    #[error("left out {count} lines that repeat the names of the columns")]
    RepeatedHeader { count: usize },
    /// Rows with another number of cells than the line of names were left out.
    ///
    /// - `count`: number of such rows.
    /// - `line`: line of the first.
    #[error("left out {count} rows with a wrong number of cells, the first in line {line}")]
    RaggedRows { count: usize, line: u64 },
    /// A row or line contains names and values; they were made columns.
    ///
    /// - `from`: the form in words.
    #[error("{from} made columns")]
    Pivoted { from: &'static str },
    /// Files of one flight were joined on their clock.
    ///
    /// - `files`: their names.
    #[error("joined on their clock: {}", .files.join(", "))]
    Joined { files: Vec<String> },
    /// Columns that several of the joined files have; those of the first file were read.
    ///
    /// - `columns`: their names.
    #[error("in several of the files, read from the first: {}", .columns.join(", "))]
    ColumnsTwice { columns: Vec<String> },
    /// The counter of the time stamps wrapped and was made continuous.
    ///
    /// - `column`: name of the time column.
    /// - `wraps`: number of wraps.
    #[error("{column} wraps {wraps} times, made continuous")]
    ClockWraps { column: String, wraps: usize },
    /// The clock begins anew in the file: it contains several flights, of which one was read.
    ///
    /// - `count`: number of flights.
    /// - `read`: number of the one that was read, from 1.
    #[error("{}", flights(*.count, *.read))]
    Flights { count: usize, read: usize },
    /// Columns that the format does not know.
    ///
    /// - `columns`: their names, in the order of the file.
    #[error("ignored columns {}", .columns.join(", "))]
    IgnoredColumns { columns: Vec<String> },
    /// `t_s` counts from this time of the file's own clock.
    ///
    /// - `start_s`: time of the first row on that clock.
    #[error("time counts from {start_s} s of the file's clock")]
    TimeShifted { start_s: f64 },
    /// Steps of the time column longer than 1.5 of the usual step.
    ///
    /// - `count`: number of such steps.
    /// - `usual_s`: median step.
    /// - `longest_s`: longest step.
    #[error("{count} gaps in time, the longest {longest_s:.3} s where {usual_s:.3} s is usual")]
    TimeGaps { count: usize, usual_s: f64, longest_s: f64 },
    /// Rows after the last radio packet of `channels` are extrapolation and were cut.
    ///
    /// - `channels`: group of columns, in words.
    /// - `kept_s`: time of the last row that was kept.
    /// - `cut_s`: duration of the part that was cut.
    #[error("cut {cut_s:.2} s after the last radio packet of {channels}, kept {kept_s:.2} s")]
    CutAfterLastPacket { channels: &'static str, kept_s: f64, cut_s: f64 },
    /// `channels` brought no packets in flight: absent from the log.
    ///
    /// - `channels`: group of columns, in words.
    #[error("{channels}: no packets in flight, left out")]
    DeadChannels { channels: &'static str },
    /// The battery voltage after its last packet is that packet's value, repeated.
    ///
    /// - `from_s`: time of the last packet.
    #[error("battery voltage held from {from_s:.2} s, its last packet")]
    BatteryHeld { from_s: f64 },
    /// Stretches in flight where `channels` are interpolated over lost packets (0.1 s or longer).
    ///
    /// - `channels`: group of columns, in words.
    /// - `count`: number of stretches.
    /// - `longest_s`: longest stretch.
    #[error("{channels}: {count} gaps filled by interpolation in flight, the longest {longest_s:.2} s")]
    RadioGaps { channels: &'static str, count: usize, longest_s: f64 },
    /// Signs turned to the right-handed frame.
    ///
    /// - `columns`: names of the columns in the file.
    #[error("negated {}", .columns.join(", "))]
    Negated { columns: &'static [&'static str] },
    /// Columns that differ from their name or description: `unit` is the one in which they were read.
    ///
    /// - `columns`: names of the columns in the file.
    /// - `unit`: quantity or unit, in words.
    #[error("{columns} read as {unit}")]
    ReadAs { columns: &'static str, unit: &'static str },
    /// A column that the firmware does not write was taken for a position from outside, by its name, in metres.
    ///
    /// - `column`: name of the column.
    #[error("{column} taken for the position from outside, in m")]
    OutsideColumn { column: String },
    /// A channel was multiplied by the mapping file's factor.
    ///
    /// - `channel`: name of the channel.
    /// - `factor`: its factor.
    #[error("{channel} times {factor}, as the mapping file says")]
    Scaled { channel: &'static str, factor: f64 },
    /// A column is in another unit than usual, given in the file.
    ///
    /// - `column`: name of the column.
    /// - `unit`: unit as in a mapping file, such as `rad`.
    #[error("{column} is in {unit}, as the file says")]
    ReadInUnit { column: String, unit: &'static str },
    /// Onboard gyro against motion-capture rates: positive when the onboard data appears later. Median,
    /// lowest and highest of the thirds of the flight. Nothing was shifted.
    ///
    /// - `median_s`: median of the thirds.
    /// - `lowest_s`: lowest of the thirds.
    /// - `highest_s`: highest of the thirds.
    #[error("onboard data appears {:.0} ms later than motion capture ({:.0} to {:.0} ms over the flight)", .median_s * 1e3, .lowest_s * 1e3, .highest_s * 1e3)]
    ClockSkew { median_s: f64, lowest_s: f64, highest_s: f64 },
    /// The onboard and motion-capture clocks could not be compared: the flight excites the rates too little.
    #[error("too little motion to compare the onboard clock")]
    ClockSkewUnknown,
    /// Median of onboard yaw minus motion-capture yaw in flight.
    ///
    /// - `median_rad`: median over the flight, positive where the onboard yaw is larger.
    #[error("onboard yaw is {:.2} degrees above motion capture", .median_rad.to_degrees())]
    YawOffset { median_rad: f64 },
    /// The format logs no yaw-rate command and none can be derived from what it logs.
    #[error("no yaw-rate command in the log")]
    NoYawRateCommand,
    /// A wrapped angle was made continuous.
    ///
    /// - `channel`: name of the angle, in words.
    /// - `jumps`: number of wraps.
    #[error("{channel} made continuous over {jumps} wraps")]
    Unwrapped { channel: &'static str, jumps: usize },
    /// Camera fixes whose capture time is not later than the one before. They are kept in order of arrival.
    ///
    /// - `count`: number of such fixes.
    #[error("{count} camera fixes not later than the one before")]
    CaptureOutOfOrder { count: usize },
    /// Camera fixes stamped later than the row in which they arrived.
    ///
    /// - `count`: number of such fixes.
    #[error("{count} camera fixes stamped later than they arrived")]
    CaptureInFuture { count: usize },
    /// The camera's clock, by which capture times were stamped, ran at another rate than the log's: corrected.
    ///
    /// - `fast_ppm`: its rate beyond the log's, in millionths.
    #[error("the camera's clock runs {:.2} % {}: capture times brought to the log's clock", .fast_ppm.abs() / 1e4, if *.fast_ppm > 0.0 { "fast" } else { "slow" })]
    CaptureDrift { fast_ppm: f64 },
    /// The file has no position at all, so it is unknown when the vehicle flew.
    #[error("no position measurement: airborne interval unknown")]
    NoPosition,
    /// The vehicle never rose above this height.
    ///
    /// - `above_m`: height that counts as flight, on the scale of the log's position.
    #[error("never above {above_m} m")]
    NeverAirborne { above_m: f64 },
    /// The file ends or is damaged at this byte; the `kept` records or messages before it were used.
    ///
    /// - `byte`: offset from the start of the file's content.
    /// - `kept`: number of records or messages used.
    /// - `unit`: word for what is counted: `records` or `messages`.
    /// - `reason`: the problem at that place.
    #[error("reading ended at byte {byte} ({reason}); used {kept} {unit}")]
    CutShort { byte: usize, kept: usize, unit: &'static str, reason: String },
    /// The database is damaged behind the messages that were used.
    ///
    /// - `kept`: number of messages used.
    /// - `reason`: the database's own message.
    #[error("the database is damaged ({reason}); used {kept} messages")]
    DamagedDatabase { kept: usize, reason: String },
    /// The check sum at the end of the file is not that of its content.
    #[error("the check sum does not match: the file is damaged or cut")]
    WrongChecksum,
    /// Rows or messages of `name` with values that are not finite, or that cannot be decoded, were left out.
    ///
    /// - `name`: name of the topic, event or quantity.
    /// - `count`: number of rows or messages left out.
    #[error("{name}: left out {count} records that cannot be read or are not finite")]
    OddValues { name: String, count: usize },
    /// Time stamps of `name` that are not later than the one before; put in order, repeated ones left out.
    ///
    /// - `name`: name of the topic, event or channel.
    /// - `count`: number of such stamps.
    #[error("{name}: {count} time stamps not later than the one before")]
    StampsOutOfOrder { name: String, count: usize },
    /// No messages of the topic that the thesis's rig calls so.
    ///
    /// - `topic`: usual name of the topic, without namespace.
    #[error("no {topic} (whatever its namespace)")]
    TopicMissing { topic: &'static str },
    /// Topics of which a flight needs nothing.
    ///
    /// - `topics`: their names, with the type of the message where no flight needs it.
    #[error("ignored topics {}", .topics.join(", "))]
    IgnoredTopics { topics: Vec<String> },
    /// Messages without time stamps: times of record were used.
    ///
    /// - `topic`: name of the topic.
    #[error("{topic}: no time stamps, times of record used")]
    NoStamps { topic: String },
    /// The stamps' clock against the recorder's. If it is another (`!same`), `offset_s` was added; the drift
    /// never is.
    ///
    /// - `topic`: name of the topic.
    /// - `same`: true if the stamps are of the recorder's clock.
    /// - `offset_s`: time added to each stamp; 0 on the same clock.
    /// - `transport_s`: median time from stamp to record, less the offset.
    /// - `spread_s`: spread of that time, from its 5 % to its 95 % quantile.
    /// - `drift_ppm`: rate at which the clocks part, in millionths; `None` for a short recording.
    #[error("{topic}: {}; recorded {:.1} ms later (spread {:.1} ms){}", clock(*.same, *.offset_s), .transport_s * 1e3, .spread_s * 1e3, drift(*.drift_ppm))]
    TopicClock {
        topic: String,
        same: bool,
        offset_s: f64,
        transport_s: f64,
        spread_s: f64,
        drift_ppm: Option<f64>,
    },
    /// Stamps more than a second from their times of record, which were used instead.
    ///
    /// - `topic`: name of the topic.
    /// - `count`: number of such stamps.
    #[error("{topic}: {count} stray time stamps, times of record used")]
    StrayStamps { topic: String, count: usize },
    /// Messages that the topic's usual rate lacks.
    ///
    /// - `topic`: name of the topic.
    /// - `count`: number of messages.
    /// - `longest_s`: longest time between two messages.
    #[error("{topic}: {count} messages lost, the longest gap {longest_s:.3} s")]
    LostMessages { topic: String, count: usize, longest_s: f64 },
    /// The camera against the IMU, by the motion that both measured: positive when the camera's data is later than
    /// its stamps. `shifted`: the capture times were corrected by it, since their stamps are unusable.
    ///
    /// - `lag_s`: delay of the camera's data.
    /// - `sigma_s`: standard error of the delay, from the scatter between parts of the flight.
    /// - `correlation`: correlation of the two motions at this delay, at most 1.
    /// - `by`: motion that was compared, in words.
    /// - `shifted`: true if the capture times were corrected.
    #[error("camera {:.0} +- {:.0} ms later than the IMU by {by} (correlation {correlation:.2}), {}", .lag_s * 1e3, .sigma_s * 1e3, if *.shifted { "capture times corrected" } else { "not corrected" })]
    CameraLag { lag_s: f64, sigma_s: f64, correlation: f64, by: &'static str, shifted: bool },
    /// Camera and IMU could not be compared: the flight moves too little or is too short.
    #[error("too little motion to compare the camera's clock with the IMU's")]
    CameraLagUnknown,
    /// Marker poses in the frame of a camera that looks down were turned into the vehicle's over the marker.
    #[error("marker poses are in the camera's frame: turned into the vehicle's over the marker")]
    SeenFromCamera,
    /// Added to the integrated yaw so that it starts at the marker's.
    ///
    /// - `offset_rad`: angle added, positive counter-clockwise.
    #[error("yaw turned by {:.2} degrees to the marker's", .offset_rad.to_degrees())]
    YawFromMarker { offset_rad: f64 },
    /// Roll, pitch and yaw are the integrated gyro, less this bias, measured before take-off or (`!at_rest`) the mean
    /// of roll and pitch rates over the file; `None`: the file's rates have none, and the integration restarts
    /// whenever the vehicle is at rest.
    ///
    /// - `bias_radps`: bias about the body's x, y and z axes.
    /// - `at_rest`: true if the bias was measured while the vehicle was at rest.
    #[error("attitude integrated from the gyro, {}", bias(*.bias_radps, *.at_rest))]
    AttitudeIntegrated { bias_radps: Option<[f64; 3]>, at_rest: bool },
    /// There is no IMU: roll, pitch and yaw are the marker's, interpolated.
    #[error("no IMU: attitude of the marker, interpolated")]
    AttitudeFromMarker,
    /// Angles derived from the direction of the acceleration; yaw taken as zero where it is not logged.
    ///
    /// - `roll`: true if roll is derived.
    /// - `pitch`: true if pitch is derived.
    /// - `yaw_taken_as_zero`: true if the log lacks yaw.
    #[error("{}", derived(*.roll, *.pitch, *.yaw_taken_as_zero))]
    TiltFromAcceleration { roll: bool, pitch: bool, yaw_taken_as_zero: bool },
    /// Nothing outside the vehicle measured its position: the fixes are its own estimate.
    #[error("no outside measurement: position is the vehicle's own estimate")]
    PositionEstimated,
    /// The thrust command is the mean of the motors' requests.
    #[error("thrust command: mean of the four motors' requests")]
    ThrustFromMotors,
    /// Channels on clocks of their own were brought to the rows: commands repeated, measurements interpolated.
    ///
    /// - `channels`: names of the channels.
    #[error("brought to the clock of the rows: {}", .channels.join(", "))]
    Resampled { channels: Vec<String> },
    /// The unit of a time column, which follows from its steps.
    ///
    /// - `column`: name of the column.
    /// - `unit`: unit as in a mapping file, such as `ms`.
    #[error("{column} read as {unit}")]
    TimeUnit { column: String, unit: &'static str },
    /// Positions that repeat the one before were taken for rows without a fix.
    ///
    /// - `share`: share of the positions left out, 0 to 1.
    #[error("{:.0} % of the positions repeat the one before: no fix arrived there", .share * 100.0)]
    RepeatedPositions { share: f64 },
    /// A command in another unit was turned into 16-bit PWM.
    ///
    /// - `channel`: name of the command.
    /// - `unit`: unit in the file.
    #[error("{channel}: {unit} scaled to PWM, 65535 being all")]
    ScaledToPwm { channel: String, unit: String },
    /// Numbers are written with a decimal comma.
    #[error("numbers have a decimal comma")]
    DecimalCommas,
    /// In this share of the rows the vehicle feels gravity from below: it lies on its back.
    ///
    /// - `share`: share of all rows, 0 to 1.
    #[error("on its back for {:.0} % of the time: a crash", .share * 100.0)]
    UpsideDown { share: f64 },
}

impl Note {
    /// The reading ended at a byte, with so many records or messages.
    pub(crate) fn cut_short(byte: usize, kept: usize, unit: &'static str, reason: &str) -> Self {
        Self::CutShort { byte, kept, unit, reason: reason.to_owned() }
    }
}

/// The number of flights in a file, and which of them was read.
fn flights(count: usize, read: usize) -> String {
    let all = if count == 2 { "two flights".to_owned() } else { format!("{count} flights") };
    let (which, other) = if read == 1 { ("the first".to_owned(), 2) } else { (format!("part {read}"), 1) };
    format!("{all}: the clock begins anew; {which} is read (--part {other} reads another)")
}

/// The clock of a topic's stamps.
fn clock(same: bool, offset_s: f64) -> String {
    if same {
        "stamps on the recorder's clock".into()
    } else {
        format!("stamps on another clock, {offset_s:.3} s added")
    }
}

fn drift(ppm: Option<f64>) -> String {
    ppm.map_or(String::new(), |ppm| format!(", drift {ppm:.0} ppm"))
}

/// The bias that an integration left out, or its restarts.
fn bias(bias_radps: Option<[f64; 3]>, at_rest: bool) -> String {
    let Some(bias_radps) = bias_radps else { return "from every standstill on".into() };
    let [x, y, z] = bias_radps.map(f64::to_degrees);
    let how = if at_rest { "at rest" } else { "on average: no standstill to tell it better" };
    format!("less its bias of {x:.3}, {y:.3}, {z:.3} degrees per second {how}")
}

/// The angles that were derived from the acceleration.
fn derived(roll: bool, pitch: bool, yaw_taken_as_zero: bool) -> String {
    let named = [(roll, "roll"), (pitch, "pitch")].into_iter().filter(|(is, _)| *is).map(|(_, name)| name);
    let named: Vec<&str> = named.collect();
    let derived = (!named.is_empty())
        .then(|| format!("not logged, derived from the acceleration: {}", named.join(", ")));
    let yaw = yaw_taken_as_zero.then(|| "yaw is not logged, taken as 0".to_owned());
    derived.into_iter().chain(yaw).collect::<Vec<_>>().join("; ")
}
