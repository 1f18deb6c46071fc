//! Channels: an input and an output of the vehicle, and their records cut out of a log.

use crate::lift::varies;
use crate::replay::measurements::{Measurements, Track};
use crate::{Error, FlightLog, Result};

use super::{Offset, Structure};

/// An input and an output of the vehicle, one for each experiment of the thesis (5.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Roll command to roll.
    Roll,
    /// Pitch command to pitch.
    Pitch,
    /// Yaw-rate command to yaw.
    Yaw,
    /// Height command to height.
    Height,
    /// Thrust command to height.
    Pwm,
    /// Measured angles, turned into the world by the measured heading, to velocity (4.10).
    Vx,
    /// The same along y.
    Vy,
    /// Commanded angles to velocity (5.5).
    CommandVx,
    /// The same along y.
    CommandVy,
}

/// Names, units and usual form of a channel.
pub struct ChannelSpec {
    channel: Channel,
    /// Name on the command line, such as `command-vx`.
    pub name: &'static str,
    /// Name of the input.
    pub input: &'static str,
    /// Name of the output.
    pub output: &'static str,
    /// Units of output and input, SI and radians.
    pub units: [&'static str; 2],
    /// Unit of output over input, as a unit (radians and PWM counts are none) and a power of the second.
    pub(super) ratio: (&'static str, i32),
    /// Degrees of numerator and denominator that the thesis has.
    order: (usize, usize),
    integrator: bool,
    /// Long enough for the slowest pole of that form to show, and for the response to outweigh the free
    /// initial states, which would else take slow errors for dynamics.
    pub window_s: f64,
}

#[rustfmt::skip]
const CHANNELS: [ChannelSpec; 9] = [
    ChannelSpec { channel: Channel::Roll, name: "roll", input: "roll command", output: "roll", units: ["rad", "rad"], ratio: ("1", 0), order: (0, 2), integrator: false, window_s: 5.0 },
    ChannelSpec { channel: Channel::Pitch, name: "pitch", input: "pitch command", output: "pitch", units: ["rad", "rad"], ratio: ("1", 0), order: (0, 2), integrator: false, window_s: 5.0 },
    ChannelSpec { channel: Channel::Yaw, name: "yaw", input: "yaw-rate command", output: "yaw", units: ["rad", "rad/s"], ratio: ("1", 1), order: (0, 1), integrator: true, window_s: 5.0 },
    ChannelSpec { channel: Channel::Height, name: "height", input: "height command", output: "z", units: ["m", "m"], ratio: ("1", 0), order: (0, 1), integrator: false, window_s: 10.0 },
    ChannelSpec { channel: Channel::Pwm, name: "pwm", input: "thrust command", output: "z", units: ["m", "PWM"], ratio: ("m", 0), order: (0, 1), integrator: false, window_s: 10.0 },
    ChannelSpec { channel: Channel::Vx, name: "vx", input: "pitch angle", output: "vx", units: ["m/s", "rad"], ratio: ("m", -1), order: (0, 1), integrator: true, window_s: 2.0 },
    ChannelSpec { channel: Channel::Vy, name: "vy", input: "roll angle", output: "vy", units: ["m/s", "rad"], ratio: ("m", -1), order: (0, 1), integrator: true, window_s: 2.0 },
    ChannelSpec { channel: Channel::CommandVx, name: "command-vx", input: "pitch command", output: "vx", units: ["m/s", "rad"], ratio: ("m", -1), order: (0, 3), integrator: true, window_s: 2.0 },
    ChannelSpec { channel: Channel::CommandVy, name: "command-vy", input: "roll command", output: "vy", units: ["m/s", "rad"], ratio: ("m", -1), order: (0, 3), integrator: true, window_s: 2.0 },
];

impl Channel {
    /// Every name, in the order of the thesis.
    pub fn names() -> impl Iterator<Item = &'static str> {
        CHANNELS.iter().map(|c| c.name)
    }

    /// The channel of that name.
    ///
    /// # Errors
    /// With a proposal.
    pub fn from_name(name: &str) -> crazyflie_env::Result<Self> {
        let found = CHANNELS.iter().find(|c| c.name == name);
        found.map(|c| c.channel).ok_or_else(|| crazyflie_env::error::unknown("channel", name, Self::names()))
    }

    /// Names, units and usual form.
    pub fn spec(self) -> &'static ChannelSpec {
        // in the order of the enum; a test checks it
        &CHANNELS[self as usize]
    }

    /// The form that the thesis found for it.
    pub fn structure(self) -> Structure {
        let ChannelSpec { order: (numerator, denominator), integrator, .. } = *self.spec();
        let offset = if self == Channel::Pwm { Offset::Shared } else { Offset::None };
        Structure { numerator, denominator, integrator, delay: false, offset, stable: false }
    }
}

/// A held input and a sampled output, on one clock.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Name of the log.
    pub name: String,
    /// The input is in force from its time to the next one's.
    pub input_t_s: Vec<f64>,
    /// Values of the input, one per time, in the second unit of its [`Channel`].
    pub input: Vec<f64>,
    /// Times of the output's samples, on the same clock.
    pub output_t_s: Vec<f64>,
    /// Values of the output, one per time, in the first unit of its [`Channel`] or its integral.
    pub output: Vec<f64>,
    /// Interval to fit.
    pub span_s: [f64; 2],
    /// The output is the integral of what the transfer function gives: a position in place of a velocity that
    /// nobody measured.
    pub integrated: bool,
}

/// Shorter than this, there is nothing to see of a pole of 2.8 1/s.
const LEAST_S: f64 = 1.0;
const LEAST_SAMPLES: usize = 30;

