"""Parts of the package that a build may leave out."""

from crazyflie_gym._native import PARTS


def need(part: str) -> None:
    """Raise an ImportError that names the missing part and how to get it, if it is not built in."""
    if not dict(PARTS)[part]:
        raise ImportError(
            f"crazyflie_gym was built without the part {part!r}: pip install crazyflie-gym brings the whole of it, "
            f"and a build of your own takes the cargo feature {part}"
        )
