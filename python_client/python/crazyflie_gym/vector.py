"""Many environments, stepped together in Rust."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from typing_extensions import Unpack

from crazyflie_gym import step_many
from crazyflie_gym._native import Controller, Crowd, Interface, Pid, Sim
from crazyflie_gym._types import AnyController, Backend, BoolArray, FloatArray, Observation
from crazyflie_gym.actions import as_array, clip_actions, fly_with
from crazyflie_gym.env import CrazyflieEnv
from crazyflie_gym.make_backend import episode_steps, make_backend, make_controller
from crazyflie_gym.notebook import describe, picture_png, shown_options, summary
from crazyflie_gym.options import EnvOptions, autoreset_mode, takes
from crazyflie_gym.rendering import RENDER_MODES, Screen, check_render_mode
from crazyflie_gym.rollout import KEPT, Rollout, fly_rollout, make_rollout
from crazyflie_gym.seeding import Seeds, as_seeds, consecutive_seeds, draw_seeds, reset_mask
from crazyflie_gym.spaces import RowLayout, action_space, choice_and_form
from crazyflie_gym.state import EnvState, set_force, simulation, step_costs

_Step = tuple[Observation, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class CrazyflieVectorEnv(VectorEnv[Observation, FloatArray, NDArray[Any]]):
    """A batch of worlds with a task. Environment i of seed s is `CrazyflieEnv` of seed s + i, bit for bit.

    One agent flies all drones of a world. With several, observations and actions are (num_envs, drones, ...), and infos
    contain "drone_rewards", "flying" and "metrics", arrays by environment.

    Args:
        num_envs: how many.
        autoreset_mode: what happens at the end of an episode, an `AutoresetMode` or its name: the next step resets
            (the default), the same step resets (info["final_obs"], info["final_info"]), or nothing does until
            `reset(options={"reset_mask": ...})`.
        max_episode_steps: truncate episodes after so many steps; -1 for never, by default the task's own number.
        threads: how many to step with. The results are the same. A server chooses for itself.
        copy: return new arrays; with False two sets of arrays take turns, so that what a step returned is overwritten
            by the step after the next. From a server they are always new.
        options: those of `crazyflie_gym.EnvOptions`: model, effects, observation, reward and so on.

    The other arguments, and the errors, are those of `CrazyflieEnv`. Rewards are float32.
    """

    _screen: Screen | None = None
    metadata: dict[str, Any] = {
        "render_modes": RENDER_MODES,
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    @takes(EnvOptions)
    def __init__(
        self,
        num_envs: int = 1,
        task: str = "hover",
        *,
        form: str = "flat",
        true_state: bool = False,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int = 1,
        copy: bool = True,
        remote: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        mode = _mode(autoreset_mode)
        observation, form = choice_and_form(options.get("observation"), form)
        options["observation"] = observation
        self.render_mode = check_render_mode(render_mode)
        draws = render_mode is not None
        self.sim: Backend = make_backend(
            num_envs,
            task,
            options,
            autoreset=mode,
            max_episode_steps=episode_steps(task, max_episode_steps),
            threads=threads,
            remote=remote,
            states=true_state or draws,
            draws=draws,
        )
        self.num_envs = self.sim.num_envs
        rows = self.sim.num_drones if self.sim.has_drone_axis else None
        self._layout = RowLayout(observation, options.get("history", 1), rows)
        self.single_observation_space = self._layout.space(form)
        self.single_action_space = action_space(rows)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.sim.tick_s), "autoreset_mode": mode}
        self.autoreset_mode = mode
        self._mode = mode
        self._screen = None if render_mode is None else Screen(self.sim, task, options)
        self._by_field = form == "dict"
        self._true_state = true_state
        self._clip = options.get("clip", False)
        self._lead = (self.num_envs,) if rows is None else (self.num_envs, rows)
        self._several = rows is not None
        self._costs = options.get("cost") is not None
        dressed = self._by_field or true_state or self._screen or self._several or self._costs
        self._plain = mode is AutoresetMode.NEXT_STEP and not dressed
        self._sets = None if copy or remote else [_set(self._lead, self.sim.width) for _ in range(2)]
        self._rows: FloatArray | None = None
        self._ended = np.zeros(self.num_envs, np.bool_)
        self._model = options.get("model")
        self._seeded = False
        self._shown = shown_options(
            options,
            task=task,
            environments=num_envs,
            drones=rows,
            vertical=self.interface.vertical,
            autoreset_mode=mode.value,
            remote=remote,
        )

    @property
    def interface(self) -> Interface:
        """The meaning of an action."""
        return self.sim.interface

    def controller(
        self,
        name: AnyController | Sequence[AnyController] = "thesis-pid",
        mode: str = "automatic",
        *,
        avoid: bool | Mapping[str, float] = True,
        **options: Any,
    ) -> Controller | Crowd:
        """Return a controller of `crazyflie_gym.controllers()`, `NAME:FILE`, or one of your own, for this batch.

        `act(controller)` returns its actions. It believes in the model of the environment but knows none of its
        effects; `avoid` is as of `CrazyflieEnv.controller`.

        Raises:
            ValueError: naming the controller, option or mode that is wrong, with a proposal where a name is unknown.
        """
        return make_controller(name, self.sim, self._model, mode, avoid, options)

    def pid(self, gains: str = "thesis", mode: str = "automatic") -> Pid:
        """Return the thesis's controller for this batch, for `act`."""
        return Pid(self.num_envs, self.sim if isinstance(self.sim, Sim) else self.sim.interface, gains, mode)

    def act(self, controller: Controller | Crowd) -> FloatArray:
        """Return the controller's actions, (num_envs, 4), after the last step or reset.

        It reads what is measured, whatever the observations hold, and the true state only if it chooses that. Call
        `controller.reset(mask)` for environments that begin an episode.

        Raises:
            RuntimeError: before the first reset.
            ValueError: for a controller of another batch, and on a server with observations other than "measured".
        """
        if self._rows is None:
            raise RuntimeError("a controller acts after the first reset()")
        return self.sim.act(controller, self._rows)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes: the first of each seed, or without seeds the next.

        Args:
            seed: a number s for the seeds s, s + 1, and so on, or one number (or None) per environment.
            options: {"reset_mask": bool array (num_envs,)} resets only these environments; the other rows of the
                returned observations stay as they were.

        Raises:
            ValueError: for seeds that are not from 0 to 2**64 - 1, a wrong number of them, and masks of another shape
                or without any True.
            TypeError: for masks that are not bool arrays.
            RuntimeError: if the first reset leaves some environments out.
        """
        mask = reset_mask(options, self.num_envs)
        self._seed(seed)
        rows = np.empty((*self._lead, self.sim.width), np.float32) if self._rows is None else self._rows.copy()
        if seed is None:
            fresh = None if self._seeded else draw_seeds(self.np_random, self.num_envs)
            self.sim.reset(fresh, mask, rows)
        elif isinstance(seed, int | np.integer):
            self.sim.reset(consecutive_seeds(int(seed), self.num_envs), mask, rows)
        else:
            self._reset_each(seed, mask, rows)
        self._seeded = True
        self._ended = np.zeros(self.num_envs, np.bool_)
        self._keep(rows)
        if self._screen:
            self._screen.begin(self.sim.measured(rows).copy(), mask)
        infos: dict[str, Any] = {}
        if self._true_state:
            self._add_states(infos, np.ones(self.num_envs, np.bool_) if mask is None else mask.copy())
        return self._form(rows), infos

    def _seed(self, seed: int | Sequence[int | None] | None) -> None:
        """Seed `np_random`, which gives the seeds of environments that have none."""
        first = next((s for s in seed if s is not None), None) if isinstance(seed, Sequence) else seed
        if first is not None:
            self._np_random, self._np_random_seed = seeding.np_random(int(first))

    def _reset_each(self, seed: Sequence[int | None], mask: BoolArray | None, rows: FloatArray) -> None:
        """Reset with a list of seeds; for None, the next episode begins."""
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: expected a list of {self.num_envs}, got {len(seed)}")
        given = np.array([s is not None for s in seed])
        numbers: Seeds = as_seeds([0 if s is None else int(s) for s in seed])
        if given.all() or not self._seeded:
            drawn = draw_seeds(self.np_random, self.num_envs)
            self.sim.reset(np.where(given, numbers, drawn), mask, rows)
            return
        chosen = np.ones(self.num_envs, np.bool_) if mask is None else mask
        self.sim.reset(numbers, chosen & given, rows)
        self.sim.reset(None, chosen & ~given, rows)

    def step(self, actions: FloatArray) -> _Step:
        """Fly one control tick with actions, (num_envs, 4) numbers from -1 to 1.

        A float32 array in C order is read where it is; lists, other dtypes, and arrays of torch and jax are converted.

        Returns:
            Observations (num_envs, 24) or by field; rewards, terminations and truncations (num_envs,); infos.

        Raises:
            ValueError: for another shape, and for numbers that are not from -1 to 1; nothing has moved then.
            TypeError: for values that are not numbers.
            RuntimeError: before the first reset, and for ended environments when automatic resets are disabled.
        """
        rows, rewards, terminated, truncated, ended = fly_with(self._fly, actions, self._clip)
        infos: dict[str, Any] = {}
        if self._plain:
            self._rows = rows
            return rows, rewards, terminated, truncated, infos
        self._keep(rows)
        ends = terminated | truncated
        if self._several:
            ends = self._add_drones(infos, rewards, ends)
            rewards, terminated, truncated = self._join(rewards, terminated, truncated, ends)
        if self._mode is AutoresetMode.SAME_STEP and ended:
            self._add_finals(infos, ends)
        if self._costs:
            infos["cost"], infos["_cost"] = step_costs(self.sim), np.ones(self.num_envs, np.bool_)
        if self._true_state:
            self._add_states(infos, np.ones(self.num_envs, np.bool_))
        if self._screen:
            self._draw(rows, rewards, ends)
        return self._form(rows), rewards, terminated, truncated, infos

    def _fly(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        """Step into new arrays, or into those whose turn it is."""
        if self._sets is None:
            return self.sim.step(actions)
        rows, rewards, terminated, truncated = self._sets[1]
        ended = simulation(self.sim).step_into(actions, rows, rewards, terminated, truncated)
        self._sets.reverse()
        return rows, rewards, terminated, truncated, ended

    def _add_drones(self, infos: dict[str, Any], rewards: FloatArray, ends: BoolArray) -> BoolArray:
        """Add what is known of each drone; returns whose episode ends, (num_envs,)."""
        flying = self.sim.flying()
        assert flying is not None
        infos |= {"drone_rewards": rewards, "flying": flying, "metrics": self.sim.metrics()}
        # a drone reset in the same step flies again
        ended = flying.all(axis=1) if self._mode is AutoresetMode.SAME_STEP else ~flying.any(axis=1)
        return np.asarray(ended & ends.any(axis=1))

    def _join(
        self, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray, ends: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Return rewards and ends of environments, from those of their drones."""
        late: BoolArray = np.asarray(truncated.any(axis=1))
        return np.asarray(rewards.mean(axis=1)), ends & ~late, ends & late

    def step_many(self, actions: FloatArray) -> _Step:
        """Fly several control ticks with actions, (ticks, num_envs, 4) numbers from -1 to 1: one request to a server.

        Returns:
            As `step`, with an axis of ticks in front; infos are "true_state" (ticks, num_envs, 12), "cost" (ticks,
            num_envs) and, where resets happen in the same step, "final_obs" (episodes, 24 or by field) and
            "final_true_state", by tick and environment.

        Raises:
            ValueError: for another shape, and for numbers that are not from -1 to 1; nothing has moved then.
            TypeError: for values that are not numbers.
            RuntimeError: before the first reset, when automatic resets are disabled, and with a `render_mode`.
        """
        if self._mode is AutoresetMode.DISABLED or self._screen:
            raise RuntimeError("several ticks at once need automatic resets, and draw no pictures")
        actions = clip_actions(as_array(actions), self._clip)
        step_many.check_actions(actions, self._lead)
        if self._several or self._costs:
            return step_many.join_steps([self.step(tick) for tick in actions])
        step, states, finals, final_states = step_many.fly_steps(self.sim, actions, self._true_state)
        rows, rewards, terminated, truncated, ended = step
        self._rows = rows[-1]
        infos: dict[str, Any] = {} if states is None else {"true_state": states}
        if self._mode is AutoresetMode.SAME_STEP and ended:
            infos["final_obs"] = self._form(finals)
            if final_states is not None:
                infos["final_true_state"] = final_states
        return self._form(rows), rewards, terminated, truncated, infos

    def rollout(
        self,
        pilot: FloatArray | str | Controller | Crowd,
        steps: int | None = None,
        *,
        options: Mapping[str, Any] | None = None,
        keep: Collection[str] = KEPT,
        out: Rollout | None = None,
    ) -> Rollout:
        """Fly several steps at once, to the bit as `step` would, at the rate of a small batch whatever the size.

        Without automatic resets, environments whose episode ends stop, with rewards and rows of zeros, until they are
        reset. Last observations of episodes that end in the same step are not kept, nor are costs.

        Args:
            pilot: actions, (K, num_envs, 4) numbers from -1 to 1; or a controller of this environment, which goes on
                from its last step; or the name of one, which is made anew and may have `options`.
            steps: K, where a controller flies.
            options: of a controller that is named.
            keep: what to keep of every step: "rewards", "terminated", "truncated", "observations". Returns are always
                there.
            out: arrays to write, of an earlier call with the same K and `keep`.

        Raises:
            ValueError: for another shape, and for numbers that are not from -1 to 1; nothing has moved then. For a
                controller of another batch or in Python; for rewards and ends by functions, and by expressions whose
                value is no number, after the last step.
            TypeError: for values that are not numbers.
            RuntimeError: before the first reset, for environments that have ended, on a server, and with a
                `render_mode`.
        """
        sim = simulation(self.sim)
        if self._screen:
            raise RuntimeError("a rollout draws no pictures")
        if isinstance(pilot, str):
            pilot = self.controller(pilot, **(options or {}))
        elif options is not None:
            raise ValueError("options: they are for a controller that is named")
        if not isinstance(pilot, Controller | Crowd):
            pilot = clip_actions(as_array(pilot), self._clip)
            step_many.check_shape(pilot, self._lead)
            if steps not in (None, len(pilot)):
                raise ValueError(f"steps: the actions are those of {len(pilot)} steps, got {steps}")
            steps = len(pilot)
        elif steps is None or steps < 1:
            raise ValueError(f"steps: expected how many the controller flies, at least 1, got {steps}")
        elif self._rows is None:
            raise RuntimeError("a controller reads the last observation first: reset(), or copy_state(observation=...)")
        if out is None:
            out = make_rollout(sim, steps, self._lead, keep)
        rows = np.zeros((*self._lead, sim.width), np.float32) if self._rows is None else self._rows.copy()
        try:
            out.last_actions = fly_rollout(sim, pilot, steps, rows, out)
        except ValueError:
            # a reward that is no number is told after the last step
            self._rows = None if self._rows is None else rows
            raise
        self._keep(rows)
        out.last_observation = self._form(rows)
        return out

    def set_force(self, force_n: Any) -> None:
        """Let forces act on the drones: (3,) or (num_envs, ..., 3) in the world frame, N, from now on; None ends them.

        They act on the centre of mass and accelerate by the mass that the model declares. Like actions, they are no
        part of the state.

        Raises:
            ValueError: for another shape, and for what is not finite, with its place.
            RuntimeError: for an environment on a server.
        """
        set_force(self.sim, force_n, self._lead)

    def _keep(self, rows: FloatArray) -> None:
        """Remember the observations for a reset with a mask; where that is the rule, out of the user's reach."""
        self._rows = rows.copy() if self._mode is AutoresetMode.DISABLED else rows

    def _form(self, rows: FloatArray) -> Observation:
        return self._layout.split(rows) if self._by_field else rows

    def _add_states(self, infos: dict[str, Any], mask: BoolArray) -> None:
        infos["true_state"], infos["_true_state"] = self.sim.states(), mask

    def _add_finals(self, infos: dict[str, Any], mask: BoolArray) -> None:
        """Add the last observation and info of the episodes that ended, laid out as Gymnasium's own vector envs do."""
        finals = np.full(self.num_envs, None, dtype=object)
        final_info: dict[str, Any] = {}
        states = np.zeros((*self._lead, 12), np.float32) if self._true_state else None
        for env in np.flatnonzero(mask):
            last = self.sim.last_of_episode(int(env))
            if last is not None:
                finals[env] = self._form(last[0])
                if states is not None and last[1] is not None:
                    states[env] = last[1]
        if states is not None:
            final_info["true_state"], final_info["_true_state"] = states, mask.copy()
        infos["final_obs"], infos["_final_obs"] = finals, mask
        infos["final_info"], infos["_final_info"] = final_info, mask.copy()

    def _draw(self, rows: FloatArray, rewards: FloatArray, ended: BoolArray) -> None:
        if self._screen:
            begun = {AutoresetMode.NEXT_STEP: self._ended, AutoresetMode.SAME_STEP: ended}.get(self._mode)
            self._screen.record(self.sim.measured(rows).copy(), float(np.mean(rewards[0])), begun)
            self._ended = ended
            if self.render_mode == "human":
                self._screen.show()

    def get_state(self) -> EnvState:
        """Return all that this environment goes on from, for `set_state` of one that was made alike.

        Raises:
            RuntimeError: for an environment on a server.
        """
        return {
            "sim": simulation(self.sim).get_state(),
            "seeded": self._seeded,
            "np_random": self.np_random.bit_generator.state,
            "rows": None if self._rows is None else self._rows.copy(),
            "ended": self._ended.copy(),
        }

    def set_state(self, state: EnvState) -> None:
        """Go on from where another environment was, to the bit as that one does. A picture follows with the next step.

        Raises:
            ValueError: for the state of an environment of another task, model, effects or size.
            RuntimeError: for an environment on a server.
        """
        simulation(self.sim).set_state(state["sim"])
        self._seeded = state["seeded"]
        self.np_random.bit_generator.state = state["np_random"]
        self._rows = None if state["rows"] is None else state["rows"].copy()
        self._ended = state["ended"].copy()

    def copy_state(
        self,
        source: CrazyflieEnv | CrazyflieVectorEnv,
        observation: FloatArray | None = None,
        seeds: int | Sequence[int] | None = None,
    ) -> None:
        """Let every environment go on from where a single one is, which stays as it is.

        Args:
            source: an environment that was made alike, or a batch of one. `CrazyflieEnv` has automatic resets disabled
                and no limit of steps: `autoreset_mode="disabled", max_episode_steps=-1`.
            observation: the last one of `source`, flat, which a controller reads first in a rollout.
            seeds: for noise that is not that of the source: one for each environment, or a number s for s, s + 1, ...

        Raises:
            ValueError: for a source of another task, model, effects or options, or with several environments.
            RuntimeError: where one of both is on a server.
        """
        state = simulation(source.sim).get_state()
        numbers: Seeds | None = None
        if isinstance(seeds, int | np.integer):
            numbers = consecutive_seeds(int(seeds), self.num_envs)
        elif seeds is not None:
            numbers = as_seeds(list(seeds))
        simulation(self.sim).set_copies(state, numbers)
        shape = (*self._lead, self.sim.width)
        self._rows = None if observation is None else np.broadcast_to(np.asarray(observation, np.float32), shape).copy()
        self._seeded = True

    # Any: Gymnasium 1.2 and 1.3 do not agree on its type
    def render(self) -> Any:
        """Return a picture of each environment, uint8 (360, 480, 3), in the mode "rgb_array"; "human" draws the first.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._screen is None:
            gym.logger.warn('render() needs a mode: gymnasium.make_vec(..., render_mode="rgb_array")')
            return None
        if self.render_mode == "human":
            self._screen.show()
            return None
        return tuple(self._screen.picture(env) for env in range(self.num_envs))

    def _repr_png_(self) -> bytes | None:
        """Return the picture of the first environment, with render_mode="rgb_array" and after the first reset."""
        screen = self._screen
        return None if screen is None else picture_png(self.render_mode, lambda: screen.picture(0))

    def __repr__(self) -> str:
        """Return task, size and options."""
        return summary(type(self).__name__, self._shown)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: task, size, options, and the picture of the first environment."""
        return describe(type(self).__name__, self._shown, self._repr_png_())

    def close_extras(self, **kwargs: Any) -> None:
        """End the pictures, and the session on a server."""
        if self._screen:
            self._screen.close()
        # Gymnasium closes what it drops, also what was refused before it had a simulation
        sim = getattr(self, "sim", None)
        if sim is not None and not isinstance(sim, Sim):
            sim.close()


# the name of the argument hides that of the function
_mode = autoreset_mode


def _set(lead: tuple[int, ...], width: int) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Return the arrays that a step writes."""
    # rows that begin at a cache line are written faster
    count = int(np.prod(lead)) * width
    room = np.zeros(count + 16, np.float32)
    skip = -room.ctypes.data % 64 // room.itemsize
    rows, rewards = room[skip : skip + count].reshape(*lead, width), np.zeros(lead, np.float32)
    return rows, rewards, np.zeros(lead, np.bool_), np.zeros(lead, np.bool_)
