//! A program as lines of Python: each operation once, short ones within the line that needs them.

use std::fmt::Write as _;

use crazyflie_env::recording::Program;
use crazyflie_env::symbol::{Binary, Call, Graph, Id, Node, Unary};

/// Longest expression that is written within another.
const LONGEST: usize = 72;

/// Name of the function that does what a call does.
pub(crate) fn call_name(call: Call) -> &'static str {
    match call {
        Call::Sin => "_sin",
        Call::Cos => "_cos",
        Call::SinQuarter => "_sin_quarter",
        Call::CosQuarter => "_cos_quarter",
        Call::Exp => "_exp",
        Call::Ln => "_ln",
    }
}

/// Lines of a program, and how its outputs are called.
pub(crate) struct Code<'a> {
    graph: &'a Graph,
    /// Number of uses of each node.
    uses: Vec<u32>,
    /// Name or text of a node.
    texts: Vec<Text>,
    lines: String,
    part: &'static str,
}

#[derive(Clone, Default)]
struct Text {
    words: String,
    /// It is one word, or in brackets.
    whole: bool,
}

/// The lines of what `wanted` is made of, and an expression for each of `wanted`. `name` returns the names of inputs.
pub(crate) fn write_lines(
    graph: &Graph,
    live: &[bool],
    wanted: &[Id],
    name: impl Fn(usize) -> String,
) -> (String, Vec<String>) {
    let nodes = graph.nodes();
    let mut uses = vec![0; nodes.len()];
    for (node, _) in nodes.iter().zip(live).filter(|(_, live)| **live) {
        node.operands().for_each(|id| uses[id as usize] += 1);
    }
    wanted.iter().for_each(|id| uses[*id as usize] += 1);
    let mut code =
        Code { graph, uses, texts: vec![Text::default(); nodes.len()], lines: String::new(), part: "" };
    for (i, live) in live.iter().enumerate() {
        if *live {
            code.add(i as Id, &name);
        }
    }
    let outputs = wanted.iter().map(|id| code.texts[*id as usize].words.clone()).collect();
    (code.lines, outputs)
}

/// Writes all outputs of a program like [`write_lines`].
pub(crate) fn write_program(
    program: &Program,
    wanted: &[Id],
    name: impl Fn(usize) -> String,
) -> (String, Vec<String>) {
    write_lines(&program.graph, &program.graph.live(wanted.iter().copied()), wanted, name)
}

impl Code<'_> {
    fn add(&mut self, id: Id, name: &impl Fn(usize) -> String) {
        let (node, i) = (self.graph.nodes()[id as usize], id as usize);
        let text = match node {
            Node::Input(_, place) => Text { words: name(place), whole: true },
            Node::Number(bits) => number(f64::from_bits(bits)),
            Node::Flag(on) => word(if on { "True" } else { "False" }),
            Node::Word(value) => word(&format!("np.uint32(0x{value:08x})")),
            _ => self.operation(node),
        };
        let constant = matches!(node, Node::Input(..) | Node::Number(_) | Node::Flag(_) | Node::Word(_));
        self.texts[i] = if constant || (self.uses[i] == 1 && text.words.len() <= LONGEST) {
            text
        } else {
            let part = self.graph.part(id);
            if part != self.part {
                self.part = part;
                writeln!(self.lines, "    # {part}").unwrap_or_default();
            }
            writeln!(self.lines, "    v{id} = {}", text.words).unwrap_or_default();
            word(&format!("v{id}"))
        };
    }

    /// An operand, in brackets where it needs them.
    fn operand(&self, id: Id) -> String {
        let text = &self.texts[id as usize];
        if text.whole { text.words.clone() } else { format!("({})", text.words) }
    }

    fn bare(&self, id: Id) -> &str {
        &self.texts[id as usize].words
    }

    fn operation(&self, node: Node) -> Text {
        let function = |name: &str, operands: &[Id]| {
            let operands: Vec<&str> = operands.iter().map(|id| self.bare(*id)).collect();
            Text { words: format!("{name}({})", operands.join(", ")), whole: true }
        };
        let infix = |sign: &str, a: Id, b: Id| Text {
            words: format!("{} {sign} {}", self.operand(a), self.operand(b)),
            whole: false,
        };
        match node {
            Node::Unary(Unary::Neg, a) => Text { words: format!("-{}", self.operand(a)), whole: false },
            Node::Unary(Unary::Not, a) => Text { words: format!("~{}", self.operand(a)), whole: false },
            Node::Unary(Unary::Unit, a) => {
                Text { words: format!("_unit({}, real)", self.bare(a)), whole: true }
            }
            Node::Unary(operation, a) => function(unary_name(operation), &[a]),
            Node::Binary(operation, a, b) => match binary_sign(operation) {
                Ok(sign) => infix(sign, a, b),
                Err(name) => function(name, &[a, b]),
            },
            Node::Shift(a, bits) => {
                Text { words: format!("{} >> np.uint32({bits})", self.operand(a)), whole: false }
            }
            Node::Select(mask, yes, no) => function("jnp.where", &[mask, yes, no]),
            Node::Call(call, a) => function(call_name(call), &[a]),
            Node::Input(..) | Node::Number(_) | Node::Flag(_) | Node::Word(_) => Text::default(),
        }
    }
}

fn word(words: &str) -> Text {
    Text { words: words.to_owned(), whole: true }
}

fn number(value: f64) -> Text {
    if value.is_infinite() {
        return Text { words: format!("{}jnp.inf", if value < 0.0 { "-" } else { "" }), whole: value > 0.0 };
    }
    Text { words: format!("{value:?}"), whole: value >= 0.0 }
}

fn unary_name(operation: Unary) -> &'static str {
    match operation {
        Unary::Sqrt => "_sqrt",
        Unary::Abs => "jnp.abs",
        Unary::Mantissa => "_mantissa",
        Unary::Exponent => "_exponent",
        Unary::Neg | Unary::Not | Unary::Unit | Unary::Round => "_round",
    }
}

/// The sign between two operands, or else the name of a function.
fn binary_sign(operation: Binary) -> Result<&'static str, &'static str> {
    match operation {
        Binary::Add | Binary::WordAdd => Ok("+"),
        Binary::Sub => Ok("-"),
        Binary::Mul | Binary::WordMul => Ok("*"),
        Binary::Div => Ok("/"),
        Binary::Less => Ok("<"),
        Binary::AtMost => Ok("<="),
        Binary::BitAnd => Ok("&"),
        Binary::BitOr => Ok("|"),
        Binary::BitXor => Ok("^"),
        Binary::Min => Err("_smaller"),
        Binary::Max => Err("_larger"),
        Binary::ScaleExponent => Err("_scale_exponent"),
    }
}
