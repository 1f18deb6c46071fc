//! Rewards and ends of episodes as a user writes them: `exp(-4*dist**2) - 0.01*rate2`. Text becomes a list of
//! steps, which the lanes of a tile take side by side.

mod moment;
mod parse;
mod program;
mod unit;

pub use moment::expression_fields;
pub(crate) use moment::{LOAD_POS, Moment, PAIR_FIELDS, Pairs, find_expression_field};
pub(crate) use program::{Program, holds};

use crate::error::Result;

/// Names of the functions that an expression may call.
pub fn expression_functions() -> impl Iterator<Item = &'static str> {
    parse::function_names()
}

/// A reward: an expression that is a number.
///
/// # Errors
/// [`crate::Error::Expression`] with the column.
pub(crate) fn parse_reward(text: &str) -> Result<Program> {
    parse::parse_number("reward", text)
}

/// A cost, as of constrained learning: an expression that is a number.
///
/// # Errors
/// The errors of [`parse_reward`].
pub(crate) fn parse_cost(text: &str) -> Result<Program> {
    parse::parse_number("cost", text)
}

/// The end of a flight: an expression that is a condition.
///
/// # Errors
/// [`crate::Error::Expression`] with the column.
pub(crate) fn parse_termination(text: &str) -> Result<Program> {
    parse::parse_condition("termination", text)
}

#[cfg(test)]
mod tests;
