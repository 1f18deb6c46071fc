"""A controller of one's own flies wherever one of the program's does, and what is wrong with it is said."""

import json
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflie_gym import Controller, CrazyflieEnv, CrazyflieSwarm, CrazyflieVectorEnv
from crazyflie_gym.benchmark import robustness, submit
from crazyflie_gym.evaluation import Scenario, Work, fly

MINE = """
import numpy as np
from gain import GAIN
from crazyflie_gym import Pid, split

class Mine:
    def __init__(self, num_envs, interface, gain=GAIN):
        self.pid, self.gain = Pid(num_envs, interface), gain
    def act(self, rows):
        return np.clip(self.gain * self.pid.act(rows), -1, 1)
    def reset(self, mask):
        self.pid.reset(mask)
    def set_mode(self, mode):
        self.pid.set_mode(mode)

class Shape(Mine):
    def act(self, rows):
        return super().act(rows)[:, :3]

class Nan(Mine):
    def act(self, rows):
        return np.full((len(rows), 4), np.nan)

class Raises(Mine):
    def act(self, rows):
        raise ArithmeticError("no thrust today")

class Nothing(Mine):
    act = None

class Level:
    def __init__(self, num_envs, interface):
        self.action = np.array([0, 0, 0, 2 * interface.hover_lift / interface.lift_max - 1], np.float32)
    def act(self, rows):
        assert rows.shape[1] == 12, rows.shape
        return np.tile(self.action, (len(rows), 1))

class Estimates(Level):
    observation, history = ["est_error_m", "est_vel_mps"], 2

class Truth(Level):
    observation = ["pos_m", "vel_mps", "att_rad", "rate_radps"]

class MisspelledField(Level):
    observation = ["est_error_m", "est_vel_mp"]
"""
WRONG = {
    "Shape": "act returned shape (1, 3), expected (1, 4)",
    "Nan": "act returned nan at [0][0], expected a number from -1 to 1",
    "Raises": "no thrust today",
    "Nothing": "expected an object with a method act(rows) -> actions",
    "Main": "did you mean 'Mine'",
}

PROGRAM = "import sys, crazyflie_cli; sys.exit(crazyflie_cli.main())"


@pytest.fixture(scope="session")
def mine(tmp_path_factory):
    """A file whose class `Mine` is the thesis's PID; it imports from its own folder."""
    file = tmp_path_factory.mktemp("own") / "own_controllers.py"
    file.write_text(MINE)
    (file.parent / "gain.py").write_text("GAIN = 1.0\n")
    return file


class Pd:
    """The thesis's PID as an object of this process."""

    def __init__(self, num_envs, interface, mode="automatic"):
        self.pid = crazyflie_gym.Pid(num_envs, interface, mode=mode)

    def act(self, rows):
        return self.pid.act(rows)

    def reset(self, mask):
        self.pid.reset(mask)

    def set_mode(self, mode):
        self.pid.set_mode(mode)


def program(*args):
    run = subprocess.run([sys.executable, "-c", PROGRAM, *args], capture_output=True, text=True, timeout=LIMIT_S)
    return run.returncode, run.stdout, run.stderr


def figures(*args):
    code, out, err = program("fly", "--json", "--seconds", "3", "--vertical", "pwm", *args)
    assert code == 0, err
    return json.loads(out)["runs"]


@pytest.mark.parametrize("task", ["hover", "whole-flight"])
def test_the_program_flies_it_as_its_own(mine, task):
    own = figures("--task", task, "--runs", "3", "--controller", f"python:{mine}:Mine")
    assert own == figures("--task", task, "--runs", "3")


def test_the_program_passes_its_options(mine):
    weak = figures("--controller", f"python:{mine}:Mine", "--controller-options", '{"gain": 0.9}')
    assert weak != figures("--controller", f"python:{mine}:Mine")


def test_each_drone_of_the_program_may_have_its_own(mine):
    own = figures("--task", "swap", "--drones", "2", "--controller", f"python:{mine}:Mine,lqr")
    assert own == figures("--task", "swap", "--drones", "2", "--controller", "thesis-pid,lqr")
    assert own != figures("--task", "swap", "--drones", "2")
    code, _, err = program("fly", "--task", "swap", "--drones", "3", "--controller", "lqr,mpc")
    assert code == 2 and "one for each of the 3 drones, got 2" in err
    assert program("fly", "--controller", "lqr,mpc")[0] == 2


