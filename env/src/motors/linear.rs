//! The motor-level form for small angles near the hover: what a controller believes of it.

use super::loops::{ANGLE_D, ANGLE_P, DEG, RATE_D, rate_gains};
use super::turn_per_thrust;
use crate::model::{AxisForm, FULL_PWM, Model, Motors, Vertical, VerticalInput};

impl Model {
    /// The differential equations of roll and pitch, where that height input is commanded. The motor-level form
    /// has loops of its own: its motor lag and the integrals of its loops are left out here.
    pub fn tilt_forms(&self, input: VerticalInput) -> [AxisForm; 2] {
        match self.motor_form(input) {
            None => [&self.roll, &self.pitch].map(|tilt| tilt.form()),
            Some(form) => [0, 1].map(|axis| {
                // a rate's output moves two motors on each side by a half
                let per_count = 2.0 * turn_per_thrust(self, form)[axis] * form.mps2_per_pwm(self);
                let (gain, damping) = closed_loop(form, axis, per_count);
                AxisForm::second_order(gain, damping, gain, 0.0)
            }),
        }
    }

    /// The differential equation of yaw, as [`Model::tilt_forms`].
    pub fn yaw_form(&self, input: VerticalInput) -> AxisForm {
        match self.motor_form(input) {
            None => self.yaw.form(),
            // the heading follows the sum of the commanded rates by its slow pole
            Some(form) => {
                let per_count = 4.0 * turn_per_thrust(self, form)[2] * form.mps2_per_pwm(self);
                let (gain, damping) = closed_loop(form, 2, per_count);
                let bandwidth = gain / damping;
                AxisForm::second_order(self.yaw.sign() * bandwidth, bandwidth, 0.0, 0.0)
            }
        }
    }

    fn motor_form(&self, input: VerticalInput) -> Option<&Motors> {
        match &self.vertical.motors {
            Some(Vertical::Motors(form)) if input == VerticalInput::Motors => Some(form),
            _ => None,
        }
    }
}

/// Returns the attitude loop around the rate loop around 1 / s^2, as angle / commanded angle = gain / (s^2 + damping
/// s + gain); `per_count` is the angular acceleration per count of the mixer's input.
fn closed_loop(form: &Motors, axis: usize, per_count: f64) -> (f64, f64) {
    let [proportional, _] = rate_gains(&form.attitude_loop);
    let [rate_p, rate_d] = [proportional, RATE_D].map(|gains| gains[axis] * DEG * per_count);
    let damped = 1.0 + rate_d;
    (rate_p * ANGLE_P[axis] / damped, rate_p * (1.0 + ANGLE_D[axis]) / damped)
}

impl Motors {
    /// Growth of a motor's thrust per mass of the vehicle, per PWM count, at the hover.
    fn mps2_per_pwm(&self, model: &Model) -> f64 {
        0.25 * model.lateral.gravity.value * self.slope()
    }

    /// Thrust at a PWM over the thrust at full PWM.
    pub fn curve(&self, pwm: f64) -> f64 {
        let (share, linear) = (pwm / FULL_PWM, self.linear_share.value);
        share * (linear + (1.0 - linear) * share)
    }

    /// The PWM of a thrust, over the thrust at full PWM: the inverse of [`Motors::curve`].
    pub fn pwm_of(&self, thrust: f64) -> f64 {
        let linear = self.linear_share.value;
        let square = 1.0 - linear;
        // the root that stays where the square goes
        FULL_PWM * 2.0 * thrust / (linear + (linear * linear + 4.0 * square * thrust).sqrt())
    }

    /// Growth of thrust over weight per PWM count, at the hover.
    pub(crate) fn slope(&self) -> f64 {
        let (share, linear) = (self.hover.value / FULL_PWM, self.linear_share.value);
        (linear + 2.0 * (1.0 - linear) * share) / FULL_PWM / self.curve(self.hover.value)
    }
}
