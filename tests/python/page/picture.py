"""Takes the picture of the page: `python tests/python/page/picture.py docs/page.png`.

A figure eight, flown by the thesis's PID through the camera on a server of its own, seen in a real browser.
"""

import io
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym

sys.path.insert(0, str(Path(__file__).parents[1]))
from browsing import CHROMIUM, FLAGS, Server, loaded
from PIL import Image
from playwright.sync_api import sync_playwright

SECONDS = 18.7
TASK = {"shape": "figure_eight", "size_m": 0.4, "period_s": 12}
EFFECTS = {
    "camera": 1,
    "camera_latency": {"latency_s": 0.05},
    "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1},
    "camera_fov": {"diagonal_deg": 120},
}


def fly(url):
    """Fly in real time; a generator that takes a step at each turn. Told to begin, it begins a new episode."""
    env = gym.make(
        "crazyflie_gym:CrazyflieTrack-v0",
        remote=url.replace("http", "ws"),
        disable_env_checker=True,
        vertical="pwm",
        effects=EFFECTS,
        task_options=TASK,
    )
    try:
        begin = True
        while True:
            if begin:
                pid, (observation, _) = env.unwrapped.pid(gains="thesis"), env.reset(seed=4)
            due = time.monotonic() + 0.02
            observation, *_ = env.step(pid.act(observation))
            begin = yield
            time.sleep(max(0.0, due - time.monotonic()))
    finally:
        env.close()


def main(path):
    """Fly, look, and write the picture."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        server = Server(str(Path(folder) / "bench.sqlite"))
        flight = fly(server.url)
        next(flight)
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1180, "height": 704}, color_scheme="light")
        page.goto(server.url + "#live")
        while page.locator("#empty").is_visible():
            next(flight)
        loaded(page)
        page.locator("#vehicle-scale").select_option("4")
        flight.send(True)
        for _ in range(int(SECONDS / 0.02)):
            next(flight)
        page.wait_for_timeout(400)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        # few colours: a quarter of the size
        picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
        print(f"{path}: {Path(path).stat().st_size // 1000} kB")
        flight.close()
        browser.close()
        server.stop()


if __name__ == "__main__":
    main(sys.argv[1])