@pytest.mark.parametrize("name", WRONG)
def test_the_program_ends_with_what_was_wrong(mine, name):
    code, out, err = program("fly", "--seconds", "1", "--controller", f"python:{mine}:{name}")
    assert code == 1 and WRONG[name] in err and not out, err
    if name == "Raises":
        assert "Traceback" in err and f'{mine.name}", line' in err and "in act" in err


def test_the_program_names_what_is_no_controller(mine):
    for text, words in {
        "python": "python:FILE:NAME",
        f"python:{mine}": "names no part of the file",
        "python:gone.py:Mine": "gone.py",
    }.items():
        code, _, err = program("fly", "--controller", text)
        assert code == 2 and words in err, err


@pytest.mark.parametrize("own", ["class", "object", "function", "name"])
def test_environments_fly_it(mine, own):
    envs = CrazyflieVectorEnv(3, vertical="pwm")
    controller = {
        "class": Pd,
        "object": Pd(3, envs.interface),
        "function": lambda num_envs, interface: Pd(num_envs, interface),
        "name": f"python:{mine}:Mine",
    }[own]
    envs.reset(seed=1)
    theirs, built_in = envs.controller(controller), envs.controller()
    for _ in range(30):
        actions = envs.act(theirs)
        np.testing.assert_array_equal(actions, envs.act(built_in))
        envs.step(actions)
    with pytest.raises(ValueError, match="expected one object for each drone") if own == "object" else nullcontext():
        CrazyflieSwarm(3, "swap", drones=2).controller(controller)


def test_each_drone_of_a_swarm_may_have_its_own():
    worlds = CrazyflieSwarm(3, "swap", drones=3)
    worlds.reset(seed=2)
    own = worlds.controller([Pd(3, worlds.sim.interfaces[0]), "lqr", Pd], avoid=False)
    built_in = worlds.controller(["thesis-pid", "lqr", "thesis-pid"], avoid=False)
    for _ in range(20):
        actions = worlds.act(own)
        np.testing.assert_array_equal(actions, worlds.act(built_in))
        worlds.step(actions)


def test_what_it_raises_arrives_as_it_is(mine):
    env = CrazyflieEnv(vertical="pwm")
    env.reset(seed=1)
    raising = env.controller(f"python:{mine}:Raises")
    with pytest.raises(ArithmeticError, match="no thrust today"):
        env.act(raising)
    for name, error in {"Shape": ValueError, "Nan": ValueError, "Nothing": TypeError, "Main": AttributeError}.items():
        with pytest.raises(error) as raised:
            env.act(env.controller(f"python:{mine}:{name}"))
        assert WRONG[name] in str(raised.value)
    with pytest.raises(TypeError, match="expected a name, an object with act"):
        env.controller(7)
    with pytest.raises(TypeError, match="unexpected keyword argument 'kp'"):
        env.controller(Pd, kp=3)
    with pytest.raises(TypeError, match="options are for a class or function"):
        env.controller(Pd(1, env.interface), kp=3)


class Watcher:
    """Keeps the rows that it is shown, and flies about."""

    def __init__(self, num_envs=0, interface=None, observation=None, history=None, others=None):
        self.observation, self.history, self.others = observation, history, others
        self.rows, self.rng = [], np.random.default_rng(0)

    def act(self, rows):
        self.rows.append(rows.copy())
        return self.rng.uniform(-0.3, 0.3, (len(rows), 4)).astype(np.float32)


