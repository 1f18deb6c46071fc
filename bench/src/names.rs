//! Names that people see: no letter that cannot be seen, that turns the line around, or that looks like nothing.

use unicode_security::{GeneralSecurityProfile as _, RestrictionLevel, RestrictionLevelDetection as _};

use super::error::{Error, Result};

/// The team of attempts from this machine's own command line.
pub(super) const LOCAL: &str = "local";

/// Characters of a name besides letters and digits of any script.
const MARKS: &str = " -_.:+/()@#=,";

/// # Errors
/// [`Error::Name`] for a controller's name with other characters, too many of them, or blanks at its ends.
pub(super) fn check_controller(name: &str) -> Result<()> {
    let plain = |c: char| (c.is_alphanumeric() && c.identifier_allowed()) || MARKS.contains(c);
    let ends = [name.chars().next(), name.chars().last()];
    let is_good = (1..=64).contains(&name.chars().count())
        && name.chars().all(plain)
        && name.chars().any(char::is_alphanumeric)
        && !ends.contains(&Some(' '))
        && !name.contains("  ");
    let letters: String = name.chars().filter(|c| c.is_alphanumeric()).collect();
    let want = match is_good {
        // letters of two alphabets that look alike make two names of one
        true if letters.as_str().check_restriction_level(RestrictionLevel::HighlyRestrictive) => {
            return Ok(());
        }
        true => "letters of one script (or Latin beside Chinese, Japanese or Korean)",
        false => "1 to 64 letters, digits, single blanks within, and - _ . : + / ( ) @ # = ,",
    };
    Err(Error::Name { what: "controller", name: name.escape_debug().to_string(), want })
}

/// # Errors
/// [`Error::Name`] for a team's name.
pub(super) fn check_team(name: &str) -> Result<()> {
    let letters = name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'));
    if letters && (1..=32).contains(&name.len()) && name != LOCAL {
        return Ok(());
    }
    let want = "1 to 32 letters, digits, '-', '_' or '.', and not \"local\"";
    Err(Error::Name { what: "team", name: name.escape_debug().to_string(), want })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_can_be_read() {
        for good in [
            "x",
            "thesis-pid",
            "my PID 2",
            "policy:hover.safetensors",
            "Größe",
            "kalman+lqr",
            "制御",
            "PID 制御",
            "контроль",
        ] {
            check_controller(good).unwrap_or_else(|e| panic!("{}: {e}", good.escape_debug()));
        }
        let long = "x".repeat(65);
        for bad in [
            "",
            " ",
            "-",
            "x ",
            " x",
            "a  b",
            "x\n",
            "\u{1b}[2J",
            "a\u{200b}b",
            "a\u{202e}b",
            "\u{2066}x",
            "\u{feff}x",
            "a\u{ad}b",
            "a\u{a0}b",
            "\u{3164}",
            "x\u{301}",
            "\u{2800}",
            "<b>",
            "thesis-p\u{456}d",
            "\u{440}id",
            "p\u{3bf}licy",
            &long,
        ] {
            assert!(check_controller(bad).is_err(), "{}", bad.escape_debug());
        }
    }
}
