"""Trained policies as files that fly without Python, and as C for a microcontroller.

    from crazyflie_gym.export import export_policy, export_policy_c

    export_policy(PPO("MlpPolicy", gymnasium.make("Crazyflie-v0")).learn(100_000), "ppo.safetensors")
    source, header = export_policy_c("ppo.safetensors", "firmware/policy.c")

`crazyflie fly --controller policy:ppo.safetensors` flies the file, and so does everything that takes a controller.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from crazyflie_gym import _native
from crazyflie_gym.options import Model, model_sources
from crazyflie_gym.spaces import Choice, RowLayout

_ACTIVATIONS = {
    "Identity": "identity",
    "Tanh": "tanh",
    "ReLU": "relu",
    "ELU": "elu",
    "SiLU": "silu",
    "Sigmoid": "sigmoid",
}
"""Classes of torch, and the words of a policy file."""


class _Env(NamedTuple):
    """Facts of the environment that a policy was trained in."""

    observation: list[str]
    history: int
    others: int
    action: str
    vertical: str
    tick_s: float


class _Layer(NamedTuple):
    kind: dict[str, str]
    tensors: dict[str, NDArray[np.float32]]


def export_policy(
    model: Any,
    path: str | Path | None = None,
    *,
    observation: Choice | None = None,
    history: int | None = None,
    normalize: Any = None,
    env: Any = None,
    action: str | None = None,
    vertical: str | None = None,
    others: int | None = None,
    tick_s: float | None = None,
    estimated: bool = False,
    note: str = "",
) -> bytes:
    """Return the file of a policy, and write it to `path`, so that it flies without Python wherever a controller does.

    Missing arguments are read from the environment that the model was trained in, or from `env`. The policy answers
    with its mean, cut off at -1 and 1, as `model.predict(rows, deterministic=True)` does.

    Args:
        model: PPO, A2C, SAC, TD3 or DDPG of Stable-Baselines3; a `torch.nn.Sequential`; or a list of layers, from first
            to last. A layer is a module of torch (`Linear`, `GRUCell`, Tanh, ReLU, ELU, SiLU, Sigmoid), or a dict:
            {"kernel": (inputs, outputs), "bias": (outputs,), "activation": "tanh"} as of Flax, with "weight" (outputs,
            inputs) for "kernel" as of torch, or "weight_ih", "weight_hh", "bias_ih", "bias_hh" of a `GRUCell`.
        path: where to write it, a path that ends in .safetensors.
        observation: contents of the rows, as of `EnvOptions`.
        history: ticks of a row.
        normalize: a `VecNormalize`, or (mean, standard deviation) of the rows. Default: that of the environment.
        env: an environment of this package, within wrappers or not.
        action: which level an action sets.
        vertical: which vertical form it commands.
        others: how many other drones have fields in a row, behind the own.
        tick_s: seconds from one action to the next.
        estimated: read the Kalman filter's estimate in place of the true state, which vehicles and ranked attempts
            lack.
        note: how it was trained, kept in the file.

    Raises:
        ValueError: naming what is missing or does not fit.
        TypeError: for a model that is none of these.
        ModuleNotFoundError: without safetensors, which the extras `sb3` and `train` bring.
    """
    try:
        from safetensors.numpy import save
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f'{error}; pip install "crazyflie-gym[sb3]" brings it', name=error.name) from None
    if path is not None and Path(path).suffix != ".safetensors":
        raise ValueError(f"{path}: expected a path that ends in .safetensors")
    trained_in = env if env is not None else model.get_env() if hasattr(model, "get_env") else None
    known = _known(_inner(trained_in, observation is not None))
    given = {"history": history, "action": action, "vertical": vertical, "others": others, "tick_s": tick_s}
    known |= {name: value for name, value in given.items() if value is not None}
    if observation is not None:
        known["observation"] = [field["name"] for field in RowLayout(observation).fields]
    missing = [name for name in _Env._fields if name not in known]
    if missing:
        raise ValueError(f"{', '.join(missing)}: not known; give them, or an environment as env=")
    trained = _Env(**known)
    names = _native.estimated_fields(trained.observation) if estimated else trained.observation
    mean, std, clip = _normalisation(trained_in, normalize, _width(trained))
    layers = _layers(model)
    tensors = {"observation_mean": mean, "observation_std": std}
    for number, layer in enumerate(layers):
        tensors |= {f"layer{number}.{name}": tensor for name, tensor in layer.tensors.items()}
    about = trained._replace(observation=names)._asdict()
    words = {name: value if isinstance(value, str) else json.dumps(value) for name, value in about.items()}
    words |= {"format": "crazyflie-policy-3", "clip": json.dumps(clip), "note": note}
    words["layers"] = json.dumps([layer.kind for layer in layers])
    content = save({name: np.ascontiguousarray(tensor, np.float32) for name, tensor in tensors.items()}, words)
    _check(content, trained)
    if path is not None:
        Path(path).write_bytes(content)
    return content


def _width(trained: _Env) -> int:
    """Return how many numbers the policy reads."""
    drones = trained.others + 1 if trained.others else None
    return RowLayout(trained.observation, trained.history, drones).width


def _known(env: Any) -> dict[str, Any]:
    """Return the facts of an environment; nothing without one."""
    if env is None:
        return {}
    env = getattr(env, "unwrapped", env)
    env = getattr(env, "swarm", env)
    layout = getattr(env, "_layout", None) or getattr(env, "layout", None)
    if not isinstance(layout, RowLayout):
        raise ValueError(f"env: expected an environment of crazyflie_gym, got {type(env).__name__}")
    interface = env.sim.interface
    return {
        "observation": [field["name"] for field in layout.fields],
        "history": layout.history,
        "others": 0 if layout.drones is None else layout.drones - 1,
        "action": interface.action,
        "vertical": interface.vertical,
        "tick_s": interface.tick_s,
    }


def _inner(env: Any, is_told: bool) -> Any:
    """Return the environment within those of Stable-Baselines3 and the wrappers of Gymnasium; None if it has none here.

    Raises:
        ValueError: for a wrapper that changes observations or actions, unless it `is_told` what the policy reads.
    """
    while hasattr(env, "venv"):
        env = env.venv
    if hasattr(env, "get_attr"):
        # environments of Stable-Baselines3; None if they run in other processes
        env = getattr(env, "envs", None)
        env = env[0] if isinstance(env, list) else env
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.ObservationWrapper | gym.ActionWrapper) and not is_told:
            raise ValueError(
                f"{type(env).__name__} changes what the policy reads or commands: give observation= and normalize=, or "
                "train without it"
            )
        env = env.env
    return env


def _normalisation(
    env: Any, normalize: Any, width: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], float | None]:
    """Return mean and standard deviation of the rows, and where they are cut off."""
    while normalize is None and hasattr(env, "venv"):
        normalize, env = (env if hasattr(env, "obs_rms") else None), env.venv
    if normalize is None or getattr(normalize, "norm_obs", True) is False:
        return np.zeros(width, np.float32), np.ones(width, np.float32), None
    clip = None
    if hasattr(normalize, "obs_rms"):
        rms, clip = normalize.obs_rms, float(normalize.clip_obs)
        mean, std = rms.mean, np.sqrt(rms.var + normalize.epsilon)
    else:
        mean, std = normalize
    mean, std = np.asarray(mean, np.float32), np.asarray(std, np.float32)
    for name, numbers in (("mean", mean), ("standard deviation", std)):
        if numbers.shape != (width,):
            raise ValueError(f"normalize: the {name} has the shape {numbers.shape}, expected ({width},)")
    return mean, std, clip


def _layers(model: Any) -> list[_Layer]:
    """Return the layers of a model.

    Raises:
        TypeError: for what is no model, or a layer that no policy file has.
    """
    layers: list[_Layer] = []
    for part in _parts(model):
        kind = _ACTIVATIONS.get(type(part).__name__)
        if kind is None:
            layers.append(_layer(part))
        elif kind != "identity":
            if not layers or layers[-1].kind.get("activation", "") != "identity":
                raise TypeError(f"{type(part).__name__}: expected behind a dense layer")
            layers[-1] = layers[-1]._replace(kind={"kind": "dense", "activation": kind})
    return layers


def _parts(model: Any) -> list[Any]:
    """Return modules and layers, from first to last."""
    if isinstance(model, list | tuple):
        return [part for each in model for part in _parts(each)]
    if hasattr(model, "policy") and hasattr(model, "predict"):
        return _sb3_parts(model)
    if type(model).__name__ == "Sequential":
        return [part for each in model for part in _parts(each)]
    return [model]


def _sb3_parts(model: Any) -> list[Any]:
    """Return the modules between an observation and the mean action of a model of Stable-Baselines3."""
    from torch import nn

    policy = model.policy
    actor = getattr(policy, "actor", policy)
    extractor = getattr(actor, "features_extractor", None) or getattr(policy, "features_extractor", None)
    if extractor is not None and type(extractor).__name__ != "FlattenExtractor":
        raise TypeError(f"{type(extractor).__name__}: expected flat rows, which MlpPolicy reads")
    if hasattr(actor, "latent_pi"):
        return _parts([actor.latent_pi, actor.mu, nn.Tanh()])
    if hasattr(actor, "mu"):
        return _parts([actor.mu])
    if hasattr(policy, "mlp_extractor") and not hasattr(policy, "lstm_actor"):
        squashed = [nn.Tanh()] if policy.squash_output else []
        return _parts([policy.mlp_extractor.policy_net, policy.action_net, *squashed])
    raise TypeError(f"{type(policy).__name__}: expected the policy of PPO, A2C, SAC, TD3 or DDPG")


def _layer(part: Any) -> _Layer:
    """Return a dense or a recurrent layer."""
    named = part if isinstance(part, Mapping) else dict(_parameters(part))
    tensors = {name: _numbers(value) for name, value in named.items() if name != "activation"}
    if set(tensors) == {"weight_ih", "weight_hh", "bias_ih", "bias_hh"}:
        names = {"weight": "weight_ih", "recurrent_weight": "weight_hh", "bias": "bias_ih", "recurrent_bias": "bias_hh"}
        return _Layer({"kind": "gru"}, {new: tensors[old].T for new, old in names.items()})
    activation = str(named.get("activation", "identity")) if isinstance(part, Mapping) else "identity"
    if set(tensors) == {"kernel", "bias"}:
        return _Layer(
            {"kind": "dense", "activation": activation}, {"weight": tensors["kernel"], "bias": tensors["bias"]}
        )
    if set(tensors) == {"weight", "bias"}:
        return _Layer({"kind": "dense", "activation": activation}, tensors | {"weight": tensors["weight"].T})
    got = ", ".join(tensors) or "no tensors"
    raise TypeError(f"{type(part).__name__} with {got}: expected a dense layer, a GRUCell or an activation")


def _parameters(part: Any) -> Sequence[tuple[str, Any]]:
    if not hasattr(part, "named_parameters"):
        raise TypeError(
            f"model: expected a model of Stable-Baselines3, a torch.nn.Sequential or a list of layers, got "
            f"{type(part).__name__}"
        )
    return list(part.named_parameters())


def _numbers(value: Any) -> NDArray[np.float32]:
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    return np.asarray(value, np.float32)


def _check(content: bytes, trained: _Env) -> None:
    """Raise what is wrong with a file, as whoever flies it would."""
    if abs(trained.tick_s - 0.02) > 1e-9 or trained.action not in ("attitude", "velocity", "position"):
        return
    options = json.dumps({"vertical": trained.vertical, "action": trained.action})
    sim = _native.Sim(1, options, [_native.model_text()])
    _native.Controller("policy:export.safetensors", 1, sim, file=content)


def export_policy_c(
    policy: str | Path, out: str | Path, *, model: Model = None, vertical: str | None = None
) -> tuple[Path, Path]:
    """Write a policy as C, single precision without allocation, and return the paths of source and header.

    The header gives the places of an observation's fields, in SI units, and what an action, float32 (4,) from -1 to 1,
    commands.

    Args:
        policy: its file, as `export_policy` or `crazyflie_gym.ppo` writes it.
        out: where to write, a path that ends in .c; the header goes beside it.
        model: of the vehicle, as of `CrazyflieEnv`; the thesis's unless given.
        vertical: which vertical form is commanded. Default: the policy's, or else "pwm".

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
