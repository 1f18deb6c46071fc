//! Policies from files: their actions, and the errors of files that are no policies.

use std::collections::HashMap;
use std::process::Command;

use crazyflie_control::{
    ControllerContext, ControllerSpec, ExtraInputs, InputNeeds, Mode, MultiController, PolicyCode, choose,
    export_c,
};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::scalar::Scalar;
use crazyflie_env::vector::{STATE, state_index};
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

type Tensors = HashMap<&'static str, (Vec<f32>, Vec<usize>)>;
type About = HashMap<String, String>;

/// Numbers of features, with two time constants.
const FEATURES: usize = 19 + 2 * 12;
const HIDDEN: usize = 8;

/// Numbers without any pattern to speak of.
fn numbers(count: usize, size: f32) -> Vec<f32> {
    (0..count).map(|i| size * (0.7 * i as f32 * i as f32 + 1.3 * i as f32).sin()).collect()
}

/// A policy of features with a hidden layer, two time constants, and arbitrary weights.
fn policy() -> (Tensors, About) {
    let features = FEATURES;
    let tensors = HashMap::from([
        ("skip.weight", (numbers(features * ACTION, 0.05), vec![features, ACTION])),
        ("taus_s", (vec![0.1, 0.4], vec![2])),
        ("feature_mean", (numbers(features, 0.1), vec![features])),
        ("feature_std", (vec![0.5; features], vec![features])),
        ("layer0.weight", (numbers(features * HIDDEN, 0.5), vec![features, HIDDEN])),
        ("layer0.bias", (numbers(HIDDEN, 0.2), vec![HIDDEN])),
        ("layer1.weight", (numbers(HIDDEN * ACTION, 0.3), vec![HIDDEN, ACTION])),
        ("layer1.bias", (numbers(ACTION, 0.1), vec![ACTION])),
    ]);
    let about =
        [("format", "crazyflie-policy-2"), ("tick_s", "0.02")].map(|(k, v)| (k.to_owned(), v.to_owned()));
    (tensors, HashMap::from(about))
}

fn file((tensors, about): &(Tensors, About)) -> Vec<u8> {
    let bytes: Vec<_> = tensors
        .iter()
        .map(|(name, (values, shape))| {
            (*name, shape, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
        })
        .collect();
    let views = bytes
        .iter()
        .map(|(name, shape, bytes)| (*name, TensorView::new(Dtype::F32, shape.to_vec(), bytes).unwrap()));
    safetensors::serialize(views, Some(about.clone())).unwrap()
}

fn chosen(bytes: Vec<u8>) -> ControllerSpec {
    choose("policy:some/where.safetensors", Value::Null, &move |_| Ok(bytes.clone())).unwrap()
}

fn site(model: &Model, envs: usize, input: VerticalInput) -> ControllerContext<'_> {
    ControllerContext {
        model,
        interface: Interface::from_model(model, input).unwrap(),
        tick_s: 0.02,
        envs,
        mode: Mode::Automatic,
    }
}

fn wave(env: usize, tick: usize, k: usize) -> f32 {
    0.5 * (0.37 * (1.0 + env as f32) * (tick as f32 + 3.0 * k as f32)).sin()
}

/// A filter like the policy's.
struct Filter(Estimator<Lanes>);

impl Filter {
    fn new(model: &Model) -> Self {
        Filter(Estimator::new(model, VerticalInput::Pwm, 0.02, &SensorNoise::default()))
    }

    /// Returns its estimate at the next row of a flight.
    fn update(&mut self, row: &[f32; OBSERVATION]) -> Estimate<f32> {
        let e = self.0.update(&row.map(|value| Lanes::from_f64(value.into())));
        let first = |lanes: Lanes| lanes.array()[0];
        Estimate {
            pos_m: e.pos_m.map(first),
            vel_mps: e.vel_mps.map(first),
            yaw_rad: first(e.yaw_rad),
            push_mps2: e.push_mps2.map(first),
        }
    }
}

