"""Environments as pure functions of JAX: for GPUs, for gradients, for training without leaving the accelerator.

    import jax
    import crazyflie_gym.jax

    env = crazyflie_gym.jax.make("Crazyflie-v0", effects={"gust": {"sigma_mps2": 0.5}})
    observation, state = env.reset(jax.random.key(0), num_envs=4096)
    step = jax.jit(env.step)
    observation, state, reward, done, info = step(jax.random.key(1), state, actions)

The functions are written by the simulator itself: it runs its own formulas on symbols and notes what it computes. So
every effect, sensor, task and action level is here as well, with the same noise. Needs the extra `jax`.
"""

from __future__ import annotations

import functools
import linecache
import types
from collections.abc import Callable, Sequence
from typing import Any, cast

from typing_extensions import Unpack

from crazyflie_gym import _native
from crazyflie_gym._parts import need
from crazyflie_gym.make_backend import episode_steps, native_options, native_texts
from crazyflie_gym.options import EnvOptions, WorldOptions, takes
from crazyflie_gym.spaces import DEFAULT_OBSERVATION, Choice

need("jax")

# options of `gymnasium.make` that a recorded environment does not have
_LACKING = {
    name: f"a recorded environment does not have this option; {why}"
    for name, why in {
        "autoreset_mode": "`step` begins ended episodes anew, `step_env` does not",
        "cost": "compute it from `env.true_state(state)`",
        "clip": "actions are clipped to -1 to 1",
        "history": "keep past observations in your own state",
        "isa": "XLA chooses the instructions",
        "num_envs": "give it to `reset`",
        "remote": "there is no server",
        "render_mode": "draw `env.true_state(state)`",
        "threads": "XLA chooses the threads",
        "wind_field": "it is a table that is looked up in flight",
    }.items()
}


@takes(WorldOptions, _LACKING)
def make(
    id: str = "Crazyflie-v0",
    *,
    reward: str | Callable[..., Any] | None = None,
    termination: str | None = None,
    observation: Choice | Callable[..., Any] = DEFAULT_OBSERVATION,
    max_episode_steps: int | None = None,
    seed: int = 0,
    starts: int = 1024,
    dtype: Any = "float32",
    **options: Unpack[WorldOptions],
) -> Any:
    """Return an environment in the style of gymnax: `reset(key, params)` and `step(key, state, action, params)`.

    Its text is in `env.source`; `env.drawn` has the starts that it picks from, each as the words of the drones' noise
    and the numbers that `env.begin` takes.

    Args:
        id: of Gymnasium, or the name of a task.
        reward: an expression, or a function `reward(state, action, params)` of JAX.
        termination: an expression.
        observation: as for `gymnasium.make`, or a function `observation(state, params)` of JAX.
        max_episode_steps: of an episode, -1 for no end; the task's own unless given.
        seed: of the first start.
        starts: how many starts of episodes there are, those of the seeds from `seed` on.
        dtype: "float32" or "float64".
        options: `crazyflie_gym.options.WorldOptions`, as for `gymnasium.make`. The numbers of all effects that are
            named here are in `env.default_params`, and can be changed there; with `each`, drone by drone.

    Raises:
        ImportError: without JAX.
        TypeError: for a keyword that is unknown, with the nearest name.
        ValueError: naming the option that is wrong, or that a recorded environment lacks.
    """
    try:
        import jax  # noqa: F401
    except ImportError as error:
        raise ImportError('crazyflie_gym.jax needs JAX: pip install "crazyflie-gym[jax]"') from error
    task = _task(id)
    judged = {
        **options,
        "observation": "measured" if callable(observation) else observation,
        "reward": None if callable(reward) else reward,
        "termination": termination,
    }
    text, models, _ = native_options(
        task, cast(EnvOptions, judged), max_episode_steps=episode_steps(task, max_episode_steps)
    )
    module = _module(text, tuple(native_texts(models)), seed, starts)
    env = module.Environment(
        reward=reward if callable(reward) else None,
        observation=observation if callable(observation) else None,
        dtype=dtype,
    )
    # the words of each drone's noise and the numbers of each start, for `begin`
    env.drawn = module.__dict__["DRAWN"]
    env.source = module.__dict__["SOURCE"]
    return env


