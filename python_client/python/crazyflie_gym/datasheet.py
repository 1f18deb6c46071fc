"""Models of vehicles that nobody has identified."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crazyflie_gym._native import datasheet_model
from crazyflie_gym.options import to_json


def model_from_datasheet(datasheet: str | os.PathLike[str] | Mapping[str, Any]) -> str:
    """Return the text of the model of a data sheet, for `model=` or a file.

    Args:
        datasheet: the path of a file (TOML or JSON), its text, or its content as a dict; docs/motors.md lists its
            values. A text has more than one line, or begins with "{".

    Raises:
        ValueError: naming the file, and each value that is missing, strange or out of its range.
        FileNotFoundError: if there is no such file.
    """
    if isinstance(datasheet, Mapping):
        return datasheet_model(to_json(**datasheet))
    if isinstance(datasheet, str) and ("\n" in datasheet or datasheet.lstrip().startswith("{")):
        return datasheet_model(datasheet)
    path = Path(datasheet)
    try:
        return datasheet_model(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
