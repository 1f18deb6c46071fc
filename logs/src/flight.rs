//! The one shape of a flight.

use crazyflie_statistics::quantile;
use std::ops::Range;

use crate::{Note, Provenance, signal};

/// A stretch at the start or the end that shows a vehicle at rest.
const RESTING_S: f64 = 0.5;
const LEAST_RESTING: usize = 5;
/// A camera's fixes of a vehicle at rest scatter by a centimetre.
const RESTING_SPREAD_M: f64 = 0.03;
/// A flight rises higher than this.
const LEAST_CLIMB_M: f64 = 0.15;
/// A command that is a larger share of the flight's carries the vehicle.
const CARRYING_SHARE: f64 = 0.7;
/// Height above its resting place at which a vehicle flies: NanoBench's rest at 0.053 to 0.072 m and fly above 0.1 m.
const OVER_REST_M: f64 = 0.05;
/// With a smaller share of the flight's thrust the motors idle.
const ON_SHARE: f64 = 0.3;
/// Over a longer gap nobody knows what was commanded: a flight ends there.
pub(crate) const LONGEST_GAP_S: f64 = 0.5;
/// Two voltages or three arrive by radio in this time.
const STEADY_S: f64 = 1.0;

/// Position measurements, each with the time it was captured. They exist only where one arrived: k fixes, k
/// <= rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Fixes {
    /// Row of the log in which the fix arrived, ascending.
    pub row: Vec<usize>,
    /// When the picture was taken, on the clock of `t_s`; about 50 ms before arrival for a camera,
    /// equal to the row's time for motion capture. In order of arrival, see [`Note::CaptureOutOfOrder`].
    pub capture_t_s: Vec<f64>,
    /// x, y, z.
    pub pos_m: [Vec<f64>; 3],
    /// Yaw of the marker, where the format has it, as recorded (may wrap).
    pub yaw_rad: Option<Vec<f64>>,
}

/// The vehicle's own estimates, one value per row. NanoBench has them on their own clock, see
/// [`Note::ClockSkew`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Onboard {
    /// Position in the world frame: x, y, z.
    pub pos_m: Option<[Vec<f64>; 3]>,
    /// Velocity in the world frame: x, y, z.
    pub vel_mps: Option<[Vec<f64>; 3]>,
    /// Roll, pitch and yaw; yaw continuous.
    pub attitude_rad: Option<[Vec<f64>; 3]>,
    /// The four motor commands after battery compensation, counts.
    pub motor_pwm: Option<[Vec<f64>; 4]>,
    /// Rate of the yaw setpoint, right-handed (yaw' = +rate). The firmware's yaw-rate command is not logged.
    pub setpoint_yaw_rate_radps: Option<Vec<f64>>,
    /// Body rates that the attitude loop commands, right-handed.
    pub cmd_rates_radps: Option<[Vec<f64>; 3]>,
    /// Moments that the attitude loop commands about the body's axes, right-handed.
    pub cmd_torque_nm: Option<[Vec<f64>; 3]>,
    /// Requests of the mixer to the four motors before battery compensation, counts: their mean is the thrust
    /// command, their differences are the moments that the rate controller needs to keep the vehicle
    /// straight.
    pub motor_request_pwm: Option<[Vec<f64>; 4]>,
    /// Speeds of the four rotors.
    pub rotor_radps: Option<[Vec<f64>; 4]>,
    /// Acceleration in the world frame, gravity taken out.
    pub acc_world_mps2: Option<[Vec<f64>; 3]>,
    /// Specific force along the body's z axis, for a log that has no more of it than that.
    pub acc_z_mps2: Option<Vec<f64>>,
    /// Delay of onboard data, including the commands, against the motion of the row, if its clock drifts: data of
    /// time `t` is at `t` plus this. Nothing was shifted.
    pub late_s: Option<Vec<f64>>,
}

/// Ground truth of a simulator. One value per row.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Position in the world frame: x, y, z.
    pub pos_m: [Vec<f64>; 3],
    /// Velocity in the world frame: x, y, z.
    pub vel_mps: [Vec<f64>; 3],
    /// Roll; positive accelerates to -y.
    pub roll_rad: Vec<f64>,
    /// Pitch; positive accelerates to +x.
    pub pitch_rad: Vec<f64>,
    /// Continuous.
    pub yaw_rad: Vec<f64>,
}

