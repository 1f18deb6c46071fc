"""A policy goes out as a file that flies without Python and as C, and what is wrong with it is said."""

import json
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflie_gym import CrazyflieSwarm, CrazyflieVectorEnv, export_policy
from crazyflie_gym.benchmark import submit
from crazyflie_gym.export import export_policy_c

save_file = pytest.importorskip("safetensors.numpy").save_file
PROGRAM = "import sys, crazyflie_cli; sys.exit(crazyflie_cli.main())"


@pytest.fixture
def policy(tmp_path):
    """A network of one layer with one time constant, that answers zeros."""
    file = tmp_path / "zero.safetensors"
    width = 19 + 12
    tensors = {
        "taus_s": [0.2],
        "feature_mean": [0.0] * width,
        "feature_std": [1.0] * width,
        "skip.weight": [[0.0] * 4] * width,
        "layer0.weight": [[0.0] * 4] * width,
        "layer0.bias": [0.0] * 4,
    }
    plain = {name: np.array(value, np.float32) for name, value in tensors.items()}
    save_file(plain, file, {"format": "crazyflie-policy-2", "tick_s": "0.02"})
    return file


def test_python_and_the_program_write_the_same(policy, tmp_path):
    source, header = export_policy_c(policy, tmp_path / "policy.c")
    other = tmp_path / "other"
    run = [sys.executable, "-c", PROGRAM, "policy", "export-c", policy, "-o", other / "policy.c"]
    subprocess.run(run, check=True, capture_output=True)
    for path in (source, header):
        assert path.read_bytes() == (other / path.name).read_bytes()
    assert "POLICY_EST_VEL_MPS" in header.read_text() and "malloc" not in source.read_text()
    assert '#include "policy.h"' in source.read_text()
    subprocess.run(["cc", "-std=c99", "-Wall", "-Werror", "-c", source, "-o", tmp_path / "policy.o"], check=True)


