"""The command line: `crazyflie` or `python -m crazyflie_gym`."""

import signal
import sys

from crazyflie_gym._native import cli


def main() -> int:
    """Run the command line with the arguments of this process and return the exit status."""
    # Python would only note an interrupt, and act on it after the native call
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return cli(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
