//! The options of tasks: declared once, read from JSON, and drawn anew for every episode if they are distributions.

use std::marker::PhantomData;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::{Error, Result, unknown};
use crate::number::{Bounds, Distribution, Number};

/// Type of an option.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OptionKind {
    /// A number.
    Number,
    /// A whole number.
    Count,
    /// Three coordinates.
    Point,
    /// One of some names.
    Name(&'static [&'static str]),
    /// Rows, of which there may be none.
    List,
}

/// An option of a task.
#[derive(Debug, Clone, Copy)]
pub struct TaskOption {
    /// Key in `task_options`, with the unit as its suffix.
    pub name: &'static str,
    /// Symbol of the unit; "1" for a pure number, empty for what is none.
    pub unit: &'static str,
    /// Its type.
    pub kind: OptionKind,
    /// The value unless another one is given, as numbers: a name by its place, one that is absent as NaN.
    default: [f64; 3],
    /// Smallest and largest value, coordinate by coordinate.
    bounds: [[f64; 2]; 3],
    /// A distribution may be given, from which every episode draws a value.
    pub drawn: bool,
    /// Description for users, without a full stop.
    pub about: &'static str,
}

impl TaskOption {
    /// Returns the number of its values.
    fn length(&self) -> usize {
        if self.kind == OptionKind::Point { 3 } else { 1 }
    }

    /// The value unless another one is given, as in JSON; null for none.
    pub fn default_value(&self) -> Value {
        match self.kind {
            OptionKind::List => Value::Array(Vec::new()),
            _ if self.default[0].is_nan() => Value::Null,
            OptionKind::Number => self.default[0].into(),
            OptionKind::Count => (self.default[0] as u64).into(),
            OptionKind::Point => self.default.to_vec().into(),
            OptionKind::Name(names) => names[self.default[0] as usize].into(),
        }
    }

    /// The values that it may have, in words.
    pub fn range(&self) -> String {
        match self.kind {
            OptionKind::List => "rows".into(),
            OptionKind::Name(names) => names.join(", "),
            OptionKind::Number | OptionKind::Count => span(self.bounds[0]),
            OptionKind::Point => self.bounds.map(span).join("; "),
        }
    }

    /// Returns the smallest value, for each of its numbers; none for names and lists.
    pub fn low(&self) -> Vec<f64> {
        self.side(0)
    }

    /// Returns the largest value, for each of its numbers; none for names and lists.
    pub fn high(&self) -> Vec<f64> {
        self.side(1)
    }

    fn side(&self, side: usize) -> Vec<f64> {
        match self.kind {
            OptionKind::List | OptionKind::Name(_) => Vec::new(),
            _ => self.bounds[..self.length()].iter().map(|bounds| bounds[side]).collect(),
        }
    }
}

fn span([low, high]: [f64; 2]) -> String {
    format!("{low} to {high}")
}

/// A type that an option may have.
pub(crate) trait OptionValue: Copy {
    type Range: Copy;
    const KIND: OptionKind;
    fn numbers(self) -> [f64; 3];
    fn from_numbers(numbers: [f64; 3]) -> Self;
    fn bounds(range: Self::Range) -> [[f64; 2]; 3];
}

impl OptionValue for f64 {
    type Range = [f64; 2];
    const KIND: OptionKind = OptionKind::Number;
    fn numbers(self) -> [f64; 3] {
        [self, 0.0, 0.0]
    }
    fn from_numbers([number, ..]: [f64; 3]) -> Self {
        number
    }
    fn bounds(range: [f64; 2]) -> [[f64; 2]; 3] {
        [range; 3]
    }
}

impl OptionValue for usize {
    type Range = [f64; 2];
    const KIND: OptionKind = OptionKind::Count;
    fn numbers(self) -> [f64; 3] {
        [self as f64, 0.0, 0.0]
    }
    fn from_numbers([number, ..]: [f64; 3]) -> Self {
        number as usize
    }
    fn bounds(range: [f64; 2]) -> [[f64; 2]; 3] {
        [range; 3]
    }
}

impl OptionValue for [f64; 3] {
    type Range = [[f64; 2]; 3];
    const KIND: OptionKind = OptionKind::Point;
    fn numbers(self) -> [f64; 3] {
        self
    }
    fn from_numbers(numbers: [f64; 3]) -> Self {
        numbers
    }
    fn bounds(range: [[f64; 2]; 3]) -> [[f64; 2]; 3] {
        range
    }
}