/// One flight. SI units and radians; right-handed, z up, +pitch accelerates to +x, +roll to -y.
///
/// Every `Vec` outside [`Fixes`] has one finite value per row. A channel that the file lacks, or whose packets never
/// arrived, is `None`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FlightLog {
    /// Origin of the channels.
    pub provenance: Provenance,
    /// Time of each row, strictly increasing.
    pub t_s: Vec<f64>,
    /// Rows during which the vehicle flies, empty if it never does: 5 cm above its resting height, with the motors
    /// on, the longest part between gaps; all rows if it is never at rest. The ends fly through ground effect: see
    /// [`FlightLog::interval_above`].
    pub airborne: Range<usize>,

    /// Roll setpoint of the attitude loop; positive accelerates to -y.
    pub cmd_roll_rad: Option<Vec<f64>>,
    /// Pitch setpoint of the attitude loop; positive accelerates to +x.
    pub cmd_pitch_rad: Option<Vec<f64>>,
    /// With the thesis's sign: yaw' = -cmd.
    pub cmd_yaw_rate_radps: Option<Vec<f64>>,
    /// Thrust command before any battery compensation, 0..65535.
    pub cmd_thrust_pwm: Option<Vec<f64>>,
    /// Height setpoint of the vehicle's own height loop, where that is the lift command.
    pub cmd_height_m: Option<Vec<f64>>,
    /// NanoBench logs (0, 0, 0) before and after the flight, meaning "no setpoint".
    pub setpoint_m: Option<[Vec<f64>; 3]>,
    /// Yaw set-point as recorded (may wrap).
    pub setpoint_yaw_rad: Option<Vec<f64>>,

    /// Camera fixes, or motion capture (one fix per row), or the vehicle's estimate where nothing else
    /// measured it, see [`Note::PositionEstimated`].
    pub fixes: Fixes,
    /// Measured velocity in the world frame (motion capture only).
    pub vel_mps: Option<[Vec<f64>; 3]>,
    /// Measured attitude: motion capture for NanoBench, else the vehicle's IMU estimate.
    pub roll_rad: Vec<f64>,
    /// Measured pitch, from the instrument that measured roll.
    pub pitch_rad: Vec<f64>,
    /// Continuous (no wraps).
    pub yaw_rad: Vec<f64>,
    /// Angular rate in the body frame.
    pub gyro_radps: Option<[Vec<f64>; 3]>,
    /// Specific force in the body frame: +9.81 on z at rest.
    pub acc_mps2: Option<[Vec<f64>; 3]>,
    /// Battery voltage.
    pub vbat_v: Option<Vec<f64>>,

    /// Estimates and motor commands of the vehicle itself.
    pub onboard: Option<Onboard>,
    /// Ground truth, in logs of a simulator.
    pub truth: Option<Truth>,
    /// Everything that was detected, cut or converted.
    pub notes: Vec<Note>,
}

impl Fixes {
    /// A fix in every row, of its time.
    pub(crate) fn in_every_row(t_s: &[f64], pos_m: [Vec<f64>; 3]) -> Self {
        Self { row: (0..t_s.len()).collect(), capture_t_s: t_s.to_vec(), pos_m, yaw_rad: None }
    }
}

impl FlightLog {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Returns whether the log has no rows (no reader returns such a log).
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Returns whether a simulator wrote the log. A simulated vehicle makes up for its battery's voltage: its motors get
    /// what is commanded.
    pub fn is_simulated(&self) -> bool {
        self.truth.is_some()
    }

    /// The longest interval of rows during which the vehicle stays above `height_m`, empty if there is none.
    ///
    /// Dips shorter than 0.5 s are bridged: they are outliers of the marker. Between fixes the last one counts;
    /// without any fix the true height is used, if the log has it.
    pub fn interval_above(&self, height_m: f64) -> Range<usize> {
        let true_z = || Some(self.truth.as_ref()?.pos_m[2].clone());
        let z = signal::height_by_row(self.len(), &self.fixes).or_else(true_z);
        z.map_or(0..0, |z| signal::longest_above(&self.t_s, &z, height_m))
    }

    /// Returns the longest interval of rows during which the motors together give more than this share of full PWM,
    /// empty if the log has no motors. Dips shorter than 0.5 s are bridged.
    pub fn interval_driven(&self, share: f64) -> Range<usize> {
        let mean = self.mean_motor_pwm();
        mean.map_or(0..0, |mean| signal::longest_above(&self.t_s, &mean, share * 65_535.0))
    }