def test_what_cannot_be_written_is_said(policy, tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.c"):
        export_policy_c(policy, tmp_path / "policy.cpp")
    with pytest.raises(ValueError, match="it commands a thrust"):
        export_policy_c(policy, tmp_path / "policy.c", vertical="height")
    with pytest.raises(ValueError, match='did you mean "pwm"'):
        export_policy_c(policy, tmp_path / "policy.c", vertical="pvm")
    (tmp_path / "none").write_bytes(b"no policy at all")
    with pytest.raises(ValueError, match="the file of the policy"):
        export_policy_c(tmp_path / "none", tmp_path / "policy.c")
    run = [sys.executable, "-c", PROGRAM, "policy", "export-c", policy, "-o", tmp_path / "policy.h"]
    done = subprocess.run(run, capture_output=True, text=True)
    assert done.returncode == 2 and "name a file that ends in .c" in done.stderr
    assert not list(tmp_path.glob("policy.*"))


def flown(file, answer, envs, ticks=10, reset_at=None):
    """The largest difference between the policy of a file, flown in a batch, and an answer to its observations.

    Actions are drawn, so that observations are spread; some flights begin anew before the tick `reset_at`.
    """
    pilot, rng = envs.controller(f"policy:{file}"), np.random.default_rng(0)
    rows, _ = envs.reset(seed=5)
    worst, largest = 0.0, 0.0
    for tick in range(ticks):
        begun = np.zeros(envs.num_envs, bool)
        if tick == reset_at:
            begun[::3] = True
            rows, _ = envs.reset(options={"reset_mask": begun})
            pilot.reset(begun)
        wanted, actions = answer(rows, begun), envs.act(pilot)
        worst, largest = max(worst, np.abs(actions - wanted).max()), max(largest, np.abs(wanted).max())
        rows, *_ = envs.step(rng.uniform(-0.3, 0.3, actions.shape).astype(np.float32))
    assert 0.3 < largest <= 1.0, "answers that say something"
    return worst


def loud(model):
    """The model with other weights: those of a beginner answer about zero."""
    init = pytest.importorskip("torch.nn.init")
    for weights in model.policy.parameters():
        if weights.ndim == 2:
            init.kaiming_uniform_(weights, a=1.0)
    return model


def contents(file):
    """What the bytes of a policy hold: their order is not always the same."""
    length = int.from_bytes(file[:8], "little")
    header = json.loads(file[8 : 8 + length])
    about = header.pop("__metadata__")
    places = {name: slice(*(8 + length + at for at in entry["data_offsets"])) for name, entry in header.items()}
    return about, {name: (header[name]["shape"], file[place]) for name, place in places.items()}


ALGORITHMS = ["PPO", "A2C", "SAC", "TD3", "DDPG"]


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_policy_of_stable_baselines_flies_as_it_predicts(name, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    small = {"n_steps": 64} if name in ("PPO", "A2C") else {"buffer_size": 10}
    model = loud(getattr(sb3, name)("MlpPolicy", gym.make("Crazyflie-v0"), device="cpu", seed=0, **small))
    file = tmp_path / "policy.safetensors"
    assert export_policy(model, file, note="untrained") == file.read_bytes()
    envs = CrazyflieVectorEnv(100, autoreset_mode="disabled")
    assert flown(file, lambda rows, _: model.predict(rows, deterministic=True)[0], envs) < 1e-5


@pytest.mark.parametrize("extra", [{}, {"observation": "estimate", "history": 3, "action": "velocity"}])
def test_normalised_rows_and_other_observations(extra, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
    from torch import nn

    from crazyflie_gym.sb3 import Sb3VecEnv

    envs = VecNormalize(VecMonitor(Sb3VecEnv("Crazyflie-v0", 16, **extra)), norm_reward=False, clip_obs=3.0)
    arch = {"net_arch": [64, 64], "activation_fn": nn.ReLU}
    model = sb3.PPO("MlpPolicy", envs, n_steps=16, batch_size=64, n_epochs=1, device="cpu", seed=0, policy_kwargs=arch)
    loud(model.learn(2 * 16 * 16))
    envs.training = False
    file, same = tmp_path / "policy.safetensors", tmp_path / "same.safetensors"
    export_policy(model, file)

    def answer(rows, _):
        return model.predict(envs.normalize_obs(rows), deterministic=True)[0]

    batch = CrazyflieVectorEnv(100, autoreset_mode="disabled", **extra)
    assert flown(file, answer, batch) < 1e-5
    # a model that was loaded has no environment: one within wrappers tells everything too
    model.save(tmp_path / "model.zip")
    loaded = sb3.PPO.load(tmp_path / "model.zip", device="cpu")
    export_policy(loaded, same, env=envs)
    assert contents(same.read_bytes()) == contents(file.read_bytes())


def test_layers_with_a_memory_fly_as_torch_answers(tmp_path):
    torch = pytest.importorskip("torch")
    from torch import nn

    torch.manual_seed(0)
    layers = [nn.Linear(24, 32), nn.SiLU(), nn.GRUCell(32, 16), nn.Linear(16, 4)]
    with torch.no_grad():
        layers[3].weight *= 4.0
    envs = CrazyflieVectorEnv(20, autoreset_mode="disabled")
    file = tmp_path / "gru.safetensors"
    export_policy(layers, file, env=envs)
    memory = torch.zeros(20, 16)

    def answer(rows, begun):
        nonlocal memory
        memory[torch.from_numpy(begun)] = 0.0
        with torch.no_grad():
            memory = layers[2](layers[1](layers[0](torch.from_numpy(rows))), memory)
            return layers[3](memory).clamp(-1.0, 1.0).numpy()

    assert flown(file, answer, envs, ticks=50, reset_at=20) < 1e-5
    # the same as numbers, as of Flax and of torch
    dense, out = (layer.state_dict() for layer in (layers[0], layers[3]))
    kernel = {"kernel": dense["weight"].T, "bias": dense["bias"], "activation": "silu"}
    for same in ([kernel, layers[2].state_dict(), out], nn.Sequential(*layers)):
        assert contents(export_policy(same, env=envs)) == contents(file.read_bytes())


def test_the_drones_of_a_swarm_share_a_policy(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from crazyflie_gym.sb3 import Sb3SwarmVecEnv

    drones = {"drones": 3, "observation": ["error_m", "vel_mps"], "max_episode_steps": 60}
    envs = Sb3SwarmVecEnv("formation", 2, **drones)
    model = loud(sb3.PPO("MlpPolicy", envs, n_steps=16, batch_size=32, device="cpu", seed=0))
    file = tmp_path / "shared.safetensors"
    export_policy(model, file)
    worlds = CrazyflieSwarm(20, "formation", autoreset_mode="disabled", **drones)
    pilot = worlds.controller(f"policy:{file}", avoid=False)
    rows, _ = worlds.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        wanted, _ = model.predict(rows.reshape(60, -1), deterministic=True)
        assert np.abs(worlds.act(pilot) - wanted.reshape(20, 3, 4)).max() < 1e-5
        rows, *_ = worlds.step(rng.uniform(-0.1, 0.1, (20, 3, 4)).astype(np.float32))
    assert np.abs(wanted).max() > 0.3
    with pytest.raises(ValueError, match="it reads fields of 2 other drones; fly it where there are 3 drones"):
        alone = CrazyflieVectorEnv(2)
        alone.reset(seed=0)
        alone.act(alone.controller(f"policy:{file}"))


def test_what_reads_estimates_flies_ranked_attempts(tmp_path):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    layer, file, data = torch.nn.Linear(24, 4), tmp_path / "policy.safetensors", tmp_path / "bench.sqlite"
    env = gym.make("Crazyflie-v0", vertical="pwm")
    export_policy(layer, file, env=env)
    with pytest.raises(ValueError, match=r"reads the true state.*estimated=True"):
        submit(f"policy:{file}", "fly-80cm", data=data)
    export_policy(layer, file, env=env, estimated=True)
    (row,) = submit(f"policy:{file}", "fly-80cm", data=data)
    assert row["status"] == "finished"
    export_policy(layer, file, env=gym.make("Crazyflie-v0"), estimated=True)
    with pytest.raises(ValueError, match="it commands the vertical form height, and pwm is asked for"):
        submit(f"policy:{file}", "fly-80cm", data=data)


def test_the_program_flies_it_as_it_was_trained(tmp_path):
    torch = pytest.importorskip("torch")
    file, layer = tmp_path / "policy.safetensors", torch.nn.Linear(24, 4)
    # the vertical form and the level of the actions are those of the file
    for options in ({}, {"vertical": "pwm"}, {"action": "velocity"}):
        export_policy(layer, file, env=gym.make("Crazyflie-v0", **options))
        run = [sys.executable, "-c", PROGRAM, "fly", "--json", "--seconds", "1", "--controller", f"policy:{file}"]
        done = subprocess.run(run, capture_output=True, text=True, timeout=LIMIT_S)
        assert done.returncode == 0, done.stderr
        assert len(json.loads(done.stdout)["runs"]) == 1


def test_what_a_policy_lacks_is_said(tmp_path):
    torch = pytest.importorskip("torch")
    sb3 = pytest.importorskip("stable_baselines3")

    class Half(gym.ObservationWrapper):
        def observation(self, row):
            return 0.5 * row

    layer, env = torch.nn.Linear(24, 4), crazyflie_gym.CrazyflieEnv()
    small = {"n_steps": 64, "device": "cpu"}
    halved = sb3.PPO("MlpPolicy", Half(gym.make("Crazyflie-v0")), **small)
    with pytest.raises(ValueError, match="Half changes what the policy reads"):
        export_policy(halved)
    assert export_policy(halved, observation="state", normalize=(np.zeros(24), np.full(24, 2.0)))
    with pytest.raises(ValueError, match="observation, history, others, action, vertical, tick_s: not known"):
        export_policy(layer)
    with pytest.raises(ValueError, match=r"^history, others, vertical, tick_s: not known"):
        export_policy(layer, observation="state", action="attitude")
    told = {"observation": "state", "action": "attitude", "history": 1, "others": 0, "vertical": "pwm"}
    by_env = export_policy(layer, env=gym.make("Crazyflie-v0", vertical="pwm"))
    assert contents(export_policy(layer, **told, tick_s=0.02)) == contents(by_env)
    for wrong, options, words in [
        (torch.nn.Linear(23, 4), {}, r"layer0 has weights \[23, 4\].*expected 24 inputs"),
        (torch.nn.Linear(24, 3), {}, "layers end in 3 numbers, expected 1 to 8 that end in 4"),
        (layer, {"normalize": (np.zeros(24), np.ones(23))}, r"the standard deviation has the shape \(23,\)"),
        (layer, {"observation": "stat"}, 'did you mean "state"'),
        (layer, {"vertical": "pvm"}, r'unknown vertical form "pvm" \(did you mean "pwm"'),
        (layer, {"path": tmp_path / "policy.zip"}, r"ends in \.safetensors"),
        (layer, {"env": gym.make("CartPole-v1")}, "expected an environment of crazyflie_gym, got CartPoleEnv"),
    ]:
        with pytest.raises(ValueError, match=words):
            export_policy(wrong, **({"env": env} | options))
    for wrong, words in [
        ("hover", "got str"),
        ([torch.nn.Conv1d(1, 1, 1), torch.nn.Dropout()], "Dropout with no tensors"),
        ([torch.nn.Tanh(), layer], "Tanh: expected behind a dense layer"),
        (sb3.PPO("MultiInputPolicy", gym.make("Crazyflie-v0", form="dict"), **small), "expected flat rows"),
        (sb3.DQN("MlpPolicy", gym.make("CartPole-v1"), buffer_size=10, device="cpu"), "PPO, A2C, SAC, TD3 or DDPG"),
    ]:
        with pytest.raises(TypeError, match=words):
            export_policy(wrong, env=env)
    assert not list(tmp_path.iterdir())
