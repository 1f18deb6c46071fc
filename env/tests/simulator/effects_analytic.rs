//! Effects against solutions on paper: step responses, steady states, swings; and the same at any control
//! rate.

use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::effects::{Entry, Hooks, Observability, Param, Role, find, registry};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::plant::{Command, State};
use crazyflie_env::world::{Settings, Tick, World};

const HOVER_PWM: f64 = 39_342.5;
const TICK_S: f64 = 0.02;
const G: f64 = 9.81;

fn table(json: &str) -> EffectTable {
    Options::parse(&format!("{{\"effects\": {json}}}")).unwrap().effects
}

fn world_of(model: &Model, effects: &str, physics_hz: Option<u32>) -> World<f64> {
    let settings = Settings { input: VerticalInput::Thrust, physics_hz };
    World::<f64>::new(model, &table(effects), settings, 1).unwrap().without_floor()
}

/// A vehicle at rest one metre up with a level command in force, flown by `command` of the tick; the states
/// at the ends of the ticks.
fn fly(
    world: &mut World<f64>,
    ticks: usize,
    mut command: impl FnMut(usize) -> Command<f64>,
) -> Vec<State<f64>> {
    world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], ..State::rest() }, &level());
    let state_after = |tick: usize| {
        world.step(0, &command(tick));
        *world.state(0)
    };
    (0..ticks).map(state_after).collect()
}

fn flight(effects: &str, ticks: usize, command: impl FnMut(usize) -> Command<f64>) -> Vec<State<f64>> {
    fly(&mut world_of(&Model::thesis(), effects, None), ticks, command)
}

fn level() -> Command<f64> {
    Command::level(HOVER_PWM)
}

fn pitched(deg: f64) -> Command<f64> {
    Command { pitch_rad: deg.to_radians(), ..level() }
}

/// Angle in rest over command, of pitch.
fn static_gain() -> f64 {
    let pitch = Model::thesis().pitch;
    pitch.gain.value / pitch.stiffness.value
}

