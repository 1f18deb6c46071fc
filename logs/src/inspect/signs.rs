//! Sign checks from the data: does the vehicle move as the signs of the log imply?

use serde::Serialize;

use crate::align::correlation;
use crate::series::{Interpolation, value_at};
use crate::signal::{acceleration_over, centred_mean};
use crate::skew::derivative;
use crate::{AttitudeSource, FlightLog, G_MPS2};

/// Both sides are averaged over this: the camera's noise of 5 mm is then 0.1 m/s2 of acceleration.
const AVERAGED_S: f64 = 0.5;
/// Beyond this correlation a sign is taken for seen: an eighth of the variance. Chosen by judgement, not set
/// on a split of recordings.
const SEEN: f64 = 0.35;
/// Loops and lags of a small vehicle answer within this time.
const LONGEST_LAG_S: f64 = 0.4;
const LAGS: usize = 9;
const LEAST_ROWS: usize = 50;
/// Without so much spread there is nothing to see: half a degree, and 0.03 rad/s.
const LEAST_RMS: f64 = 0.009;

/// The outcome of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SignVerdict {
    /// Both sides move together, as the sign implies.
    Agrees,
    /// The sides move against each other: the sign is wrong.
    Contradicts,
    /// The flight moves too little, or something else moves the vehicle.
    NotSeen,
}

/// One check of a sign.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignCheck {
    /// The expectation in words.
    pub expectation: &'static str,
    /// The channel whose sign is wrong if the data contradicts.
    pub channel: &'static str,
    /// Correlation of both sides, -1 to 1; of a command, at the delay where it is strongest.
    pub correlation: f64,
    /// Expected side per unit of the channel, by least squares.
    pub slope: f64,
    /// The slope that the right unit has; `None` where it differs from vehicle to vehicle.
    pub usual_slope: Option<f64>,
    /// Outcome of the check.
    pub verdict: SignVerdict,
}

/// Beyond this correlation a slope determines a unit: the scatter of the slope is then far below a factor of two.
const SLOPE_SEEN: f64 = 0.6;
/// Degrees for radians are a factor of 57; slopes of loops with lags and of noisy accelerations are off by
/// less than four.
const ANGLE_RATIO: std::ops::Range<f64> = 15.0..230.0;

/// Returns whether a ratio of slopes is that of degrees and radians.
pub(crate) fn is_angle_ratio(ratio: f64) -> bool {
    ANGLE_RATIO.contains(&ratio)
}

impl SignCheck {
    /// The slope against the usual one, where both are seen to move together: 57 or a 57th of it is the wrong
    /// unit.
    pub fn unit_ratio(&self) -> Option<f64> {
        self.usual_slope
            .filter(|_| self.correlation.abs() > SLOPE_SEEN)
            .map(|usual| (self.slope / usual).abs())
    }
}