    /// Returns the height of the vehicle at rest before take-off or, if the log starts in the air, after landing.
    /// `None` if it does neither, or never leaves that height. A vehicle whose motors run as in flight is not at
    /// rest, however still it is.
    pub fn resting_height_m(&self) -> Option<f64> {
        let z = &self.fixes.pos_m[2];
        let (first_s, last_s) = (*self.fixes.capture_t_s.first()?, *self.fixes.capture_t_s.last()?);
        let (bottom, top) = (quantile(z, 0.02).unwrap_or(0.0), quantile(z, 0.95).unwrap_or(0.0));
        let still = |from_s: f64| {
            let within = |t: &f64| (from_s..=from_s + RESTING_S).contains(t);
            let seen: Vec<f64> =
                self.fixes.capture_t_s.iter().zip(z).filter(|(t, _)| within(t)).map(|(_, z)| *z).collect();
            let height_m = quantile(&seen, 0.5).unwrap_or(0.0);
            let spread_m = quantile(&seen, 0.9).unwrap_or(0.0) - quantile(&seen, 0.1).unwrap_or(0.0);
            // against the flight's; none if no thrust is logged
            let thrust = self.thrust_share(from_s..from_s + RESTING_S);
            let hangs = thrust.is_some_and(|share| share > CARRYING_SHARE);
            // motors that carry later only tell of a flight, however low it is
            let climbs = height_m < top - LEAST_CLIMB_M || thrust.is_some_and(|share| share < ON_SHARE);
            let is_lowest = !hangs && height_m < bottom + RESTING_SPREAD_M && climbs;
            (seen.len() >= LEAST_RESTING && spread_m < RESTING_SPREAD_M && is_lowest).then_some(height_m)
        };
        still(first_s).or_else(|| still(last_s - RESTING_S))
    }

    /// The PWM that would give the motors the same mean voltage from a battery of `reference_v`: their mean
    /// PWM times the voltage, over the reference. `None` where the log lacks either. The voltage is averaged
    /// over a second, see [`FlightLog::steady_voltage_v`].
    pub fn motor_pwm_at(&self, reference_v: f64) -> Option<Vec<f64>> {
        let (mean, voltage_v) = (self.mean_motor_pwm()?, self.steady_voltage_v()?);
        Some(mean.iter().zip(voltage_v).map(|(mean, voltage_v)| mean * voltage_v / reference_v).collect())
    }

    fn mean_motor_pwm(&self) -> Option<Vec<f64>> {
        let [m1, m2, m3, m4] = self.onboard.as_ref()?.motor_pwm.as_ref()?;
        Some((0..self.len()).map(|row| (m1[row] + m2[row] + m3[row] + m4[row]) / 4.0).collect())
    }

    /// Returns the battery's voltage without the load that its rate aliases. Channels by radio that are interpolated
    /// give two voltages a second, each at the momentary load of the motors: this is the mean over a second.
    /// (Vertical velocities 2 s ahead were off by 0.181 m/s for it and by 0.195 m/s without, on eleven flights, each
    /// part predicted from the others.) Other logs keep the voltage as logged.
    pub fn steady_voltage_v(&self) -> Option<Vec<f64>> {
        let voltage_v = self.vbat_v.as_ref()?;
        if !self.provenance.onboard_interpolated {
            return Some(voltage_v.clone());
        }
        let mean = |t_s: &f64| {
            let first = self.t_s.partition_point(|t| *t < t_s - STEADY_S / 2.0);
            let rows = first..self.t_s.partition_point(|t| *t <= t_s + STEADY_S / 2.0);
            voltage_v[rows.clone()].iter().sum::<f64>() / rows.len() as f64
        };
        Some(self.t_s.iter().map(mean).collect())
    }

    /// The thrust command of a stretch against that of the flight.
    fn thrust_share(&self, stretch_s: Range<f64>) -> Option<f64> {
        let thrust = self.cmd_thrust_pwm.as_ref()?;
        let within: Vec<f64> =
            self.t_s.iter().zip(thrust).filter(|(t, _)| stretch_s.contains(t)).map(|(_, pwm)| *pwm).collect();
        let usual = quantile(thrust, 0.75).filter(|usual| *usual > 0.0)?;
        Some(quantile(&within, 0.5)? / usual)
    }

    /// A flight of these rows in which nothing is known yet.
    pub(crate) fn empty(provenance: Provenance, t_s: Vec<f64>) -> Self {
        let zero = vec![0.0; t_s.len()];
        Self {
            provenance,
            roll_rad: zero.clone(),
            pitch_rad: zero.clone(),
            yaw_rad: zero,
            t_s,
            ..Self::default()
        }
    }

    /// The log with the reader's notes before its own.
    pub(crate) fn with_notes(mut self, mut notes: Vec<Note>) -> Self {
        notes.append(&mut self.notes);
        Self { notes, ..self }
    }

    /// Fills `airborne`: above the resting height with the motors on; if the vehicle is not at rest before or after,
    /// above `otherwise_m`, or the whole log. A flight ends at a gap.
    pub(crate) fn find_airborne_over_rest(&mut self, otherwise_m: Option<f64>) {
        let rest_m = self.resting_height_m().map(|rest_m| rest_m + OVER_REST_M);
        match rest_m.or(otherwise_m) {
            None if self.fixes.row.is_empty() => self.find_airborne(OVER_REST_M),
            None => self.airborne = 0..self.len(),
            Some(above_m) => {
                self.find_airborne(above_m);
                if rest_m.is_some() {
                    self.airborne = self.low_flight(above_m).unwrap_or(self.airborne.clone());
                }
            }
        }
        self.end_at_gaps();
    }

