"""Options of an environment in the form that the simulator reads: JSON and the text of a model."""

from __future__ import annotations

import difflib
import functools
import inspect
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypedDict, TypeVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from crazyflie_gym._native import vehicles
from crazyflie_gym.own_judgement import Reward
from crazyflie_gym.spaces import Choice

Model = str | os.PathLike[str] | Mapping[str, Any] | None
"""None for the thesis's model, the name of a vehicle (`crazyflie_gym.vehicles()`), the path of a model file or a data
sheet, the text of one, or its content as a dict."""


class WorldOptions(TypedDict, total=False):
    """Options of every environment, those of JAX too. None is the default.

    Attributes:
        model: the name of a vehicle (`crazyflie_gym.vehicles()`), the path of a model file or a data sheet, its text,
            or its content as a dict; or a list of one for each drone. Default: "cf2-thesis".
        vehicle: another word for `model`; give one of the two.
        vertical: the height input that is commanded: "height", "pwm", "thrust" or "motors". Default: the model's first.
        effects: what the linear model lacks, by name (`crazyflie_gym.effects()`): a number for the first parameter or a
            dict of parameters in their units, each a number or a distribution such as {"uniform": [0.1, 0.3]}, drawn
            per episode. Default: none; of several drones "downwash" as it was measured, unless {"downwash": 0}.
        task_options: the task's own options, which `tasks()` lists with units and defaults. A `drawn` one may be a
            distribution, such as {"uniform": [low, high]}: every episode draws from it.
        physics_hz: physics steps per second while effects push. Default: what the effects need.
        drones: how many, 1 to 64, for a task of several drones. Default: the task's own number.
        each: for each drone, what it has in place of the others' effects: [{"effects": {...}}, ...]. Default: nothing.
        neighbours: what drones know of each other: {"by": "ideal"} (default), {"by": "range", "range_m": ...}, or
            {"by": "radio", "delay_s": ..., "loss": ...}, where each sends its own camera's fix.
        radius_m: two drones nearer than twice this have collided, 0 to 0.5 m. Default: 0.069.
        action: what an action sets: "attitude" (default), "velocity", "position", "body_rates" or "motors"
            (`crazyflie_gym.action_levels()`).
    """

    model: Model | Sequence[Model]
    vehicle: Model | Sequence[Model]
    vertical: str | None
    effects: Mapping[str, Any] | None
    task_options: Mapping[str, Any] | None
    physics_hz: int | None
    drones: int | None
    each: Sequence[Mapping[str, Any]] | None
    neighbours: Mapping[str, Any] | None
    radius_m: float | None
    action: str


class EnvOptions(WorldOptions, total=False):
    """Options of every environment of Gymnasium and PettingZoo, besides those of `WorldOptions`.

    Attributes:
        observation: contents of an observation: "state" (default: the true state), "measured" (what the rig could
            measure), "estimate" (what a Kalman filter makes of that), or a list of names of
            `crazyflie_gym.observable_fields()`, which have units. Each of several drones has such a row, and after it 8
            numbers for each of the others, `crazyflie_gym.neighbour_fields()`.
        history: ticks of an observation, 1 (default) to 64: the newest last, at the beginning all alike.
        reward: a reward of one's own: an expression over `crazyflie_gym.expression_fields()`, such as
            "exp(-4*dist**2) - 0.01*rate2", or a function of such fields, which gets arrays (num_envs, ...) of all
            environments. Default: the task's.
        termination: a condition that ends a flight in place of the task's own, such as "dist > 2", or a function that
            returns bools. A crash, a collision and leaving the room end it anyway. Default: the task's.
        cost: a cost beside the reward, for constrained learning: an expression over the same fields, such as
            "max(0, tilt - 0.3)". Infos contain it as "cost". Default: none.
        wind_field: wind from place to place, a `crazyflie_gym.WindField`. Default: none.
        clip: cut actions off at -1 and 1. Default: False, more than round-off is an error.
        isa: "baseline", "avx2" or "avx512". Default: the best of the machine. The results are the same.
    """

    observation: Choice
    history: int
    reward: Reward
    termination: Reward
    cost: str | None
    wind_field: Mapping[str, Any] | None
    clip: bool
    isa: str | None


_P = ParamSpec("_P")
_T = TypeVar("_T")