#[test]
fn a_heavier_model_file_flies_as_the_lighter_one_with_a_payload() {
    let mut thesis = Model::thesis();
    (thesis.vertical.height, thesis.vertical.pwm) = (None, None);
    let text = thesis.to_toml().unwrap();
    let (head, vehicle) = text.split_once("[vehicle.mass]").unwrap();
    let heavier =
        Model::parse(&format!("{head}[vehicle.mass]{}", vehicle.replacen("0.0368", "0.046", 1))).unwrap();
    assert_eq!((heavier.vehicle.mass.value, thesis.vehicle.mass.value), (0.046, 0.0368));
    let climbing =
        |tick: usize| Command { pitch_rad: 0.05, ..Command::level(42_000.0 + 100.0 * tick as f64) };
    let loaded = fly(&mut world_of(&thesis, r#"{"mass_change": 0.0092}"#, None), 100, climbing);
    let plain = fly(&mut world_of(&thesis, "{}", None), 100, climbing);
    let heavy = fly(&mut world_of(&heavier, "{}", None), 100, climbing);
    let apart = |a: &[State<f64>], b: &[State<f64>]| {
        a.iter().zip(b).map(|(a, b)| (a.pos_m[2] - b.pos_m[2]).abs()).fold(0.0, f64::max)
    };
    // the effect's push is held over a physics step, the model's own forces are stepped exactly
    assert!(apart(&loaded, &heavy) < 2e-3 && apart(&plain, &heavy) > 1.0, "{}", apart(&loaded, &heavy));
}

#[test]
fn a_yaw_rate_loop_answers_a_step_with_its_gain_and_lag() {
    let turning = |_| Command { yaw_rate_radps: 0.5, ..level() };
    let (plain, slow) = (
        flight("{}", 100, turning),
        flight(r#"{"yaw_rate_loop": {"gain": 0.98, "lag_s": 0.12}}"#, 100, turning),
    );
    for (tick, (plain, slow)) in plain.iter().zip(&slow).enumerate() {
        let t = (tick + 1) as f64 * TICK_S;
        // the integral of 1 - exp(-t / lag), where the plain vehicle turns by t
        let expected = plain.att_rad[2] / t * 0.98 * (t - 0.12 * (1.0 - (-t / 0.12).exp()));
        assert!(
            (slow.att_rad[2] - expected).abs() < 1e-9,
            "{t} s: {} instead of {expected}",
            slow.att_rad[2]
        );
    }
}

#[test]
fn play_stays_until_it_is_crossed_and_lags_half_its_width() {
    // up to 5 degrees, back by less than the play, back by more
    let commands = [5.0, 4.2, 3.5, 2.0, -3.0];
    let obeyed = [4.0, 4.0, 4.0, 3.0, -2.0];
    let states = flight(r#"{"backlash": 2.0}"#, 1500, |tick| pitched(commands[tick / 300]));
    for (i, obeyed) in obeyed.iter().enumerate() {
        let settled = states[300 * i + 299].att_rad[1].to_degrees();
        assert!((settled - static_gain() * obeyed).abs() < 1e-5, "{} deg: {settled}", commands[i]);
    }
}

#[test]
fn a_rate_limit_makes_a_ramp_of_a_step() {
    let (plain, limited) =
        (flight("{}", 400, |_| pitched(10.0)), flight(r#"{"cmd_rate_limit": 47.0}"#, 400, |_| pitched(10.0)));
    // in the long run only the area between step and ramp counts, and a linear plant multiplies it by its
    // static gain
    let area: f64 =
        plain.iter().zip(&limited).map(|(p, l)| (p.att_rad[1] - l.att_rad[1]).to_degrees() * TICK_S).sum();
    let expected = static_gain() * 10.0 * 10.0 / (2.0 * 47.0);
    assert!((area - expected).abs() < 1e-6, "{area} instead of {expected}");
    let down = flight(r#"{"cmd_rate_limit": 47.0}"#, 400, |_| pitched(-10.0));
    assert!(down.iter().zip(&limited).all(|(d, l)| (d.att_rad[1] + l.att_rad[1]).abs() < 1e-12));
}

#[test]
fn a_saturated_vehicle_climbs_by_what_its_motors_have() {
    let full = |_| Command::level(1.6 * HOVER_PWM);
    let climb = |effects: &str| flight(effects, 1, full)[0].vel_mps[2] / TICK_S;
    let (asked, got) = (climb("{}"), climb(r#"{"motor_saturation": 1.4}"#));
    assert!((got / asked - 0.4 / 0.6).abs() < 2e-3, "{got} of {asked}");
    assert!((climb(r#"{"motor_saturation": 1.7}"#) - asked).abs() < 1e-12);
}

#[test]
fn two_saturated_motors_take_half_of_the_torque_and_their_thrust() {
    let mut model = Model::thesis();
    // a tick is one physics step, so that the torque is that of the start
    (model.rig.control.value, model.rig.imu.value) = (300.0, 300.0);
    let step = |effects: &str| {
        let command = Command { roll_rad: 0.2, ..Command::level(1.5 * HOVER_PWM) };
        fly(&mut world_of(&model, effects, None), 1, |_| command)[0]
    };
    let (plain, limited) = (step("{}"), step(r#"{"motor_saturation": 1.5}"#));
    let halved = limited.rate_radps[0] / plain.rate_radps[0];
    assert!((halved - 0.5).abs() < 2e-3, "{halved}");
    // half the torque J a is lost; divided by the lever, this is the lost thrust
    let side_m = model.vehicle.arm.value * std::f64::consts::FRAC_1_SQRT_2;
    let lost = 0.5 * 1.657e-5 * model.roll.gain.value * 0.2 / (side_m * model.vehicle.mass.value);
    let got = (plain.vel_mps[2] - limited.vel_mps[2]) * 300.0;
    assert!((got / lost - 1.0).abs() < 0.01, "{got} instead of {lost}");
    assert!(limited.att_rad[1].abs() < 1e-12);
}

#[test]
fn a_motor_saturates_just_where_the_mixer_asks_too_much_or_too_little_of_it() {
    let mut model = Model::thesis();
    (model.rig.control.value, model.rig.imu.value) = (300.0, 300.0);
    let (gravity, ratio) = (model.lateral.gravity.value, 1.9);
    let side_m = model.vehicle.arm.value * std::f64::consts::FRAC_1_SQRT_2;
    let per_tilt = 0.25 * 1.657e-5 / (side_m * model.vehicle.mass.value);
    let gains = [model.roll.gain.value, model.pitch.gain.value];
    let mut counts = [0, 0];
    for lift in [0.1, 0.4, 1.0, 1.5, 1.85] {
        for (roll_rad, pitch_rad) in
            [-0.8, -0.3, 0.0, 0.5].into_iter().flat_map(|roll| [-0.6, 0.0, 0.4].map(|pitch| (roll, pitch)))
        {
            let command = Command { roll_rad, pitch_rad, ..Command::level(lift * HOVER_PWM) };
            let step = |effects: &str| fly(&mut world_of(&model, effects, None), 1, |_| command)[0];
            let asked_mps2 = [(1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(front, left)| {
                0.25 * gravity * lift + per_tilt * (left * gains[0] * roll_rad - front * gains[1] * pitch_rad)
            });
            let is_within = asked_mps2.iter().all(|asked| (0.0..=0.25 * gravity * ratio).contains(asked));
            let (plain, limited) = (step("{}"), step(&format!(r#"{{"motor_saturation": {ratio}}}"#)));
            let is_same = plain.rate_radps == limited.rate_radps && plain.vel_mps == limited.vel_mps;
            assert_eq!(is_same, is_within, "{lift} {roll_rad} {pitch_rad}: {asked_mps2:?}");
            counts[usize::from(is_within)] += 1;
        }
    }
    assert!(counts.iter().all(|count| *count > 10), "{counts:?}");
}

/// Two bodies and a thread: their common centre goes on, and they swing about it.
#[test]
fn a_slung_load_swings_as_a_pendulum_on_a_free_vehicle() {
    let (ratio, length_m, v0) = (0.2, 0.63, 0.3);
    let effects = format!(
        "{{\"slung_load\": {{\"mass_ratio\": {ratio}, \"length_m\": {length_m}, \"damping_ps\": 0}}}}"
    );
    let mut world = world_of(&Model::thesis(), &effects, None);
    let command = Command::level((1.0 + ratio) * HOVER_PWM);
    world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], ..State::rest() }, &command);
    // a shove on the vehicle alone
    world.set_state(&State { pos_m: [0.0, 0.0, 1.0], vel_mps: [v0, 0.0, 0.0], ..State::rest() }, [0.0; 3]);
    let w = (G * (1.0 + ratio) / length_m).sqrt();
    for tick in 1..=200 {
        world.step(0, &command);
        let expected = v0 / (1.0 + ratio) * (1.0 + ratio * (w * tick as f64 * TICK_S).cos());
        let got = world.state(0).vel_mps[0];
        assert!((got - expected).abs() < 0.01 * v0, "tick {tick}: {got} instead of {expected}");
    }
    let x = world.state(0);
    assert!(x.vel_mps[2].abs() < 1e-9, "the thrust carries both: {:?}", x.vel_mps);
}

/// At a constant lean for long, both move as one body: as the vehicle alone would.
#[test]
fn a_dragged_load_hangs_back_and_costs_nothing_in_the_long_run() {
    let lean = |tick: usize| if tick < 1000 { pitched(1.0) } else { level() };
    let with = flight(
        r#"{"slung_load": {"mass_ratio": 0.15, "length_m": 0.3, "damping_ps": 1, "declared": 1}}"#,
        2000,
        lean,
    );
    let alone = flight("{}", 2000, lean);
    let (got, expected) = (with[1999].vel_mps[0], alone[1999].vel_mps[0]);
    assert!((got / expected - 1.0).abs() < 0.01 && expected > 1.0, "{got} instead of {expected}");
    let shaken =
        with.iter().zip(&alone).map(|(a, b)| (a.vel_mps[0] - b.vel_mps[0]).abs()).fold(0.0, f64::max);
    assert!(shaken > 0.002, "{shaken}");
}

/// A load that was weighed with the vehicle lowers nothing, and its swing dies away.
#[test]
fn a_declared_load_only_swings() {
    let effects = r#"{"slung_load": {"mass_ratio": 0.1, "length_m": 0.4, "damping_ps": 0.5, "declared": 1}}"#;
    let mut world = world_of(&Model::thesis(), effects, None);
    world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], ..State::rest() }, &level());
    world.set_state(&State { pos_m: [0.0, 0.0, 1.0], vel_mps: [0.3, 0.0, 0.0], ..State::rest() }, [0.0; 3]);
    let speeds: Vec<f64> = (0..1500)
        .map(|_| {
            world.step(0, &level());
            world.state(0).vel_mps[0]
        })
        .collect();
    let swing = |of: &[f64]| {
        of.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - of.iter().copied().fold(f64::INFINITY, f64::min)
    };
    assert!(
        swing(&speeds[..100]) > 0.04 && swing(&speeds[1300..]) < 0.005,
        "{} {}",
        swing(&speeds[..100]),
        swing(&speeds[1300..])
    );
    assert!(world.state(0).vel_mps[2].abs() < 1e-9);
}

#[test]
fn a_step_of_thrust_or_wind_begins_at_its_time() {
    let heave_ps = Model::thesis().parameter("vertical.thrust.heave").unwrap();
    let states = flight(r#"{"thrust_step": {"scale": 0.9, "t_s": 1.0}}"#, 150, |_| level());
    assert!(states[..44].iter().all(|x| x.vel_mps[2].abs() < 1e-12), "nothing before the ramp begins");
    let fall = -0.1 * G / heave_ps * (1.0 - (-heave_ps * 2.0_f64).exp());
    let got = states[149].vel_mps[2];
    assert!((got / fall - 1.0).abs() < 3e-3, "{got} instead of {fall}");
    let states = flight(r#"{"wind_step": {"x_mps2": 0.4, "y_mps2": -0.2, "t_s": 1.5}}"#, 150, |_| level());
    let [x, y, _] = states[149].vel_mps;
    assert!((x - 0.6).abs() < 1e-9 && (y + 0.3).abs() < 1e-9, "{x} {y}");
}

#[test]
fn warm_motors_let_a_vehicle_sink_as_the_equation_says() {
    let heave_ps = Model::thesis().parameter("vertical.thrust.heave").unwrap();
    let (share, time_s, end_s) = (0.05, 8.0, 12.0_f64);
    let states = flight(r#"{"motor_warming": {"share": 0.05, "time_s": 8.0}}"#, 600, |_| level());
    // v' = -heave v - g share (1 - exp(-t / time))
    let damped = (-heave_ps * end_s).exp();
    let lag = ((-end_s / time_s).exp() - damped) / (heave_ps - 1.0 / time_s);
    let sink = -share * G * ((1.0 - damped) / heave_ps - lag);
    let got = states[599].vel_mps[2];
    assert!((got / sink - 1.0).abs() < 1e-4, "{got} instead of {sink}");
}

#[test]
fn a_periodic_force_gives_a_swing_of_speed() {
    let effects = r#"{"periodic_force": {"frequency_hz": 0.8, "x_sine_mps2": 0.5, "y_cosine_mps2": 0.3}}"#;
    let w = 0.8 * std::f64::consts::TAU;
    for (tick, state) in flight(effects, 200, |_| level()).iter().enumerate() {
        let angle = w * (tick + 1) as f64 * TICK_S;
        let expected = [0.5 / w * (1.0 - angle.cos()), 0.3 / w * angle.sin()];
        for (got, expected) in state.vel_mps.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-4, "tick {tick}: {got} instead of {expected}");
        }
    }
}

#[test]
fn torques_that_share_the_loss_are_those_of_a_weaker_attitude_loop() {
    let mut weaker = Model::thesis();
    for path in
        ["gain", "damping", "stiffness"].iter().flat_map(|n| [format!("roll.{n}"), format!("pitch.{n}")])
    {
        weaker = weaker.with_parameter(&path, 0.8 * weaker.parameter(&path).unwrap()).unwrap();
    }
    let commands = |tick: usize| Command { roll_rad: -0.05, ..pitched(if tick < 25 { 8.0 } else { -8.0 }) };
    let truth = fly(&mut world_of(&weaker, r#"{"thrust_scale": 0.8}"#, None), 100, commands);
    for hz in [50, 300] {
        let shared = r#"{"thrust_scale": {"scale": 0.8, "torque_share": 1}}"#;
        let got = fly(&mut world_of(&Model::thesis(), shared, Some(hz)), 100, commands);
        let off = |of: &[State<f64>]| {
            let by = of
                .iter()
                .zip(&truth)
                .flat_map(|(a, b)| (0..3).map(move |i| (a.att_rad[i] - b.att_rad[i]).abs()));
            by.fold(0.0, f64::max)
        };
        let alone =
            off(&fly(&mut world_of(&Model::thesis(), r#"{"thrust_scale": 0.8}"#, Some(hz)), 100, commands));
        let (with, most) = (off(&got), if hz == 50 { 0.15 } else { 0.02 });
        assert!(with < most * alone, "{hz} Hz: {with} rad off, {alone} without the torques");
        assert!((got[99].vel_mps[2] - truth[99].vel_mps[2]).abs() < 1e-9);
    }
}

#[test]
fn a_weak_motor_turns_by_its_lever() {
    let turn = |yaw_m: f64| {
        let effects = format!("{{\"weak_motor\": {{\"motor\": 2, \"loss\": 0.1, \"yaw_m\": {yaw_m}}}}}");
        flight(&effects, 5, |_| level())[4]
    };
    let (plain, twice) = (turn(5.96e-3), turn(2.0 * 5.96e-3));
    // the yaw that it loses asks more of the motor itself: a hundredth
    assert!((twice.att_rad[2] / plain.att_rad[2] - 2.0).abs() < 0.05 && plain.att_rad[2].abs() > 1e-6);
    for axis in 0..2 {
        assert!((twice.att_rad[axis] / plain.att_rad[axis] - 1.0).abs() < 0.02, "{axis}");
    }
}

#[test]
fn a_loop_may_leave_a_part_of_a_weak_motors_tilting_torque() {
    let begin = |tilt_share: f64| {
        let weak = format!("{{\"motor\": 2, \"loss\": 0.01, \"tilt_share\": {tilt_share}}}");
        flight(&format!("{{\"weak_motor\": {weak}}}"), 2, |_| level())[1]
    };
    let (whole, part) = (begin(1.0), begin(0.25));
    for axis in 0..2 {
        let share = part.att_rad[axis] / whole.att_rad[axis];
        assert!((share - 0.25).abs() < 0.01 && whole.att_rad[axis].abs() > 1e-5, "{axis}: {share}");
    }
    // thrust and turn are lost whole
    assert!((part.vel_mps[2] / whole.vel_mps[2] - 1.0).abs() < 0.01 && whole.vel_mps[2] < 0.0);
    assert!((part.att_rad[2] / whole.att_rad[2] - 1.0).abs() < 0.01);
}

#[test]
fn a_ground_effect_counts_from_where_the_vehicle_rests() {
    let climb = |effects: &str, z: f64| {
        let mut world = world_of(&Model::thesis(), effects, None);
        world.start(0, true, &State { pos_m: [0.0, 0.0, z], ..State::rest() }, &level());
        world.step(0, &level());
        world.state(0).vel_mps[2]
    };
    let near = climb(r#"{"ground_effect_exp": 0.12}"#, 0.05);
    let raised = climb(r#"{"ground_effect_exp": {"amount": 0.12, "rest_m": 0.02}}"#, 0.07);
    assert!((near / raised - 1.0).abs() < 1e-9 && near > 0.0, "{near} {raised}");
}

fn fitting(names: &[&str], model: &Model) -> World<f64> {
    let entries: Vec<&'static Entry> = names.iter().map(|name| find(name).unwrap().1).collect();
    World::<f64>::for_fitting(model, &entries, Settings { input: VerticalInput::Thrust, physics_hz: None })
        .unwrap()
}

#[test]
fn a_lens_bends_by_the_square_of_the_angle() {
    let mut world = fitting(&["lens_distortion"], &Model::thesis());
    world.set_params("lens_distortion", &[-0.1]).unwrap();
    let level = world.film(&State { pos_m: [0.3, -0.4, 1.25], ..State::rest() }, 0.0);
    let scale = 1.0 - 0.1 * 0.25 / (1.25 * 1.25);
    assert!(
        (level.pos_m[0] - 0.3 * scale).abs() < 1e-12 && (level.pos_m[1] + 0.4 * scale).abs() < 1e-12,
        "{:?}",
        level.pos_m
    );
    // a vehicle that leans so that it looks at the marker sees it straight
    let aimed = State { pos_m: [0.125, -0.25, 1.25], att_rad: [0.2, 0.1, 0.0], ..State::rest() };
    let frame = world.film(&aimed, 0.0);
    assert!(
        (frame.pos_m[0] - 0.125).abs() < 1e-12 && (frame.pos_m[1] + 0.25).abs() < 1e-12,
        "{:?}",
        frame.pos_m
    );
}

/// However fast the control ticks, a command that does not change is obeyed as it is.
#[test]
fn a_constant_command_means_the_same_at_any_control_rate() {
    let command = Command { roll_rad: -0.04, pitch_rad: 0.1, yaw_rate_radps: 0.3, lift: HOVER_PWM };
    let settled = |hz: f64, entry: &'static Entry, values: &[f64]| {
        let mut model = Model::thesis();
        (model.rig.control.value, model.rig.imu.value) = (hz, hz);
        let mut world = fitting(&[entry.name], &model);
        world.set_params(entry.name, values).unwrap();
        world.start(0, true, &State::rest(), &Command { lift: HOVER_PWM, ..Command::level(0.0) });
        for _ in 0..(3.0 * hz) as usize {
            world.step(0, &command);
        }
        let x = world.state(0);
        [x.att_rad[0], x.att_rad[1], x.rate_radps[2]]
    };
    for entry in registry()
        .iter()
        .filter(|e| e.hooks == Hooks::COMMAND && e.observability == Observability::Deterministic)
    {
        for share in [0.3, 0.72, 1.0] {
            let value = |p: &Param| {
                if p.role == Role::Choice { p.off } else { p.off + share * (p.farthest_bound() - p.off) }
            };
            let values: Vec<f64> = entry.params.iter().map(value).collect();
            let usual = settled(50.0, entry, &values);
            for hz in [60.0, 100.0, 200.0, 500.0] {
                let got = settled(hz, entry, &values);
                for (got, usual) in got.iter().zip(usual) {
                    assert!(
                        (got - usual).abs() < 1e-4,
                        "{} {values:?} at {hz} Hz: {got} instead of {usual}",
                        entry.name
                    );
                }
            }
        }
    }
}

/// A vehicle at rest is seen at its place, however late the camera is.
#[test]
fn a_late_camera_shows_what_stands_still_at_any_rate() {
    for hz in [30.0, 60.0, 100.0, 200.0, 500.0] {
        for latency_s in [0.02, 0.07, 0.12] {
            let mut model = Model::thesis();
            let control = f64::max(hz, 50.0);
            (model.rig.control.value, model.rig.imu.value, model.rig.camera.value) = (control, control, hz);
            let mut world = world_of(&model, &format!("{{\"camera_latency\": {latency_s}}}"), None);
            let states = State { pos_m: [0.1, -0.2, 0.5], ..State::rest() };
            world.start(0, true, &states, &level());
            let mut tick = Tick::none();
            for k in 1..=(0.5 * control) as usize {
                tick = world.step(0, &level());
                let (m, now_s) = (&tick.reading.marker, k as f64 / control);
                let age_s = now_s - m.t_s;
                assert!(m.valid == 1.0 && (m.pos_m[0] - 0.1).abs() < 1e-12, "{hz} Hz, {latency_s} s: {m:?}");
                let late = latency_s - 1e-3..latency_s + 1.0 / hz + 1e-3;
                assert!(
                    now_s < latency_s + 2.0 / hz || late.contains(&age_s),
                    "{hz} Hz, {latency_s} s: {age_s} s old"
                );
            }
            assert!(tick.reading.marker.t_s > 0.2);
        }
    }
}

/// A vehicle whose IMU is not level flies like one whose commanded lean is smaller by the error, and reports the
/// error more: in the exact geometry too, where a vehicle that turns trades roll for pitch by its true tilt.
#[test]
fn a_tilted_imu_shifts_commands_and_readings_and_nothing_else() {
    let model = Model::thesis();
    let error_rad = [3.0_f64.to_radians(), -2.0_f64.to_radians()];
    let started = |effects: &str| {
        let mut world = world_of(&model, effects, None);
        world.start(0, true, &State { pos_m: [0.0, 0.0, 1.0], ..State::rest() }, &level());
        world
    };
    let mut tilted = started(r#"{"rigid_body": 1, "imu_tilt": {"roll_deg": 3, "pitch_deg": -2}}"#);
    let mut untilted = started(r#"{"rigid_body": 1}"#);
    let shift = |error: f64, stiffness: f64, gain: f64| error * stiffness / gain;
    let shifts_rad = [
        shift(error_rad[0], model.roll.stiffness.value, model.roll.gain.value),
        shift(error_rad[1], model.pitch.stiffness.value, model.pitch.gain.value),
    ];
    for tick in 0..250 {
        let t = 0.02 * f64::from(tick);
        let told = Command {
            roll_rad: 0.08 * (2.0 * t).sin(),
            pitch_rad: 0.06 * (1.3 * t).cos(),
            yaw_rate_radps: 0.8,
            ..level()
        };
        let shifted = Command {
            roll_rad: told.roll_rad - shifts_rad[0],
            pitch_rad: told.pitch_rad - shifts_rad[1],
            ..told
        };
        let [reported, true_att] =
            [tilted.step(0, &told), untilted.step(0, &shifted)].map(|tick| tick.reading.att_rad);
        let [x, same] = [tilted.state(0), untilted.state(0)];
        for axis in 0..3 {
            assert!((x.pos_m[axis] - same.pos_m[axis]).abs() < 1e-10, "{tick}: {x:?} {same:?}");
            assert!((x.att_rad[axis] - same.att_rad[axis]).abs() < 1e-10, "{tick}: {x:?} {same:?}");
            let error = error_rad.get(axis).copied().unwrap_or(0.0);
            assert!((reported[axis] - true_att[axis] - error).abs() < 1e-10, "{tick}: {reported:?}");
        }
    }
}

#[test]
fn a_loop_of_higher_order_answers_later_and_then_faster() {
    let thesis = Model::thesis();
    let (delay_s, damping_ps) = (0.01, thesis.pitch.damping.value);
    // half a second of pitch each way
    let doublet = |tick: usize| pitched(if tick < 25 { 4.0 } else { -4.0 });
    let pitch_rad = |effects: &str| -> Vec<f64> {
        let mut world = world_of(&thesis, effects, Some(300));
        fly(&mut world, 50, doublet).iter().map(|x| x.att_rad[1]).collect()
    };
    let ordered = pitch_rad(&format!("{{\"attitude_order\": {delay_s}}}"));
    let inertia = 1.0 - damping_ps * delay_s;
    let spelt_out = pitch_rad(&format!("{{\"cmd_delay\": {delay_s}, \"inertia_scale\": {inertia}}}"));
    for (ordered, spelt_out) in ordered.iter().zip(&spelt_out) {
        assert!((ordered - spelt_out).abs() < 1e-9, "{ordered} instead of {spelt_out}");
    }
    let declared = pitch_rad("{}");
    assert!(ordered[0] < 0.8 * declared[0], "{} after a tick, {} without", ordered[0], declared[0]);
    // behind a late command it is as late again
    let behind = pitch_rad(&format!("{{\"cmd_delay\": 0.02, \"attitude_order\": {delay_s}}}"));
    for (tick, ordered) in ordered.iter().enumerate().take(49) {
        assert!(
            (behind[tick + 1] - ordered).abs() < 1e-9,
            "tick {tick}: {} instead of {ordered}",
            behind[tick + 1]
        );
    }
}
