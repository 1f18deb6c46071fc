//! Text to steps, with the unit of every part.

use std::sync::LazyLock;

use pest::Parser;
use pest::error::{Error as SyntaxError, InputLocation};
use pest::iterators::Pair;
use pest::pratt_parser::{Assoc, Op, PrattParser};

use super::moment::find_expression_field;
use super::program::{DEEPEST, Function, Operator, Program, Step};
use super::unit::Unit;
use crate::error::{Error, Result};
use crate::observation::Field;

#[derive(pest_derive::Parser)]
#[grammar = "expression/grammar.pest"]
struct Syntax;

/// The longest text: a reward is a line or two, and a server reads those of strangers.
const LONGEST: usize = 1000;
/// Brackets within brackets: the parser calls itself for each.
const DEEPEST_BRACKETS: usize = 24;
/// Steps of one expression.
const MOST_STEPS: usize = 200;
/// A larger whole exponent is no reward that anybody means.
const LARGEST_EXPONENT: f64 = 64.0;

/// Kinds of parts of an expression.
#[derive(Debug, Clone, PartialEq)]
enum Kind {
    /// A number with its unit; none where a bare factor in the text may have brought any.
    Number(Option<Unit>),
    Condition,
}

/// A part of an expression.
#[derive(Debug, Clone)]
struct Part {
    kind: Kind,
    steps: Vec<Step>,
    /// The value of a number written in the text.
    literal: Option<f64>,
    /// The first character in the text.
    first: usize,
}

/// A problem and its place.
struct Fault {
    first: usize,
    problem: String,
}

type Parsed<T> = std::result::Result<T, Fault>;

fn fault<T>(first: usize, problem: impl Into<String>) -> Parsed<T> {
    Err(Fault { first, problem: problem.into() })
}

/// Python's precedence, the loosest first.
static PRECEDENCE: LazyLock<PrattParser<Rule>> = LazyLock::new(|| {
    let left = |rule| Op::infix(rule, Assoc::Left);
    PrattParser::new()
        .op(left(Rule::or))
        .op(left(Rule::and))
        .op(Op::prefix(Rule::not))
        .op(left(Rule::less) | left(Rule::at_most) | left(Rule::more) | left(Rule::at_least))
        .op(left(Rule::add) | left(Rule::subtract))
        .op(left(Rule::multiply) | left(Rule::divide))
        .op(Op::prefix(Rule::negative))
        .op(Op::infix(Rule::power, Assoc::Right))
});

/// The steps of the number that `text` gives.
pub(super) fn parse_number(name: &'static str, text: &str) -> Result<Program> {
    finish(name, text, |part| match part.kind {
        Kind::Number(_) => Ok(()),
        Kind::Condition => fault(part.first, "expected a number, got a condition: write `1 if ... else 0`"),
    })
}

/// The steps of the condition that `text` gives.
pub(super) fn parse_condition(name: &'static str, text: &str) -> Result<Program> {
    finish(name, text, |part| match part.kind {
        Kind::Condition => Ok(()),
        Kind::Number(_) => fault(part.first, "expected a condition such as `dist > 2`, got a number"),
    })
}

fn finish(name: &'static str, text: &str, check: impl Fn(&Part) -> Parsed<()>) -> Result<Program> {
    let parse = || {
        check_size(text)?;
        let mut pairs = Syntax::parse(Rule::text, text).map_err(|e| syntax_fault(&e))?;
        let Some(pair) = pairs.next() else { return fault(0, "expected an expression, got nothing") };
        let part = choice(pair)?;
        check(&part)?;
        let program = Some(part.steps).filter(|steps| steps.len() <= MOST_STEPS).and_then(Program::new);
        program.map_or_else(
            || {
                fault(
                    0,
                    format!("too long: expected at most {MOST_STEPS} operations, {DEEPEST} of them waiting"),
                )
            },
            Ok,
        )
    };
    parse().map_err(|Fault { first, problem }| {
        let column = text.get(..first).map_or(first, |before| before.chars().count()) + 1;
        Error::Expression { name, text: text.into(), column, problem }
    })
}

fn check_size(text: &str) -> Parsed<()> {
    if text.trim().is_empty() {
        return fault(0, "expected an expression, got nothing");
    }
    if text.len() > LONGEST {
        return fault(0, format!("expected at most {LONGEST} characters, got {}", text.len()));
    }
    let mut open = 0_usize;
    for (i, c) in text.char_indices() {
        match c {
            '(' => open += 1,
            ')' => open = open.saturating_sub(1),
            _ => {}
        }
        if open > DEEPEST_BRACKETS {
            return fault(i, format!("expected at most {DEEPEST_BRACKETS} brackets within each other"));
        }
    }
    Ok(())
}