impl OptionValue for Option<[f64; 3]> {
    type Range = [[f64; 2]; 3];
    const KIND: OptionKind = OptionKind::Point;
    fn numbers(self) -> [f64; 3] {
        self.unwrap_or([f64::NAN; 3])
    }
    fn from_numbers(numbers: [f64; 3]) -> Self {
        (!numbers[0].is_nan()).then_some(numbers)
    }
    fn bounds(range: [[f64; 2]; 3]) -> [[f64; 2]; 3] {
        range
    }
}

/// Rows are read once, see [`Chosen::list`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows;

impl OptionValue for Rows {
    type Range = ();
    const KIND: OptionKind = OptionKind::List;
    fn numbers(self) -> [f64; 3] {
        [0.0; 3]
    }
    fn from_numbers(_: [f64; 3]) -> Self {
        Rows
    }
    fn bounds((): ()) -> [[f64; 2]; 3] {
        [[0.0; 2]; 3]
    }
}

/// The options of a task, as the task computes with them.
pub(crate) trait OptionSet: Copy + Send + Sync + 'static {
    fn list() -> Vec<TaskOption>;
    fn from_numbers(numbers: &[[f64; 3]]) -> Self;
}

/// No options.
impl OptionSet for () {
    fn list() -> Vec<TaskOption> {
        Vec::new()
    }
    fn from_numbers(_: &[[f64; 3]]) -> Self {}
}

