"""The program `crazyflie`: the command line in Rust, without a wait for the packages that environments need."""

import signal
import sys
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, PathFinder
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

_NAME = "crazyflie_gym._native"


def _native() -> ModuleType:
    """Return the native module, loaded without its package, which imports Gymnasium and NumPy."""
    package = PathFinder.find_spec("crazyflie_gym")
    for folder in (package and package.submodule_search_locations) or []:
        for suffix in EXTENSION_SUFFIXES:
            file = Path(folder) / f"_native{suffix}"
            spec = spec_from_loader(_NAME, ExtensionFileLoader(_NAME, str(file))) if file.exists() else None
            if spec is not None and spec.loader is not None:
                module = module_from_spec(spec)
                # for the package, if a controller in Python imports it
                sys.modules[_NAME] = module
                spec.loader.exec_module(module)
                return module
    raise ImportError("crazyflie_gym is not installed, or without its native module")


def main() -> int:
    """Run the command line with the arguments of this process and return the exit status."""
    # Python would only note an interrupt, and act on it after the native call
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    status: int = _native().cli(sys.argv[1:])
    return status


if __name__ == "__main__":
    sys.exit(main())
