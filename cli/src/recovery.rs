//! The identification flights of chapter 5, flown by the simulator, recorded, and identified: the thesis's
//! equations must come back.

use crazyflie_control::ControllerSpec;
use crazyflie_env::Error;
use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::{EffectParams, EffectTable, Number};
use crazyflie_env::model::{Model, Vertical, VerticalInput};
use crazyflie_env::plant::Command;
use crazyflie_identify::FlightLog;
use crazyflie_identify::estimate::{IdentifyError, ParameterEstimate};
use crazyflie_identify::transfer::{Channel, Record, WindowLength, identify};
use crazyflie_identify::vehicle;

use crazyflie_server::flight::{FlightScenario, Setup, fly_with_override, lab_rig, log};

/// 5.1: "after 10 seconds".
const HOVER_S: f64 = 10.0;
const STEP_RAD: f64 = 7.5 * std::f64::consts::PI / 180.0;
const YAW_RADPS: f64 = 36.0 * std::f64::consts::PI / 180.0;
/// The white error of the angles that the rig adds to the lab's camera. The thesis gives none; this is the
/// scatter of a Crazyflie at hover.
const ANGLE_NOISE_DEG: f64 = 0.2;

/// Sensors of the flights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sensors {
    /// The true pose at every control tick.
    Ideal,
    /// 30 Hz frames, 50 ms late, with noise, which the controller answers; noisy angles.
    Rig,
}

impl Sensors {
    pub(crate) fn name(self) -> &'static str {
        if self == Sensors::Ideal { "ideal" } else { "camera rig" }
    }

    fn effects(self) -> EffectTable {
        if self == Sensors::Ideal {
            return EffectTable::new();
        }
        let angles =
            EffectParams::Named([("angle_noise_deg".to_owned(), Number::Fixed(ANGLE_NOISE_DEG))].into());
        lab_rig().into_iter().chain([("gyro_bias".to_owned(), angles)]).collect()
    }
}

/// A parameter that was identified from simulated flights.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RecoveredParameter {
    pub equation: &'static str,
    pub experiment: &'static str,
    pub sensors: Sensors,
    pub truth: f64,
    pub estimate: ParameterEstimate,
    /// Of the flight, in windows; MATLAB's.
    pub fit_percent: Option<f64>,
}

impl RecoveredParameter {
    /// Distance from the truth in standard errors.
    pub(crate) fn deviations(&self) -> f64 {
        (self.estimate.value - self.truth) / self.estimate.standard_error
    }

    /// Distance from the truth as a share of it, or itself where the truth is zero.
    pub(crate) fn relative(&self) -> f64 {
        let scale = if self.truth == 0.0 { 1.0 } else { self.truth.abs() };
        (self.estimate.value - self.truth).abs() / scale
    }
}

/// A flight after its hover.
struct Experiment {
    name: &'static str,
    equation: &'static str,
    channel: Channel,
    vertical: VerticalInput,
    seconds: f64,
    height_m: f32,
    command: fn(Command<f64>) -> Command<f64>,
}

fn unchanged(u: Command<f64>) -> Command<f64> {
    u
}

#[rustfmt::skip]
const EXPERIMENTS: [Experiment; 6] = [
    Experiment { name: "pitch 7.5 deg (5.1.1)", equation: "5.1", channel: Channel::Pitch, vertical: VerticalInput::Pwm, seconds: 1.2, height_m: 0.7,
        command: |u| Command { pitch_rad: STEP_RAD, ..u } },
    Experiment { name: "roll 7.5 deg (5.1.1)", equation: "5.1", channel: Channel::Roll, vertical: VerticalInput::Pwm, seconds: 1.2, height_m: 0.7,
        command: |u| Command { roll_rad: STEP_RAD, ..u } },
    Experiment { name: "yaw 36 deg/s (5.1.2)", equation: "5.2", channel: Channel::Yaw, vertical: VerticalInput::Pwm, seconds: 10.0, height_m: 0.7,
        command: |u| Command { yaw_rate_radps: YAW_RADPS, ..u } },
    Experiment { name: "height 70 to 80 cm (5.1.3)", equation: "5.3", channel: Channel::Height, vertical: VerticalInput::Height, seconds: 6.0, height_m: 0.8,
        command: unchanged },
    Experiment { name: "height by PWM (5.1.3)", equation: "5.4", channel: Channel::Pwm, vertical: VerticalInput::Pwm, seconds: 6.0, height_m: 0.8,
        command: unchanged },
    Experiment { name: "speed at 7.5 deg (5.1.4)", equation: "5.5", channel: Channel::CommandVx, vertical: VerticalInput::Pwm, seconds: 1.2, height_m: 0.7,
        command: |u| Command { pitch_rad: STEP_RAD, ..u } },
];

/// Number of calls of `done`: each experiment with both kinds of sensors, and the whole model with each.
pub(crate) const COUNT: usize = 2 * EXPERIMENTS.len() + 2;

/// The log of an experiment, hover first, by the thesis's PID until the experiment overrules it.
fn fly_experiment(
    model: &Model,
    experiment: &Experiment,
    sensors: Sensors,
    seed: u64,
) -> Result<FlightLog, Error> {
    let setup = Setup {
        model: model.clone(),
        scenario: FlightScenario::find("hover-70cm")?,
        task_options: None,
        own: None,
        action: ActionLevel::Attitude,
        controller: ControllerSpec::named("thesis-pid")?,
        effects: sensors.effects(),
        vertical: experiment.vertical,
        seconds: HOVER_S + experiment.seconds,
    };
    // half a tick of margin for the clock's rounding
    let after = |t_s: f64| t_s > HOVER_S - 5e-3;
    let height = |t_s: f64| if after(t_s) { experiment.height_m } else { 0.7 };
    let traces = fly_with_override(&setup, &[seed], &height, &|t_s, u| {
        if after(t_s) { (experiment.command)(u) } else { u }
    })?;
    // as a recording: through the project's CSV
    let mut bytes = Vec::new();
    let written =
        log(&traces[0]).write_csv(&mut bytes).and_then(|()| FlightLog::from_bytes(experiment.name, &bytes));
    written.map_err(|e| Error::Config(format!("{}: {e}", experiment.name)))
}

