//! Content of an observation: measurements, the estimates of a filter, true values, or fields by name; of now, or of
//! the last few ticks.

use serde::{Deserialize, Deserializer, Serialize};

use super::{ACC, ATTITUDE, FIELDS, Field, GYRO, LAST_ACTION, OBSERVATION, SETPOINT, field};
use super::{MARKER_AGE, MARKER_POS, MARKER_VALID, MARKER_YAW, VBAT};
use crate::error::{Error, Result, find_named, unknown};

const PI: f64 = std::f64::consts::PI;
/// No flight in the room is faster: one that falls from its ceiling reaches 7 m/s.
const FASTEST_MPS: f64 = 20.0;
/// From any place to any set-point.
const FARTHEST_M: f64 = 20.0;

/// True position.
pub const POS: Field = field("pos_m", OBSERVATION, 3, "m", [-10.0, 10.0]).about("true position in the room");
/// True velocity.
pub const VEL: Field = field("vel_mps", POS.end(), 3, "m/s", [-FASTEST_MPS, FASTEST_MPS])
    .about("true velocity along the room's axes");
/// True attitude.
pub const ATT: Field = field("att_rad", VEL.end(), 3, "rad", [-PI, PI]).about("true roll, pitch, yaw");
/// True rates.
pub const RATE: Field =
    field("rate_radps", ATT.end(), 3, "rad/s", [-34.9, 34.9]).about("true rates of roll, pitch, yaw");
/// True way to the set-point.
pub const ERROR: Field =
    field("error_m", RATE.end(), 3, "m", [-FARTHEST_M, FARTHEST_M]).about("set-point minus true position");
/// True turn to the set-point.
pub const YAW_ERROR: Field = field("yaw_error_rad", ERROR.end(), 1, "rad", [-PI, PI])
    .about("set-point minus true yaw, the short way round");
/// Estimated position.
pub const EST_POS: Field =
    field("est_pos_m", YAW_ERROR.end(), 3, "m", [-10.0, 10.0]).about("position now, by the Kalman filter");
/// Estimated velocity.
pub const EST_VEL: Field = field("est_vel_mps", EST_POS.end(), 3, "m/s", [-FASTEST_MPS, FASTEST_MPS])
    .about("velocity along the room's axes, by the Kalman filter");
/// Estimated heading.
pub const EST_YAW: Field =
    field("est_yaw_rad", EST_VEL.end(), 1, "rad", [-PI, PI]).about("heading now, by the Kalman filter");
/// Estimated push.
pub const EST_PUSH: Field = field("est_push_mps2", EST_YAW.end(), 3, "m/s^2", [-157.0, 157.0])
    .about("acceleration that the attitude does not explain, by accelerometer and filter");
/// Estimated way to the set-point.
pub const EST_ERROR: Field = field("est_error_m", EST_PUSH.end(), 3, "m", [-FARTHEST_M, FARTHEST_M])
    .about("set-point minus estimated position");
/// Estimated turn to the set-point.
pub const EST_YAW_ERROR: Field = field("est_yaw_error_rad", EST_ERROR.end(), 1, "rad", [-PI, PI])
    .about("set-point minus estimated heading, the short way round");

/// Middle of the next gate.
pub const GATE_POS: Field = field("gate_pos_m", EST_YAW_ERROR.end(), 3, "m", [-10.0, 10.0])
    .about("middle of the next gate in the room, where the task has gates");
/// Direction of the next gate.
pub const GATE_YAW: Field =
    field("gate_yaw_rad", GATE_POS.end(), 1, "rad", [-PI, PI]).about("direction to fly through it");
/// Middle of the gate after it.
pub const NEXT_GATE_POS: Field =
    field("next_gate_pos_m", GATE_YAW.end(), 3, "m", [-10.0, 10.0]).about("middle of the gate after that");
/// Direction of the gate after it.
pub const NEXT_GATE_YAW: Field = field("next_gate_yaw_rad", NEXT_GATE_POS.end(), 1, "rad", [-PI, PI])
    .about("direction to fly through that one");
