"""How the tests are run, and what they are run for."""

import os

# Three processes share two cores: a network whose threads wait for each other takes four times as long.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import pytest
from hypothesis import settings

from common import IDS

# helpers that assert
pytest.register_assert_rewrite("crazyflies", "deployments")

# the same cases in every run, and no folder of past cases
settings.register_profile("repository", database=None, derandomize=True)
settings.load_profile("repository")


@pytest.fixture(params=IDS)
def env_id(request):
    """Every registered id."""
    return request.param