EFFECTS = {"camera": 1, "camera_latency": 0.05, "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1}, "gust": 0.3}
SIGHTS = {
    "estimates": {"observation": ["est_error_m", "est_vel_mps"], "history": 2},
    "estimate": {"observation": "estimate"},
    "state": {"observation": "state", "history": 3},
    "measured": {"history": 4},
}


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("sight", SIGHTS)
def test_it_sees_what_an_agent_with_its_observation_sees(sight, mode):
    own = SIGHTS[sight]
    options = {"effects": EFFECTS, "vertical": "pwm", "autoreset_mode": mode, "max_episode_steps": 25}
    envs = CrazyflieVectorEnv(5, **options)
    agents = CrazyflieVectorEnv(5, **options, **({"observation": "measured"} | own))
    watcher = Watcher(**own)
    pilot = envs.controller(watcher)
    envs.reset(seed=3)
    rows, _ = agents.reset(seed=3)
    if sight == "estimates":
        assert rows.shape == (5, 12)
    begin = np.zeros(5, bool)
    for _ in range(60):
        actions = envs.act(pilot)
        np.testing.assert_array_equal(watcher.rows[-1], rows)
        _, _, terminated, truncated, _ = envs.step(actions)
        rows, *_ = agents.step(actions)
        # with a reset in the next step, the controller begins anew with its first observation
        ends = terminated | truncated
        pilot.reset(begin if mode == "next_step" else ends)
        begin = ends


def test_it_sees_the_other_drones():
    options = {"drones": 3, "effects": {"camera_noise": 0.01}}
    worlds = CrazyflieSwarm(4, "formation", **options)
    agents = CrazyflieSwarm(4, "formation", observation=["error_m", "est_vel_mps"], history=2, **options)
    sight = {"observation": ["error_m", "est_vel_mps"], "history": 2, "others": 2}
    watchers = [Watcher(**sight) for _ in range(3)]
    crowd = worlds.controller(watchers, avoid=False)
    worlds.reset(seed=3)
    rows, _ = agents.reset(seed=3)
    for _ in range(20):
        actions = 0.2 * worlds.act(crowd)
        for drone, watcher in enumerate(watchers):
            np.testing.assert_array_equal(watcher.rows[-1], rows[:, drone])
        worlds.step(actions)
        rows, *_ = agents.step(actions)
    with pytest.raises(ValueError, match="it reads fields of 2 other drones; fly it where there are 3 drones"):
        envs = CrazyflieVectorEnv(3)
        envs.reset(seed=0)
        envs.act(envs.controller(Watcher(**sight)))


def test_programs_and_evaluation_show_what_it_asks_for(mine, tmp_path):
    for name in ("Estimates", "Truth"):
        (flight,) = figures("--controller", f"python:{mine}:{name}")
        assert flight
    code, _, err = program("fly", "--seconds", "1", "--controller", f"python:{mine}:MisspelledField")
    assert code != 0 and 'unknown observation field "est_vel_mp" (did you mean "est_vel_mps"?)' in err
    with pytest.raises(ValueError, match='did you mean "est_vel_mps"'):
        CrazyflieVectorEnv(3).controller(f"python:{mine}:MisspelledField")
    scenario = Scenario(ticks=60, effects=EFFECTS)
    seen = CrazyflieVectorEnv(4, effects=EFFECTS, vertical="pwm", observation="measured", max_episode_steps=-1)
    watcher = Watcher(observation="state")
    flown = fly(Work(scenario, watcher, first_seed=7, count=4))
    seen = CrazyflieVectorEnv(4, effects=EFFECTS, vertical="pwm", max_episode_steps=-1)
    rows, _ = seen.reset(seed=7)
    np.testing.assert_array_equal(watcher.rows[0], rows)
    assert len(flown) == 4 and len(watcher.rows) == 60
    data = tmp_path / "bench.sqlite"
    with pytest.raises(ValueError, match="Truth: it reads the true state"):
        submit(f"python:{mine}:Truth", "fly-80cm", data=data)
    code, _, err = program("bench", "submit", "--controller", f"python:{mine}:Truth", "--data", str(data))
    assert code != 0 and "it reads the true state, and ranked attempts show measurements only" in err
    (row,) = submit(f"python:{mine}:Estimates", "fly-80cm", data=data)
    assert row["status"] == "finished"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"observation": "stat"}, 'did you mean "state"'),
        ({"observation": 3}, "observation is 3, expected one of"),
        ({"history": 0}, "history is 0, expected 1 to 64"),
        ({"history": "two"}, 'invalid type: string "two"'),
    ],
)
def test_what_it_cannot_see_is_said(wrong, words):
    with pytest.raises(ValueError, match=words):
        CrazyflieEnv().controller(Watcher(**wrong))
    env = CrazyflieEnv(observation="measured")
    row, _ = env.reset(seed=1)
    with pytest.raises(ValueError, match="it reads the true state, and only measurements are known here"):
        env.controller(Watcher(observation="state")).act(row)