/// Way to the nearest obstacle.
pub const OBSTACLE: Field = field("obstacle_m", NEXT_GATE_YAW.end(), 3, "m", [-10.0, 10.0])
    .about("true way to the nearest point of the nearest obstacle, along the room's axes; 10 along each where there is none");

/// Fields of the true state, each with the field that stands for it where only measurements are known.
const ESTIMATED: [(Field, Field); 6] = [
    (POS, EST_POS),
    (VEL, EST_VEL),
    (ATT, ATTITUDE),
    (RATE, GYRO),
    (ERROR, EST_ERROR),
    (YAW_ERROR, EST_YAW_ERROR),
];

/// Returns whether no sensor measures the field: it is of the true state.
pub(crate) fn is_true_state(field: &Field) -> bool {
    ESTIMATED.iter().any(|(truth, _)| truth.first == field.first)
}

/// Returns whether the field describes gates or obstacles.
pub(crate) fn is_of_surroundings(field: &Field) -> bool {
    field.first >= GATE_POS.first
}

/// Every field available to an observation. `first` is the place among all [`OBSERVABLE`] numbers.
pub const ALL_FIELDS: [Field; 27] = [
    MARKER_POS,
    MARKER_YAW,
    MARKER_AGE,
    MARKER_VALID,
    ATTITUDE,
    GYRO,
    ACC,
    VBAT,
    SETPOINT,
    LAST_ACTION,
    POS,
    VEL,
    ATT,
    RATE,
    ERROR,
    YAW_ERROR,
    EST_POS,
    EST_VEL,
    EST_YAW,
    EST_PUSH,
    EST_ERROR,
    EST_YAW_ERROR,
    GATE_POS,
    GATE_YAW,
    NEXT_GATE_POS,
    NEXT_GATE_YAW,
    OBSTACLE,
];

/// Numbers of all fields together.
pub const OBSERVABLE: usize = OBSTACLE.end();

/// A choice that has a name.
#[derive(Debug, Clone, Copy)]
pub struct NamedChoice {
    /// Key in configurations.
    pub name: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
    /// Its fields, in order.
    pub fields: &'static [Field],
}

/// Every choice that has a name; the first is the default.
pub const CHOICES: [NamedChoice; 3] = [
    NamedChoice { name: "measured", about: "what the rig could measure; the benchmark's", fields: &FIELDS },
    NamedChoice {
        name: "estimate",
        about: "what a Kalman filter makes of camera and IMU, and what LQR sees",
        fields: &[EST_POS, EST_VEL, EST_YAW, ATTITUDE, GYRO, EST_ERROR, EST_YAW_ERROR, SETPOINT, LAST_ACTION],
    },
    NamedChoice {
        name: "state",
        about: "the true state, without noise or delay",
        fields: &[POS, VEL, ATT, RATE, ERROR, YAW_ERROR, SETPOINT, LAST_ACTION],
    },
];

/// The most ticks of one observation.
pub const LONGEST_HISTORY: usize = 64;

/// Content of an observation: one of [`CHOICES`], or names of [`ALL_FIELDS`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum ObservationChoice {
    /// By the name of a choice.
    Named(String),
    /// By the names of its fields.
    Fields(Vec<String>),
}

impl Default for ObservationChoice {
    fn default() -> Self {
        ObservationChoice::Named(CHOICES[0].name.into())
    }
}

impl<'de> Deserialize<'de> for ObservationChoice {
    fn deserialize<D: Deserializer<'de>>(from: D) -> std::result::Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(from)?;
        let text = |item: &serde_json::Value| item.as_str().map(String::from);
        let read = match &value {
            serde_json::Value::Array(items) => {
                items.iter().map(text).collect::<Option<_>>().map(ObservationChoice::Fields)
            }
            other => text(other).map(ObservationChoice::Named),
        };
        read.ok_or_else(|| {
            serde::de::Error::custom(format!(
                "observation is {value}, expected one of {}, or a list of names of fields",
                CHOICES.map(|choice| format!("{:?}", choice.name)).join(", ")
            ))
        })
    }
}

impl ObservationChoice {
    /// Returns whether this is the row of [`super::observe`].
    pub fn is_default(&self) -> bool {
        *self == ObservationChoice::default()
    }

