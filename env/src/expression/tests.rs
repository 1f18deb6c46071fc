use proptest::prelude::*;

use super::*;
use crate::lanes::{LANES, Lanes};
use crate::observation::{OBSERVATION, Setpoint};
use crate::plant::State;
use crate::scalar::Scalar;

/// A moment of a drone 30 cm beside and 40 cm below its set-point.
fn evaluate<R: Scalar>(program: &Program) -> R {
    let n = R::from_f64;
    let mut x = State::rest();
    x.pos_m = [n(0.3), n(0.0), n(0.3)];
    x.vel_mps = [n(3.0), n(-4.0), n(0.0)];
    x.att_rad = [n(0.1), n(-0.2), n(4.0)];
    x.rate_radps = [n(1.0), n(2.0), n(-2.0)];
    let setpoint = Setpoint { pos_m: [n(0.0), n(0.0), n(0.7)], yaw_rad: n(0.5) };
    let mut own = [n(0.0); OBSERVATION];
    own[16..20].copy_from_slice(&[n(0.0), n(0.0), n(0.7), n(0.5)]);
    own[20..].copy_from_slice(&[n(0.25), n(0.0), n(0.0), n(-0.5)]);
    let last_action = [n(-0.25), n(0.0), n(0.0), n(-0.5)];
    program.evaluate(&Moment {
        own: &own,
        x: &x,
        setpoint: &setpoint,
        last_action: &last_action,
        impact_mps: n(0.5),
        now_s: n(1.5),
        broken: R::nothing(),
        arrived: n(0.0).lt(n(1.0)),
        task_reward: n(0.9),
        pairs: None,
    })
}

fn value(text: &str) -> f64 {
    evaluate(&parse_reward(text).unwrap())
}

fn error(text: &str) -> String {
    parse_reward(text).unwrap_err().to_string()
}

#[test]
fn values_are_those_of_python() {
    for (text, want) in [
        ("exp(-4*dist**2) - 0.01*rate2", (-4.0_f64 * 0.25).exp() - 0.09),
        ("-2**2", -4.0),
        ("2**3**2", 512.0),
        ("2**-1", 0.5),
        ("1 - 2 - 3", -4.0),
        ("8 / 4 / 2", 1.0),
        ("2 + 3 * 4", 14.0),
        ("(2 + 3) * 4", 20.0),
        ("1 if dist < 0.4 else 2 if dist < 0.6 else 3", 2.0),
        ("1 if not dist < 0.4 and tilt > 0.2 or 1 > 2 else 0", 1.0),
        ("1 if dist >= 0.4 and tilt <= 0.2 else 0", 0.0),
        ("speed + norm(vel_mps)", 10.0),
        ("pos_m[2]", 0.3),
        ("error_m[2] - 0.1", 0.3),
        ("yaw_error_rad", 0.5 - (4.0 - std::f64::consts::TAU)),
        ("setpoint[3]", 0.5),
        ("last_action[0]", 0.25),
        ("action_change[0]", 0.5),
        ("norm(action_change)", 0.5),
        ("time_s * 2", 3.0),
        ("impact_mps", 0.5),
        ("task_reward - arrived + broken", -0.1),
        ("min(dist, 0.2) + max(dist, 0.2)", 0.7),
        ("abs(-3) + sqrt(16) + log(exp(1))", 8.0),
        ("tanh(0.5) + tanh(-50) + tanh(50)", 0.5_f64.tanh()),
        ("sin(0.3)**2 + cos(0.3)**2", 1.0),
        ("dist**0.5", 0.5_f64.sqrt()),
        ("2**0.25 + 0**0.25", 2.0_f64.powf(0.25)),
        ("(dist - 0.7)**3", -0.008),
        ("1e-2 + .5 + 2.", 2.51),
        ("\n  1 +\n 2 ", 3.0),
    ] {
        let got = value(text);
        assert!((got - want).abs() < 1e-9, "{text}: {got}, expected {want}");
    }
}

