//! A policy as C for a microcontroller: single precision, constant tables, no allocation.

use std::collections::BTreeMap;

use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, merge_maps};
use minijinja::{Environment, UndefinedBehavior, Value, context};

use super::network::{Layer, Network, Weights};
use super::row::RowPolicy;
use super::{Contents, FeaturePolicy, PolicyFile, SIGNALS};
use crate::landing::{BELOW_M, SINK_MPS, SINK_PS, TOUCH_M};
use crate::{ControllerConfig, ControllerContext, Mode, ObservationSpec};
use crazyflie_env::action::{ACTION, ActionLevel, Interface};
use crazyflie_env::coupling::NEIGHBOUR_FIELDS;
use crazyflie_env::error::{Error, Result};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{
    ATTITUDE, EST_POS, EST_PUSH, EST_VEL, EST_YAW, Field, GYRO, LAST_ACTION, SETPOINT,
};
use crazyflie_env::plant::Command;

/// A policy in C: a source file, and the header that goes with it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PolicyCode {
    /// Functions and weights; includes `STEM.h`.
    pub source: String,
    /// Declarations, the fields of an observation and what an action means.
    pub header: String,
}

/// The policy of a safetensors file as C, for the commands of this vehicle; `stem` is the name of the files without
/// their endings. `input` is the vertical form; by default the file's, or else pwm.
///
/// # Errors
/// [`Error::Config`] for what is no policy, [`Error::Unknown`] for a form that the model lacks.
pub fn export_c(file: &[u8], model: &Model, input: Option<VerticalInput>, stem: &str) -> Result<PolicyCode> {
    let config = ControllerConfig {
        name: super::ENTRY.name,
        options: &serde_json::Value::Null,
        file: Some(file),
        path: "",
        member: "",
        first_env: 0,
        task_observation: &ObservationSpec::default(),
    };
    let file = PolicyFile::read(&config)?;
    let trained = file.get("vertical").map(VerticalInput::named).transpose()?;
    let level = file.get("action").map(ActionLevel::named).transpose()?.unwrap_or_default();
    let input = level.input(model, input.or(trained).or(Some(VerticalInput::Pwm)))?;
    let interface = Interface::at_level(model, input, level)?;
    let tick_s = 1.0 / model.rig.control.value;
    let site = ControllerContext { model, interface, tick_s, envs: 1, mode: Mode::Automatic };
    let contents = file.contents(&config, &site)?;
    let (network, fields, format) = match &contents {
        Contents::Row(policy) => {
            let format = context! { past => policy.spec.history - 1 };
            (&policy.network, row_fields(policy, &config)?, format)
        }
        Contents::Features(policy) => {
            let fields = OF_ESTIMATE.iter().map(|field| (field.name.to_owned(), *field)).collect();
            (&policy.network, fields, feature_view(policy, &interface))
        }
    };
    let vehicle = context! { stem, model => &model.name, tick_s => format!("{tick_s:?}f") };
    let views = [vehicle, format, network_view(network), interface_view(&interface), field_view(&fields)];
    let code = merge_maps(views);
    let mut templates = Environment::new();
    templates.set_undefined_behavior(UndefinedBehavior::Strict);
    let mut syntax = SyntaxConfig::builder();
    syntax.trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true);
    templates.set_syntax(syntax.build().map_err(|problem| config.problem(problem))?);
    let render = |text| templates.render_str(text, &code).map_err(|problem| config.problem(problem));
    let (source, header) = (include_str!("policy.c.jinja"), include_str!("policy.h.jinja"));
    Ok(PolicyCode { source: render(source)?, header: render(header)? })
}

/// The fields of an observation, in order: in C each is an index and a comment.
fn field_view(fields: &[(String, Field)]) -> Value {
    let (mut lines, mut first, mut count) = (Vec::new(), BTreeMap::new(), 0);
    for (name, field) in fields {
        let last = if field.length > 1 { format!("..{}", count + field.length - 1) } else { String::new() };
        let index = format!("POLICY_{} = {count},", name.to_uppercase());
        lines.push(format!("{index:36} /* [{count}{last}] {}: {} */", field.unit, field.about));
        first.insert(name, count);
        count += field.length;
    }
    context! { fields => lines, first => Serde(first), count }
}

