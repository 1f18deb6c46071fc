"""Recorded environments against the simulator itself, their gradients, and what they say of mistakes."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
from common import FIVE
from crazyflie_gym._native import double_flight
from crazyflie_gym.make_backend import episode_steps

jax = pytest.importorskip("jax", exc_type=ImportError)
jnp = jax.numpy
jaxenv = pytest.importorskip("crazyflie_gym.jax")

ROOT = Path(__file__).parents[2]
THESIS = crazyflie_gym.model_text()
EFFECTS = {effect["name"]: effect for effect in crazyflie_gym.effects()}
TASKS = {task["name"]: task for task in crazyflie_gym.tasks()}
# most of the time of these tests goes to compiling
QUICK = {"xla_backend_optimization_level": 0}
COUNTS = {"columns", "rows"}
SEED = 5


@pytest.fixture(autouse=True)
def double_precision():
    """The other tests of the process go on as they were."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def lively(effect):
    """Parameters that are felt, and moderate."""

    def value(p):
        far = p["high"] if p["high"] > p["off"] else p["low"]
        return 2.0 if p["name"] in COUNTS else p["off"] + 0.2 * (far - p["off"])

    return {p["name"]: value(p) for p in effect["params"]}


def actions(ticks, drones=1):
    """Lively actions of shape (ticks, 4), or (ticks, drones, 4)."""
    t = 0.02 * np.arange(ticks)[:, None] + 0.3 * np.arange(drones)
    rows = np.stack([0.5 * np.sin(3.1 * t), 0.6 * np.sin(2.3 * t), 0.2 * np.sin(0.9 * t), 0.311 + 0.03 * np.sin(t)], -1)
    return rows[:, 0] if drones == 1 else rows


def first_start(env):
    """The words and numbers of the first start of an environment."""
    keys, numbers = env.drawn[0]
    words = np.array([[key & 0xFFFFFFFF, key >> 32] for key in keys], np.uint32)
    return words, numbers


def fly(env, rows, params=None):
    """Observations from the first moment on, rewards, terminated and true states of a flight without resets."""
    words, numbers = first_start(env)

    def tick(state, action):
        observation, state, reward, _, info = env.step_env(None, state, action, params)
        return state, (observation, reward, info["terminated"], env.true_state(state))

    # one program: to compile the first moment operation by operation takes longer than all the rest
    @functools.partial(jax.jit, compiler_options=QUICK)
    def flight(rows):
        first, state = env.begin(words, numbers, params)
        return first, jax.lax.scan(tick, state, rows)[1]

    observation, (observations, rewards, terminated, true) = flight(jnp.asarray(rows, env.dtype))
    states = np.concatenate([true[name] for name in ("pos_m", "vel_mps", "att_rad", "rate_radps")], -1)
    return np.concatenate([observation[None], observations]), np.asarray(rewards), np.asarray(terminated), states


def core(rows, **options):
    """The same flight by the simulator in double precision."""
    name = options.pop("id", "hover")
    text = json.dumps({"task": name, "max_episode_steps": episode_steps(name, None), **options})
    drones = rows.shape[1] if rows.ndim == 3 else 1
    observations, rewards, terminated, _, states = double_flight(text, [THESIS], SEED, rows)
    lead = (len(rows), drones) if drones > 1 else (len(rows),)
    return (
        observations.reshape(len(rows) + 1, *lead[1:], -1),
        rewards.reshape(lead),
        terminated.reshape(lead),
        states.reshape(*lead, -1),
    )


def compare(ours, theirs, tolerance):
    for what, a, b in zip(("observations", "rewards", "terminated", "states"), ours, theirs, strict=True):
        assert a.shape == b.shape, what
        worst = np.max(np.abs(np.asarray(a, float) - b) / (1.0 + np.abs(b)))
        assert worst <= tolerance, f"{what}: {worst}"


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_agrees_with_the_core_in_double_precision(name):
    effects = {name: lively(EFFECTS[name])}
    env = jaxenv.make("hover", effects=effects, observation="measured", seed=SEED, starts=1, dtype="float64")
    rows = actions(1000)
    compare(fly(env, rows), core(rows, effects=effects), 1e-9)


