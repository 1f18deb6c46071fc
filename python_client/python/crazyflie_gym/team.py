"""Several drones as one environment of Gymnasium: one agent that flies them all."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from crazyflie_gym._native import Crowd
from crazyflie_gym._types import BoolArray, FloatArray
from crazyflie_gym.swarm import METRICS, CrazyflieSwarm

_Step = tuple[FloatArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]


def _spaces(swarm: CrazyflieSwarm) -> tuple[spaces.Space[FloatArray], spaces.Space[FloatArray]]:
    """The drones' spaces, one row for each."""
    return batch_space(swarm.single_observation_space, swarm.num_drones), batch_space(
        swarm.single_action_space, swarm.num_drones
    )


class CrazyflieTeamEnv(gym.Env[FloatArray, FloatArray]):
    """One world of several Crazyflies, flown by one agent.

    Observations are float32 (num_drones, width), actions float32 (num_drones, 4) from -1 to 1, the reward is their
    mean. It ends when no drone flies any more. info["drone_rewards"] and info["flying"] are of each drone,
    info["metrics"] of the episode. The arguments are those of `crazyflie_gym.swarm.CrazyflieSwarm`.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 50}

    def __init__(self, task: str = "formation", **options: Any) -> None:
        self.swarm = CrazyflieSwarm(1, task, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=-1, **options)
        self.observation_space, self.action_space = _spaces(self.swarm)
        self.render_mode = None
        self._seeded = False

    def controller(self, name: str = "thesis-pid", **options: Any) -> Crowd:
        """Return a controller for the drones; it wants an axis of worlds in front, which `action` adds."""
        return self.swarm.controller(name, **options)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin the first episode of a seed, or without one the next episode; there are no options.

        Raises:
            ValueError: for a seed that is not from 0 to 2**64 - 1.
        """
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(0, 2**63))
        self._seeded = True
        rows, _ = self.swarm.reset(seed=seed)
        return rows[0], {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Fly one control tick; see `CrazyflieSwarm.step` for the errors."""
        if not isinstance(action, np.ndarray) or action.shape != self.action_space.shape:
            got = action.shape if isinstance(action, np.ndarray) else type(action).__name__
            raise ValueError(f"action: expected a float32 array of shape {self.action_space.shape}, got {got}")
        rows, rewards, _, _, info = self.swarm.step(action[np.newaxis])
        flying = info["flying"][0]
        dress = {
            "drone_rewards": rewards[0],
            "flying": flying,
            "metrics": dict(zip(METRICS, info["metrics"][0].tolist(), strict=True)),
        }
        return rows[0], float(rewards.mean()), not flying.any(), False, dress


class CrazyflieTeamVectorEnv(VectorEnv[FloatArray, FloatArray, NDArray[Any]]):
    """A batch of worlds, each flown by one agent; see `CrazyflieTeamEnv`. Infos are those of `CrazyflieSwarm`."""

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "formation",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode is {render_mode!r}, expected None: teams draw no pictures here")
        self.swarm = CrazyflieSwarm(num_envs, task, autoreset_mode=autoreset_mode, **options)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.swarm)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {**self.metadata, "autoreset_mode": self.swarm.mode}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin episodes; see `CrazyflieSwarm.reset`."""
        return self.swarm.reset(seed=seed, options=options)

    def step(self, actions: FloatArray) -> _Step:
        """Fly one control tick in every world; rewards are the drones' means, ends those of whole worlds."""
        rows, rewards, terminated, truncated, infos = self.swarm.step(actions)
        over = truncated.any(axis=1)
        ended = terminated.any(axis=1) & ~over
        if self.swarm.mode is AutoresetMode.SAME_STEP:
            last = infos.pop("final_obs")
            ended &= np.isin(np.arange(self.num_envs), list(last))
            infos["final_obs"] = np.array([last.get(world) for world in range(self.num_envs)], dtype=object)
            infos["_final_obs"] = ended | over
        else:
            ended &= ~infos["flying"].any(axis=1)
        infos["drone_rewards"] = rewards
        return rows, rewards.mean(axis=1), ended, over, infos