/// Computes the formulas of `crazyflie_gym/policy.py` once more, in `f64` and as plainly as possible.
fn plainly(
    o: &[f32],
    e: &Estimate<f32>,
    averages: &mut [[f64; 12]; 2],
    fresh: bool,
    rest: f64,
    (t, _): &(Tensors, About),
) -> Vec<f64> {
    let o: Vec<f64> = o.iter().map(|v| f64::from(*v)).collect();
    let wide = |v: [f32; 3]| v.map(f64::from);
    let (pos, yaw) = (wide(e.pos_m), f64::from(e.yaw_rad));
    let turned = |v: &[f64]| [yaw.cos() * v[0] + yaw.sin() * v[1], yaw.cos() * v[1] - yaw.sin() * v[0], v[2]];
    let error = [o[16] - pos[0], o[17] - pos[1], o[18] - pos[2]];
    let last = [o[20], o[21], o[22], o[23] - rest];
    let signals = [&error[..], &o[6..8], &last, &o[16..19]].concat();
    let turn = (o[19] - yaw).sin().atan2((o[19] - yaw).cos());
    let motion = [turned(&wide(e.vel_mps)), turned(&wide(e.push_mps2))];
    let motion = motion.as_flattened();
    let mut x = [&turned(&error)[..], motion, &[turn], &o[6..8], &o[9..12], &last].concat();
    for (kept, tau_s) in averages.iter_mut().zip([0.1, 0.4]) {
        for (kept, now) in kept.iter_mut().zip(&signals) {
            *kept = if fresh { *now } else { *kept + 0.02 / (tau_s + 0.02) * (now - *kept) };
        }
        let off: Vec<f64> = signals.iter().zip(&*kept).map(|(now, kept)| now - kept).collect();
        x.extend([&turned(&off[0..3])[..], &off[3..9], &turned(&off[9..12])].concat());
    }
    for ((x, mean), std) in x.iter_mut().zip(&t["feature_mean"].0).zip(&t["feature_std"].0) {
        *x = ((*x - f64::from(*mean)) / f64::from(*std)).clamp(-5.0, 5.0);
    }
    let layer = |x: &[f64], name: &str| -> Vec<f64> {
        let (weights, bias) = (&t[&*format!("{name}.weight")].0, &t[&*format!("{name}.bias")].0);
        let outputs = bias.len();
        (0..outputs)
            .map(|j| {
                f64::from(bias[j])
                    + (0..x.len()).map(|i| x[i] * f64::from(weights[i * outputs + j])).sum::<f64>()
            })
            .collect()
    };
    let hidden: Vec<f64> = layer(&x, "layer0").iter().map(|x| x.tanh()).collect();
    let skip = &t["skip.weight"].0;
    let linear = |j: usize| -> f64 {
        x.iter().zip(skip.chunks(ACTION)).map(|(x, weights)| x * f64::from(weights[j])).sum()
    };
    let out = layer(&hidden, "layer1");
    let rests = [0.0, 0.0, 0.0, rest];
    (0..ACTION).map(|j| (out[j] + linear(j) + rests[j]).clamp(-1.0, 1.0)).collect()
}

#[test]
fn it_answers_what_its_formulas_say_alone_as_in_a_batch() {
    let (model, given) = (Model::thesis(), policy());
    let mut estimator = Filter::new(&model);
    let mut batch = chosen(file(&given)).build(&site(&model, 37, VerticalInput::Pwm)).unwrap();
    let mut alone = chosen(file(&given)).build(&site(&model, 1, VerticalInput::Pwm)).unwrap();
    let interface = site(&model, 1, VerticalInput::Pwm).interface;
    let rest = 2.0 * interface.hover_lift / interface.lift_max - 1.0;
    let (mut averages, mut worst) = ([[0.0; 12]; 2], 0.0_f64);
    for tick in 0..100 {
        // a new flight begins in environment 23 half way
        if tick == 50 {
            batch.reset(&|env| env == 23);
            alone.reset(&|_| true);
            estimator = Filter::new(&model);
        }
        let rows: Vec<f32> =
            (0..37).flat_map(|env| (0..OBSERVATION).map(move |k| wave(env, tick, k))).collect();
        let (mut all, mut one) = (vec![0.0; 37 * ACTION], vec![0.0; ACTION]);
        let row = &rows[23 * OBSERVATION..24 * OBSERVATION];
        batch.act(&rows, &mut all).unwrap();
        alone.act(row, &mut one).unwrap();
        let bits = |row: &[f32]| row.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&one), bits(&all[23 * ACTION..24 * ACTION]), "tick {tick}");
        let estimate = estimator.update(row.as_array().unwrap());
        let want = plainly(row, &estimate, &mut averages, tick % 50 == 0, rest, &given);
        worst = one.iter().zip(&want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(worst, f64::max);
    }
    println!("largest difference from f64: {worst:.1e}");
    assert!(worst < 1e-5);
}