def test_all_effects_together_agree_with_the_core():
    effects = {name: lively(effect) for name, effect in EFFECTS.items()}
    # six physics steps in a tick, which some effects ask for, would make XLA compile for minutes
    options = {"effects": effects, "physics_hz": 50}
    env = jaxenv.make("hover", observation="measured", seed=SEED, starts=1, dtype="float64", **options)
    rows = actions(1000)
    compare(fly(env, rows), core(rows, **options), 1e-9)


@pytest.mark.parametrize("name", TASKS)
def test_every_task_agrees_with_the_core(name):
    drones = TASKS[name]["drones"]
    # with eight drones a program takes as long to compile as all the others here: one task has them
    drones = drones if name == "swap" else min(drones, 3)
    options = {} if drones == 1 else {"drones": drones}
    if name == "swap":
        options["each"] = [{"effects": {"drag_linear": 0.05 * drone}} for drone in range(drones)]
    env = jaxenv.make(TASKS[name]["id"], observation="measured", seed=SEED, starts=1, dtype="float64", **options)
    rows = actions(300, drones)
    compare(fly(env, rows), core(rows, id=name, **options), 1e-9)


def test_single_precision_agrees_with_the_lanes():
    effects = {"gust": {"sigma_mps2": 0.5}, "camera_noise": 0.01, "camera_latency": 0.05, "cmd_delay": 0.03}
    lanes = gymnasium.make("Crazyflie-v0", effects=effects, observation="measured").unwrapped
    pid = lanes.pid()
    theirs, rows, rewards = [lanes.reset(seed=SEED)[0]], [], []
    for _ in range(250):
        rows.append(np.asarray(pid.act(theirs[-1]), np.float32))
        observation, reward, terminated, _, _ = lanes.step(rows[-1])
        theirs.append(observation)
        rewards.append(reward)
        assert not terminated
    rows = np.stack(rows)
    env = jaxenv.make("Crazyflie-v0", effects=effects, observation="measured", seed=SEED, starts=1)
    observations, ours, _, _ = fly(env, rows)
    assert np.max(np.abs(observations - np.array(theirs)) / (1 + np.abs(theirs))) < 1e-4
    assert np.max(np.abs(ours - rewards)) < 1e-4
    # and 25 ticks at a time in one kernel, which is interpreted here
    fused = jax.jit(functools.partial(env.fly, fused=True), compiler_options=QUICK)
    observation, state = jax.jit(env.begin)(*first_start(env))
    for last in range(25, 251, 25):
        observation, state, paid, ended = fused(jax.random.key(0), observation, state, rows[last - 25 : last])
        assert np.max(np.abs(observation - theirs[last]) / (1 + np.abs(theirs[last]))) < 1e-4
        assert (float(paid), int(ended)) == (pytest.approx(sum(rewards[last - 25 : last]), abs=1e-3), 0)


def law(weights, columns):
    """A policy of a few numbers, as a kernel takes it."""
    return [weights["pull"][0, j] * columns[j] + weights["rest"][j] for j in range(4)]


def test_a_kernel_begins_episodes_and_asks_policies_as_steps_do():
    # one program of the kernel has fewer environments, and two have more
    env = jaxenv.make("hover", effects={"camera_noise": 0.01}, max_episode_steps=7)
    observation, state = jax.jit(functools.partial(env.reset, num_envs=130))(jax.random.key(0))
    weights = {"pull": jnp.full((1, 4), 0.1, jnp.float32), "rest": jnp.array([0, 0, 0, -0.07], jnp.float32)}
    kernel, steps = (
        jax.jit(functools.partial(env.fly, actions=law, ticks=20, fused=fused), compiler_options=QUICK)(
            jax.random.key(1), observation, state, weights=weights
        )
        for fused in (True, False)
    )
    assert kernel[0].shape == observation.shape and set(np.asarray(kernel[3])) == {2}
    np.testing.assert_array_equal(kernel[1].noise, steps[1].noise)
    for ours, theirs in zip(jax.tree.leaves(kernel), jax.tree.leaves(steps), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-6)


