//! `crazyflie model`: the model as data.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::model::{Model, PwmSource, THESIS_TOML, VerticalInput};
use serde_json::{Value, json};

use super::{Failure, Outcome, files};

const EXAMPLES: &str = "\
Examples:
  crazyflie model --show > my.toml          the thesis's model, as a start for your own
  crazyflie model my.toml                   check a model file
  crazyflie model my.toml --show --json     the same model as JSON
  crazyflie model --schema                  what a model file holds, as JSON Schema
  crazyflie model --datasheet examples/crazyflie_datasheet.toml --out my.toml    of a vehicle's data sheet";

/// Show or check a model, or print the schema of model files.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Model file (TOML or JSON); the thesis's model unless given
    file: Option<PathBuf>,
    /// Print the model
    #[arg(long)]
    show: bool,
    /// Make the model of a data sheet (TOML or JSON; docs/datasheet.md)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["file", "schema"])]
    datasheet: Option<PathBuf>,
    /// Write the model to this file
    #[arg(long, value_name = "FILE", conflicts_with = "schema")]
    out: Option<PathBuf>,
    /// Print the JSON Schema of model files
    #[arg(long, conflicts_with = "show")]
    schema: bool,
    /// For machines
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.schema {
        serde_json::to_writer_pretty(&mut *out, &schema())?;
        return Ok(writeln!(out)?);
    }
    let model = match &args.datasheet {
        Some(path) => files::read(path, Model::from_datasheet)?,
        None => files::model(args.file.as_deref())?,
    };
    if let Some(path) = &args.out {
        let text = model.to_toml().map_err(|e| Failure::about(&model.name, e))?;
        files::write(path, text.as_bytes())?;
    }
    if args.json {
        serde_json::to_writer_pretty(&mut *out, &model)?;
        return Ok(writeln!(out)?);
    }
    if args.show && args.file.is_none() && args.datasheet.is_none() {
        // with its comments
        return Ok(write!(out, "{THESIS_TOML}")?);
    }
    if args.show {
        let text = model.to_toml().map_err(|e| Failure::about(&model.name, e))?;
        return Ok(write!(out, "{text}")?);
    }
    describe(&model, out)
}

fn describe(m: &Model, out: &mut dyn Write) -> Outcome {
    let tilt = |t: &crazyflie_env::model::Tilt| {
        format!("{} / (s^2 + {} s + {})", t.gain.value, t.damping.value, t.stiffness.value)
    };
    writeln!(out, "model {}: {}", m.name, m.description)?;
    writeln!(out, "  roll   {}\n  pitch  {}", tilt(&m.roll), tilt(&m.pitch))?;
    let has = |input: &VerticalInput| m.vertical(*input).is_ok();
    let inputs: Vec<&str> = VerticalInput::ALL.into_iter().filter(has).map(VerticalInput::name).collect();
    writeln!(out, "  vertical inputs: {}", inputs.join(", "))?;
    let (r, effects) = (&m.rig, m.effects.keys().map(String::as_str).collect::<Vec<_>>());
    writeln!(out, "  control {} Hz, IMU {} Hz, camera {} Hz", r.control.value, r.imu.value, r.camera.value)?;
    writeln!(out, "  own effects: {}", if effects.is_empty() { "none".into() } else { effects.join(", ") })?;
    writeln!(out, "the file is good; --show prints it")?;
    Ok(())
}

/// An object with these required members and no others but `optional`.
fn object(required: &[(&str, Value)], optional: &[(&str, Value)]) -> Value {
    let properties: serde_json::Map<String, Value> =
        required.iter().chain(optional).map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    let names: Vec<&str> = required.iter().map(|(name, _)| *name).collect();
    json!({"type": "object", "properties": properties, "required": names, "additionalProperties": false})
}

fn quantity(unit: &str) -> Value {
    object(
        &[
            ("value", json!({"type": "number"})),
            ("unit", json!({"const": unit})),
            ("source", json!({"type": "string"})),
        ],
        &[],
    )
}

fn form(name: &str, mut required: Vec<(&str, Value)>, optional: &[(&str, Value)]) -> Value {
    required.push(("form", json!({"const": name})));
    object(&required, optional)
}

/// The schema of a vertical form whose input has this unit; gains turn it into m/s (first order) or m/s^2
/// (second order).
fn vertical(input: &str, first: &str, second: &str) -> Value {
    let more = [("offset", quantity(input)), ("hover", quantity(input))];
    let poles = |gain: &str| {
        vec![("gain", quantity(gain)), ("pole", quantity("1/s")), ("push_damping", quantity("1/s"))]
    };
    let second =
        vec![("gain", quantity(second)), ("damping", quantity("1/s")), ("stiffness", quantity("1/s^2"))];
    json!({"oneOf": [form("first_order", poles(first), &more), form("second_order", second, &more)]})
}

