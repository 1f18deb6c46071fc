"""Trained in a minute, a policy beats the thesis's PID on unseen seeds. Needs the extra `train`."""

import dataclasses
import time

import numpy as np
import pytest

pytest.importorskip("jax", reason="JAX is not installed (extra train): training is not tested")

from safetensors.numpy import load_file, save_file

from crazyflie_gym import CrazyflieVectorEnv
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.policy import Pilot, Policy
from crazyflie_gym.ppo import Trainer, paired, paired_table
from crazyflie_gym.training import LAB, OBSERVED, RANDOMISED, TASKS

FLOWN = {
    "hover": Scenario(ticks=500, effects=LAB, task_options={"start_radius_m": 0.8, "start_yaw_deg": 20.0}),
    "fly-80cm": Scenario(ticks=750, effects=LAB, task_options={"start_m": [0.8, 0.0, 0.7]}),
}
UNSEEN = 10**9


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy trained as `python -m crazyflie_gym.ppo hover` does it, a quarter as long, as a file."""
    start = time.perf_counter()
    trained = Trainer(dataclasses.replace(TASKS["hover"], iterations=20)).train()
    print(f"trained in {time.perf_counter() - start:.1f} s: {trained.seconds}")
    path = tmp_path_factory.mktemp("trained") / "hover.safetensors"
    trained.policy.save(path)
    return path


def beats(controller, scenario):
    """Whether a controller has the higher reward and the smaller error than the PID, and never fails; prints both."""
    pid, ours = (fly(Work.of(scenario, name, UNSEEN, 128)) for name in ("thesis-pid", controller))
    for name, flights in (("PID", pid), (controller, ours)):
        print(f"{name}: reward {median(flights, 'reward'):.3f}, RMS error {100 * median(flights, 'rmse_m'):.1f} cm")
    better = median(ours, "reward") > median(pid, "reward") and median(ours, "rmse_m") < median(pid, "rmse_m")
    return better and not any(flight["failed"] for flight in ours)


@pytest.mark.parametrize("scenario", FLOWN.values(), ids=FLOWN)
def test_it_beats_the_pid_on_unseen_seeds(policy, scenario):
    assert beats(f"policy:{policy}", scenario)


def test_by_late_commands_it_beats_every_controller_of_feedback(tmp_path):
    """The recipe of the page, half as long; the regulator that it begins as has the best weights for it."""
    config = dataclasses.replace(TASKS["delayed-track"], iterations=90, averaged=0.2)
    Trainer(config).train().policy.save(tmp_path / "late.safetensors")
    ours, *rivals = paired(config, str(tmp_path / "late.safetensors"), first_seed=UNSEEN)
    print(paired_table([ours, *rivals]))
    assert {row["controller"] for row in rivals} > {"lqr", "mpc", "velocity", "lqr, as imitated"}
    assert ours["failed"] == 0 and all(row["p_value"] < 0.01 for row in rivals)


def rmse_m(controller, scenario):
    """The median RMS error of unseen flights."""
    return median(fly(Work.of(scenario, controller, UNSEEN, 64)), "rmse_m")


def test_it_begins_as_the_controller_that_it_imitates(tmp_path):
    trainer = Trainer(dataclasses.replace(TASKS["hover"], envs=512))
    trainer.imitate()
    trainer.policy().save(tmp_path / "young.safetensors")
    scenario = FLOWN["hover"]
    young, lqr = (rmse_m(name, scenario) for name in (f"policy:{tmp_path / 'young.safetensors'}", "lqr"))
    assert abs(young / lqr - 1) < 0.05


def test_without_a_controller_to_imitate_and_without_training_it_is_worse(tmp_path):
    trainer = Trainer(dataclasses.replace(TASKS["hover"], envs=128))
    trainer.policy().save(tmp_path / "none.safetensors")
    assert rmse_m(f"policy:{tmp_path / 'none.safetensors'}", FLOWN["fly-80cm"]) > 2 * rmse_m("lqr", FLOWN["fly-80cm"])


def test_the_same_seed_trains_the_same_policy():
    small = dataclasses.replace(TASKS["track"], iterations=3, envs=128, effects=RANDOMISED, seed=3)
    first, second = (Trainer(small).train() for _ in range(2))
    assert first.rewards == second.rewards
    for a, b in zip(first.policy.layers, second.policy.layers, strict=True):
        assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])
    other = Trainer(dataclasses.replace(small, seed=4)).train()
    assert not np.array_equal(first.policy.layers[0][0], other.policy.layers[0][0])


def test_rust_flies_what_python_trained(policy):
    envs = CrazyflieVectorEnv(
        37, vertical="pwm", effects=RANDOMISED, autoreset_mode="same_step", max_episode_steps=150,
        task_options={"start_yaw_deg": 180.0}, observation=OBSERVED,
    )  # fmt: skip
    rust, jax = envs.controller(f"policy:{policy}"), Pilot(Policy.load(policy), 37, envs.interface)
    rows, worst = envs.reset(seed=5)[0], 0.0
    for _ in range(500):
        actions = envs.act(rust)
        worst = max(worst, float(np.abs(actions - jax.act(rows)).max()))
        rows, _, terminated, truncated, _ = envs.step(actions)
        for pilot in (rust, jax):
            pilot.reset(terminated | truncated)
    print(f"largest difference of two actions over a flight: {worst:.1e}")
    assert worst < 1e-5


def test_a_file_is_what_was_saved(policy, tmp_path):
    loaded = Policy.load(policy)
    loaded.save(tmp_path / "again.safetensors")
    before, after = load_file(policy), load_file(tmp_path / "again.safetensors")
    assert before.keys() == after.keys() and all(np.array_equal(before[name], after[name]) for name in before)
    assert np.allclose(loaded.taus_s, TASKS["hover"].taus_s) and loaded.tick_s == 0.02


def test_other_files_are_refused(policy, tmp_path):
    bad, envs = tmp_path / "bad.safetensors", CrazyflieVectorEnv(2, vertical="pwm")
    save_file(load_file(policy), bad, {"format": "another"})
    with pytest.raises(ValueError, match="another"):
        Policy.load(bad)
    with pytest.raises(ValueError, match='controller policy: the file of the policy: its format is "another"'):
        envs.controller(f"policy:{bad}")
    with pytest.raises(ValueError, match="expected the vertical form pwm or thrust"):
        CrazyflieVectorEnv(2, vertical="height").controller(f"policy:{policy}")
