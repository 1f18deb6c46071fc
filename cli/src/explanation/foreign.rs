//! Flights of another vehicle than the model's: how that shows, and the commands that get the right numbers.

use crazyflie_identify::explain::foreign::{HoverPwm, foreign_hover_pwm};
use serde::Serialize;

use super::{FlightSource, Run};
use crate::text::number;

/// A model whose vehicle is not the one that flew.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ForeignModel {
    /// Hover PWM of the flights and of the model, if these differ by more than flights of one vehicle do.
    pub hover_pwm: Option<HoverPwm>,
    /// Commands to run in place of this explanation, in order.
    pub commands: [String; 2],
}

impl Run {
    /// A warning if the flights hover at another PWM than the model, or if numbers fitted to them predict far
    /// better.
    pub(crate) fn foreign_model(&self) -> Option<ForeignModel> {
        let logs = self.fit.sources.iter().map(|source| &source.log);
        let hover_pwm = foreign_hover_pwm(&self.model, self.vertical(), &self.trims, logs);
        (hover_pwm.is_some() || self.found.foreign)
            .then(|| ForeignModel { hover_pwm, commands: self.own_model_commands() })
    }

    /// Returns the commands that fit the vehicle that flew, and then explain that model.
    fn own_model_commands(&self) -> [String; 2] {
        let files = |sources: &[FlightSource]| {
            sources.iter().map(|s| shell_quoted(&s.file)).collect::<Vec<_>>().join(" ")
        };
        let (fit, test) = (files(&self.fit.sources), files(&self.test.sources));
        let start =
            self.model_file.as_deref().map_or(String::new(), |file| format!("{} ", shell_quoted(file)));
        [
            format!("crazyflie identify {start}--fit {fit} --out mine.toml"),
            format!("crazyflie explain mine.toml --fit {fit} --test {test} --out explained"),
        ]
    }
}

/// The warning in one sentence, without the commands.
pub(crate) fn foreign_sentence(run: &Run, foreign: &ForeignModel) -> String {
    let reason = foreign.hover_pwm.map_or_else(
        || "numbers fitted to its flights predict far better".to_owned(),
        |pwm| format!("it hovers at {} PWM, the model at {}", number(pwm.flown, 0), number(pwm.model, 0)),
    );
    format!(
        "The numbers of the model {} are not this vehicle's: {reason}. Identify it first, then explain what that model lacks.",
        run.model.name
    )
}

/// A file name as a shell reads it.
pub(super) fn shell_quoted(file: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "_-./+=:,@%".contains(c);
    if !file.is_empty() && file.chars().all(plain) {
        file.to_owned()
    } else {
        format!("'{}'", file.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_quoted_only_where_a_shell_would_split_them() {
        assert_eq!(
            ["a/b-1.csv.gz", "my flight.csv", "it's.csv"].map(shell_quoted),
            ["a/b-1.csv.gz", "'my flight.csv'", "'it'\\''s.csv'"]
        );
    }
}
