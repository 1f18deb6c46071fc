//! Policies from files: what they answer, and what is said of files that are no policies.

use std::collections::HashMap;

use crazyflie_control::{ControllerContext, ControllerSpec, Mode, choose};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

type Tensors = HashMap<&'static str, (Vec<f32>, Vec<usize>)>;
type About = HashMap<String, String>;

const FEATURES: usize = 14 + 2 * 12;
const HIDDEN: usize = 8;

/// Numbers without any pattern to speak of.
fn numbers(count: usize, size: f32) -> Vec<f32> {
    (0..count).map(|i| size * (0.7 * i as f32 * i as f32 + 1.3 * i as f32).sin()).collect()
}

/// A policy with a hidden layer, two time constants, and arbitrary weights.
fn policy() -> (Tensors, About) {
    let tensors = HashMap::from([
        ("taus_s", (vec![0.1, 0.4], vec![2])),
        ("feature_mean", (numbers(FEATURES, 0.1), vec![FEATURES])),
        ("feature_std", (vec![0.5; FEATURES], vec![FEATURES])),
        ("layer0.weight", (numbers(FEATURES * HIDDEN, 0.5), vec![FEATURES, HIDDEN])),
        ("layer0.bias", (numbers(HIDDEN, 0.2), vec![HIDDEN])),
        ("layer1.weight", (numbers(HIDDEN * ACTION, 0.3), vec![HIDDEN, ACTION])),
        ("layer1.bias", (numbers(ACTION, 0.1), vec![ACTION])),
    ]);
    let about =
        [("format", "crazyflie-policy-1"), ("tick_s", "0.02")].map(|(k, v)| (k.to_owned(), v.to_owned()));
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

/// The formulas of `crazyflie_gym/policy.py` once more, in `f64` and as plainly as they can be said.
fn plainly(
    o: &[f32],
    averages: &mut [[f64; 12]; 2],
    fresh: bool,
    rest: f64,
    (t, _): &(Tensors, About),
) -> Vec<f64> {
    let o: Vec<f64> = o.iter().map(|v| f64::from(*v)).collect();
    let turned =
        |v: &[f64]| [o[3].cos() * v[0] + o[3].sin() * v[1], o[3].cos() * v[1] - o[3].sin() * v[0], v[2]];
    let error = [o[16] - o[0], o[17] - o[1], o[18] - o[2]];
    let last = [o[20], o[21], o[22], o[23] - rest];
    let signals = [&error[..], &o[6..8], &last, &o[16..19]].concat();
    let turn = (o[19] - o[3]).sin().atan2((o[19] - o[3]).cos());
    let mut x = [&turned(&error)[..], &[turn], &o[6..8], &o[9..12], &last, &[o[4].min(0.5)]].concat();
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
    let out = layer(&hidden, "layer1");
    out.iter().zip([0.0, 0.0, 0.0, rest]).map(|(out, rest)| (out + rest).clamp(-1.0, 1.0)).collect()
}

#[test]
fn it_answers_what_its_formulas_say_alone_as_in_a_batch() {
    let (model, given) = (Model::thesis(), policy());
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
        }
        let rows: Vec<f32> =
            (0..37).flat_map(|env| (0..OBSERVATION).map(move |k| wave(env, tick, k))).collect();
        let (mut all, mut one) = (vec![0.0; 37 * ACTION], vec![0.0; ACTION]);
        let row = &rows[23 * OBSERVATION..24 * OBSERVATION];
        batch.act(&rows, &mut all).unwrap();
        alone.act(row, &mut one).unwrap();
        let bits = |row: &[f32]| row.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&one), bits(&all[23 * ACTION..24 * ACTION]), "tick {tick}");
        let want = plainly(row, &mut averages, tick % 50 == 0, rest, &given);
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
    (rows[2], rows[OBSERVATION + 2]) = (0.04, 0.3);
    let mut actions = vec![0.0; 2 * ACTION];
    pilot.act(&rows, &mut actions).unwrap();
    assert_eq!(actions[..4], [0.0, 0.0, 0.0, -1.0]);
    assert!(actions[7] > -1.0);
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    type Spoil = fn(&mut (Tensors, About));
    let cases: [(Spoil, &str); 13] = [
        (|p| drop(p.1.remove("format")), "its format is \"not said\", expected \"crazyflie-policy-1\""),
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
        (|p| drop(p.0.insert("taus_s", (vec![0.1], vec![1]))), "feature_mean has 38 numbers, expected 26"),
        (
            |p| drop(p.0.insert("taus_s", (vec![0.1, -1.0], vec![2]))),
            "taus_s is [0.1, -1.0], expected 1 to 8 positive times",
        ),
        (
            |p| p.0.get_mut("layer0.weight").unwrap().1 = vec![HIDDEN, FEATURES],
            "layer0 has weights [8, 38] and 8 biases, expected 38 inputs",
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
        let mut given = policy();
        spoil(&mut given);
        let error = told(file(&given), VerticalInput::Pwm);
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
