//! ULog, the log format of PX4: definitions of messages, subscriptions, and data, little endian.
//!
//! Written down at <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>. PX4's world is NED (x north,
//! y east, z down), its body FRD: both are turned by half a turn about x.

use std::collections::HashMap;

use crate::attitude::Rotation;
use crate::bytes::Bytes;
use crate::channels::{Channels, Facts};
use crate::series::{Series, longest_times};
use crate::{Columns, Content, FlightLog, LogError, Note, PositionSource, Reader, Result};

const MAGIC: &[u8] = b"ULog\x01\x12\x35";
/// Magic, version and start time.
const HEADER_BYTES: usize = 16;
/// Formats nest three deep at most; a damaged one may name itself.
const DEEPEST: usize = 8;
/// PX4's largest message has a few hundred fields.
const MOST_FIELDS: usize = 4096;
/// Beyond this no field of a flight makes sense.
const LARGEST: f64 = 1e12;
/// Incompatible flag bits that are understood: data appended at the end, which contains no flight.
const KNOWN_INCOMPATIBLE: u8 = 1;

pub(crate) static READER: Reader =
    Reader { name: "ulog", title: "a ULog of PX4", magic: MAGIC, read, columns, ..Reader::TEXT };

fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    let recording = Recording::read(content.file, content.bytes, Vec::new(), &mut notes)?;
    let outside =
        OUTSIDE.iter().find(|fields| each(fields).next().is_some_and(|first| recording.has(&first)));
    let position = if outside.is_some() { PositionSource::MotionCapture } else { PositionSource::Estimate };
    let mut series = recording.channels(outside.copied().unwrap_or(ESTIMATE), &mut notes);
    if outside.is_none() {
        notes.push(Note::PositionEstimated);
    }
    let start_s = series.iter().filter_map(|s| s.t_s.first().copied()).fold(f64::INFINITY, f64::min);
    if !start_s.is_finite() {
        let missing = "topics of a flight (vehicle_local_position, vehicle_attitude)";
        let (file, found) = (content.file.to_owned(), recording.names());
        return Err(LogError::MissingSignals { file, missing, found });
    }
    notes.push(Note::TimeShifted { start_s });
    series.iter_mut().flat_map(|s| &mut s.t_s).for_each(|t| *t -= start_s);
    let longest = longest_times(&series);
    let facts = Facts { position: Some(position), ..Facts::default() };
    Ok(Channels::new(series, || longest).flight(READER.name, &facts, notes))
}

