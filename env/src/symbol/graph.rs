//! Operations in the order of their requests, each once; those on constants are carried out at once.

use std::collections::HashMap;

use crate::scalar::{Scalar, Word};

/// A node's place in its graph; its operands are before it.
pub type Id = u32;

/// Type of a node's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A real number.
    Number,
    /// A truth value.
    Flag,
    /// An integer modulo 2^32.
    Word,
}

/// An operation on one operand; see the methods of [`Scalar`] of the same names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Unary {
    Neg,
    Sqrt,
    Abs,
    Round,
    Not,
    /// [`Scalar::unit`].
    Unit,
    /// The first of [`Scalar::split_exponent`].
    Mantissa,
    /// The second of it.
    Exponent,
}

/// An operation on two operands; see the methods of [`Scalar`] and [`Word`] of the same names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Binary {
    Add,
    Sub,
    Mul,
    Div,
    Min,
    Max,
    /// [`Scalar::lt`].
    Less,
    /// [`Scalar::le`].
    AtMost,
    BitAnd,
    BitOr,
    BitXor,
    WordAdd,
    WordMul,
    ScaleExponent,
}

/// An elementary function, see [`super::elementary_body`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Call {
    Sin,
    Cos,
    /// The sine of [`Scalar::sin_cos_quarter`].
    SinQuarter,
    CosQuarter,
    Exp,
    Ln,
}

/// One operation, input or constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Node {
    /// An input of the caller, by its place among the inputs.
    Input(Kind, usize),
    /// A constant, by its bits.
    Number(u64),
    /// A constant.
    Flag(bool),
    /// A constant.
    Word(u32),
    /// One operand.
    Unary(Unary, Id),
    /// Two operands.
    Binary(Binary, Id, Id),
    /// A word, shifted right by so many bits.
    Shift(Id, u32),
    /// The second if the first is true, otherwise the third.
    Select(Id, Id, Id),
    /// An elementary function.
    Call(Call, Id),
}

/// Nodes in the order of their first requests.
#[derive(Debug, Clone, Default)]
pub struct Graph {
    nodes: Vec<Node>,
    /// The part of the simulator that requested each.
    parts: Vec<&'static str>,
    known: HashMap<Node, Id>,
    part: &'static str,
    /// Why what was recorded is no program.
    pub(super) fault: Option<&'static str>,
}

impl Graph {
    pub(super) fn new() -> Self {
        Graph::default()
    }

    /// All nodes.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Marks the nodes that `wanted` are made of.
    pub fn live(&self, wanted: impl IntoIterator<Item = Id>) -> Vec<bool> {
        let mut live = vec![false; self.nodes.len()];
        wanted.into_iter().for_each(|id| live[id as usize] = true);
        for i in (0..live.len()).rev() {
            if live[i] {
                self.nodes[i].operands().for_each(|id| live[id as usize] = true);
            }
        }
        live
    }

