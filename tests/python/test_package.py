"""The package as it is installed: types, stubs, command line, files."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

from common import LIMIT_S
from crazyflie_gym import _native

ROOT = Path(__file__).parents[2]


def run(*args, **kwargs):
    return subprocess.run(
        [sys.executable, *args], capture_output=True, text=True, timeout=2 * LIMIT_S, check=False, **kwargs
    )


def test_the_stubs_are_those_of_the_binary():
    pytest.importorskip("mypy")
    done = run("-m", "mypy.stubtest", "crazyflie_gym._native", "--mypy-config-file", ROOT / "pyproject.toml")
    assert done.returncode == 0, done.stdout + done.stderr


def test_everything_in_the_native_module_is_documented():
    for name in (
        "Interface",
        "Sim",
        "Controller",
        "Pid",
        "Crowd",
        "controllers",
        "metrics",
        "neighbour_fields",
        "observation_fields",
        "effects",
        "tasks",
        "track_rows",
        "render",
        "ansi",
        "path",
        "cli",
        "check_model",
        "model_text",
    ):
        assert getattr(_native, name).__doc__, name


def test_parts_are_the_features_of_wheel_and_program():
    tomllib = pytest.importorskip("tomllib")
    for crate in ("cli", "python_client"):
        features = tomllib.loads((ROOT / crate / "Cargo.toml").read_text())["features"]
        assert set(features["default"]) == features.keys() - {"default"} == {*dict(_native.PARTS), "postgres"}
    assert all(dict(_native.PARTS).values()), _native.PARTS


def test_only_numpy_and_gymnasium_are_required():
    required = [r for r in importlib.metadata.requires("crazyflie-gym") or [] if "extra ==" not in r]
    assert sorted(r.split(">")[0].split("=")[0] for r in required) == ["gymnasium", "numpy"]
    heavy = {"torch", "stable_baselines3", "jax", "ray", "tqdm"}
    loaded = run("-c", f"import sys, crazyflie_gym; print({heavy} & set(sys.modules))")
    assert loaded.stdout.split() == ["set()"], loaded.stderr


def test_every_path_that_contributing_names_exists():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    crates = [path.parent.name for path in ROOT.glob("*/Cargo.toml")] + ["tests", "docs", "examples"]
    folder, missing = ROOT, []
    for path in re.findall(r"`([\w./{},*-]+(?:/|\.rs|\.md|\.py|\.toml))`", text):
        if "NAME" in path or "..." in path:
            continue
        for word in re.findall(r"\{([^}]*)\}", path)[0].split(",") if "{" in path else [""]:
            named = re.sub(r"\{[^}]*\}", word, path)
            if named.split("/")[0] in crates:
                folder = (ROOT / named) if named.endswith("/") else (ROOT / named).parent
                found = [ROOT / named]
            else:
                # a name beside or below the path before it, or anywhere in the code
                found = [folder / named, *ROOT.glob(f"*/src/**/{named}"), *ROOT.glob(named)]
            if not any(place.exists() for place in found):
                missing.append(named)
    assert not missing


def test_the_command_line_runs():
    done = run("-m", "crazyflie_gym", "--help")
    assert done.returncode == 0 and "Usage" in done.stdout, done.stdout + done.stderr
    assert run("-m", "crazyflie_gym", "no-such-command").returncode != 0


def test_the_command_line_waits_for_no_package():
    code = "import sys, crazyflie_cli; sys.argv[1:] = ['tasks']; crazyflie_cli.main(); print(list(sys.modules))"
    done = run("-c", code)
    assert done.returncode == 0 and "swap (CrazyflieSwap-v0)" in done.stdout
    for heavy in ("numpy", "gymnasium", "crazyflie_gym"):
        assert f"'{heavy}'" not in done.stdout


# these need a server: test_remote.py and test_shared.py run them against one
SERVED = {"remote_client.py", "submit_own.py", "swap_places.py"}
# test_jax_examples.py runs these, and looks at what they print
JAX = {"jax_hover_bptt.py", "jax_identify.py", "jax_ppo.py"}
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py") if path.name not in SERVED | JAX)


# examples that train for a minute or more are cut short
SHORT = {
    "4_train.py": ["--iterations", "10"],
    "sb3_ppo.py": ["--steps", "8192"],
    "torchrl_ppo.py": ["--steps", "8192"],
    "swarm_ppo.py": ["--steps", "8192", "--worlds", "8"],
    "rllib_make_vec.py": ["--iterations", "3", "--envs", "16"],
    "mppi.py": ["--ticks", "40", "--samples", "256"],
}
PRINTED = {"rllib_make_vec.py": r"iteration 2: mean return \d+\.\d"}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_examples_run(example, tmp_path):
    assert len(example.read_text().splitlines()) <= 100
    done = run(str(example), *SHORT.get(example.name, []), cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    if "SKIPPED" in done.stdout:
        pytest.skip(f"{example.name}: {done.stdout.strip()}")
    assert re.search(PRINTED.get(example.name, "."), done.stdout)
    if example.name[0].isdigit():
        assert list(tmp_path.glob(f"{example.stem}.*"))


def test_the_licences_that_a_release_prints_are_those_that_are_allowed():
    lists = [
        re.search(rf"{key} = \[(.*?)\]", (ROOT / path).read_text(), re.DOTALL)[1]
        for path, key in (("deny.toml", "allow"), (".github/about.toml", "accepted"))
    ]
    assert lists[0] == lists[1]


def test_raptor_hovers_on_vehicles_by_name(tmp_path):
    done = run(str(ROOT / "examples/raptor.py"), cwd=tmp_path)
    far = dict(re.findall(r"(\S+): .* ([\d.]+) m in the last second", done.stdout))
    assert set(far) == {"cf21", "cf21-brushless"} and all(float(metres) < 0.05 for metres in far.values()), done.stderr