def test_the_kernel_is_written_for_a_gpu_where_there_is_none(monkeypatch):
    env = jaxenv.make("hover")
    observation, state = jax.jit(env.reset)(jax.random.key(0))
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    traced = jax.jit(env.fly).trace(jax.random.key(0), observation, state, jnp.zeros((5, 4), jnp.float32))
    kernels = [
        traced.lower(lowering_platforms=(name,)).as_text().count("gpu$xla.gpu.triton") for name in ("cuda", "cpu")
    ]
    assert kernels == [1, 0]


@pytest.mark.parametrize(("effects", "stored", "kernels", "moved"), [({}, 84, 114, 1765), (FIVE, 212, 219, 4251)])
def test_a_step_stores_what_changes_and_stays_fused(effects, stored, kernels, moved, monkeypatch):
    """Bytes of an environment, and what a processor runs and moves in a step; a GPU's program is fused further."""
    monkeypatch.syspath_prepend(str(ROOT / "python_client"))
    from program_cost import program_cost

    envs, ticks = 4096, 10
    env = jaxenv.make("hover", effects=effects, vertical="pwm")
    observation, state = jax.eval_shape(functools.partial(env.reset, num_envs=envs), jax.random.key(0))
    assert sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state)) == stored * envs
    actions = jax.ShapeDtypeStruct((ticks, envs, 4), jnp.float32)
    cost = program_cost(jax.jit(env.fly).lower(jax.random.key(0), observation, state, actions).compile())
    assert cost.kernels < 1.1 * kernels * ticks and cost.moved < 1.1 * moved * ticks * envs, cost


def test_noise_is_the_same_to_the_last_bit():
    """A draw is a word's upper 23 bits: were one of them another, the marker's noise would differ by more than this."""
    sigma_m = 0.1
    effects = {"camera_noise": sigma_m}
    env = jaxenv.make("hover", effects=effects, observation="measured", seed=SEED, starts=1, dtype="float64")
    rows = actions(400)
    ours, theirs = fly(env, rows), core(rows, effects=effects)
    noise_m = theirs[0][1:, 0] - theirs[3][:, 0]
    assert np.std(noise_m) > 0.5 * sigma_m
    assert np.max(np.abs(ours[0][:, :2] - theirs[0][:, :2])) < sigma_m * 2.0**-24


# effects on sensors move nothing here
SENSED = ("camera", "markers", "lens", "frame", "imu", "gyro")
MOVING = [name for name in EFFECTS if not name.startswith(SENSED)]
# all in one program compile in twice the time
QUARTERS = [MOVING[first::4] for first in range(4)]


@pytest.mark.parametrize("names", QUARTERS, ids=[names[0] for names in QUARTERS])
def test_gradients_are_those_of_differences(names):
    """Of every parameter of an effect, on where the vehicle is at the end of half a second."""
    assert len(MOVING) > 30
    effects = {name: lively(EFFECTS[name]) for name in names}
    options = {"observation": "measured", "physics_hz": 50}
    env = jaxenv.make("hover", effects=effects, seed=SEED, starts=1, dtype="float64", **options)
    words, numbers = first_start(env)
    rows = jnp.asarray(actions(25))

    def end(params):
        _, state = env.begin(words, numbers, params)

        def tick(state, action):
            _, state, reward, _, _ = env.step_env(None, state, action, params)
            return state, reward

        state, rewards = jax.lax.scan(tick, state, rows)
        true = env.true_state(state)
        return true["pos_m"].sum() + 0.3 * true["att_rad"].sum() + rewards.sum()

    params = jax.tree.map(jnp.float64, env.default_params)
    gradient = jax.jit(jax.grad(end), compiler_options=QUICK)(params)
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(gradient))
    leaves, shape = jax.tree.flatten(params)
    values = jax.jit(jax.vmap(lambda *leaves: end(jax.tree.unflatten(shape, leaves))), compiler_options=QUICK)
    steps = np.array([1e-6 * max(abs(float(leaf)), 1e-2) for leaf in leaves])
    base = np.array([float(leaf) for leaf in leaves])
    moved = np.concatenate([base + np.diag(steps), base - np.diag(steps)])
    ends = np.asarray(values(*moved.T))
    differences = (ends[: len(leaves)] - ends[len(leaves) :]) / (2 * steps)
    ours = np.array([float(leaf) for leaf in jax.tree.leaves(gradient)])
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(params)]
    scale = np.abs(differences) + 1e-3 * np.max(np.abs(differences))
    wrong = {n: (a, b) for n, a, b, s in zip(paths, ours, differences, scale, strict=True) if abs(a - b) > 2e-3 * s}
    # at a kink a difference takes both sides: a command that is a multiple of the step, a count
    assert len(wrong) <= 1, wrong


