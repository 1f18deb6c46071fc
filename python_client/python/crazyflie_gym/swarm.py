"""Several drones in one world: many worlds side by side, arrays shaped worlds x drones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

from crazyflie_gym._native import Crowd, Sim
from crazyflie_gym._types import AnyController, BoolArray, FloatArray
from crazyflie_gym.actions import fly_with
from crazyflie_gym.env import METRICS
from crazyflie_gym.make_backend import episode_steps, make_backend, make_controller
from crazyflie_gym.notebook import describe, shown_options
from crazyflie_gym.options import EnvOptions, takes
from crazyflie_gym.options import autoreset_mode as mode_named
from crazyflie_gym.seeding import Seeds, consecutive_seeds, draw_seeds, reset_mask
from crazyflie_gym.spaces import DEFAULT_OBSERVATION, RowLayout, action_space
from crazyflie_gym.state import EnvState, set_force, step_costs

__all__ = ["METRICS", "CrazyflieSwarm"]

_Step = tuple[FloatArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class CrazyflieSwarm:
    """A batch of worlds, each of several Crazyflies that feel each other's downwash, collide, and know of each other.

    Everything is shaped (num_worlds, num_drones, ...), for training with shared parameters. World i of seed s is world
    0 of seed s + i, bit for bit. A world's episode ends when none of its drones flies any more, or its time is over.

    Args:
        num_worlds: how many worlds.
        task: which of `crazyflie_gym.tasks()`, one of several drones.
        autoreset_mode: as of `CrazyflieVectorEnv`, for whole worlds.
        max_episode_steps: -1 for no end, by default the task's own number.
        threads: as of `CrazyflieVectorEnv`.
        options: those of `crazyflie_gym.EnvOptions`: model, effects, drones, neighbours and so on.

    The errors are those of `CrazyflieVectorEnv`.
    """

    @takes(EnvOptions)
    def __init__(
        self,
        num_worlds: int = 1,
        task: str = "formation",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int = 1,
        **options: Unpack[EnvOptions],
    ) -> None:
        self.mode = mode_named(autoreset_mode)
        observation = options.setdefault("observation", DEFAULT_OBSERVATION)
        steps = episode_steps(task, max_episode_steps)
        sim = make_backend(num_worlds, task, options, autoreset=self.mode, max_episode_steps=steps, threads=threads)
        assert isinstance(sim, Sim)
        if not sim.has_drone_axis:
            raise ValueError(f"task is {task!r}, which is for one drone: make it with gymnasium.make_vec")
        self.sim = sim
        self.num_worlds, self.num_drones = sim.num_envs, sim.num_drones
        self.layout = RowLayout(observation, options.get("history", 1), self.num_drones)
        self.single_observation_space = self.layout.drone_space("flat")
        self.single_action_space = action_space()
        self._model = options.get("model")
        self._np_random: np.random.Generator | None = None
        self._rows: FloatArray | None = None
        self._seeded = False
        self._clip = options.get("clip", False)
        self._costs = options.get("cost") is not None
        self._shown = shown_options(options, task=task, worlds=num_worlds, drones=self.num_drones)

    def controller(
        self,
        name: AnyController | Sequence[AnyController] = "thesis-pid",
        avoid: bool | Mapping[str, float] = True,
        **options: Any,
    ) -> Crowd:
        """Return a controller of `crazyflie_gym.controllers()` for every drone.

        Args:
            name: which; one for all drones, or one for each.
            avoid: keep out of each other's way: True, False, or a dict of the layer's parameters (speed_mps, leash_m,
                range_m, push_mps, vortex_mps, horizon_s).
            options: the controller's own.

        Raises:
            ValueError: naming what is wrong, with a proposal where a name is unknown.
        """
        found = make_controller(name, self.sim, self._model, "automatic", avoid, options)
        assert isinstance(found, Crowd)
        return found

    def act(self, controller: Crowd) -> FloatArray:
        """Return the controller's actions after the last step or reset, whatever the observations hold.

        Raises:
            RuntimeError: before the first reset.
        """
        if self._rows is None:
            raise RuntimeError("a controller acts after the first reset()")
        return self.sim.act(controller, self._rows)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin episodes: with a seed s the first ones of the seeds s, s + 1, and so on, without it the next.

        `options` may be {"reset_mask": bool array (num_worlds,)}: the other worlds, and their rows, stay as they are.
        Returns observations, float32 (num_worlds, num_drones, width), and an empty info.

        Raises:
            ValueError: for seeds that are not from 0 to 2**64 - 1, and masks of another shape or without any True.
            TypeError: for masks that are not bool arrays.
            RuntimeError: if the first reset leaves some worlds out.
        """
        mask = reset_mask(options, self.num_worlds)
        if seed is not None:
            self._np_random, _ = seeding.np_random(seed)
            fresh: Seeds | None = consecutive_seeds(seed, self.num_worlds)
        else:
            fresh = None if self._seeded else draw_seeds(self._generator(), self.num_worlds)
        rows = None if self._rows is None else self._rows.copy()
        self._rows = self.sim.reset(fresh, mask, rows)
        self._seeded = True
        return self._rows.copy(), {}

    def _generator(self) -> np.random.Generator:
        if self._np_random is None:
            self._np_random, _ = seeding.np_random()
        return self._np_random

    def set_force(self, force_n: Any) -> None:
        """Let forces act on the drones: (3,) or (num_worlds, num_drones, 3), N, as `CrazyflieVectorEnv.set_force`."""
        set_force(self.sim, force_n, (self.num_worlds, self.num_drones))

    def step(self, actions: FloatArray) -> _Step:
        """Fly one control tick: actions, (num_worlds, num_drones, 4) numbers from -1 to 1.

        They are converted as by `CrazyflieVectorEnv.step`. Actions of drones that no longer fly are ignored.

        Returns:
            Observations (num_worlds, num_drones, width), zeros of drones that did not fly; rewards, terminations and
            truncations (num_worlds, num_drones), each flag set in the step in which a flight ends; an info of "flying"
            (num_worlds, num_drones), whose next action counts, "metrics" (num_worlds, 6), and where resets happen in
            the same step "final_obs", by world.

        Raises:
            ValueError: for another shape, and for numbers that are not from -1 to 1; nothing has moved then.
            TypeError: for values that are not numbers.
            RuntimeError: before the first reset, and for ended worlds when automatic resets are disabled.
        """
        rows, rewards, terminated, truncated, _ = fly_with(self.sim.step, actions, self._clip)
        self._rows = rows
        flying = self.sim.flying()
        assert flying is not None
        infos: dict[str, Any] = {"flying": flying, "metrics": self.sim.metrics()}
        if self._costs:
            infos["cost"] = step_costs(self.sim)
        if self.mode is AutoresetMode.SAME_STEP:
            # who was reset in the same step flies again; where one has crashed and others fly on, nothing has ended
            ended = np.flatnonzero((terminated | truncated).any(axis=1) & flying.all(axis=1))
            last = {int(world): self.sim.last_of_episode(int(world)) for world in ended}
            infos["final_obs"] = {world: pair[0] for world, pair in last.items() if pair is not None}
        return rows, rewards, terminated, truncated, infos

    def get_state(self) -> EnvState:
        """Return all that these worlds go on from, for `set_state` of a swarm that was made alike."""
        return {
            "sim": self.sim.get_state(),
            "seeded": self._seeded,
            "np_random": self._generator().bit_generator.state,
            "rows": None if self._rows is None else self._rows.copy(),
        }

    def set_state(self, state: EnvState) -> None:
        """Go on from where another swarm was, to the bit as that one does.

        Raises:
            ValueError: for the state of a swarm of another task, model, effects or size.
        """
        self.sim.set_state(state["sim"])
        self._seeded = state["seeded"]
        self._generator().bit_generator.state = state["np_random"]
        self._rows = None if state["rows"] is None else state["rows"].copy()

    def states(self) -> FloatArray:
        """Return the true states, float32 (num_worlds, num_drones, 12), laid out as `STATE_FIELDS`."""
        return self.sim.states()

    def _repr_html_(self) -> str:
        """Return what a notebook shows: task, size and options."""
        return describe("CrazyflieSwarm", self._shown)

    def loads(self) -> FloatArray | None:
        """Return where the loads are, float32 (num_worlds, 3), in metres; `None` where the task carries nothing."""
        return self.sim.loads()
