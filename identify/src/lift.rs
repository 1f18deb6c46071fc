//! The commands of a flight log that drive the forms of a model, and its motors.

use std::borrow::Cow;

use crazyflie_env::model::{FULL_PWM, Model, PwmSource, TiltInput, VerticalInput};

use crate::{Error, FlightLog, NamedLog, Result};

/// The PWM of each row where the model was identified with it (see [`PwmSource`]).
///
/// # Errors
/// [`Error::Logs`] names what the log lacks.
pub fn read_pwm<'a>(log: &'a FlightLog, model: &Model) -> Result<Cow<'a, [f64]>> {
    let commanded = log.cmd_thrust_pwm.as_deref().map(Cow::Borrowed);
    if model.vertical.pwm_source == PwmSource::Command {
        return commanded.ok_or_else(|| no_commands("thrust command"));
    }
    let of_motors = log.motor_pwm_at(model.battery_reference_v()).map(Cow::Owned);
    of_motors.or(commanded.filter(|_| log.is_simulated())).ok_or_else(|| {
        let name = &model.name;
        Error::Logs(format!(
            "the log holds no motor PWM with battery voltage, which drives the model {name}; `crazyflie identify {name} --pwm-source command` makes one that the thrust command drives"
        ))
    })
}

/// The lift command of each row for a vertical form: a height in metres, or a PWM.
///
/// # Errors
/// The errors of [`read_pwm`].
pub(crate) fn read_lift<'a>(
    log: &'a FlightLog,
    model: &Model,
    input: VerticalInput,
) -> Result<Cow<'a, [f64]>> {
    if input.is_pwm() {
        return read_pwm(log, model);
    }
    let height = log.cmd_height_m.as_deref().map(Cow::Borrowed);
    height.ok_or_else(|| no_commands("height command"))
}

/// An error that names the commands that a log lacks.
pub(crate) fn no_commands(what: &str) -> Error {
    Error::Logs(format!("the log holds no {what}, so there is nothing to drive the model with"))
}

const BY_RATES: &str = "roll and pitch commands as angles, but body rates or moments, for which `crazyflie identify` finds a model";

/// The roll and pitch commands of each row, as the model takes them: angles, body rates or moments.
///
/// # Errors
/// The errors of [`read_pwm`].
pub(crate) fn read_tilt(log: &FlightLog, input: TiltInput) -> Result<[&[f64]; 2]> {
    let onboard = log.onboard.as_ref();
    let (found, what) = match input {
        TiltInput::Angle => {
            let angles = log.cmd_roll_rad.as_deref().zip(log.cmd_pitch_rad.as_deref());
            let by_rates = onboard.is_some_and(|o| o.cmd_rates_radps.is_some() || o.cmd_torque_nm.is_some());
            let what = if by_rates { BY_RATES } else { "roll and pitch commands" };
            (angles.map(|(roll, pitch)| [roll, pitch]), what)
        }
        TiltInput::Rate => (onboard.and_then(|o| about_x_and_y(&o.cmd_rates_radps)), "body-rate commands"),
        TiltInput::Torque => (onboard.and_then(|o| about_x_and_y(&o.cmd_torque_nm)), "commands of moments"),
    };
    found.ok_or_else(|| no_commands(what))
}

/// Returns the roll and pitch input that all logs contain: angles if present, else body rates, else moments.
pub(crate) fn tilt_input(logs: &[NamedLog]) -> Option<TiltInput> {
    let hold = |input: &TiltInput| logs.iter().all(|(_, log)| read_tilt(log, *input).is_ok());
    [TiltInput::Angle, TiltInput::Rate, TiltInput::Torque].into_iter().find(hold)
}

fn about_x_and_y(axes: &Option<[Vec<f64>; 3]>) -> Option<[&[f64]; 2]> {
    axes.as_ref().map(|[x, y, _]| [x.as_slice(), y.as_slice()])
}

/// Returns whether a command changes by more than rounding.
pub(crate) fn varies(command: &[f64]) -> bool {
    let largest = command.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    command.iter().any(|v| (v - command[0]).abs() > 1e-6 * largest)
}

/// The mean voltage of each motor, row by row: share of full PWM times battery voltage.
pub(crate) fn motor_voltages(log: &FlightLog) -> Option<[Vec<f64>; 4]> {
    let (pwm, vbat) = (log.onboard.as_ref()?.motor_pwm.as_ref()?, log.vbat_v.as_ref()?);
    Some(pwm.each_ref().map(|motor| motor.iter().zip(vbat).map(|(pwm, v)| pwm / FULL_PWM * v).collect()))
}
