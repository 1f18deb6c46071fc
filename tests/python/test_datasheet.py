"""Models from data sheets."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym as cf

SHEET = Path(__file__).parents[2] / "examples" / "crazyflie_datasheet.toml"
VALUES = {
    "name": "my-crazyflie",
    "description": "Crazyflie 2.0 without camera",
    "attitude_loop": "crazyflie-firmware",
    "mass_kg": 0.028,
    "arm_m": 0.046,
    "tilt_inertia_kgm2": 1.657e-5,
    "yaw_inertia_kgm2": 2.926e-5,
    "motor": {"thrust_max_n": 0.1592, "thrust_linear_share": 0.4252, "lag_s": 0.0647},
    "propeller": {"radius_m": 0.0225, "torque_per_thrust_m": 5.96e-3},
    "battery": {"capacity_mah": 240, "hover_current_a": 2.1, "voltage_v": 4.2},
}


def climb_mps(model, steps=15):
    """Return the speed after full thrust on all motors."""
    env = gym.make("Crazyflie-v0", model=model, action="motors", true_state=True).unwrapped
    env.reset(seed=0)
    for _ in range(steps):
        *_, info = env.step(np.ones(4, np.float32))
    return float(info["true_state"][5])


def test_a_path_a_text_and_a_dict_say_the_same():
    text = SHEET.read_text()
    model = cf.model_from_datasheet(SHEET)
    assert cf.model_from_datasheet(text) == model == cf.model_from_datasheet(VALUES)
    assert cf.check_model(model) == "my-crazyflie"
    env = gym.make("Crazyflie-v0", model=model).unwrapped
    assert env.interface.vertical == "motors"
    level = {level["name"]: level for level in cf.action_levels(model)}["body_rates"]
    assert level["channels"][3]["high"] == 60000


def test_a_vehicle_of_50_g_flies_otherwise():
    light, heavy = (cf.model_from_datasheet(VALUES | {"mass_kg": mass}) for mass in (0.0368, 0.05))
    assert climb_mps(light) > 1.5 * climb_mps(heavy)


def test_what_is_missing_is_named():
    sheet = {name: value for name, value in VALUES.items() if name not in ("motor", "mass_kg")}
    sheet["motor"] = {name: value for name, value in VALUES["motor"].items() if name != "lag_s"}
    with pytest.raises(ValueError, match=r"no mass_kg \(mass as flown\), no motor.lag_s"):
        cf.model_from_datasheet(sheet)
    with pytest.raises(ValueError, match=r"there is no .*mass_kg"):
        cf.model_from_datasheet(SHEET.read_text().replace("mass_kg", "# mass_kg"))
    with pytest.raises(FileNotFoundError, match=r"nowhere\.toml"):
        cf.model_from_datasheet("nowhere.toml")
