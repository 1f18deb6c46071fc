"""The options of tasks: distributions, tracks of one's own, and what the documentation says of them."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
from crazyflie_gym import CrazyflieEnv, CrazyflieVectorEnv, track
from crazyflie_gym.spaces import DEFAULT_OBSERVATION, RowLayout

split = RowLayout(DEFAULT_OBSERVATION).split
OPTIONS = [(task, option) for task in crazyflie_gym.tasks() for option in task["options"]]


def setpoints(envs: CrazyflieVectorEnv, seed: int = 1) -> np.ndarray:
    observations, _ = envs.reset(seed=seed)
    return split(observations)["setpoint"]


def test_a_goal_is_drawn_for_every_episode_and_is_the_same_for_every_batch():
    low, high = [-1.0, -0.5, 0.5], [1.0, 0.5, 1.5]
    options = {"setpoint_m": {"uniform": [low, high]}, "start_m": [{"normal": [0.0, 0.1]}, 0.0, {"choice": [0.5, 1.0]}]}
    goals = setpoints(CrazyflieVectorEnv(64, task_options=options))[:, :3]
    assert (goals >= np.float32(low)).all() and (goals <= np.float32(high)).all()
    assert (goals.std(axis=0) > 0.4 * np.array([1.0, 0.5, 0.5])).all()
    np.testing.assert_array_equal(goals, setpoints(CrazyflieVectorEnv(64, task_options=options, threads=3))[:, :3])
    np.testing.assert_array_equal(goals[:5], setpoints(CrazyflieVectorEnv(5, task_options=options))[:, :3])
    corners = [[1.0, 1.0, 1.0], [-1.0, -1.0, 0.5]]
    chosen = setpoints(CrazyflieVectorEnv(64, task_options={"setpoint_m": {"choice": corners}}))[:, :3]
    assert {tuple(row) for row in chosen.tolist()} == {tuple(row) for row in corners}


@pytest.mark.parametrize(("task", "option"), OPTIONS, ids=lambda entry: entry["name"])
def test_every_option_says_what_it_takes(task, option):
    make = lambda value: gymnasium.make(task["id"], task_options={option["name"]: value})  # noqa: E731
    make(option["default"]).close()
    assert option["about"] and option["range"]
    if option["low"]:
        outside = [low - 1.0 for low in option["low"]]
        with pytest.raises(ValueError, match=option["name"]):
            make(outside if len(outside) > 1 else outside[0])
    if option["drawn"] and option["default"] is not None:
        env = make({"uniform": [option["default"]] * 2})
        observation, _ = env.reset(seed=0)
        assert np.isfinite(observation).all()
    elif not option["drawn"]:
        with pytest.raises(ValueError, match=option["name"]):
            make({"uniform": [1.0, 2.0]})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"setpoint": [0, 0, 1]},
            r'unknown option of this task "hover.setpoint" \(did you mean "hover.setpoint_m"\?\)',
        ),
        ({"setpoint_m": [0, 0]}, "setpoint_m is .*expected three numbers"),
        ({"setpoint_m": [0, 0, 9]}, r"setpoint_m\[2\] is 9, expected 0 to 2.6 m"),
        (
            {"setpoint_m": {"uniform": [[0, 0, 1]]}},
            r"setpoint_m is \{\"uniform\":\[0.*expected a number or a distribution",
        ),
        ({"setpoint_m": {"uniform": [[1, 0, 1], [0, 0, 1]]}}, r"setpoint_m\[0\]: the lower bound 1 is above"),
        ({"setpoint_m": {"choice": []}}, r"setpoint_m\[0\]: choice needs at least one value"),
        ({"setpoint_m": {"gauss": [[0, 0, 1], [0, 0, 1]]}}, "setpoint_m"),
        ({"setpoint_m": [0, 0, float("nan")]}, "task_options: Out of range float"),
        ({"start_radius_m": {"normal": [0.5, -1]}}, "start_radius_m is -1, expected a standard deviation"),
        ({"start_radius_m": {"log_uniform": [0, 1]}}, "start_radius_m is 0, expected a positive lower bound"),
        ({"start_radius_m": {"choice": []}}, "start_radius_m: choice needs at least one value"),
        ({"start_radius_m": "wide"}, 'start_radius_m is "wide", expected a number or a distribution'),
        ({"steps": 3}, "steps is 3, expected a list"),
        ([1, 2], "task_options"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises((ValueError, TypeError), match=words):
        CrazyflieEnv(task_options=options)


def test_a_circle_for_many_drones_grows():
    observations, _ = crazyflie_gym.CrazyflieSwarm(1, "swap", drones=64).reset(seed=0)
    assert np.isfinite(observations).all()
    with pytest.raises(ValueError, match=r"radius_m is 0\.5, expected 25 cm between 64 drones: at least 2\.54"):
        crazyflie_gym.CrazyflieSwarm(1, "swap", drones=64, task_options={"radius_m": 0.5, "jitter_m": 0.05})


def flown(options: dict) -> np.ndarray:
    """Set-points of two seconds, which nobody obeys."""
    env = CrazyflieEnv(task="track", task_options=options)
    rows = [env.reset(seed=0)[0]]
    rows += [env.step(np.zeros(4, np.float32))[0] for _ in range(100)]
    return split(np.stack(rows))["setpoint"]


def test_a_track_is_the_same_from_a_table_a_file_and_a_function(tmp_path: Path):
    rows = np.array([[0, 0, 0, 0.7, 0], [1, 0.5, 0, 0.9, 1], [2, 0.5, -0.5, 0.7, 2]])
    file = tmp_path / "way.csv"
    text = "\n".join(",".join(map(str, row)) for row in rows)
    file.write_text("t_s,x_m,y_m,z_m,yaw_rad\n" + text)

    def way(t_s: float) -> list[float]:
        return [float(np.interp(t_s, rows[:, 0], rows[:, i])) for i in range(1, 5)]

    expected = np.array([way(0.02 * tick) for tick in range(101)])
    for options in track(rows), track(rows.tolist()), track(file), track(str(file)), track(way, seconds=2.0):
        np.testing.assert_allclose(flown(options), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: track([[0, 0, 1]]), r"expected shape \(n, 4\) or \(n, 5\).*got \(1, 3\)"),
        (lambda: track([]), "expected shape"),
        (lambda: track([[0, 0, 0, 1], [1, 0, np.nan, 1]]), "row 1, column 2 is nan"),
        (lambda: track(lambda t_s: [0.0, 0.0, np.inf]), "row 0, column 3 is inf"),
        (lambda: track(lambda t_s: [0.0], seconds=1.0), r"got \(51, 2\)"),
        (lambda: track(lambda t_s: [0, 0, 1], seconds=-1), "seconds is -1"),
        (
            lambda: CrazyflieEnv(task="track", task_options=track([[0, 0, 0, 1], [0, 0, 0, 1]])),
            r"points\[1\]\[0\] \(t_s\)",
        ),
        (lambda: CrazyflieEnv(task="track", task_options={**track([[0, 0, 0, 1]]), "size_m": 1}), "size_m must not be"),
    ],
)
def test_bad_tracks_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_bad_track_file_is_named_with_line_and_column(tmp_path: Path):
    file = tmp_path / "bad.csv"
    file.write_text("t_s,x_m,y_m,z_m\n0,0,0,1\n1,0,wide,1\n")
    with pytest.raises(ValueError, match=r'bad\.csv, line 3: column y_m is "wide", expected a number'):
        track(file)
    with pytest.raises(FileNotFoundError):
        track(tmp_path / "nowhere.csv")


def test_a_task_file_may_draw_its_goal_and_is_the_same_for_every_batch():
    task = {
        "name": "anywhere",
        "task": "hover",
        "task_options": {"setpoint_m": {"uniform": [[-1, -1, 0.5], [1, 1, 1]]}},
    }
    goals = setpoints(crazyflie_gym.make_task(task, num_envs=20), seed=3)
    assert len(np.unique(goals[:, 0])) == 20
    observation, _ = crazyflie_gym.make_task(task).reset(seed=3)
    np.testing.assert_array_equal(split(observation)["setpoint"], goals[0])


def test_every_episode_draws_anew():
    env = CrazyflieEnv(task="track", task_options={"shape": "circle", "size_m": {"log_uniform": [0.2, 1.0]}})
    starts = [split(env.reset(seed=7 if episode == 0 else None)[0])["setpoint"][0] for episode in range(8)]
    assert len(set(starts)) == 8 and all(0.2 <= start <= 1.0 for start in starts)
    assert split(env.reset(seed=7)[0])["setpoint"][0] == starts[0]


def test_the_documentation_says_what_the_registry_says():
    page = (Path(__file__).parents[2] / "docs/tasks.md").read_text()
    for task, option in OPTIONS:
        line = next(line for line in page.splitlines() if line.startswith(f"| `{task['name']}` | `{option['name']}` |"))
        assert option["about"] in line and option["range"] in line
    for field in crazyflie_gym.observable_fields():
        assert f"| `{field['name']}` | {field['length']} |" in page
