//! A policy as C for a microcontroller: single precision, constant tables, no allocation.

use std::fmt::Write;

use super::{AGE_MAX_S, CLEAR_M, CLIP, Network, SIGNALS, Sight};
use crate::landing::{BELOW_M, SINK_MPS, SINK_PS, TOUCH_M};
use crate::{ControllerConfig, ControllerContext, Mode};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{
    ATTITUDE, EST_POS, EST_PUSH, EST_VEL, EST_YAW, FIELDS, Field, GYRO, LAST_ACTION, MARKER_AGE, MARKER_POS,
    MARKER_YAW, SETPOINT,
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

/// The policy of a safetensors file as C, for the commands of this vehicle; `stem` is the name of the files
/// without their endings.
///
/// # Errors
/// [`crazyflie_env::Error::Config`] for what is no policy, [`crazyflie_env::Error::Unknown`] for a form that
/// the model lacks.
pub fn export_c(file: &[u8], model: &Model, input: VerticalInput, stem: &str) -> Result<PolicyCode> {
    let given = ControllerConfig {
        name: super::ENTRY.name,
        options: &serde_json::Value::Null,
        file: Some(file),
        path: "",
        member: "",
        first_env: 0,
    };
    let interface = Interface::from_model(model, input)?;
    let tick_s = 1.0 / model.rig.control.value;
    let site = ControllerContext { model, interface, tick_s, envs: 1, mode: Mode::Automatic };
    let network = Network::read(&given, &site)?;
    Ok(PolicyCode {
        source: source(&network, &interface, stem),
        header: header(&network, &interface, tick_s, &model.name),
    })
}

/// The estimator's fields, and the other fields of a policy that uses its estimate.
const OF_ESTIMATE: [Field; 8] = [EST_POS, EST_VEL, EST_YAW, EST_PUSH, ATTITUDE, GYRO, SETPOINT, LAST_ACTION];

/// The fields of an observation in C, in order.
fn fields(sight: Sight) -> &'static [Field] {
    match sight {
        Sight::Estimate => &OF_ESTIMATE,
        Sight::Fix => &FIELDS,
    }
}

/// Returns the index of a field's first value in C.
fn first(sight: Sight, name: &str) -> usize {
    fields(sight).iter().take_while(|field| field.name != name).map(|field| field.length).sum()
}

fn header(network: &Network, interface: &Interface, tick_s: f64, model: &str) -> String {
    let mut fields = String::new();
    let mut count = 0;
    for field in self::fields(network.sight) {
        let first = count;
        count += field.length;
        let last = if field.length > 1 { format!("..{}", count - 1) } else { String::new() };
        let name = format!("POLICY_{} = {first},", field.name.to_uppercase());
        // writing to a string cannot fail
        let _ = writeln!(fields, "    {name:36} /* [{first}{last}] {}: {} */", field.unit, field.about);
    }
    let Interface { tilt_max_rad, yaw_rate_max_radps, lift_max, hover_lift, .. } = *interface;
    let form = interface.input.name();
    format!(
        "/* A policy for the vehicle \"{model}\", commanded by its vertical form {form}. Written by crazyflie policy\n   export-c. Single precision; no allocation; needs sinf, cosf, tanhf and floorf of the C library. */
#ifndef CRAZYFLIE_POLICY_H
#define CRAZYFLIE_POLICY_H

#define POLICY_OBSERVATION {count} /* numbers of an observation */
#define POLICY_ACTION {ACTION}       /* numbers of an action */
#define POLICY_TICK_S {tick_s:?}f    /* call policy_act once in so many seconds */
#define POLICY_AVERAGES {averages}  /* moving averages that a policy keeps */

/* What an action of 1 commands: roll, pitch (rad), yaw rate (rad/s, the vehicle's own sign). The fourth number
   goes from 0 at -1 to POLICY_LIFT_MAX (PWM counts) at 1. */
#define POLICY_TILT_MAX_RAD {}
#define POLICY_YAW_RATE_MAX_RADPS {}
#define POLICY_LIFT_MAX {}
#define POLICY_HOVER_LIFT {} /* PWM counts that carry the weight */

/* Where the fields of an observation begin: [numbers] unit: meaning. */
enum policy_field {{
{fields}}};

/* What a policy remembers of a flight. */
struct policy {{
    float averages[POLICY_AVERAGES];
    int fresh;   /* a flight begins with the next observation */
    int landing; /* set it to 1 to go down; motors are off on the floor */
    int sinking;
    int idle;      /* landed */
    float sink_m;  /* the height that a landing has come to */
}};

/* Forget the flight. Call it before the first observation of each. */
void policy_reset(struct policy *policy);

/* The action, from -1 to 1, for an observation in SI units. */
void policy_act(struct policy *policy, const float observation[POLICY_OBSERVATION], float action[POLICY_ACTION]);

#endif
",
        single(tilt_max_rad),
        single(yaw_rate_max_radps),
        single(lift_max),
        single(hover_lift),
        averages = SIGNALS * network.gains.len(),
    )
}

