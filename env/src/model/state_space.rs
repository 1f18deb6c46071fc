//! The model as matrices.

use nalgebra::{SMatrix, SVector};

use super::{Model, VerticalInput};
use crate::error::Result;

/// x' = A x + B u, y = C x + D u   (thesis 4.14)
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace {
    /// System matrix A; [`crate::model::Model::state_space`] lists the states.
    pub a: SMatrix<f64, 12, 12>,
    /// Input matrix B, commands in SI units and PWM counts.
    pub b: SMatrix<f64, 12, 4>,
    /// Output matrix C, one row per measured quantity.
    pub c: SMatrix<f64, 7, 12>,
    /// Direct feed-through of a command: the climb rate of a first-order vertical form, and nothing else.
    pub d: SMatrix<f64, 7, 4>,
}

impl Model {
    /// The 12-state form (thesis 4.14, 4.15): A, B and C for the states (x y z, roll pitch yaw, their rates), the
    /// inputs (roll, pitch, yaw rate, height or PWM above its offset), the outputs (z, roll, pitch, yaw, vx, vy, vz).
    /// The drag terms are on the diagonal and roll accelerates to -y, as in a right-handed frame. A first-order
    /// vertical or yaw form has its pole on the position itself. The motor-level form is that of small angles near
    /// the hover.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] if the model has no such vertical form.
    pub fn state_space(&self, input: VerticalInput) -> Result<StateSpace> {
        let mut a = SMatrix::<f64, 12, 12>::zeros();
        let mut b = SMatrix::<f64, 12, 4>::zeros();
        let (g, k) = (self.lateral.gravity.value, self.lateral.drag.value);
        for i in 0..2 {
            a[(i, 6 + i)] = 1.0;
            a[(3 + i, 9 + i)] = 1.0;
            a[(6 + i, 6 + i)] = -k;
        }
        a[(6, 4)] = g;
        a[(7, 3)] = -g;
        for (i, tilt) in self.tilt_forms(input).into_iter().enumerate() {
            a[(9 + i, 3 + i)] = tilt.a[1][0];
            a[(9 + i, 9 + i)] = tilt.a[1][1];
            b[(9 + i, i)] = tilt.u[1];
        }
        for (x, w, u, form) in [(5, 11, 2, self.yaw_form(input)), (2, 8, 3, self.vertical(input)?.form(g))] {
            for (row, i) in [(x, 0), (w, 1)] {
                a[(row, x)] = form.a[i][0];
                a[(row, w)] = form.a[i][1];
                b[(row, u)] = form.u[i];
            }
        }
        let mut c = SMatrix::<f64, 7, 12>::zeros();
        for (row, state) in [2, 3, 4, 5, 6, 7, 8].into_iter().enumerate() {
            c[(row, state)] = 1.0;
        }
        // a first-order form has no state for the velocity: the measured vz is the derivative of z
        c.set_row(6, &a.row(2));
        let mut d = SMatrix::<f64, 7, 4>::zeros();
        d.set_row(6, &b.row(2));
        Ok(StateSpace { a, b, c, d })
    }
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
