"""Mistakes are named with what was expected, as ordinary exceptions, and nothing has moved."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import crazyflie_gym
from crazyflie_gym import EnvOptions, Pid, Sim, ansi, check_model, render
from crazyflie_gym.options import WorldOptions

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests/recorded"))

from faults import with_faults  # noqa: E402


def good(n=4):
    return np.zeros((n, 4), np.float32)


BAD_ACTIONS = [
    (None, TypeError, "expected numbers, such as a float32 array, got dtype object"),
    ("up", TypeError, "got dtype <U2"),
    (good().astype(bool), TypeError, "got dtype bool"),
    (good().astype(complex), TypeError, "got dtype complex128"),
    ([[0.0] * 4, [0.0] * 3], ValueError, "actions: .*inhomogeneous"),
    (good(3), ValueError, r"actions: expected shape \(4, 4\), got \(3, 4\)"),
    (good(3).tolist(), ValueError, r"actions: expected shape \(4, 4\), got \(3, 4\)"),
    (good().ravel(), ValueError, r"got \(16,\)"),
    (np.zeros((4, 3), np.float32), ValueError, r"got \(4, 3\)"),
    (good().astype(np.float64) + 1e39, ValueError, r"actions\[0\]\[0\] is inf"),
    (good().astype(int) + 2, ValueError, r"actions\[0\]\[0\] is 2, expected a number from -1 to 1"),
]


@pytest.mark.parametrize(("actions", "error", "words"), BAD_ACTIONS)
def test_wrong_arrays(actions, error, words):
    envs, untouched = (gym.make_vec("Crazyflie-v0", num_envs=4) for _ in range(2))
    envs.reset(seed=1)
    untouched.reset(seed=1)
    with pytest.raises(error, match=words):
        envs.step(actions)
    assert np.array_equal(envs.step(good())[0], untouched.step(good())[0])


def tensor(actions):
    return pytest.importorskip("torch").tensor(actions, requires_grad=True)


CONVERSIONS = {
    "float64": lambda a: a.astype(np.float64),
    "float16": lambda a: a.astype(np.float16),
    "big-endian": lambda a: a.astype(">f4"),
    "list": lambda a: a.tolist(),
    "rows in a list": list,
    "Fortran order": np.asfortranarray,
    "strided": lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
    "unaligned": lambda a: np.frombuffer(b"0" + a.tobytes(), np.uint8)[1:].view(np.float32).reshape(a.shape),
    "read-only": lambda a: np.broadcast_to(a, a.shape),
    "torch": tensor,
    "jax": lambda a: pytest.importorskip("jax.numpy").asarray(a),
}


@pytest.mark.parametrize("convert", CONVERSIONS.values(), ids=CONVERSIONS)
def test_actions_of_any_kind_fly_as_float32(convert):
    # numbers that a float16 holds
    actions = np.round(np.random.default_rng(1).uniform(-1, 1, (10, 3, 4)) * 64).astype(np.float32) / 64
    for make in (
        lambda: gym.make_vec("Crazyflie-v0", num_envs=3),
        lambda: crazyflie_gym.CrazyflieEnv(task="swap", drones=3),
    ):
        env, reference = make(), make()
        env.reset(seed=1)
        reference.reset(seed=1)
        for tick in actions:
            assert np.array_equal(env.step(convert(tick))[0], reference.step(tick)[0])
    env, reference = (crazyflie_gym.CrazyflieEnv() for _ in range(2))
    env.reset(seed=1)
    reference.reset(seed=1)
    for action in actions[:, 0]:
        assert np.array_equal(env.step(convert(action))[0], reference.step(action)[0])


@pytest.mark.parametrize(("value", "clip"), [(1.0000001, False), (-1.000009, False), (1.5, True), (np.inf, True)])
def test_round_off_is_cut_off_and_excess_only_when_asked(value, clip):
    for make, shape in (
        (lambda **more: crazyflie_gym.CrazyflieEnv(**more), (4,)),
        (lambda **more: gym.make_vec("Crazyflie-v0", num_envs=2, **more), (2, 4)),
        (lambda **more: crazyflie_gym.CrazyflieSwarm(2, "swap", drones=2, **more), (2, 2, 4)),
    ):
        env, reference = make(clip=clip), make()
        env.reset(seed=1)
        reference.reset(seed=1)
        actions = np.full(shape, value, np.float32)
        given = actions.copy()
        assert np.array_equal(env.step(actions)[0], reference.step(np.sign(actions))[0])
        assert np.array_equal(actions, given), "the caller's array has changed"
        with pytest.raises(ValueError, match="is NaN, expected a number from -1 to 1"):
            env.step(np.full(shape, np.nan, np.float32))


@pytest.mark.parametrize("value", [1.5, -1.0001, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_wrong_numbers(value, mode):
    envs, untouched = (gym.make_vec("Crazyflie-v0", num_envs=20, autoreset_mode=mode) for _ in range(2))
    envs.reset(seed=1)
    untouched.reset(seed=1)
    actions = good(20)
    actions[17, 1] = value
    with pytest.raises(
        ValueError, match=r"actions\[17\]\[1\] is (1\.5|-1\.0001|NaN|inf|-inf), expected a number from -1 to 1"
    ):
        envs.step(actions)
    assert np.array_equal(envs.step(good(20))[0], untouched.step(good(20))[0])


def test_a_single_environment_says_the_same():
    env = crazyflie_gym.CrazyflieEnv()
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        env.step(np.zeros(4, np.float32))
    env.reset(seed=1)
    for action, error, words in [
        (None, TypeError, "actions: expected numbers"),
        (np.zeros(3, np.float32), ValueError, r"action: expected shape \(4,\), got \(3,\)"),
        ([0, 0, 0], ValueError, r"action: expected shape \(4,\), got \(3,\)"),
        (np.full(4, np.nan, np.float32), ValueError, r"actions\[0\]\[0\] is NaN"),
    ]:
        with pytest.raises(error, match=words):
            env.step(action)
    down = np.array([0, 0, 0, -1], np.float32)
    far = crazyflie_gym.CrazyflieEnv(task_options={"start_m": [2.4, 0, 0.7]})
    far.reset(seed=0)
    with pytest.raises(RuntimeError, match=r"the episode has ended: call reset\(\) before the next step\(\)"):
        for _ in range(500):
            far.step(np.array([0, 1, 0, 0], np.float32))
    far.reset()
    far.step(down)


BAD_KWARGS = [
    ({"effects": {"drag_lineer": 0.3}}, r'unknown effect "drag_lineer" \(did you mean "drag_linear"\?\)'),
    ({"effects": {"wind": {"x_mps": 1}}}, r'did you mean "wind.x_mps2"'),
    ({"effects": {"wind": {"x_mps2": 30}}}, r"wind.x_mps2 is 30, expected -5 to 5 m/s\^2"),
    ({"effects": {"wind": {"x_mps2": {"uniform": [1, -1]}}}}, "lower bound"),
    ({"effects": {"wind": float("nan")}}, "effects: Out of range float"),
    ({"effects": {"wind": object()}}, "effects: expected numbers, strings, lists and dicts, got object"),
    ({"effects": {"wind": "strong"}}, "expected a number, a distribution"),
    ({"effects": 3}, "effects: invalid type"),
    ({"vertical": "hight"}, r'vertical: unknown vertical form "hight" \(did you mean "height"\?\)'),
    ({"physics_hz": "often"}, "physics_hz: invalid type"),
    ({"task_options": {"start_radius": 1}}, "start_radius_m"),
    ({"task_options": {"start_radius_m": -1}}, "start_radius_m is -1, expected 0 to 2"),
    ({"physics_hz": 77}, "physics_hz is 77, expected one of"),
    ({"isa": "avx9"}, "avx9"),
    ({"observation": "image"}, 'unknown observation "image"'),
    ({"render_mode": "depth"}, "render_mode is 'depth', expected None, 'rgb_array', 'human'"),
    ({"model": {"schema": 1}}, "model: "),
    ({"model": "schema = 1\nname = 'x'\n"}, "missing field"),
    ({"model": {}}, "missing field"),
]


@pytest.mark.parametrize(("kwargs", "words"), BAD_KWARGS)
@pytest.mark.parametrize("make", [crazyflie_gym.CrazyflieEnv, crazyflie_gym.CrazyflieVectorEnv])
def test_wrong_arguments(make, kwargs, words):
    with pytest.raises(ValueError, match=words):
        make(**kwargs)


@pytest.mark.parametrize(
    ("make", "wrong", "near"),
    [
        (crazyflie_gym.CrazyflieEnv, "efects", "effects"),
        (crazyflie_gym.CrazyflieEnv, "renderer_mode", "render_mode"),
        (crazyflie_gym.CrazyflieVectorEnv, "autoreset", "autoreset_mode"),
        (crazyflie_gym.CrazyflieSwarm, "drone", "drones"),
        (lambda **more: gym.make("Crazyflie-v0", **more), "task_option", "task_options"),
        (lambda **more: gym.make_vec("Crazyflie-v0", 2, **more), "wind_fields", "wind_field"),
    ],
)
def test_a_keyword_that_is_unknown_gets_the_nearest_name(make, wrong, near):
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{wrong}'; did you mean '{near}'\?"):
        make(**{wrong: 1})


def test_the_options_are_those_of_the_simulator():
    with pytest.raises(ValueError) as said:
        Sim(1, '{"nothing": 0}')
    native = set(re.findall(r"`(\w+)`", str(said.value))) - {"nothing"}
    options = set(EnvOptions.__annotations__)
    # here alone: the model (the vehicle) goes beside the options, actions are cut off in Python
    assert options - native == {"model", "vehicle", "clip"}
    # there alone: the task, what is the batch's, and the fields that functions want
    assert native - options == {"task", "autoreset", "max_episode_steps", "threads", "watch"}


def test_every_option_is_explained_and_in_the_signatures():
    about = {name for given in (WorldOptions, EnvOptions) for name in re.findall(r"\n {8}(\w+): ", given.__doc__)}
    assert about == set(EnvOptions.__annotations__)
    for made in (crazyflie_gym.CrazyflieEnv, crazyflie_gym.CrazyflieVectorEnv, crazyflie_gym.CrazyflieSwarm):
        assert about < set(inspect.signature(made).parameters)
    # None is as if it was not given
    nothing = dict.fromkeys(EnvOptions.__annotations__)
    assert crazyflie_gym.CrazyflieEnv(**nothing).reset(seed=1)[0].tobytes() == (
        crazyflie_gym.CrazyflieEnv().reset(seed=1)[0].tobytes()
    )


def test_wrong_arguments_of_the_batch():
    for count in (0, -1, 2**40):
        with pytest.raises(ValueError, match=f"num_envs is {count}, expected 1 to"):
            crazyflie_gym.CrazyflieVectorEnv(count)
    with pytest.raises(TypeError):
        crazyflie_gym.CrazyflieVectorEnv(2.5)
    with pytest.raises(
        ValueError, match="autoreset_mode is 'sometimes', expected one of next_step, same_step, disabled"
    ):
        crazyflie_gym.CrazyflieVectorEnv(2, autoreset_mode="sometimes")
    with pytest.raises(ValueError, match=r'unknown task "hoover" \(did you mean "hover"\?\)'):
        crazyflie_gym.CrazyflieVectorEnv(2, task="hoover")
    for threads in (-1, 1.5, "two"):
        with pytest.raises(ValueError, match="invalid"):
            crazyflie_gym.CrazyflieVectorEnv(2, threads=threads)


def test_wrong_masks():
    envs = crazyflie_gym.CrazyflieVectorEnv(3, autoreset_mode="disabled")
    with pytest.raises(RuntimeError, match="call reset"):
        envs.reset(options={"reset_mask": np.array([True, False, True])})
    envs.reset(seed=0)
    for mask, error, words in [
        ([True, False, True], TypeError, "expected a numpy array of bool, got list"),
        (np.ones(3), TypeError, "got dtype float64"),
        (np.ones(4, bool), ValueError, r"expected shape \(3,\), got \(4,\)"),
        (np.zeros(3, bool), ValueError, "at least one True"),
    ]:
        with pytest.raises(error, match=words):
            envs.reset(options={"reset_mask": mask})
    # a bool array may hold other bytes than 0 and 1
    assert envs.reset(options={"reset_mask": np.array([2, 0, 255], np.uint8).view(bool)})[0].shape == (3, 24)


def test_wrong_model_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no file .*nowhere\.toml"):
        crazyflie_gym.CrazyflieEnv(model=str(tmp_path / "nowhere.toml"))
    broken = tmp_path / "broken.toml"
    broken.write_text(crazyflie_gym.model_text().replace("123.2", "none", 1))
    with pytest.raises(ValueError, match=r"broken\.toml: .*line [0-9]+"):
        crazyflie_gym.CrazyflieEnv(model=broken)
    unit = crazyflie_gym.model_text().replace('unit = "1/s^2"', 'unit = "1/s"', 1)
    with pytest.raises(ValueError, match=r'roll\.gain has the unit "1/s", expected "1/s\^2"'):
        check_model(unit)
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="cannot read"):
        crazyflie_gym.CrazyflieEnv(model=tmp_path / "binary")
    with pytest.raises(ValueError, match=r"cannot read .*; expected a vehicle's name, a model file"):
        crazyflie_gym.CrazyflieEnv(model=tmp_path)
    (tmp_path / "note.txt").write_text("no model at all\n")
    with pytest.raises(ValueError, match=r"(?s)note\.txt: .*line 1.*; expected a vehicle's name"):
        crazyflie_gym.CrazyflieEnv(model=tmp_path / "note.txt")
    brushless = crazyflie_gym.model_text("cf21-brushless").replace('name = "cf21-brushless"', 'name = "cf21"')
    with pytest.raises(ValueError, match=r"model cf21: name is that of .*these fit cf21-brushless"):
        check_model(brushless)
    with pytest.raises(TypeError, match="got int"):
        crazyflie_gym.CrazyflieEnv(model=3)


def test_the_native_classes_check_as_well():
    sim = Sim(3)
    obs, rewards, flags = np.zeros((3, 24), np.float32), np.zeros(3, np.float32), np.zeros(3, bool)
    sim.reset(observations=obs)
    with pytest.raises(ValueError, match="truncated: "):
        sim.step_into(good(3), obs, rewards, flags, flags)
    locked = np.zeros((3, 24), np.float32)
    locked.flags.writeable = False
    with pytest.raises(ValueError, match="observations: "):
        sim.step_into(good(3), locked, rewards, flags, flags.copy())
    with pytest.raises(
        TypeError, match=r"terminated: expected a numpy array of bool with shape \(3,\), got dtype uint8"
    ):
        sim.step_into(good(3), obs, rewards, flags.view(np.uint8), flags.copy())
    with pytest.raises(TypeError, match="seeds: expected a numpy array of uint64"):
        sim.reset(seeds=np.arange(3))
    assert sim.last_of_episode(0) is None and sim.last_of_episode(10**9) is None
    with pytest.raises(OverflowError):
        sim.last_of_episode(-1)
    with pytest.raises(ValueError, match="line 1 column 1"):
        Sim(3, "{")
    with pytest.raises(ValueError, match=r'unknown controller "thesys" \(did you mean "thesis"\?\)'):
        Pid(3, sim, gains="thesys")
    with pytest.raises(ValueError, match="unknown controller mode"):
        Pid(3, sim, mode="fly")
    with pytest.raises(TypeError, match="of: expected a Sim or an Interface, got str"):
        Pid(3, "sim")
    with pytest.raises(ValueError, match=r"observations: expected shape \(3, 24\), got \(2, 24\)"):
        Pid(3, sim).act(obs[:2])


def test_pictures_check_as_well():
    with pytest.raises(ValueError, match="width is 0, expected 1 to 8192"):
        render(0, 100)
    with pytest.raises(ValueError, match="trail: expected shape"):
        render(64, 48, trail=np.zeros((5, 2), np.float32))
    with pytest.raises(ValueError, match="position"):
        render(64, 48, drones=np.full((1, 6), np.nan, np.float32))
    with pytest.raises(ValueError, match="columns"):
        ansi(render(64, 48), -1)
    with pytest.raises(TypeError, match="picture"):
        ansi(np.zeros((4, 4, 3)), 4)


NUMBER = st.one_of(st.floats(-10, 10), st.integers(-5, 500), st.none(), st.booleans(), st.text(max_size=3))
DRAWN = st.dictionaries(
    st.sampled_from(["uniform", "normal", "log_uniform", "choice", "value"]), st.lists(NUMBER, max_size=3), max_size=2
)
PARAMS = sorted({p["name"] for e in crazyflie_gym.effects() for p in e["params"]})
EFFECT = st.one_of(NUMBER, st.dictionaries(st.sampled_from(PARAMS), st.one_of(NUMBER, DRAWN), max_size=3))
NAMES = [e["name"] for e in crazyflie_gym.effects()]
OPTIONS = st.fixed_dictionaries(
    {},
    optional={
        "task": st.sampled_from([t["name"] for t in crazyflie_gym.tasks()]),
        "task_options": st.dictionaries(
            st.sampled_from(["height_m", "size_m", "shape", "start_m", "period_s", "rise_m"]), NUMBER
        ),
        "effects": st.dictionaries(st.sampled_from(NAMES), EFFECT, max_size=4),
        "vertical": st.sampled_from(["height", "pwm", "thrust", "motors"]),
        "physics_hz": st.sampled_from([50, 100, 150, 300, 0, 77, -1]),
        "autoreset": st.sampled_from(["next_step", "same_step", "disabled", "never"]),
        "max_episode_steps": st.integers(0, 5),
        "threads": st.integers(0, 3),
        "drones": st.integers(0, 4),
        "radius_m": NUMBER,
        "neighbours": st.sampled_from([{"by": "ideal"}, {"by": "range", "range_m": 1}, {"by": "smell"}]),
    },
)


@settings(max_examples=400, deadline=None)
@given(OPTIONS, st.integers(1, 18), st.randoms(use_true_random=False))
def test_any_options_fly_or_are_refused(options, num_envs, random):
    try:
        sim = Sim(num_envs, json.dumps(options))
    except ValueError as error:
        assert str(error)
        return
    seeds = np.array([random.getrandbits(64) for _ in range(num_envs)], np.uint64)
    obs = sim.reset(seeds)
    assert np.isfinite(obs).all()
    for _ in range(12):
        try:
            shape = (*obs.shape[:-1], 4)
            obs, rewards, _, _, _ = sim.step(np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32))
        except RuntimeError as error:
            assert "has ended" in str(error)
            break
        assert np.isfinite(obs).all() and np.isfinite(rewards).all()


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=40))
def test_any_text_is_refused_as_options_and_as_model(text):
    for refuse in (lambda: Sim(1, text), lambda: check_model(text), lambda: Sim(1, "{}", [text])):
        with pytest.raises(ValueError, match=r"."):
            refuse()


def test_an_option_that_a_reset_does_not_have_is_refused():
    for env in (
        gym.make("Crazyflie-v0"),
        gym.make_vec("Crazyflie-v0", num_envs=2),
        crazyflie_gym.CrazyflieSwarm(2, "swap"),
    ):
        env.reset(seed=1, options={})
        with pytest.raises(ValueError, match=r"options\['start_m'\]: a reset has .*; starts are options of the task"):
            env.reset(options={"start_m": [0, 0, 1]})


def test_commands_stamped_late_stop_the_explanation_of_short_flights(tmp_path):
    """Their few stretches cannot tell chance; half a minute of flight in all."""
    data, out = ROOT / "tests/data/nanobench", tmp_path / "found"
    names = ["B3_figure8_fast_rep1", "B8_star_fast_rep1", "B8_star_medium_rep1", "B3_figure8_slow_rep1"]
    *fit, test = with_faults([data / f"{name}.csv.gz" for name in names], tmp_path, early_s=-0.08)
    command = [sys.executable, "-m", "crazyflie_gym", "explain", "cf21", "--fit", *fit, "--test", test, "--out", out]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "obeyed its commands about 80 ms before" in done.stderr, done
    assert not out.exists()