fn source(network: &Network, interface: &Interface, stem: &str) -> String {
    let taus = network.gains.len();
    let widest = network.layers.iter().map(|layer| layer.bias.len()).fold(network.mean.len(), usize::max);
    let level = |lift: f64| interface.action(&Command::level(lift));
    let mut tables = String::new();
    table(&mut tables, "GAINS", network.gains.iter().map(|gain| *gain as f32));
    table(&mut tables, "MEAN", network.mean.iter().copied());
    table(&mut tables, "STD", network.std.iter().copied());
    table(&mut tables, "REST", level(interface.hover_lift).map(|a| a as f32).into_iter());
    table(&mut tables, "OFF", level(0.0).map(|a| a as f32).into_iter());
    let mut calls = String::new();
    let mut inputs = network.mean.len();
    for (i, layer) in network.layers.iter().enumerate() {
        let (outputs, last) = (layer.bias.len(), i + 1 == network.layers.len());
        table(&mut tables, &format!("WEIGHT{i}"), layer.weights.iter().copied());
        table(&mut tables, &format!("BIAS{i}"), layer.bias.iter().copied());
        let (from, to) = if i.is_multiple_of(2) { ("x", "y") } else { ("y", "x") };
        let squash = u8::from(!last);
        let _ =
            writeln!(calls, "    layer({from}, {inputs}, WEIGHT{i}, BIAS{i}, {to}, {outputs}, {squash});");
        inputs = outputs;
    }
    let answer = if network.layers.len().is_multiple_of(2) { "x" } else { "y" };
    let at = |field: Field| first(network.sight, field.name);
    let (pos, yaw) = match network.sight {
        Sight::Estimate => (at(EST_POS), at(EST_YAW)),
        Sight::Fix => (at(MARKER_POS), at(MARKER_YAW)),
    };
    let (roll, gyro, goal, last) = (at(ATTITUDE), at(GYRO), at(SETPOINT), at(LAST_ACTION));
    let motion = match network.sight {
        Sight::Estimate => format!(
            "rotate(s, c, o + {}, x + n);\n    rotate(s, c, o + {}, x + n + 3);\n    n += 6;",
            at(EST_VEL),
            at(EST_PUSH)
        ),
        Sight::Fix => String::new(),
    };
    let age = match network.sight {
        Sight::Estimate => String::new(),
        Sight::Fix => {
            let (age, most) = (at(MARKER_AGE), single(AGE_MAX_S));
            format!("x[n++] = o[{age}] < {most} ? o[{age}] : {most};")
        }
    };
    let linear = if network.skip.is_empty() {
        String::new()
    } else {
        table(&mut tables, "SKIP", network.skip.iter().copied());
        "for (int i = 0; i < FEATURES; i++) {
        for (int j = 0; j < POLICY_ACTION; j++) {
            linear[j] += x[i] * SKIP[i * POLICY_ACTION + j];
        }
    }"
        .into()
    };
    format!(
        "#include <math.h>

#include \"{stem}.h\"

#define TAUS {taus}
#define SIGNALS {SIGNALS}
#define FEATURES {features}
#define WIDEST {widest}

{tables}
static float clamp(float value, float low, float high) {{
    return value < low ? low : value > high ? high : value;
}}

/* A world vector in the vehicle's heading. */
static void rotate(float s, float c, const float v[3], float out[3]) {{
    out[0] = c * v[0] + s * v[1];
    out[1] = c * v[1] - s * v[0];
    out[2] = v[2];
}}

static void layer(const float *in, int inputs, const float *weight, const float *bias, float *out, int outputs, int squash) {{
    for (int j = 0; j < outputs; j++) {{
        float sum = bias[j];
        for (int i = 0; i < inputs; i++) {{
            sum += in[i] * weight[i * outputs + j];
        }}
        out[j] = squash ? tanhf(sum) : sum;
    }}
}}

/* Moving averages go on by a tick; features of an observation that is flown to this height, in standard deviations. */
static void features(struct policy *p, const float *o, float height, float *x) {{
    const float s = sinf(o[{yaw}]), c = cosf(o[{yaw}]);
    const float turn = o[{goal} + 3] - o[{yaw}];
    const float signals[SIGNALS] = {{
        o[{goal}] - o[{pos}], o[{goal} + 1] - o[{pos} + 1], height - o[{pos} + 2], o[{roll}], o[{roll} + 1],
        o[{last}] - REST[0], o[{last} + 1] - REST[1], o[{last} + 2] - REST[2], o[{last} + 3] - REST[3],
        o[{goal}], o[{goal} + 1], height,
    }};
    int n = 3;
    rotate(s, c, signals, x);
    {motion}
    x[n++] = turn - 6.28318530718f * floorf(turn * 0.159154943092f + 0.5f);
    x[n++] = o[{roll}];
    x[n++] = o[{roll} + 1];
    for (int i = 0; i < 3; i++) {{
        x[n++] = o[{gyro} + i];
    }}
    for (int i = 0; i < 4; i++) {{
        x[n++] = signals[5 + i];
    }}
    {age}
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
    p->fresh = 0;
    for (int i = 0; i < FEATURES; i++) {{
        x[i] = clamp((x[i] - MEAN[i]) / STD[i], -{clip}, {clip});
    }}
}}

void policy_reset(struct policy *policy) {{
    policy->fresh = 1;
    policy->landing = 0;
    policy->sinking = 0;
    policy->idle = 0;
}}

void policy_act(struct policy *policy, const float observation[POLICY_OBSERVATION], float action[POLICY_ACTION]) {{
    float x[WIDEST], y[WIDEST], linear[POLICY_ACTION] = {{0.0f}};
    float height = observation[{goal} + 2];
    {landing}
    features(policy, observation, height, x);
    {linear}
{calls}    for (int i = 0; i < POLICY_ACTION; i++) {{
        action[i] = policy->idle ? OFF[i] : clamp(REST[i] + {answer}[i] + linear[i], -1.0f, 1.0f);
    }}
}}
",
        features = network.mean.len(),
        clip = single(CLIP),
        landing = landing(network.sight, pos),
    )
}

/// Returns the C code of a policy's landing; `Landing` does the same for policies of an estimate.
fn landing(sight: Sight, pos: usize) -> String {
    let height = format!("observation[{pos} + 2]");
    match sight {
        Sight::Estimate => format!(
            "policy->sinking &= policy->landing;
    if (policy->landing) {{
        const float from = policy->sinking ? policy->sink_m : {height};
        const float sunk = from - clamp({} * from, {}, {}) * POLICY_TICK_S;
        policy->sink_m = sunk > {below} ? sunk : {below};
        policy->sinking = 1;
        height = policy->sink_m;
        policy->idle |= {height} <= {};
    }}",
            single(SINK_PS),
            single(SINK_MPS[0]),
            single(SINK_MPS[1]),
            single(TOUCH_M),
            below = single(-BELOW_M),
        ),
        Sight::Fix => format!(
            "if (policy->landing) {{
        height = {};
        policy->idle |= {height} <= height;
    }}",
            single(CLEAR_M)
        ),
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