def test_evaluation_flies_it(mine, tmp_path):
    scenario = Scenario(ticks=60)
    expected = fly(Work.of(scenario, "thesis-pid", 0, 4))
    assert fly(Work.of(scenario, f"python:{mine}:Mine", 0, 4)) == expected
    assert fly(Work.of(scenario, Pd, 0, 4)) == expected
    weak = Work.of(scenario, f"python:{mine}:Mine", 0, 4, gain=0.9)
    assert fly(weak) != expected
    other = tmp_path / "other.py"
    other.write_text(MINE + "\n")
    keys = {
        work.key()
        for work in [
            weak,
            Work.of(scenario, f"python:{mine}:Mine", 0, 4),
            Work.of(scenario, f"python:{other}:Mine", 0, 4),
            Work.of(scenario, f"python:{mine}:Nan", 0, 4),
            Work.of(scenario, Pd, 0, 4),
            Work.of(scenario, CrazyflieEnv, 0, 4),
        ]
    }
    assert len(keys) == 6
    with pytest.raises(ArithmeticError):
        fly(Work.of(scenario, f"python:{mine}:Raises", 0, 4))


def test_the_benchmark_flies_it_here(mine, tmp_path):
    data = tmp_path / "bench.sqlite"
    (own,) = submit(Pd, "fly-80cm", data=data)
    (built_in,) = submit("thesis-pid", "fly-80cm", data=data)
    assert own["status"] == built_in["status"] and own["controller"] == "python:Pd"
    with pytest.raises(ArithmeticError):
        submit(f"python:{mine}:Raises", "fly-80cm", data=data)
    code, out, err = program("bench", "submit", "--controller", f"python:{mine}:Mine", "--scenario", "fly-80cm",
                             "--data", str(data), "--json")  # fmt: skip
    assert code == 0 and json.loads(out)["controller"] == "python:own_controllers:Mine", err
    assert program("bench", "submit", "--controller", f"python:{mine}:Nan", "--data", str(data))[0] == 1
    assert program("bench", "verify", "--data", str(data))[0] == 0


def test_robustness_flies_it(mine):
    rows = robustness(["thesis-pid", Pd], ["fly-80cm"], seeds=20)
    assert len(rows) == 6 and {row["controller"] for row in rows} == {"thesis-pid", "python:Pd"}
    built_in, own = ([row for row in rows if row["controller"] == name] for name in ("thesis-pid", "python:Pd"))
    assert [row["score"] for row in own] == [row["score"] for row in built_in]
    with pytest.raises(ArithmeticError):
        robustness([f"python:{mine}:Raises"], ["fly-80cm"], seeds=20)
    with pytest.raises(ValueError, match="seeds is 3, expected 20 to 10000"):
        robustness([Pd], seeds=3)


def test_tuning_finds_its_options(mine, tmp_path):
    pytest.importorskip("tqdm")
    from crazyflie_gym.sweep import Store
    from crazyflie_gym.tuning import Search, tune

    search = Search(Scenario(ticks=40), f"python:{mine}:Mine", options={"gain": 0.5}, seeds=2, judged_on=2,
                    generations=2, population=4)  # fmt: skip
    with Store(tmp_path / "store.sqlite") as store:
        tuned = tune(search, store, progress=False)
    assert set(tuned.gains) == {"gain"} and len(tuned.costs) == 3


def test_options_of_a_controller_are_merged_with_its_defaults(tmp_path):
    env = CrazyflieEnv(vertical="pwm")
    defaults = json.loads(next(c["defaults"] for c in crazyflie_gym.controllers() if c["name"] == "thesis-pid"))
    defaults["x"]["kp"] = 3.0
    env.reset(seed=3)
    part, whole = env.controller(x={"kp": 3}), env.controller(**defaults)
    np.testing.assert_array_equal(env.act(part), env.act(whole))
    assert (env.act(part) != env.act(env.controller())).any()
    gains = Path(tmp_path, "gains.json")
    gains.write_text(json.dumps(defaults))
    assert isinstance(env.controller(f"pid:{gains}", y={"kd": 1}), Controller)
    with pytest.raises(ValueError, match="unknown field `kq`"):
        env.controller(x={"kq": 3})
    with pytest.raises(ValueError, match="invalid type"):
        env.controller(x=3)