/// Form and ranges of the commands.
fn interface_view(interface: &Interface) -> Value {
    let channels = interface.level().entry().channels.iter().zip(interface.ranges()).enumerate();
    let lines = channels.map(|(i, (channel, range))| {
        let [low, high] = range.map(|end| end as f32);
        format!("action[{i}]: {}, {low:?} to {high:?} {}", channel.name, channel.unit)
    });
    context! { form => interface.input.name(), actions => ACTION, channels => lines.collect::<Vec<_>>() }
}

/// The layers with their weights.
fn network_view(network: &Network) -> Value {
    let (mut inputs, mut memory) = (network.mean.len(), 0);
    let mut layers = Vec::new();
    for (i, layer) in network.layers.iter().enumerate() {
        let tables = |name: &str, weights: &Weights| {
            let bias = (format!("BIAS{i}{name}"), singles(&weights.bias));
            [(format!("WEIGHT{i}{name}"), singles(&weights.weights)), bias]
        };
        let outputs = layer.outputs();
        layers.push(match layer {
            Layer::Dense { weights, activation } => {
                context! { inputs, outputs, tables => tables("", weights), activation => activation.c() }
            }
            Layer::Gru { inputs: given, memory: kept } => {
                let tables = [tables("", given), tables("_MEMORY", kept)].concat();
                context! { inputs, outputs, memory, tables }
            }
        });
        inputs = outputs;
        memory += layer.memory();
    }
    let features = network.mean.len();
    context! {
        features,
        widest => network.layers.iter().map(Layer::outputs).fold(features, usize::max),
        mean => singles(&network.mean),
        std => singles(&network.std),
        skip => singles(&network.skip),
        clip => network.clip.is_finite().then(|| single(network.clip)),
        layers,
        memory,
    }
}

/// # Errors
/// [`Error::Config`] for fields that are unknown.
fn row_fields(policy: &RowPolicy, config: &ControllerConfig<'_>) -> Result<Vec<(String, Field)>> {
    let own = policy.spec.observation.sources().map_err(|problem: Error| config.problem(problem))?;
    let mut fields: Vec<_> = own.into_iter().map(|field| (field.name.to_owned(), field)).collect();
    for other in 0..policy.spec.others {
        fields.extend(NEIGHBOUR_FIELDS.map(|field| (format!("other_{other}_{}", field.name), field)));
    }
    Ok(fields)
}

/// The estimator's fields, and the other fields of a policy that uses its estimate.
const OF_ESTIMATE: [Field; 8] = [EST_POS, EST_VEL, EST_YAW, EST_PUSH, ATTITUDE, GYRO, SETPOINT, LAST_ACTION];

/// Constants of a policy that uses features of an estimate.
fn feature_view(policy: &FeaturePolicy, interface: &Interface) -> Value {
    let level = |lift: f64| singles(&interface.action(&Command::level(lift)).map(|a| a as f32));
    let gains: Vec<f32> = policy.gains.iter().map(|gain| *gain as f32).collect();
    context! {
        gains => singles(&gains),
        rest => level(interface.hover_lift),
        off => level(0.0),
        signals => SIGNALS,
        sink => single(SINK_PS),
        slow => single(SINK_MPS[0]),
        fast => single(SINK_MPS[1]),
        touch => single(TOUCH_M),
        below => single(-BELOW_M),
    }
}

/// A number as C writes it in single precision.
fn single(value: f64) -> String {
    format!("{:?}f", value as f32)
}

/// Numbers of a constant array.
fn singles(values: &[f32]) -> Vec<String> {
    values.iter().map(|value| format!("{value:?}f,")).collect()
}