/// All checks that the channels of a log allow.
pub(super) fn checks(log: &FlightLog) -> Vec<SignCheck> {
    let rows = log.airborne.clone();
    if rows.len() < LEAST_ROWS {
        return Vec::new();
    }
    let view = View { log, t_s: &log.t_s[rows.clone()] };
    let part = |values: &[f64]| values[rows.clone()].to_vec();
    let [roll, pitch, yaw] = [&log.roll_rad, &log.pitch_rad, &log.yaw_rad].map(|values| part(values));
    let mut checks = Vec::new();
    let acceleration = view.acceleration(&yaw);
    let measured = log.provenance.attitude != AttitudeSource::Motion;
    if let Some(Motion { forward, left, up, place_m, height_m }) = &acceleration {
        if measured {
            let expected = ("+pitch accelerates forward (+x at yaw 0)", "pitch");
            checks.push(view.tilt_check(expected, [&pitch, forward, &place_m[0]]));
            let expected = ("+roll accelerates to the right (-y at yaw 0)", "roll");
            checks.push(view.tilt_check(expected, [&negate(&roll), left, &place_m[1]]));
        }
        // a simulated vertical form without inertia has no thrust that accelerates
        if let Some(thrust) = log.cmd_thrust_pwm.as_ref().filter(|_| !log.is_simulated()) {
            checks.push(view.thrust_check(&part(thrust), up, &view.slopes(height_m)));
        }
    }
    let commands = [
        (("roll follows its command", "cmd_roll"), &log.cmd_roll_rad, &roll),
        (("pitch follows its command", "cmd_pitch"), &log.cmd_pitch_rad, &pitch),
    ];
    for (expected, command, angle) in commands.into_iter().filter(|_| measured) {
        checks.extend(command.as_ref().map(|command| view.lagged_check(expected, &part(command), angle)));
    }
    let rates = [&roll, &pitch, &yaw].map(|angle| view.slopes(angle));
    if let Some(command) = &log.cmd_yaw_rate_radps {
        let expected = ("the yaw rate follows its command (+ turns clockwise)", "cmd_yaw_rate");
        checks.push(view.lagged_check(expected, &negate(&part(command)), &rates[2]));
    }
    if let Some(gyro) = log.gyro_radps.as_ref().filter(|_| measured) {
        let names = [
            ("the gyro's x is the slope of roll", "gyro_x"),
            ("the gyro's y is the slope of pitch", "gyro_y"),
            ("the gyro's z is the slope of yaw", "gyro_z"),
        ];
        for (expected, (gyro, rate)) in names.into_iter().zip(gyro.iter().zip(&rates)) {
            checks.push(view.averaged_check(expected, &part(gyro), rate));
        }
    }
    if let Some([_, _, z]) = &log.acc_mps2 {
        let mean = part(z).iter().sum::<f64>() / rows.len() as f64;
        let verdict = if mean > 0.0 { SignVerdict::Agrees } else { SignVerdict::Contradicts };
        let expectation = "the accelerometer's z is about +9.81 m/s2 in flight";
        let (correlation, slope) = (1.0_f64.copysign(mean), mean / G_MPS2);
        let channel = "acc_z";
        checks.push(SignCheck { expectation, channel, correlation, slope, usual_slope: None, verdict });
    }
    checks
}

/// Acceleration forward, to the left and up, the place forward and to the left, and the height.
struct Motion {
    forward: Vec<f64>,
    left: Vec<f64>,
    up: Vec<f64>,
    place_m: [Vec<f64>; 2],
    height_m: Vec<f64>,
}

/// An expectation in words, and the channel whose sign it shows.
type Expectation = (&'static str, &'static str);

/// The rows of the flight.
struct View<'a> {
    log: &'a FlightLog,
    t_s: &'a [f64],
}

