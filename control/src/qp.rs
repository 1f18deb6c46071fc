//! The quadratic program of one axis over a receding horizon.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};
use nalgebra::{SMatrix, SVector};

use super::observer::DiscreteModel;
use super::riccati::solve;
use crazyflie_env::error::{Error, Result};

/// Number of moves that are decided, and the ticks of each: fine where it matters, one second in all at 50 Hz.
const MOVES: usize = 10;
const HOLD: [usize; MOVES] = [1, 1, 2, 2, 4, 4, 6, 8, 10, 12];
/// States of an axis, at most; missing ones are zeros.
const STATES: usize = 4;

type State = SVector<f64, STATES>;

/// Minimise the sum of x' Q x + r d^2 over the horizon and x' P x at its end, with limits on every move d.
pub(super) struct Horizon {
    /// Half the gradient at the state x is `slope * x`; without limits the moves are `-free * x`.
    slope: SMatrix<f64, MOVES, STATES>,
    free: SMatrix<f64, MOVES, STATES>,
    solver: DefaultSolver<f64>,
    /// The solver's linear cost, kept to avoid allocations.
    gradient: Vec<f64>,
    limits: Vec<f64>,
}

impl Horizon {
    /// Creates the problem of the states that one command moves, with the costs of all twelve states and of that
    /// command.
    ///
    /// # Errors
    /// The errors of [`solve`].
    pub(super) fn new(
        model: &DiscreteModel,
        states: &[usize],
        input: usize,
        q: &SVector<f64, 12>,
        r: f64,
    ) -> Result<Self> {
        let (mut a, mut b, mut cost) =
            (SMatrix::<f64, STATES, STATES>::zeros(), State::zeros(), State::zeros());
        for (i, from) in states.iter().enumerate() {
            (b[i], cost[i]) = (model.b[(*from, input)], q[*from]);
            for (j, to) in states.iter().enumerate() {
                a[(i, j)] = model.a[(*from, *to)];
            }
        }
        let end = solve(&a, &b, &cost, &SVector::<f64, 1>::new(r))?;
        let (mut hessian, mut slope) =
            (SMatrix::<f64, MOVES, MOVES>::zeros(), SMatrix::<f64, MOVES, STATES>::zeros());
        // the state as a function of the moves and of the state now
        let (mut by_moves, mut by_state) =
            (SMatrix::<f64, STATES, MOVES>::zeros(), SMatrix::<f64, STATES, STATES>::identity());
        let every = SMatrix::from_diagonal(&cost);
        for held in HOLD.iter().enumerate().flat_map(|(held, ticks)| std::iter::repeat_n(held, *ticks)) {
            hessian += by_moves.transpose() * every * by_moves;
            slope += by_moves.transpose() * every * by_state;
            hessian[(held, held)] += r;
            by_moves = a * by_moves;
            by_moves.column_mut(held).axpy(1.0, &b, 1.0);
            by_state = a * by_state;
        }
        hessian += by_moves.transpose() * end * by_moves;
        slope += by_moves.transpose() * end * by_state;
        let inverse = hessian
            .try_inverse()
            .ok_or_else(|| Error::Config("the horizon has no unique best moves".into()))?;
        let solver = solver(&hessian)?;
        let (gradient, limits) = (vec![0.0; MOVES], vec![0.0; 2 * MOVES]);
        Ok(Horizon { slope, free: inverse * slope, solver, gradient, limits })
    }

    /// The first of the best moves from `x` with every move within the limits.
    pub(super) fn first_move(&mut self, x: &[f64; STATES], [least, most]: [f64; 2]) -> f64 {
        let x = State::from(*x);
        let free = -(self.free * x);
        if free.iter().all(|d| (least..=most).contains(d)) {
            // the optimum without limits keeps them: it is the optimum
            return free[0];
        }
        self.gradient.copy_from_slice((self.slope * x).as_slice());
        self.limits[..MOVES].fill(most);
        self.limits[MOVES..].fill(-least);
        let told = self.solver.update_q(&self.gradient).is_ok() && self.solver.update_b(&self.limits).is_ok();
        if told {
            self.solver.solve();
        }
        let solved =
            told && matches!(self.solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
        let best = if solved { self.solver.solution.x[0] } else { free[0] };
        best.clamp(least, most)
    }
}

/// For d' H d / 2 with limits above and below every move.
fn solver(hessian: &SMatrix<f64, MOVES, MOVES>) -> Result<DefaultSolver<f64>> {
    let (mut row, mut column, mut value) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..MOVES {
        for i in 0..=j {
            row.push(i);
            column.push(j);
            value.push(hessian[(i, j)]);
        }
    }
    let p = CscMatrix::new_from_triplets(MOVES, MOVES, row, column, value);
    let both = (0..2 * MOVES).map(|i| if i < MOVES { 1.0 } else { -1.0 }).collect();
    let (rows, columns) = (0..2 * MOVES).map(|i| (i, i % MOVES)).unzip();
    let limits = CscMatrix::new_from_triplets(2 * MOVES, MOVES, rows, columns, both);
    let settings = DefaultSettings {
        verbose: false,
        presolve_enable: false,
        input_sparse_dropzeros: false,
        max_iter: 50,
        ..DefaultSettings::default()
    };
    let cones = [NonnegativeConeT(2 * MOVES)];
    DefaultSolver::new(&p, &[0.0; MOVES], &limits, &[1.0; 2 * MOVES], &cones, settings)
        .map_err(|e| Error::Config(format!("the quadratic program cannot be set up: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ControllerContext, Mode};
    use crazyflie_env::action::Interface;
    use crazyflie_env::model::{Model, VerticalInput};

    fn horizon() -> Horizon {
        let model = Model::thesis();
        let interface = Interface::from_model(&model, VerticalInput::Thrust).unwrap();
        let site =
            ControllerContext { model: &model, interface, tick_s: 0.02, envs: 1, mode: Mode::Automatic };
        let q = SVector::from([100.0, 100.0, 100.0, 0.0, 0.0, 30.0, 6.0, 6.0, 0.0, 0.0, 0.0, 0.0]);
        Horizon::new(&DiscreteModel::from_context(&site).unwrap(), &[0, 4, 6, 10], 1, &q, 130.0).unwrap()
    }

    /// Within the limits the horizon with the Riccati solution at its end is the LQR, whatever its length and
    /// blocks; a limit far away is none.
    #[test]
    fn the_solver_agrees_with_the_formula() {
        let mut h = horizon();
        let x = [0.05, 0.01, -0.1, 0.2];
        let free = h.first_move(&x, [-1e3, 1e3]);
        let far = -(h.free * State::from(x));
        let limit = far.iter().fold(0.0_f64, |most, d| most.max(d.abs())) * 0.999;
        let just = h.first_move(&x, [-limit, limit]);
        assert!((free - just).abs() < 0.01 * free.abs(), "{free} {just}");
    }

    #[test]
    fn a_limit_that_binds_is_kept_and_braking_comes_before_the_goal() {
        let mut h = horizon();
        let most = 0.17;
        assert!(
            (h.first_move(&[-0.8, 0.0, 0.0, 0.0], [-most, most]) - most).abs() < 1e-6,
            "far off: full tilt towards it"
        );
        assert!(
            (h.first_move(&[-0.2, 0.0, 1.2, 0.0], [-most, most]) + most).abs() < 1e-6,
            "fast and near: full tilt against it"
        );
    }
}