    /// The longest stretch with the motors on, from where it first is above a height to where it last is: a
    /// hover close to the floor dips below.
    fn low_flight(&self, above_m: f64) -> Option<Range<usize>> {
        let z = signal::height_by_row(self.len(), &self.fixes)?;
        let thrust = self.cmd_thrust_pwm.as_ref()?;
        let usual = quantile(thrust, 0.75).filter(|usual| *usual > 0.0)?;
        let carried = signal::longest_above(&self.t_s, thrust, ON_SHARE * usual);
        let heights = &z[carried.clone()];
        // a hover below the usual take-off height: a quarter of its median height over the floor
        let rest_m = above_m - OVER_REST_M;
        let low_m = rest_m + 0.25 * (quantile(heights, 0.5)? - rest_m);
        let is_above = |z: &f64| *z > above_m.min(low_m);
        let first = heights.iter().position(is_above)?;
        let last = heights.iter().rposition(is_above)?;
        (last > first).then(|| carried.start + first..carried.start + last + 1)
    }

    /// Leaves of `airborne` the longest part that no gap parts.
    fn end_at_gaps(&mut self) {
        let rows = self.airborne.clone();
        let is_gap = |row: &usize| self.t_s[*row] - self.t_s[row - 1] > LONGEST_GAP_S;
        let mut starts: Vec<usize> = vec![rows.start];
        starts.extend((rows.start + 1..rows.end).filter(is_gap));
        let ends = starts.iter().skip(1).copied().chain([rows.end]);
        let parts = starts.iter().zip(ends).map(|(from, to)| *from..to);
        self.airborne = parts.max_by_key(|part| (part.len(), usize::MAX - part.start)).unwrap_or(rows);
    }

    /// Fills `airborne` up to a gap, and notes if there is no such interval.
    pub(crate) fn find_airborne(&mut self, above_m: f64) {
        self.airborne = self.interval_above(above_m);
        self.end_at_gaps();
        if self.fixes.row.is_empty() && self.truth.is_none() {
            self.notes.push(Note::NoPosition);
        } else if self.airborne.is_empty() {
            self.notes.push(Note::NeverAirborne { above_m });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AttitudeSource, PositionSource};

    /// Three seconds at 10 Hz; the voltage falls from 4 V to 3 V in the middle.
    fn log(onboard_interpolated: bool) -> FlightLog {
        let provenance = Provenance {
            format: "test",
            position: PositionSource::MotionCapture,
            attitude: AttitudeSource::MotionCapture,
            onboard_interpolated,
        };
        let mut log = FlightLog::empty(provenance, (0..30).map(|i| f64::from(i) / 10.0).collect());
        log.vbat_v = Some((0..30).map(|i| if i < 15 { 4.0 } else { 3.0 }).collect());
        let motor = |pwm: f64| vec![pwm; 30];
        log.onboard = Some(Onboard {
            motor_pwm: Some([motor(39e3), motor(41e3), motor(38e3), motor(42e3)]),
            ..Onboard::default()
        });
        log
    }

    #[test]
    fn the_motors_get_their_mean_pwm_times_the_voltage() {
        let pwm = log(false).motor_pwm_at(3.2).unwrap();
        assert!((pwm[0] - 50e3).abs() < 1e-6 && (pwm[14] - 50e3).abs() < 1e-6, "{pwm:?}");
        assert!((pwm[15] - 37.5e3).abs() < 1e-6, "{pwm:?}");
        let without = |change: &dyn Fn(&mut FlightLog)| {
            let mut log = log(false);
            change(&mut log);
            log.motor_pwm_at(3.2)
        };
        assert_eq!(without(&|log| log.vbat_v = None), None);
        assert_eq!(without(&|log| log.onboard = None), None);
    }

    #[test]
    fn a_voltage_that_came_by_radio_is_the_mean_over_a_second() {
        assert_eq!(log(false).steady_voltage_v().unwrap()[14], 4.0);
        let steady_v = log(true).steady_voltage_v().unwrap();
        assert_eq!((steady_v[0], steady_v[9], steady_v[29]), (4.0, 4.0, 3.0));
        // 1.4 s: rows of 0.9 to 1.9 s, six of eleven before the fall
        assert!((steady_v[14] - (6.0 * 4.0 + 5.0 * 3.0) / 11.0).abs() < 1e-12, "{steady_v:?}");
    }
}
