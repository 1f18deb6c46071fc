"""A trained policy as C for a microcontroller: `crazyflie policy export-c` from Python.

from crazyflie_gym.export import export_policy_c

source, header = export_policy_c("hover.safetensors", "firmware/policy.c")
"""

from __future__ import annotations

from pathlib import Path

from crazyflie_gym import _native
from crazyflie_gym.options import Model, model_sources


def export_policy_c(
    policy: str | Path, out: str | Path, *, model: Model = None, vertical: str = "pwm"
) -> tuple[Path, Path]:
    """Write a policy as C, single precision without allocation, and return the paths of source and header.

    The header gives the places of an observation's fields, float32 (24,) in SI units, and what an action, float32 (4,)
    from -1 to 1, commands.

    Args:
        policy: its file, as `crazyflie_gym.ppo` writes it.
        out: where to write, a path that ends in .c; the header goes beside it.
        model: of the vehicle, as of `CrazyflieEnv`; the thesis's unless given.
        vertical: which vertical form is commanded, "pwm" or "thrust".

    Raises:
        ValueError: for a file that is no policy, a form that it cannot command, and a path that does not end in .c.
        OSError: for a file that cannot be read or written.
    """
    source = Path(out)
    if source.suffix != ".c":
        raise ValueError(f"{out}: expected a path that ends in .c")
    content = Path(policy).read_bytes()
    code = _native.policy_c(content, source.stem, model=model_sources(model)[0][0], vertical=vertical)
    paths = source, source.with_suffix(".h")
    for path, text in zip(paths, code, strict=True):
        path.write_text(text)
    return paths
