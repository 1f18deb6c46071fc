//! Flights by name: the tasks, and the thesis's flights.

use std::borrow::Cow;
use std::sync::OnceLock;

use crazyflie_control::Mode;
use crazyflie_env::config::{EffectParams, EffectTable, Number};
use crazyflie_env::model::VerticalInput;
use serde_json::Value;

/// A part of a flight with one set-point and one state of the controller.
#[derive(Debug, Clone)]
pub struct Phase {
    /// Title in tables.
    pub name: Cow<'static, str>,
    /// Start of the phase, from the start of the flight.
    pub from_s: f64,
    /// In place of the task's.
    pub setpoint_m: Option<[f32; 3]>,
    /// State that the controller is set to.
    pub mode: Mode,
}

/// Flight that has a name.
#[derive(Debug)]
pub struct FlightScenario {
    /// Key on the command line.
    pub name: &'static str,
    /// Description for users.
    pub about: &'static str,
    /// Section and figure of the thesis; empty for a plain task.
    pub source: &'static str,
    /// Name of the task in [`crazyflie_env::task::registry`].
    pub task: &'static str,
    options: &'static str,
    /// Default length of the flight.
    pub seconds: f64,
    /// Controller and its options as JSON that fly it unless others are given; the thesis's PID without.
    pub controller: Option<(&'static str, &'static str)>,
    /// Vertical form unless another is given; the model's without.
    pub vertical: Option<VerticalInput>,
    /// Phases in order of time, the first from 0 on.
    pub phases: &'static [Phase],
}

impl FlightScenario {
    /// # Errors
    /// With a proposal, if there is no such task or flight.
    pub fn find(name: &str) -> crazyflie_env::Result<&'static FlightScenario> {
        let all = || SCENARIOS.iter().chain(other_tasks());
        // an id of Gymnasium is its task
        let name = crazyflie_env::task::find(name).map_or(name, |task| task.name);
        all()
            .find(|s| s.name == name || s.name == name.replace('_', "-"))
            .ok_or_else(|| crazyflie_env::error::unknown("task or flight", name, all().map(|s| s.name)))
    }

    /// Returns whether its task has several drones.
    ///
    /// # Errors
    /// The error of an unknown task.
    pub fn flies_several(&self) -> crazyflie_env::Result<bool> {
        Ok(crazyflie_env::task::find(self.task)?.drones > 1)
    }

    /// Options of the task.
    pub(crate) fn task_options(&self) -> Value {
        // a test reads them all
        serde_json::from_str(self.options).unwrap_or(Value::Null)
    }
}

/// The tasks of the registry that have no entry below: as long as an episode, in one phase.
fn other_tasks() -> &'static [FlightScenario] {
    static OTHERS: OnceLock<Vec<FlightScenario>> = OnceLock::new();
    OTHERS.get_or_init(|| {
        let tasks = crazyflie_env::task::registry()
            .iter()
            .filter(|entry| SCENARIOS.iter().all(|s| s.name != entry.name));
        tasks
            .map(|entry| task(entry.name, entry.about, f64::from(entry.max_episode_steps) / EPISODE_HZ, HOLD))
            .collect()
    })
}

/// Steps per second that the lengths of episodes are meant for: the thesis's rig.
pub const EPISODE_HZ: f64 = 50.0;

/// The phase in force; half a millisecond of margin for the clock's rounding.
pub fn phase_at(phases: &[Phase], t_s: f64) -> &Phase {
    phases.iter().rev().find(|p| p.from_s <= t_s + 5e-4).unwrap_or(&phases[0])
}

const fn phase(name: &'static str, from_s: f64, setpoint_m: Option<[f32; 3]>, mode: Mode) -> Phase {
    Phase { name: Cow::Borrowed(name), from_s, setpoint_m, mode }
}

const HOLD: &[Phase] = &[phase("", 0.0, None, Mode::Automatic)];
const TAKEOFF: &[Phase] = &[phase("", 0.0, None, Mode::Takeoff)];
const LAND: &[Phase] = &[phase("", 0.0, None, Mode::Landing)];
const STEP: &[Phase] = &[
    phase("hover", 0.0, Some([0.0, 0.0, 0.7]), Mode::Automatic),
    phase("step", 5.0, Some([0.0, 0.0, 0.8]), Mode::Automatic),
];
const WHOLE: &[Phase] = &[
    phase("take off", 0.0, Some([0.8, 0.0, 0.7]), Mode::Takeoff),
    phase("fly 80 cm", 15.0, Some([0.0, 0.0, 0.7]), Mode::Takeoff),
    phase("land", 30.0, Some([0.0, 0.0, 0.05]), Mode::Landing),
];

/// A track, for two and a half rounds.
const fn track(name: &'static str, about: &'static str, options: &'static str) -> FlightScenario {
    FlightScenario { task: "track", options, ..task(name, about, 20.0, HOLD) }
}

const fn task(
    name: &'static str,
    about: &'static str,
    seconds: f64,
    phases: &'static [Phase],
) -> FlightScenario {
    FlightScenario {
        name,
        about,
        source: "",
        task: name,
        options: "null",
        seconds,
        controller: None,
        vertical: None,
        phases,
    }
}

/// An identification flight of chapter 5: a command from a hover at 70 cm, without control.
const fn step(
    name: &'static str,
    about: &'static str,
    source: &'static str,
    options: &'static str,
    seconds: f64,
) -> FlightScenario {
    FlightScenario {
        controller: Some(("hover", options)),
        options: r#"{"start_m": [0, 0, 0.7]}"#,
        source,
        task: "hover",
        ..task(name, about, seconds, HOLD)
    }
}

