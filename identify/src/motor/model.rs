//! Motor-level form of a quadrotor: rotor speeds in, motion of the simulator's rigid body out. Generic over the
//! number type, so that a fit carries derivatives through the same formulas.

use crazyflie_env::model::FULL_PWM;
use crazyflie_env::motors::{Attitude, Motion, RigidBody};
use crazyflie_env::plant::Accelerations;
use crazyflie_env::scalar::{Scalar, dot};
use crazyflie_env::vector::state_index::{PITCH, POS, RATE, ROLL, VEL, YAW};

use super::flight::STEP_S;

/// Standard gravity.
pub(super) const G_MPS2: f64 = 9.81;
/// Steps of the body in a row of a flight, of the simulator's length.
const STEPS: usize = 5;

/// A parameter of the form: name, unit, start of a fit, bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Identifier in snake case, for tables.
    pub name: &'static str,
    /// Unit of the start, the bounds and the fitted value.
    pub unit: &'static str,
    /// Value from which a fit starts.
    pub start: f64,
    /// Lower bound of a fit.
    pub low: f64,
    /// Upper bound of a fit.
    pub high: f64,
    /// Physical meaning in a few words.
    pub about: &'static str,
}

const fn row(name: &'static str, unit: &'static str, range: [f64; 3], about: &'static str) -> Parameter {
    let [start, low, high] = range;
    Parameter { name, unit, start, low, high, about }
}

/// Number of parameters.
pub const PARAMETERS: usize = 13;

