"""How the tests are run, and what they are run for."""

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
