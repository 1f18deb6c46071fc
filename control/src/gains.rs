//! Gains of the PID, as data.

use serde::{Deserialize, Serialize};

/// One loop: output = kp e + ki clamp(sum e dt) + kd de/dt, clamped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loop {
    /// Proportional gain, output per unit of the error.
    pub kp: f64,
    /// Integral gain, output per unit of the integrated error.
    pub ki: f64,
    /// Derivative gain, output per unit of the rate of the error.
    pub kd: f64,
    /// Limits of the integral of the error.
    pub integral: [f64; 2],
    /// Limits of the output, in its own unit.
    pub output: [f64; 2],
}

/// The four loops. Pitch (x) and roll (y) give degrees per metre, yaw deg/s per radian, height PWM counts per
/// metre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// Loop that turns the error along x into a pitch.
    pub x: Loop,
    /// Loop that turns the error along y into a roll.
    pub y: Loop,
    /// Loop that turns the error of the height into a thrust.
    pub z: Loop,
    /// Loop that turns the error of the heading into a yaw rate.
    pub yaw: Loop,
}

const fn gains(kp: f64, ki: f64, kd: f64, integral: f64, output: [f64; 2]) -> Loop {
    Loop { kp, ki, kd, integral: [-integral, integral], output }
}

impl Gains {
    /// Table 7.1, "new": what the thesis's PID tuner found. The table has no integral clamps; the package's
    /// are used.
    pub const THESIS: Gains = Gains {
        x: gains(12.0, 0.06, 10.0, 0.1, [-10.0, 10.0]),
        y: gains(12.0, 0.06, 10.0, 0.1, [-10.0, 10.0]),
        z: gains(10781.90, 5196.65, 638.14, 1000.0, [0.0, 60000.0]),
        yaw: gains(20.0, 0.0, 5.0, 0.0, [-200.0, 200.0]),
    };

    /// `crazyflie_ros` defaults (config/crazyflie2.yaml): the package that the thesis calls "old", which it
    /// does not print.
    pub const CRAZYFLIE_ROS: Gains = Gains {
        x: gains(40.0, 2.0, 20.0, 0.1, [-10.0, 10.0]),
        y: gains(40.0, 2.0, 20.0, 0.1, [-10.0, 10.0]),
        z: gains(5000.0, 3500.0, 6000.0, 1000.0, [10000.0, 60000.0]),
        yaw: gains(200.0, 0.0, 20.0, 0.0, [-200.0, 200.0]),
    };

    /// The height loop in parts of the PWM that carries the vehicle: the same acceleration per metre on a
    /// vehicle with another hover PWM as on the thesis's (39 342.5, read off 5.4).
    #[must_use]
    pub fn for_hover(mut self, hover_pwm: f64) -> Gains {
        let by = hover_pwm / THESIS_HOVER_PWM;
        let z = &mut self.z;
        (z.kp, z.ki, z.kd) = (by * z.kp, by * z.ki, by * z.kd);
        z.output = z.output.map(|limit| by * limit);
        self
    }

    /// Refuses gains that cannot be flown.
    ///
    /// # Errors
    /// Values that are not numbers, or limits in the wrong order.
    pub fn check(&self) -> std::result::Result<(), String> {
        for (name, l) in [("x", &self.x), ("y", &self.y), ("z", &self.z), ("yaw", &self.yaw)] {
            if [l.kp, l.ki, l.kd].iter().chain(&l.integral).chain(&l.output).any(|v| !v.is_finite()) {
                return Err(format!("the loop {name} is {l:?}, expected finite numbers"));
            }
            if l.integral[0] > l.integral[1] || l.output[0] > l.output[1] {
                return Err(format!(
                    "the loop {name} has the limits {:?} and {:?}, expected the lower one first",
                    l.integral, l.output
                ));
            }
        }
        Ok(())
    }
}

/// PWM that carries the thesis's vehicle by 5.4.
const THESIS_HOVER_PWM: f64 = 39_342.5;
