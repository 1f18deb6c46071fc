//! A policy as C for a microcontroller: single precision, constant tables, no allocation.

use std::fmt::Write;

use super::network::{Layer, Network};
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
    let given = ControllerConfig {
        name: super::ENTRY.name,
        options: &serde_json::Value::Null,
        file: Some(file),
        path: "",
        member: "",
        first_env: 0,
        task_observation: &ObservationSpec::default(),
    };
    let file = PolicyFile::read(&given)?;
    let trained = file.get("vertical").map(VerticalInput::named).transpose()?;
    let level = file.get("action").map(ActionLevel::named).transpose()?.unwrap_or_default();
    let input = level.input(model, input.or(trained).or(Some(VerticalInput::Pwm)))?;
    let interface = Interface::at_level(model, input, level)?;
    let tick_s = 1.0 / model.rig.control.value;
    let site = ControllerContext { model, interface, tick_s, envs: 1, mode: Mode::Automatic };
    let contents = file.contents(&given, &site)?;
    let code = match &contents {
        Contents::Row(policy) => row_code(policy, &given)?,
        Contents::Features(policy) => feature_code(policy, &interface),
    };
    Ok(PolicyCode { header: code.header(&interface, tick_s, &model.name), source: code.source(stem) })
}

/// A block of an observation in C.
struct CField {
    name: String,
    length: usize,
    unit: &'static str,
    about: &'static str,
}

impl From<&Field> for CField {
    fn from(field: &Field) -> Self {
        let Field { name, length, unit, about, .. } = *field;
        CField { name: name.to_owned(), length, unit, about }
    }
}

/// Parts that differ between the formats.
struct Code<'a> {
    network: &'a Network,
    /// Fields of the observation, in order.
    fields: Vec<CField>,
    /// Members of the structure besides those of recurrent layers, and statements that set them for a new flight.
    members: String,
    reset: String,
    /// Constants and functions, among them `features(policy, observation, x)`.
    functions: String,
    /// The action, from number `i` of the network's answer.
    action: &'static str,
}