fn columns(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>> {
    let wanted = content.mapping.map(|(_, mapping)| mapping.columns()).unwrap_or_default();
    let topics = wanted.iter().filter_map(|column| Some(column.split_once('.')?.0.to_owned())).collect();
    let recording = Recording::read(content.file, content.bytes, topics, notes)?;
    Ok(Some(Columns(recording.columns(notes))))
}

/// Fields of a topic and the channels of a mapping file that they are, with spaces between, and the factors.
type Fields = (&'static str, &'static str, &'static str, &'static [f64]);

/// One of the fields.
#[derive(Debug, Clone, Copy)]
struct Field {
    topic: &'static str,
    field: &'static str,
    channel: &'static str,
    factor: f64,
}

fn each(&(topic, fields, channels, factors): &Fields) -> impl Iterator<Item = Field> {
    let named = fields.split(' ').zip(channels.split(' ')).zip(factors);
    named.map(move |((field, channel), factor)| Field { topic, field, channel, factor: *factor })
}

/// From NED and FRD to z-up.
const TURNED: &[f64] = &[1.0, -1.0, -1.0];
/// Thrust and motors are shares.
const PWM: &[f64] = &[65_535.0; 4];

/// Positions that a system outside sent, the best first.
const OUTSIDE: [Fields; 3] = [
    ("vehicle_mocap_odometry", "position[0] position[1] position[2]", "x y z", TURNED),
    ("vehicle_visual_odometry", "position[0] position[1] position[2]", "x y z", TURNED),
    ("vehicle_mocap_odometry", "x y z", "x y z", TURNED),
];
const ESTIMATE: Fields = ("vehicle_local_position", "x y z", "x y z", TURNED);

/// All other channels; of several fields for one channel the first that is logged counts. Yaw-rate commands are
/// clockwise from above in both.
const FIELDS: [Fields; 12] = [
    ("vehicle_local_position", "x y z", "estimate_x estimate_y estimate_z", TURNED),
    ("vehicle_local_position", "vx vy vz", "estimate_vx estimate_vy estimate_vz", TURNED),
    ("vehicle_attitude", "q[0] q[1] q[2] q[3]", "qw qx qy qz", &[1.0, 1.0, -1.0, -1.0]),
    ("vehicle_angular_velocity", "xyz[0] xyz[1] xyz[2]", "gyro_x gyro_y gyro_z", TURNED),
    ("sensor_combined", "gyro_rad[0] gyro_rad[1] gyro_rad[2]", "gyro_x gyro_y gyro_z", TURNED),
    ("vehicle_acceleration", "xyz[0] xyz[1] xyz[2]", "acc_x acc_y acc_z", TURNED),
    (
        "sensor_combined",
        "accelerometer_m_s2[0] accelerometer_m_s2[1] accelerometer_m_s2[2]",
        "acc_x acc_y acc_z",
        TURNED,
    ),
    (
        "vehicle_attitude_setpoint",
        "roll_body pitch_body yaw_sp_move_rate thrust_body[2] thrust",
        "cmd_roll cmd_pitch cmd_yaw_rate cmd_thrust cmd_thrust",
        &[1.0, -1.0, 1.0, -65_535.0, 65_535.0],
    ),
    ("vehicle_local_position_setpoint", "x y z", "setpoint_x setpoint_y setpoint_z", TURNED),
    ("vehicle_local_position_setpoint", "yaw", "setpoint_yaw", &[-1.0]),
    (
        "actuator_motors",
        "control[0] control[1] control[2] control[3]",
        "motor_1 motor_2 motor_3 motor_4",
        PWM,
    ),
    ("battery_status", "voltage_v", "vbat", &[1.0]),
];

/// The set-point of newer versions, a quaternion.
const WANTED_ROTATION: [&str; 4] = ["q_d[1]", "q_d[2]", "q_d[3]", "q_d[0]"];

/// Number types of the format, their letters in Python's `struct`, and their sizes.
const TYPES: [&str; 12] = [
    "int8_t", "uint8_t", "bool", "char", "int16_t", "uint16_t", "int32_t", "uint32_t", "int64_t", "uint64_t",
    "float", "double",
];
const LETTERS: &[u8; 12] = b"bBBBhHiIqQfd";
const SIZES: [usize; 12] = [1, 1, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8];

/// A field's place in the data of its message.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Slot {
    path: String,
    letter: u8,
    at: usize,
}

/// The data of one topic.
#[derive(Debug, Default)]
struct Topic {
    name: String,
    slots: Vec<Slot>,
    t_s: Vec<f64>,
    /// The slots' values, one row per message.
    rows: Vec<Vec<f64>>,
}

impl Topic {
    /// The place of a field in the rows.
    fn place(&self, field: &str) -> Option<usize> {
        self.slots.iter().position(|slot| slot.path == field)
    }
}

/// All topics of a file that a flight may need.
struct Recording {
    topics: Vec<Topic>,
    unread: Vec<String>,
    /// Topics that a mapping names.
    wanted: Vec<String>,
}

impl Recording {
    /// Reads the topics that a flight needs, and those that are `wanted` besides.
    fn read(file: &str, data: &[u8], wanted: Vec<String>, notes: &mut Vec<Note>) -> Result<Self> {
        let mut bytes = Bytes::new(data);
        let bad = |byte, expected| LogError::BadBinary { file: file.to_owned(), byte, expected };
        bytes.take(HEADER_BYTES).ok_or_else(|| bad(0, "the 16 bytes of a ULog header"))?;
        let mut formats: HashMap<String, String> = HashMap::new();
        let mut by_id: HashMap<u16, usize> = HashMap::new();
        let mut recording = Self { topics: Vec::new(), unread: Vec::new(), wanted };
        let mut kept = 0;
        while bytes.remaining() > 0 {
            let start = bytes.position();
            let Some((kind, body)) = message(&mut bytes) else {
                notes.push(Note::cut_short(start, kept, "messages", "the last message is not whole"));
                break;
            };
            let taken = match kind {
                b'B' if body.get(8).is_none_or(|flags| flags & !KNOWN_INCOMPATIBLE != 0) => {
                    return Err(bad(start, "flag bits of a known version of ULog"));
                }
                b'F' => define(&mut formats, body),
                b'A' => recording.subscribe(&formats, &mut by_id, body),
                b'D' => recording.take(&by_id, body).inspect(|()| kept += 1),
                _ => Some(()),
            };
            if taken.is_none() {
                notes.push(Note::cut_short(start, kept, "messages", "a message is damaged"));
                break;
            }
        }
        Ok(recording)
    }

