//! Messages of a recording by topic, and which topic plays which role in a flight.

use super::Note;
use super::message::{Encoding, Kind, decode};

/// A message as a recorder stored it.
#[derive(Debug, Clone, Copy)]
pub(super) struct StoredMessage<'a> {
    pub(super) recorded_ns: u64,
    pub(super) data: &'a [u8],
}

/// The messages of one topic, in the order of the file.
#[derive(Debug)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) recorded_ns: Vec<u64>,
    pub(super) stamp_ns: Vec<Option<u64>>,
    /// The numbers of each message that a flight needs: see [`flight_numbers`].
    pub(super) values: Vec<Vec<f64>>,
    /// Messages that could not be decoded.
    bad: usize,
}

/// The numbers of a message that a flight needs.
fn flight_numbers(kind: Kind, numbers: &[f64]) -> Vec<f64> {
    match kind {
        // linear x, y, z and angular z
        Kind::Twist | Kind::TwistStamped => vec![numbers[0], numbers[1], numbers[2], numbers[5]],
        // orientation, the first entry of its covariance (-1: not filled), rates, acceleration
        Kind::Imu => [&numbers[0..5], &numbers[13..16], &numbers[25..28]].concat(),
        Kind::PoseStamped | Kind::TransformStamped | Kind::Float32 => numbers.to_vec(),
        Kind::PoseWithCovarianceStamped | Kind::Odometry => numbers[..7].to_vec(),
    }
}

/// The role of a topic in a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TopicRole {
    Command,
    Imu,
    Pose,
    Goal,
    Battery,
}

impl TopicRole {
    /// How the thesis's rig calls the topic, without namespace.
    pub(super) fn usual_name(self) -> &'static str {
        match self {
            Self::Command => "crazyflie/cmd_vel",
            Self::Imu => "crazyflie/imu",
            Self::Pose => "ar_single_board/pose",
            Self::Goal => "crazyflie/goal",
            Self::Battery => "crazyflie/battery",
        }
    }

    /// How well a topic fits: 0 not at all, more is better. Goals and batteries have to be named so, since
    /// other topics have the same types; names may have any namespace in front.
    fn fit(self, topic: &Topic) -> usize {
        let name = topic.name.trim_matches('/');
        let last = name.rsplit('/').next().unwrap_or(name);
        let kinds: &[Kind] = match self {
            Self::Command => &[Kind::Twist, Kind::TwistStamped],
            Self::Imu => &[Kind::Imu],
            Self::Pose => {
                &[Kind::PoseStamped, Kind::TransformStamped, Kind::PoseWithCovarianceStamped, Kind::Odometry]
            }
            Self::Goal => &[Kind::PoseStamped],
            Self::Battery => &[Kind::Float32],
        };
        let usual = self.usual_name();
        let named = usual.rsplit('/').next() == Some(last);
        if !kinds.contains(&topic.kind)
            || (matches!(self, Self::Goal | Self::Battery) && !named)
            || (self == Self::Pose && last == "goal")
        {
            return 0;
        }
        1 + usize::from(named) + 2 * usize::from(name.ends_with(usual)) + 4 * usize::from(name == usual)
    }
}

/// All topics of a recording.
#[derive(Debug, Default)]
pub(super) struct Topics {
    list: Vec<Topic>,
    /// Topics of other types.
    unread: Vec<String>,
    messages: usize,
}

impl Topics {
    /// Adds a message; `read_as` is `None` for a type that no flight needs.
    pub(super) fn add(
        &mut self,
        name: &str,
        type_name: &str,
        message: StoredMessage<'_>,
        read_as: Option<(Kind, Encoding)>,
    ) {
        self.messages += 1;
        let Some((kind, encoding)) = read_as else {
            let shown = format!("{name} ({type_name})");
            // Damaged files could name a new one with every message.
            if self.unread.len() < 100 && !self.unread.contains(&shown) {
                self.unread.push(shown);
            }
            return;
        };
        let found = self.list.iter().position(|topic| topic.name == name && topic.kind == kind);
        let at = found.unwrap_or_else(|| {
            let name = name.to_owned();
            self.list.push(Topic {
                name,
                kind,
                recorded_ns: Vec::new(),
                stamp_ns: Vec::new(),
                values: Vec::new(),
                bad: 0,
            });
            self.list.len() - 1
        });
        let topic = &mut self.list[at];
        match decode(kind, encoding, message.data) {
            None => topic.bad += 1,
            Some(decoded) => {
                topic.recorded_ns.push(message.recorded_ns);
                topic.stamp_ns.push(decoded.stamp_ns);
                topic.values.push(flight_numbers(kind, &decoded.numbers));
            }
        }
    }

    /// Number of messages, of all topics.
    pub(super) fn messages(&self) -> usize {
        self.messages
    }

    /// The topics' names, for an error.
    pub(super) fn names(&self) -> String {
        let read = self.list.iter().map(|topic| topic.name.clone());
        let names: Vec<String> = read.chain(self.unread.iter().cloned()).collect();
        names.join(", ").chars().take(300).collect()
    }

    /// The topic that fits a role best; of equals the one with most messages. `None` without a message.
    pub(super) fn best_for(&self, role: TopicRole) -> Option<&Topic> {
        let fitting = self.list.iter().filter(|topic| role.fit(topic) > 0 && !topic.values.is_empty());
        fitting.max_by_key(|topic| (role.fit(topic), topic.values.len()))
    }

    /// Notes topics that play no role and messages that could not be read.
    pub(super) fn note_unused(&self, parts: &[Option<&Topic>], notes: &mut Vec<Note>) {
        let plays = |topic: &Topic| {
            parts.iter().flatten().any(|used| used.name == topic.name && used.kind == topic.kind)
        };
        let idle = self.list.iter().filter(|topic| !plays(topic)).map(|topic| topic.name.clone());
        let topics: Vec<String> = idle.chain(self.unread.iter().cloned()).collect();
        if !topics.is_empty() {
            notes.push(Note::IgnoredTopics { topics });
        }
        for topic in self.list.iter().filter(|topic| topic.bad > 0) {
            notes.push(Note::OddValues { source: topic.name.clone(), count: topic.bad });
        }
    }
}
