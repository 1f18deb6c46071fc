//! One picture per flight of section 7.3: old gains and new, with the true position and through the camera.

use crazyflie_env::Error;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_picture::{BLUE, Drawing, GREEN, Panel, PictureError, Style, VERMILION, chart};

use super::flights::{GAINS, fly_pair};
use crazyflie_server::flight::Trace;

/// Reason that a picture could not be drawn.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DrawError {
    #[error(transparent)]
    Flight(#[from] Error),
    #[error(transparent)]
    Picture(#[from] PictureError),
}

struct Plot {
    file: &'static str,
    title: &'static str,
    scenario: &'static str,
    vertical: VerticalInput,
    /// Place in the true state, and its label.
    state: usize,
    label: &'static str,
    band: (&'static str, [f64; 2]),
}

const MARKER: (&str, [f64; 2]) = ("over the marker", [-0.0985, 0.0985]);
const HEIGHT: (&str, [f64; 2]) = ("70 cm +- 5 cm", [0.65, 0.75]);

const PLOTS: [Plot; 4] = [
    Plot {
        file: "fly-80cm.svg",
        title: "80 cm to the marker (thesis fig. 7.5, 7.6)",
        scenario: "fly-80cm",
        vertical: VerticalInput::Pwm,
        state: 0,
        label: "x (m)",
        band: MARKER,
    },
    Plot {
        file: "takeoff.svg",
        title: "take-off to 70 cm on 5.4 (thesis fig. 7.9)",
        scenario: "takeoff-70cm",
        vertical: VerticalInput::Pwm,
        state: 2,
        label: "z (m)",
        band: HEIGHT,
    },
    Plot {
        file: "takeoff-thrust.svg",
        title: "take-off to 70 cm on the thrust form (thesis fig. 7.9)",
        scenario: "takeoff-70cm",
        vertical: VerticalInput::Thrust,
        state: 2,
        label: "z (m)",
        band: HEIGHT,
    },
    Plot {
        file: "hover.svg",
        title: "hover over the marker (thesis fig. 7.11, 7.12)",
        scenario: "hover-70cm",
        vertical: VerticalInput::Pwm,
        state: 0,
        label: "x (m)",
        band: MARKER,
    },
];

/// File names and drawings.
pub(crate) fn pictures() -> Result<Vec<(&'static str, Drawing)>, DrawError> {
    let model = Model::thesis();
    PLOTS.iter().map(|plot| Ok((plot.file, draw(&model, plot)?))).collect()
}

fn draw(model: &Model, plot: &Plot) -> Result<Drawing, DrawError> {
    let mut flown = Vec::new();
    for (_, gains) in GAINS {
        flown.push(fly_pair(model, plot.scenario, gains, plot.vertical)?);
    }
    let looks = [("old gains (crazyflie_ros)", VERMILION), ("new gains (table 7.1)", BLUE)];
    let panel = |title| {
        let (label, edges) = plot.band;
        Panel::new("time (s)", plot.label).title(title).band(GREEN, label, edges)
    };
    let add = |panel: Panel, gains: usize, trace: &Trace| {
        let t_s = (0..trace.rows.len()).map(|row| trace.t_s(row));
        panel.curve(Style::Solid, looks[gains].1, looks[gains].0, t_s, trace.state(plot.state))
    };
    let camera = "30 Hz camera, 50 ms late, noisy (seed 0)";
    let [old, new] = &flown[..] else { return Ok(chart(&[], 2, plot.title)?) };
    let panels = if plot.scenario == "hover-70cm" {
        // the true position stands still, and the two gains need axes of their own
        [add(panel(camera), 0, &old.rig[0]), add(panel(camera), 1, &new.rig[0])]
    } else {
        let ideal = add(add(panel("true position"), 0, &old.ideal), 1, &new.ideal);
        [ideal, add(add(panel(camera), 0, &old.rig[0]), 1, &new.rig[0])]
    };
    Ok(chart(&panels, 2, plot.title)?)
}
