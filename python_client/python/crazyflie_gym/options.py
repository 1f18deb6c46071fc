"""What a user can ask of an environment, in the form the simulator reads: JSON options and the text of a model."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

Model = str | os.PathLike[str] | Mapping[str, Any] | None
"""None or "thesis" for the built-in model, the path of a model file, the text of one, or its content as a dict."""

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
    """Return the text of a model, None for the built-in one, and the name to report errors with.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is not UTF-8 text.
        TypeError: for other types.
    """
    if model is None or model == "thesis":
        return None, "thesis"
    if isinstance(model, Mapping):
        return to_json(**model), "model"
    if not isinstance(model, str | os.PathLike):
        raise TypeError(f"model: expected a path, a text, a dict or None, got {type(model).__name__}")
    if isinstance(model, str) and ("\n" in model or model.lstrip().startswith("{")):
        return model, "model"
    path = Path(model)
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except FileNotFoundError:
        raise FileNotFoundError(
            f'model: there is no file {str(path)!r}, and the only built-in model is "thesis"'
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"model: cannot read {str(path)!r}: {error}") from None