#[test]
fn landing_ends_with_the_motors_off() {
    let model = Model::thesis();
    let mut pilot = chosen(file(&policy())).build(&site(&model, 2, VerticalInput::Pwm)).unwrap();
    pilot.set_mode(Mode::Landing);
    let mut rows = vec![0.0; 2 * OBSERVATION];
    (rows[index::MARKER_Z], rows[OBSERVATION + index::MARKER_Z]) = (0.005, 0.3);
    let mut actions = vec![0.0; 2 * ACTION];
    pilot.act(&rows, &mut actions).unwrap();
    assert_eq!(actions[..4], [0.0, 0.0, 0.0, -1.0]);
    assert!(actions[ACTION + 3] > -1.0);
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    type Spoil = fn(&mut (Tensors, About));
    let cases: [(Spoil, &str); 16] = [
        (
            |p| drop(p.1.insert("format".into(), "crazyflie-policy-1".into())),
            "train it anew, version 0.2 reads other features",
        ),
        (|p| drop(p.1.remove("format")), "its format is \"not said\", expected \"crazyflie-policy-3\" or"),
        (|p| drop(p.0.remove("skip.weight")), "it lacks skip.weight"),
        (
            |p| p.0.get_mut("skip.weight").unwrap().1 = vec![ACTION, 43],
            "has the shape [4, 43], expected [43, 4]",
        ),
        (|p| drop(p.1.insert("tick_s".into(), "0.01".into())), "ticks of 0.01 s, expected 0.02 s"),
        (|p| drop(p.1.insert("tick_s".into(), "soon".into())), "ticks of NaN s"),
        (|p| drop(p.0.remove("feature_std")), "it lacks feature_std"),
        (
            |p| p.0.get_mut("feature_std").unwrap().0[3] = 0.0,
            "feature_std holds 0, expected positive numbers",
        ),
        (
            |p| p.0.get_mut("layer0.weight").unwrap().0[7] = f32::NAN,
            "layer0.weight holds NaN, expected finite numbers",
        ),
        (|p| p.0.get_mut("layer1.bias").unwrap().0[0] = f32::INFINITY, "layer1.bias holds inf"),
        (|p| drop(p.0.insert("taus_s", (vec![0.1], vec![1]))), "feature_mean has 43 numbers, expected 31"),
        (
            |p| drop(p.0.insert("taus_s", (vec![0.1, -1.0], vec![2]))),
            "taus_s is [0.1, -1.0], expected 1 to 8 positive times",
        ),
        (
            |p| p.0.get_mut("layer0.weight").unwrap().1 = vec![HIDDEN, FEATURES],
            "layer0 has weights [8, 43] and 8 biases, expected 43 inputs",
        ),
        (
            |p| p.0.get_mut("layer0.weight").unwrap().1 = vec![HIDDEN * FEATURES],
            "expected F32 with 2 dimension(s)",
        ),
        (|p| drop(p.0.remove("layer1.weight")), "1 layers end in 8 numbers, expected 1 to 8 that end in 4"),
        (|p| drop(p.0.remove("layer1.bias")), "it lacks layer1.bias"),
    ];
    let model = Model::thesis();
    let told = |bytes: Vec<u8>, input| {
        chosen(bytes).build(&site(&model, 1, input)).map(|_| ()).unwrap_err().to_string()
    };
    for (spoil, words) in cases {
        let mut parts = policy();
        spoil(&mut parts);
        let error = told(file(&parts), VerticalInput::Pwm);
        assert!(
            error.contains("controller policy") && error.contains(words),
            "expected {words:?} in: {error}"
        );
    }
    let whole = file(&policy());
    for cut in [0, 4, 100, whole.len() - 1] {
        let error = told(whole[..cut].to_vec(), VerticalInput::Pwm);
        assert!(error.contains("the file of the policy"), "{cut} bytes gave: {error}");
    }
    assert!(told(whole, VerticalInput::Height).contains("expected the vertical form pwm or thrust"));
    assert_eq!(chosen(Vec::new()).label, "policy:where");
}

