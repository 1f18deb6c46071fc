//! The view of a result: tables, values with their units, and JSON.

use std::fmt::Display;
use std::io::Write;

pub(crate) use crazyflie_picture::Table;

use serde::Serialize;

use crate::failure::Outcome;

/// Writes a result for machines, as JSON over several lines.
pub(crate) fn write_json(result: &(impl Serialize + ?Sized), out: &mut dyn Write) -> Outcome {
    serde_json::to_writer_pretty(&mut *out, result)?;
    Ok(writeln!(out)?)
}

/// Returns lines below their heading.
pub(crate) fn listed(lines: &[String]) -> String {
    lines.iter().map(|line| format!("\n  {line}")).collect()
}

/// Writes a value, or a dash for a missing one.
pub(crate) fn or_dash<T: Display>(value: Option<T>) -> String {
    value.map_or("-".into(), |value| value.to_string())
}

/// A number with so many decimals and its unit; a dash where there is none.
pub(crate) fn quantity(value: f64, decimals: usize, unit: &str) -> String {
    or_dash(value.is_finite().then(|| format!("{} {unit}", number(value, decimals))))
}

/// A fit in percent with so many decimals. A free run of an integrator leaves any frame.
pub(crate) fn percent(fit: Option<f64>, decimals: usize) -> String {
    match fit {
        Some(fit) if fit < -9999.0 => "< -9999 %".into(),
        fit => quantity(fit.unwrap_or(f64::NAN), decimals, "%"),
    }
}

/// Seconds with so many decimals, until what may never happen.
pub(crate) fn seconds(value: Option<f64>, decimals: usize) -> String {
    value.map_or("never".into(), |s| quantity(s, decimals, "s"))
}

/// A number with so many decimals; no minus before a zero.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| matches!(c, '0' | '.')) => rest.to_owned(),
        _ => text,
    }
}

/// Formats an error with all its causes; words that an error repeats from its cause appear once.
pub(crate) fn with_cause(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(now) = cause {
        let more = now.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = now.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_has_a_unit_or_is_a_dash() {
        assert_eq!([quantity(1.25, 1, "cm"), quantity(f64::NAN, 2, "cm")], ["1.2 cm", "-"]);
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!([number(-0.001, 2), number(-0.1, 1), number(2.0, 0)], ["0.00", "-0.1", "2"]);
    }
}
