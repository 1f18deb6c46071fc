"""One environment: a drone, or several that share the air."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

from crazyflie_gym._native import Controller, Crowd, Interface, Pid, Sim, metrics
from crazyflie_gym._types import AnyController, Backend, FloatArray, Observation
from crazyflie_gym.actions import fly_with
from crazyflie_gym.make_backend import make_backend, make_controller
from crazyflie_gym.notebook import describe, picture_png, shown_options, summary
from crazyflie_gym.options import EnvOptions, takes
from crazyflie_gym.rendering import RENDER_MODES, Screen, check_render_mode
from crazyflie_gym.seeding import as_seeds, draw_seeds, refuse_options
from crazyflie_gym.spaces import RowLayout, action_space, choice_and_form
from crazyflie_gym.state import EnvState, set_force, simulation, step_costs

METRICS = tuple(name for name, _, _ in metrics())
"""Metrics of an episode of several drones. `crazyflie_gym.metrics()` explains them."""


class CrazyflieEnv(gym.Env[Observation, FloatArray]):
    """One world with a task; `crazyflie_gym.tasks()` lists the tasks and their numbers of drones.

    Actions are float32 (4,) from -1 to 1: roll, pitch, yaw rate, and height or PWM, see `interface`. Observations
    are the true state, unless `observation` chooses others.

    One agent flies all drones of a task: actions and observations have a row for each of several drones, the
    reward is the drones' mean, and the episode ends when none of them flies any more. info["drone_rewards"] and
    info["flying"] are of each drone, info["metrics"] of the episode. (Agents of their own: `CrazyflieSwarm` and
    `crazyflie_gym.parallel`.)

    Args:
        task: which task, such as "hover", or the id of a registered one.
        form: "flat" for a Box of rows, "dict" for a Dict by field.
        true_state: give the true state, float32 (12,), or (drones, 12), as info["true_state"]; its layout is
            STATE_FIELDS.
        render_mode: None, "rgb_array", or "human" for the terminal.
        remote: the address of a server, such as "ws://127.0.0.1:8765": it simulates there. The results are the same.
        options: those of `crazyflie_gym.EnvOptions`: model, effects, observation, reward and so on.

    Raises:
        TypeError: for a keyword that is unknown, with the nearest name.
        ValueError: naming the argument that is wrong, with a proposal where a name is unknown.
        FileNotFoundError: if there is no such model file.
        ConnectionError: if no server answers at `remote`; from any method if one goes away and does not return.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 50}

    @takes(EnvOptions)
    def __init__(
        self,
        task: str = "hover",
        *,
        form: str = "flat",
        true_state: bool = False,
        render_mode: str | None = None,
        remote: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        observation, form = choice_and_form(options.get("observation"), form)
        options["observation"] = observation
        self.render_mode = check_render_mode(render_mode)
        draws = render_mode is not None
        self.sim: Backend = make_backend(
            1,
            task,
            options,
            autoreset=AutoresetMode.DISABLED,
            remote=remote,
            states=true_state or draws,
            draws=draws,
        )
        rows = self.sim.num_drones if self.sim.has_drone_axis else None
        self._layout = RowLayout(observation, options.get("history", 1), rows)
        self.observation_space = self._layout.space(form)
        self.action_space = action_space(rows)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.sim.tick_s)}
        self._screen = None if render_mode is None else Screen(self.sim, task, options)
        self._by_field = form == "dict"
        self._true_state = true_state
        self._clip = options.get("clip", False)
        self._several = rows is not None
        self._lead = (1,) if rows is None else (1, rows)
        self._costs = options.get("cost") is not None
        self._plain = not (self._by_field or true_state or self._screen or self._several or self._costs)
        self._model = options.get("model")
        self._row: FloatArray | None = None
        self._seeded = False
        self._shown = shown_options(options, task=task, drones=rows, vertical=self.interface.vertical, remote=remote)

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
        """Return a controller of `crazyflie_gym.controllers()`, `NAME:FILE`, or one of your own, for this environment.

        `act(controller)` returns its action. It believes in the model of the environment but knows none of its
        effects. For several drones `name` may be a list with one for each. `avoid` then keeps them out of each other's
        way: True, False, or a dict of the layer's parameters (clearance_m, horizon_s, reach_m, leash_m, climb_m,
        damping_s, push_m, vortex_m, least_m, braking_mps2, delay_s).

        Raises:
            ValueError: naming the controller, option or mode that is wrong, with a proposal where a name is unknown.
        """
        return make_controller(name, self.sim, self._model, mode, avoid, options)

    def pid(self, gains: str = "thesis", mode: str = "automatic") -> Pid:
        """Return the thesis's controller for this environment, for `act`."""
        return Pid(1, self.sim if isinstance(self.sim, Sim) else self.sim.interface, gains, mode)

    def act(self, controller: Controller | Crowd) -> FloatArray:
        """Return the controller's action, (4,) or (drones, 4), after the last step or reset.

        It reads what is measured, whatever the observations hold, and the true state only if it chooses that. Call
        `controller.reset()` when an episode begins.

        Raises:
            RuntimeError: before the first reset.
            ValueError: for a controller of another environment, and on a server with observations other than
                "measured".
        """
        if self._row is None:
            raise RuntimeError("a controller acts after the first reset()")
        action: FloatArray = self.sim.act(controller, self._row[np.newaxis])[0]
        return action

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the first episode of a seed, or without one the next episode; there are no options.

        Raises:
            ValueError: for a seed that is not from 0 to 2**64 - 1, and for options.
        """
        refuse_options(options)
        super().reset(seed=seed)
        if seed is not None:
            row = self.sim.reset(as_seeds([seed]))[0]
        elif self._seeded:
            row = self.sim.reset()[0]
        else:
            row = self.sim.reset(draw_seeds(self.np_random, 1))[0]
        self._seeded, self._row = True, row
        if self._screen:
            self._screen.begin(self.sim.measured(row[np.newaxis]))
        return self._dress(row, {})

    def step(self, action: FloatArray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly one control tick, `interface.tick_s`, with an action, (4,) or (drones, 4) numbers from -1 to 1.

        A float32 array is read where it is; lists, other dtypes, and arrays of torch and jax are converted.

        Raises:
            ValueError: for another shape, and for numbers that are not from -1 to 1; nothing has moved then.
            TypeError: for values that are not numbers.
            RuntimeError: before the first reset, and after the end of an episode.
        """
        if self._plain:
            # not by fly_with at once: the calls take a twentieth of a step
            try:
                result = self.sim.step_one(action)
            except (TypeError, ValueError):
                result = fly_with(self.sim.step_one, action, self._clip)
            self._row = result[0]
            return result
        result = fly_with(self._step_several if self._several else self.sim.step_one, action, self._clip)
        row, reward, terminated, truncated, info = result
        self._row = row
        if self._costs:
            cost = step_costs(self.sim)[0]
            info["cost"] = cost if self._several else float(cost)
        if self._screen:
            self._screen.record(self.sim.measured(row[np.newaxis]), reward)
            if self.render_mode == "human":
                self._screen.show()
        return *self._dress(row, info)[:1], reward, terminated, truncated, info

    def _step_several(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        if not isinstance(action, np.ndarray) or action.shape != self.action_space.shape:
            got = action.shape if isinstance(action, np.ndarray) else type(action).__name__
            raise ValueError(f"action: expected shape {self.action_space.shape}, got {got}")
        rows, rewards, *_ = self.sim.step(action[np.newaxis])
        flying, measured = self.sim.flying(), self.sim.metrics()
        assert flying is not None and measured is not None
        info = {
            "drone_rewards": rewards[0],
            "flying": flying[0],
            "metrics": dict(zip(METRICS, measured[0].tolist(), strict=True)),
        }
        return rows[0], float(rewards.mean()), not flying.any(), False, info

    def set_force(self, force_n: Any) -> None:
        """Let forces act on the drones: (3,) or (drones, 3) in the world frame, N, from now on; None ends them.

        They act on the centre of mass and accelerate by the mass that the model declares. Like actions, they are no
        part of the state.

        Raises:
            ValueError: for another shape, and for what is not finite, with its place.
            RuntimeError: for an environment on a server.
        """
        set_force(self.sim, force_n, self._lead)

    def _dress(self, row: FloatArray, info: dict[str, Any]) -> tuple[Observation, dict[str, Any]]:
        if self._true_state:
            info["true_state"] = self.sim.states()[0]
        return (self._layout.split(row) if self._by_field else row), info

    def get_state(self) -> EnvState:
        """Return all that this environment goes on from, for `set_state` of one that was made alike.

        Raises:
            RuntimeError: for an environment on a server.
        """
        sim = simulation(self.sim).get_state()
        return {"sim": sim, "seeded": self._seeded, "np_random": self.np_random.bit_generator.state}

    def set_state(self, state: EnvState) -> None:
        """Go on from where another environment was, to the bit as that one does. A picture follows with the next step.

        Raises:
            ValueError: for the state of an environment of another task, model, effects or size.
            RuntimeError: for an environment on a server.
        """
        simulation(self.sim).set_state(state["sim"])
        self._seeded = state["seeded"]
        self.np_random.bit_generator.state = state["np_random"]

    # Any: Gymnasium 1.2 and 1.3 do not agree on its type
    def render(self) -> Any:
        """Return a picture, uint8 (360, 480, 3), in the mode "rgb_array"; "human" draws as it flies.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._screen is None:
            gym.logger.warn('render() needs a mode: gymnasium.make(..., render_mode="rgb_array")')
            return None
        if self.render_mode == "human":
            self._screen.show()
            return None
        return self._screen.picture(0)

    def _repr_png_(self) -> bytes | None:
        """Return the picture that a notebook shows, with render_mode="rgb_array" and after the first reset."""
        return picture_png(self.render_mode, self.render)

    def __repr__(self) -> str:
        """Return task, size and options."""
        return summary(type(self).__name__, self._shown)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: task, options, and the picture."""
        return describe("CrazyflieEnv", self._shown, self._repr_png_())

    def close(self) -> None:
        """End the pictures, and the session on a server; may be called twice."""
        if self._screen:
            self._screen.close()
        if not isinstance(self.sim, Sim):
            self.sim.close()