fn syntax_fault(error: &SyntaxError<Rule>) -> Fault {
    let first = match error.location {
        InputLocation::Pos(first) | InputLocation::Span((first, _)) => first,
    };
    let renamed = error.clone().renamed_rules(|rule| {
        let word = match rule {
            Rule::EOI => "the end",
            Rule::number | Rule::name | Rule::call | Rule::component | Rule::choice => {
                "a number, a field or a function"
            }
            Rule::index => "the index of a component",
            Rule::not | Rule::negative => "a sign",
            Rule::else_word => "`else`",
            _ => "an operator",
        };
        word.to_owned()
    });
    // a word once, however many rules it stands for
    let mut words: Vec<&str> = Vec::new();
    let message = renamed.variant.message();
    let listed = message.trim_start_matches("expected ");
    for word in listed.split(", or ").flat_map(|part| part.split(" or ")).flat_map(|part| part.split(", ")) {
        if !words.contains(&word) && word != "a sign" && !word.is_empty() {
            words.push(word);
        }
    }
    // "a number, a field or a function" was split as well: whole again
    let value = ["a number", "a field", "a function"];
    let whole = words.iter().filter(|word| !value.contains(word)).copied();
    let expected: Vec<&str> = words
        .contains(&"a field")
        .then_some("a number, a field, a function")
        .into_iter()
        .chain(whole)
        .collect();
    Fault { first, problem: format!("expected {}", expected.join(" or ")) }
}

/// `a if condition else b`, or `a` alone.
fn choice(pair: Pair<'_, Rule>) -> Parsed<Part> {
    let first = pair.as_span().start();
    let mut parts =
        pair.into_inner().filter(|part| !matches!(part.as_rule(), Rule::if_word | Rule::else_word));
    let (yes, condition, no) = (parts.next(), parts.next(), parts.next());
    let Some(yes) = yes else { return fault(first, "expected a number") };
    let yes = operation(yes)?;
    let (Some(condition), Some(no)) = (condition, no) else { return Ok(yes) };
    let (condition, no) = (operation(condition)?, choice(no)?);
    if condition.kind != Kind::Condition {
        return fault(condition.first, "expected a condition such as `dist > 2` behind `if`, got a number");
    }
    let kind = match (&yes.kind, &no.kind) {
        (Kind::Condition, Kind::Condition) => Kind::Condition,
        _ => Kind::Number(common_unit(&yes, &no, "`if` chooses between")?),
    };
    Ok(combine(first, kind, [yes, condition, no], Step::Select))
}

fn operation(pair: Pair<'_, Rule>) -> Parsed<Part> {
    PRECEDENCE
        .map_primary(value)
        .map_prefix(|operator, part| prefix(&operator, part?))
        .map_infix(|left, operator, right| infix(left?, &operator, right?))
        .parse(pair.into_inner())
}

fn value(pair: Pair<'_, Rule>) -> Parsed<Part> {
    let (first, text) = (pair.as_span().start(), pair.as_str());
    match pair.as_rule() {
        Rule::number => {
            let Some(value) = text.parse().ok().filter(|value: &f64| value.is_finite()) else {
                return fault(first, format!("{text} is no finite number"));
            };
            Ok(Part {
                kind: Kind::Number(None),
                steps: vec![Step::Number(value)],
                literal: Some(value),
                first,
            })
        }
        Rule::name => {
            let field = field(first, text)?;
            if field.length > 1 {
                let last = field.length - 1;
                return fault(
                    first,
                    format!(
                        "{text} has {} numbers: write {text}[0] to {text}[{last}], or norm({text})",
                        field.length
                    ),
                );
            }
            Ok(load(first, &field, 0))
        }
        Rule::component => {
            let mut inner = pair.into_inner();
            let (name, index) =
                (inner.next().map_or("", |p| p.as_str()), inner.next().map_or("", |p| p.as_str()));
            let field = field(first, name)?;
            match index.parse::<usize>() {
                Ok(i) if i < field.length => Ok(load(first, &field, i)),
                _ => {
                    fault(first, format!("{name} has the components 0 to {}, got {index}", field.length - 1))
                }
            }
        }
        Rule::call => call(pair),
        _ => choice(pair),
    }
}

fn field(first: usize, name: &str) -> Parsed<Field> {
    find_expression_field(name).or_else(|error| fault(first, error.to_string()))
}

