//! A made-up flight as ROS messages, and a writer of bags.
#![allow(dead_code)] // each test file uses its own part

use std::io::Write;

/// A message as a recorder stores it.
#[derive(Clone)]
pub struct StoredMessage {
    pub topic: &'static str,
    pub kind: &'static str,
    pub recorded_ns: u64,
    pub data: Vec<u8>,
}

/// Parameters of a made-up recording.
#[derive(Clone, Copy)]
pub struct Rig {
    pub seconds: f64,
    /// Stamps of the IMU count from the vehicle's boot.
    pub imu_since_boot: bool,
    /// The camera's driver fills stamps.
    pub camera_stamps: bool,
    pub camera_delay_s: f64,
    /// Poses are the marker's in the camera's frame.
    pub from_camera: bool,
}

pub const RIG: Rig = Rig {
    seconds: 40.0,
    imu_since_boot: false,
    camera_stamps: true,
    camera_delay_s: 0.05,
    from_camera: false,
};
pub const START_NS: u64 = 1_500_000_000_000_000_000;
const BOOT_NS: u64 = 7_000_000_000;
const G: f64 = 9.81;

pub fn pitch_rad(t: f64) -> f64 {
    if t < 2.0 { 0.0 } else { 0.06 * (1.3 * (t - 2.0)).sin() }
}

pub fn x_m(t: f64) -> f64 {
    // twice the integral of g tan(pitch), near enough
    if t < 2.0 { 0.0 } else { G * 0.06 * ((t - 2.0) / 1.3 - (1.3 * (t - 2.0)).sin() / 1.69) }
}

pub fn height_m(t: f64) -> f64 {
    (0.5 * (t - 2.0)).clamp(0.02, 0.7)
}

fn ns(t: f64) -> u64 {
    START_NS.wrapping_add_signed((t * 1e9).round() as i64)
}

fn header(stamp_ns: u64) -> Vec<u8> {
    let mut bytes = 0_u32.to_le_bytes().to_vec();
    bytes.extend(((stamp_ns / 1_000_000_000) as u32).to_le_bytes());
    bytes.extend(((stamp_ns % 1_000_000_000) as u32).to_le_bytes());
    bytes.extend(4_u32.to_le_bytes());
    bytes.extend(b"base");
    bytes
}

