//! Motor-level form of a quadrotor: rotor speeds in, rigid-body motion out. Generic over the number type, so
//! that a fit carries derivatives through the same formulas.

use crazyflie_env::scalar::Scalar;

/// Standard gravity.
const G_MPS2: f64 = 9.81;
/// Mixing signs of roll, pitch and yaw by motor: 1 front right, 2 back right, 3 back left, 4 front left.
/// Positive pitch lowers the nose; motors 1 and 3 turn counter-clockwise and push the frame clockwise.
const SIGNS: [[f64; 4]; 3] = [[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]];

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

const fn parameter(
    name: &'static str,
    unit: &'static str,
    [start, low, high]: [f64; 3],
    about: &'static str,
) -> Parameter {
    Parameter { name, unit, start, low, high, about }
}

/// Number of parameters.
pub const PARAMETERS: usize = 13;

/// All parameters, in the order of the arrays below. Speeds are in parts of their median, so that thrust is
/// near gravity on every vehicle. Negative authority is unphysical: a controller that fights a disturbance
/// would pass for it.
pub const FORM: [Parameter; PARAMETERS] = [
    parameter(
        "thrust",
        "m/s^2",
        [9.81, 5.0, 15.0],
        "specific thrust at the median rotor speed, c sum w^2 / m",
    ),
    parameter("motor_lag", "s", [0.05, 0.002, 0.3], "time constant of the rotor speeds"),
    parameter(
        "roll_authority",
        "rad/s^2",
        [40.0, 0.0, 1000.0],
        "roll acceleration per w^2 of left less right",
    ),
    parameter(
        "pitch_authority",
        "rad/s^2",
        [40.0, 0.0, 1000.0],
        "pitch acceleration per w^2 of back less front",
    ),
    parameter(
        "yaw_authority",
        "rad/s^2",
        [5.0, 0.0, 200.0],
        "yaw acceleration per w^2 of motors 2 and 4 less 1 and 3",
    ),
    parameter("drag_x", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's x axis"),
    parameter("drag_y", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's y axis"),
    parameter("drag_z", "1/s", [0.3, 0.0, 3.0], "linear drag along the body's z axis"),
    parameter("roll_damping", "1/s", [8.0, 0.0, 60.0], "damping of the roll rate"),
    parameter("pitch_damping", "1/s", [8.0, 0.0, 60.0], "damping of the pitch rate"),
    parameter("yaw_damping", "1/s", [3.0, 0.0, 60.0], "damping of the yaw rate"),
    parameter(
        "thrust_memory",
        "s",
        [0.3, 0.05, 10.0],
        "time over which the start of a prediction learns thrust scale and marker tilt from the past",
    ),
    parameter(
        "torque_memory",
        "s",
        [5.0, 0.05, 60.0],
        "time over which it learns the torque of an off-centre mass",
    ),
];

/// Position, velocity (world), roll, pitch and yaw, body rates.
pub(crate) type MotionState<R> = [R; 12];

/// Specific force and angular acceleration in the body frame that stay for a prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotorTrim<R> {
    pub force_mps2: [R; 3],
    pub torque_radps2: [R; 3],
}

impl<R: Scalar> MotorTrim<R> {
    pub(crate) fn zero() -> Self {
        Self { force_mps2: [R::zero(); 3], torque_radps2: [R::zero(); 3] }
    }
}

/// Rows of the rotation from the body frame to the world, roll after pitch after yaw.
pub(crate) fn rotation<R: Scalar>([roll, pitch, yaw]: [R; 3]) -> [[R; 3]; 3] {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

/// A world vector in the body frame.
pub(crate) fn into_body<R: Scalar>(m: &[[R; 3]; 3], v: [R; 3]) -> [R; 3] {
    std::array::from_fn(|i| m[0][i] * v[0] + m[1][i] * v[1] + m[2][i] * v[2])
}

/// Rotor speeds a step later: first order towards what is commanded.
pub(crate) fn lag_rotors<R: Scalar>(
    p: &[R; PARAMETERS],
    speeds: [R; 4],
    commanded: [f64; 4],
    step_s: f64,
) -> [R; 4] {
    let gain = R::from_f64(1.0) - (-R::from_f64(step_s) / p[1]).exp();
    std::array::from_fn(|i| speeds[i] + gain * (R::from_f64(commanded[i]) - speeds[i]))
}

/// Specific force and angular acceleration in the body frame, without trim.
pub(crate) fn accelerations<R: Scalar>(
    p: &[R; PARAMETERS],
    x: &MotionState<R>,
    turn: &[[R; 3]; 3],
    speeds: &[R; 4],
) -> MotorTrim<R> {
    let squares = speeds.map(|w| w * w);
    let sum = |signs: [f64; 4]| {
        let [a, b, c, d]: [R; 4] = std::array::from_fn(|i| R::from_f64(0.25 * signs[i]) * squares[i]);
        a + b + c + d
    };
    let velocity = into_body(turn, [x[3], x[4], x[5]]);
    MotorTrim {
        force_mps2: [-(p[5] * velocity[0]), -(p[6] * velocity[1]), p[0] * sum([1.0; 4]) - p[7] * velocity[2]],
        torque_radps2: std::array::from_fn(|i| p[2 + i] * sum(SIGNS[i]) - p[8 + i] * x[9 + i]),
    }
}

/// The motion a step later. Rates and velocity by Euler, attitude and position by the mean over the step.
pub(crate) fn step<R: Scalar>(
    p: &[R; PARAMETERS],
    x: &MotionState<R>,
    speeds: &[R; 4],
    trim: &MotorTrim<R>,
    step_s: f64,
) -> MotionState<R> {
    let turn = rotation([x[6], x[7], x[8]]);
    let model = accelerations(p, x, &turn, speeds);
    let force: [R; 3] = std::array::from_fn(|i| model.force_mps2[i] + trim.force_mps2[i]);
    let (dt, half) = (R::from_f64(step_s), R::from_f64(0.5 * step_s));
    let acceleration: [R; 3] = std::array::from_fn(|i| {
        let turned = turn[i][0] * force[0] + turn[i][1] * force[1] + turn[i][2] * force[2];
        if i == 2 { turned - R::from_f64(G_MPS2) } else { turned }
    });
    let torque: [R; 3] = std::array::from_fn(|i| model.torque_radps2[i] + trim.torque_radps2[i]);
    let [roll, pitch, yaw]: [R; 3] = std::array::from_fn(|i| x[9 + i] + half * torque[i]);
    let (sin, cos) = x[6].sin_cos();
    let (_, cos_pitch) = x[7].sin_cos();
    let across = pitch * sin + yaw * cos;
    let turning = [roll + x[7].tan() * across, pitch * cos - yaw * sin, across / cos_pitch];
    std::array::from_fn(|i| match i {
        0..3 => x[i] + dt * (x[3 + i] + half * acceleration[i]),
        3..6 => x[i] + dt * acceleration[i - 3],
        6..9 => x[i] + dt * turning[i - 6],
        _ => x[i] + dt * torque[i - 9],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start_values() -> [f64; PARAMETERS] {
        FORM.map(|p| p.start)
    }

    #[test]
    fn hover_speeds_hover() {
        let mut x = [0.0; 12];
        x[2] = 1.0;
        let trim = MotorTrim::zero();
        for _ in 0..100 {
            x = step(&start_values(), &x, &[1.0; 4], &trim, 0.01);
        }
        assert!((x[2] - 1.0).abs() < 1e-9 && x[3..].iter().all(|v| v.abs() < 1e-9), "{x:?}");
    }

    #[test]
    fn motors_turn_the_vehicle_the_way_they_stand() {
        let rates = |speeds: [f64; 4]| {
            step(&start_values(), &[0.0; 12], &speeds, &MotorTrim::zero(), 0.01)[9..].to_vec()
        };
        // left: to the right; back: nose down; 1 and 3, counter-clockwise: frame clockwise
        assert!(
            rates([1.0, 1.0, 1.1, 1.1])[0] > 0.0
                && rates([1.0, 1.1, 1.1, 1.0])[1] > 0.0
                && rates([1.1, 1.0, 1.1, 1.0])[2] < 0.0
        );
        let tilted = step(
            &start_values(),
            &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0],
            &[1.0; 4],
            &MotorTrim::zero(),
            0.01,
        );
        assert!(tilted[3] > 0.0 && tilted[4] < 0.0, "{tilted:?}");
    }

    #[test]
    fn rotors_follow_with_their_time_constant() {
        let p = start_values();
        let mut speeds = [1.0; 4];
        for _ in 0..5 {
            speeds = lag_rotors(&p, speeds, [2.0; 4], 0.01);
        }
        assert!((speeds[0] - (2.0 - (-1.0_f64).exp())).abs() < 1e-9, "{speeds:?}");
    }
}