    /// Takes a subscription: a topic, if a flight needs it; only its first instance counts.
    fn subscribe(
        &mut self,
        formats: &HashMap<String, String>,
        by_id: &mut HashMap<u16, usize>,
        body: &[u8],
    ) -> Option<()> {
        let mut bytes = Bytes::new(body);
        let (instance, id) = (bytes.u8()?, bytes.u16()?);
        let name = std::str::from_utf8(bytes.rest()).ok()?;
        if instance > 0 || !(is_needed(name) || self.wanted.iter().any(|wanted| wanted == name)) {
            if self.unread.len() < 100 && !self.unread.iter().any(|known| known == name) {
                self.unread.push(name.to_owned());
            }
            return Some(());
        }
        let mut layout = Layout { formats, slots: Vec::new(), at: 0 };
        layout.expand(name, "", 0)?;
        if layout.slots.first().is_none_or(|slot| slot.path != "timestamp") {
            return None;
        }
        let known = self.topics.iter().position(|topic| topic.name == name);
        let index = known.unwrap_or_else(|| {
            self.topics.push(Topic { name: name.to_owned(), slots: layout.slots, ..Topic::default() });
            self.topics.len() - 1
        });
        by_id.insert(id, index);
        Some(())
    }

    /// Takes the data of a message.
    fn take(&mut self, by_id: &HashMap<u16, usize>, body: &[u8]) -> Option<()> {
        let mut bytes = Bytes::new(body);
        let id = bytes.u16()?;
        let Some(topic) = by_id.get(&id).and_then(|at| self.topics.get_mut(*at)) else { return Some(()) };
        let data = bytes.rest();
        let read = |slot: &Slot| Bytes::new(data.get(slot.at..)?).number(slot.letter);
        // Padding at the end of a message is not written.
        let values: Vec<f64> = topic.slots.iter().map(|slot| read(slot).unwrap_or(f64::NAN)).collect();
        topic.t_s.push(values[0] * 1e-6);
        topic.rows.push(values);
        Some(())
    }

    /// Every field as a column, named by topic and field.
    fn columns(&self, notes: &mut Vec<Note>) -> Vec<Series> {
        let fields = self
            .topics
            .iter()
            .flat_map(|topic| topic.slots.iter().enumerate().map(move |slot| (topic, slot)));
        let column = |(topic, (at, slot)): (&Topic, (usize, &Slot))| Series {
            name: format!("{}.{}", topic.name, slot.path),
            t_s: topic.t_s.clone(),
            values: topic.rows.iter().map(|row| row[at]).collect(),
        };
        let finite = fields.map(column).map(|series| series.finite(notes));
        finite.filter(|series| !series.t_s.is_empty()).collect()
    }

    fn topic(&self, name: &str) -> Option<&Topic> {
        self.topics.iter().find(|topic| topic.name == name && !topic.t_s.is_empty())
    }

    fn has(&self, field: &Field) -> bool {
        self.topic(field.topic).is_some_and(|topic| topic.place(field.field).is_some())
    }

    fn names(&self) -> String {
        let read = self.topics.iter().map(|topic| topic.name.clone());
        read.chain(self.unread.iter().cloned()).collect::<Vec<_>>().join(", ").chars().take(300).collect()
    }

    /// The channels of a flight, each with its times.
    fn channels(&self, position: Fields, notes: &mut Vec<Note>) -> Vec<Series> {
        let mut all: Vec<Series> = Vec::new();
        for field in std::iter::once(&position).chain(&FIELDS).flat_map(each) {
            let known = all.iter().any(|series| series.name == field.channel);
            if let Some(series) = (!known).then(|| self.series(&field, notes)).flatten() {
                all.push(series);
            }
        }
        if !all.iter().any(|series| series.name == "cmd_roll") {
            all.extend(self.wanted_tilt(notes).into_iter().flatten());
        }
        let shares: Vec<&Series> =
            all.iter().filter(|s| s.name == "cmd_thrust" || s.name.starts_with("motor")).collect();
        for series in shares {
            notes.push(Note::ScaledToPwm { channel: series.name.clone(), unit: "fraction".to_owned() });
        }
        all
    }