fn numbers(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The flight: 2 s on the ground, then up to 0.7 m and back and forth along x.
pub fn messages(rig: Rig) -> Vec<StoredMessage> {
    let mut all = Vec::new();
    for i in 0..(rig.seconds * 100.0) as usize {
        let t = i as f64 * 0.01;
        let stamp = if rig.imu_since_boot { ns(t) - START_NS + BOOT_NS } else { ns(t) };
        let rate = (pitch_rad(t + 1e-4) - pitch_rad(t - 1e-4)) / 2e-4;
        let mut values = vec![0.0; 37];
        values[4] = -1.0;
        // a gyro with a bias
        values[13..16].copy_from_slice(&[0.01, rate - 0.02, 0.0]);
        values[25..28].copy_from_slice(&[0.0, 0.0, G]);
        let data = [header(stamp), numbers(&values)].concat();
        all.push(StoredMessage {
            topic: "/cf1/crazyflie/imu",
            kind: "sensor_msgs/Imu",
            recorded_ns: ns(t + 0.003),
            data,
        });
    }
    for i in 0..(rig.seconds * 50.0) as usize {
        let t = i as f64 * 0.02;
        let thrust = if t < 2.0 { 0.0 } else { 38_000.0 };
        let data = numbers(&[pitch_rad(t).to_degrees(), -1.5, thrust, 0.0, 0.0, 12.0]);
        all.push(StoredMessage {
            topic: "/cf1/crazyflie/cmd_vel",
            kind: "geometry_msgs/Twist",
            recorded_ns: ns(t),
            data,
        });
    }
    for i in 0..(rig.seconds * 30.0) as usize {
        let t = i as f64 / 30.0;
        let (x, z, half) = (x_m(t), height_m(t), 0.5 * pitch_rad(t));
        let pose = if rig.from_camera {
            // seen from a camera turned half round x; tilt left out
            [-x, 0.0, z, 1.0, 0.0, 0.0, 0.0]
        } else {
            [x, 0.0, z, 0.0, half.sin(), 0.0, half.cos()]
        };
        let stamp = if rig.camera_stamps { ns(t) } else { 0 };
        let data = [header(stamp), numbers(&pose)].concat();
        all.push(StoredMessage {
            topic: "ar_single_board/pose",
            kind: "geometry_msgs/PoseStamped",
            recorded_ns: ns(t + rig.camera_delay_s),
            data,
        });
    }
    all.sort_by_key(|message| message.recorded_ns);
    let picture = StoredMessage {
        topic: "/camera/image",
        kind: "sensor_msgs/Image",
        recorded_ns: ns(1.0),
        data: vec![0; 64],
    };
    all.insert(100, picture);
    all
}

fn field(name: &str, value: &[u8]) -> Vec<u8> {
    [&((name.len() + 1 + value.len()) as u32).to_le_bytes()[..], name.as_bytes(), b"=", value].concat()
}

fn record(fields: &[Vec<u8>], data: &[u8]) -> Vec<u8> {
    let header = fields.concat();
    [&(header.len() as u32).to_le_bytes()[..], &header, &(data.len() as u32).to_le_bytes()[..], data].concat()
}

/// A bag of messages, 500 to a chunk, without index: as a recorder that was killed leaves it.
pub fn bag(messages: &[StoredMessage], compression: &str) -> Vec<u8> {
    let mut topics: Vec<(&str, &str)> = Vec::new();
    let start = [
        field("op", &[3]),
        field("index_pos", &[0; 8]),
        field("conn_count", &[0; 4]),
        field("chunk_count", &[0; 4]),
    ];
    let mut bytes = [&b"#ROSBAG V2.0\n"[..], &record(&start, &[b' '; 40])].concat();
    for chunk in messages.chunks(500) {
        let mut inner = Vec::new();
        for message in chunk {
            let known = topics.iter().position(|(topic, _)| *topic == message.topic);
            let id = known.unwrap_or(topics.len());
            let id_bytes = (id as u32).to_le_bytes();
            if known.is_none() {
                topics.push((message.topic, message.kind));
                let about = [
                    field("topic", message.topic.as_bytes()),
                    field("type", message.kind.as_bytes()),
                    field("md5sum", b"*"),
                ]
                .concat();
                inner.extend(record(
                    &[field("op", &[7]), field("conn", &id_bytes), field("topic", message.topic.as_bytes())],
                    &about,
                ));
            }
            let (s, ns) =
                ((message.recorded_ns / 1_000_000_000) as u32, (message.recorded_ns % 1_000_000_000) as u32);
            let time = [s.to_le_bytes(), ns.to_le_bytes()].concat();
            inner.extend(record(
                &[field("op", &[2]), field("conn", &id_bytes), field("time", &time)],
                &message.data,
            ));
        }
        let packed = pack(&inner, compression);
        let fields = [
            field("op", &[5]),
            field("compression", compression.as_bytes()),
            field("size", &(inner.len() as u32).to_le_bytes()),
        ];
        bytes.extend(record(&fields, &packed));
    }
    bytes
}

fn pack(data: &[u8], compression: &str) -> Vec<u8> {
    match compression {
        "lz4" => {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
            encoder.write_all(data).unwrap();
            encoder.finish().0
        }
        "bz2" => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
            encoder.write_all(data).unwrap();
            encoder.finish().unwrap()
        }
        _ => data.to_vec(),
    }
}

/// The same messages as MCAP.
pub fn mcap(messages: &[StoredMessage], encoding: &str) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    for message in messages {
        let schema = writer.add_schema(message.kind, "", b"").unwrap();
        let channel_id = writer.add_channel(schema, message.topic, encoding, &Default::default()).unwrap();
        let time = message.recorded_ns;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &message.data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}
