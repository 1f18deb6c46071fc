"""RLlib's way to its environments. The example `rllib_make_vec.py` trains, which test_package.py runs."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList


@pytest.mark.parametrize("env_config", [{}, {"effects": {"drag_linear": 0.3}, "true_state": True}])
def test_what_its_env_runner_does(env_config):
    """`SingleAgentEnvRunner.make_env` and `sample`: make_vec by name, infos as lists, actions as a list of rows."""
    mode = gym.VectorizeMode("vector_entry_point")
    # the module before the colon is imported in every worker
    made = gym.make_vec(
        "crazyflie_gym:Crazyflie-v0", num_envs=3, vectorization_mode=mode, max_episode_steps=5, **env_config
    )
    envs = DictInfoToList(made)
    assert envs.num_envs == 3 and made.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    obs, infos = envs.reset(seed=None, options=None)
    assert len(infos) == 3
    ended = np.zeros(3, bool)
    for _ in range(20):
        actions = [made.single_action_space.sample() for _ in range(3)]
        obs, rewards, terminated, truncated, infos = envs.step(actions)
        assert len(infos) == 3 and made.observation_space.contains(obs)
        assert all(("true_state" in info) == ("true_state" in env_config) for info in infos)
        # in the step after the end, RLlib takes the observation as the first of a new episode
        assert (rewards[ended] == 0).all() and not (terminated | truncated)[ended].any()
        ended = terminated | truncated