/// The unit of a component: where a field has two, the last is that of its last number.
fn component_unit(field: &Field, i: usize) -> Unit {
    let (others, last) = field.unit.split_once(", ").unwrap_or((field.unit, field.unit));
    Unit::parse(if i + 1 == field.length { last } else { others })
}

fn load(first: usize, field: &Field, i: usize) -> Part {
    let kind = Kind::Number(Some(component_unit(field, i)));
    Part { kind, steps: vec![Step::Load(field.first + i)], literal: None, first }
}

/// Functions of one number.
const FUNCTIONS: [(&str, Function); 7] = [
    ("abs", Function::Abs),
    ("sqrt", Function::Sqrt),
    ("exp", Function::Exp),
    ("log", Function::Log),
    ("tanh", Function::Tanh),
    ("sin", Function::Sin),
    ("cos", Function::Cos),
];

/// Functions of two numbers.
const PAIRS: [(&str, Operator); 2] = [("min", Operator::Min), ("max", Operator::Max)];

/// Names of all functions.
pub(super) fn function_names() -> impl Iterator<Item = &'static str> {
    FUNCTIONS.iter().map(|(name, _)| *name).chain(PAIRS.iter().map(|(name, _)| *name)).chain(["norm"])
}

fn call(pair: Pair<'_, Rule>) -> Parsed<Part> {
    let first = pair.as_span().start();
    let mut inner = pair.into_inner();
    let name = inner.next().map_or("", |p| p.as_str());
    let arguments: Vec<_> = inner.collect();
    if name == "norm" {
        let [argument] = take_arguments(first, name, arguments)?;
        return norm(argument.as_span().start(), argument.as_str().trim()).map(|part| Part { first, ..part });
    }
    if let Some((_, function)) = FUNCTIONS.iter().find(|(known, _)| *known == name) {
        let [argument] = take_arguments(first, name, arguments)?;
        return apply(first, name, *function, choice(argument)?);
    }
    if let Some((_, operator)) = PAIRS.iter().find(|(known, _)| *known == name) {
        let [a, b] = take_arguments(first, name, arguments)?;
        let (a, b) = (choice(a)?, choice(b)?);
        let kind = Kind::Number(common_unit(&a, &b, &format!("{name} compares"))?);
        return Ok(combine(first, kind, [a, b], Step::Join(*operator)));
    }
    fault(first, crate::error::unknown("function", name, function_names()).to_string())
}

fn take_arguments<'a, const N: usize>(
    first: usize,
    name: &str,
    arguments: Vec<Pair<'a, Rule>>,
) -> Parsed<[Pair<'a, Rule>; N]> {
    arguments.try_into().or_else(|given: Vec<_>| {
        let s = if N == 1 { "" } else { "s" };
        fault(first, format!("{name} takes {N} argument{s}, got {}", given.len()))
    })
}

/// The length of a field that is a vector.
fn norm(at: usize, name: &str) -> Parsed<Part> {
    let field = field(at, name)?;
    if field.unit.contains(", ") {
        return fault(at, format!("{name} has numbers of several units ({}): it has no length", field.unit));
    }
    let mut steps = Vec::new();
    for i in 0..field.length {
        steps.extend([Step::Load(field.first + i), Step::Power(2)]);
        if i > 0 {
            steps.push(Step::Join(Operator::Add));
        }
    }
    steps.push(Step::Map(Function::Sqrt));
    Ok(Part { kind: Kind::Number(Some(component_unit(&field, 0))), steps, literal: None, first: at })
}

fn apply(first: usize, name: &str, function: Function, part: Part) -> Parsed<Part> {
    let unit = match (number_unit(&part)?, function) {
        (unit, Function::Abs) => unit,
        (Some(unit), Function::Sqrt) => unit.root(),
        (Some(unit), _) if !unit.is_pure() => {
            return fault(
                part.first,
                format!(
                    "{name} of a number in {unit}: multiply it by a number, or divide it by one of the same unit"
                ),
            );
        }
        (Some(_), _) => Some(Unit::default()),
        (None, _) => None,
    };
    Ok(map(first, Kind::Number(unit), part, Step::Map(function)))
}

fn prefix(operator: &Pair<'_, Rule>, part: Part) -> Parsed<Part> {
    let first = operator.as_span().start();
    if operator.as_rule() == Rule::not {
        if part.kind != Kind::Condition {
            return fault(part.first, "expected a condition behind `not`, got a number");
        }
        return Ok(map(first, Kind::Condition, part, Step::Map(Function::Not)));
    }
    let kind = Kind::Number(number_unit(&part)?);
    Ok(map(first, kind, part, Step::Map(Function::Negative)))
}

