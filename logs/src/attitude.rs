//! Attitude for a log without one: integrated from the gyro, or derived from the direction of the specific force.

use super::signal::centred_mean;

/// The accelerometer shakes with the motors: 2 to 4 degrees as read, below 1 degree over 0.15 s.
const AVERAGED_S: f64 = 0.15;

/// A unit quaternion that turns the body frame into the world frame: w, x, y, z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rotation([f64; 4]);

impl Rotation {
    /// From a recorded quaternion in ROS's order (x, y, z, w); `None` if it is no rotation.
    pub(super) fn from_xyzw([x, y, z, w]: [f64; 4]) -> Option<Self> {
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        // Quaternions that nobody filled are all zero; recorded ones are off by rounding.
        (norm.is_finite() && (norm - 1.0).abs() < 0.01).then(|| Self([w, x, y, z].map(|v| v / norm)))
    }

    /// Returns roll, pitch and yaw of columns x, y, z and w; `None` if a row is no rotation.
    pub(super) fn angles_of_columns([x, y, z, w]: &[Vec<f64>; 4]) -> Option<[Vec<f64>; 3]> {
        let mut angles = [const { Vec::new() }; 3];
        for row in 0..w.len() {
            let of_row = Self::from_xyzw([x[row], y[row], z[row], w[row]])?.angles();
            angles.iter_mut().zip(of_row).for_each(|(out, angle)| out.push(angle));
        }
        Some(angles)
    }

    #[cfg(test)]
    pub(super) fn xyzw(self) -> [f64; 4] {
        let Self([w, x, y, z]) = self;
        [x, y, z, w]
    }

    /// Roll about x after pitch about y after yaw about z.
    pub(super) fn from_angles([roll, pitch, yaw]: [f64; 3]) -> Self {
        let about = |axis: usize, angle: f64| {
            let mut q = [(0.5 * angle).cos(), 0.0, 0.0, 0.0];
            q[axis] = (0.5 * angle).sin();
            Self(q)
        };
        about(3, yaw).then(about(2, pitch)).then(about(1, roll))
    }

    /// Roll, pitch and yaw.
    pub(super) fn angles(self) -> [f64; 3] {
        let m = self.matrix();
        [m[2][1].atan2(m[2][2]), (-m[2][0]).clamp(-1.0, 1.0).asin(), m[1][0].atan2(m[0][0])]
    }

    /// This rotation and then, in the turned frame, another.
    pub(super) fn then(self, Self([w2, x2, y2, z2]): Self) -> Self {
        let Self([w1, x1, y1, z1]) = self;
        Self([
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ])
    }

    pub(super) fn inverse(self) -> Self {
        let Self([w, x, y, z]) = self;
        Self([w, -x, -y, -z])
    }

    /// A vector of the body frame in the world frame.
    pub(super) fn turn(self, v: [f64; 3]) -> [f64; 3] {
        self.matrix().map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    fn matrix(self) -> [[f64; 3]; 3] {
        let Self([w, x, y, z]) = self;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// Turned further at a body rate for a time.
    fn advance(self, rate_radps: [f64; 3], step_s: f64) -> Self {
        let norm = rate_radps.iter().map(|r| r * r).sum::<f64>().sqrt();
        let half = 0.5 * norm * step_s;
        if !(half.is_finite() && norm > 0.0) {
            return self;
        }
        let [x, y, z] = rate_radps.map(|r| r / norm * half.sin());
        let Self(q) = self.then(Self([half.cos(), x, y, z]));
        // Rounding would add up over hours.
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        Self(q.map(|v| v / length))
    }
}

/// Integrates roll, pitch and yaw from the gyro, by the trapezoidal rule (thesis, 6.3.1), on the rotation group
/// rather than axis by axis. Angles from `known` restart the integration. Yaw may wrap.
pub(super) fn integrate(
    t_s: &[f64],
    gyro_radps: &[Vec<f64>; 3],
    known: impl Fn(usize) -> Option<[f64; 3]>,
) -> [Vec<f64>; 3] {
    let mut rotation = Rotation::from_angles(known(0).unwrap_or([0.0; 3]));
    let mut angles = [const { Vec::new() }; 3];
    for row in 0..t_s.len() {
        if let Some(known) = known(row) {
            rotation = Rotation::from_angles(known);
        } else if row > 0 {
            let mean = gyro_radps.each_ref().map(|g| 0.5 * (g[row - 1] + g[row]));
            rotation = rotation.advance(mean, t_s[row] - t_s[row - 1]);
        }
        for (out, angle) in angles.iter_mut().zip(rotation.angles()) {
            out.push(angle);
        }
    }
    angles
}

/// Roll and pitch that point the thrust along the specific force (world frame, multiples of g, gravity taken
/// out), averaged; drag, which is small, is taken for tilt.
pub(super) fn tilt(t_s: &[f64], [ax, ay, az]: &[Vec<f64>; 3], yaw: &[f64]) -> [Vec<f64>; 2] {
    let [mut roll, mut pitch] = [const { Vec::new() }; 2];
    for (row, yaw) in yaw.iter().enumerate() {
        let (sin, cos) = yaw.sin_cos();
        let forward = ax[row] * cos + ay[row] * sin;
        let left = ay[row] * cos - ax[row] * sin;
        let up = az[row] + 1.0;
        pitch.push(forward.atan2(up));
        roll.push((-left).atan2((forward * forward + up * up).sqrt()));
    }
    [roll, pitch].map(|angle| centred_mean(t_s, &angle, AVERAGED_S))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-9)
    }

    #[test]
    fn angles_survive_the_quaternion() {
        for angles in [[0.1, -0.2, 0.3], [-3.0, 1.2, 2.9], [0.0; 3]] {
            let rotation = Rotation::from_angles(angles);
            assert!(close(rotation.angles(), angles));
            assert!(close(rotation.then(rotation.inverse()).angles(), [0.0; 3]));
        }
    }

    #[test]
    fn pitch_tips_the_thrust_forward_and_roll_to_the_right() {
        let up = [0.0, 0.0, 1.0];
        assert!(Rotation::from_angles([0.0, 0.1, 0.0]).turn(up)[0] > 0.09);
        assert!(Rotation::from_angles([0.1, 0.0, 0.0]).turn(up)[1] < -0.09);
        assert!(close(
            Rotation::from_angles([0.0, 0.0, 1.0]).turn([1.0, 0.0, 0.0]),
            [1_f64.cos(), 1_f64.sin(), 0.0]
        ));
    }

    #[test]
    fn a_steady_rate_gives_its_angle_and_known_rows_restart_it() {
        let t_s: Vec<f64> = (0..201).map(|i| f64::from(i) * 0.01).collect();
        let gyro = [vec![0.0; 201], vec![0.0; 201], vec![0.5; 201]];
        let [_, _, yaw] = integrate(&t_s, &gyro, |_| None);
        assert!((yaw[200] - 1.0).abs() < 1e-9);
        let [_, _, yaw] = integrate(&t_s, &gyro, |row| (row == 100).then_some([0.0; 3]));
        assert!((yaw[200] - 0.5).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        assert_eq!(Rotation::from_xyzw([0.0; 4]), None);
        assert_eq!(Rotation::from_xyzw([f64::NAN, 0.0, 0.0, 1.0]), None);
        assert!(Rotation::from_xyzw([0.0, 0.0, 0.0, 1.0]).is_some());
    }
}