    /// Returns the chosen fields, with their places among all [`OBSERVABLE`] numbers.
    ///
    /// # Errors
    /// [`Error::Unknown`] with a proposal, [`Error::Config`] for an empty list and for a field that is named
    /// twice.
    pub fn sources(&self) -> Result<Vec<Field>> {
        match self {
            ObservationChoice::Named(name) => CHOICES
                .iter()
                .find(|choice| choice.name == name)
                .map(|choice| choice.fields.to_vec())
                .ok_or_else(|| unknown("observation", name, CHOICES.iter().map(|choice| choice.name))),
            ObservationChoice::Fields(names) if names.is_empty() => {
                Err(Error::Config("observation: expected at least one field, got an empty list".into()))
            }
            ObservationChoice::Fields(names) => {
                if let Some(twice) = (1..names.len()).find(|i| names[..*i].contains(&names[*i])) {
                    return Err(Error::Config(format!(
                        "observation[{twice}]: the field {:?} is there already",
                        names[twice]
                    )));
                }
                names.iter().map(|name| find_field(name)).collect()
            }
        }
    }

    /// Returns the names of its fields, with estimates in the place of the true state: for use where only measurements
    /// are known.
    ///
    /// # Errors
    /// The errors of [`ObservationChoice::sources`].
    pub fn estimated(&self) -> Result<ObservationChoice> {
        let estimate = |field: Field| {
            let known = ESTIMATED.iter().find(|(truth, _)| truth.first == field.first);
            known.map_or(field, |(_, estimate)| *estimate).name.to_owned()
        };
        let choice = ObservationChoice::Fields(self.sources()?.into_iter().map(estimate).collect());
        choice.sources().map(|_| choice)
    }

    /// Returns the fields with their places in a row.
    ///
    /// # Errors
    /// The errors of [`ObservationChoice::sources`].
    pub fn fields(&self) -> Result<Vec<Field>> {
        let mut first = 0;
        let place = |source: Field| {
            first += source.length;
            Field { first: first - source.length, ..source }
        };
        Ok(self.sources()?.into_iter().map(place).collect())
    }
}

/// The field of a name.
///
/// # Errors
/// [`Error::Unknown`] with a proposal.
pub fn find_field(name: &str) -> Result<Field> {
    find_named("observation field", name, ALL_FIELDS, |field| field.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_belongs_to_one_field() {
        let mut end = 0;
        for field in ALL_FIELDS {
            assert_eq!(field.first, end, "{}", field.name);
            assert!(!field.about.is_empty(), "{}", field.name);
            assert!(field.low < field.high && field.low.is_finite() && field.high.is_finite());
            end = field.end();
        }
        assert_eq!(end, OBSERVABLE);
        assert_eq!(ALL_FIELDS[..FIELDS.len()], FIELDS, "what is measured comes first");
    }

    #[test]
    fn fields_of_a_row_stand_side_by_side() {
        for choice in CHOICES {
            let fields = ObservationChoice::Named(choice.name.into()).fields().unwrap();
            let mut end = 0;
            for (placed, source) in fields.iter().zip(choice.fields) {
                assert_eq!((placed.first, placed.name), (end, source.name));
                end = placed.end();
            }
        }
    }

    #[test]
    fn what_is_wrong_with_a_choice_is_said() {
        let error = |json: &str| {
            let choice: std::result::Result<ObservationChoice, _> = serde_json::from_str(json);
            choice.map_or_else(|e| e.to_string(), |choice| choice.fields().unwrap_err().to_string())
        };
        for (json, words) in [
            (r#""estimated""#, "did you mean \"estimate\""),
            (r#"["pos_m", "vel_mp"]"#, "did you mean \"vel_mps\""),
            (r#"["pos_m", "vel_mps", "pos_m"]"#, "observation[2]: the field \"pos_m\" is there already"),
            ("[]", "expected at least one field"),
            ("3", "observation is 3, expected one of \"measured\""),
            (r#"["pos_m", 3]"#, "or a list of names of fields"),
        ] {
            assert!(error(json).contains(words), "{json} gave: {}", error(json));
        }
    }
}