fn infix(left: Part, operator: &Pair<'_, Rule>, right: Part) -> Parsed<Part> {
    let (first, sign) = (left.first, operator.as_str());
    let join = |kind, parts, operator| Ok(combine(first, kind, parts, Step::Join(operator)));
    match operator.as_rule() {
        rule @ (Rule::and | Rule::or) => {
            for part in [&left, &right] {
                if part.kind != Kind::Condition {
                    return fault(part.first, format!("expected a condition beside `{sign}`, got a number"));
                }
            }
            let operator = if rule == Rule::and { Operator::And } else { Operator::Or };
            join(Kind::Condition, [left, right], operator)
        }
        rule @ (Rule::less | Rule::at_most | Rule::more | Rule::at_least) => {
            if left.kind == Kind::Condition {
                return fault(
                    left.first,
                    format!("expected a number before `{sign}`, got a condition: join two with `and`"),
                );
            }
            common_unit(&left, &right, &format!("`{sign}` compares"))?;
            let operator =
                if matches!(rule, Rule::less | Rule::more) { Operator::Less } else { Operator::AtMost };
            let turned = matches!(rule, Rule::more | Rule::at_least);
            join(Kind::Condition, if turned { [right, left] } else { [left, right] }, operator)
        }
        rule @ (Rule::add | Rule::subtract) => {
            let unit = common_unit(&left, &right, &format!("`{sign}` joins"))?;
            let operator = if rule == Rule::add { Operator::Add } else { Operator::Subtract };
            join(Kind::Number(unit), [left, right], operator)
        }
        rule @ (Rule::multiply | Rule::divide) => {
            let units = number_unit(&left)?.zip(number_unit(&right)?);
            let sign = if rule == Rule::multiply { 1 } else { -1 };
            let unit = units.map(|(left, right)| left.times(&right, sign));
            let operator = if sign == 1 { Operator::Multiply } else { Operator::Divide };
            join(Kind::Number(unit), [left, right], operator)
        }
        _ => raise(left, right),
    }
}

fn raise(base: Part, exponent: Part) -> Parsed<Part> {
    let (first, unit) = (base.first, number_unit(&base)?);
    if number_unit(&exponent)?.is_some_and(|unit| !unit.is_pure()) {
        return fault(exponent.first, "expected an exponent without a unit");
    }
    let whole = exponent.literal.filter(|e| e.fract() == 0.0 && e.abs() <= LARGEST_EXPONENT);
    if let Some(whole) = whole {
        let kind = Kind::Number(unit.map(|unit| unit.power(whole as i32)));
        let mut part = map(first, kind, base, Step::Power(whole.abs() as u32));
        if whole < 0.0 {
            part.steps.push(Step::Map(Function::Inverse));
        }
        return Ok(part);
    }
    if exponent.literal == Some(0.5) {
        let kind = Kind::Number(unit.and_then(|unit| unit.root()));
        return Ok(map(first, kind, base, Step::Map(Function::Sqrt)));
    }
    let kind = Kind::Number(unit.filter(Unit::is_pure));
    Ok(combine(first, kind, [base, exponent], Step::Join(Operator::Power)))
}

fn number_unit(part: &Part) -> Parsed<Option<Unit>> {
    match &part.kind {
        Kind::Number(unit) => Ok(unit.clone()),
        Kind::Condition => fault(part.first, "expected a number, got a condition: write `1 if ... else 0`"),
    }
}

/// The unit of two numbers of one kind; a number that may have any takes the other's.
fn common_unit(left: &Part, right: &Part, what: &str) -> Parsed<Option<Unit>> {
    match (number_unit(left)?, number_unit(right)?) {
        (Some(a), Some(b)) if a != b => fault(
            left.first,
            format!(
                "{what} a number in {a} and one in {b}: multiply one of them by a number, which brings the unit"
            ),
        ),
        (a, b) => Ok(a.or(b)),
    }
}

fn map(first: usize, kind: Kind, part: Part, step: Step) -> Part {
    let mut steps = part.steps;
    let literal = match (part.literal, step) {
        (Some(value), Step::Map(function)) => Some(function.value(value)),
        _ => None,
    };
    match literal {
        Some(value) => steps = vec![Step::Number(value)],
        None => steps.push(step),
    }
    Part { kind, steps, literal, first }
}

fn combine<const N: usize>(first: usize, kind: Kind, parts: [Part; N], step: Step) -> Part {
    let mut steps: Vec<Step> = parts.into_iter().flat_map(|part| part.steps).collect();
    steps.push(step);
    Part { kind, steps, literal: None, first }
}