#[test]
fn what_is_wrong_is_said_with_its_column() {
    for (text, words) in [
        ("exp(-4*dst**2)", vec!["column 8", "unknown field \"dst\"", "did you mean \"dist\""]),
        ("exq(dist)", vec!["column 1", "unknown function \"exq\"", "did you mean \"exp\""]),
        ("dist + speed", vec!["column 1", "a number in m and one in m/s"]),
        ("dist < 0.3", vec!["expected a number, got a condition"]),
        ("1 if dist < speed else 0", vec!["column 6", "`<` compares a number in m and one in m/s"]),
        ("exp(dist)", vec!["column 5", "exp of a number in m"]),
        ("dist**tilt", vec![]),
        ("2**dist", vec!["column 4", "exponent without a unit"]),
        ("dist < 1", vec!["expected a number, got a condition"]),
        ("dist and 1", vec!["column 1", "expected a condition beside `and`"]),
        ("1 if 0 < dist < 1 else 0", vec!["join two with `and`"]),
        ("pos_m", vec!["pos_m has 3 numbers", "pos_m[0] to pos_m[2], or norm(pos_m)"]),
        ("pos_m[3]", vec!["pos_m has the components 0 to 2, got 3"]),
        ("norm(setpoint)", vec!["several units"]),
        ("min(dist)", vec!["min takes 2 arguments, got 1"]),
        ("dist +", vec!["column 7", "expected a number"]),
        ("(dist", vec!["column 6", "expected"]),
        ("dist)", vec!["column 5", "expected"]),
        ("1 if dist < 1", vec!["`else`"]),
        ("", vec!["got nothing"]),
        ("est_pos_m[0]", vec!["unknown field"]),
        ("1e999", vec!["no finite number"]),
        ("lambda: 0", vec!["column"]),
        ("ä", vec!["column 1"]),
    ] {
        if words.is_empty() {
            parse_reward(text).unwrap();
            continue;
        }
        let got = error(text);
        assert!(words.iter().all(|word| got.contains(word)), "{text} gave: {got}");
    }
    let got = parse_termination("dist").unwrap_err().to_string();
    assert!(got.contains("expected a condition such as"), "{got}");
}

#[test]
fn what_is_too_large_is_refused() {
    let deep = format!("{}1{}", "(".repeat(25), ")".repeat(25));
    assert!(error(&deep).contains("brackets"));
    assert!(error(&"1+".repeat(600)).contains("1000 characters"));
    let right = format!("{}1{}", "(1+".repeat(20), ")".repeat(20));
    assert!(error(&right).contains("operations"));
    // a parser recurses for these without brackets
    for text in ["-".repeat(900) + "1", "not ".repeat(240) + "dist < 1", "1**".repeat(300) + "1"] {
        let _ = parse_reward(&text);
        let _ = parse_termination(&text);
    }
}

#[test]
fn what_is_no_number_is_never_hidden() {
    for text in [
        "log(0.1*dist - 1)",
        "min(1, log(-1))",
        "max(log(-1), 1)",
        "1 if log(-1) < 3 else 0",
        "sqrt(dist - 3)",
        "1 if dist < 3 or log(-1) < 3 else 0",
        "tanh(log(-1))",
        "exp(log(-1))",
    ] {
        assert!(value(text).is_nan(), "{text}: {}", value(text));
        let lanes: Lanes = evaluate(&parse_reward(text).unwrap());
        assert!((0..LANES).all(|lane| lanes.lane(lane).is_nan()), "{text}");
    }
    assert_eq!(value("exp(1000)"), value("exp(80)"), "rewards are finite");
}

fn expressions() -> impl Strategy<Value = String> {
    let leaf = prop_oneof![
        (0..expression_fields().count()).prop_map(|i| {
            let field = expression_fields().nth(i).unwrap();
            if field.length == 1 { field.name.to_owned() } else { format!("{}[0]", field.name) }
        }),
        (-3.0..3.0_f64).prop_map(|x| format!("{x:.3}")),
    ];
    leaf.prop_recursive(4, 24, 3, |inner| {
        prop_oneof![
            (inner.clone(), prop_oneof![Just("+"), Just("-"), Just("*")], inner.clone())
                .prop_map(|(a, op, b)| format!("(2*{a} {op} 3*{b})")),
            (prop_oneof![Just("sin"), Just("cos"), Just("abs"), Just("tanh")], inner.clone())
                .prop_map(|(f, a)| format!("{f}(0.1*{a})")),
            (inner.clone(), inner.clone(), inner)
                .prop_map(|(a, b, c)| format!("({a} if 2*{b} < 1 else {c}*2)")),
        ]
    })
}

proptest! {
    #[test]
    fn lanes_agree_with_the_reference(text in expressions()) {
        let program = parse_reward(&text);
        prop_assume!(!matches!(&program, Err(e) if e.to_string().contains("operations") || e.to_string().contains("chooses")));
        let program = program.unwrap();
        let want: f64 = evaluate(&program);
        let got: Lanes = evaluate(&program);
        for lane in 0..LANES {
            prop_assert!((got.lane(lane) - want).abs() <= 1e-3 * (1.0 + want.abs()), "{}: {} and {}", text, got.lane(lane), want);
        }
    }

    #[test]
    fn no_text_stops_the_program(text in ".{0,80}") {
        let _ = parse_reward(&text);
        let _ = parse_termination(&text);
    }

    #[test]
    fn texts_of_our_own_words_get_an_answer_with_a_column(words in prop::collection::vec(
        prop_oneof![Just("dist"), Just("pos_m[1]"), Just("("), Just(")"), Just("**"), Just("-"), Just("if"), Just("else"),
            Just("and"), Just("not"), Just("<"), Just("exp("), Just("min("), Just(","), Just("2")], 1..14))
    {
        let text = words.join(" ");
        if let Err(e) = parse_reward(&text) {
            let e = e.to_string();
            prop_assert!(e.contains("column "), "{}", e);
            prop_assert!(!e.contains("Rule"), "{}", e);
        }
    }
}
