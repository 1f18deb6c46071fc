"""The command line: `crazyflie` or `python -m crazyflie_gym`."""

import sys

from crazyflie_cli import main

if __name__ == "__main__":
    sys.exit(main())
