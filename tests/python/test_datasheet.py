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


VEHICLES = [vehicle["name"] for vehicle in cf.vehicles()]


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("vertical", ["thrust", "motors"])
def test_every_vehicle_hovers_with_every_controller(vehicle, vertical):
    options = {"vehicle": vehicle, "vertical": vertical, "task_options": {"start_radius_m": 0.3}}
    for name in ("thesis-pid", "lqr", "velocity", "mpc"):
        envs = cf.CrazyflieVectorEnv(4, "hover", max_episode_steps=-1, **options)
        controller = envs.controller(name)
        envs.reset(seed=1)
        for _ in range(400):
            _, _, terminated, _, _ = envs.step(envs.act(controller))
            assert not terminated.any(), name
        position = envs.sim.states()[:, :3]
        assert np.abs(position - [0, 0, 0.7]).max() < 0.08, (name, position)


def test_a_name_a_file_and_a_text_are_the_same_vehicle(tmp_path):
    text = cf.model_text("cf21-brushless")
    Path(tmp_path, "own.toml").write_text(text)
    flown = []
    for model in (
        {"vehicle": "cf21-brushless"},
        {"model": "cf21-brushless"},
        {"model": text},
        {"model": tmp_path / "own.toml"},
    ):
        env = gym.make("Crazyflie-v0", **model)
        env.reset(seed=3)
        flown.append(env.step(np.float32([0.1, 0.2, 0.0, 0.3]))[0])
    for row in flown[1:]:
        np.testing.assert_array_equal(row, flown[0])


def test_a_strange_vehicle_is_refused_with_a_proposal():
    with pytest.raises(ValueError, match='did you mean "cf21-plus"'):
        gym.make("Crazyflie-v0", vehicle="cf21-plu")
    with pytest.raises(ValueError, match="got an empty string"):
        gym.make("Crazyflie-v0", vehicle="")
    with pytest.raises(ValueError, match="give one of the two"):
        gym.make("Crazyflie-v0", vehicle="cf21", model="cf21")
