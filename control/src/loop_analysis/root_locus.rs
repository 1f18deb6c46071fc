//! Poles of a closed loop, and how they wander with the gain.

use crazyflie_env::transfer_function::TransferFunction;
#[cfg(test)]
use crazyflie_env::transfer_function::product;
use nalgebra::{Complex, DMatrix};

use super::FeedbackLoop;

impl FeedbackLoop {
    /// Poles of the closed loop, 1/s, for multiples of kp, ki and kd, the dead time by its Padé approximation of second order.
    pub fn root_locus(&self, factors: &[f64]) -> Vec<Vec<Complex<f64>>> {
        let open = self.open().in_series(&pade(self.dead_time_s));
        let poles = |factor: f64| {
            let lead = open.denominator.len().saturating_sub(open.numerator.len());
            let added = |i: usize| i.checked_sub(lead).map_or(0.0, |k| factor * open.numerator[k]);
            let closed = open.denominator.iter().enumerate().map(|(i, d)| d + added(i));
            roots(&closed.collect::<Vec<f64>>())
        };
        factors.iter().map(|factor| poles(*factor)).collect()
    }
}

/// exp(-T s) as (T^2 s^2 / 12 - T s / 2 + 1) / (T^2 s^2 / 12 + T s / 2 + 1), made monic.
fn pade(dead_time_s: f64) -> TransferFunction {
    if dead_time_s <= 0.0 {
        return TransferFunction { numerator: vec![1.0], denominator: vec![1.0] };
    }
    let [first, last] = [6.0 / dead_time_s, 12.0 / dead_time_s.powi(2)];
    TransferFunction { numerator: vec![1.0, -first, last], denominator: vec![1.0, first, last] }
}

/// Roots of a polynomial, highest power first: eigenvalues of its companion matrix. A constant has none.
pub fn roots(coefficients: &[f64]) -> Vec<Complex<f64>> {
    let Some(first) = coefficients.iter().position(|c| *c != 0.0) else { return Vec::new() };
    let monic: Vec<f64> = coefficients[first + 1..].iter().map(|c| c / coefficients[first]).collect();
    let order = monic.len();
    if order == 0 {
        return Vec::new();
    }
    let companion = DMatrix::from_fn(order, order, |row, column| match (row, column) {
        (0, _) => -monic[column],
        _ if row == column + 1 => 1.0,
        _ => 0.0,
    });
    companion.complex_eigenvalues().iter().copied().collect()
}

/// The polynomial with these roots, highest power first; complex ones in pairs.
#[cfg(test)]
fn polynomial(roots: &[f64]) -> Vec<f64> {
    roots.iter().fold(vec![1.0], |all, root| product(&all, &[1.0, -root]))
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::{Model, VerticalInput};

    use super::*;
    use crate::loop_analysis::LoopAxis;
    use crate::pid::Gains;

    #[test]
    fn roots_of_a_product_are_its_factors() {
        let wanted = [-30.0, -2.0, -0.5, 4.0];
        let mut real_parts: Vec<f64> = roots(&polynomial(&wanted)).iter().map(|root| root.re).collect();
        real_parts.sort_by(f64::total_cmp);
        assert!(real_parts.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{real_parts:?}");
    }

    #[test]
    fn a_constant_has_no_roots() {
        assert!(roots(&[0.0, 3.0]).is_empty() && roots(&[0.0]).is_empty());
    }

    /// Multiplying the gains by the gain margin puts a pole on the imaginary axis.
    #[test]
    fn a_pole_crosses_at_the_gain_margin() {
        let model = Model::thesis();
        let own = FeedbackLoop::from_model(&model, VerticalInput::Thrust, LoopAxis::X, &Gains::THESIS, 0.077);
        let own = own.unwrap();
        let most = 10.0_f64.powf(own.margins().gain_db / 20.0);
        let rightmost = |factor: f64| {
            let poles = own.root_locus(&[factor]).swap_remove(0);
            poles.iter().map(|pole| pole.re).fold(f64::NEG_INFINITY, f64::max)
        };
        assert!(rightmost(0.9 * most) < 0.0 && rightmost(1.1 * most) > 0.0, "{most}");
    }
}
