//! The recorded flights, and which of them may be fitted.

use crazyflie_statistics::quantile;
use std::path::Path;

use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::fit::flight::Flight;

/// Split by the description of the recordings: the first are fitted, the others only predicted.
const FIT: [&str; 12] = [
    "B2_circle_fast_rep2",
    "B8_star_fast_rep1",
    "B2_circle_medium_rep2",
    "B3_figure8_fast_rep1",
    "B3_figure8_medium_rep2",
    "B5_helix_medium_rep1",
    "B6_linear_ramp_rep2",
    "B7_oval_fast_rep2",
    "B8_star_slow_rep1",
    "B9_trefoil_fast_rep14",
    "B9_trefoil_slow_rep12",
    "B10_lissajous_fast_rep1",
];
const TEST: [&str; 6] = [
    "B7_oval_fast_rep3",
    "B2_circle_slow_rep2",
    "B3_figure8_slow_rep1",
    "B8_star_medium_rep1",
    "B9_trefoil_medium_rep10",
    "B9_trefoil_slow_rep15",
];

/// A flight with the log that it is from.
pub(super) struct RecordedFlight {
    pub(super) log: FlightLog,
    pub(super) flight: Flight,
}

/// Flights of one side of the split.
pub(super) struct FlightSet {
    pub(super) recorded: Vec<RecordedFlight>,
    /// Files that cannot drive a model, and why.
    pub(super) skipped: Vec<(String, String)>,
}

impl FlightSet {
    /// The same flights, each with its thrust command in parts of its own median, times a common PWM. The
    /// vehicle hovers on the whole, so the median command is the one that carries it: nothing but commands
    /// goes into this.
    pub(super) fn flights_with_own_hover(&self, model: &Model, common_pwm: f64) -> Vec<Flight> {
        let with_own_hover = |r: &RecordedFlight| {
            let mut log = r.log.clone();
            let airborne = log.airborne.clone();
            let thrust = log.cmd_thrust_pwm.as_mut()?;
            let median_pwm = quantile(thrust.get(airborne)?, 0.5).unwrap_or(f64::NAN);
            thrust.iter_mut().for_each(|pwm| *pwm *= common_pwm / median_pwm);
            Flight::from_log(&r.flight.name, &log, model, None).ok()
        };
        self.recorded.iter().filter_map(with_own_hover).collect()
    }

    /// The median thrust command of each flight.
    pub(super) fn hovers_pwm(&self) -> Vec<f64> {
        let hover_pwm = |r: &RecordedFlight| {
            Some(
                quantile(r.log.cmd_thrust_pwm.as_ref()?.get(r.log.airborne.clone())?, 0.5)
                    .unwrap_or(f64::NAN),
            )
        };
        self.recorded.iter().filter_map(hover_pwm).collect()
    }

    pub(super) fn flights(&self) -> Vec<Flight> {
        self.recorded.iter().map(|r| r.flight.clone()).collect()
    }
}

/// Half of the values lie below.
/// Both sides; when it has to be quick, two flights to fit and one to predict.
pub(super) fn sides(folder: &Path, model: &Model, quick: bool) -> Result<[FlightSet; 2], String> {
    let (fit, test) = if quick { (&FIT[..2], &TEST[..1]) } else { (&FIT[..], &TEST[..]) };
    let sides = [side(folder, fit, model)?, side(folder, test, model)?];
    match sides.iter().any(|s| s.recorded.is_empty()) {
        true => Err(format!("{}: no flight can be used", folder.display())),
        false => Ok(sides),
    }
}

fn side(folder: &Path, names: &[&str], model: &Model) -> Result<FlightSet, String> {
    let mut side = FlightSet { recorded: Vec::new(), skipped: Vec::new() };
    for name in names {
        let log = FlightLog::read(&folder.join(format!("{name}.csv.gz"))).map_err(|e| e.to_string())?;
        match Flight::from_log(name, &log, model, None) {
            Ok(flight) => side.recorded.push(RecordedFlight { log, flight }),
            Err(why) => side.skipped.push(((*name).to_owned(), why.to_string())),
        }
    }
    Ok(side)
}