def _task(id: str) -> str:
    """Return the name of the task with that id or name."""
    names = {entry["id"]: entry["name"] for entry in _native.tasks()}
    if id not in names and id not in names.values():
        raise ValueError(f"there is no environment {id!r}; known: {', '.join(names)}")
    return names.get(id, id)


@functools.lru_cache(maxsize=64)
def _module(options: str, models: tuple[str, ...], seed: int, starts: int) -> types.ModuleType:
    """Return the module of these options."""
    text, drawn = _native.jax_module(options, list(models), seed=seed, starts=starts)
    name = f"<crazyflie_gym.jax {options}>"
    # so that tracebacks show its lines
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    module = types.ModuleType("crazyflie_gym.jax.recorded")
    module.__dict__["SOURCE"] = text
    module.__dict__["DRAWN"] = drawn
    exec(compile(text, name, "exec"), module.__dict__)
    return module


_TARGET = "crazyflie_gym_step"


class Core:
    """The core's own batch, stepped within compiled programs: `make_core` makes one.

    It is no pure function: it has the state. `step` takes and returns a count, which keeps steps in order.
    """

    def __init__(self, batch: _native.JaxCore):
        self._batch = batch
        self.num_envs, self.num_drones, self.tick_s = batch.num_envs, batch.num_drones, batch.tick_s
        self._lead = (batch.num_envs, batch.num_drones) if batch.has_drone_axis else (batch.num_envs,)

    def reset(self, seeds: Sequence[int] | None = None) -> tuple[Any, Any]:
        """Begin an episode of each seed, 0, 1, 2, ... unless given; the count and the observations.

        Raises:
            ValueError: unless there is a seed for each environment.
        """
        import jax.numpy as jnp

        rows = self._batch.reset(list(range(self.num_envs) if seeds is None else seeds))
        return jnp.zeros((), jnp.int32), jnp.asarray(rows.reshape(*self._lead, -1))

    def step(self, count: Any, actions: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Fly one tick: the count, observations, rewards, terminated, truncated.

        Episodes that have ended begin anew in the next step, whose action they ignore.

        Raises:
            ValueError: for actions of another shape; when the program runs, for actions that are no numbers from -1
                to 1 (as JAX's own exception).
        """
        import jax
        import jax.numpy as jnp
        import numpy as np

        actions = jnp.asarray(actions, jnp.float32)
        if actions.shape != (*self._lead, 4):
            raise ValueError(f"actions: expected shape {(*self._lead, 4)}, got {actions.shape}")
        lead = self._lead
        shapes = [((), jnp.int32), ((*lead, self._batch.width), jnp.float32), (lead, jnp.float32)]
        shapes += [(lead, jnp.bool_)] * 2
        structure: Any = jax.ShapeDtypeStruct
        call = jax.ffi.ffi_call(_TARGET, [structure(*each) for each in shapes], has_side_effect=True)
        results = call(count, actions, handle=np.int64(self._batch.handle))
        return tuple(results)  # type: ignore[return-value]


@functools.cache
def _register_target() -> None:
    """Register the core's step with JAX, once."""
    import jax

    jax.ffi.register_ffi_target(_TARGET, _native.jax_step_target(), platform="cpu")


@takes(EnvOptions)
def make_core(
    id: str = "Crazyflie-v0",
    num_envs: int = 1,
    *,
    threads: int = 1,
    max_episode_steps: int | None = None,
    **options: Unpack[EnvOptions],
) -> Core:
    """Return the core itself for programs of JAX on a CPU: at native speed, without gradients.

    If JAX would choose a GPU, run the program within `jax.default_device(jax.devices("cpu")[0])`.

    Args:
        id: of Gymnasium, or the name of a task.
        num_envs: environments.
        threads: that step them.
        max_episode_steps, options: as for `gymnasium.make_vec`.

    Raises:
        ImportError: without JAX.
        ValueError: naming the option that is wrong.
    """
    try:
        _register_target()
    except ImportError as error:
        raise ImportError('crazyflie_gym.jax needs JAX: pip install "crazyflie-gym[jax]"') from error
    task = _task(id)
    steps = episode_steps(task, max_episode_steps)
    text, models, functions = native_options(task, options, threads=threads, max_episode_steps=steps)
    if functions or options.get("clip"):
        raise ValueError(f"{next(iter(functions), 'clip')}: the core's step has no Python in it")
    return Core(_native.JaxCore(num_envs, text, native_texts(models)))
