"""Fly a controller on a real Crazyflie, or on one of `crazyflie cf2`, over cflib.

The command `crazyflie deploy` does this; in Python::

    from crazyflie_gym.deploy import Settings, deploy

    summary = deploy(Settings("radio://0/80/2M/E7E7E7E7E7", controller="lqr"))
    print(summary["reason"], summary["log"])

The vehicle's own commander takes off and lands. In between the controller flies at the rate of its model, on the
vehicle's clock: a sample of the vehicle is a tick. Needs cflib: `pip install "crazyflie-gym[cflib]"`.
"""

from __future__ import annotations

from crazyflie_gym._parts import need
from crazyflie_gym.deploy.command import deploy, main
from crazyflie_gym.deploy.poses import Pose
from crazyflie_gym.deploy.settings import DeployError, Settings

need("crazyflies")

__all__ = ["DeployError", "Pose", "Settings", "deploy", "main"]
