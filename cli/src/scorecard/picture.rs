//! One picture per flight of section 7.3: old gains and new, with the true position and through the camera.

use crazyflie_env::Error;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_picture::{Band, PALETTE, Panel, PictureError, Series, Style, chart};

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
    band: Band<'static>,
}

const MARKER: Band<'static> =
    Band { label: "over the marker", low: -0.0985, high: 0.0985, color: PALETTE[2] };
const HEIGHT: Band<'static> = Band { label: "70 cm +- 5 cm", low: 0.65, high: 0.75, color: PALETTE[2] };

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

/// File names and SVG documents.
pub(crate) fn pictures() -> Result<Vec<(&'static str, String)>, DrawError> {
    let model = Model::thesis();
    PLOTS.iter().map(|plot| Ok((plot.file, draw(&model, plot)?))).collect()
}

fn draw(model: &Model, plot: &Plot) -> Result<String, DrawError> {
    let mut flown = Vec::new();
    for (_, gains) in GAINS {
        flown.push(fly_pair(model, plot.scenario, gains, plot.vertical)?);
    }
    let curve = |trace: &Trace| {
        let t: Vec<f64> = (0..trace.rows.len()).map(|row| trace.t_s(row)).collect();
        (t, trace.state(plot.state))
    };
    let ideal: Vec<_> = flown.iter().map(|pair| curve(&pair.ideal)).collect();
    let rig: Vec<_> = flown.iter().map(|pair| curve(&pair.rig[0])).collect();
    let panel = |title, curves: &'static str, of| Panel {
        title,
        x_label: "time (s)",
        y_label: curves,
        series: of,
        bands: vec![plot.band],
        ..Panel::default()
    };
    let camera = "30 Hz camera, 50 ms late, noisy (seed 0)";
    let panels = if plot.scenario == "hover-70cm" {
        // the true position stands still, and the two gains need axes of their own
        let [old, new] = [0, 1].map(|i| vec![series(&rig)[i]]);
        [panel(camera, plot.label, old), panel(camera, plot.label, new)]
    } else {
        [panel("true position", plot.label, series(&ideal)), panel(camera, plot.label, series(&rig))]
    };
    Ok(chart(&panels, 2, plot.title)?)
}

fn series(curves: &[(Vec<f64>, Vec<f64>)]) -> Vec<Series<'_>> {
    let looks = [("old gains (crazyflie_ros)", PALETTE[1]), ("new gains (table 7.1)", PALETTE[0])];
    curves
        .iter()
        .zip(looks)
        .map(|((x, y), (label, color))| Series { label, x, y, style: Style::Solid, color })
        .collect()
}
