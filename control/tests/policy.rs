//! Policies from files: their actions, and the errors of files that are no policies.

use std::collections::HashMap;
use std::process::Command;

use crazyflie_control::{ControllerContext, ControllerSpec, Mode, PolicyCode, choose, export_c};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::scalar::Scalar;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

type Tensors = HashMap<&'static str, (Vec<f32>, Vec<usize>)>;
type About = HashMap<String, String>;

/// Numbers of features: of the format with fixes, and of the one with an estimate.
const FEATURES: [usize; 2] = [14 + 2 * 12, 19 + 2 * 12];
const HIDDEN: usize = 8;

/// Numbers without any pattern to speak of.
fn numbers(count: usize, size: f32) -> Vec<f32> {
    (0..count).map(|i| size * (0.7 * i as f32 * i as f32 + 1.3 * i as f32).sin()).collect()
}

/// A policy with a hidden layer, two time constants, and arbitrary weights: of a fix (the first format), or of
/// an estimate.
fn policy(estimate: bool) -> (Tensors, About) {
    let features = FEATURES[usize::from(estimate)];
    let mut tensors = HashMap::from([
        ("taus_s", (vec![0.1, 0.4], vec![2])),
        ("feature_mean", (numbers(features, 0.1), vec![features])),
        ("feature_std", (vec![0.5; features], vec![features])),
        ("layer0.weight", (numbers(features * HIDDEN, 0.5), vec![features, HIDDEN])),
        ("layer0.bias", (numbers(HIDDEN, 0.2), vec![HIDDEN])),
        ("layer1.weight", (numbers(HIDDEN * ACTION, 0.3), vec![HIDDEN, ACTION])),
        ("layer1.bias", (numbers(ACTION, 0.1), vec![ACTION])),
    ]);
    if estimate {
        tensors.insert("skip.weight", (numbers(features * ACTION, 0.05), vec![features, ACTION]));
    }
    let format = format!("crazyflie-policy-{}", 1 + u8::from(estimate));
    let about = [("format", &*format), ("tick_s", "0.02")].map(|(k, v)| (k.to_owned(), v.to_owned()));
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
    estimate: Option<&Estimate<f32>>,
    averages: &mut [[f64; 12]; 2],
    fresh: bool,
    rest: f64,
    (t, _): &(Tensors, About),
) -> Vec<f64> {
    let o: Vec<f64> = o.iter().map(|v| f64::from(*v)).collect();
    let wide = |v: [f32; 3]| v.map(f64::from);
    let pos = estimate.map_or([o[0], o[1], o[2]], |e| wide(e.pos_m));
    let yaw = estimate.map_or(o[3], |e| f64::from(e.yaw_rad));
    let turned = |v: &[f64]| [yaw.cos() * v[0] + yaw.sin() * v[1], yaw.cos() * v[1] - yaw.sin() * v[0], v[2]];
    let error = [o[16] - pos[0], o[17] - pos[1], o[18] - pos[2]];
    let last = [o[20], o[21], o[22], o[23] - rest];
    let signals = [&error[..], &o[6..8], &last, &o[16..19]].concat();
    let turn = (o[19] - yaw).sin().atan2((o[19] - yaw).cos());
    let motion = estimate.map_or(Vec::new(), |e| {
        [turned(&wide(e.vel_mps)), turned(&wide(e.push_mps2))].as_flattened().to_vec()
    });
    let age = if estimate.is_some() { Vec::new() } else { vec![o[4].min(0.5)] };
    let mut x = [&turned(&error)[..], &motion, &[turn], &o[6..8], &o[9..12], &last, &age].concat();
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
    let skip = t.get("skip.weight").map_or(&[][..], |(weights, _)| weights);
    let linear = |j: usize| -> f64 {
        x.iter().zip(skip.chunks(ACTION)).map(|(x, weights)| x * f64::from(weights[j])).sum()
    };
    let out = layer(&hidden, "layer1");
    let rests = [0.0, 0.0, 0.0, rest];
    (0..ACTION).map(|j| (out[j] + linear(j) + rests[j]).clamp(-1.0, 1.0)).collect()
}

#[test]
fn it_answers_what_its_formulas_say_alone_as_in_a_batch() {
    compare_with_formulas(&policy(true));
}

#[test]
fn files_of_the_first_format_fly_on() {
    compare_with_formulas(&policy(false));
}

