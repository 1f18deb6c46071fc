"""Several drones as agents of PettingZoo. Needs the extra `swarm`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError("PettingZoo is missing: pip install 'crazyflie-gym[swarm]'") from error

from crazyflie_gym._native import Controller, Crowd
from crazyflie_gym._types import AnyController, FloatArray, Observation
from crazyflie_gym.actions import as_array
from crazyflie_gym.options import EnvOptions, takes
from crazyflie_gym.rendering import RENDER_MODES
from crazyflie_gym.spaces import choice_and_form
from crazyflie_gym.state import EnvState
from crazyflie_gym.swarm import METRICS, CrazyflieSwarm

_Results = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]


class AgentController:
    """Controllers of `crazyflie_gym.controllers()` for agents: dictionaries in, dictionaries out."""

    def __init__(self, agents: Sequence[str], swarm: CrazyflieSwarm, crowd: Controller | Crowd) -> None:
        self._places = {agent: j for j, agent in enumerate(agents)}
        self._swarm, self._crowd = swarm, crowd

    def act(self, observations: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return an action, float32 (4,), for each agent whose observation is given, whatever that holds.

        Raises:
            KeyError: for an agent that is unknown.
            RuntimeError: before the first reset.
        """
        places = {agent: self._places[agent] for agent in observations}
        actions = self._swarm.act(self._crowd)[0]
        return {agent: actions[place] for agent, place in places.items()}

    def reset(self) -> None:
        """Forget the flight; call it where an episode begins."""
        self._crowd.reset()