/// Mirrors [`Model`]; a test compares it with the built-in model, member by member.
fn schema() -> Value {
    let tilt = object(
        &[("gain", quantity("1/s^2")), ("damping", quantity("1/s")), ("stiffness", quantity("1/s^2"))],
        &[],
    );
    let second_yaw =
        vec![("gain", quantity("1/s")), ("damping", quantity("1/s")), ("stiffness", quantity("1/s^2"))];
    let yaw = json!({"oneOf": [
        form("integrator", vec![("gain", quantity("1"))], &[]),
        form("rate", vec![("gain", quantity("1")), ("bandwidth", quantity("1/s"))], &[]),
        form("second_order", second_yaw, &[]),
    ]});
    let thrust = form("thrust", vec![("hover", quantity("1")), ("heave", quantity("1/s"))], &[]);
    let pwm = json!({"oneOf": [vertical("1", "m/s", "m/s^2"), thrust]});
    let motors = form(
        "motors",
        [
            ("hover", "1"),
            ("linear_share", "1"),
            ("lag", "s"),
            ("tilt_inertia", "kg m^2"),
            ("yaw_inertia", "kg m^2"),
            ("torque_per_thrust", "m"),
            ("heave", "1/s"),
        ]
        .map(|(name, unit)| (name, quantity(unit)))
        .to_vec(),
        &[],
    );
    let default = json!({"enum": VerticalInput::ALL.map(VerticalInput::name), "description": "the form that is driven unless another is asked for"});
    let pwm_source = json!({"enum": PwmSource::ALL.map(PwmSource::name), "description": "where a flight log holds the PWM: in the thrust command, or in what the motors get, their mean PWM times battery voltage over the reference voltage; command unless given"});
    let verticals = [
        ("default", default),
        ("pwm_source", pwm_source),
        ("height", vertical("m", "1/s", "1/s^2")),
        ("pwm", pwm.clone()),
        ("thrust", pwm),
        ("motors", motors),
    ];
    let quantities = |units: &[(&'static str, &str)]| {
        object(&units.iter().map(|(name, unit)| (*name, quantity(unit))).collect::<Vec<_>>(), &[])
    };
    let vehicle = [
        ("mass", "kg"),
        ("rotor_radius", "m"),
        ("arm", "m"),
        ("battery_capacity", "C"),
        ("hover_current", "A"),
    ];
    let vehicle = vehicle.map(|(name, unit)| (name, quantity(unit)));
    let identified = object(
        &[("mass", quantity("kg")), ("arm", quantity("m"))],
        &[("battery_capacity", quantity("C")), ("hover_current", quantity("A"))],
    );
    let mut schema = object(
        &[
            ("schema", json!({"const": 1})),
            ("name", json!({"type": "string"})),
            ("roll", tilt.clone()),
            ("pitch", tilt),
            ("yaw", yaw),
            ("lateral", quantities(&[("gravity", "m/s^2"), ("drag", "1/s")])),
            ("vertical", object(&[], &verticals)),
            (
                "command",
                quantities(&[
                    ("tilt_max", "deg"),
                    ("yaw_rate_max", "deg/s"),
                    ("height_max", "m"),
                    ("pwm_max", "1"),
                ]),
            ),
            (
                "vehicle",
                object(&vehicle, &[("battery_reference", quantity("V")), ("identified", identified)]),
            ),
            ("rig", quantities(&[("control", "Hz"), ("imu", "Hz"), ("camera", "Hz")])),
        ],
        &[
            ("description", json!({"type": "string"})),
            ("effects", json!({"type": "object", "description": "effects by name, see `crazyflie effects`"})),
        ],
    );
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("A quadrotor as identified");
    schema
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a value has the members that a schema asks for, and no others.
    fn fits(value: &Value, schema: &Value, path: &str) {
        if let Some(options) = schema["oneOf"].as_array() {
            let form = &value["form"];
            let flat = options
                .iter()
                .flat_map(|o| o["oneOf"].as_array().map_or_else(|| vec![o], |inner| inner.iter().collect()));
            let option = flat.into_iter().find(|o| o["properties"]["form"]["const"] == *form);
            return fits(value, option.unwrap_or_else(|| panic!("{path}: no form {form}")), path);
        }
        if let Some(expected) = schema.get("const") {
            assert_eq!(value, expected, "{path}");
        }
        let Some(properties) = schema["properties"].as_object() else { return };
        let members = value.as_object().unwrap();
        for name in schema["required"].as_array().unwrap() {
            assert!(members.contains_key(name.as_str().unwrap()), "{path} lacks {name}");
        }
        for (name, member) in members.iter().filter(|(_, member)| !member.is_null()) {
            fits(
                member,
                properties.get(name).unwrap_or_else(|| panic!("{path}.{name} is not in the schema")),
                &format!("{path}.{name}"),
            );
        }
    }

    #[test]
    fn the_schema_describes_the_built_in_model() {
        fits(&serde_json::to_value(Model::thesis()).unwrap(), &schema(), "model");
    }
}
