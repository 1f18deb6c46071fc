//! Messages of a recording by topic, and which topic plays which role in a flight.

use super::clock::{BEGINS_ANEW_S, choose_flight};
use super::message::{Encoding, Kind, decode};
use super::series::Series;
use super::{Columns, Note, Result};

/// A message as a recorder stored it.
#[derive(Debug, Clone, Copy)]
pub(super) struct StoredMessage<'a> {
    pub(super) recorded_ns: u64,
    pub(super) data: &'a [u8],
}

/// Damaged files name any number of bodies.
const MOST_TOPICS: usize = 256;
/// Damaged files begin anew with every message.
const MOST_FLIGHTS: usize = 64;
/// Fewer poses are no body that flies.
const LEAST_POSES: usize = 10;

/// The messages of one topic, in the order of the file.
#[derive(Debug)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// The flight of the recording that it belongs to, from 0.
    flight: usize,
    pub(super) recorded_ns: Vec<u64>,
    pub(super) stamp_ns: Vec<Option<u64>>,
    /// The numbers of each message, see [`Kind::path`].
    pub(super) values: Vec<Vec<f64>>,
    /// Messages that could not be decoded.
    bad: usize,
}

impl Topic {
    /// Returns whether a time is so far before the latest message that the clock began anew.
    fn is_before(&self, recorded_ns: u64) -> bool {
        let latest_ns = self.recorded_ns.last().copied().unwrap_or(0);
        latest_ns.saturating_sub(recorded_ns) as f64 * 1e-9 > BEGINS_ANEW_S
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

const POSES: &[Kind] = &[
    Kind::PoseStamped,
    Kind::TransformStamped,
    Kind::Transforms,
    Kind::PoseWithCovarianceStamped,
    Kind::Odometry,
];

impl TopicRole {
    /// Returns the topic's name in the thesis's rig, without namespace.
    pub(super) fn usual_name(self) -> &'static str {
        self.known().0
    }

    /// The usual name, and the types of messages that it may have.
    fn known(self) -> (&'static str, &'static [Kind]) {
        match self {
            Self::Command => ("crazyflie/cmd_vel", &[Kind::Twist, Kind::TwistStamped]),
            Self::Imu => ("crazyflie/imu", &[Kind::Imu]),
            Self::Pose => ("ar_single_board/pose", POSES),
            Self::Goal => ("crazyflie/goal", &[Kind::PoseStamped]),
            Self::Battery => ("crazyflie/battery", &[Kind::Float32]),
        }
    }

    /// Rates the match of a topic: 0 for none, more is better. Goals and batteries need their names, since other
    /// topics have the same types; names may have any namespace in front.
    fn fit(self, topic: &Topic) -> usize {
        let name = topic.name.trim_matches('/');
        let last = name.rsplit('/').next().unwrap_or(name);
        let (usual, kinds) = self.known();
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
    /// The latest flight.
    flight: usize,
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
        let Some(decoded) = decode(kind, encoding, message.data) else {
            self.topic(name, kind, message.recorded_ns).bad += 1;
            return;
        };
        for (body, decoded) in decoded {
            // Damaged files could name a new body with every message.
            if body.is_empty() || self.list.len() < MOST_TOPICS {
                let name = if body.is_empty() { name.to_owned() } else { format!("{name}/{body}") };
                let topic = self.topic(&name, kind, message.recorded_ns);
                topic.recorded_ns.push(message.recorded_ns);
                topic.stamp_ns.push(decoded.stamp_ns);
                topic.values.push(decoded.numbers);
            }
        }
    }

    /// The topic of this name and kind in the flight of a time, new if there is none.
    fn topic(&mut self, name: &str, kind: Kind, recorded_ns: u64) -> &mut Topic {
        let latest = self.list.iter().rposition(|topic| topic.name == name && topic.kind == kind);
        let began_anew =
            self.flight + 1 < MOST_FLIGHTS && latest.is_some_and(|at| self.list[at].is_before(recorded_ns));
        let index = latest.filter(|_| !began_anew).unwrap_or_else(|| {
            // the first topic that begins anew begins a flight, which the others join
            self.flight += usize::from(latest.is_some_and(|index| self.list[index].flight == self.flight));
            self.list.push(Topic {
                name: name.to_owned(),
                kind,
                flight: self.flight,
                recorded_ns: Vec::new(),
                stamp_ns: Vec::new(),
                values: Vec::new(),
                bad: 0,
            });
            self.list.len() - 1
        });
        &mut self.list[index]
    }

    /// Keeps the topics of the chosen flight: a clock that falls back began anew with another one.
    ///
    /// # Errors
    /// [`LogError::NoSuchFlight`].
    pub(super) fn of_flight(
        mut self,
        file: &str,
        part: Option<usize>,
        notes: &mut Vec<Note>,
    ) -> Result<Self> {
        let chosen = choose_flight(file, self.flight + 1, part, notes)?;
        self.list.retain(|topic| topic.flight == chosen);
        Ok(self)
    }

    /// Every number of every topic of the chosen flight as a column, named by topic and field, at the times of record.
    ///
    /// # Errors
    /// [`LogError::NoSuchFlight`].
    pub(super) fn columns(
        self,
        file: &str,
        part: Option<usize>,
        notes: &mut Vec<Note>,
    ) -> Result<Option<Columns>> {
        let mut columns = Vec::new();
        for topic in &self.of_flight(file, part, notes)?.list {
            let t_s: Vec<f64> = topic.recorded_ns.iter().map(|ns| *ns as f64 * 1e-9).collect();
            for at in 0..topic.values.iter().map(Vec::len).min().unwrap_or(0) {
                let name = format!("{}.{}", topic.name, topic.kind.path(at));
                let values = topic.values.iter().map(|values| values[at]).collect();
                columns.push(Series { name, t_s: t_s.clone(), values }.in_order(notes));
            }
        }
        Ok(Some(Columns(columns)))
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

    /// The names of all topics that are poses as well as the best one: of several bodies, where there is more
    /// than one.
    pub(super) fn bodies(&self) -> Vec<&str> {
        let fit = |topic: &Topic| TopicRole::Pose.fit(topic);
        let best = self.best_for(TopicRole::Pose).map_or(0, fit);
        let alike = self.list.iter().filter(|topic| fit(topic) > 0 && fit(topic) == best);
        alike.filter(|topic| topic.values.len() >= LEAST_POSES).map(|topic| topic.name.as_str()).collect()
    }

    /// Leaves out the topics of other bodies; false if none is of this one.
    pub(super) fn keep_body(&mut self, body: &str) -> bool {
        let is_of = |topic: &Topic| topic.name.split('/').any(|part| part == body);
        let is_listed = self.list.iter().any(is_of);
        self.list.retain(|topic| TopicRole::Pose.fit(topic) == 0 || is_of(topic));
        is_listed
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
            notes.push(Note::OddValues { name: topic.name.clone(), count: topic.bad });
        }
    }
}