    /// The finite values of a field; set-points that are not in force are NaN.
    fn series(&self, field: &Field, notes: &mut Vec<Note>) -> Option<Series> {
        let topic = self.topic(field.topic)?;
        let at = topic.place(field.field)?;
        let is_pwm = field.factor.abs() == 65_535.0;
        let limited = |value: f64| if is_pwm { value.clamp(0.0, 65_535.0) } else { value };
        let values = topic.t_s.iter().zip(&topic.rows).map(|(t, row)| (*t, limited(row[at] * field.factor)));
        let (t_s, values) = values.filter(|(t, value)| value.abs() <= LARGEST && t.abs() <= LARGEST).unzip();
        let series = Series { name: field.channel.to_owned(), t_s, values }.in_order(notes);
        (!series.t_s.is_empty()).then_some(series)
    }

    /// Roll and pitch commands out of the set-point's quaternion.
    fn wanted_tilt(&self, notes: &mut Vec<Note>) -> Option<[Series; 2]> {
        let topic = self.topic("vehicle_attitude_setpoint")?;
        let [x, y, z, w] = WANTED_ROTATION.map(|field| topic.place(field));
        let (x, y, z, w) = (x?, y?, z?, w?);
        let rotations = topic.t_s.iter().zip(&topic.rows).filter_map(|(t_s, row)| {
            Some((*t_s, Rotation::from_xyzw([row[x], -row[y], -row[z], row[w]])?.angles()))
        });
        let (t_s, angles): (Vec<f64>, Vec<[f64; 3]>) = rotations.unzip();
        let commands = [("cmd_roll", 0), ("cmd_pitch", 1)].map(|(name, axis)| {
            let values = angles.iter().map(|angles| angles[axis]).collect();
            Series { name: name.to_owned(), t_s: t_s.clone(), values }.in_order(notes)
        });
        (!t_s.is_empty()).then_some(commands)
    }
}

/// Type and body of a message; `None` if it is not whole.
fn message<'a>(bytes: &mut Bytes<'a>) -> Option<(u8, &'a [u8])> {
    let (length, kind) = (bytes.u16()?, bytes.u8()?);
    Some((kind, bytes.take(usize::from(length))?))
}

/// Takes a definition, `name:type field;type field;`.
fn define(formats: &mut HashMap<String, String>, body: &[u8]) -> Option<()> {
    let (name, fields) = std::str::from_utf8(body).ok()?.split_once(':')?;
    formats.insert(name.to_owned(), fields.to_owned());
    Some(())
}

fn is_needed(topic: &str) -> bool {
    FIELDS.iter().chain(&OUTSIDE).chain([&ESTIMATE]).any(|(known, ..)| *known == topic)
}

/// The fields of a format while they are laid out.
struct Layout<'a> {
    formats: &'a HashMap<String, String>,
    slots: Vec<Slot>,
    at: usize,
}

impl Layout<'_> {
    /// Adds the fields of a format behind those that are there; `None` for what is no format.
    fn expand(&mut self, format: &str, prefix: &str, depth: usize) -> Option<()> {
        if depth > DEEPEST {
            return None;
        }
        let fields = self.formats.get(format)?;
        for field in fields.split(';').filter(|field| !field.is_empty()) {
            let (type_name, name) = field.split_once(' ')?;
            let (type_name, count) = match type_name.split_once('[') {
                Some((of, count)) => (of, Some(count.strip_suffix(']')?.parse::<usize>().ok()?)),
                None => (type_name, None),
            };
            for i in 0..count.unwrap_or(1) {
                let index = count.map_or(String::new(), |_| format!("[{i}]"));
                let path = format!("{prefix}{name}{index}");
                match TYPES.iter().position(|known| *known == type_name) {
                    Some(of) => {
                        self.slots.push(Slot { path, letter: LETTERS[of], at: self.at });
                        self.at += SIZES[of];
                    }
                    None => self.expand(type_name, &format!("{path}."), depth + 1)?,
                }
                if self.slots.len() > MOST_FIELDS {
                    return None;
                }
            }
        }
        Some(())
    }
}