def takes(options: type, lacking: Mapping[str, str] | None = None) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Let a function take the keys of a TypedDict: its signature shows them, and None is as if a key was not given.

    Args:
        options: the TypedDict of `**options`.
        lacking: options of other functions that this one does not have, and why. They raise ValueError.

    A keyword that is unknown raises TypeError, with the nearest name.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        signature, kind = inspect.signature(function), inspect.Parameter.KEYWORD_ONLY
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        hints = {name: getattr(hint, "__forward_arg__", hint) for name, hint in options.__annotations__.items()}
        known = [*(p.name for p in own), *hints]

        @functools.wraps(function)
        def checked(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            args, kwargs = _with_own_task(signature.bind_partial(*args, **kwargs))
            for name in list(kwargs):
                if lacking and name in lacking:
                    raise ValueError(f"{name}: {lacking[name]}")
                if name not in known:
                    near = difflib.get_close_matches(name, known, 1)
                    hint = f"; did you mean {near[0]!r}?" if near else ""
                    raise TypeError(f"{function.__qualname__}() got an unexpected keyword argument {name!r}{hint}")
                if name in hints and kwargs[name] is None:
                    del kwargs[name]
            if "vehicle" in kwargs:
                if "model" in kwargs:
                    raise ValueError("vehicle: another word for model; give one of the two")
                kwargs["model"] = kwargs.pop("vehicle")
            return function(*args, **kwargs)

        keys = [inspect.Parameter(name, kind, default=None, annotation=hint) for name, hint in hints.items()]
        checked.__dict__["__signature__"] = signature.replace(parameters=[*own, *keys])
        return checked

    return decorate


def _with_own_task(call: inspect.BoundArguments) -> tuple[Any, Any]:
    """Return the arguments of a call, with the options of a registered task in place of its id. Given ones override."""
    name = "id" if "id" in call.arguments else "task"
    spec = gymnasium.registry.get(str(call.arguments.get(name)))
    if spec is None or spec.namespace != "crazyflie":
        return call.args, call.kwargs
    options = {**spec.kwargs, "max_episode_steps": spec.max_episode_steps}
    call.arguments[name] = options.pop("task")
    given = {key: value for key, value in call.kwargs.items() if value is not None}
    return call.args, options | given


_MODES = {mode.value.lower(): mode for mode in AutoresetMode}
_NATIVE_MODES = {
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.DISABLED: "disabled",
}


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy for `json.dumps`."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"expected numbers, strings, lists and dicts, got {type(value).__name__}")


def to_json(**options: Any) -> str:
    """Return the options that are not None as JSON.

    Raises:
        ValueError: for NaN and infinite numbers, and for values that JSON has no word for.
    """
    texts = []
    for name, value in options.items():
        if value is not None:
            try:
                texts.append(f"{json.dumps(name)}: {json.dumps(value, allow_nan=False, default=_plain)}")
            except (TypeError, ValueError, RecursionError) as error:
                raise ValueError(f"{name}: {error}") from None
    return "{" + ", ".join(texts) + "}"


def autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the mode that is meant: an `AutoresetMode`, or its name, such as "NextStep" or "next_step".

    Raises:
        ValueError: for other names.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    found = _MODES.get(str(mode).replace("_", "").lower())
    if found is None:
        raise ValueError(f"autoreset_mode is {mode!r}, expected one of {', '.join(_NATIVE_MODES.values())}")
    return found


def native_autoreset(mode: AutoresetMode) -> str:
    """Return the simulator's name of a mode."""
    return _NATIVE_MODES[mode]


def model_sources(model: Model | Sequence[Model]) -> list[tuple[str | None, str]]:
    """Return text and name of each model: of one for all drones, or of one for each.

    Raises:
        As `model_source`; ValueError for an empty list.
    """
    models = model if isinstance(model, Sequence) and not isinstance(model, str) else [model]
    if not models:
        raise ValueError("model: expected a model for each drone, or one for all, got an empty list")
    return [model_source(each) for each in models]


def model_source(model: Model) -> tuple[str | None, str]:
    """Return the text of a model or a vehicle's name, None for the thesis's, and the name to report errors with.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is not UTF-8 text.
        TypeError: for other types.
    """
    if model is None:
        return None, "cf2-thesis"
    if isinstance(model, Mapping):
        return to_json(**model), "model"
    if not isinstance(model, str | os.PathLike):
        raise TypeError(f"model: expected a path, a text, a dict or None, got {type(model).__name__}")
    if isinstance(model, str) and ("\n" in model or model.lstrip().startswith("{")):
        return model, "model"
    if model == "":
        raise ValueError("model: expected a vehicle's name, a path or a text, got an empty string")
    path = Path(model)
    if isinstance(model, str) and re.fullmatch(r"[\w-]+", model) and not path.exists():
        return model, "model"
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"model: there is no file {str(path)!r}; vehicles with a name: {', '.join(v['name'] for v in vehicles())}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(
            f"model: cannot read {str(path)!r}: {error}; expected a vehicle's name, a model file or a data sheet"
        ) from None