fn compare_with_formulas(given: &(Tensors, About)) {
    let model = Model::thesis();
    let mut estimator = given.0.contains_key("skip.weight").then(|| Filter::new(&model));
    let mut batch = chosen(file(given)).build(&site(&model, 37, VerticalInput::Pwm)).unwrap();
    let mut alone = chosen(file(given)).build(&site(&model, 1, VerticalInput::Pwm)).unwrap();
    let interface = site(&model, 1, VerticalInput::Pwm).interface;
    let rest = 2.0 * interface.hover_lift / interface.lift_max - 1.0;
    let (mut averages, mut worst) = ([[0.0; 12]; 2], 0.0_f64);
    for tick in 0..100 {
        // a new flight begins in environment 23 half way
        if tick == 50 {
            batch.reset(&|env| env == 23);
            alone.reset(&|_| true);
            estimator = estimator.map(|_| Filter::new(&model));
        }
        let rows: Vec<f32> =
            (0..37).flat_map(|env| (0..OBSERVATION).map(move |k| wave(env, tick, k))).collect();
        let (mut all, mut one) = (vec![0.0; 37 * ACTION], vec![0.0; ACTION]);
        let row = &rows[23 * OBSERVATION..24 * OBSERVATION];
        batch.act(&rows, &mut all).unwrap();
        alone.act(row, &mut one).unwrap();
        let bits = |row: &[f32]| row.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&one), bits(&all[23 * ACTION..24 * ACTION]), "tick {tick}");
        let estimate = estimator.as_mut().map(|estimator| estimator.update(row.as_array().unwrap()));
        let want = plainly(row, estimate.as_ref(), &mut averages, tick % 50 == 0, rest, given);
        worst = one.iter().zip(&want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(worst, f64::max);
    }
    println!("largest difference from f64: {worst:.1e}");
    assert!(worst < 1e-5);
}

#[test]
fn landing_ends_with_the_motors_off() {
    let model = Model::thesis();
    let mut pilot = chosen(file(&policy(true))).build(&site(&model, 2, VerticalInput::Pwm)).unwrap();
    pilot.set_mode(Mode::Landing);
    let mut rows = vec![0.0; 2 * OBSERVATION];
    (rows[2], rows[OBSERVATION + 2]) = (0.005, 0.3);
    let mut actions = vec![0.0; 2 * ACTION];
    pilot.act(&rows, &mut actions).unwrap();
    assert_eq!(actions[..4], [0.0, 0.0, 0.0, -1.0]);
    assert!(actions[7] > -1.0);
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    type Spoil = fn(&mut (Tensors, About));
    let cases: [(Spoil, &str); 15] = [
        (|p| drop(p.1.remove("format")), "its format is \"not said\", expected \"crazyflie-policy-2\" or"),
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
            |p| p.0.get_mut("layer0.weight").unwrap().1 = vec![HIDDEN, FEATURES[1]],
            "layer0 has weights [8, 43] and 8 biases, expected 43 inputs",
        ),
        (
            |p| p.0.get_mut("layer0.weight").unwrap().1 = vec![HIDDEN * FEATURES[1]],
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
        let mut given = policy(true);
        spoil(&mut given);
        let error = told(file(&given), VerticalInput::Pwm);
        assert!(
            error.contains("controller policy") && error.contains(words),
            "expected {words:?} in: {error}"
        );
    }
    let whole = file(&policy(true));
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
fn answers_in_c(code: &PolicyCode, folder: &str, rows: &[f32]) -> Vec<f32> {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(folder);
    std::fs::create_dir_all(&folder).unwrap();
    for (name, text) in
        [("policy.c", &code.source[..]), ("policy.h", &code.header[..]), ("main.c", HARNESS), ("rows", "")]
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
    compare_with_c(true);
}

#[test]
fn in_c_the_first_format_answers_as_here() {
    compare_with_c(false);
}

fn compare_with_c(estimate: bool) {
    const ROWS: usize = 1000;
    let model = Model::thesis();
    let bytes = file(&policy(estimate));
    let code = export_c(&bytes, &model, VerticalInput::Pwm, "policy").unwrap();
    assert!(!code.source.contains("malloc") && !code.source.contains("double"));
    let first = if estimate { "POLICY_EST_POS_M = 0," } else { "POLICY_MARKER_POS_M = 0," };
    assert!(code.header.contains(first) && code.header.contains("[0..2] m:"), "{}", code.header);
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
        row[2] = row[2].abs() + 0.1 - f32::from(u8::from(tick > 950)) * 2.0;
        let mut action = vec![0.0; ACTION];
        pilot.act(&row, &mut action).unwrap();
        rows.push(command);
        let e = estimator.update(&row);
        if estimate {
            rows.extend([e.pos_m, e.vel_mps].as_flattened());
            rows.push(e.yaw_rad);
            rows.extend(e.push_mps2);
            rows.extend([&row[6..12], &row[16..24]].concat());
        } else {
            rows.extend(row);
        }
        want.extend(action);
    }
    let got = answers_in_c(&code, if estimate { "of_estimate" } else { "of_fix" }, &rows);
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
    let error = |bytes: &[u8], input| export_c(bytes, &model, input, "policy").unwrap_err().to_string();
    assert!(error(b"no policy", VerticalInput::Pwm).contains("the file of the policy"));
    assert!(error(&file(&policy(true)), VerticalInput::Height).contains("it commands a thrust"));
}
