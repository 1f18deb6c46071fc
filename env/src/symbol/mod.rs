//! A number that is not there yet: its operations are written down as a [`Graph`] instead of being carried out.
//! A world of symbols steps once, and what it wrote down is a program that any machine can run.

mod graph;

use std::cell::RefCell;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub};

pub use graph::{Binary, Call, Graph, Id, Kind, Node, Unary};

use crate::elementary;
use crate::error::{Error, Result};
use crate::scalar::{Scalar, Word, assigns};

thread_local! {
    /// The graph being recorded on this thread.
    static GRAPH: RefCell<Graph> = RefCell::new(Graph::new());
}

/// A number of the graph that is being recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Symbol(Id);

/// A truth value of the graph that is being recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Condition(Id);

/// A word of the graph that is being recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SymbolWord(Id);

/// Runs `code` and returns what its symbols were made by.
///
/// # Errors
/// The errors of `code`; [`Error::Config`] if a formula needs the value of a symbolic number.
pub fn record<T>(code: impl FnOnce() -> Result<T>) -> Result<(T, Graph)> {
    GRAPH.with_borrow_mut(|graph| *graph = Graph::new());
    let made = code();
    let graph = GRAPH.take();
    match graph.fault {
        Some(what) => Err(Error::Config(format!("cannot be recorded: {what}"))),
        None => Ok((made?, graph)),
    }
}

/// Attributes the following nodes to this part of the simulator.
pub(crate) fn enter(part: &'static str) {
    GRAPH.with_borrow_mut(|graph| graph.enter(part));
}

// A recording runs once: calls instead of copies keep the program small and its compilation short, here and in all
// that follows.
#[inline(never)]
fn node(node: Node) -> Id {
    GRAPH.with_borrow_mut(|graph| graph.add(node))
}

#[inline(never)]
fn unary(operation: Unary, a: Id) -> Id {
    node(Node::Unary(operation, a))
}

#[inline(never)]
fn binary(operation: Binary, a: Id, b: Id) -> Id {
    node(Node::Binary(operation, a, b))
}

impl Symbol {
    /// The number that input `place` will bring.
    pub fn input(place: usize) -> Self {
        Symbol(node(Node::Input(Kind::Number, place)))
    }
    /// Its node.
    pub fn id(self) -> Id {
        self.0
    }
    /// An elementary function of a number.
    fn call(call: Call, argument: Self) -> Self {
        Symbol(node(Node::Call(call, argument.0)))
    }
}

impl Condition {
    /// Its node.
    pub fn id(self) -> Id {
        self.0
    }
}

impl SymbolWord {
    /// The word that input `place` will bring.
    pub fn input(place: usize) -> Self {
        SymbolWord(node(Node::Input(Kind::Word, place)))
    }
    /// Its node.
    pub fn id(self) -> Id {
        self.0
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $type:ident) => {
        impl $trait for $type {
            type Output = $type;
            #[inline(never)]
            fn $method(self, other: $type) -> $type {
                $type(binary(Binary::$trait, self.0, other.0))
            }
        }
    };
}
operator!(Add, add, Symbol);
operator!(Sub, sub, Symbol);
operator!(Mul, mul, Symbol);
operator!(Div, div, Symbol);
operator!(BitAnd, bitand, Condition);
operator!(BitOr, bitor, Condition);
operator!(BitXor, bitxor, SymbolWord);
assigns!(Symbol);

impl Neg for Symbol {
    type Output = Symbol;
    fn neg(self) -> Symbol {
        Symbol(unary(Unary::Neg, self.0))
    }
}

impl Not for Condition {
    type Output = Condition;
    fn not(self) -> Condition {
        Condition(unary(Unary::Not, self.0))
    }
}

impl Word for SymbolWord {
    fn from_u32(value: u32) -> Self {
        SymbolWord(node(Node::Word(value)))
    }
    fn add(self, other: Self) -> Self {
        SymbolWord(binary(Binary::WordAdd, self.0, other.0))
    }
    fn mul(self, other: Self) -> Self {
        SymbolWord(binary(Binary::WordMul, self.0, other.0))
    }
    fn shr(self, bits: u32) -> Self {
        SymbolWord(node(Node::Shift(self.0, bits)))
    }
    fn set_lane(&mut self, _: usize, value: u32) {
        *self = Self::from_u32(value);
    }
}

