"""The batch as a vector environment of Stable-Baselines3, which has an interface of its own.

    from crazyflie_gym.sb3 import Sb3VecEnv
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor

    PPO("MlpPolicy", VecMonitor(Sb3VecEnv("Crazyflie-v0", num_envs=64))).learn(100_000)

`Sb3SwarmVecEnv` is the same for several drones that share one policy.

Needs the extra `sb3`. Observations must be flat, or by field with Stable-Baselines3's "MultiInputPolicy".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from crazyflie_gym._types import FloatArray
from crazyflie_gym.swarm import CrazyflieSwarm
from crazyflie_gym.vector import CrazyflieVectorEnv


class _BatchVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """Common part of batches: their environments are not made, queried or wrapped one by one."""

    envs: Any
    _actions: FloatArray | None = None
    reset_infos: list[dict[str, Any]]
    # axes of an array of the batch that count its environments
    _axes = 1

    def step_async(self, actions: FloatArray) -> None:
        """Take the actions of the next `step_wait`."""
        self._actions = np.ascontiguousarray(actions, np.float32)

    def _taken(self) -> FloatArray:
        actions, self._actions = self._actions, None
        if actions is None:
            raise RuntimeError("call step_async() before step_wait()")
        return actions

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of the batch, once per requested environment."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of the batch.

        Raises:
            ValueError: for some environments only: they share their attributes.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError("the environments of a batch share their attributes: set them for all")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: int | Iterable[int] | None = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch once, and return its result once per requested environment."""
        result = getattr(self.envs, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def _infos(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the infos of each environment."""
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for name in ("true_state", "cost"):
            if name in infos:
                values = infos[name].reshape(self.num_envs, *infos[name].shape[self._axes :])
                for info, value in zip(listed, values, strict=True):
                    info[name] = value
        return listed

    def close(self) -> None:
        """Close the batch."""
        self.envs.close()

    def get_images(self) -> Sequence[Any]:
        """Return the pictures of the batch, in the mode "rgb_array"."""
        return self.envs.render() or ()

    def env_is_wrapped(self, wrapper_class: Any, indices: int | Iterable[int] | None = None) -> list[bool]:
        """Return False for each requested environment: those of a batch are not wrapped one by one."""
        return [False for _ in self._get_indices(indices)]


class Sb3VecEnv(_BatchVecEnv):  # type: ignore[misc, unused-ignore]
    """A `CrazyflieVectorEnv` for Stable-Baselines3.

    Args:
        id: the Gymnasium id.
        num_envs: how many.
        kwargs: for `gymnasium.make_vec`; the autoreset mode is given.
    """

    def __init__(self, id: str = "Crazyflie-v0", num_envs: int = 1, **kwargs: Any) -> None:
        if gym.spec(id).vector_entry_point != "crazyflie_gym.vector:CrazyflieVectorEnv":
            raise TypeError(f"id: expected one of crazyflie_gym's environments, got {id!r}")
        envs = gym.make_vec(id, num_envs=num_envs, autoreset_mode=AutoresetMode.SAME_STEP.value, **kwargs)
        self.envs = cast("CrazyflieVectorEnv", envs)
        self.render_mode = envs.render_mode
        super().__init__(num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Begin episodes: the first of the seeds that `seed` set, or the next; returns the observations."""
        # the base class hands out seed, seed + 1, ...
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        obs, infos = self.envs.reset(seed=seeds)
        self.reset_infos = self._infos(infos)
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_wait(self) -> tuple[Any, FloatArray, Any, list[dict[str, Any]]]:
        """Fly one control tick; returns observations, rewards, dones and infos."""
        obs, rewards, terminated, truncated, infos = self.envs.step(self._taken())
        dones = terminated | truncated
        listed = self._infos(infos)
        for env in np.flatnonzero(dones):
            info = listed[env]
            if "true_state" in infos:
                info["true_state"] = infos["final_info"]["true_state"][env]
            info["terminal_observation"] = infos["final_obs"][env]
            info["TimeLimit.truncated"] = bool(truncated[env] and not terminated[env])
        return obs, rewards, dones, listed


class Sb3SwarmVecEnv(_BatchVecEnv):
    """Drones of many worlds for Stable-Baselines3: each is an environment, and all share the policy that is learned.

    An observation contains the drone's own fields, then those of each of the others. When a drone crashes or collides,
    the flights of its whole world end: its own by termination, those of the others as if their time were over.

    Args:
        task: of several drones, as of `CrazyflieSwarm`.
        num_worlds: how many worlds; there are `num_worlds * drones` environments, those of a world side by side.
        kwargs: for `CrazyflieSwarm`; the autoreset mode is given.
    """

    _axes = 2

    def __init__(self, task: str = "swap", num_worlds: int = 1, **kwargs: Any) -> None:
        self.envs = CrazyflieSwarm(num_worlds, task, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
        self.render_mode = self.envs.render_mode
        drones = self.envs.num_drones
        super().__init__(num_worlds * drones, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> FloatArray:
        """Begin the flights of all worlds: of the first of the seeds that `seed` set, and the next."""
        rows, infos = self.envs.reset(seed=self._seeds[0])
        self.reset_infos = self._infos(infos)
        self._reset_seeds()
        self._reset_options()
        return self._flat(rows)

    def step_wait(self) -> tuple[FloatArray, FloatArray, Any, list[dict[str, Any]]]:
        """Fly one control tick; returns observations, rewards, dones and infos."""
        actions = self._taken().reshape(self.envs.num_worlds, self.envs.num_drones, -1)
        rows, rewards, terminated, truncated, swarm_infos = self.envs.step(actions)
        ended = (terminated | truncated).any(axis=1)
        infos = self._infos(swarm_infos)
        rewards = rewards.reshape(-1).copy()
        if ended.any():
            last = self._flat(rows).copy()
            for env in np.flatnonzero(np.repeat(ended, self.envs.num_drones)):
                crashed = bool(terminated.reshape(-1)[env])
                infos[env] |= {"terminal_observation": last[env], "TimeLimit.truncated": not crashed}
            rows, _ = self.envs.reset(options={"reset_mask": ended})
        return self._flat(rows), rewards, np.repeat(ended, self.envs.num_drones), infos

    def _flat(self, rows: FloatArray) -> FloatArray:
        return rows.reshape(self.num_envs, -1)