class CrazyflieParallelEnv(ParallelEnv[str, Observation, FloatArray]):  # type: ignore[misc]
    """One world of several Crazyflies, each an agent: "drone_0", "drone_1", and so on.

    A drone that collides, crashes or is done terminates and leaves; when the time is over the others are truncated.
    Infos contain the episode's "metrics" so far.

    Args:
        task: one of `crazyflie_gym.tasks()` for several drones, or the id of a registered one.
        form: "flat" for a Box of rows, "dict" for a Dict by field.
        render_mode: None, "rgb_array", or "human" for the terminal.
        max_episode_steps: -1 for no end, by default the task's own number.
        threads: as of `CrazyflieVectorEnv`.
        options: those of `crazyflie_gym.EnvOptions`: model, effects, drones, neighbours and so on.
    """

    metadata: dict[str, Any] = {
        "render_modes": RENDER_MODES,
        "render_fps": 50,
        "name": "crazyflie_v0",
        "is_parallelizable": True,
    }

    @takes(EnvOptions)
    def __init__(
        self,
        task: str = "formation",
        *,
        form: str = "flat",
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        **options: Unpack[EnvOptions],
    ) -> None:
        self.render_mode = render_mode
        options["observation"], form = choice_and_form(options.get("observation"), form)
        self._by_field = form == "dict"
        self.swarm = CrazyflieSwarm(
            1,
            task,
            render_mode=render_mode,
            autoreset_mode=AutoresetMode.DISABLED,
            max_episode_steps=max_episode_steps,
            threads=threads,
            **options,
        )
        sim = self.swarm.sim
        self.metadata = {**self.metadata, "render_fps": round(1.0 / sim.tick_s)}
        self.state_space = spaces.Box(-np.inf, np.inf, (sim.num_drones * 12,), np.float32)
        self.possible_agents = [f"drone_{j}" for j in range(self.swarm.num_drones)]
        self.agents: list[str] = []
        # PettingZoo wants the same object each time
        self.observation_spaces = {agent: self.swarm._layout.drone_space(form) for agent in self.possible_agents}
        self.action_spaces = {agent: self._action_space() for agent in self.possible_agents}

    def _form(self, row: FloatArray) -> Observation:
        return self.swarm._layout.split(row) if self._by_field else row

    def _action_space(self) -> spaces.Space[FloatArray]:
        space: Any = spaces.Box(-1.0, 1.0, (4,), np.float32)
        return space  # type: ignore[no-any-return]

    def observation_space(self, agent: str) -> spaces.Space[Observation]:
        """Return the space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[FloatArray]:
        """Return the space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin the first episode of a seed, or without one the next episode; there are no options."""
        rows, _ = self.swarm.reset(seed=seed)
        self.agents = list(self.possible_agents)
        observations = {agent: self._form(rows[0, j]) for j, agent in enumerate(self.agents)}
        return observations, {agent: {} for agent in self.agents}

    def set_force(self, force_n: Any) -> None:
        """Let forces act on the drones: (3,) or (1, num_drones, 3), N, as `CrazyflieVectorEnv.set_force`."""
        self.swarm.set_force(force_n)

    def step(self, actions: Mapping[str, FloatArray]) -> _Results:
        """Fly one control tick with one action, float32 (4,) from -1 to 1, of every agent of `agents`.

        Raises:
            ValueError: for an agent that is missing, unknown, or no longer flies; and as `CrazyflieSwarm.step`. Nothing
                has moved then.
        """
        self._check(actions)
        rows = np.zeros((1, len(self.possible_agents), 4), np.float32)
        places = {agent: j for j, agent in enumerate(self.possible_agents)}
        for agent, action in actions.items():
            row = as_array(action)
            if row.shape != (4,):
                raise ValueError(f"action of {agent}: expected shape (4,), got {row.shape}")
            rows[0, places[agent]] = row
        if not self.agents:
            return {}, {}, {}, {}, {}
        seen, rewards, terminated, truncated, info = self.swarm.step(rows)
        costs = info.get("cost")
        measured = dict(zip(METRICS, info["metrics"][0].tolist(), strict=True))
        flew = [(agent, places[agent]) for agent in self.agents]
        self.agents = [agent for agent, j in flew if info["flying"][0, j]]
        return (
            {agent: self._form(seen[0, j]) for agent, j in flew},
            {agent: float(rewards[0, j]) for agent, j in flew},
            {agent: bool(terminated[0, j]) for agent, j in flew},
            {agent: bool(truncated[0, j]) for agent, j in flew},
            {
                agent: {"metrics": measured} | ({} if costs is None else {"cost": float(costs[0, j])})
                for agent, j in flew
            },
        )

    def controller(
        self,
        name: AnyController | Sequence[AnyController] = "thesis-pid",
        avoid: bool | Mapping[str, float] = True,
        **options: Any,
    ) -> AgentController:
        """Return a controller for all agents, or by a list of names one for each; as of `CrazyflieSwarm.controller`."""
        return AgentController(self.possible_agents, self.swarm, self.swarm.controller(name, avoid=avoid, **options))

    def state(self) -> FloatArray:
        """Return the true states of all drones, one after the other, float32 (drones * 12,); see `STATE_FIELDS`."""
        return self.swarm.states().reshape(-1)

    def get_state(self) -> EnvState:
        """Return all that this environment goes on from, for `set_state` of one that was made alike."""
        return {"swarm": self.swarm.get_state(), "agents": list(self.agents)}

    def set_state(self, state: EnvState) -> None:
        """Go on from where another environment was, to the bit as that one does.

        Raises:
            ValueError: for the state of an environment of another task, model, effects or size.
        """
        self.swarm.set_state(state["swarm"])
        self.agents = list(state["agents"])

    def render(self) -> Any:
        """Return a picture, uint8 (360, 480, 3), in the mode "rgb_array"; "human" draws as it flies.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self.render_mode is None:
            gym.logger.warn('render() needs a mode: parallel_env(..., render_mode="rgb_array")')
            return None
        pictures = self.swarm.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """End the pictures; may be called twice."""
        self.swarm.close()

    def _check(self, actions: Mapping[str, FloatArray]) -> None:
        for agent in actions:
            if agent not in self.possible_agents:
                raise ValueError(f"action of {agent!r}: there is no such drone, expected {', '.join(self.agents)}")
            if agent not in self.agents:
                raise ValueError(
                    f"action of {agent}: it no longer flies; those that do: {', '.join(self.agents) or 'none'}"
                )
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise ValueError(f"no action of {', '.join(missing)}: every drone that flies needs one")


parallel_env = CrazyflieParallelEnv
"""The name that PettingZoo's own modules have."""