impl Scalar for Symbol {
    type Mask = Condition;
    type Word = SymbolWord;
    const SINGLE: bool = false;

    #[inline(never)]
    fn from_f64(value: f64) -> Self {
        Symbol(node(Node::Number(value.to_bits())))
    }
    #[inline(never)]
    fn sqrt(self) -> Self {
        Symbol(unary(Unary::Sqrt, self.0))
    }
    #[inline(never)]
    fn abs(self) -> Self {
        Symbol(unary(Unary::Abs, self.0))
    }
    #[inline(never)]
    fn min(self, other: Self) -> Self {
        Symbol(binary(Binary::Min, self.0, other.0))
    }
    #[inline(never)]
    fn max(self, other: Self) -> Self {
        Symbol(binary(Binary::Max, self.0, other.0))
    }
    #[inline(never)]
    fn round(self) -> Self {
        Symbol(unary(Unary::Round, self.0))
    }
    #[inline(never)]
    fn lt(self, other: Self) -> Condition {
        Condition(binary(Binary::Less, self.0, other.0))
    }
    #[inline(never)]
    fn le(self, other: Self) -> Condition {
        Condition(binary(Binary::AtMost, self.0, other.0))
    }
    #[inline(never)]
    fn select(mask: Condition, yes: Self, no: Self) -> Self {
        Symbol(node(Node::Select(mask.0, yes.0, no.0)))
    }
    /// May be true: where a formula leaves work out because it is false everywhere, the work is recorded.
    #[inline(never)]
    fn any(mask: Condition) -> bool {
        GRAPH.with_borrow(|graph| graph.flag(mask.0) != Some(false))
    }
    /// Returns true for any mask.
    #[inline(never)]
    fn all(mask: Condition) -> bool {
        GRAPH.with_borrow(|graph| graph.flag(mask.0) == Some(true))
    }
    #[inline(never)]
    fn nothing() -> Condition {
        Condition(node(Node::Flag(false)))
    }
    #[inline(never)]
    fn unit(word: SymbolWord) -> Self {
        Symbol(unary(Unary::Unit, word.0))
    }
    #[inline(never)]
    fn split_exponent(self) -> (Self, Self) {
        (Symbol(unary(Unary::Mantissa, self.0)), Symbol(unary(Unary::Exponent, self.0)))
    }
    #[inline(never)]
    fn scale_exponent(self, exponent: Self) -> Self {
        Symbol(binary(Binary::ScaleExponent, self.0, exponent.0))
    }
    #[inline(never)]
    fn lane(self, _: usize) -> f64 {
        GRAPH.with_borrow_mut(|graph| {
            graph.number(self.0).unwrap_or_else(|| {
                graph.fault = Some("a formula looks a number up that is not known before the flight");
                f64::NAN
            })
        })
    }
    #[inline(never)]
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = Self::from_f64(value);
    }
    // Kept as calls, so that a reader knows them again; what they do is recorded apart, see `elementary_body`.
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        (Self::call(Call::Sin, self), Self::call(Call::Cos, self))
    }
    #[inline(never)]
    fn sin_cos_quarter(self) -> (Self, Self) {
        (Self::call(Call::SinQuarter, self), Self::call(Call::CosQuarter, self))
    }
    #[inline(never)]
    fn exp(self) -> Self {
        Self::call(Call::Exp, self)
    }
    #[inline(never)]
    fn ln(self) -> Self {
        Self::call(Call::Ln, self)
    }
    #[inline(never)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
}

/// Returns the formula of a call as a program of one input: the formula that every other number type runs.
///
/// # Errors
/// The errors of [`record`].
pub fn elementary_body(call: Call) -> Result<(Id, Graph)> {
    record(|| {
        let x = Symbol::input(0);
        let value = match call {
            Call::Sin => elementary::sin_cos(x).0,
            Call::Cos => elementary::sin_cos(x).1,
            Call::SinQuarter => elementary::sin_cos_quarter(x).0,
            Call::CosQuarter => elementary::sin_cos_quarter(x).1,
            Call::Exp => elementary::exp(x),
            Call::Ln => elementary::ln(x),
        };
        Ok(value.id())
    })
}

#[cfg(test)]
mod tests;