def test_gradients_through_actions_train():
    env = jaxenv.make("hover", observation="state")
    _, start = env.reset(jax.random.key(0))

    def cost(rows):
        def tick(state, action):
            _, state, reward, _, _ = env.step_env(None, state, action)
            return state, reward

        return -jax.lax.scan(tick, start, rows)[1].mean()

    descend = jax.jit(jax.value_and_grad(cost))
    rows = jnp.zeros((50, 4), jnp.float32).at[:, 3].set(0.311)
    first, _ = descend(rows)
    for _ in range(60):
        _, gradient = descend(rows)
        rows = jnp.clip(rows - 0.3 * gradient / (jnp.linalg.norm(gradient) + 1e-9), -1, 1)
    last, _ = descend(rows)
    assert last < first - 0.05, (first, last)


def test_batches_and_vmap_are_the_same():
    env = jaxenv.make("hover", effects={"gust": {"sigma_mps2": 0.5}}, observation="estimate")
    observation, state = env.reset(jax.random.key(3), num_envs=8)
    rows = jnp.asarray(np.random.default_rng(0).uniform(-0.3, 0.3, (8, 4)), jnp.float32)
    batch = jax.jit(env.step)(jax.random.key(4), state, rows)
    one = jax.jit(jax.vmap(env.step, in_axes=(None, 0, 0)))(jax.random.key(4), state, rows)
    for a, b in zip(jax.tree.leaves(batch), jax.tree.leaves(one), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    assert observation.shape == (8, env.observation_space().shape[0])
    assert len({float(x) for x in state.pos_m[0]}) == 8


# the page's flights on two devices, and the same step on one
SHARDS = """
step = jax.jit(lambda state, actions: env.step(jax.random.key(1), state, actions)[:4])
ours, whole = jax.jit(shards)(state, jnp.zeros((256, 4))), step(state, jnp.zeros((256, 4)))
for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(whole), strict=True):
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
"""


def test_two_devices_share_the_batch_of_the_page():
    blocks = [block.split("```")[0] for block in (ROOT / "docs/jax.md").read_text().split("```python\n")[1:4]]
    assert "shard_map" in blocks[2]
    here = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    code = "\n".join([*blocks, "import numpy as np", SHARDS])
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=here)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip().endswith("2")


def test_ended_episodes_begin_anew_and_differ():
    env = jaxenv.make("hover", max_episode_steps=20)
    _, state = env.reset(jax.random.key(0), num_envs=16)
    starts = []
    step = jax.jit(env.step)
    for tick in range(60):
        _, state, _, done, info = step(jax.random.key(1), state, jnp.zeros((16, 4)).at[:, 3].set(0.311))
        assert bool(done.all()) == (tick % 20 == 19)
        if tick % 20 == 19:
            assert bool(info["truncated"].all()) and not bool(info["terminated"].any())
            starts.append(np.asarray(state.pos_m[0]))
    assert np.all(np.asarray(state.noise[-1]) == 0)
    assert not np.allclose(starts[0], starts[1]) and len(np.unique(starts[0])) > 8


def test_an_action_that_is_no_number_ends_its_flight_at_once():
    env = jaxenv.make("hover", effects={"cmd_delay": 0.03})
    _, state = env.reset(jax.random.key(0), num_envs=3)
    rows = jnp.zeros((3, 4)).at[1, 2].set(jnp.nan)
    ended, after, reward, done, info = jax.jit(env.step)(jax.random.key(1), state, rows)
    assert list(done) == list(info["terminated"]) == [False, True, False]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((ended, after, reward)))
    assert list(after.noise[-1]) == [1, 0, 1]