impl Code<'_> {
    fn header(&self, interface: &Interface, tick_s: f64, model: &str) -> String {
        let (mut fields, mut count) = (String::new(), 0);
        for field in &self.fields {
            let first = count;
            count += field.length;
            let last = if field.length > 1 { format!("..{}", count - 1) } else { String::new() };
            let name = format!("POLICY_{} = {first},", field.name.to_uppercase());
            // writing to a string cannot fail
            let _ = writeln!(fields, "    {name:36} /* [{first}{last}] {}: {} */", field.unit, field.about);
        }
        let mut channels = String::new();
        for (i, (channel, [low, high])) in
            interface.level().entry().channels.iter().zip(interface.ranges()).enumerate()
        {
            let (name, unit, low, high) = (channel.name, channel.unit, low as f32, high as f32);
            let _ = writeln!(channels, "   action[{i}]: {name}, {low:?} to {high:?} {unit}");
        }
        let form = interface.input.name();
        format!(
            "/* A policy for the vehicle \"{model}\", commanded by its vertical form {form}. Written by crazyflie policy
   export-c. Single precision; no allocation; needs sinf, cosf, tanhf, expf and floorf of the C library. */
#ifndef CRAZYFLIE_POLICY_H
#define CRAZYFLIE_POLICY_H

#define POLICY_OBSERVATION {count} /* numbers of an observation */
#define POLICY_ACTION {ACTION}       /* numbers of an action */
#define POLICY_TICK_S {tick_s:?}f    /* call policy_act once in so many seconds */

/* What actions of -1 to 1 command:
{channels}   A yaw rate has the vehicle's own sign. */

/* Where the fields of an observation begin: [numbers] unit: meaning. */
enum policy_field {{
{fields}}};

/* What a policy remembers of a flight. */
struct policy {{
    int fresh; /* a flight begins with the next observation */
{members}{memory}}};

/* Forget the flight. Call it before the first observation of each. */
void policy_reset(struct policy *policy);

/* The action, from -1 to 1, for an observation in SI units. */
void policy_act(struct policy *policy, const float observation[POLICY_OBSERVATION], float action[POLICY_ACTION]);

#endif
",
            members = self.members,
            memory = match self.memory() {
                0 => String::new(),
                numbers => format!("    float memory[{numbers}]; /* of recurrent layers */\n"),
            },
        )
    }

    /// Numbers that recurrent layers remember.
    fn memory(&self) -> usize {
        self.network.layers.iter().map(Layer::memory).sum()
    }

    fn source(&self, stem: &str) -> String {
        let network = self.network;
        let features = network.mean.len();
        let widest = network.layers.iter().map(Layer::outputs).fold(features, usize::max);
        let mut tables = String::new();
        table(&mut tables, "MEAN", network.mean.iter().copied());
        table(&mut tables, "STD", network.std.iter().copied());
        let (calls, functions) = layer_calls(network, &mut tables);
        let answer = if network.layers.len().is_multiple_of(2) { "x" } else { "y" };
        let linear = if network.skip.is_empty() {
            String::new()
        } else {
            table(&mut tables, "SKIP", network.skip.iter().copied());
            "    for (int i = 0; i < FEATURES; i++) {
        for (int j = 0; j < POLICY_ACTION; j++) {
            linear[j] += x[i] * SKIP[i * POLICY_ACTION + j];
        }
    }
"
            .into()
        };
        let clip = if network.clip.is_finite() {
            let clip = single(network.clip);
            format!("clamp((x[i] - MEAN[i]) / STD[i], -{clip}, {clip})")
        } else {
            "(x[i] - MEAN[i]) / STD[i]".into()
        };
        let forget = match self.memory() {
            0 => String::new(),
            numbers => format!(
                "    for (int i = 0; i < {numbers}; i++) {{\n        policy->memory[i] = 0.0f;\n    }}\n"
            ),
        };
        format!(
            "#include <math.h>

#include \"{stem}.h\"

#define FEATURES {features}
#define WIDEST {widest}

{tables}
static float clamp(float value, float low, float high) {{
    return value < low ? low : value > high ? high : value;
}}

/* Adds the products of the inputs to biases. */
static void multiply(const float *in, int inputs, const float *weight, const float *bias, float *out, int outputs) {{
    for (int j = 0; j < outputs; j++) {{
        float sum = bias[j];
        for (int i = 0; i < inputs; i++) {{
            sum += in[i] * weight[i * outputs + j];
        }}
        out[j] = sum;
    }}
}}
{functions}{own}
void policy_reset(struct policy *policy) {{
    policy->fresh = 1;
{reset}{forget}}}

void policy_act(struct policy *policy, const float observation[POLICY_OBSERVATION], float action[POLICY_ACTION]) {{
    float x[WIDEST], y[WIDEST], linear[POLICY_ACTION] = {{0.0f}};
    features(policy, observation, x);
    policy->fresh = 0;
    for (int i = 0; i < FEATURES; i++) {{
        x[i] = {clip};
    }}
{linear}{calls}    for (int i = 0; i < POLICY_ACTION; i++) {{
        const float sum = {answer}[i] + linear[i];
        action[i] = {action};
    }}
}}
",
            own = self.functions,
            reset = self.reset,
            action = self.action,
        )
    }
}

/// Calls of the layers in `policy_act`, and the functions that they call; the weights go into `tables`.
fn layer_calls(network: &Network, tables: &mut String) -> (String, String) {
    let (mut calls, mut functions) = (String::new(), String::new());
    let (mut inputs, mut memory) = (network.mean.len(), 0);
    for (i, layer) in network.layers.iter().enumerate() {
        let (from, to) = if i.is_multiple_of(2) { ("x", "y") } else { ("y", "x") };
        let outputs = layer.outputs();
        match layer {
            Layer::Dense { weights, activation } => {
                table(tables, &format!("WEIGHT{i}"), weights.weights.iter().copied());
                table(tables, &format!("BIAS{i}"), weights.bias.iter().copied());
                let _ =
                    writeln!(calls, "    multiply({from}, {inputs}, WEIGHT{i}, BIAS{i}, {to}, {outputs});");
                let body = activation.c();
                if body != "x" {
                    let _ = write!(
                        functions,
                        "\nstatic float activation{i}(float x) {{\n    return {body};\n}}\n"
                    );
                    let _ = writeln!(
                        calls,
                        "    for (int i = 0; i < {outputs}; i++) {{\n        {to}[i] = activation{i}({to}[i]);\n    }}"
                    );
                }
            }
            Layer::Gru { inputs: given, memory: kept } => {
                for (name, weights) in [("", given), ("_MEMORY", kept)] {
                    table(tables, &format!("WEIGHT{i}{name}"), weights.weights.iter().copied());
                    table(tables, &format!("BIAS{i}{name}"), weights.bias.iter().copied());
                }
                functions.push_str(&gru(i, inputs, outputs));
                let _ = writeln!(calls, "    recurrent{i}({from}, policy->memory + {memory}, {to});");
                memory += outputs;
            }
        }
        inputs = outputs;
    }
    (calls, functions)
}