    /// Returns the part of the simulator that requested a node first.
    pub fn part(&self, id: Id) -> &'static str {
        self.parts[id as usize]
    }

    pub(super) fn enter(&mut self, part: &'static str) {
        self.part = part;
    }

    /// The value of a constant.
    pub fn number(&self, id: Id) -> Option<f64> {
        match self.nodes[id as usize] {
            Node::Number(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// The value of a constant.
    pub fn flag(&self, id: Id) -> Option<bool> {
        match self.nodes[id as usize] {
            Node::Flag(on) => Some(on),
            _ => None,
        }
    }

    fn word(&self, id: Id) -> Option<u32> {
        match self.nodes[id as usize] {
            Node::Word(word) => Some(word),
            _ => None,
        }
    }

    /// Returns the place of a node: of the same one, if it is there already, or of its constant value.
    pub(super) fn add(&mut self, node: Node) -> Id {
        if let Some(id) = self.simplify(node) {
            return id;
        }
        self.intern(node)
    }

    fn intern(&mut self, node: Node) -> Id {
        if let Some(id) = self.known.get(&node) {
            return *id;
        }
        let id = self.nodes.len() as Id;
        self.nodes.push(node);
        self.parts.push(self.part);
        self.known.insert(node, id);
        id
    }

    fn intern_number(&mut self, value: f64) -> Id {
        self.intern(Node::Number(value.to_bits()))
    }

    fn simplify(&mut self, node: Node) -> Option<Id> {
        match node {
            Node::Unary(operation, a) => self.simplify_unary(operation, a),
            Node::Binary(operation, a, b) => self.simplify_binary(operation, a, b),
            Node::Shift(word, bits) => {
                let word = self.word(word)?;
                Some(self.intern(Node::Word(Word::shr(word, bits))))
            }
            Node::Select(mask, yes, no) => match self.flag(mask) {
                Some(true) => Some(yes),
                Some(false) => Some(no),
                None => (yes == no).then_some(yes),
            },
            Node::Call(call, a) => {
                let a = self.number(a)?;
                Some(self.intern_number(call.value(a)))
            }
            _ => None,
        }
    }

    fn simplify_unary(&mut self, operation: Unary, a: Id) -> Option<Id> {
        if let (Unary::Not, Some(on)) = (operation, self.flag(a)) {
            return Some(self.intern(Node::Flag(!on)));
        }
        if let Node::Unary(Unary::Neg | Unary::Not, inner) = self.nodes[a as usize]
            && self.nodes[a as usize] == Node::Unary(operation, inner)
        {
            return Some(inner);
        }
        if let (Unary::Unit, Some(word)) = (operation, self.word(a)) {
            return Some(self.intern_number(f64::unit(word)));
        }
        let a = self.number(a)?;
        let value = match operation {
            Unary::Neg => -a,
            Unary::Sqrt => Scalar::sqrt(a),
            Unary::Abs => Scalar::abs(a),
            Unary::Round => Scalar::round(a),
            Unary::Mantissa => a.split_exponent().0,
            Unary::Exponent => a.split_exponent().1,
            Unary::Not | Unary::Unit => return None,
        };
        Some(self.intern_number(value))
    }

    fn simplify_binary(&mut self, operation: Binary, a: Id, b: Id) -> Option<Id> {
        match operation {
            Binary::BitAnd | Binary::BitOr => self.simplify_logic(operation, a, b),
            Binary::BitXor | Binary::WordAdd | Binary::WordMul => {
                let (a, b) = (self.word(a)?, self.word(b)?);
                Some(self.intern(Node::Word(match operation {
                    Binary::BitXor => a ^ b,
                    Binary::WordAdd => Word::add(a, b),
                    _ => Word::mul(a, b),
                })))
            }
            _ => match (self.number(a), self.number(b)) {
                (Some(x), Some(y)) => Some(self.fold(operation, x, y)),
                known => self.simplify_neutral(operation, [a, b], known),
            },
        }
    }

    fn simplify_logic(&self, operation: Binary, a: Id, b: Id) -> Option<Id> {
        let neutral = operation == Binary::BitAnd;
        match (self.flag(a), self.flag(b)) {
            (Some(on), _) => Some(if on == neutral { b } else { a }),
            (_, Some(on)) => Some(if on == neutral { a } else { b }),
            _ => (a == b).then_some(a),
        }
    }

    /// Adding nothing, and multiplying by one or by nothing. (A number that is not finite would make NaN of
    /// nothing; there is none.)
    fn simplify_neutral(
        &mut self,
        operation: Binary,
        [a, b]: [Id; 2],
        known: (Option<f64>, Option<f64>),
    ) -> Option<Id> {
        match (operation, known) {
            (Binary::Add, (Some(0.0), _)) | (Binary::Mul, (Some(1.0), _)) => Some(b),
            (Binary::Add | Binary::Sub, (_, Some(0.0))) | (Binary::Mul | Binary::Div, (_, Some(1.0))) => {
                Some(a)
            }
            (Binary::Mul, (Some(0.0), _) | (_, Some(0.0))) | (Binary::Div, (Some(0.0), _)) => {
                Some(self.intern_number(0.0))
            }
            (Binary::Sub, (Some(0.0), _)) => Some(self.add(Node::Unary(Unary::Neg, b))),
            (Binary::Mul, (Some(-1.0), _)) => Some(self.add(Node::Unary(Unary::Neg, b))),
            (Binary::Mul, (_, Some(-1.0))) => Some(self.add(Node::Unary(Unary::Neg, a))),
            (Binary::Sub, _) if a == b => Some(self.intern_number(0.0)),
            (Binary::Min | Binary::Max, _) if a == b => Some(a),
            (Binary::Less, _) if a == b => Some(self.intern(Node::Flag(false))),
            (Binary::AtMost, _) if a == b => Some(self.intern(Node::Flag(true))),
            _ => None,
        }
    }

    /// An operation on two constants.
    fn fold(&mut self, operation: Binary, x: f64, y: f64) -> Id {
        let value = match operation {
            Binary::Less => return self.intern(Node::Flag(x < y)),
            Binary::AtMost => return self.intern(Node::Flag(x <= y)),
            Binary::Add => x + y,
            Binary::Sub => x - y,
            Binary::Mul => x * y,
            Binary::Div => x / y,
            Binary::Min => Scalar::min(x, y),
            Binary::Max => Scalar::max(x, y),
            _ => x.scale_exponent(y),
        };
        self.intern_number(value)
    }
}

impl Node {
    /// Returns its operands.
    pub fn operands(self) -> impl Iterator<Item = Id> {
        let [a, b, c] = match self {
            Node::Input(..) | Node::Number(_) | Node::Flag(_) | Node::Word(_) => [None; 3],
            Node::Unary(_, a) | Node::Shift(a, _) | Node::Call(_, a) => [Some(a), None, None],
            Node::Binary(_, a, b) => [Some(a), Some(b), None],
            Node::Select(a, b, c) => [Some(a), Some(b), Some(c)],
        };
        [a, b, c].into_iter().flatten()
    }
}

impl Call {
    /// Its value on a number.
    pub fn value(self, x: f64) -> f64 {
        match self {
            Call::Sin => Scalar::sin_cos(x).0,
            Call::Cos => Scalar::sin_cos(x).1,
            Call::SinQuarter => x.sin_cos_quarter().0,
            Call::CosQuarter => x.sin_cos_quarter().1,
            Call::Exp => Scalar::exp(x),
            Call::Ln => Scalar::ln(x),
        }
    }
}
