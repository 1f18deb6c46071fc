"""Pictures and the terminal."""

import zlib

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym


def test_rgb_array_shows_the_flight_move():
    env = gym.make("Crazyflie-v0", render_mode="rgb_array", effects={"camera_fov": 120, "camera_noise": {"xy_m": 0.02}})
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (360, 480, 3) and first.dtype == np.uint8
    for _ in range(20):
        env.step(np.array([0, 1, 0, 0], np.float32))
    assert (env.render() != first).any() and np.array_equal(env.render(), env.render())


def test_what_the_scene_holds():
    def picture(id="Crazyflie-v0", **kwargs):
        env = gym.make(id, render_mode="rgb_array", **kwargs)
        env.reset(seed=1)
        return env.render()

    plain = picture()
    for effects in ({"camera_fov": 120}, {"markers": {"columns": 3, "rows": 2}}, {"camera_noise": {"xy_m": 0.05}}):
        assert (picture(effects=effects) != plain).any(), effects
    path = crazyflie_gym._native.path("track", '{"shape": "square"}', 0.02, 400)
    assert path.shape == (400, 3) and np.abs(path[:, :2]).max() == pytest.approx(0.5)
    assert len(crazyflie_gym._native.path("track", '{"shape": "waypoints"}', 0.02, 400)) == 0


def test_render_before_reset_is_an_error():
    for wrapped in (
        gym.make("Crazyflie-v0", render_mode="rgb_array"),
        gym.make_vec("Crazyflie-v0", 2, render_mode="rgb_array"),
    ):
        with pytest.raises(gym.error.ResetNeeded):
            wrapped.render()
        with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before render\(\)"):
            wrapped.unwrapped.render()


def test_render_without_a_mode_warns():
    env = gym.make("Crazyflie-v0").unwrapped
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_batch_shows_each_environment(mode):
    envs = gym.make_vec("Crazyflie-v0", 3, render_mode="rgb_array", autoreset_mode=mode, max_episode_steps=4)
    envs.reset(seed=0)
    for _ in range(11):
        envs.step(np.zeros((3, 4), np.float32))
    pictures = envs.render()
    assert len(pictures) == 3 and (pictures[0] != pictures[1]).any()


def test_a_batch_draws_what_one_environment_draws():
    envs = gym.make_vec("Crazyflie-v0", 3, render_mode="rgb_array", max_episode_steps=5)
    one = gym.make("Crazyflie-v0", render_mode="rgb_array", max_episode_steps=5)
    envs.reset(seed=0)
    one.reset(seed=1)
    action = np.array([0, 0.5, 0, 0], np.float32)
    for _ in range(8):
        _, _, _, truncated, _ = envs.step(np.tile(action, (3, 1)))
        one.step(action)
        if truncated[1]:
            envs.step(np.tile(action, (3, 1)))
            one.reset()
    assert np.array_equal(envs.render()[1], one.render())


def test_human_mode_prints_a_line_per_second_without_a_terminal(capsys):
    env = gym.make("Crazyflie-v0", render_mode="human")
    env.reset(seed=0)
    for _ in range(125):
        env.step(np.array([0, 0, 0, 2 * 0.7 / 1.5 - 1], np.float32))
    env.close()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ["0.02", "1.00", "2.00"]
    assert "return" in lines[0] and "\x1b" not in "".join(lines)


def test_human_mode_draws_on_a_terminal(monkeypatch):
    import io
    import os

    class Terminal(io.StringIO):
        def isatty(self):
            return True

        def fileno(self):
            return 1

    screen = Terminal()
    monkeypatch.setattr("sys.stdout", screen)
    monkeypatch.setattr(os, "get_terminal_size", lambda fd: os.terminal_size((60, 30)))
    env = gym.make("Crazyflie-v0", render_mode="human")
    env.reset(seed=0)
    for _ in range(6):
        env.step(np.zeros(4, np.float32))
    env.close()
    text = screen.getvalue()
    assert "\u2580" * 3 in text.replace("\x1b[0m", "") or "\u2580" in text
    assert text.count("\x1b[H") == 3, "every second tick of 50 Hz"
    assert max(line.count("\u2580") for line in text.split("\n")) <= 60


def test_record_video(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.make("Crazyflie-v0", render_mode="rgb_array", max_episode_steps=10)
    env = gym.wrappers.RecordVideo(env, str(tmp_path / "videos"), episode_trigger=lambda episode: True)
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros(4, np.float32))
    env.close()
    videos = list((tmp_path / "videos").glob("*.mp4"))
    assert len(videos) == 1 and videos[0].stat().st_size > 1000


def test_png_files_hold_the_picture(tmp_path):
    picture = crazyflie_gym.render(40, 30, drones=np.array([[0, 0, 0.7, 0, 0, 0]], np.float32))
    path = tmp_path / "a.png"
    crazyflie_gym.save_png(path, picture)
    data = path.read_bytes()
    start = data.index(b"IDAT")
    length = int.from_bytes(data[start - 4 : start], "big")
    rows = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + length]), np.uint8).reshape(30, 121)
    assert (rows[:, 0] == 0).all() and np.array_equal(rows[:, 1:].reshape(30, 40, 3), picture)
    with pytest.raises(ValueError, match="expected uint8"):
        crazyflie_gym.save_png(path, picture[0])


def test_ansi_shows_a_picture_as_text():
    text = crazyflie_gym.ansi(np.full((8, 8, 3), 200, np.uint8), 8)
    assert text.count("\n") == 4 and "200;200;200" in text
