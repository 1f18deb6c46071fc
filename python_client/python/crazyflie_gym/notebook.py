"""Displays of environments, flights and rollouts in a notebook: HTML without scripts, all in one piece."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from crazyflie_gym.png import png_bytes

_CELL = "padding:2px 10px;text-align:left"
_NUMBER = "padding:2px 10px;text-align:right"


def shown_options(options: Mapping[str, Any], **first: Any) -> dict[str, str]:
    """Return those of an environment's options that were given, as text, except for long ones; `first` are first."""
    given = {**first, **{name: value for name, value in options.items() if name not in (*first, "model", "wind_field")}}
    return {name: _shown(value) for name, value in given.items() if value is not None and value is not False}


def _shown(value: Any) -> str:
    text = getattr(value, "__name__", None) or (str(dict(value)) if isinstance(value, Mapping) else str(value))
    return text if len(text) <= 300 else text[:297] + "..."


def summary(title: str, about: Mapping[str, str]) -> str:
    """Return a title with names and values, in one line."""
    return f"{title}({', '.join(f'{name}={value}' for name, value in about.items())})"


def describe(title: str, about: Mapping[str, str], picture: bytes | None = None) -> str:
    """Return a title, rows of names with values, and a picture beside them if there is one."""
    rows = "".join(
        f'<tr><th style="{_CELL}">{html.escape(name)}</th><td style="{_CELL}">{html.escape(value)}</td></tr>'
        for name, value in about.items()
    )
    text = f"<b>{html.escape(title)}</b><table>{rows}</table>"
    if picture is None:
        return f"<div>{text}</div>"
    source = base64.b64encode(picture).decode()
    image = f'<img alt="{html.escape(title)}" src="data:image/png;base64,{source}">'
    return f'<div style="display:flex;flex-wrap:wrap;gap:16px"><div>{image}</div><div>{text}</div></div>'


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table with names in the first column and numbers in the others."""
    head = "".join(f'<th style="{_NUMBER if i else _CELL}">{html.escape(cell)}</th>' for i, cell in enumerate(header))
    body = "".join(
        "<tr>"
        + "".join(f'<td style="{_NUMBER if i else _CELL}">{html.escape(cell)}</td>' for i, cell in enumerate(row))
        + "</tr>"
        for row in rows
    )
    return f"<div><b>{html.escape(title)}</b><table><tr>{head}</tr>{body}</table></div>"


def picture_png(render_mode: str | None, picture: Callable[[], NDArray[Any]]) -> bytes | None:
    """Return what an environment looks like, or None where it draws nothing or has not begun."""
    if render_mode != "rgb_array":
        return None
    try:
        return png_bytes(picture())
    except ResetNeeded:
        return None
