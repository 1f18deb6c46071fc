//! Hover trim of a flight: the mean demand on the four motors while the vehicle hovers or flies steadily.

use std::ops::Range;

use crazyflie_statistics::quantile;
use nalgebra::Vector4;

use super::demand::mix;
use super::swing::SwingSpectrum;
use crate::lift::motor_voltages;
use crate::{Error, FlightLog, Result};

/// Rows this close to rest, take-off or landing do not count.
const EDGE_S: f64 = 1.5;
/// A shorter steady stretch is no hover.
const SHORTEST_S: f64 = 1.0;
/// A flight with less steady time in all has no trim.
const LEAST_S: f64 = 3.0;
/// Rows further apart than this are not of one stretch.
const GAP_S: f64 = 0.2;
/// Flying is above this share of the usual height of a vehicle with its motors on.
const FLYING_SHARE: f64 = 0.5;

/// Logged quantity from which the motors' demand is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DemandSource {
    /// Requests of the mixer before battery compensation, which the firmware makes proportional to thrust.
    Request,
    /// Square of motor PWM times battery voltage: a rotor's speed follows its mean voltage, its thrust the
    /// square of the speed.
    SquaredVoltage,
}

impl DemandSource {
    /// Words for a table.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Request => "mixer requests",
            Self::SquaredVoltage => "(motor PWM x battery voltage)^2",
        }
    }
}

/// Mean demand of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trim {
    /// In the unit of its source.
    pub thrust: f64,
    /// Roll, pitch and yaw as shares of the thrust.
    pub shares: [f64; 3],
}

/// Trim of a flight by every source that its log has.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightTrim {
    /// File and folder, for the reader.
    pub name: String,
    /// Flights of one folder and one vehicle are one set-up.
    pub folder: String,
    /// The file name up to its first underscore, empty if there is none.
    pub vehicle: String,
    /// Time in steady flight, summed over its stretches.
    pub steady_s: f64,
    /// Trim by [`DemandSource::Request`], thrust in counts; `None` if the log lacks the source.
    pub request: Option<Trim>,
    /// Trim by [`DemandSource::SquaredVoltage`], thrust in V^2; `None` if the log lacks the source.
    pub squared_voltage: Option<Trim>,
    /// Spectrum of the roll and pitch demands over the longer steady stretches.
    pub swing: SwingSpectrum,
}

impl FlightTrim {
    /// Computes the trim of a log; `folder` and `file` are its place.
    ///
    /// # Errors
    /// [`Error`]: no motors in the log, or hardly any steady flight.
    pub fn from_log(folder: &str, file: &str, log: &FlightLog) -> Result<Self> {
        let name = if folder.is_empty() { file.to_owned() } else { format!("{folder}/{file}") };
        let request = log.onboard.as_ref().and_then(|o| o.motor_request_pwm.as_ref());
        let squares = |motor: Vec<f64>| motor.into_iter().map(|v| v.powi(2)).collect::<Vec<f64>>();
        let squared = motor_voltages(log).map(|motors| motors.map(squares));
        let missing = "logs neither requests of the mixer nor motor PWM with battery voltage";
        let motors = request.or(squared.as_ref()).ok_or_else(|| Error::about(&name, missing))?;
        let stretches = steady_stretches(log, motors);
        let durations_s = stretches.iter().map(|s| log.t_s[s.end - 1] - log.t_s[s.start]);
        let steady_s = durations_s.fold(0.0, |sum, s| sum + s);
        if steady_s < LEAST_S {
            let found = format!("flies steadily for {steady_s:.1} s only");
            return Err(Error::about(&name, format!("{found}, at least {LEAST_S} s are needed")));
        }
        Ok(Self {
            swing: SwingSpectrum::from_demand(&log.t_s, motors, &stretches),
            folder: folder.to_owned(),
            vehicle: file.split_once('_').map_or("", |(vehicle, _)| vehicle).to_owned(),
            steady_s,
            request: request.map(|motors| mean_trim(motors, &stretches)),
            squared_voltage: squared.as_ref().map(|motors| mean_trim(motors, &stretches)),
            name,
        })
    }