def test_parameters_are_drawn_from_their_distributions():
    effects = {"drag_linear": {"uniform": [0.2, 0.4]}, "gust": {"sigma_mps2": {"choice": [0.1, 0.7]}}}
    env = jaxenv.make("hover", effects=effects)
    params = env.sample_params(jax.random.key(0), (500,))
    drag, gust = np.asarray(params.drag_linear.rate_ps), np.asarray(params.gust.sigma_mps2)
    assert 0.2 <= drag.min() < 0.21 and 0.39 < drag.max() <= 0.4
    assert set(np.round(gust, 3)) == {0.1, 0.7}
    assert env.default_params.drag_linear.rate_ps == pytest.approx(0.3)
    _, state = env.reset(jax.random.key(0), params, num_envs=500)
    *_, info = env.step(jax.random.key(0), state, jnp.zeros((500, 4)), params)
    assert info["terminated"].shape == (500,)


def test_own_reward_and_observation():
    env = jaxenv.make(
        "hover",
        reward=lambda state, action, params: -jnp.abs(state.pos_m[0]) + 0 * action[..., 0],
        observation=lambda state, params: jnp.stack([*state.pos_m, *state.vel_mps], -1),
    )
    observation, state = env.reset(jax.random.key(0), num_envs=3)
    assert observation.shape == (3, 6)
    observation, state, reward, _, _ = env.step(jax.random.key(0), state, jnp.zeros((3, 4)))
    np.testing.assert_allclose(reward, -np.abs(observation[:, 0]), rtol=1e-6)
    written = jaxenv.make("hover", reward="-dist")
    _, state = written.reset(jax.random.key(0))
    _, state, reward, _, _ = written.step(jax.random.key(0), state, jnp.zeros(4))
    assert float(reward) == pytest.approx(-np.linalg.norm(np.array(state.pos_m) - [0, 0, 0.7]), rel=1e-5)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: jaxenv.make("hover", history=3), ValueError, ["history", "your own state"]),
        (lambda: jaxenv.make("hover", remote="ws://x"), ValueError, ["remote"]),
        (lambda: jaxenv.make("hover", effect={}), TypeError, ["effect"]),
        (lambda: jaxenv.make("hovr"), ValueError, ["hovr", "Crazyflie-v0"]),
        (lambda: jaxenv.make("hover", effects={"gusts": 1}), ValueError, ["gusts", "gust"]),
        (lambda: jaxenv.make("swap", neighbours={"by": "radio"}), ValueError, ["neighbours by radio"]),
        (lambda: jaxenv.make("hover", dtype="int32"), ValueError, ["float32 or float64", "int32"]),
        (lambda: _step(jnp.zeros(3)), ValueError, ["action", "(4,)", "(3,)"]),
        (lambda: _step(jnp.zeros(4, int)), TypeError, ["action", "float32", "int"]),
        (lambda: _step(jnp.zeros(4), {"gust": 1}), TypeError, ["params", "default_params", "dict"]),
        (lambda: jaxenv.make("hover").reset(0), TypeError, ["key", "jax.random.key"]),
    ],
)
def test_mistakes_are_named_before_anything_is_traced(call, error, words):
    with pytest.raises(error) as caught:
        call()
    assert all(word in str(caught.value) for word in words), caught.value


def _step(action, params=None):
    env = jaxenv.make("hover")
    _, state = env.reset(jax.random.key(0))
    return jax.jit(env.step)(jax.random.key(0), state, action, params)


ALONE = """
import importlib.util, sys
sys.modules["crazyflie_gym"] = None
spec = importlib.util.spec_from_file_location("mine", sys.argv[1])
mine = importlib.util.module_from_spec(spec)
spec.loader.exec_module(mine)
import jax, jax.numpy as jnp
env = mine.Environment()
observation, state = jax.jit(lambda key: env.reset(key, num_envs=5))(jax.random.key(0))
step = jax.jit(env.step)
for _ in range(3):
    observation, state, reward, done, info = step(jax.random.key(1), state, jnp.zeros((5, 3, 4)))
print(observation.shape, reward.shape, done.shape)
"""