/// Every coefficient of 5.1 to 5.5 by itself, as the thesis did. `done` is called after each experiment.
pub(crate) fn equations(
    model: &Model,
    sensors: Sensors,
    seed: u64,
    done: &dyn Fn(),
) -> Result<Vec<RecoveredParameter>, IdentifyError> {
    let mut all = Vec::new();
    for experiment in &EXPERIMENTS {
        let log = fly_experiment(model, experiment, sensors, seed)?;
        let record = Record::from_log(experiment.name, &log, experiment.channel)?;
        // a simulated flight needs no new start: nothing disturbs it
        let identified =
            identify(&[record], experiment.channel, experiment.channel.structure(), WindowLength::Whole)?;
        let fit_percent = identified.fit.first().and_then(|c| c.fit.fit_percent);
        let line = |(estimate, truth): (&ParameterEstimate, f64)| RecoveredParameter {
            equation: experiment.equation,
            experiment: experiment.name,
            sensors,
            truth,
            estimate: estimate.clone(),
            fit_percent,
        };
        all.extend(identified.parameters.iter().zip(truths(model, experiment.channel)).map(line));
        done();
    }
    Ok(all)
}

/// The coefficients that the model has, in the order of an identified structure.
fn truths(model: &Model, channel: Channel) -> Vec<f64> {
    let tilt = |t: &crazyflie_env::model::Tilt| vec![t.gain.value, t.damping.value, t.stiffness.value];
    let first_order = |form: &Option<Vertical>| match form {
        Some(Vertical::FirstOrder { gain, pole, offset, .. }) => {
            [gain.value, pole.value].into_iter().chain(offset.iter().map(|q| q.value)).collect()
        }
        _ => Vec::new(),
    };
    match channel {
        Channel::Pitch => tilt(&model.pitch),
        Channel::Roll => tilt(&model.roll),
        Channel::Yaw => model.parameter("yaw.gain").into_iter().collect(),
        Channel::Height => first_order(&model.vertical.height),
        Channel::Pwm => first_order(&model.vertical.pwm),
        // 5.5 is 5.1 times g / s
        _ => vec![
            model.pitch.gain.value * model.lateral.gravity.value,
            model.pitch.damping.value,
            model.pitch.stiffness.value,
        ],
    }
}

/// Factor by which the start values of the whole model are wrong.
const WRONG: f64 = 1.3;

/// The numbers of the model, all at once from the flights that PWM commands, starting from numbers that are
/// 30 % off.
pub(crate) fn whole_model(
    model: &Model,
    sensors: Sensors,
    seed: u64,
    done: &dyn Fn(),
) -> Result<Vec<RecoveredParameter>, IdentifyError> {
    let mut logs = Vec::new();
    for experiment in EXPERIMENTS[..5].iter().filter(|e| e.vertical == VerticalInput::Pwm) {
        logs.push((experiment.name.to_owned(), fly_experiment(model, experiment, sensors, seed)?));
    }
    let mut start = model.clone();
    for path in vehicle::visible(model, &logs, VerticalInput::Pwm) {
        let truth = model.parameter(&path)?;
        // an offset of 45500 would be above every command
        let wrong = if path.ends_with(".offset") { 0.9 * truth } else { WRONG * truth };
        start = start.with_parameter(&path, wrong)?;
    }
    let plan = vehicle::FitOptions { vertical: Some(VerticalInput::Pwm), ..vehicle::FitOptions::default() };
    let identified = vehicle::identify(&start, &logs, &plan, &|| ())?;
    done();
    let line = |estimate: &ParameterEstimate| {
        let truth = model.parameter(&estimate.name)?;
        let experiment = "all PWM flights, all numbers";
        Ok(RecoveredParameter {
            equation: "4.15",
            experiment,
            sensors,
            truth,
            estimate: estimate.clone(),
            fit_percent: None,
        })
    };
    identified.parameters.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without noise what is left is the 32-bit rounding of the recording.
    #[test]
    fn the_equations_come_back_from_ideal_flights() {
        for recovered in equations(&Model::thesis(), Sensors::Ideal, 0, &|| ()).unwrap() {
            assert!(recovered.relative() < 2e-3, "{recovered:?}");
            assert!(recovered.fit_percent.unwrap() > 99.9, "{recovered:?}");
        }
    }

    /// Through the camera within four standard errors, and these within what one step of 7.5 degrees or 10 cm
    /// can give.
    #[test]
    fn the_equations_come_back_through_the_camera() {
        for recovered in equations(&Model::thesis(), Sensors::Rig, 0, &|| ()).unwrap() {
            let allowed = match recovered.equation {
                "5.1" => 0.2,
                "5.2" => 0.03,
                "5.5" => 0.5,
                _ => 0.35,
            };
            assert!(recovered.deviations().abs() < 4.0 && recovered.relative() < allowed, "{recovered:?}");
        }
    }

    #[test]
    fn the_whole_model_comes_back_from_wrong_numbers() {
        for (sensors, allowed) in [(Sensors::Ideal, 0.01), (Sensors::Rig, 0.35)] {
            for recovered in whole_model(&Model::thesis(), sensors, 0, &|| ()).unwrap() {
                assert!(recovered.relative() < allowed, "{recovered:?}");
            }
        }
    }
}