/// C program that runs the exported policy on rows of observations that begin with a command: 0 for nothing, 1 for a
/// new flight, 2 for a landing.
const HARNESS: &str = r#"
#include <stdio.h>
#include "policy.h"
int main(void) {
    struct policy policy;
    float row[1 + POLICY_OBSERVATION], action[POLICY_ACTION];
    while (fread(row, sizeof row, 1, stdin) == 1) {
        if (row[0] == 1.0f) policy_reset(&policy);
        if (row[0] == 2.0f) policy.landing = 1;
        policy_act(&policy, row + 1, action);
        fwrite(action, sizeof action, 1, stdout);
    }
    return POLICY_LAST_ACTION + POLICY_ACTION - POLICY_OBSERVATION;
}
"#;

/// Compiles an exported policy and returns its answers.
fn answers_in_c(code: &PolicyCode, folder: &str, harness: &str, rows: &[f32]) -> Vec<f32> {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(folder);
    std::fs::create_dir_all(&folder).unwrap();
    for (name, text) in
        [("policy.c", &code.source[..]), ("policy.h", &code.header[..]), ("main.c", harness), ("rows", "")]
    {
        std::fs::write(folder.join(name), text).unwrap();
    }
    let flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wdouble-promotion"];
    let compiled = Command::new("cc")
        .current_dir(&folder)
        .args(flags)
        .args(["policy.c", "main.c", "-o", "policy", "-lm"])
        .output()
        .expect("a C compiler, which the linker of Rust needs as well");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let bytes: Vec<u8> = rows.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(folder.join("rows"), bytes).unwrap();
    let input = std::fs::File::open(folder.join("rows")).unwrap();
    let run = Command::new(folder.join("policy")).stdin(input).output().unwrap();
    assert!(run.status.success(), "{}", run.status);
    run.stdout.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

#[test]
fn in_c_it_answers_as_here() {
    const ROWS: usize = 1000;
    let model = Model::thesis();
    let bytes = file(&policy());
    let code = export_c(&bytes, &model, None, "policy").unwrap();
    assert!(!code.source.contains("malloc") && !code.source.contains("double"));
    assert!(
        code.header.contains("POLICY_EST_POS_M = 0,") && code.header.contains("[0..2] m:"),
        "{}",
        code.header
    );
    let mut pilot = chosen(bytes).build(&site(&model, 1, VerticalInput::Pwm)).unwrap();
    let mut estimator = Filter::new(&model);
    let (mut rows, mut want) = (Vec::new(), Vec::new());
    for tick in 0..ROWS {
        let mut row: [f32; OBSERVATION] = std::array::from_fn(|k| 3.0 * wave(7, tick, k));
        // new flights; the last of them lands
        let command = if tick % 250 == 0 { 1.0 } else { f32::from(u8::from(tick == 900)) * 2.0 };
        if command == 1.0 {
            pilot.reset(&|_| true);
            estimator = Filter::new(&model);
        }
        if command == 2.0 {
            pilot.set_mode(Mode::Landing);
        }
        row[index::MARKER_Z] = row[index::MARKER_Z].abs() + 0.1 - f32::from(u8::from(tick > 950)) * 2.0;
        let mut action = vec![0.0; ACTION];
        pilot.act(&row, &mut action).unwrap();
        rows.push(command);
        let e = estimator.update(&row);
        rows.extend([e.pos_m, e.vel_mps].as_flattened());
        rows.push(e.yaw_rad);
        rows.extend(e.push_mps2);
        rows.extend([&row[6..12], &row[16..24]].concat());
        want.extend(action);
    }
    let got = answers_in_c(&code, "of_features", HARNESS, &rows);
    assert_eq!(got.len(), ROWS * ACTION);
    let worst = got.iter().zip(&want).map(|(got, want)| (got - want).abs()).fold(0.0_f32, f32::max);
    println!("largest difference of {ROWS} answers: {worst:.1e}");
    assert!(worst < 1e-5, "{worst}");
    // the answers are not all cut off, and the landing ends with the motors off
    assert!(want.iter().filter(|a| a.abs() < 0.99).count() > ROWS);
    assert_eq!(got[ROWS * ACTION - 1], -1.0);
}

#[test]
fn what_is_no_policy_is_not_exported() {
    let model = Model::thesis();
    let error = |bytes: &[u8], input| export_c(bytes, &model, Some(input), "policy").unwrap_err().to_string();
    assert!(error(b"no policy", VerticalInput::Pwm).contains("the file of the policy"));
    assert!(error(&file(&policy()), VerticalInput::Height).contains("it commands a thrust"));
}

/// A policy of an observation: a dense layer, a recurrent one, and one that ends in an action.
fn row_policy(observation: &str, history: usize, others: usize, width: usize) -> (Tensors, About) {
    let inputs = history * width;
    let matrix =
        |rows: usize, columns: usize, size: f32| (numbers(rows * columns, size), vec![rows, columns]);
    let vector = |count: usize, size: f32| (numbers(count, size), vec![count]);
    let tensors = HashMap::from([
        ("observation_mean", vector(inputs, 0.1)),
        ("observation_std", (vec![0.7; inputs], vec![inputs])),
        ("layer0.weight", matrix(inputs, HIDDEN, 0.4)),
        ("layer0.bias", vector(HIDDEN, 0.2)),
        ("layer1.weight", matrix(HIDDEN, 3 * 5, 0.5)),
        ("layer1.bias", vector(3 * 5, 0.1)),
        ("layer1.recurrent_weight", matrix(5, 3 * 5, 0.6)),
        ("layer1.recurrent_bias", vector(3 * 5, 0.3)),
        ("layer2.weight", matrix(5, ACTION, 0.8)),
        ("layer2.bias", vector(ACTION, 0.1)),
    ]);
    let kinds = r#"[{"kind": "dense", "activation": "elu"}, {"kind": "gru"}, {"kind": "dense", "activation": "tanh"}]"#;
    let about = [
        ("format", "crazyflie-policy-3"),
        ("tick_s", "0.02"),
        ("observation", observation),
        ("history", &history.to_string()),
        ("others", &others.to_string()),
        ("action", "attitude"),
        ("vertical", "pwm"),
        ("clip", "10.0"),
        ("layers", kinds),
    ]
    .map(|(key, value)| (key.to_owned(), value.to_owned()));
    (tensors, HashMap::from(about))
}

/// The network of [`row_policy`] once more, in `f64` and as plainly as possible.
fn row_answer(x: &[f32], memory: &mut [f64; 5], t: &Tensors) -> Vec<f64> {
    let multiply = |x: &[f64], weight: &str, bias: &str| -> Vec<f64> {
        let (weights, bias) = (&t[weight].0, &t[bias].0);
        let sum = |j: usize| -> f64 {
            x.iter().enumerate().map(|(i, x)| x * f64::from(weights[i * bias.len() + j])).sum()
        };
        (0..bias.len()).map(|j| f64::from(bias[j]) + sum(j)).collect()
    };
    let scaled = x.iter().zip(&t["observation_mean"].0).zip(&t["observation_std"].0);
    let x: Vec<f64> = scaled
        .map(|((x, mean), std)| ((f64::from(*x) - f64::from(*mean)) / f64::from(*std)).clamp(-10.0, 10.0))
        .collect();
    let hidden: Vec<f64> = multiply(&x, "layer0.weight", "layer0.bias")
        .iter()
        .map(|x| if *x < 0.0 { x.exp_m1() } else { *x })
        .collect();
    let input = multiply(&hidden, "layer1.weight", "layer1.bias");
    let kept = multiply(&*memory, "layer1.recurrent_weight", "layer1.recurrent_bias");
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    for (i, memory) in memory.iter_mut().enumerate() {
        let (reset, update) = (sigmoid(input[i] + kept[i]), sigmoid(input[5 + i] + kept[5 + i]));
        let new = (input[10 + i] + reset * kept[10 + i]).tanh();
        *memory = (1.0 - update) * new + update * *memory;
    }
    multiply(&*memory, "layer2.weight", "layer2.bias").iter().map(|x| x.tanh()).collect()
}

/// Rows of three environments, as the rig measures them.
fn measured_rows(tick: usize) -> Vec<f32> {
    let mut rows: Vec<f32> =
        (0..3).flat_map(|env| (0..OBSERVATION).map(move |k| 2.0 * wave(env, tick, k))).collect();
    rows.chunks_exact_mut(OBSERVATION)
        .for_each(|row| row[index::MARKER_Z] = row[index::MARKER_Z].abs() + 0.2);
    rows
}

#[test]
fn a_policy_of_an_estimate_makes_it_from_what_is_measured() {
    let model = Model::thesis();
    let fields = r#"["est_error_m", "est_vel_mps", "attitude_rad", "marker_age_s"]"#;
    let parts = row_policy(fields, 2, 0, 10);
    let mut pilot = chosen(file(&parts)).build(&site(&model, 3, VerticalInput::Pwm)).unwrap();
    assert_eq!(pilot.needs(), InputNeeds::default());
    let mut filter = Filter::new(&model);
    let (mut memory, mut before) = ([0.0; 5], Vec::new());
    let mut rows_in_c = Vec::new();
    let mut all = Vec::new();
    for tick in 0..1000 {
        let begins = tick % 250 == 0;
        if begins {
            pilot.reset(&|_| true);
            (filter, memory, before) = (Filter::new(&model), [0.0; 5], Vec::new());
        }
        let rows = measured_rows(tick);
        let mut actions = vec![0.0; 3 * ACTION];
        pilot.act(&rows, &mut actions).unwrap();
        let row: &[f32; OBSERVATION] = rows[OBSERVATION..2 * OBSERVATION].as_array().unwrap();
        let e = filter.update(row);
        let error = [0, 1, 2].map(|i| row[index::SETPOINT_X + i] - e.pos_m[i]);
        let angle = |a: f32| a.clamp(-std::f32::consts::PI, std::f32::consts::PI);
        let now = [
            &error[..],
            &e.vel_mps,
            &row[index::ROLL..=index::YAW].iter().map(|a| angle(*a)).collect::<Vec<_>>(),
            &[row[index::MARKER_AGE].clamp(0.0, 60.0)],
        ]
        .concat();
        let two = [if begins { &now } else { &before }, &now[..]].concat();
        let want = row_answer(&two, &mut memory, &parts.0);
        for (got, want) in actions[ACTION..2 * ACTION].iter().zip(&want) {
            assert!((f64::from(*got) - want).abs() < 2e-5, "tick {tick}: {got} {want}");
        }
        rows_in_c.push(f32::from(u8::from(begins)));
        rows_in_c.extend(&now);
        all.extend_from_slice(&actions[ACTION..2 * ACTION]);
        before = now;
    }
    let code = export_c(&file(&parts), &model, None, "policy").unwrap();
    let harness = HARNESS.replace("        if (row[0] == 2.0f) policy.landing = 1;\n", "").replace(
        "POLICY_LAST_ACTION + POLICY_ACTION - POLICY_OBSERVATION",
        "POLICY_MARKER_AGE_S + 1 - POLICY_OBSERVATION",
    );
    let got = answers_in_c(&code, "of_rows", &harness, &rows_in_c);
    assert_eq!(got.len(), all.len());
    let worst = got.iter().zip(&all).map(|(got, want)| (got - want).abs()).fold(0.0_f32, f32::max);
    println!("largest difference of 1000 answers: {worst:.1e}");
    assert!(worst < 1e-5, "{worst}");
}

#[test]
fn the_true_state_is_read_where_it_is_known_and_refused_elsewhere() {
    let model = Model::thesis();
    let parts = row_policy("\"state\"", 1, 0, 24);
    let mut pilot = chosen(file(&parts)).build(&site(&model, 3, VerticalInput::Pwm)).unwrap();
    assert!(pilot.needs().truth);
    let (rows, mut actions) = (measured_rows(0), vec![0.0; 3 * ACTION]);
    let error = pilot.act(&rows, &mut actions).unwrap_err().to_string();
    assert!(error.contains("controller policy:") && error.contains("it reads the true state"), "{error}");
    let states: Vec<f32> = numbers(3 * STATE, 0.4);
    pilot.set_inputs(ExtraInputs { states: &states, others: &[] });
    pilot.act(&rows, &mut actions).unwrap();
    let (state, row) = (&states[STATE..2 * STATE], &rows[OBSERVATION..2 * OBSERVATION]);
    let error: Vec<f32> = (0..3).map(|i| row[index::SETPOINT_X + i] - state[i]).collect();
    let (sin, cos) = (row[index::SETPOINT_YAW] - state[state_index::YAW]).sin_cos();
    let seen = [state, &error, &[sin.atan2(cos)], &row[index::SETPOINT_X..OBSERVATION]].concat();
    let seen: Vec<f32> =
        seen.iter().enumerate().map(|(i, v)| if i >= 20 { v.clamp(-1.0, 1.0) } else { *v }).collect();
    for (got, want) in actions[ACTION..2 * ACTION].iter().zip(row_answer(&seen, &mut [0.0; 5], &parts.0)) {
        assert!((f64::from(*got) - want).abs() < 2e-5, "{got} {want}");
    }
    // extra inputs serve one action only
    pilot.act(&rows, &mut actions).unwrap_err();
}

#[test]
fn other_drones_are_read_in_worlds_of_as_many() {
    let model = Model::thesis();
    let parts = row_policy(r#"["est_error_m"]"#, 1, 1, 3 + 8);
    let build = || chosen(file(&parts)).build(&site(&model, 2, VerticalInput::Pwm)).unwrap();
    let mut alone = build();
    let mut actions = vec![0.0; 2 * ACTION];
    let error = alone.act(&measured_rows(0)[..2 * OBSERVATION], &mut actions).unwrap_err().to_string();
    assert!(error.contains("it reads fields of 1 other drones; fly it where there are 2 drones"), "{error}");
    let mut pair = MultiController::new(vec![build(), build()], 2, None, 0.02).unwrap();
    let rows = numbers(4 * (OBSERVATION + 8), 0.5);
    let mut actions = vec![0.0; 4 * ACTION];
    pair.act(&rows, &mut actions).unwrap();
    for (row, action) in rows.chunks_exact(OBSERVATION + 8).zip(actions.chunks_exact(ACTION)) {
        let pos_m = [row[index::MARKER_X], row[index::MARKER_Y], row[index::MARKER_Z].max(0.0)];
        let error_m = [0, 1, 2].map(|i| row[index::SETPOINT_X + i] - pos_m[i]);
        let seen = [&error_m, &row[OBSERVATION..]].concat();
        for (got, want) in action.iter().zip(row_answer(&seen, &mut [0.0; 5], &parts.0)) {
            assert!((f64::from(*got) - want).abs() < 2e-4, "{got} {want}");
        }
    }
}

#[test]
fn it_lands_by_the_set_point_and_ends_with_the_motors_off() {
    let model = Model::thesis();
    let parts = row_policy(r#"["setpoint"]"#, 1, 0, 4);
    let mut pilot = chosen(file(&parts)).build(&site(&model, 3, VerticalInput::Pwm)).unwrap();
    pilot.set_mode(Mode::Landing);
    let mut rows = measured_rows(0);
    rows[2] = 0.005;
    let mut actions = vec![0.0; 3 * ACTION];
    pilot.act(&rows, &mut actions).unwrap();
    assert_eq!(actions[..ACTION], [0.0, 0.0, 0.0, -1.0]);
    assert!(actions[2 * ACTION - 1] > -1.0);
}

#[test]
fn what_is_wrong_with_such_a_file_is_said() {
    let model = Model::thesis();
    for (key, value, words) in [
        ("observation", r#"["est_eror_m"]"#, "did you mean \"est_error_m\""),
        ("observation", r#"["gate_pos_m"]"#, "a controller is not told the field \"gate_pos_m\""),
        ("observation", r#"["est_error_m", "est_vel_mps"]"#, "observation_mean has 3 numbers, expected 6"),
        ("history", "0", "history is 0, expected 1 to 64"),
        ("history", "soon", "history: expected"),
        ("layers", r#"[{"kind": "lstm"}]"#, "layers: unknown variant `lstm`"),
        ("layers", r#"[{"kind": "dense", "activation": "mish"}]"#, "layers: unknown variant `mish`"),
        ("layers", "[]", "0 layers end in 3 numbers"),
        ("action", "velocity", "trained for the action level velocity, and attitude is asked for"),
        ("vertical", "height", "commands the vertical form height, and pwm is asked for"),
        ("tick_s", "0.01", "ticks of 0.01 s, expected 0.02 s"),
    ] {
        let mut parts = row_policy(r#"["est_error_m"]"#, 1, 0, 3);
        parts.1.insert(key.into(), value.into());
        let spec = chosen(file(&parts));
        let error = spec.build(&site(&model, 1, VerticalInput::Pwm)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("controller policy") && error.contains(words), "{key} {value} gave: {error}");
    }
    // trained for a PWM, it commands the form with inertia as well
    chosen(file(&row_policy(r#"["est_error_m"]"#, 1, 0, 3)))
        .build(&site(&model, 1, VerticalInput::Thrust))
        .unwrap();
    let mut parts = row_policy(r#"["est_error_m"]"#, 1, 0, 3);
    parts.0.insert("layer1.recurrent_weight", (numbers(4 * 15, 0.1), vec![4, 15]));
    let error =
        chosen(file(&parts)).build(&site(&model, 1, VerticalInput::Pwm)).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("layer1 has weights [4, 15] and 15 biases, expected 5 inputs"), "{error}");
}