    /// The trim by one source.
    #[must_use]
    pub fn trim(&self, source: DemandSource) -> Option<Trim> {
        match source {
            DemandSource::Request => self.request,
            DemandSource::SquaredVoltage => self.squared_voltage,
        }
    }

    /// Returns whether two logs are of one flight: means over hundreds of noisy rows never agree to the last bit by
    /// chance.
    #[must_use]
    pub fn is_same_flight(&self, other: &Self) -> bool {
        let agrees = |a: Option<Trim>, b: Option<Trim>| a.is_some() && a == b;
        agrees(self.request, other.request) || agrees(self.squared_voltage, other.squared_voltage)
    }
}

fn mean_trim(motors: &[Vec<f64>; 4], stretches: &[Range<usize>]) -> Trim {
    let count = stretches.iter().map(ExactSizeIterator::len).sum::<usize>() as f64;
    let mean = |motor: &Vec<f64>| stretches.iter().flat_map(|s| &motor[s.clone()]).sum::<f64>() / count;
    let demand = mix() * Vector4::from_iterator(motors.iter().map(mean));
    Trim { thrust: demand[0], shares: [1, 2, 3].map(|i| demand[i] / demand[0]) }
}

/// Stretches of rows with the motors on and well off the floor, their ends cut away. Some logs contain several
/// flights with landings between.
/// The steady stretches of a flight, by the voltages of its motors; none if the log lacks them.
pub(crate) fn hover_stretches(log: &FlightLog) -> Vec<Range<usize>> {
    motor_voltages(log).map_or_else(Vec::new, |motors| steady_stretches(log, &motors))
}

fn steady_stretches(log: &FlightLog, motors: &[Vec<f64>; 4]) -> Vec<Range<usize>> {
    let is_on = |row: usize| motors.iter().all(|m| m[row] > 0.0);
    let height = heights(log);
    let usual: Vec<f64> = (0..log.len()).filter(|row| is_on(*row)).map(|row| height[row]).collect();
    let least_m = FLYING_SHARE * quantile(&usual, 0.75).unwrap_or(0.0);
    let mut stretches: Vec<Range<usize>> = Vec::new();
    for row in (0..log.len()).filter(|row| is_on(*row) && height[*row] >= least_m) {
        match stretches.last_mut() {
            Some(s) if s.end == row && log.t_s[row] - log.t_s[row - 1] < GAP_S => s.end = row + 1,
            _ => stretches.push(row..row + 1),
        }
    }
    let inner = |s: Range<usize>| {
        let (first_s, last_s) = (log.t_s[s.start] + EDGE_S, log.t_s[s.end - 1] - EDGE_S);
        let start = s.start + log.t_s[s.clone()].partition_point(|t| *t < first_s);
        let end = s.start + log.t_s[s.clone()].partition_point(|t| *t <= last_s);
        start..end.max(start)
    };
    let is_long = |s: &Range<usize>| !s.is_empty() && log.t_s[s.end - 1] - log.t_s[s.start] >= SHORTEST_S;
    stretches.into_iter().map(inner).filter(is_long).collect()
}

/// Returns the height by row; the last fix counts. Zero throughout where nothing measured it, so that the motors
/// alone decide.
fn heights(log: &FlightLog) -> Vec<f64> {
    let mut fixes = log.fixes.row.iter().zip(&log.fixes.pos_m[2]).peekable();
    let mut last_m = log.fixes.pos_m[2].first().copied().unwrap_or(0.0);
    let mut heights = Vec::with_capacity(log.len());
    for row in 0..log.len() {
        while let Some((_, z)) = fixes.next_if(|(at, _)| **at <= row) {
            last_m = *z;
        }
        heights.push(last_m);
    }
    heights
}