/// The tasks, then the thesis's flights.
pub static SCENARIOS: &[FlightScenario] = &[
    task("hover", "fly to the marker from up to 80 cm away", 10.0, HOLD),
    task("takeoff", "take off to 70 cm", 15.0, TAKEOFF),
    task("land", "land on the marker", 10.0, LAND),
    task("track", "follow a moving set-point", 20.0, HOLD),
    track("figure-eight", "follow a figure eight", r#"{"shape": "figure_eight"}"#),
    track("circle", "follow a circle", r#"{"shape": "circle"}"#),
    track("square", "follow a square", r#"{"shape": "square"}"#),
    track("helix", "follow a helix", r#"{"shape": "helix"}"#),
    track("waypoints", "follow waypoints that each flight draws", r#"{"shape": "waypoints"}"#),
    FlightScenario {
        source: "7.3, fig. 7.4-7.8",
        task: "hover",
        options: r#"{"start_m": [0.8, 0, 0.7]}"#,
        ..task(
            "fly-80cm",
            "from hovering 80 cm away in x, fly to the marker and hold 70 cm over it",
            15.0,
            HOLD,
        )
    },
    FlightScenario {
        source: "7.3, fig. 7.9",
        task: "takeoff",
        ..task("takeoff-70cm", "take off from the marker to 70 cm", 20.0, TAKEOFF)
    },
    FlightScenario {
        source: "7.3, fig. 7.10-7.14",
        task: "hover",
        options: r#"{"start_m": [0, 0, 0.7]}"#,
        ..task("hover-70cm", "hold 70 cm over the marker", 20.0, HOLD)
    },
    FlightScenario {
        source: "5.1.3, fig. 5.13, 5.15",
        task: "hover",
        options: r#"{"start_m": [0, 0, 0.7]}"#,
        ..task("height-step", "hold 70 cm, then 80 cm", 15.0, STEP)
    },
    FlightScenario {
        source: "7.3",
        task: "hover",
        options: r#"{"start_m": [0.8, 0, 0]}"#,
        ..task("whole-flight", "take off 80 cm away, hold 70 cm, fly to the marker, hold, land", 40.0, WHOLE)
    },
    step(
        "roll-step",
        "7.5 degrees of roll from a hover, without control",
        "5.1.1, fig. 5.5",
        r#"{"roll_deg": 7.5, "from_s": 10}"#,
        11.2,
    ),
    step(
        "pitch-step",
        "7.5 degrees of pitch from a hover, without control, until the speed of fig. 5.17",
        "5.1.1, 5.1.4, fig. 5.2, 5.4, 5.17",
        r#"{"pitch_deg": 7.5, "from_s": 10}"#,
        12.0,
    ),
    step(
        "yaw-turn",
        "36 deg/s of yaw from a hover, without control",
        "5.1.2, fig. 5.8",
        r#"{"yaw_rate_degps": 36, "from_s": 10}"#,
        20.0,
    ),
    FlightScenario {
        vertical: Some(VerticalInput::Height),
        phases: STEP,
        ..step(
            "height-command",
            "70 cm, then 80 cm by the vehicle's own height loop",
            "5.1.3, fig. 5.10, 5.12",
            "{}",
            15.0,
        )
    },
];

/// From the capture of a frame to its pose.
pub const LAB_LATENCY_S: f64 = 0.05;

/// The camera rig of the lab as effects: 30 Hz frames that arrive 50 ms after capture, with the noise of a good ArUco
/// pose at 70 cm. With the mean age of a frame (17 ms) and of a command (10 ms) that is 77 ms of delay in all.
pub fn lab_rig() -> EffectTable {
    let named = |params: &[(&str, f64)]| {
        EffectParams::Named(
            params.iter().map(|(name, value)| ((*name).to_owned(), Number::Fixed(*value))).collect(),
        )
    };
    EffectTable::from([
        ("camera".to_owned(), named(&[("on", 1.0)])),
        ("camera_latency".to_owned(), named(&[("latency_s", LAB_LATENCY_S)])),
        ("camera_noise".to_owned(), named(&[("xy_m", 0.005), ("z_m", 0.01), ("yaw_deg", 1.0)])),
    ])
}

/// Effects of the sensors of that name, and the latency of their camera in seconds.
///
/// # Errors
/// With a proposal, for anything but ideal and lab.
pub fn sensor_rig(name: &str) -> crazyflie_env::Result<(EffectTable, Option<f64>)> {
    match name {
        "ideal" => Ok((EffectTable::new(), None)),
        "lab" => Ok((lab_rig(), Some(LAB_LATENCY_S))),
        other => Err(crazyflie_env::error::unknown("rig", other, ["ideal", "lab"])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::task::OptionKind;

    #[test]
    fn every_scenario_is_a_task_with_good_options() {
        for entry in crazyflie_env::task::registry() {
            assert_eq!(FlightScenario::find(entry.name).unwrap().task, entry.name);
        }
        let track = crazyflie_env::task::find("track").unwrap();
        let options = track.options();
        let shape = options.iter().find(|option| option.name == "shape").unwrap();
        let OptionKind::Name(shapes) = shape.kind else { panic!("{:?}", shape.kind) };
        for shape in shapes {
            assert_eq!(FlightScenario::find(shape).unwrap().task_options()["shape"], *shape);
        }
        for s in SCENARIOS {
            crazyflie_env::task::find(s.task).unwrap();
            serde_json::from_str::<Value>(s.options).unwrap();
            assert!(s.phases[0].from_s == 0.0 && s.phases.is_sorted_by_key(|p| p.from_s), "{}", s.name);
        }
    }

    #[test]
    fn the_lab_rig_is_in_range() {
        crazyflie_env::effects::check_effects(&lab_rig()).unwrap();
    }
}
