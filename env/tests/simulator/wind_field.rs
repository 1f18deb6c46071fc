//! Wind from place to place, felt by whatever drags through the air.

use crazyflie_env::Result;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::effects;
use crazyflie_env::free_flight::{FreeFlight, FreeStart};
use crazyflie_env::model::Model;
use crazyflie_env::scalar::tabulate;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv, state_index};
use crazyflie_env::wind_field::WindField;
use serde_json::{Value, json};

const ENVS: usize = 21;
const STEPS: usize = 50;

/// A field whose x-velocity is 0.5 m/s and `per_m` more for each metre of x, as far as drones fly.
fn field(per_m: f64) -> Value {
    let sample = |x_m: f64| json!([[[0.5 + per_m * x_m, -0.25, 0.0]]]);
    json!({"origin_m": [-4.0, 0.0, 0.0], "spacing_m": [8.0, 1.0, 1.0], "velocity_mps": [sample(-4.0), sample(4.0)]})
}

/// True states at the beginning and after a second of level flight.
fn fly(model: &Model, options: Value) -> Result<[Vec<f32>; 2]> {
    let mut all = json!({"vertical": "thrust"});
    all.as_object_mut().unwrap().extend(options.as_object().unwrap().clone());
    let mut env = VectorEnv::new(std::slice::from_ref(model), &Options::parse(&all.to_string())?, ENVS)?;
    let rows = ENVS * env.num_drones();
    let (mut rewards, mut terminated, mut truncated) =
        (vec![0.0; rows], vec![false; rows], vec![false; rows]);
    let (mut flying, mut metrics) = (vec![true; rows], vec![0.0; ENVS * env.num_metrics()]);
    let mut observations = vec![0.0; rows * env.width()];
    let seeds: Vec<u64> = (0..ENVS as u64).collect();
    env.reset(Some(&seeds), None, &mut observations)?;
    let hover = env.interfaces()[0].hover_lift / env.interfaces()[0].lift_max * 2.0 - 1.0;
    let mut actions = vec![0.0; rows * ACTION];
    actions.chunks_mut(ACTION).for_each(|action| action[3] = hover as f32);
    let mut states = [vec![0.0; rows * STATE], vec![0.0; rows * STATE]];
    env.states(&mut states[0])?;
    for _ in 0..STEPS {
        let out = StepBuffers {
            observations: &mut observations,
            rewards: &mut rewards,
            terminated: &mut terminated,
            truncated: &mut truncated,
            flying: &mut flying,
            metrics: &mut metrics,
        };
        env.step(&actions, out)?;
    }
    env.states(&mut states[1])?;
    Ok(states)
}

#[test]
fn a_drone_drifts_as_the_differential_equation_says() {
    let (rate_ps, per_m) = (0.8, 0.3);
    let options = json!({"effects": {"drag_linear": rate_ps}, "wind_field": field(per_m)});
    let [before, after] = fly(&Model::thesis(), options).unwrap();
    for (row, (before, after)) in before.chunks(STATE).zip(after.chunks(STATE)).enumerate() {
        let (mut x_m, mut vx_mps, mut vy_mps) = (f64::from(before[state_index::POS]), 0.0, 0.0);
        let h_s = 1e-4;
        for _ in 0..10_000 {
            // at the middle of the step
            let middle_mps = vx_mps + 0.5 * h_s * rate_ps * (0.5 + per_m * x_m - vx_mps);
            let middle_m = x_m + 0.5 * h_s * vx_mps;
            vx_mps += h_s * rate_ps * (0.5 + per_m * middle_m - middle_mps);
            vy_mps += h_s * rate_ps * (-0.25 - vy_mps);
            x_m += h_s * middle_mps;
        }
        let got = |place: usize| f64::from(after[place]);
        for (got, want) in [
            (got(state_index::POS), x_m),
            (got(state_index::VEL), vx_mps),
            (got(state_index::VEL + 1), vy_mps),
        ] {
            assert!((got - want).abs() < 1e-4, "{row}: {got}, not {want}");
        }
    }
}

#[test]
fn the_drag_of_the_model_feels_the_air_as_an_effect_does() {
    let mut dragging = Model::thesis();
    dragging.lateral.drag.value = 0.8;
    let [_, by_model] = fly(&dragging, json!({"wind_field": field(0.3)})).unwrap();
    let effects = json!({"effects": {"drag_linear": 0.8}, "wind_field": field(0.3)});
    let [_, by_effect] = fly(&Model::thesis(), effects).unwrap();
    let far = by_model.iter().zip(&by_effect).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-4, "{far}");
    let [_, calm] = fly(&dragging, json!({})).unwrap();
    assert!((by_model[state_index::POS] - calm[state_index::POS]).abs() > 0.05);
}