def test_an_exported_module_needs_this_package_no_more(tmp_path):
    target = tmp_path / "swap.py"
    words = ["export", "--jax", str(target), "--task", "swap", "--drones", "3", "--effects", "gust.sigma_mps2=0.5"]
    said = subprocess.run([sys.executable, "-m", "crazyflie_gym", *words, "--json"], capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    summary = json.loads(said.stdout)
    assert summary["drones"] == 3 and summary["operations"] > 500
    run = subprocess.run([sys.executable, "-c", ALONE, str(target)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "(5, 3, 40) (5, 3) (5,)"


def test_without_jax_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(ImportError, match=r"crazyflie-gym\[jax\]"):
        jaxenv.make("hover")


@pytest.fixture
def on_cpu():
    """Compile for the processor, where the core is, also on a machine with a GPU."""
    with jax.default_device(jax.devices("cpu")[0]):
        yield


@pytest.mark.usefixtures("on_cpu")
def test_the_core_steps_within_a_compiled_program_as_it_does_alone():
    effects = {"gust": {"sigma_mps2": 0.5}}
    core = jaxenv.make_core("hover", num_envs=40, threads=2, effects=effects)
    rows = np.random.default_rng(1).uniform(-0.4, 0.4, (30, 40, 4)).astype(np.float32)
    count, observation = core.reset(range(40))

    def tick(carry, action):
        count, _ = carry
        count, observation, reward, terminated, truncated = core.step(count, action)
        return (count, observation), (observation, reward, terminated | truncated)

    (count, _), (observations, rewards, ends) = jax.jit(lambda c, a: jax.lax.scan(tick, c, a))(
        (count, observation), rows
    )
    sim = crazyflie_gym.Sim(40, json.dumps({"effects": effects, "max_episode_steps": 500}), [THESIS])
    np.testing.assert_array_equal(observation, sim.reset(np.arange(40, dtype=np.uint64)))
    for tick, row in enumerate(rows):
        theirs, reward, terminated, truncated, _ = sim.step(row)
        np.testing.assert_array_equal(observations[tick], theirs)
        np.testing.assert_array_equal(rewards[tick], reward)
        np.testing.assert_array_equal(ends[tick], terminated | truncated)
    assert int(count) == 30


@pytest.mark.usefixtures("on_cpu")
def test_the_core_says_what_is_wrong_within_a_program():
    core = jaxenv.make_core("swap", num_envs=2, drones=3)
    count, observation = core.reset()
    assert observation.shape == (2, 3, 40)
    with pytest.raises(ValueError, match=r"\(2, 3, 4\)"):
        core.step(count, np.zeros((2, 4)))
    with pytest.raises(Exception, match="-1 to 1"):
        jax.block_until_ready(jax.jit(core.step)(count, np.full((2, 3, 4), 2.0, np.float32)))
    count, *_ = jax.jit(core.step)(count, np.zeros((2, 3, 4), np.float32))
    assert int(count) == 1
    with pytest.raises(ValueError, match="effect"):
        jaxenv.make_core("hover", effects={"gusts": 1})


@pytest.mark.parametrize("name", TASKS)
def test_the_flight_in_double_precision_is_that_of_the_batch(name):
    """What programs are recorded from steps an environment by itself: the batch must do the same, in `float32`."""
    drones = TASKS[name]["drones"]
    rows = actions(100, drones)
    sim = crazyflie_gym.Sim(1, json.dumps({"task": name, "autoreset": "disabled"}), [THESIS])
    observations, rewards, ends, states = core(rows, id=name)
    np.testing.assert_allclose(sim.reset(np.array([SEED], np.uint64))[0], observations[0], atol=1e-5)
    for tick, row in enumerate(rows.astype(np.float32)):
        observation, reward, terminated, _, _ = sim.step(row[None])
        np.testing.assert_array_equal(np.ravel(terminated[0]), np.ravel(ends[tick]), err_msg=f"{tick}")
        np.testing.assert_allclose(sim.states()[0], states[tick], atol=2e-4, err_msg=f"{tick}")
        np.testing.assert_allclose(observation[0], observations[tick + 1], atol=2e-2, err_msg=f"{tick}")
        np.testing.assert_allclose(reward[0], rewards[tick], atol=2e-4, err_msg=f"{tick}")
        if np.any(terminated):
            break
    assert tick > 20
