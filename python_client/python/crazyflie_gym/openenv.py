"""A typed client of `crazyflie serve` for OpenEnv: actions, observations and states are models, not dictionaries.

::

    from crazyflie_gym.openenv import CrazyflieAction, CrazyflieEnv

    with CrazyflieEnv(base_url="http://127.0.0.1:8765").sync() as env:
        result = env.reset(seed=1, env="CrazyflieTrack-v0")
        while not result.done:
            result = env.step(CrazyflieAction(action=[0.0, 0.0, 0.0, 0.0]))
        print(result.observation.fields["attitude_rad"], env.state().true_state)

`pip install "crazyflie-gym[openenv]"` brings what it needs. It is no Gymnasium environment: that is
`crazyflie_gym.CrazyflieEnv`.
"""

from __future__ import annotations

from typing import Annotated, Any

from openenv.core import EnvClient
from openenv.core.client_types import StepResult
from openenv.core.env_server.types import Action, Observation, State
from pydantic import Field

__all__ = ["CrazyflieAction", "CrazyflieEnv", "CrazyflieObservation", "CrazyflieState"]


class CrazyflieAction(Action):  # type: ignore[misc]
    """Four numbers from -1 to 1; their meaning is the environment's, see `crazyflie actions`."""

    action: Annotated[list[float], Field(min_length=4, max_length=4)]


class CrazyflieObservation(Observation):  # type: ignore[misc]
    """Fields by name (see `observation=`); with a history each is a list of ticks, the newest last."""

    fields: dict[str, list[Any]]
    terminated: bool
    truncated: bool


class CrazyflieState(State):  # type: ignore[misc]
    """The number of steps, and the simulator's true state of the vehicle."""

    true_state: list[float]


class CrazyflieEnv(EnvClient[CrazyflieAction, CrazyflieObservation, CrazyflieState]):  # type: ignore[misc]
    """One drone on a server. `reset` takes `seed`, `episode_id`, `env` (a Gymnasium id) and `options`."""

    def _step_payload(self, action: CrazyflieAction) -> dict[str, Any]:
        return {"action": action.action}

    def _parse_result(self, payload: dict[str, Any]) -> StepResult[CrazyflieObservation]:
        fields = dict(payload["observation"])
        ends = {name: fields.pop(name) for name in ("terminated", "truncated")}
        result = {"reward": payload["reward"], "done": payload["done"]}
        # copied as it is: to validate each number would take longer than the flight
        observation = CrazyflieObservation.model_construct(fields=fields, metadata={}, **ends, **result)
        return StepResult(observation=observation, **result)

    def _parse_state(self, payload: dict[str, Any]) -> CrazyflieState:
        return CrazyflieState(**payload)