/// The function of a gated recurrent unit.
fn gru(i: usize, inputs: usize, size: usize) -> String {
    let gates = 3 * size;
    format!(
        "
static void recurrent{i}(const float *in, float *memory, float *out) {{
    float given[{gates}], kept[{gates}];
    multiply(in, {inputs}, WEIGHT{i}, BIAS{i}, given, {gates});
    multiply(memory, {size}, WEIGHT{i}_MEMORY, BIAS{i}_MEMORY, kept, {gates});
    for (int i = 0; i < {size}; i++) {{
        const float reset = 1.0f / (1.0f + expf(-(given[i] + kept[i])));
        const float update = 1.0f / (1.0f + expf(-(given[{size} + i] + kept[{size} + i])));
        const float new = tanhf(given[2 * {size} + i] + reset * kept[2 * {size} + i]);
        memory[i] = new + update * (memory[i] - new);
        out[i] = memory[i];
    }}
}}
"
    )
}

/// # Errors
/// [`Error::Config`] for fields that are unknown.
fn row_code<'a>(policy: &'a RowPolicy, given: &ControllerConfig<'_>) -> Result<Code<'a>> {
    let spec = &policy.spec;
    let fields = spec.observation.sources().map_err(|problem: Error| given.problem(problem))?;
    let mut fields: Vec<CField> = fields.iter().map(CField::from).collect();
    for other in 0..spec.others {
        let near = NEIGHBOUR_FIELDS
            .iter()
            .map(|field| CField { name: format!("other_{other}_{}", field.name), ..CField::from(field) });
        fields.extend(near);
    }
    let past = spec.history - 1;
    let (members, functions) = if past == 0 {
        let copy = "for (int i = 0; i < POLICY_OBSERVATION; i++) {\n        x[i] = o[i];\n    }";
        (String::new(), format!("    (void)p;\n    {copy}\n"))
    } else {
        let body = format!(
            "    for (int tick = 0; tick < {past}; tick++) {{
        for (int i = 0; i < POLICY_OBSERVATION; i++) {{
            x[tick * POLICY_OBSERVATION + i] = p->fresh ? o[i] : p->past[tick][i];
        }}
    }}
    for (int i = 0; i < POLICY_OBSERVATION; i++) {{
        x[{past} * POLICY_OBSERVATION + i] = o[i];
    }}
    for (int tick = 0; tick < {past}; tick++) {{
        for (int i = 0; i < POLICY_OBSERVATION; i++) {{
            p->past[tick][i] = x[(tick + 1) * POLICY_OBSERVATION + i];
        }}
    }}
"
        );
        (format!("    float past[{past}][POLICY_OBSERVATION]; /* observations, the newest last */\n"), body)
    };
    Ok(Code {
        network: &policy.network,
        fields,
        members,
        reset: String::new(),
        functions: format!(
            "\n/* Numbers of an observation of {} ticks, the newest last. */\nstatic void features(struct policy *p, const float *o, float *x) {{\n{functions}}}\n",
            spec.history
        ),
        action: "clamp(sum, -1.0f, 1.0f)",
    })
}

/// The estimator's fields, and the other fields of a policy that uses its estimate.
const OF_ESTIMATE: [Field; 8] = [EST_POS, EST_VEL, EST_YAW, EST_PUSH, ATTITUDE, GYRO, SETPOINT, LAST_ACTION];

/// Returns the index of a field's first value in C.
fn first(field: Field) -> usize {
    OF_ESTIMATE.iter().take_while(|other| other.name != field.name).map(|field| field.length).sum()
}

