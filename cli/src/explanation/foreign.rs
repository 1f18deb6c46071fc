//! Flights of another vehicle than the model's: how that shows, and the commands that get the right numbers.

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_identify::lift::read_pwm;
use crazyflie_logs::{AttitudeSource, PositionSource};
use serde::Serialize;

use super::{FlightSource, Run};
use crate::text::number;

/// Hover PWM of one vehicle spread by 3 % from flight to flight (11 real flights): a vehicle that is off by
/// five times that is another.
const FOREIGN: f64 = 0.15;

/// A model whose vehicle is not the one that flew.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ForeignModel {
    /// Of the flights and of the model, where these differ by more than flights of one vehicle do.
    pub hover_pwm: Option<HoverPwm>,
    /// Commands to run in place of this explanation, in order.
    pub commands: [String; 2],
}

#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct HoverPwm {
    pub flown: f64,
    pub model: f64,
}

impl Run {
    /// A warning if the flights hover at another PWM than the model, or if numbers fitted to them predict far
    /// better.
    pub(crate) fn foreign_model(&self) -> Option<ForeignModel> {
        let hover_pwm = self.foreign_hover_pwm();
        (hover_pwm.is_some() || self.found.foreign)
            .then(|| ForeignModel { hover_pwm, commands: self.own_model_commands() })
    }

    fn foreign_hover_pwm(&self) -> Option<HoverPwm> {
        let flown = self.flown_hover_pwm()?;
        let forms = [self.vertical(), VerticalInput::Thrust, VerticalInput::Pwm].into_iter();
        let hovers = forms.filter_map(|form| self.model.vertical(form).ok()?.hover_pwm());
        let model = hovers.into_iter().find(|pwm| pwm.is_finite())?;
        ((flown / model - 1.0).abs() > FOREIGN).then_some(HoverPwm { flown, model })
    }

    /// Median over flights of the PWM that carries the vehicle.
    fn flown_hover_pwm(&self) -> Option<f64> {
        let by_trim =
            self.trims.iter().filter_map(|trim| trim.values.iter().find(|(name, ..)| name == "hover_pwm"));
        let mut hovers: Vec<f64> = by_trim.map(|(.., pwm)| *pwm).collect();
        // a model with effects of its own may need another command than the mean to hover
        if hovers.is_empty() && self.model.effects.is_empty() {
            hovers =
                self.fit.sources.iter().filter_map(|source| mean_thrust_pwm(source, &self.model)).collect();
        }
        hovers.sort_by(f64::total_cmp);
        hovers.get(hovers.len() / 2).copied()
    }

    /// Gets the numbers of the vehicle that flew, then asks what that model lacks.
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

/// The mean thrust command in flight: over a flight it carries the weight. Only of recordings: in a simulated
/// flight another thrust is what one looks for.
fn mean_thrust_pwm(source: &FlightSource, model: &Model) -> Option<f64> {
    let (log, origin) = (&source.log, source.log.provenance);
    if origin.attitude != AttitudeSource::MotionCapture && origin.position != PositionSource::Estimate {
        return None;
    }
    let pwm = read_pwm(log, model).ok()?;
    let flown = pwm.get(log.airborne.clone()).filter(|pwm| !pwm.is_empty())?;
    Some(flown.iter().sum::<f64>() / flown.len() as f64)
}

/// The warning in one sentence, without the commands.
pub(crate) fn foreign_sentence(run: &Run, foreign: &ForeignModel) -> String {
    let reason = foreign.hover_pwm.map_or_else(
        || "numbers fitted to its flights predict far better".to_owned(),
        |pwm| format!("it hovers at {} PWM, the model at {}", number(pwm.flown, 0), number(pwm.model, 0)),
    );
    format!(
        "The numbers of the model {} are not this vehicle's: {reason}. Identify it first, then explain what that model lacks:",
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
