//! `crazyflie model`: the model as data.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::model::{Model, PwmSource, VEHICLES, Vehicle, VerticalInput};
use serde_json::{Value, json};

use super::{Failure, Outcome, files, write_json};

/// Show or check a model, or print the schema of model files.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Vehicle by name (see `crazyflie vehicles`), or its model file or data sheet [default: cf2-thesis]
    file: Option<PathBuf>,
    /// Print the model
    #[arg(long)]
    show: bool,
    /// Make the model of a data sheet (TOML or JSON; docs/motors.md)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["file", "schema"])]
    datasheet: Option<PathBuf>,
    /// Write the model to this file
    #[arg(long, value_name = "FILE", conflicts_with = "schema")]
    out: Option<PathBuf>,
    /// Print the JSON Schema of model files
    #[arg(long, conflicts_with = "show")]
    schema: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.schema {
        return write_json(&schema()?, out);
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
        return write_json(&model, out);
    }
    if args.show {
        let named = args.file.as_deref().map_or(Some(VEHICLES[0].name), Vehicle::name_in);
        if let Some(name) = named.filter(|_| args.datasheet.is_none()) {
            // with its comments
            return Ok(write!(out, "{}", Vehicle::named(name)?.text)?);
        }
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

/// The schema of a model file in short form, see [`expand`].
const TEMPLATE: &str = include_str!("../../templates/model_schema.json");

/// Mirrors [`Model`]; a test compares it with the built-in model, member by member.
fn schema() -> serde_json::Result<Value> {
    let mut schema = expand(&serde_json::from_str(TEMPLATE)?);
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("A quadrotor as identified");
    let vertical = &mut schema["properties"]["vertical"]["properties"];
    vertical["default"]["enum"] = json!(VerticalInput::ALL.map(VerticalInput::name));
    vertical["pwm_source"]["enum"] = json!(PwmSource::ALL.map(PwmSource::name));
    Ok(schema)
}

/// Returns the schema of a template. A text is the unit of a quantity, or one of several with `|` between them; after
/// `=` a constant; a list has the alternatives. An object has its members and no others, and may lack those whose
/// names end in `?`; under `$` it contains a schema as it is.
fn expand(template: &Value) -> Value {
    match template {
        Value::String(text) => match text.strip_prefix('=') {
            Some(constants) => match constants.split('|').collect::<Vec<_>>()[..] {
                [constant] => json!({"const": constant}),
                ref several => json!({"enum": several}),
            },
            None => expand(
                &json!({"value": {"$": {"type": "number"}}, "unit": format!("={text}"), "source": {"$": {"type": "string"}}}),
            ),
        },
        Value::Array(forms) => json!({"oneOf": forms.iter().map(expand).collect::<Vec<_>>()}),
        Value::Object(members) if !members.contains_key("$") => {
            let properties: serde_json::Map<String, Value> =
                members.iter().map(|(name, member)| (name.replace('?', ""), expand(member))).collect();
            let required: Vec<_> = members.keys().filter(|name| !name.ends_with('?')).collect();
            json!({"type": "object", "properties": properties, "required": required, "additionalProperties": false})
        }
        schema => schema["$"].clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that a value has the members that a schema requires, and no others.
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
        fits(&serde_json::to_value(Model::thesis()).unwrap(), &schema().unwrap(), "model");
    }
}