impl View<'_> {
    /// Acceleration and place, from the fixes.
    fn acceleration(&self, yaw_rad: &[f64]) -> Option<Motion> {
        let fixes = &self.log.fixes;
        let mut order: Vec<usize> = (0..fixes.row.len()).collect();
        order.sort_by(|a, b| fixes.capture_t_s[*a].total_cmp(&fixes.capture_t_s[*b]));
        order.dedup_by(|later, earlier| fixes.capture_t_s[*later] == fixes.capture_t_s[*earlier]);
        if order.len() < LEAST_ROWS {
            return None;
        }
        let t_s: Vec<f64> = order.iter().map(|at| fixes.capture_t_s[*at]).collect();
        let pos_m = fixes.pos_m.each_ref().map(|axis| order.iter().map(|at| axis[*at]).collect::<Vec<f64>>());
        let at_rows = |values: Vec<f64>| -> Vec<f64> {
            self.t_s.iter().map(|t| value_at(&t_s, &values, *t, Interpolation::Line, None)).collect()
        };
        let [x, y, up] = acceleration_over(&t_s, &pos_m, 0.5 * AVERAGED_S).map(at_rows);
        let turned = |[x, y]: [&[f64]; 2]| {
            let turn = |row: usize| {
                let (sin, cos) = yaw_rad[row].sin_cos();
                [x[row] * cos + y[row] * sin, y[row] * cos - x[row] * sin]
            };
            [0, 1].map(|axis| (0..self.t_s.len()).map(|row| turn(row)[axis]).collect::<Vec<f64>>())
        };
        let [forward, left] = turned([&x, &y]);
        let [place_x, place_y, height_m] = pos_m.map(at_rows);
        Some(Motion { forward, left, up, place_m: turned([&place_x, &place_y]), height_m })
    }

    fn slopes(&self, angle_rad: &[f64]) -> Vec<f64> {
        derivative(self.t_s, &centred_mean(self.t_s, angle_rad, 0.1))
    }

    /// A check of two channels that go together, both averaged.
    fn averaged_check(&self, expected: Expectation, measured: &[f64], answer: &[f64]) -> SignCheck {
        let [measured, answer] = [measured, answer].map(|values| centred_mean(self.t_s, values, AVERAGED_S));
        check_sign(expected, &measured, &answer)
    }

    /// A check of a tilt and the acceleration along it. A force that goes with the place may outweigh a tilt that
    /// works against it: a sign is not wrong that is right at a constant place.
    fn tilt_check(&self, expected: Expectation, sides: [&[f64]; 3]) -> SignCheck {
        let [tilt, acceleration, place_m] = sides.map(|values| centred_mean(self.t_s, values, AVERAGED_S));
        let mut check = check_sign(expected, &tilt, &acceleration);
        let [both, by_tilt, by_acceleration] = [
            correlation(&tilt, &acceleration),
            correlation(&tilt, &place_m),
            correlation(&acceleration, &place_m),
        ];
        let rest = ((1.0 - by_tilt * by_tilt) * (1.0 - by_acceleration * by_acceleration)).sqrt();
        if check.verdict == SignVerdict::Contradicts && both - by_tilt * by_acceleration > SEEN * rest {
            check.verdict = SignVerdict::NotSeen;
        }
        check
    }

    /// A check of the thrust. The climb shows the sign if it follows more closely than the acceleration does, as in a
    /// vehicle whose damping outweighs its inertia.
    fn thrust_check(&self, thrust_pwm: &[f64], up_mps2: &[f64], climb_mps: &[f64]) -> SignCheck {
        let check = self.lagged_check(("more thrust accelerates upwards", "cmd_thrust"), thrust_pwm, up_mps2);
        let by_climb = self.lagged_check(("more thrust climbs faster", "cmd_thrust"), thrust_pwm, climb_mps);
        let is_clearer = by_climb.correlation > check.correlation.abs();
        if is_clearer && by_climb.verdict == SignVerdict::Agrees { by_climb } else { check }
    }

    /// Checks a command and its later answer, at the lag of the largest correlation.
    fn lagged_check(&self, expected: Expectation, command: &[f64], answer: &[f64]) -> SignCheck {
        let checks = (0..LAGS).map(|lag| {
            let later_s = LONGEST_LAG_S * lag as f64 / (LAGS - 1) as f64;
            let later = |t: &f64| value_at(self.t_s, answer, t + later_s, Interpolation::Line, None);
            self.averaged_check(expected, command, &self.t_s.iter().map(later).collect::<Vec<_>>())
        });
        let first = self.averaged_check(expected, command, answer);
        checks.fold(
            first,
            |best, next| {
                if next.correlation.abs() > best.correlation.abs() { next } else { best }
            },
        )
    }
}

fn check_sign((expectation, channel): Expectation, measured: &[f64], expected: &[f64]) -> SignCheck {
    let correlation = correlation(measured, expected);
    let standard_deviation = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    };
    let (moved, answered) = (standard_deviation(measured), standard_deviation(expected));
    let slope = if moved > 0.0 { correlation * answered / moved } else { 0.0 };
    let verdict = match correlation {
        _ if moved < LEAST_RMS || answered < LEAST_RMS => SignVerdict::NotSeen,
        r if r > SEEN => SignVerdict::Agrees,
        r if r < -SEEN => SignVerdict::Contradicts,
        _ => SignVerdict::NotSeen,
    };
    SignCheck { expectation, channel, correlation, slope, usual_slope: usual_slope(channel), verdict }
}

/// Acceleration per angle of a vehicle that hovers; an angle per its command and a slope per the gyro.
fn usual_slope(channel: &str) -> Option<f64> {
    match channel {
        "roll" | "pitch" => Some(G_MPS2),
        "cmd_roll" | "cmd_pitch" | "cmd_yaw_rate" | "gyro_x" | "gyro_y" | "gyro_z" => Some(1.0),
        _ => None,
    }
}

fn negate(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| -v).collect()
}
