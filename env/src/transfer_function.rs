//! The model as transfer functions: one from each command to what it moves.

use nalgebra::Complex;

use crate::error::{Result, find_named};
use crate::model::{AxisForm, Model, VerticalInput};

/// Quantity that a command moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Roll angle, by the commanded roll.
    Roll,
    /// Pitch angle, by the commanded pitch.
    Pitch,
    /// Position along x, by the commanded pitch.
    X,
    /// Position along y, by the commanded roll.
    Y,
    /// Height, by the commanded height or thrust PWM.
    Z,
    /// Heading, by the commanded yaw rate.
    Yaw,
}

impl Channel {
    /// Every channel, attitude first.
    pub const ALL: [Channel; 6] =
        [Channel::Roll, Channel::Pitch, Channel::X, Channel::Y, Channel::Z, Channel::Yaw];

    /// Name for users.
    pub fn name(self) -> &'static str {
        match self {
            Channel::Roll => "roll",
            Channel::Pitch => "pitch",
            Channel::X => "x",
            Channel::Y => "y",
            Channel::Z => "z",
            Channel::Yaw => "yaw",
        }
    }

    /// The channel of that name.
    ///
    /// # Errors
    /// With a proposal, if there is none.
    pub fn find(name: &str) -> Result<Channel> {
        find_named("channel", name, Channel::ALL, |channel| channel.name())
    }
}

/// numerator(s) / denominator(s), coefficients with the highest power of s first.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferFunction {
    /// Coefficients of the numerator.
    pub numerator: Vec<f64>,
    /// Coefficients of the denominator; the first is 1.
    pub denominator: Vec<f64>,
}

impl TransferFunction {
    /// Value at a complex frequency, rad/s.
    pub fn response_at(&self, s: Complex<f64>) -> Complex<f64> {
        polynomial_at(&self.numerator, s) / polynomial_at(&self.denominator, s)
    }

    /// The product: one behind the other.
    #[must_use]
    pub fn in_series(&self, other: &TransferFunction) -> TransferFunction {
        TransferFunction {
            numerator: product(&self.numerator, &other.numerator),
            denominator: product(&self.denominator, &other.denominator),
        }
    }

    /// The same with its output multiplied.
    #[must_use]
    pub fn scaled(mut self, by: f64) -> TransferFunction {
        self.numerator.iter_mut().for_each(|c| *c *= by);
        self
    }
}

/// A polynomial, highest power first, by Horner's rule.
pub fn polynomial_at(coefficients: &[f64], s: Complex<f64>) -> Complex<f64> {
    coefficients.iter().fold(Complex::new(0.0, 0.0), |sum, c| sum * s + c)
}

/// The product of two polynomials.
pub fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut all = vec![0.0; a.len() + b.len() - 1];
    for (i, a) in a.iter().enumerate() {
        b.iter().enumerate().for_each(|(j, b)| all[i + j] += a * b);
    }
    all
}

impl Model {
    /// From the command of a channel (radians, rad/s, and PWM counts or metres) to its output (radians or
    /// metres), with the signs of [`Model::state_space`].
    ///
    /// # Errors
    /// For a vertical form that the model lacks.
    pub fn transfer_function(&self, channel: Channel, input: VerticalInput) -> Result<TransferFunction> {
        let (g, drag) = (self.lateral.gravity.value, self.lateral.drag.value);
        let [roll, pitch] = self.tilt_forms(input).map(|form| transfer_function_of(&form));
        // 5.1 times g / (s (s + drag)), 5.5 with the position
        let sideways = |angle: TransferFunction, g: f64| angle.in_series(&lag(g, drag, 0.0));
        Ok(match channel {
            Channel::Roll => roll,
            Channel::Pitch => pitch,
            Channel::X => sideways(pitch, g),
            Channel::Y => sideways(roll, -g),
            Channel::Yaw => transfer_function_of(&self.yaw_form(input)),
            Channel::Z => transfer_function_of(&self.vertical(input)?.form(g)),
        })
    }
}

/// Returns the transfer function of a form of first order (the input sets the rate) or of second order.
fn transfer_function_of(form: &AxisForm) -> TransferFunction {
    let AxisForm { a, u, .. } = form;
    if u[0] == 0.0 { lag(u[1], -a[1][1], -a[1][0]) } else { first_order(u[0], -a[0][0]) }
}

/// gain / (s + pole)
fn first_order(gain: f64, pole: f64) -> TransferFunction {
    TransferFunction { numerator: vec![gain], denominator: vec![1.0, pole] }
}

/// gain / (s^2 + damping s + stiffness)
fn lag(gain: f64, damping: f64, stiffness: f64) -> TransferFunction {
    TransferFunction { numerator: vec![gain], denominator: vec![1.0, damping, stiffness] }
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;

    /// State and command of a channel, as [`Model::state_space`] lists them.
    fn place(channel: Channel) -> (usize, usize) {
        match channel {
            Channel::Roll => (3, 0),
            Channel::Pitch => (4, 1),
            Channel::X => (0, 1),
            Channel::Y => (1, 0),
            Channel::Z => (2, 3),
            Channel::Yaw => (5, 2),
        }
    }

    #[test]
    fn every_transfer_function_is_that_of_the_state_space() {
        let model = Model::thesis();
        for input in VerticalInput::ALL {
            let space = model.state_space(input).unwrap();
            for channel in Channel::ALL {
                let function = model.transfer_function(channel, input).unwrap();
                let (state, command) = place(channel);
                for omega in [0.1, 1.0, 7.0, 40.0] {
                    let s = Complex::new(0.2, omega);
                    let resolvent = SMatrix::<Complex<f64>, 12, 12>::identity() * s
                        - space.a.map(|v| Complex::new(v, 0.0));
                    let b = space.b.column(command).map(|v| Complex::new(v, 0.0));
                    let expected = resolvent.lu().solve(&b).unwrap()[state];
                    let got = function.response_at(s);
                    assert!(
                        (got - expected).norm() <= 1e-9 * expected.norm(),
                        "{channel:?} {got} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn an_unknown_channel_gets_a_proposal() {
        let message = Channel::find("pich").unwrap_err().to_string();
        assert!(message.contains("\"pitch\"") && message.contains("yaw"), "{message}");
    }
}