/// All parameters, in the order of the arrays below. Speeds are in parts of their median, so that thrust is
/// near gravity on every vehicle. Negative authority is unphysical: a controller that fights a disturbance
/// would pass for it.
pub const FORM: [Parameter; PARAMETERS] = [
    row("thrust", "m/s^2", [9.81, 5.0, 15.0], "specific thrust at the median rotor speed, c sum w^2 / m"),
    row("motor_lag", "s", [0.05, 0.002, 0.3], "time constant of the rotor speeds"),
    row("roll_authority", "rad/s^2", [40.0, 0.0, 1000.0], "roll acceleration per w^2 of left less right"),
    row("pitch_authority", "rad/s^2", [40.0, 0.0, 1000.0], "pitch acceleration per w^2 of back less front"),
    row(
        "yaw_authority",
        "rad/s^2",
        [5.0, 0.0, 200.0],
        "yaw acceleration per w^2 of motors 2 and 4 less 1 and 3",
    ),
    row("drag_x", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's x axis"),
    row("drag_y", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's y axis"),
    row("drag_z", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's z axis"),
    row("roll_damping", "1/s", [8.0, 0.0, 60.0], "damping of the roll rate"),
    row("pitch_damping", "1/s", [8.0, 0.0, 60.0], "damping of the pitch rate"),
    row("yaw_damping", "1/s", [3.0, 0.0, 60.0], "damping of the yaw rate"),
    row(
        "thrust_memory",
        "s",
        [0.3, 0.05, 10.0],
        "time over which the start of a prediction learns thrust scale and marker tilt from the past",
    ),
    row(
        "torque_memory",
        "s",
        [5.0, 0.05, 60.0],
        "time over which it learns the torque of an off-centre mass",
    ),
];

/// Position, velocity (world), roll, pitch and yaw, body rates.
pub(super) type MotionRow<R> = [R; 12];

/// A vehicle of this form. Its motors give full PWM at the median speed, and thrust by the square of the speed.
pub(super) struct MotorForm<R> {
    p: [R; PARAMETERS],
    body: RigidBody<R>,
    median_speed: f64,
}

impl<R: Scalar> MotorForm<R> {
    pub(super) fn new(p: [R; PARAMETERS], median_speed: f64) -> Self {
        let (zero, step_s) = (R::zero(), R::from_f64(STEP_S / STEPS as f64));
        let body = RigidBody {
            step_s,
            gravity_mps2: R::from_f64(G_MPS2),
            drag_ps: zero,
            heave_ps: zero,
            follow: [R::from_f64(1.0) - (-step_s / p[1]).exp(); 2],
            linear_share: zero,
            most_mps2: R::from_f64(0.25) * p[0],
            turn_per_thrust: [p[2] / p[0], p[3] / p[0], p[4] / p[0]],
            gyroscopic: [zero; 3],
        };
        Self { p, body, median_speed }
    }

    /// Time over which the trim of the force and that of the torque is learnt.
    pub(super) fn memories_s(&self) -> [R; 2] {
        [self.p[11], self.p[12]]
    }

    /// PWM of motors at these speeds.
    pub(super) fn pwm(&self, speeds: [f64; 4]) -> [R; 4] {
        speeds.map(|w| R::from_f64(w / self.median_speed * FULL_PWM))
    }

    /// Moves the motion and the PWM of the motors one row on. The commanded speeds and the trim, which is in the body
    /// frame, are constant.
    pub(super) fn advance(
        &self,
        motion: &mut Motion<R>,
        pwm: &mut [R; 4],
        commanded: [f64; 4],
        trim: &Accelerations<R>,
    ) {
        let commanded = self.pwm(commanded);
        for _ in 0..STEPS {
            let turn = motion.attitude.rotation();
            let velocity = into_body(&turn, motion.vel_mps);
            let force = std::array::from_fn(|i| trim.acc_mps2[i] - self.p[5 + i] * velocity[i]);
            let damping = |i: usize| self.p[8 + i] * motion.rate_radps[i];
            let torque = std::array::from_fn(|i| trim.ang_radps2[i] - damping(i));
            let push = Accelerations { acc_mps2: turn.map(|row| dot(&row, force)), ang_radps2: torque };
            self.body.step(motion, pwm, commanded, &push);
        }
    }
}

/// A world vector in the body frame.
pub(super) fn into_body<R: Scalar>(turn: &[[R; 3]; 3], v: [R; 3]) -> [R; 3] {
    std::array::from_fn(|i| dot(&[turn[0][i], turn[1][i], turn[2][i]], v))
}

pub(super) fn attitude<R: Scalar>(row: &MotionRow<R>) -> Attitude<R> {
    Attitude::new([row[ROLL], row[PITCH], row[YAW]])
}

pub(super) fn motion_of_row<R: Scalar>(row: &MotionRow<f64>) -> Motion<R> {
    let three = |first: usize| std::array::from_fn(|i| R::from_f64(row[first + i]));
    let (pos_m, vel_mps, rate_radps) = (three(POS), three(VEL), three(RATE));
    Motion { pos_m, vel_mps, attitude: Attitude::new(three(ROLL)), rate_radps }
}

pub(super) fn row_of_motion<R: Scalar>(motion: &Motion<R>) -> MotionRow<R> {
    let parts = [motion.pos_m, motion.vel_mps, motion.attitude.angles_rad(), motion.rate_radps];
    std::array::from_fn(|i| parts[i / 3][i % 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of motion and the motors some rows later, without trim: `speeds` and commands in parts of the median.
    fn after(
        rows: usize,
        row: MotionRow<f64>,
        speeds: [f64; 4],
        commanded: [f64; 4],
    ) -> (MotionRow<f64>, [f64; 4]) {
        let form = MotorForm::new(FORM.map(|p| p.start), 1.0);
        let (mut motion, mut pwm) = (motion_of_row(&row), form.pwm(speeds));
        for _ in 0..rows {
            form.advance(&mut motion, &mut pwm, commanded, &Accelerations::none());
        }
        (row_of_motion(&motion), pwm.map(|pwm| pwm / FULL_PWM))
    }

    #[test]
    fn hover_speeds_hover() {
        let (row, _) = after(100, [0.0; 12], [1.0; 4], [1.0; 4]);
        assert!(row.iter().all(|v| v.abs() < 1e-9), "{row:?}");
    }

    #[test]
    fn motors_turn_the_vehicle_the_way_they_stand() {
        let rates = |speeds: [f64; 4]| after(1, [0.0; 12], speeds, speeds).0[9..].to_vec();
        // left: to the right; back: nose down; 1 and 3, counter-clockwise: frame clockwise
        assert!(
            rates([1.0, 1.0, 1.1, 1.1])[0] > 0.0
                && rates([1.0, 1.1, 1.1, 1.0])[1] > 0.0
                && rates([1.1, 1.0, 1.1, 1.0])[2] < 0.0
        );
        let tilted = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0];
        let (row, _) = after(1, tilted, [1.0; 4], [1.0; 4]);
        assert!(row[VEL] > 0.0 && row[VEL + 1] < 0.0, "{row:?}");
    }

    /// Seen from the front of a vehicle that heads to +y, the world's +x is on the left.
    #[test]
    fn drag_is_along_the_bodys_axes() {
        let mut row = [0.0; 12];
        (row[VEL], row[YAW]) = (1.0, std::f64::consts::FRAC_PI_2);
        let mut p = FORM.map(|p| p.start);
        (p[5], p[6]) = (0.0, 2.0);
        let (mut motion, mut pwm) = (motion_of_row(&row), [FULL_PWM; 4]);
        MotorForm::new(p, 1.0).advance(&mut motion, &mut pwm, [1.0; 4], &Accelerations::none());
        assert!((motion.vel_mps[0] - (-2.0 * STEP_S).exp()).abs() < 1e-4, "{motion:?}");
    }

    #[test]
    fn rotors_follow_with_their_time_constant() {
        let (_, speeds) = after(5, [0.0; 12], [1.0; 4], [2.0; 4]);
        assert!((speeds[0] - (2.0 - (-1.0_f64).exp())).abs() < 1e-9, "{speeds:?}");
    }
}
