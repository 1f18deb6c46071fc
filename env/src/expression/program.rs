//! An expression as a list of steps on a stack of numbers: the same steps for lanes and for the reference.

use super::moment::Moment;
use crate::observation::Field;
use crate::scalar::Scalar;

/// Numbers that may wait while an expression is evaluated.
pub(super) const DEEPEST: usize = 16;
/// So many wait in most rewards: a stack of that size is cleared in a quarter of the time.
const SHALLOW: usize = 4;

/// A step. Conditions are numbers: 1 if true, 0 if false.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Put a number on the stack.
    Number(f64),
    /// Put a number of the moment on the stack.
    Load(usize),
    /// Replace the topmost number.
    Map(Function),
    /// Replace the topmost number by its product with itself, so many times.
    Power(u32),
    /// Replace the topmost two numbers.
    Join(Operator),
    /// Replace the topmost three, `yes`, `condition`, `no`: by the first if the second is true.
    Select,
}

/// A function of one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Function {
    Negative,
    Not,
    Inverse,
    Abs,
    Sqrt,
    Exp,
    Log,
    Tanh,
    Sin,
    Cos,
}

/// A function of two numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Less,
    AtMost,
    And,
    Or,
    Min,
    Max,
}

/// The steps that evaluate an expression.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Program {
    steps: Vec<Step>,
    /// Numbers that wait at most.
    depth: usize,
}

impl Program {
    /// Creates a program of steps that leave one number; none if too many numbers would wait.
    pub(super) fn new(steps: Vec<Step>) -> Option<Program> {
        let (mut now, mut depth) = (0_usize, 0);
        for step in &steps {
            match step {
                Step::Number(_) | Step::Load(_) => now += 1,
                Step::Map(_) | Step::Power(_) => {}
                Step::Join(_) => now -= 1,
                Step::Select => now -= 2,
            }
            depth = depth.max(now);
        }
        (depth <= DEEPEST).then_some(Program { steps, depth })
    }

    /// Returns whether it reads a number of the field.
    pub(crate) fn reads(&self, field: &Field) -> bool {
        self.steps.iter().any(|step| matches!(step, Step::Load(place) if field.range().contains(place)))
    }

    /// The value for each lane.
    #[inline(always)]
    pub(crate) fn evaluate<R: Scalar>(&self, moment: &Moment<'_, R>) -> R {
        if self.depth <= SHALLOW {
            self.evaluate_on::<R, SHALLOW>(moment)
        } else {
            self.evaluate_on::<R, DEEPEST>(moment)
        }
    }

    /// On a stack for `N` numbers.
    #[inline(always)]
    fn evaluate_on<R: Scalar, const N: usize>(&self, moment: &Moment<'_, R>) -> R {
        let mut stack = [R::zero(); N];
        // the index of the topmost number; parsing sees to it that it stays in the stack, and % costs nothing
        let mut top = N - 1;
        for step in &self.steps {
            match *step {
                Step::Number(value) => {
                    top = (top + 1) % N;
                    stack[top] = R::from_f64(value);
                }
                Step::Load(place) => {
                    top = (top + 1) % N;
                    stack[top] = moment.number(place);
                }
                Step::Map(function) => stack[top] = function.value(stack[top]),
                Step::Power(exponent) => stack[top] = power(stack[top], exponent),
                Step::Join(operator) => {
                    let below = (top + N - 1) % N;
                    stack[below] = operator.value(stack[below], stack[top]);
                    top = below;
                }
                Step::Select => {
                    let (condition, yes) = ((top + N - 1) % N, (top + N - 2) % N);
                    let (condition, chosen) =
                        (stack[condition], R::select(holds(stack[condition]), stack[yes], stack[top]));
                    stack[yes] = R::select(condition.le(condition), chosen, condition);
                    top = yes;
                }
            }
        }
        stack[top]
    }
}

/// Returns the mask of the lanes in which a condition is true.
#[inline(always)]
pub(crate) fn holds<R: Scalar>(condition: R) -> R::Mask {
    condition.gt(R::from_f64(0.5))
}

/// By repeated products, so that a negative base has one too.
#[inline(always)]
fn power<R: Scalar>(base: R, mut exponent: u32) -> R {
    let (mut square, mut product) = (base, R::from_f64(1.0));
    while exponent > 0 {
        if exponent & 1 == 1 {
            product = product * square;
        }
        square = square * square;
        exponent >>= 1;
    }
    product
}

impl Function {
    #[inline(always)]
    pub(super) fn value<R: Scalar>(self, a: R) -> R {
        let one = R::from_f64(1.0);
        match self {
            Function::Negative => -a,
            Function::Not => one - a,
            Function::Inverse => one / a,
            Function::Abs => a.abs(),
            Function::Sqrt => a.sqrt(),
            Function::Exp => a.exp(),
            Function::Log => R::select(a.gt(R::zero()), a.ln(), R::from_f64(f64::NAN)),
            // the exponential stays within exp(80), where this is 1 to the last bit
            Function::Tanh => one - R::from_f64(2.0) / ((a + a).exp() + one),
            Function::Sin => a.sin_cos().0,
            Function::Cos => a.sin_cos().1,
        }
    }
}

/// `value` where all that it was made of are numbers: a comparison would hide what is none.
#[inline(always)]
fn unless_nan<R: Scalar>(a: R, b: R, value: R) -> R {
    R::select(a.le(a), R::select(b.le(b), value, b), a)
}

impl Operator {
    #[inline(always)]
    fn value<R: Scalar>(self, a: R, b: R) -> R {
        let (one, zero) = (R::from_f64(1.0), R::zero());
        match self {
            Operator::Add => a + b,
            Operator::Subtract => a - b,
            Operator::Multiply => a * b,
            Operator::Divide => a / b,
            Operator::Power => {
                let value = (b * Function::Log.value(a)).exp();
                R::select(a.abs().le(zero) & b.gt(zero), zero, value)
            }
            Operator::Less => unless_nan(a, b, R::select(a.lt(b), one, zero)),
            Operator::AtMost => unless_nan(a, b, R::select(a.le(b), one, zero)),
            Operator::And => a * b,
            Operator::Min => unless_nan(a, b, a.min(b)),
            Operator::Or | Operator::Max => unless_nan(a, b, a.max(b)),
        }
    }
}
