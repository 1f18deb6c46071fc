//! The model as matrices.

use nalgebra::{SMatrix, SVector};

/// x' = A x + B u, y = C x + D u   (thesis 4.14)
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace {
    /// System matrix A; [`crate::model::Model::state_space`] lists the states.
    pub a: SMatrix<f64, 12, 12>,
    /// Input matrix B, commands in SI units and PWM counts.
    pub b: SMatrix<f64, 12, 4>,
    /// Output matrix C, one row per measured quantity.
    pub c: SMatrix<f64, 7, 12>,
    /// What a command changes at once: the climb rate of a first-order vertical form, and nothing else.
    pub d: SMatrix<f64, 7, 4>,
}

impl StateSpace {
    /// A and B over `duration_s` with the input held: exact, by the matrix exponential of the augmented
    /// system.
    pub fn discrete(&self, duration_s: f64) -> (SMatrix<f64, 12, 12>, SMatrix<f64, 12, 4>) {
        let mut augmented = SMatrix::<f64, 16, 16>::zeros();
        augmented.fixed_view_mut::<12, 12>(0, 0).copy_from(&self.a);
        augmented.fixed_view_mut::<12, 4>(0, 12).copy_from(&self.b);
        let e = (augmented * duration_s).exp();
        (e.fixed_view::<12, 12>(0, 0).into_owned(), e.fixed_view::<12, 4>(0, 12).into_owned())
    }

    /// The state after `duration_s` with the input held.
    pub fn advance(&self, x: &SVector<f64, 12>, u: &SVector<f64, 4>, duration_s: f64) -> SVector<f64, 12> {
        let (a, b) = self.discrete(duration_s);
        a * x + b * u
    }
}