/// Declares a task's options, each with type, default, unit, range and meaning; `drawn` ones may be a
/// distribution.
macro_rules! options {
    ($($mode:ident $name:ident: $type:ty = $default:expr, $unit:literal, $range:expr, $about:literal;)*) => {
        /// Options of the task.
        #[derive(Debug, Clone, Copy)]
        #[allow(dead_code, reason = "rows are read by their name")]
        pub struct Options {
            $(#[doc = $about] pub(crate) $name: $type,)*
        }

        impl $crate::task::options::OptionSet for Options {
            fn list() -> Vec<$crate::task::options::TaskOption> {
                use $crate::task::options::{OptionValue, declare};
                vec![$(declare::<$type>(
                    [stringify!($mode), stringify!($name), $unit, $about],
                    $default,
                    <$type as OptionValue>::bounds($range),
                ),)*]
            }
            fn from_numbers(numbers: &[[f64; 3]]) -> Self {
                let mut numbers = numbers.iter().copied();
                let mut next = || numbers.next().unwrap_or_default();
                Options {
                    $($name: <$type as $crate::task::options::OptionValue>::from_numbers(next()),)*
                }
            }
        }
    };
}
pub(crate) use options;

pub(crate) fn declare<V: OptionValue>(
    [mode, name, unit, about]: [&'static str; 4],
    default: V,
    bounds: [[f64; 2]; 3],
) -> TaskOption {
    TaskOption {
        name,
        unit,
        kind: V::KIND,
        default: default.numbers(),
        bounds,
        drawn: mode == "drawn",
        about,
    }
}

/// Most options that a task may have.
const MOST: usize = 16;

/// Origin of an option's value.
#[derive(Debug, Clone)]
enum Source {
    Numbers([Number; 3]),
    /// One of these, all coordinates together.
    Choice(Vec<[f64; 3]>),
}

/// The options that were chosen for a task.
#[derive(Debug, Clone)]
pub(crate) struct Chosen<O> {
    task: &'static str,
    list: Vec<TaskOption>,
    sources: Vec<Source>,
    given: Value,
    /// Options at the beginning of every episode, if nothing is drawn.
    fixed: Option<O>,
    options: PhantomData<O>,
}

impl<O: OptionSet> Chosen<O> {
    /// # Errors
    /// [`Error::Config`] for other JSON than an object, [`Error::Unknown`] for an option that there is not,
    /// and for values of the wrong type or out of range.
    pub(crate) fn read(task: &'static str, given: &Value) -> Result<Self> {
        let list = O::list();
        let empty = serde_json::Map::new();
        let map = match given {
            Value::Null => &empty,
            Value::Object(map) => map,
            other => {
                return Err(Error::Config(format!("task_options is {other}, expected an object of options")));
            }
        };
        let full = |name: &str| format!("{task}.{name}");
        if let Some(name) = map.keys().find(|name| list.iter().all(|option| option.name != name.as_str())) {
            let known: Vec<String> = list.iter().map(|option| full(option.name)).collect();
            return Err(unknown("option of this task", &full(name), known.iter().map(String::as_str)));
        }
        let sources: Vec<Source> = list
            .iter()
            .map(|option| match map.get(option.name) {
                Some(Value::Null) | None => Ok(usual(option.default)),
                Some(value) => read_source(task, option, value),
            })
            .collect::<Result<_>>()?;
        let fixed = sources.iter().map(Source::fixed).collect::<Option<Vec<_>>>();
        let fixed = fixed.map(|numbers| O::from_numbers(&numbers));
        Ok(Chosen { task, list, sources, given: given.clone(), fixed, options: PhantomData })
    }

    /// Returns whether the user gave the option.
    pub(crate) fn gives(&self, name: &str) -> bool {
        self.given.get(name).is_some_and(|value| !value.is_null())
    }

    /// Set an option that was not given.
    pub(crate) fn set(&mut self, name: &str, value: f64) {
        if let Some(at) = self.list.iter().position(|option| option.name == name) {
            self.sources[at] = usual([value, 0.0, 0.0]);
            let numbers = self.sources.iter().map(Source::fixed).collect::<Option<Vec<_>>>();
            self.fixed = numbers.map(|numbers| O::from_numbers(&numbers));
        }
    }

    /// The rows of a list.
    ///
    /// # Errors
    /// [`Error::Config`] for rows of another form.
    pub(crate) fn list<T: DeserializeOwned>(&self, name: &str) -> Result<Vec<T>> {
        match self.given.get(name) {
            None | Some(Value::Null) => Ok(Vec::new()),
            Some(value) => {
                serde_json::from_value(value.clone()).map_err(|e| wrong(self.task, format!("{name}: {e}")))
            }
        }
    }

    /// The options of one episode.
    pub(crate) fn draw(&self, rng: &mut Pcg64Mcg) -> O {
        if let Some(fixed) = self.fixed {
            return fixed;
        }
        let mut numbers = [[0.0; 3]; MOST];
        for ((source, option), slot) in self.sources.iter().zip(&self.list).zip(&mut numbers) {
            *slot = source.draw(option, rng);
        }
        O::from_numbers(&numbers)
    }

    /// Options with the smallest and the largest of what each may become, in all combinations: what has to be true of
    /// several at once is checked on them. The first also has the options that are not drawn.
    pub(crate) fn corners(&self) -> impl Iterator<Item = O> + '_ {
        let ends: Vec<[[f64; 3]; 2]> =
            self.sources.iter().zip(&self.list).map(|(source, option)| source.ends(option)).collect();
        let varied: Vec<usize> = (0..ends.len()).filter(|i| self.sources[*i].fixed().is_none()).collect();
        (0..1_usize << varied.len()).map(move |corner| {
            let mut numbers: Vec<[f64; 3]> = ends.iter().map(|ends| ends[0]).collect();
            for (bit, at) in varied.iter().enumerate() {
                numbers[*at] = ends[*at][corner >> bit & 1];
            }
            O::from_numbers(&numbers)
        })
    }

    /// The first of [`Chosen::corners`].
    pub(crate) fn first(&self) -> O {
        let numbers: Vec<[f64; 3]> =
            self.sources.iter().zip(&self.list).map(|(source, option)| source.ends(option)[0]).collect();
        O::from_numbers(&numbers)
    }
}

fn usual(numbers: [f64; 3]) -> Source {
    Source::Numbers(numbers.map(Number::Fixed))
}

impl Source {
    fn fixed(&self) -> Option<[f64; 3]> {
        match self {
            Source::Numbers([x, y, z]) => Some([x.fixed()?, y.fixed()?, z.fixed()?]),
            Source::Choice(_) => None,
        }
    }

    fn draw(&self, option: &TaskOption, rng: &mut Pcg64Mcg) -> [f64; 3] {
        match self {
            Source::Choice(points) => points[rng.random_range(0..points.len())],
            Source::Numbers(numbers) => {
                let mut drawn = [0.0; 3];
                for ((slot, number), bounds) in drawn.iter_mut().zip(numbers).zip(option.bounds) {
                    *slot = match number.fixed() {
                        Some(value) => value,
                        None => {
                            let [low, high] = number.ends(bounds);
                            number.draw(rng).clamp(low, high)
                        }
                    };
                }
                drawn
            }
        }
    }

    /// The smallest and the largest value of each coordinate.
    fn ends(&self, option: &TaskOption) -> [[f64; 3]; 2] {
        match self {
            Source::Numbers(numbers) => {
                let ends: [[f64; 2]; 3] = std::array::from_fn(|i| numbers[i].ends(option.bounds[i]));
                [0, 1].map(|side| ends.map(|ends| ends[side]))
            }
            Source::Choice(points) => {
                let extreme = |pick: fn(f64, f64) -> f64| {
                    std::array::from_fn(|i| points.iter().map(|p| p[i]).fold(points[0][i], pick))
                };
                [extreme(f64::min), extreme(f64::max)]
            }
        }
    }
}

/// Creates the error for an option that cannot be read.
fn wrong(task: &str, problem: String) -> Error {
    Error::Config(format!("options of the task {task}: {problem}"))
}

fn read_source(task: &str, option: &TaskOption, value: &Value) -> Result<Source> {
    if !option.drawn && value.is_object() && value.get("value").is_none() {
        return Err(wrong(task, format!("{} is {value}, expected one value: it is not drawn", option.name)));
    }
    match option.kind {
        OptionKind::List if value.is_array() => Ok(usual([0.0; 3])),
        OptionKind::List => Err(wrong(task, format!("{} is {value}, expected a list", option.name))),
        OptionKind::Name(names) => read_name(task, option.name, names, value),
        OptionKind::Point => read_point(task, option, value),
        OptionKind::Number => {
            Ok(Source::Numbers([number(task, option, 0, value)?, Number::Fixed(0.0), Number::Fixed(0.0)]))
        }
        OptionKind::Count => {
            let count = number(task, option, 0, value)?;
            let whole = |x: &f64| *x == x.trunc();
            let good = match &count {
                Number::Distribution(Distribution::Choice(of)) => of.iter().all(whole),
                Number::Distribution(_) => false,
                other => other.fixed().as_ref().is_some_and(whole),
            };
            if good {
                return Ok(Source::Numbers([count, Number::Fixed(0.0), Number::Fixed(0.0)]));
            }
            let want = "a whole number or {\"choice\": [...]} of some";
            Err(wrong(task, format!("{} is {value}, expected {want}", option.name)))
        }
    }
}

fn read_name(task: &str, name: &str, names: &[&str], value: &Value) -> Result<Source> {
    let none = || wrong(task, format!("{name} is {value}, expected one of {}", names.join(", ")));
    let text = value.as_str().ok_or_else(none)?;
    match names.iter().position(|known| *known == text) {
        Some(at) => Ok(usual([at as f64, 0.0, 0.0])),
        None => Err(wrong(task, format!("{name}: {}", unknown("value", text, names.iter().copied())))),
    }
}

/// Three coordinates, each a number or a distribution, or a distribution of points.
fn read_point(task: &str, option: &TaskOption, value: &Value) -> Result<Source> {
    let bad = || {
        let want = "three numbers, or a distribution such as {\"uniform\": [[-1, -1, 0.5], [1, 1, 1]]}";
        wrong(task, format!("{} is {value}, expected {want}", option.name))
    };
    let number = |axis: usize, value: &Value| number(task, option, axis, value);
    match value {
        Value::Array(items) if items.len() == 3 => {
            Ok(Source::Numbers([number(0, &items[0])?, number(1, &items[1])?, number(2, &items[2])?]))
        }
        Value::Object(map) if map.len() == 1 => {
            let Some((kind, points)) = map.iter().next() else { return Err(bad()) };
            let rows: Vec<[f64; 3]> = serde_json::from_value(points.clone()).map_err(|_| bad())?;
            let axis = |i: usize| {
                let column: Vec<f64> = rows.iter().map(|row| row[i]).collect();
                number(i, &serde_json::json!({ kind: column }))
            };
            let axes = [axis(0)?, axis(1)?, axis(2)?];
            Ok(if kind == "choice" { Source::Choice(rows) } else { Source::Numbers(axes) })
        }
        _ => Err(bad()),
    }
}

fn number(task: &str, option: &TaskOption, axis: usize, value: &Value) -> Result<Number> {
    let number: Number = serde_json::from_value(value.clone()).map_err(|_| {
        let drawn = if option.drawn { " or a distribution such as {\"uniform\": [0.1, 0.2]}" } else { "" };
        wrong(task, format!("{} is {value}, expected a number{drawn}", option.name))
    })?;
    let name = if option.kind == OptionKind::Point {
        format!("{}[{axis}]", option.name)
    } else {
        option.name.to_owned()
    };
    let [low, high] = option.bounds[axis];
    number.check(&Bounds { name, unit: option.unit, low, high })?;
    Ok(number)
}

#[cfg(test)]
mod tests;