#[test]
fn threads_and_instruction_sets_change_nothing() {
    for task in ["hover", "swap"] {
        let fly = |threads: usize, isa: Option<&str>| {
            let effects = json!({"drag_quadratic": 0.3, "gust": 0.2});
            let options = json!({"task": task, "effects": effects, "wind_field": field(0.3),
                                 "threads": threads, "isa": isa});
            fly(&Model::thesis(), options).unwrap()[1].iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        assert!(fly(1, None) == fly(2, Some("baseline")), "{task}");
    }
}

#[test]
fn what_says_that_it_feels_the_air_does() {
    let mut count = 0;
    for entry in effects::registry() {
        let param = &entry.params[0];
        let on = param.starts.first().copied().unwrap_or(0.5 * (param.off + param.farthest_bound()));
        let effects = json!({entry.name: {param.name: on}});
        let windy = fly(
            &Model::thesis(),
            json!({"vertical": "pwm", "effects": effects.clone(), "wind_field": field(0.0)}),
        );
        if entry.feels_air {
            let calm = fly(&Model::thesis(), json!({"vertical": "pwm", "effects": effects})).unwrap();
            let upwards =
                json!({"origin_m": [0, 0, 0], "spacing_m": [1, 1, 1], "velocity_mps": [[[[0.5, 0, 0.5]]]]});
            let effects = json!({entry.name: {param.name: on}});
            let options = json!({"vertical": "pwm", "effects": effects, "wind_field": upwards});
            let blown = fly(&Model::thesis(), options).unwrap();
            assert!(windy.is_ok() && blown[1] != calm[1], "{}", entry.name);
            count += 1;
        } else {
            let error = windy.unwrap_err().to_string();
            assert!(error.contains("nothing feels the air") && error.contains("drag_linear"), "{error}");
        }
    }
    assert!(count > 0);
}

/// Returns the linear velocity field `linear` on a grid of 4 by 3 by 2 points.
fn linear_field(linear: impl Fn([f64; 3]) -> [f64; 3]) -> WindField {
    let (origin_m, spacing_m, counts) = ([-1.0, -0.5, 0.0], [0.5, 0.5, 2.0], [4, 3, 2]);
    let mut velocity_mps = Vec::new();
    for x in 0..counts[0] {
        for y in 0..counts[1] {
            for z in 0..counts[2] {
                let steps = [x, y, z];
                let pos_m = tabulate::<f64, 3>(|k| origin_m[k] + spacing_m[k] * steps[k] as f64);
                velocity_mps.push(linear(pos_m).map(|v| v as f32));
            }
        }
    }
    WindField::new(origin_m, spacing_m, counts, velocity_mps).unwrap()
}

#[test]
fn a_linear_field_is_exact_between_the_points_and_ends_at_the_faces() {
    let linear = |[x, y, z]: [f64; 3]| [1.0 + x - 2.0 * y, 0.5 * z, x + 0.25 * y - z];
    let field = linear_field(linear);
    for pos_m in [[-1.0, -0.5, 0.0], [0.5, 0.5, 2.0], [-0.8125, 0.125, 1.75], [0.25, 0.0, 0.0625]] {
        assert_eq!(field.velocity_mps(pos_m), linear(pos_m), "at {pos_m:?}");
    }
    assert_eq!(field.velocity_mps([9.0, 0.25, -3.0]), linear([0.5, 0.25, 0.0]));
}

#[test]
fn one_point_is_the_same_wind_everywhere() {
    let field = WindField::new([0.0; 3], [1.0; 3], [1; 3], vec![[0.5, -0.25, 0.0]]).unwrap();
    assert_eq!(field.velocity_mps([3.0, -7.0, 0.2]), [0.5, -0.25, 0.0]);
}

#[test]
fn it_is_read_as_it_is_written_and_mistakes_are_named() {
    let text = serde_json::to_string(&linear_field(|[x, ..]| [x, 0.1, 0.0])).unwrap();
    let read: WindField = serde_json::from_str(&text).unwrap();
    assert_eq!(serde_json::to_string(&read).unwrap(), text);
    for (table, words) in [
        (r#"{"origin_m": [0, 0, 0], "spacing_m": [1, 1, 1], "velocity_mps": []}"#, "axis 0 is 0"),
        (
            r#"{"origin_m": [0, 0, 0], "spacing_m": [1, 0, 1], "velocity_mps": [[[[0, 0, 0]]]]}"#,
            "spacing_m[1] is 0",
        ),
        (
            r#"{"origin_m": [0, 0, 0], "spacing_m": [1, 1, 1], "velocity_mps": [[[[0, 0, 99]]]]}"#,
            "velocity_mps[0][0][0][2] is 99",
        ),
        (
            r#"{"origin_m": [0, 0, 0], "spacing_m": [1, 1, 1], "velocity_mps": [[[[0, 0, 0]]], [[]]]}"#,
            "velocity_mps[1][0] has 0 entries, expected 1",
        ),
        (r#"{"origin_m": [0, 0, 0], "spacing": [1, 1, 1], "velocity_mps": []}"#, "unknown field"),
    ] {
        let error = serde_json::from_str::<WindField>(table).unwrap_err().to_string();
        assert!(error.contains(words), "{table} gave: {error}");
    }
}

#[test]
fn a_free_flight_refuses_it_instead_of_flying_without() {
    let options = json!({"effects": {"drag_linear": 0.8}, "wind_field": field(0.3)});
    let options = Options::parse(&options.to_string()).unwrap();
    let start = |drones| FreeStart { pos_m: vec![[0.0, 0.0, 1.0]; drones], load: None, seed: 1 };
    let refused = FreeFlight::new(&Model::thesis(), &options, start(1)).err().unwrap().to_string();
    assert!(refused.contains("wind_field: a free flight"), "{refused}");
    let calm = Options { wind_field: None, ..options };
    assert!(FreeFlight::new(&Model::thesis(), &calm, start(1)).is_ok());
    let none = FreeFlight::new(&Model::thesis(), &calm, start(0)).err().unwrap().to_string();
    assert!(none.contains("drones"), "{none}");
}
