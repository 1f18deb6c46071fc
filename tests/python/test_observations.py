"""What an observation may hold: what is measured, an estimate, the true state, named fields, the last few ticks."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import crazyflie_gym
from common import actions_for, random_actions
from crazyflie_gym import STATE_FIELDS
from crazyflie_gym.parallel import parallel_env

EFFECTS = {"camera_noise": {"xy_m": 0.004, "z_m": 0.008}, "camera_latency": 0.05, "gust": {"sigma_mps2": 0.3}}
CHOICES = [choice["name"] for choice in crazyflie_gym.observation_choices()]
FIELDS = ["error_m", "est_vel_mps", "attitude_rad", "gyro_radps", "last_action"]


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("observation", [*CHOICES, FIELDS])
def test_every_choice_is_a_gymnasium_observation(env_id, observation, form, history):
    options = {"observation": observation, "form": form, "history": history, "effects": EFFECTS}
    env = gym.make(env_id, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    envs = gym.make_vec(env_id, num_envs=3, **options)
    rows, _ = envs.reset(seed=5)
    single, _ = env.reset(seed=6)
    for actions in 0.2 * actions_for(envs.action_space, 12):
        assert envs.observation_space.contains(rows)
        second = {name: field[1] for name, field in rows.items()} if form == "dict" else {"": rows[1]}
        alone = single if form == "dict" else {"": single}
        assert all(np.array_equal(second[name], alone[name]) for name in second)
        rows, *_ = envs.step(actions)
        single, *_ = env.step(actions[1])


def test_the_state_is_info_true_state():
    envs = gym.make_vec("CrazyflieTrack-v0", num_envs=4, observation="state", form="dict", true_state=True)
    seen, info = envs.reset(seed=1)
    for actions in random_actions(40, 4, size=0.3):
        for name, at in STATE_FIELDS.items():
            if name != "att_rad":
                assert np.array_equal(seen[name], info["true_state"][:, at]), name
        assert np.allclose(seen["error_m"], seen["setpoint"][:, :3] - seen["pos_m"], atol=1e-6)
        seen, _, _, _, info = envs.step(actions)


def test_the_estimate_knows_the_velocity():
    envs = gym.make_vec(
        "Crazyflie-v0", num_envs=64, observation="estimate", form="dict", effects=EFFECTS, true_state=True
    )
    measured = gym.make_vec("Crazyflie-v0", num_envs=64, observation="measured", effects=EFFECTS)
    pilot = envs.controller("thesis-pid")
    rows, _ = measured.reset(seed=3)
    seen, info = envs.reset(seed=3)
    errors = []
    for _ in range(200):
        actions = envs.act(pilot)
        rows, *_ = measured.step(actions)
        seen, _, _, _, info = envs.step(actions)
        errors.append(seen["est_vel_mps"] - info["true_state"][:, STATE_FIELDS["vel_mps"]])
        assert np.array_equal(seen["gyro_radps"], rows[:, 9:12]), "what is measured stays what it was"
    assert np.sqrt(np.mean(np.square(errors[50:]))) < 0.08


def test_history_holds_the_last_observations():
    for env_id in ("Crazyflie-v0", "CrazyflieSwap-v0"):
        now = gym.make_vec(env_id, num_envs=3, observation=FIELDS, effects=EFFECTS)
        past = gym.make_vec(env_id, num_envs=3, observation=FIELDS, history=4, effects=EFFECTS)
        fields = gym.make_vec(env_id, num_envs=3, observation=FIELDS, history=4, form="dict", effects=EFFECTS)
        rows, _ = now.reset(seed=2)
        long, _ = past.reset(seed=2)
        split, _ = fields.reset(seed=2)
        ticks = [rows] * 4
        for k in range(10):
            assert np.array_equal(long, np.concatenate(ticks, axis=-1))
            lead = rows.shape[:-1]
            assert split["error_m"].shape == (*lead, 4, 3)
            assert np.array_equal(split["error_m"][..., -1, :], rows[..., :3])
            actions = 0.2 * actions_for(now.action_space, 1, seed=k)[0]
            rows, *_ = now.step(actions)
            long, *_ = past.step(actions)
            split, *_ = fields.step(actions)
            ticks = [*ticks[1:], rows]


def test_several_ticks_at_once_and_the_last_observation():
    envs = gym.make_vec(
        "Crazyflie-v0", num_envs=2, observation="state", history=2, autoreset_mode="same_step", max_episode_steps=5
    )
    envs.reset(seed=1)
    rows, _, _, truncated, infos = envs.step_many(np.zeros((5, 2, 4), np.float32))
    assert rows.shape == (5, 2, 48) and truncated[-1].all() and infos["final_obs"].shape == (2, 48)
    assert envs.single_observation_space.contains(infos["final_obs"][0])


def test_agents_of_their_own_see_what_was_asked_for():
    env = parallel_env("swap", observation="state", form="dict", drones=3)
    observations, _ = env.reset(seed=1)
    for agent, seen in observations.items():
        assert env.observation_space(agent).contains(seen)
        assert seen["neighbour_pos_m"].shape == (2, 3)
    rows, _ = parallel_env("swap", observation="state", drones=3).reset(seed=1)
    assert np.array_equal(rows["drone_1"][:3], observations["drone_1"]["pos_m"])


def test_pictures_do_not_depend_on_the_observation():
    pictures = []
    for options in ({}, {"observation": "measured"}, {"observation": ["vel_mps"], "history": 3}):
        env = gym.make("Crazyflie-v0", render_mode="rgb_array", effects=EFFECTS, **options)
        env.reset(seed=4)
        for action in random_actions(20, 1, size=0.3):
            env.step(action[0])
        pictures.append(env.render())
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])


def test_a_state_goes_on_with_filter_and_history():
    def make():
        return gym.make_vec("Crazyflie-v0", num_envs=3, observation=FIELDS, history=3, effects=EFFECTS)

    first, second = make(), make()
    first.reset(seed=1)
    actions = random_actions(40, 3, size=0.3)
    for action in actions[:20]:
        first.step(action)
    second.set_state(first.get_state())
    for action in actions[20:]:
        assert np.array_equal(first.step(action)[0], second.step(action)[0])


def test_the_layout_is_what_the_space_holds():
    assert crazyflie_gym.observation_fields() == crazyflie_gym.observation_fields("measured")
    everything = [field["name"] for field in crazyflie_gym.observable_fields()]
    fields = crazyflie_gym.observation_fields(everything)
    assert fields == crazyflie_gym.observable_fields()
    env = gym.make("CrazyflieRace-v0", observation=everything)  # the task that has them all
    assert env.observation_space.shape == (fields[-1]["first"] + fields[-1]["length"],)
    for choice in crazyflie_gym.observation_choices():
        assert [field["name"] for field in crazyflie_gym.observation_fields(choice["name"])] == choice["fields"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"observation": "stat"}, 'did you mean "state"'),
        ({"observation": ["pos_m", "vel_mp"]}, 'did you mean "vel_mps"'),
        ({"observation": []}, "at least one field"),
        ({"observation": ["pos_m", "pos_m"]}, r"observation\[1\]"),
        ({"history": 0}, "history is 0, expected 1 to 64"),
        ({"form": "list"}, 'form is \'list\', expected "flat" or "dict"'),
    ],
)
def test_mistakes_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        gym.make("Crazyflie-v0", **options)


def test_the_forms_of_before_still_work_with_a_warning():
    with pytest.warns(DeprecationWarning, match='write form="dict"'):
        env = gym.make("Crazyflie-v0", observation="dict")
    assert isinstance(env.observation_space, gym.spaces.Dict)