fn feature_code<'a>(policy: &'a FeaturePolicy, interface: &Interface) -> Code<'a> {
    let level = |lift: f64| interface.action(&Command::level(lift));
    let mut functions = String::from("\n");
    table(&mut functions, "GAINS", policy.gains.iter().map(|gain| *gain as f32));
    table(&mut functions, "REST", level(interface.hover_lift).map(|a| a as f32).into_iter());
    table(&mut functions, "OFF", level(0.0).map(|a| a as f32).into_iter());
    let (pos, vel, push, yaw) = (first(EST_POS), first(EST_VEL), first(EST_PUSH), first(EST_YAW));
    let (roll, gyro, goal, last) = (first(ATTITUDE), first(GYRO), first(SETPOINT), first(LAST_ACTION));
    let _ = write!(
        functions,
        "
#define TAUS {taus}
#define SIGNALS {SIGNALS}

/* A world vector in the vehicle's heading. */
static void rotate(float s, float c, const float v[3], float out[3]) {{
    out[0] = c * v[0] + s * v[1];
    out[1] = c * v[1] - s * v[0];
    out[2] = v[2];
}}

/* The height to fly to: that of the set-point, or lower and lower in a landing. */
static float target_height(struct policy *p, const float *o) {{
    p->sinking &= p->landing;
    if (!p->landing) {{
        return o[{goal} + 2];
    }}
    const float from = p->sinking ? p->sink_m : o[{pos} + 2];
    const float sunk = from - clamp({sink} * from, {slow}, {fast}) * POLICY_TICK_S;
    p->sink_m = sunk > {below} ? sunk : {below};
    p->sinking = 1;
    p->idle |= o[{pos} + 2] <= {touch};
    return p->sink_m;
}}

/* Moving averages go on by a tick; features of an observation. */
static void features(struct policy *p, const float *o, float *x) {{
    const float height = target_height(p, o);
    const float s = sinf(o[{yaw}]), c = cosf(o[{yaw}]);
    const float turn = o[{goal} + 3] - o[{yaw}];
    const float signals[SIGNALS] = {{
        o[{goal}] - o[{pos}], o[{goal} + 1] - o[{pos} + 1], height - o[{pos} + 2], o[{roll}], o[{roll} + 1],
        o[{last}] - REST[0], o[{last} + 1] - REST[1], o[{last} + 2] - REST[2], o[{last} + 3] - REST[3],
        o[{goal}], o[{goal} + 1], height,
    }};
    int n = 9;
    rotate(s, c, signals, x);
    rotate(s, c, o + {vel}, x + 3);
    rotate(s, c, o + {push}, x + 6);
    x[n++] = turn - 6.28318530718f * floorf(turn * 0.159154943092f + 0.5f);
    x[n++] = o[{roll}];
    x[n++] = o[{roll} + 1];
    for (int i = 0; i < 3; i++) {{
        x[n++] = o[{gyro} + i];
    }}
    for (int i = 0; i < 4; i++) {{
        x[n++] = signals[5 + i];
    }}
    for (int t = 0; t < TAUS; t++) {{
        float *average = p->averages + t * SIGNALS, *out = x + n + t * SIGNALS, from[SIGNALS];
        for (int i = 0; i < SIGNALS; i++) {{
            average[i] = p->fresh ? signals[i] : average[i] + GAINS[t] * (signals[i] - average[i]);
            from[i] = signals[i] - average[i];
        }}
        rotate(s, c, from, out);
        for (int i = 3; i < 9; i++) {{
            out[i] = from[i];
        }}
        rotate(s, c, from + 9, out + 9);
    }}
}}
",
        taus = policy.gains.len(),
        sink = single(SINK_PS),
        slow = single(SINK_MPS[0]),
        fast = single(SINK_MPS[1]),
        touch = single(TOUCH_M),
        below = single(-BELOW_M),
    );
    let averages = SIGNALS * policy.gains.len();
    Code {
        network: &policy.network,
        fields: OF_ESTIMATE.iter().map(CField::from).collect(),
        members: format!(
            "    float averages[{averages}];
    int landing; /* set it to 1 to go down; motors are off on the floor */
    int sinking;
    int idle;     /* landed */
    float sink_m; /* the height that a landing has come to */
"
        ),
        reset: "    policy->landing = 0;\n    policy->sinking = 0;\n    policy->idle = 0;\n".into(),
        functions,
        action: "policy->idle ? OFF[i] : clamp(REST[i] + sum, -1.0f, 1.0f)",
    }
}

/// A number as C writes it in single precision.
fn single(value: f64) -> String {
    format!("{:?}f", value as f32)
}

/// A constant array, eight numbers a line.
fn table(out: &mut String, name: &str, values: impl ExactSizeIterator<Item = f32>) {
    let _ = write!(out, "static const float {name}[{}] = {{", values.len());
    for (i, value) in values.enumerate() {
        let _ = write!(out, "{}{value:?}f,", if i.is_multiple_of(8) { "\n    " } else { " " });
    }
    out.push_str("\n};\n");
}
