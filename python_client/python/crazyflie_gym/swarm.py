"""Several drones in one world: many worlds side by side, arrays shaped worlds x drones."""

from __future__ import annotations

from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

from crazyflie_gym._types import BoolArray, FloatArray
from crazyflie_gym.env import METRICS
from crazyflie_gym.options import EnvOptions, takes
from crazyflie_gym.spaces import action_space
from crazyflie_gym.state import simulation
from crazyflie_gym.vector import CrazyflieVectorEnv

__all__ = ["METRICS", "CrazyflieSwarm"]


class CrazyflieSwarm(CrazyflieVectorEnv):
    """A batch of worlds, each of several Crazyflies that feel each other's downwash, collide, and know of each other.

    It is a `CrazyflieVectorEnv` whose rewards and ends are those of each drone, (num_worlds, num_drones), for training
    with shared parameters: the single spaces are those of one drone. World i of seed s is world 0 of seed s + i, bit
    for bit. A world's episode ends when none of its drones flies any more, or its time is over. Observations, infos and
    errors are those of `CrazyflieVectorEnv`; rows of drones that did not fly are zeros, and their actions are ignored.

    Args:
        num_worlds: how many worlds.
        task: one of `crazyflie_gym.tasks()` for several drones, or the id of a registered one.
        form, true_state, render_mode, autoreset_mode, max_episode_steps, threads, copy, remote: as of
            `CrazyflieVectorEnv`.
        options: those of `crazyflie_gym.EnvOptions`: model, effects, drones, neighbours and so on.

    Raises:
        ValueError: as `CrazyflieVectorEnv`, and for a task of one drone.
    """

    @takes(EnvOptions)
    def __init__(
        self,
        num_worlds: int = 1,
        task: str = "formation",
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
        super().__init__(
            num_worlds,
            task,
            form=form,
            true_state=true_state,
            render_mode=render_mode,
            autoreset_mode=autoreset_mode,
            max_episode_steps=max_episode_steps,
            threads=threads,
            copy=copy,
            remote=remote,
            **options,
        )
        if not self._several:
            raise ValueError(f"task is {task!r}, which is for one drone: make it with gymnasium.make_vec")
        self.num_worlds, self.num_drones = self.num_envs, self.sim.num_drones
        self.single_observation_space = self._layout.drone_space(form)
        self.single_action_space = action_space()

    def _join(
        self, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray, ends: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Leave rewards and ends to each drone."""
        return rewards, terminated, truncated

    def states(self) -> FloatArray:
        """Return the true states, float32 (num_worlds, num_drones, 12), laid out as `STATE_FIELDS`."""
        return self.sim.states()

    def loads(self) -> FloatArray | None:
        """Return where the loads are, float32 (num_worlds, 3), in metres; `None` where the task carries nothing."""
        return simulation(self.sim).loads()