impl Record {
    /// Cuts a channel out of the airborne part of a log.
    ///
    /// # Errors
    /// [`Error`]: the channel is missing, the flight too short.
    pub fn from_log(name: &str, log: &FlightLog, channel: Channel) -> Result<Self> {
        let missing = || Error::about(name, format!("no {} in this log", channel.spec().input));
        let input = input(log, channel).ok_or_else(missing)?;
        let (track, integrated) = output(name, log, channel)?;
        let flown = &log.t_s[log.airborne.clone()];
        let span_s = [flown.first().copied().unwrap_or(0.0), flown.last().copied().unwrap_or(0.0)];
        let inside = track.between(span_s[0], span_s[1]);
        let (seconds, samples) = (span_s[1] - span_s[0], inside.len());
        if seconds < LEAST_S || samples < LEAST_SAMPLES {
            let expected = format!("expected at least {LEAST_S:.1} s and {LEAST_SAMPLES} samples");
            let found = format!("only {seconds:.2} s of flight with {samples} samples");
            return Err(Error::about(name, format!("{found}, {expected}")));
        }
        let (name, input_t_s) = (name.to_owned(), log.t_s.clone());
        let (output_t_s, output) = (track.t_s[inside.clone()].to_vec(), track.values[inside].to_vec());
        Ok(Record { name, input_t_s, input, output_t_s, output, span_s, integrated })
    }

    /// Returns whether the input changes while the vehicle flies.
    pub fn is_excited(&self) -> bool {
        let rows = self.input_t_s.partition_point(|t| *t < self.span_s[0])
            ..self.input_t_s.partition_point(|t| *t <= self.span_s[1]);
        varies(&self.input[rows])
    }

    /// The input in force at a time.
    pub fn input_at(&self, t_s: f64) -> f64 {
        self.input[self.input_t_s.partition_point(|t| *t <= t_s).saturating_sub(1)]
    }
}

fn input(log: &FlightLog, channel: Channel) -> Option<Vec<f64>> {
    let (cos, sin): (Vec<f64>, Vec<f64>) = log.yaw_rad.iter().map(|yaw| (yaw.cos(), yaw.sin())).unzip();
    // the tilt along world x and against world y, from tilts about the vehicle's axes
    let rows = || 0..log.len();
    let along_x =
        |roll: &[f64], pitch: &[f64]| rows().map(|i| pitch[i] * cos[i] + roll[i] * sin[i]).collect();
    let along_y =
        |roll: &[f64], pitch: &[f64]| rows().map(|i| roll[i] * cos[i] - pitch[i] * sin[i]).collect();
    let commands = log.cmd_roll_rad.as_ref().zip(log.cmd_pitch_rad.as_ref());
    match channel {
        Channel::Roll => log.cmd_roll_rad.clone(),
        Channel::Pitch => log.cmd_pitch_rad.clone(),
        Channel::Yaw => log.cmd_yaw_rate_radps.clone(),
        // the height that a controller was told is what the thesis takes for the command (5.1.3)
        Channel::Height => {
            log.cmd_height_m.clone().or_else(|| log.setpoint_m.as_ref().map(|[_, _, z]| z.clone()))
        }
        Channel::Pwm => log.cmd_thrust_pwm.clone(),
        Channel::Vx => Some(between(along_x(&log.roll_rad, &log.pitch_rad))),
        Channel::Vy => Some(between(along_y(&log.roll_rad, &log.pitch_rad))),
        Channel::CommandVx => commands.map(|(roll, pitch)| along_x(roll, pitch)),
        Channel::CommandVy => commands.map(|(roll, pitch)| along_y(roll, pitch)),
    }
}

/// A sampled signal is not constant between samples: their mean is used between two, which is right to second order.
fn between(mut samples: Vec<f64>) -> Vec<f64> {
    for i in 1..samples.len() {
        samples[i - 1] = 0.5 * (samples[i - 1] + samples[i]);
    }
    samples
}

fn output(name: &str, log: &FlightLog, channel: Channel) -> Result<(Track, bool)> {
    let of_rows = |values: &Vec<f64>| Track { t_s: log.t_s.clone(), values: values.clone() };
    let axis = match channel {
        Channel::Roll => return Ok((of_rows(&log.roll_rad), false)),
        Channel::Pitch => return Ok((of_rows(&log.pitch_rad), false)),
        Channel::Yaw => return Ok((of_rows(&log.yaw_rad), false)),
        Channel::Vx | Channel::CommandVx => 0,
        Channel::Vy | Channel::CommandVy => 1,
        Channel::Height | Channel::Pwm => 2,
    };
    if let (Some(velocity), true) = (&log.vel_mps, axis < 2) {
        return Ok((of_rows(&velocity[axis]), false));
    }
    let measured = Measurements::from_log(log, &mut Vec::new()).map_err(|why| Error::about(name, why))?;
    // by their places among the signals of a replay: z, x, y
    let place = [6, 7, 3][axis];
    Ok((measured.track(place).clone(), axis < 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_stand_in_their_places() {
        for (place, about) in CHANNELS.iter().enumerate() {
            assert_eq!(about.channel as usize, place);
            assert_eq!(Channel::from_name(about.name), Ok(about.channel));
        }
        assert!(Channel::from_name("rol").unwrap_err().to_string().contains("did you mean \"roll\""));
    }

    #[test]
    fn a_sampled_signal_is_held_at_its_means() {
        assert_eq!(between(vec![0.0, 2.0, 6.0]), [1.0, 4.0, 6.0]);
    }
}
