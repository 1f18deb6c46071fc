//! Flights of another vehicle than the model's: how that shows, and the commands that get the right numbers.

use crazyflie_env::model::VerticalInput;
use crazyflie_logs::{AttitudeSource, PositionSource};
use serde::Serialize;

use super::{Run, Source};
use crate::cli::number;

/// Hover PWM of one vehicle spread by 3 % from flight to flight (11 real flights): a vehicle that is off by five times that is another.
const FOREIGN: f64 = 0.15;

/// A model whose vehicle is not the one that flew.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ForeignModel {
    pub flown_hover_pwm: f64,
    pub model_hover_pwm: f64,
    /// What to run in place of this explanation, in order.
    pub commands: [String; 2],
}

impl Run {
    /// Where the flights hover at a PWM that differs from the model's by more than flights of one vehicle do.
    pub(crate) fn foreign_model(&self) -> Option<ForeignModel> {
        let flown_hover_pwm = self.flown_hover_pwm()?;
        let forms = [self.vertical(), VerticalInput::Thrust, VerticalInput::Pwm].into_iter();
        let hovers = forms.filter_map(|form| self.model.vertical(form).ok()?.hover_pwm());
        let model_hover_pwm = hovers.into_iter().find(|pwm| pwm.is_finite())?;
        let is_foreign = (flown_hover_pwm / model_hover_pwm - 1.0).abs() > FOREIGN;
        is_foreign.then(|| ForeignModel { flown_hover_pwm, model_hover_pwm, commands: self.own_model_commands() })
    }

    /// Median over flights of the PWM that carries the vehicle.
    fn flown_hover_pwm(&self) -> Option<f64> {
        let by_trim = self.trims.iter().filter_map(|trim| trim.values.iter().find(|(name, ..)| name == "hover_pwm"));
        let mut hovers: Vec<f64> = by_trim.map(|(.., pwm)| *pwm).collect();
        // a model with effects of its own may need another command than the mean to hover
        if hovers.is_empty() && self.model.effects.is_empty() {
            hovers = self.fit.sources.iter().filter_map(mean_thrust_pwm).collect();
        }
        hovers.sort_by(f64::total_cmp);
        hovers.get(hovers.len() / 2).copied()
    }

    /// Gets the numbers of the vehicle that flew, then asks what that model lacks.
    fn own_model_commands(&self) -> [String; 2] {
        let files = |sources: &[Source]| sources.iter().map(|s| quoted(&s.file)).collect::<Vec<_>>().join(" ");
        let (fit, test) = (files(&self.fit.sources), files(&self.test.sources));
        let start = self.model_file.as_deref().map_or(String::new(), |file| format!("{} ", quoted(file)));
        [
            format!("crazyflie identify {start}--fit {fit} --out mine.toml"),
            format!("crazyflie explain mine.toml --fit {fit} --test {test} --out explained"),
        ]
    }
}

/// The mean thrust command in flight: over a flight it carries the weight. Only of recordings: in a simulated flight another thrust is what one looks
/// for.
fn mean_thrust_pwm(source: &Source) -> Option<f64> {
    let (log, origin) = (&source.log, source.log.provenance);
    if origin.attitude != AttitudeSource::MotionCapture && origin.position != PositionSource::Estimate {
        return None;
    }
    let flown = log.cmd_thrust_pwm.as_ref()?.get(log.airborne.clone()).filter(|pwm| !pwm.is_empty())?;
    Some(flown.iter().sum::<f64>() / flown.len() as f64)
}

/// The warning in one sentence, without the commands.
pub(crate) fn foreign_sentence(run: &Run, foreign: &ForeignModel) -> String {
    format!(
        "The numbers of the model {} are not this vehicle's: it hovers at {} PWM, the model at {}. Identify it first, then explain what that model \
         lacks:",
        run.model.name,
        number(foreign.flown_hover_pwm, 0),
        number(foreign.model_hover_pwm, 0)
    )
}

/// A file name as a shell reads it.
pub(super) fn quoted(file: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "_-./+=:,@%".contains(c);
    if !file.is_empty() && file.chars().all(plain) { file.to_owned() } else { format!("'{}'", file.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_quoted_only_where_a_shell_would_split_them() {
        assert_eq!(["a/b-1.csv.gz", "my flight.csv", "it's.csv"].map(quoted), ["a/b-1.csv.gz", "'my flight.csv'", "'it'\\''s.csv'"]);
    }
}
