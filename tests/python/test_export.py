"""A policy goes out as C, the same from Python and from the program, and what is wrong with it is said."""

import subprocess
import sys

import numpy as np
import pytest

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
